import dataclasses

import numpy as np
import pytest
from manifold3d import Manifold
from numpy.testing import assert_allclose

import pssf
from pssf import anatomy, raycast
from pssf.anatomy.truth import _by_site
from pssf.geometry.view import magnification, view_of

REFERENCE = pssf.load_protocol("reference")
BEAKS = tuple(pssf.Osteophyte(site=site, size_mm=2.0) for site in ("medial_femur", "medial_tibia", "lateral_spine"))


@pytest.fixture(scope="module")
def grown():
    knee = pssf.Knee(osteophytes=BEAKS)
    small = dataclasses.replace(REFERENCE, rows=512, cols=512, pixel_mm=0.3)
    return pssf.simulate(knee, small, engine="scanline", keep=("masks",))


def test_joint_space_at_fractions_of_the_femur_is_no_less_than_the_smallest(knee, built):
    truth = built.truth(REFERENCE)
    for fraction, space in truth.jsw_at_mm.items():
        least = knee.jsw_medial_mm if fraction < 0.5 else knee.jsw_lateral_mm
        assert least - 1e-3 <= space < least + 4
    assert truth.readings["jsw_least_medial_mm"] == pytest.approx(knee.jsw_medial_mm, abs=1e-3)
    assert truth.readings["jsw_least_lateral_mm"] == pytest.approx(knee.jsw_lateral_mm, abs=1e-3)
    shifted = built.truth(pssf.load_protocol("geometry_shift"))
    assert shifted.jsw_at_mm == truth.jsw_at_mm


def test_spaces_of_a_taking_are_all_of_that_taking():
    protocol = pssf.load_protocol("fixed_flexion")
    off = {"medial": [], "lateral": []}
    for seed in range(3):
        knee = pssf.draw_knee(grade=seed % 4, rng=np.random.default_rng(seed), table="people", subluxation_mm=0.0)
        taken = pssf.draw_exposure(protocol, rng=np.random.default_rng(seed))
        truth = pssf.build(knee, taken).truth(taken)
        for side, of_side in (("medial", slice(0, 7)), ("lateral", slice(7, 16))):
            least = truth.readings[f"jsw_least_{side}_mm"]
            off[side].append(min(list(truth.jsw_at_mm.values())[of_side]) - least)
            assert least != pytest.approx(getattr(knee, f"jsw_{side}_mm"), abs=1e-3)
    # Places 2 mm apart see no less than the least of all, but where they reach farther out; and little more.
    for beyond in off.values():
        assert min(beyond) > -0.3
        assert np.median(beyond) < 0.3


def test_landmarks_lie_as_in_a_knee(grown):
    spots = grown.truth.landmarks_px
    mm = grown.protocol.pixel_mm / magnification(view_of(grown.protocol))
    row, col = ({name: place[k] for name, place in spots.items()} for k in (0, 1))
    for name in ("condyle_edge", "plateau_edge", "epicondyle", "spine", "joint_line"):
        assert col[f"medial_{name}"] > col["joint_centre"] > col[f"lateral_{name}"]
    assert row["medial_epicondyle"] < row["medial_condyle_edge"] < row["medial_joint_line"] < row["medial_plateau_edge"]
    assert row["notch"] < row["lateral_spine"] < row["joint_centre"]
    assert_allclose((col["medial_plateau_edge"] - col["lateral_plateau_edge"]) * mm, 77.5, atol=2.0)
    assert_allclose((col["medial_epicondyle"] - col["lateral_epicondyle"]) * mm, 82.65, atol=3.0)


def test_masks_are_the_shadows_of_the_bones(grown):
    masks = grown.truth.masks
    bones = set(anatomy.BONES) - {"fabella"}
    assert set(masks) == {*bones, *(f"{beak.site}_osteophyte" for beak in BEAKS)}
    scene = pssf.build(grown.knee).scene
    for name in bones:
        surface = next(s for s in scene.surfaces if s.name == name)
        paths = pssf.trace(pssf.Scene([surface], "muscle"), grown.protocol, engine="scanline", precision="float64")
        assert ((paths.path_mm["cortical_bone"] > 0) == masks[name]).mean() > 0.9999


def test_the_mask_of_an_osteophyte_reaches_beyond_the_edge_by_its_size(grown):
    spots, masks = grown.truth.landmarks_px, grown.truth.masks
    mm = grown.protocol.pixel_mm / magnification(view_of(grown.protocol))
    cols = np.flatnonzero(masks["medial_tibia_osteophyte"].any(axis=0))
    assert_allclose((cols.max() - spots["medial_plateau_edge"][1]) * mm, 2.0, atol=0.4)
    bone = masks["tibia"] | masks["femur"]
    for beak in BEAKS:
        mask = masks[f"{beak.site}_osteophyte"]
        assert 10 < mask.sum() < 1000
        assert (bone[mask]).all()
    assert not (masks["medial_tibia_osteophyte"] & masks["lateral_spine_osteophyte"]).any()


def test_what_grew_together_of_two_sites_is_parted_between_their_tips_and_of_one_site_is_not():
    box, far = Manifold.cube((10.0, 2.0, 2.0)), Manifold.cube((3.0, 2.0, 2.0)).translate((30.0, 0.0, 0.0))
    tips = np.array([[1.0, 1.0, 1.0], [4.0, 1.0, 1.0], [8.0, 1.0, 1.0], [40.0, 1.0, 1.0]])
    sites = ["medial_spine", "medial_spine", "lateral_spine", "medial_tibia"]
    volumes = {site: part.volume() for site, part in _by_site(box + far, sites, tips).items()}
    assert volumes == pytest.approx({"medial_spine": 4 * 6.0, "lateral_spine": 4 * 4.0, "medial_tibia": 12.0})


def test_masks_of_a_left_knee_mirror_those_of_a_right_one(grown):
    left = dataclasses.replace(grown.knee, side="left")
    for site, mesh in pssf.build(left).osteophytes().items():
        assert mesh.as_trimesh().volume > 0
        seen = raycast.shadow(mesh, grown.protocol)
        assert (seen[:, ::-1] == grown.truth.masks[f"{site}_osteophyte"]).mean() > 0.9999


def test_masks_cost_nothing_unless_asked_for_and_are_refused_for_a_scene(built, scene):
    small = dataclasses.replace(REFERENCE, rows=32, cols=32, pixel_mm=5.0)
    assert not pssf.simulate(built, small).truth.masks
    with pytest.raises(pssf.InputError, match="keep = masks of a scene"):
        pssf.simulate(scene, small, keep=("masks",))


def test_truth_survives_a_file(grown, tmp_path):
    assert pssf.load(pssf.save(grown, tmp_path / "knee.tif")).truth == grown.truth


@pytest.mark.parametrize(("rows", "cols", "pixel_mm"), [(64, 64, 30.0), (12, 12, 25.0), (1, 1, 1.0), (2, 3, 50.0)])
def test_a_detector_whose_pixels_are_wider_than_a_compartment_tells_the_same_places(built, small, rows, cols, pixel_mm):
    fine = built.truth(small)
    coarse = dataclasses.replace(small, rows=rows, cols=cols, pixel_mm=pixel_mm)
    truth = built.truth(coarse)
    for name, place in fine.landmarks_px.items():
        there, here = (
            [(at - (count - 1) / 2) * seen.pixel_mm for at, count in zip(spot, (seen.rows, seen.cols), strict=True)]
            for spot, seen in ((place, small), (truth.landmarks_px[name], coarse))
        )
        np.testing.assert_allclose(here, there, atol=1.0)
    assert truth.jsw_at_mm == fine.jsw_at_mm
