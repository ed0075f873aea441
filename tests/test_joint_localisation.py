"""Check joint localisation: joints are found, and unsuitable images are rejected with a reason."""

from dataclasses import replace

import numpy as np
import pytest
from block_phantom import PIXEL_MM, SHAPE, TEMPLATE, make_phantom
from hypothesis import given, settings
from hypothesis import strategies as st
from msgspec.structs import replace as replaced
from scipy.ndimage import gaussian_filter, zoom

import pssf
from pssf.core.checks import InputError
from pssf.data.analysis.localisation_table import load_localisation_settings
from pssf.radiomics.localisation import pixel_aspect
from pssf.radiomics.localisation.edge_field import Pyramid, compute_edge_field
from pssf.radiomics.localisation.joint_candidates import Candidates, MatchPair
from pssf.radiomics.localisation.joint_localisation import (
    _compute_chance_score,
    _decide_status,
    _select_side,
    locate_joint,
    locate_joint_in_radiograph,
)
from pssf.radiomics.localisation.joint_localisation import find_candidates as search_film
from pssf.radiomics.localisation.laterality import compute_side_evidence
from pssf.radiomics.localisation.pixel_aspect import locate_joint_in_film, resample_to_square_pixels
from pssf.radiomics.localisation.template_matching import Match, find_matches
from pssf.radiomics.localisation.templates import Template, compute_density, make_poses
from pssf.standard_templates import make_standard_templates
from pssf.validation.study_methods.localisation_rates import make_coarse_protocol

TABLE = load_localisation_settings()


def locate_in_phantom(pixels, side="right", pixel_mm=PIXEL_MM, region_px=64, templates=(TEMPLATE,)):
    return locate_joint_in_radiograph(pixels, templates, TABLE, side=side, pixel_mm=pixel_mm, region_px=region_px)


@settings(max_examples=8)
@given(
    row=st.integers(130, 190),
    col=st.integers(150, 175),
    side=st.sampled_from(["right", "left"]),
    noise=st.sampled_from([0.0, 1.0]),
)
def test_a_shifted_joint_is_found_to_within_a_pixel_on_both_sides(row, col, side, noise):
    col = col if side == "right" else SHAPE[1] - 1 - col
    joint = locate_in_phantom(make_phantom(row, col, side, noise=noise), side)
    assert joint.status == "found"
    assert abs(joint.row - row) < 1
    assert abs(joint.col - col) < 1
    assert joint.side_margin > 0
    assert joint.orientation_margin > 0.1


@pytest.mark.parametrize("scale", [0.85, 1.1])
def test_a_larger_or_smaller_knee_is_found(scale):
    joint = locate_in_phantom(make_phantom(150, 170, scale=scale))
    assert np.hypot(joint.row - 150, joint.col - 170) < 2
    assert abs(joint.scale - scale) < 0.04


def test_a_narrow_template_finds_the_middle_of_a_narrow_joint_space():
    tibia_mm = 0.0
    middle = 160 + (tibia_mm - 2.5) / 2 / PIXEL_MM
    pixels = make_phantom(160, 180, tibia_mm=tibia_mm)
    narrow = Template(pixels=pixels, row=middle, col=180, pixel_mm=PIXEL_MM)
    image = make_phantom(150, 170, noise=1.0, tibia_mm=tibia_mm)
    by_one, by_two = locate_in_phantom(image), locate_in_phantom(image, templates=(TEMPLATE, narrow))
    assert abs(by_two.row - (middle - 10)) < 0.4
    assert abs(by_one.row - (middle - 10)) > 0.6
    assert abs(locate_in_phantom(make_phantom(150, 170), templates=(TEMPLATE, narrow)).row - 150) < 0.4


@pytest.mark.parametrize("curve", [lambda x: x**3, np.sqrt, lambda x: np.clip(2.5 * x - 0.9, 0, 1)])
def test_localisation_does_not_depend_on_tone_curve_and_polarity(curve):
    density = compute_density(make_phantom(150, 170, noise=1.0))
    toned = curve((density - density.min()) / np.ptp(density))
    bright, dark = (
        locate_joint(film, [TEMPLATE], TABLE, side="right", pixel_mm=PIXEL_MM) for film in (toned, 1.0 - toned)
    )
    for joint in (bright, dark):
        assert joint.status == "found"
        assert np.hypot(joint.row - 150, joint.col - 170) < 2
    assert (bright.polarity, dark.polarity) == ("bone bright", "bone dark")


@pytest.mark.parametrize("side", ["right", "left"])
def test_unknown_side_and_pixel_size_are_estimated(side):
    film = compute_density(make_phantom(150, 165, side, noise=1.0))
    joint = locate_joint(film, [TEMPLATE], TABLE)
    assert (joint.status, joint.side, joint.pixel_mm_source) == ("found", side, "plateau")
    assert np.hypot(joint.row - 150, joint.col - 165) < 2
    # Without a pixel size the plateau is assumed to have the mean width.
    usual = PIXEL_MM * load_localisation_settings().plateau.mean_mm / TEMPLATE.plateau_mm
    assert abs(joint.pixel_mm / usual - 1) < 0.04
    smaller = locate_joint(film.reshape(160, 2, 160, 2).mean(axis=(1, 3)), [TEMPLATE], TABLE)
    assert abs(smaller.pixel_mm / joint.pixel_mm / 2 - 1) < 0.04


def test_a_joint_near_the_border_of_a_crop_is_found():
    film = compute_density(make_phantom(150, 165, noise=1.0))[90:210, 40:220]
    joint = locate_joint(film, [TEMPLATE], TABLE, side="right", pixel_mm=PIXEL_MM)
    assert joint.status == "found"
    assert np.hypot(joint.row - 60, joint.col - 125) < 2
    assert joint.visible_fraction < 1


@pytest.fixture(scope="module")
def simulated(built, small):
    """Simulate a knee at 256 x 256 pixels and its leg without bones; return both and a template of a standard knee."""
    soft = pssf.Scene([s for s in built.scene.surfaces if s.name in ("skin", "adipose", "muscle")])
    whole, bare = (pssf.simulate(subject, small, rng=1, engine="scanline") for subject in (built, soft))
    standard = pssf.simulate(pssf.Knee(), small, engine="scanline", keep=("noise_free",))
    row, col = standard.truth.medial_joint_line_px
    template = Template(pixels=standard.kept["noise_free"], row=row, col=col, pixel_mm=small.pixel_mm, plateau_mm=94.0)
    return whole, bare.pixels, [template]


@pytest.fixture(scope="module")
def standard():
    return make_standard_templates("scanline")


def test_a_simulated_joint_is_found_with_and_without_side_and_pixel_size(simulated):
    whole, _, templates = simulated
    row, col = whole.truth.medial_joint_line_px
    given = locate_joint_in_radiograph(whole.pixels, templates, TABLE, side="right", pixel_mm=1.2, region_px=64)
    alone = locate_joint(compute_density(whole.pixels), templates, TABLE)
    for joint in (given, alone):
        assert (joint.status, joint.side) == ("found", "right")
        assert np.hypot(joint.row - row, joint.col - col) * 1.2 < 2.5


def squeeze_rows(simulated, by):
    """Crop a film and squeeze its rows; return crops with and without bones, joint row and templates."""
    whole, bare, templates = simulated
    row, _ = whole.truth.medial_joint_line_px
    rows = slice(int(row) - 60, int(row) + 60)
    crops = [
        zoom(compute_density(pixels)[rows], (1 / by, 1.0), order=1, mode="nearest", grid_mode=True)
        for pixels in (whole.pixels, bare)
    ]
    return *crops, (row - rows.start + 0.5) / by - 0.5, templates


def test_a_joint_on_a_film_with_non_square_pixels_is_found(simulated):
    whole, bare, row, templates = squeeze_rows(simulated, 1.44)
    col = simulated[0].truth.medial_joint_line_px[1]
    square, tall = (locate_joint(resample_to_square_pixels(whole, height), templates, TABLE) for height in (1.0, 1.44))
    assert square.mean_score < tall.mean_score - 0.05
    between = (square.mean_score + tall.mean_score) / 2
    strict = replaced(TABLE, thresholds=replaced(TABLE.thresholds, min_score=between, min_score_stop_search=between))
    assert locate_joint(whole, templates, strict).status == "no knee"
    joint = locate_joint_in_film(whole, templates, strict)
    assert (joint.status, joint.pixel_height) == ("found", 1.44)
    assert np.hypot(joint.row - row, joint.col - col) * 1.2 < 3.0
    assert joint.square_pixel_row == pytest.approx((joint.row + 0.5) * 1.44 - 0.5)
    # If the pixel size is given, pixels are assumed to be square.
    assert locate_joint_in_film(whole, templates, strict, pixel_mm=1.2).pixel_height == 1.0
    # Further attempts require a higher score, because the maximum of several scores is higher by chance.
    above = replaced(strict, thresholds=replaced(strict.thresholds, min_score_further_attempts=0.9))
    assert locate_joint_in_film(whole, templates, above).status == "no knee"
    assert locate_joint_in_film(bare, templates, TABLE).status == "no knee"


def locate_with_attempts(monkeypatch, attempts):
    """Locate a joint with specified attempts: (rows of the resampled film, severe) -> (status, score)."""
    known = locate_in_phantom(make_phantom(150, 165))

    def attempt(image, *_, severe=False, **__):
        status, both = attempts.get((image.shape[0], severe), ("no knee", 0.3))
        orientation = "upside down" if status == "upside down" else "upright"
        return replace(
            known, status=status, orientation=orientation, score=both, compartment_score=both, row=0.4 * image.shape[0]
        )

    monkeypatch.setattr(pixel_aspect, "locate_joint", attempt)
    return locate_joint_in_film(np.zeros((100, 80)), [TEMPLATE], TABLE)


def test_the_best_pixel_aspect_is_used_unless_an_inverted_one_is_better(monkeypatch):
    attempts = {(83, False): ("found", 0.48), (120, False): ("found", 0.5), (144, False): ("found", 0.55)}
    joint = locate_with_attempts(monkeypatch, attempts)
    assert (joint.status, joint.pixel_height, joint.mean_score) == ("found", 1.44, 0.55)
    assert joint.square_pixel_row == pytest.approx(0.4 * 144)
    assert locate_with_attempts(monkeypatch, attempts | {(144, False): ("no knee", 0.55)}).pixel_height == 1.2
    assert locate_with_attempts(monkeypatch, attempts | {(83, False): ("upside down", 0.6)}).status == "upside down"


@pytest.mark.parametrize(
    ("square", "tall", "height"),
    [
        # The score with square pixels is high enough.
        (("found", 0.52), ("found", 0.59), 1.0),
        # A rejection with such a high score is accepted.
        (("wrong side", 0.63), ("found", 0.7), 1.0),
        (("wrong side", 0.55), ("found", 0.59), 1.44),
        # The score gain is too small for non-square pixels.
        (("found", 0.48), ("found", 0.50), 1.0),
        (("found", 0.48), ("found", 0.52), 1.44),
        (("found", 0.45), ("found", 0.45), 1.0),
    ],
)
def test_square_pixels_are_preferred_if_their_score_is_high_or_similar(monkeypatch, square, tall, height):
    joint = locate_with_attempts(monkeypatch, {(100, False): square, (144, False): tall})
    assert joint.pixel_height == height
    assert joint.status == (square if height == 1.0 else tall)[0]


@pytest.mark.parametrize(
    ("usual", "severe", "of_severe"),
    [
        (("no knee", 0.3), ("found", 0.47), True),
        # A score of 0.45 can occur by chance in several attempts.
        (("no knee", 0.3), ("found", 0.45), False),
        (("found", 0.55), ("found", 0.57), True),
        (("found", 0.55), ("found", 0.53), False),
        (("found", 0.55), ("low score", 0.57), False),
        # The usual score is so high that severe templates are not tried.
        (("found", 0.63), ("found", 0.7), False),
    ],
)
def test_a_severe_template_is_used_if_it_matches_better(monkeypatch, usual, severe, of_severe):
    joint = locate_with_attempts(monkeypatch, {(100, False): usual, (100, True): severe})
    assert (joint.status, joint.mean_score) == (severe if of_severe else usual)


def test_a_severe_template_with_edges_of_the_other_side_is_rejected():
    joint = replace(locate_in_phantom(make_phantom(150, 165)), score=0.5, compartment_score=0.5)
    severe = replace(joint, score=0.6, side_evidence=-0.1)
    assert pixel_aspect._select_usual_or_severe(joint, severe, TABLE) is severe
    assert pixel_aspect._select_usual_or_severe(joint, replace(severe, side_evidence=-0.2), TABLE) is joint


def test_a_weak_match_without_a_pixel_size_needs_clear_side_evidence():
    joint = replace(
        locate_in_phantom(make_phantom(150, 165)),
        pixel_mm_source="plateau",
        score=0.455,
        compartment_score=0.455,
        side_evidence=0.3,
    )
    assert _decide_status(joint, SHAPE, None, TABLE) == "no knee"
    for other in ({"side_evidence": -0.8}, {"score": 0.52}, {"pixel_mm_source": "given"}):
        assert _decide_status(replace(joint, **other), SHAPE, None, TABLE) == "found"


def test_severe_templates_are_used_only_on_request():
    film = compute_density(make_phantom(150, 165))
    templates = [TEMPLATE, replace(TEMPLATE, pixels=make_phantom(160, 180, scale=1.5), severe=True)]
    assert locate_joint(film, templates, TABLE) == locate_joint(film, templates[:1], TABLE)
    larger = compute_density(make_phantom(150, 165, scale=1.5))
    usual, severe = (locate_joint(larger, templates, TABLE, severe=requested).mean_score for requested in (False, True))
    assert severe > usual


def test_resampling_to_square_pixels_restores_the_proportions():
    film = np.arange(60.0).reshape(10, 6)
    assert resample_to_square_pixels(film, 1.0) is film
    square = resample_to_square_pixels(film, 1.5)
    assert square.shape == (15, 6)
    # Values increase by 6 per original row and by 4 per square pixel; border rows are repeated.
    np.testing.assert_allclose(np.diff(square[1:-1], axis=0), 4.0)


def test_no_knee_is_found_in_noise_or_in_a_leg_without_bones(simulated):
    _, bare, templates = simulated
    assert locate_joint_in_radiograph(bare, templates, TABLE, side="right", pixel_mm=1.2).status == "no knee"
    noise = np.random.default_rng(0).integers(1000, 2000, bare.shape).astype(np.uint16)
    assert locate_joint_in_radiograph(noise, templates, TABLE, side="right", pixel_mm=1.2).status == "no knee"


@pytest.mark.parametrize("name", ["reference", "fixed_flexion"])
def test_standard_templates_distinguish_a_knee_from_a_leg_without_bones(standard, name):
    assert len({template.plateau_mm for template in standard}) == 1
    protocol = make_coarse_protocol(pssf.load_protocol(name))
    built = pssf.build(pssf.Knee(), protocol)
    soft = pssf.Scene([surface for surface in built.scene.surfaces if surface.name in ("skin", "adipose", "muscle")])
    whole, bare = (pssf.simulate(subject, protocol, engine="scanline") for subject in (built, soft))
    assert (
        locate_joint(compute_density(bare.pixels), standard, TABLE, severe=True).mean_score
        < TABLE.thresholds.min_score_unknown_pitch
    )
    assert (
        locate_joint(compute_density(whole.pixels), standard, TABLE).mean_score
        > TABLE.thresholds.min_score_square_pixels
    )
    joint = locate_joint_in_radiograph(
        whole.pixels, standard, TABLE, side="right", pixel_mm=protocol.pixel_mm, region_px=64
    )
    offset_px = np.subtract((joint.row, joint.col), whole.truth.medial_joint_line_px)
    assert np.hypot(*offset_px) * protocol.pixel_mm < 4.0


def test_matching_the_plateau_width_rescales_a_template_pixel_size():
    larger = replace(TEMPLATE, pixel_mm=1.3 * TEMPLATE.pixel_mm, plateau_mm=1.3 * TEMPLATE.plateau_mm)
    assert larger.match_plateau_width(TEMPLATE).pixel_mm == pytest.approx(TEMPLATE.pixel_mm)
    assert larger.match_plateau_width(TEMPLATE).plateau_mm == TEMPLATE.plateau_mm
    with pytest.raises(InputError, match="template plateau_mm must be the width in mm, got plateau_mm = None"):
        larger.match_plateau_width(replace(TEMPLATE, plateau_mm=None))


def test_a_wrong_side_is_reported(simulated):
    whole, _, templates = simulated
    joint = locate_joint_in_radiograph(whole.pixels, templates, TABLE, side="left", pixel_mm=1.2)
    assert joint.status == "wrong side"
    assert joint.side_evidence < -load_localisation_settings().thresholds.max_opposite_side_evidence


@pytest.mark.parametrize("invert", [np.flipud, lambda image: np.rot90(image, 2)])
def test_an_inverted_image_is_reported_as_upside_down(simulated, invert):
    whole, _, templates = simulated
    joint = locate_joint(compute_density(invert(whole.pixels)), templates, TABLE, pixel_mm=1.2)
    assert joint.status == joint.orientation == "upside down"


@pytest.mark.parametrize("factor", [2.0, 1.5, 0.5])
def test_a_wrong_pixel_size_is_reported(simulated, factor):
    whole, _, templates = simulated
    joint = locate_joint_in_radiograph(
        whole.pixels, templates, TABLE, side="right", pixel_mm=1.2 * factor, region_px=64
    )
    assert joint.status == "wrong scale"


@pytest.mark.parametrize("weak", ["score", "compartment_score"])
def test_a_mean_score_below_the_limit_is_reported_as_no_knee(weak):
    limits, joint = load_localisation_settings().thresholds, locate_in_phantom(make_phantom(150, 165))
    for off, status in ((0.01, "found"), (-0.01, "no knee")):
        score = getattr(joint, weak) + 2 * (limits.min_score + off - joint.mean_score)
        assert _decide_status(replace(joint, **{weak: score}), SHAPE, None, load_localisation_settings()) == status


def test_a_distant_compartment_match_is_reported_as_low_score():
    limits, joint = load_localisation_settings().thresholds, locate_in_phantom(make_phantom(150, 165))
    for off, status in ((-0.1, "found"), (0.1, "low score")):
        apart = replace(joint, match_distance_mm=limits.max_match_distance_mm + off)
        assert _decide_status(apart, SHAPE, None, load_localisation_settings()) == status


def make_candidates(matches, rise=0.0):
    image = Pyramid(compute_density(make_phantom(150, 165)))
    return Candidates(
        image=image, templates=(TEMPLATE,), matches=matches, table=load_localisation_settings(), chance_slope=rise
    )


def make_match(score, row, col, unit_mm=PIXEL_MM, side="right", orientation="upright", chance=0.0):
    return Match(
        score=score, side=side, orientation=orientation, polarity="bone bright", row=row, col=col,
        template_mm_per_px=unit_mm,
        visible_fraction=1.0,
        chance_score=chance,
    )  # fmt: skip


def test_a_match_with_a_medial_compartment_is_preferred():
    right, decoys = make_match(0.60, 150, 165), [make_match(0.64, 90, 120), make_match(0.66, 150, 165, 2.2 * PIXEL_MM)]
    pair = make_candidates([right, *decoys]).select_pair("upright", "right")
    assert pair.joint_match == right
    assert np.hypot(pair.compartment_match.row - 150, pair.compartment_match.col - 165) < 1.0
    assert pair.compartment_match.score > 0.9
    assert pair.mean_score == pytest.approx((pair.joint_match.score + pair.compartment_match.score) / 2)


def test_a_match_with_a_much_lower_score_is_not_considered():
    far = load_localisation_settings().search.max_score_deficit + 0.01
    right, decoy = make_match(0.60, 150, 165), make_match(0.60 + far, 90, 120)
    assert make_candidates([right, decoy]).select_pair("upright", "right").joint_match == decoy
    # The score expected by chance is subtracted first.
    lucky = make_match(0.60 + far, 90, 120, chance=far)
    assert make_candidates([right, lucky]).select_pair("upright", "right").joint_match == right


def test_a_wrong_side_is_reported_only_if_a_side_is_specified():
    joint = locate_in_phantom(make_phantom(150, 165))
    mirrored = replace(joint, side_evidence=-1.0)
    assert _decide_status(mirrored, SHAPE, None, load_localisation_settings()) == "found"
    assert _decide_status(mirrored, SHAPE, None, load_localisation_settings(), "right") == "wrong side"


def test_edge_evidence_selects_the_side_only_for_matches_at_one_joint():
    def make_pair(wide, narrow, **at):
        return MatchPair(joint_match=make_match(wide, **at), compartment_match=make_match(narrow, **at))

    same, distant = {"row": 150, "col": 165}, {"row": 90, "col": 165}
    right, left = make_pair(0.62, 0.40, **same), make_pair(0.60, 0.50, **same, side="left")
    assert _select_side({"right": right, "left": left}, 0.1, load_localisation_settings()) == "right"
    assert _select_side({"right": right, "left": left}, -0.1, load_localisation_settings()) == "left"
    elsewhere = make_pair(0.60, 0.50, **distant, side="left")
    assert _select_side({"right": right, "left": elsewhere}, 0.1, load_localisation_settings()) == "left"
    of_another_size = make_pair(0.60, 0.50, **same, side="left", unit_mm=2 * PIXEL_MM)
    assert _select_side({"right": right, "left": of_another_size}, 0.1, load_localisation_settings()) == "left"


@pytest.mark.parametrize("invert", [np.array, np.negative, np.flipud])
def test_mirroring_a_film_reverses_the_evidence_for_its_side(simulated, invert):
    whole, _, templates = simulated
    film = invert(compute_density(whole.pixels))

    def compute_evidence(of):
        search, of_sides = search_film(of, templates, TABLE, 1.2)
        return compute_side_evidence(search.image, of_sides, TABLE)

    of_film, of_mirror = compute_evidence(film), compute_evidence(film[:, ::-1])
    assert of_film > 0.5
    assert of_mirror == pytest.approx(-of_film, abs=0.05)


def test_matches_of_another_side_or_orientation_are_not_candidates():
    right, others = (
        make_match(0.60, 150, 165),
        [make_match(0.9, 90, 120, side="left"), make_match(0.9, 90, 120, orientation="upside down")],
    )
    assert make_candidates([right, *others]).select_pair("upright", "right").joint_match == right


def test_a_region_beyond_the_image_border_is_reported():
    assert locate_in_phantom(make_phantom(160, 170), region_px=400).status == "leaves image"
    film = compute_density(make_phantom(160, 170))
    assert (
        locate_joint(film, [TEMPLATE], TABLE, side="right", pixel_mm=PIXEL_MM, region_px=330).status == "leaves image"
    )


def test_invalid_arguments_raise_an_error():
    film = compute_density(make_phantom(160, 180))
    with pytest.raises(InputError, match="large enough for a knee joint"):
        locate_in_phantom(np.ones((10, 10), np.uint16))
    with pytest.raises(InputError, match="side"):
        locate_joint(film, [TEMPLATE], TABLE, side="up")
    with pytest.raises(InputError, match="pixel_mm"):
        locate_joint(film, [TEMPLATE], TABLE, pixel_mm=0.0)
    with pytest.raises(InputError, match="templates must include a knee without severe osteoarthritis"):
        locate_joint(film, [], TABLE)
    with pytest.raises(InputError, match="plateau_mm = None"):
        locate_joint(film, [Template(pixels=TEMPLATE.pixels, row=160, col=180, pixel_mm=PIXEL_MM)], TABLE)
    with pytest.raises(InputError, match="template plateau_mm"):
        Template(pixels=TEMPLATE.pixels, row=160, col=180, pixel_mm=PIXEL_MM, plateau_mm=-1.0)


def test_edge_vectors_are_parallel_to_the_density_gradient():
    ramp = np.add.outer(np.arange(40.0), 3 * np.arange(50.0))
    down, right = compute_edge_field(ramp, 6.0)[:, 5:-5, 5:-5]
    np.testing.assert_allclose(right / down, 3.0, rtol=1e-4)
    field = compute_edge_field(np.random.default_rng(0).standard_normal((40, 40)), 6.0)
    assert np.hypot(*field).max() <= 1
    assert not compute_edge_field(np.ones((20, 20)), 6.0).any()


@given(zoomed=st.floats(0.05, 2.0))
@settings(max_examples=12)
def test_a_resampled_image_keeps_its_position(zoomed):
    rows, cols = np.mgrid[:90, :120].astype(float)
    image = Pyramid(rows + 2 * cols).resample_image(zoomed)
    row, col = ((np.arange(length) + 0.5) / zoomed - 0.5 for length in image.shape)
    inside = [slice(length // 4, -(length // 4) or None) for length in image.shape]
    wanted = np.add.outer(row, 2 * col)
    np.testing.assert_allclose(image[tuple(inside)], wanted[tuple(inside)], atol=0.6 / zoomed)


def test_the_score_expected_by_chance_is_higher_for_smaller_knees():
    """Check the correction of scores: noise offers more possible positions for a small knee than for a large one."""
    table = load_localisation_settings()
    chance = [_compute_chance_score((160, 300), unit_mm, table) for unit_mm in (0.2, 0.4, 0.8, 1.6, 3.2)]
    assert chance == sorted(chance)
    noise = gaussian_filter(np.random.default_rng(3).standard_normal((160, 300)), 1.5)
    large, small = (_find_best_score(noise, unit_mm) for unit_mm in (0.4, 1.6))
    assert large < small
    corrected = (
        large - _compute_chance_score(noise.shape, 0.4, table),
        small - _compute_chance_score(noise.shape, 1.6, table),
    )
    assert abs(corrected[1] - corrected[0]) < small - large


def _find_best_score(image, unit_mm):
    table = load_localisation_settings()
    whole = make_poses((TEMPLATE,), table.wide)
    return max(
        one.score
        for one in find_matches(Pyramid(image), [unit_mm], whole, table.wide, table.search.min_visible_fraction)
    )
