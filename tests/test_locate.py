"""Finding the joint, and refusing what is none, is turned, mirrored or of another size."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from msgspec.structs import replace as replaced
from phantoms import PIXEL_MM, SHAPE, TEMPLATE, phantom
from scipy.ndimage import gaussian_filter, zoom

import pssf
from pssf.core.checks import InputError
from pssf.data.analysis.localisation_table import load_localisation_settings
from pssf.experiment import make_standard_templates
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
from pssf.radiomics.localisation.joint_localisation import find_candidates as searched_film
from pssf.radiomics.localisation.laterality import compute_side_evidence
from pssf.radiomics.localisation.pixel_aspect import locate_joint_in_film, resample_to_square_pixels
from pssf.radiomics.localisation.template_matching import Match, find_matches
from pssf.radiomics.localisation.templates import Template, compute_density, make_poses
from pssf.validation.study_methods.localisation_rates import make_coarse_protocol

TABLE = load_localisation_settings()


def joint_of(pixels, side="right", pixel_mm=PIXEL_MM, region_px=64, templates=(TEMPLATE,)):
    return locate_joint_in_radiograph(pixels, templates, TABLE, side=side, pixel_mm=pixel_mm, region_px=region_px)


@settings(max_examples=8)
@given(
    row=st.integers(130, 190),
    col=st.integers(150, 175),
    side=st.sampled_from(["right", "left"]),
    noise=st.sampled_from([0.0, 1.0]),
)
def test_a_shifted_joint_is_found_to_within_a_pixel_on_either_side(row, col, side, noise):
    col = col if side == "right" else SHAPE[1] - 1 - col
    joint = joint_of(phantom(row, col, side, noise=noise), side)
    assert joint.status == "found"
    assert abs(joint.row - row) < 1
    assert abs(joint.col - col) < 1
    assert joint.side_margin > 0
    assert joint.orientation_margin > 0.1


@pytest.mark.parametrize("scale", [0.85, 1.1])
def test_a_larger_or_smaller_knee_is_found(scale):
    joint = joint_of(phantom(150, 170, scale=scale))
    assert np.hypot(joint.row - 150, joint.col - 170) < 2
    assert abs(joint.scale - scale) < 0.04


def test_the_middle_of_a_narrow_joint_space_is_found_by_the_template_of_one():
    tibia_mm = 0.0
    middle = 160 + (tibia_mm - 2.5) / 2 / PIXEL_MM
    pixels = phantom(160, 180, tibia_mm=tibia_mm)
    narrow = Template(pixels=pixels, row=middle, col=180, pixel_mm=PIXEL_MM)
    image = phantom(150, 170, noise=1.0, tibia_mm=tibia_mm)
    by_one, by_two = joint_of(image), joint_of(image, templates=(TEMPLATE, narrow))
    assert abs(by_two.row - (middle - 10)) < 0.4
    assert abs(by_one.row - (middle - 10)) > 0.6
    assert abs(joint_of(phantom(150, 170), templates=(TEMPLATE, narrow)).row - 150) < 0.4


@pytest.mark.parametrize("curve", [lambda x: x**3, np.sqrt, lambda x: np.clip(2.5 * x - 0.9, 0, 1)])
def test_the_tone_of_a_film_does_not_matter_and_neither_does_its_polarity(curve):
    density = compute_density(phantom(150, 170, noise=1.0))
    shown = curve((density - density.min()) / np.ptp(density))
    bright, dark = (
        locate_joint(film, [TEMPLATE], TABLE, side="right", pixel_mm=PIXEL_MM) for film in (shown, 1.0 - shown)
    )
    for joint in (bright, dark):
        assert joint.status == "found"
        assert np.hypot(joint.row - 150, joint.col - 170) < 2
    assert (bright.polarity, dark.polarity) == ("bone bright", "bone dark")


@pytest.mark.parametrize("side", ["right", "left"])
def test_side_and_pitch_that_are_not_known_are_found(side):
    film = compute_density(phantom(150, 165, side, noise=1.0))
    joint = locate_joint(film, [TEMPLATE], TABLE)
    assert (joint.status, joint.side, joint.pixel_mm_source) == ("found", side, "plateau")
    assert np.hypot(joint.row - 150, joint.col - 165) < 2
    # The phantom's plateau is taken for one of the usual width.
    usual = PIXEL_MM * load_localisation_settings().plateau.mean_mm / TEMPLATE.plateau_mm
    assert abs(joint.pixel_mm / usual - 1) < 0.04
    smaller = locate_joint(film.reshape(160, 2, 160, 2).mean(axis=(1, 3)), [TEMPLATE], TABLE)
    assert abs(smaller.pixel_mm / joint.pixel_mm / 2 - 1) < 0.04


def test_a_crop_whose_patch_leaves_it_is_found():
    film = compute_density(phantom(150, 165, noise=1.0))[90:210, 40:220]
    joint = locate_joint(film, [TEMPLATE], TABLE, side="right", pixel_mm=PIXEL_MM)
    assert joint.status == "found"
    assert np.hypot(joint.row - 60, joint.col - 125) < 2
    assert joint.visible_fraction < 1


@pytest.fixture(scope="module")
def simulated(built, small):
    """A knee's radiograph on 256 x 256 pixels, the same leg without bones, and the standard knee to processing for."""
    soft = pssf.Scene([s for s in built.scene.surfaces if s.name in ("skin", "adipose", "muscle")])
    whole, bare = (pssf.simulate(what, small, rng=1, engine="scanline") for what in (built, soft))
    standard = pssf.simulate(pssf.Knee(), small, engine="scanline", keep=("noise_free",))
    row, col = standard.truth.medial_joint_line_px
    template = Template(pixels=standard.kept["noise_free"], row=row, col=col, pixel_mm=small.pixel_mm, plateau_mm=94.0)
    return whole, bare.pixels, [template]


@pytest.fixture(scope="module")
def standard():
    return make_standard_templates("scanline")


def test_a_simulated_joint_is_found_with_side_and_pitch_or_without(simulated):
    whole, _, templates = simulated
    row, col = whole.truth.medial_joint_line_px
    given = locate_joint_in_radiograph(whole.pixels, templates, TABLE, side="right", pixel_mm=1.2, region_px=64)
    alone = locate_joint(compute_density(whole.pixels), templates, TABLE)
    for joint in (given, alone):
        assert (joint.status, joint.side) == ("found", "right")
        assert np.hypot(joint.row - row, joint.col - col) * 1.2 < 2.5


def squeezed(simulated, by):
    """A crop of 256 columns about the joint whose rows were made fewer, its joint line, bone bright; and templates."""
    whole, bare, templates = simulated
    row, _ = whole.truth.medial_joint_line_px
    rows = slice(int(row) - 60, int(row) + 60)
    crops = [
        zoom(compute_density(pixels)[rows], (1 / by, 1.0), order=1, mode="nearest", grid_mode=True)
        for pixels in (whole.pixels, bare)
    ]
    return *crops, (row - rows.start + 0.5) / by - 0.5, templates


def test_a_joint_on_a_film_that_was_squeezed_is_found_on_higher_pixels(simulated):
    whole, bare, row, templates = squeezed(simulated, 1.44)
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
    # A pitch that is known is of pixels that are square.
    assert locate_joint_in_film(whole, templates, strict, pixel_mm=1.2).pixel_height == 1.0
    # Better than chance alone gives among so many looks.
    above = replaced(strict, thresholds=replaced(strict.thresholds, min_score_further_attempts=0.9))
    assert locate_joint_in_film(whole, templates, above).status == "no knee"
    assert locate_joint_in_film(bare, templates, TABLE).status == "no knee"


def looks_of(monkeypatch, looks):
    """What `locate_film` makes of looks: (rows of a film of 100, severe) -> status and scores; of others nothing."""
    known = joint_of(phantom(150, 165))

    def look(seen, *_, severe=False, **__):
        status, both = looks.get((seen.shape[0], severe), ("no knee", 0.3))
        way = "upside down" if status == "upside down" else "upright"
        return replace(
            known, status=status, orientation=way, score=both, compartment_score=both, row=0.4 * seen.shape[0]
        )

    monkeypatch.setattr(pixel_aspect, "locate_joint", look)
    return locate_joint_in_film(np.zeros((100, 80)), [TEMPLATE], TABLE)


def test_of_looks_at_higher_and_wider_pixels_the_best_decides_unless_one_upside_down_is_better(monkeypatch):
    looks = {(83, False): ("found", 0.48), (120, False): ("found", 0.5), (144, False): ("found", 0.55)}
    joint = looks_of(monkeypatch, looks)
    assert (joint.status, joint.pixel_height, joint.mean_score) == ("found", 1.44, 0.55)
    assert joint.square_pixel_row == pytest.approx(0.4 * 144)
    assert looks_of(monkeypatch, looks | {(144, False): ("no knee", 0.55)}).pixel_height == 1.2
    assert looks_of(monkeypatch, looks | {(83, False): ("upside down", 0.6)}).status == "upside down"


@pytest.mark.parametrize(
    ("square", "tall", "height"),
    [
        (("found", 0.52), ("found", 0.59), 1.0),  # clear
        (("wrong side", 0.63), ("found", 0.7), 1.0),  # so clear that what it is refused for counts
        (("wrong side", 0.55), ("found", 0.59), 1.44),
        (("found", 0.48), ("found", 0.50), 1.0),  # by less than a step of height gives
        (("found", 0.48), ("found", 0.52), 1.44),
        (("found", 0.45), ("found", 0.45), 1.0),
    ],
)
def test_pixels_are_taken_as_square_where_that_is_clear_or_nearly_as_good(monkeypatch, square, tall, height):
    joint = looks_of(monkeypatch, {(100, False): square, (144, False): tall})
    assert joint.pixel_height == height
    assert joint.status == (square if height == 1.0 else tall)[0]


@pytest.mark.parametrize(
    ("usual", "severe", "of_severe"),
    [
        (("no knee", 0.3), ("found", 0.47), True),
        (("no knee", 0.3), ("found", 0.45), False),  # chance among so many looks
        (("found", 0.55), ("found", 0.57), True),
        (("found", 0.55), ("found", 0.53), False),
        (("found", 0.55), ("low score", 0.57), False),
        (("found", 0.63), ("found", 0.7), False),  # not looked for
    ],
)
def test_a_severe_knee_is_taken_where_it_matches_better_or_no_usual_one_is_found(monkeypatch, usual, severe, of_severe):
    joint = looks_of(monkeypatch, {(100, False): usual, (100, True): severe})
    assert (joint.status, joint.mean_score) == (severe if of_severe else usual)


def test_a_severe_knee_whose_edges_are_of_the_other_side_is_not_taken():
    joint = replace(joint_of(phantom(150, 165)), score=0.5, compartment_score=0.5)
    severe = replace(joint, score=0.6, side_evidence=-0.1)
    assert pixel_aspect._select_usual_or_severe(joint, severe, TABLE) is severe
    assert pixel_aspect._select_usual_or_severe(joint, replace(severe, side_evidence=-0.2), TABLE) is joint


def test_without_a_pitch_a_match_as_on_a_leg_without_bones_needs_a_side():
    joint = replace(
        joint_of(phantom(150, 165)), pixel_mm_source="plateau", score=0.455, compartment_score=0.455, side_evidence=0.3
    )
    assert _decide_status(joint, SHAPE, None, TABLE) == "no knee"
    for other in ({"side_evidence": -0.8}, {"score": 0.52}, {"pixel_mm_source": "given"}):
        assert _decide_status(replace(joint, **other), SHAPE, None, TABLE) == "found"


def test_a_severe_template_is_used_only_where_it_is_asked_for():
    film = compute_density(phantom(150, 165))
    templates = [TEMPLATE, replace(TEMPLATE, pixels=phantom(160, 180, scale=1.5), severe=True)]
    assert locate_joint(film, templates, TABLE) == locate_joint(film, templates[:1], TABLE)
    larger = compute_density(phantom(150, 165, scale=1.5))
    usual, severe = (locate_joint(larger, templates, TABLE, severe=asked).mean_score for asked in (False, True))
    assert severe > usual


def test_what_was_squeezed_has_its_own_proportions_on_square_pixels():
    film = np.arange(60.0).reshape(10, 6)
    assert resample_to_square_pixels(film, 1.0) is film
    square = resample_to_square_pixels(film, 1.5)
    assert square.shape == (15, 6)
    # Rows rise by 6 each, by 4 on square pixels; at the ends the border is repeated.
    np.testing.assert_allclose(np.diff(square[1:-1], axis=0), 4.0)


def test_a_leg_without_bones_holds_no_knee_and_neither_does_noise(simulated):
    _, bare, templates = simulated
    assert locate_joint_in_radiograph(bare, templates, TABLE, side="right", pixel_mm=1.2).status == "no knee"
    noise = np.random.default_rng(0).integers(1000, 2000, bare.shape).astype(np.uint16)
    assert locate_joint_in_radiograph(noise, templates, TABLE, side="right", pixel_mm=1.2).status == "no knee"


@pytest.mark.parametrize("name", ["reference", "fixed_flexion"])
def test_of_standard_templates_all_are_as_wide_and_a_leg_without_bones_is_as_none_of_them(standard, name):
    assert len({template.plateau_mm for template in standard}) == 1
    protocol = make_coarse_protocol(pssf.load_protocol(name))
    built = pssf.build(pssf.Knee(), protocol)
    soft = pssf.Scene([surface for surface in built.scene.surfaces if surface.name in ("skin", "adipose", "muscle")])
    whole, bare = (pssf.simulate(what, protocol, engine="scanline") for what in (built, soft))
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
    away_px = np.subtract((joint.row, joint.col), whole.truth.medial_joint_line_px)
    assert np.hypot(*away_px) * protocol.pixel_mm < 4.0


def test_a_template_that_is_larger_on_its_detector_is_the_same_at_another_pitch():
    larger = replace(TEMPLATE, pixel_mm=1.3 * TEMPLATE.pixel_mm, plateau_mm=1.3 * TEMPLATE.plateau_mm)
    assert larger.match_plateau_width(TEMPLATE).pixel_mm == pytest.approx(TEMPLATE.pixel_mm)
    assert larger.match_plateau_width(TEMPLATE).plateau_mm == TEMPLATE.plateau_mm
    with pytest.raises(InputError, match="template plateau_mm must be its width in mm, got plateau_mm = None"):
        larger.match_plateau_width(replace(TEMPLATE, plateau_mm=None))


def test_the_wrong_side_is_refused(simulated):
    whole, _, templates = simulated
    joint = locate_joint_in_radiograph(whole.pixels, templates, TABLE, side="left", pixel_mm=1.2)
    assert joint.status == "wrong side"
    assert joint.side_evidence < -load_localisation_settings().thresholds.max_opposite_side_evidence


@pytest.mark.parametrize("turned", [np.flipud, lambda image: np.rot90(image, 2)])
def test_what_is_upside_down_is_refused(simulated, turned):
    whole, _, templates = simulated
    joint = locate_joint(compute_density(turned(whole.pixels)), templates, TABLE, pixel_mm=1.2)
    assert joint.status == joint.orientation == "upside down"


@pytest.mark.parametrize("factor", [2.0, 1.5, 0.5])
def test_a_wrong_pitch_is_refused(simulated, factor):
    whole, _, templates = simulated
    joint = locate_joint_in_radiograph(
        whole.pixels, templates, TABLE, side="right", pixel_mm=1.2 * factor, region_px=64
    )
    assert joint.status == "wrong scale"


@pytest.mark.parametrize("weak", ["score", "compartment_score"])
def test_where_the_mean_of_both_scores_is_below_the_limit_there_is_no_knee(weak):
    limits, joint = load_localisation_settings().thresholds, joint_of(phantom(150, 165))
    for off, status in ((0.01, "found"), (-0.01, "no knee")):
        score = getattr(joint, weak) + 2 * (limits.min_score + off - joint.mean_score)
        assert _decide_status(replace(joint, **{weak: score}), SHAPE, None, load_localisation_settings()) == status


def test_a_compartment_that_matches_elsewhere_has_too_low_a_score():
    limits, joint = load_localisation_settings().thresholds, joint_of(phantom(150, 165))
    for off, status in ((-0.1, "found"), (0.1, "low score")):
        apart = replace(joint, match_distance_mm=limits.max_match_distance_mm + off)
        assert _decide_status(apart, SHAPE, None, load_localisation_settings()) == status


def searched(found, rise=0.0):
    image = Pyramid(compute_density(phantom(150, 165)))
    return Candidates(
        image=image, templates=(TEMPLATE,), matches=found, table=load_localisation_settings(), chance_slope=rise
    )


def wide_match(score, row, col, unit_mm=PIXEL_MM, side="right", way="upright", chance=0.0):
    return Match(
        score=score, side=side, orientation=way, polarity="bone bright", row=row, col=col, template_mm_per_px=unit_mm,
        visible_fraction=1.0,
        chance_score=chance,
    )  # fmt: skip


def test_of_places_that_match_alike_the_one_with_a_medial_compartment_is_taken():
    right, decoys = wide_match(0.60, 150, 165), [wide_match(0.64, 90, 120), wide_match(0.66, 150, 165, 2.2 * PIXEL_MM)]
    pair = searched([right, *decoys]).select_pair("upright", "right")
    assert pair.joint_match == right
    assert np.hypot(pair.compartment_match.row - 150, pair.compartment_match.col - 165) < 1.0
    assert pair.compartment_match.score > 0.9
    assert pair.mean_score == pytest.approx((pair.joint_match.score + pair.compartment_match.score) / 2)


def test_a_place_that_matches_far_worse_as_a_whole_is_not_looked_at():
    far = load_localisation_settings().search.max_score_deficit + 0.01
    right, decoy = wide_match(0.60, 150, 165), wide_match(0.60 + far, 90, 120)
    assert searched([right, decoy]).select_pair("upright", "right").joint_match == decoy
    # What chance gives is taken off first.
    lucky = wide_match(0.60 + far, 90, 120, chance=far)
    assert searched([right, lucky]).select_pair("upright", "right").joint_match == right


def test_a_side_is_wrong_only_where_it_was_told():
    joint = joint_of(phantom(150, 165))
    mirrored = replace(joint, side_evidence=-1.0)
    assert _decide_status(mirrored, SHAPE, None, load_localisation_settings()) == "found"
    assert _decide_status(mirrored, SHAPE, None, load_localisation_settings(), "right") == "wrong side"


def test_of_two_sides_at_one_joint_the_edges_tell_and_of_two_places_the_better_by_both():
    def pair(wide, narrow, **at):
        return MatchPair(joint_match=wide_match(wide, **at), compartment_match=wide_match(narrow, **at))

    here, beyond = {"row": 150, "col": 165}, {"row": 90, "col": 165}
    right, left = pair(0.62, 0.40, **here), pair(0.60, 0.50, **here, side="left")
    assert _select_side({"right": right, "left": left}, 0.1, load_localisation_settings()) == "right"
    assert _select_side({"right": right, "left": left}, -0.1, load_localisation_settings()) == "left"
    elsewhere = pair(0.60, 0.50, **beyond, side="left")
    assert _select_side({"right": right, "left": elsewhere}, 0.1, load_localisation_settings()) == "left"
    of_another_size = pair(0.60, 0.50, **here, side="left", unit_mm=2 * PIXEL_MM)
    assert _select_side({"right": right, "left": of_another_size}, 0.1, load_localisation_settings()) == "left"


@pytest.mark.parametrize("turned", [np.array, np.negative, np.flipud])
def test_a_film_in_the_mirror_has_the_opposite_evidence_for_its_side(simulated, turned):
    whole, _, templates = simulated
    film = turned(compute_density(whole.pixels))

    def evidence(of):
        search, of_sides = searched_film(of, templates, TABLE, 1.2)
        return compute_side_evidence(search.image, of_sides, TABLE)

    of_film, of_mirror = evidence(film), evidence(film[:, ::-1])
    assert of_film > 0.5
    assert of_mirror == pytest.approx(-of_film, abs=0.05)


def test_matches_of_another_side_or_way_are_no_candidates():
    right, others = (
        wide_match(0.60, 150, 165),
        [wide_match(0.9, 90, 120, side="left"), wide_match(0.9, 90, 120, way="upside down")],
    )
    assert searched([right, *others]).select_pair("upright", "right").joint_match == right


def test_a_region_that_leaves_the_image_is_refused():
    assert joint_of(phantom(160, 170), region_px=400).status == "leaves image"
    film = compute_density(phantom(160, 170))
    assert (
        locate_joint(film, [TEMPLATE], TABLE, side="right", pixel_mm=PIXEL_MM, region_px=330).status == "leaves image"
    )


def test_arguments_that_cannot_be_used_are_refused():
    film = compute_density(phantom(160, 180))
    with pytest.raises(InputError, match="large enough for a knee joint"):
        joint_of(np.ones((10, 10), np.uint16))
    with pytest.raises(InputError, match="side"):
        locate_joint(film, [TEMPLATE], TABLE, side="up")
    with pytest.raises(InputError, match="pixel_mm"):
        locate_joint(film, [TEMPLATE], TABLE, pixel_mm=0.0)
    with pytest.raises(InputError, match="templates must be one or more"):
        locate_joint(film, [], TABLE)
    with pytest.raises(InputError, match="plateau_mm = None"):
        locate_joint(film, [Template(pixels=TEMPLATE.pixels, row=160, col=180, pixel_mm=PIXEL_MM)], TABLE)
    with pytest.raises(InputError, match="template plateau_mm"):
        Template(pixels=TEMPLATE.pixels, row=160, col=180, pixel_mm=PIXEL_MM, plateau_mm=-1.0)


def test_edges_point_up_the_density_and_are_nowhere_longer_than_one():
    ramp = np.add.outer(np.arange(40.0), 3 * np.arange(50.0))
    down, right = compute_edge_field(ramp, 6.0)[:, 5:-5, 5:-5]
    np.testing.assert_allclose(right / down, 3.0, rtol=1e-4)
    field = compute_edge_field(np.random.default_rng(0).standard_normal((40, 40)), 6.0)
    assert np.hypot(*field).max() <= 1
    assert not compute_edge_field(np.ones((20, 20)), 6.0).any()


@given(zoomed=st.floats(0.05, 2.0))
@settings(max_examples=12)
def test_an_image_at_another_pitch_lies_where_it_should(zoomed):
    rows, cols = np.mgrid[:90, :120].astype(float)
    image = Pyramid(rows + 2 * cols).resample_image(zoomed)
    row, col = ((np.arange(length) + 0.5) / zoomed - 0.5 for length in image.shape)
    inside = [slice(length // 4, -(length // 4) or None) for length in image.shape]
    wanted = np.add.outer(row, 2 * col)
    np.testing.assert_allclose(image[tuple(inside)], wanted[tuple(inside)], atol=0.6 / zoomed)


def test_the_smaller_a_knee_the_better_is_its_best_score_by_chance():
    """On noise, over which a small knee has more places; of an unknown pitch sizes are weighed by it."""
    table = load_localisation_settings()
    chance = [_compute_chance_score((160, 300), unit_mm, table) for unit_mm in (0.2, 0.4, 0.8, 1.6, 3.2)]
    assert chance == sorted(chance)
    noise = gaussian_filter(np.random.default_rng(3).standard_normal((160, 300)), 1.5)
    large, small = (_best_at(noise, unit_mm) for unit_mm in (0.4, 1.6))
    assert large < small
    weighed = (
        large - _compute_chance_score(noise.shape, 0.4, table),
        small - _compute_chance_score(noise.shape, 1.6, table),
    )
    assert abs(weighed[1] - weighed[0]) < small - large


def _best_at(image, unit_mm):
    table = load_localisation_settings()
    whole = make_poses((TEMPLATE,), table.wide)
    return max(
        one.score
        for one in find_matches(Pyramid(image), [unit_mm], whole, table.wide, table.search.min_visible_fraction)
    )
