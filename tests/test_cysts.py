"""Check subchondral cysts: size, location in trabecular bone, masks and sampling."""

import dataclasses
import itertools

import numpy as np
import pytest
from numpy.testing import assert_allclose
from posed_bones import build_posed_bones

import pssf
from pssf import Cyst, InputError, Knee
from pssf.anatomy.posture.knee_assembly import assemble_knee, load_jsw_protocol
from pssf.anatomy.subchondral_cysts import WALL_MM, place_cysts
from pssf.anatomy.template.bone_builder import resolve_bone_parameters
from pssf.data.anatomy.anatomy_tables import load_anatomy_tables
from pssf.data.knees.field_definitions import load_field_specs
from pssf.model.knee import knee_from_dict, knee_to_dict
from pssf.model.protocol import Posture

SITES = load_field_specs("cyst")["site"].choices
WORN = Knee(
    jsw_definition="read", jsw_medial_mm=0.1, jsw_lateral_mm=4.0, varus_deg=5.0, side="left",
    cysts=(
        Cyst(site="medial_tibia", diameter_mm=6.0, place=-0.5),
        Cyst(site="medial_tibia", diameter_mm=3.0, place=0.5, outward=1.0),
        Cyst(site="lateral_femur", diameter_mm=4.0, outward=0.0),
    ),
)  # fmt: skip


def place_bones_and_cysts(knee, posture):
    """Return bones and cysts of a knee without soft tissue, and its assembly."""
    assembly = assemble_knee(
        knee, resolve_bone_parameters(knee, load_anatomy_tables()), posture, load_jsw_protocol(knee)
    )
    placed = build_posed_bones(knee, assembly)
    return placed, place_cysts(knee, assembly, placed), assembly


def find_centre(solid):
    """Return the centre of a bounding box in mm."""
    return np.array(solid.bounding_box()).reshape(2, 3).mean(axis=0)


@pytest.mark.parametrize("site", SITES)
def test_a_cyst_has_its_size_and_is_inside_trabecular_bone(site):
    sides, bone = site.split("_"), site.split("_")[1]
    locations = [(15.0, 0.0, 0.5), (1.5, 1.0, 1.0), (8.0, -1.0, 0.0), (8.0, 1.0, 1.0)]
    placed, _, assembly = place_bones_and_cysts(Knee(), Posture())
    for diameter_mm, place, outward in locations:
        knee = Knee(cysts=(Cyst(site=site, diameter_mm=diameter_mm, place=place, outward=outward),))
        ((one,),) = place_cysts(knee, assembly, placed).values()
        for solid, radius in ((one.contents, diameter_mm / 2), (one.wall, diameter_mm / 2 + WALL_MM)):
            assert_allclose(solid.volume(), 4 / 3 * np.pi * radius**3, rtol=0.01)
        assert (one.wall - placed[bone].inner).volume() == 0
        assert (one.contents - one.wall).volume() == 0
        assert (find_centre(one.wall)[0] > 0) == (sides[0] == "medial")


@pytest.mark.parametrize("site", SITES)
def test_an_anterior_cyst_is_nearer_to_the_patella_than_a_posterior_one(site):
    placed, _, assembly = place_bones_and_cysts(Knee(), Posture())
    patella = find_centre(placed["patella"].outer)
    far_mm = []
    for place in (-1.0, 0.0, 1.0):
        knee = Knee(cysts=(Cyst(site=site, diameter_mm=2.0, place=place),))
        ((cyst,),) = place_cysts(knee, assembly, placed).values()
        far_mm.append(abs(find_centre(cyst.wall) - patella)[1])
    assert far_mm[0] + 2 < far_mm[1] < far_mm[2] - 2


def test_cysts_do_not_overlap_and_keep_their_location_in_every_posture():
    bent, straight = (
        place_bones_and_cysts(WORN, posture) for posture in (pssf.load_protocol("fixed_flexion").posture, Posture())
    )
    locations = [
        [
            f[:, :3].T @ (find_centre(one.wall) - f[:, 3])
            for bone in cysts
            for f in [frames[bone]]
            for one in cysts[bone]
        ]
        for _, cysts, at in (bent, straight)
        for frames in [{"tibia": at.pose.tibia_transform(), "femur": at.pose.femur_transform()}]
    ]
    assert len(locations[0]) == len(WORN.cysts)
    assert_allclose(*locations, atol=0.02)
    walls = [one.wall for of_bone in bent[1].values() for one in of_bone]
    assert all((a ^ b).volume() == 0 for a, b in itertools.combinations(walls, 2))


def test_a_knee_with_cysts_has_no_faults_and_masks_within_bone():
    protocol = pssf.load_protocol("fixed_flexion")
    small = dataclasses.replace(protocol, rows=360, cols=360, pixel_mm=protocol.pixel_mm * protocol.rows / 360)
    built = pssf.build(WORN, protocol)
    assert str(pssf.check(built.scene)) == "no faults"
    radiograph = pssf.simulate(built, small, keep=("masks",))
    for site in ("medial_tibia", "lateral_femur"):
        mask = radiograph.truth.masks[f"{site}_cyst"]
        bone = radiograph.truth.masks[site.split("_")[1]]
        assert mask.sum() > 0
        assert not (mask & ~bone).any()
    names = [surface.name for surface in built.scene.surfaces if "cyst" in surface.name]
    assert names == ["femur_cyst_1_wall", "femur_cyst_1", "tibia_cyst_1_wall", "tibia_cyst_1", "tibia_cyst_2_wall",
                     "tibia_cyst_2"]  # fmt: skip


def test_invalid_cysts_are_rejected():
    with pytest.raises(InputError, match=r"diameter_mm must be .*, got 20"):
        Cyst(site="medial_tibia", diameter_mm=20.0)
    with pytest.raises(InputError, match="cysts at medial_tibia must differ by at least"):
        Knee(cysts=(Cyst(site="medial_tibia", diameter_mm=2.0), Cyst(site="medial_tibia", diameter_mm=3.0)))
    locations = list(itertools.product(SITES, (-0.6, 0.0)))
    many = tuple(Cyst(site=site, diameter_mm=2.0, place=at) for site, at in locations[:7])
    with pytest.raises(InputError, match=r"number of cysts must be .*, got 7"):
        Knee(cysts=many)


def test_a_knee_with_cysts_survives_conversion_to_a_dictionary():
    assert knee_from_dict(knee_to_dict(WORN)) == WORN


def test_sampled_cysts_occur_in_high_grades_on_the_narrower_side():
    sampled = {
        grade: [
            pssf.sample_knee(grade=grade, rng=np.random.default_rng((9, grade, k)), grade_table="population")
            for k in range(300)
        ]
        for grade in (0, 2, 3, 4)
    }
    fraction = {grade: np.mean([bool(knee.cysts) for knee in knees]) for grade, knees in sampled.items()}
    assert fraction[0] == fraction[2] == 0
    # Tolerances are four standard errors of a fraction of 300 knees.
    assert abs(fraction[3] - 0.15) < 0.085
    assert abs(fraction[4] - 0.35) < 0.11
    cysts = [(knee, one) for knees in sampled.values() for knee in knees for one in knee.cysts]
    on_narrower_side = [
        one.site.startswith("medial" if knee.jsw_medial_mm < knee.jsw_lateral_mm else "lateral") for knee, one in cysts
    ]
    assert abs(np.mean(on_narrower_side) - 0.85) < 0.11
    assert all(2.0 <= one.diameter_mm <= 8.0 for _, one in cysts)
