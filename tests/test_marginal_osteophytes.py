"""Check that marginal osteophytes are broad, have the specified location and protrude by the specified size."""

import numpy as np
import pytest

import pssf
from pssf.anatomy.bones import bone_shells, osteophyte_growth
from pssf.anatomy.meshing.solids import extract_mesh
from pssf.anatomy.template.bone_builder import deform_template_points, resolve_bone_parameters
from pssf.data.anatomy.anatomy_tables import load_anatomy_tables

TABLES = load_anatomy_tables()
SHAPE = TABLES.template
BUILD = resolve_bone_parameters(pssf.Knee(shape=(1.0, -1.5, 2.0, 0.5, -1.0)), TABLES)
BONES = {
    "femur": (bone_shells.grow_femur_osteophytes, BUILD.template_femur, BUILD.femur, SHAPE.osteophytes.femur.band_z),
    "tibia": (bone_shells.grow_tibia_osteophytes, BUILD.template_tibia, BUILD.tibia, SHAPE.osteophytes.tibia.band_z),
}
MARGINS = ("medial_femur", "lateral_femur", "medial_tibia", "lateral_tibia")


def grow_osteophyte(site: str, size_mm: float, **where: float):
    """Grow an osteophyte; return the grown bone, the bone shape, and margin vertices of the bone without osteophyte."""
    grow, mean, form, band = BONES[site.split("_")[1]]
    points = extract_mesh(mean.outer).vertices
    points = points[(points[:, 2] >= band[0]) & (points[:, 2] <= band[1])]
    return grow(BUILD, (pssf.Osteophyte(site=site, size_mm=size_mm, **where),)), form, points


@pytest.mark.parametrize("site", MARGINS)
@pytest.mark.parametrize(
    ("size_mm", "place", "curve_deg"), [(0.4, 0.0, 0.0), (4.0, 0.0, 45.0), (4.0, -0.7, -30.0), (10.0, 0.4, 20.0)]
)
def test_an_osteophyte_protrudes_from_the_margin_by_its_size(site, size_mm, place, curve_deg):
    grown, form, margin = grow_osteophyte(site, size_mm, place=place, curve_deg=curve_deg)
    (shape,) = grown.shapes
    outwards = shape.axes[1]
    bare = (deform_template_points(margin, form) @ outwards).max()
    assert (deform_template_points(shape.farthest_point[None], form) @ outwards)[0] - bare == pytest.approx(
        size_mm, abs=1e-8
    )
    points = extract_mesh(grown.outer).vertices
    about = deform_template_points(points[np.linalg.norm(points - shape.farthest_point, axis=1) < 3.0], form) @ outwards
    assert about.max() - bare == pytest.approx(size_mm, abs=1e-4 if size_mm > 1 else 0.1)


@pytest.mark.parametrize("site", MARGINS)
def test_an_osteophyte_is_broad_along_the_margin_and_at_its_base(site):
    grown, _, _ = grow_osteophyte(site, 4.0)
    (shape,) = grown.shapes
    mean = BONES[site.split("_")[1]][1]
    points = extract_mesh(grown.outer).vertices
    added = points[shape.is_near(points) & (mean.field(points) > 0.5)]
    along, _, up = ((added - shape.origin) @ shape.axes.T).T
    assert 14 < np.ptp(along) < 30
    assert 6 < np.ptp(up) < 15


@pytest.mark.parametrize("site", ["lateral_tibia", "medial_tibia"])
def test_a_tibial_osteophyte_above_the_joint_surface_rises_from_it(site):
    grown, _, _ = grow_osteophyte(site, 2.0)
    (shape,) = grown.shapes
    mean = BONES["tibia"][1]
    points = extract_mesh(grown.outer).vertices
    points = points[shape.is_near(points)]
    along, out, up = shape._convert_to_local(points)
    inwards = (out < -shape.long_mm - 1.5) & (up > -shape.tip_above_foot_mm - 1.0) & (np.abs(along) < 3.0)
    assert inwards.sum() > 3
    assert shape.tip_above_foot_mm > 0.9
    assert mean.field(points[inwards]).max() < 0.2 * shape.tip_above_foot_mm


@pytest.mark.parametrize("site", MARGINS)
def test_osteophytes_lengthen_with_size_and_curve_towards_the_joint(site):
    small, large = (grow_osteophyte(site, size)[0].shapes[0] for size in (2.0, 8.0))
    assert large.half_length_mm > small.half_length_mm + 3
    flat, bent = (grow_osteophyte(site, 4.0, curve_deg=curve)[0].shapes[0] for curve in (0.0, 40.0))
    towards = 1.0 if site.endswith("tibia") else -1.0
    assert towards * (bent.farthest_point - flat.farthest_point)[2] > 1.0


def test_osteophyte_interior_joins_trabecular_bone_inside_the_cortex():
    osteophyte = pssf.Osteophyte(site="medial_tibia", size_mm=6.0)
    grown = bone_shells.grow_tibia_osteophytes(BUILD, (osteophyte,))
    bone = bone_shells.build_tibia(BUILD, grown, bone_shells.compute_cortex_depths_mm(BUILD)[1])
    assert len(bone.inner.decompose()) == 1
    assert (bone.inner - bone.outer).volume() < 1e-6
    reach = [extract_mesh(solid).vertices[:, 0].max() for solid in (bone.outer, bone.inner)]
    assert 0.5 < reach[0] - reach[1] < 1.8


def test_an_osteophyte_that_covers_the_tip_of_another_raises_an_error():
    small, large = (grow_osteophyte("medial_femur", size)[0].shapes[0] for size in (1.0, 6.0))
    osteophyte = pssf.Osteophyte(site="medial_femur", size_mm=1.0)
    with pytest.raises(pssf.InputError, match=r"must not hide the farthest point of another osteophyte, .*: make them"):
        osteophyte_growth._require_tips_not_hidden((osteophyte,), [small, large], "femur")


def test_two_osteophytes_on_the_same_margin_have_a_common_mask():
    osteophytes = tuple(pssf.Osteophyte(site="medial_tibia", size_mm=2.0, place=place) for place in (-0.8, 0.5))
    meshes = pssf.build(pssf.Knee(osteophytes=osteophytes)).osteophyte_meshes()
    assert set(meshes) == {"medial_tibia"}
    positions_mm = meshes["medial_tibia"].vertices[:, 1]
    assert positions_mm.min() < -10
    assert positions_mm.max() > 10


@pytest.mark.parametrize(("side", "inwards"), [("medial", -1), ("lateral", 1)])
def test_a_spine_osteophyte_is_a_ridge_leaning_towards_the_other_spine(side, inwards):
    grow, mean, form, _ = BONES["tibia"]
    bare = extract_mesh(mean.outer).vertices
    bare = bare[bare[:, 0] * inwards < -1]
    top = bare[deform_template_points(bare, form)[:, 2].argmax()]
    grown = extract_mesh(grow(BUILD, (pssf.Osteophyte(site=f"{side}_spine", size_mm=2.0),)).outer).vertices
    ridge = grown[(grown[:, 2] > top[2] + 0.5) & (grown[:, 0] * inwards < 0)]
    assert np.ptp(ridge[:, 1]) > 5
    assert 1 < ((ridge.mean(axis=0) - top)[0]) * inwards < 2


def test_a_spine_ridge_protrudes_by_its_size_on_a_deformed_bone():
    build = resolve_bone_parameters(
        pssf.Knee(shape=(-1.9, 0.0, 2.6, 2.5, -2.9, 1.0, -1.0, -2.2, -2.2, 1.8, 2.8, 0.1)), TABLES
    )
    grown = bone_shells.grow_tibia_osteophytes(
        build, (pssf.Osteophyte(site="medial_spine", size_mm=2.0 * build.scale),)
    ).outer
    sides = (extract_mesh(solid).vertices for solid in (build.template_tibia.outer, grown))
    bare, tall = (deform_template_points(side[side[:, 0] > 1], build.tibia)[:, 2].max() for side in sides)
    assert tall - bare == pytest.approx(2.0, abs=1e-4)
