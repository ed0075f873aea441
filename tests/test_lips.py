"""Lips: osteophytes of the margins are broad, lie where they are put and stand out by their size."""

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
OF_BONE = {
    "femur": (bone_shells.grow_femur_osteophytes, BUILD.template_femur, BUILD.femur, SHAPE.osteophytes.femur.band_z),
    "tibia": (bone_shells.grow_tibia_osteophytes, BUILD.template_tibia, BUILD.tibia, SHAPE.osteophytes.tibia.band_z),
}
MARGINS = ("medial_femur", "lateral_femur", "medial_tibia", "lateral_tibia")


def lip(site: str, size_mm: float, **where: float):
    """A lip on its bone, that bone's form, and vertices of the bare margin."""
    grow, mean, form, band = OF_BONE[site.split("_")[1]]
    points = extract_mesh(mean.outer).vertices
    points = points[(points[:, 2] >= band[0]) & (points[:, 2] <= band[1])]
    return grow(BUILD, (pssf.Osteophyte(site=site, size_mm=size_mm, **where),)), form, points


@pytest.mark.parametrize("site", MARGINS)
@pytest.mark.parametrize(
    ("size_mm", "place", "curve_deg"), [(0.4, 0.0, 0.0), (4.0, 0.0, 45.0), (4.0, -0.7, -30.0), (10.0, 0.4, 20.0)]
)
def test_a_lip_stands_out_of_the_deformed_margin_by_its_size_wherever_it_is(site, size_mm, place, curve_deg):
    grown, form, margin = lip(site, size_mm, place=place, curve_deg=curve_deg)
    (shape,) = grown.shapes
    way = shape.axes[1]
    bare = (deform_template_points(margin, form) @ way).max()
    assert (deform_template_points(shape.farthest_point[None], form) @ way)[0] - bare == pytest.approx(
        size_mm, abs=1e-8
    )
    points = extract_mesh(grown.outer).vertices
    about = deform_template_points(points[np.linalg.norm(points - shape.farthest_point, axis=1) < 3.0], form) @ way
    assert about.max() - bare == pytest.approx(size_mm, abs=1e-4 if size_mm > 1 else 0.1)


@pytest.mark.parametrize("site", MARGINS)
def test_a_lip_is_broad_along_the_margin_and_at_its_base(site):
    grown, _, _ = lip(site, 4.0)
    (shape,) = grown.shapes
    mean = OF_BONE[site.split("_")[1]][1]
    points = extract_mesh(grown.outer).vertices
    added = points[shape.is_near(points) & (mean.field(points) > 0.5)]
    along, _, up = ((added - shape.origin) @ shape.axes.T).T
    assert 14 < np.ptp(along) < 30
    assert 6 < np.ptp(up) < 15


@pytest.mark.parametrize("site", ["lateral_tibia", "medial_tibia"])
def test_a_lip_that_stands_above_the_joint_surface_rises_from_it(site):
    grown, _, _ = lip(site, 2.0)
    (shape,) = grown.shapes
    mean = OF_BONE["tibia"][1]
    points = extract_mesh(grown.outer).vertices
    points = points[shape.is_near(points)]
    along, out, up = shape._convert_to_local(points)
    inwards = (out < -shape.long_mm - 1.5) & (up > -shape.tip_above_foot_mm - 1.0) & (np.abs(along) < 3.0)
    assert inwards.sum() > 3
    assert shape.tip_above_foot_mm > 0.9
    assert mean.field(points[inwards]).max() < 0.2 * shape.tip_above_foot_mm


@pytest.mark.parametrize("site", MARGINS)
def test_a_larger_lip_is_longer_and_one_that_curves_ends_nearer_to_the_joint(site):
    small, large = (lip(site, size)[0].shapes[0] for size in (2.0, 8.0))
    assert large.half_length_mm > small.half_length_mm + 3
    flat, bent = (lip(site, 4.0, curve_deg=curve)[0].shapes[0] for curve in (0.0, 40.0))
    towards = 1.0 if site.endswith("tibia") else -1.0
    assert towards * (bent.farthest_point - flat.farthest_point)[2] > 1.0


def test_the_filling_of_a_lip_is_one_with_the_spongy_bone_and_within_a_cortex():
    osteophyte = pssf.Osteophyte(site="medial_tibia", size_mm=6.0)
    grown = bone_shells.grow_tibia_osteophytes(BUILD, (osteophyte,))
    bone = bone_shells.build_tibia(BUILD, grown, bone_shells.compute_cortex_depths_mm(BUILD)[1])
    assert len(bone.inner.decompose()) == 1
    assert (bone.inner - bone.outer).volume() < 1e-6
    reach = [extract_mesh(solid).vertices[:, 0].max() for solid in (bone.outer, bone.inner)]
    assert 0.5 < reach[0] - reach[1] < 1.8


def test_one_lip_that_hides_the_end_of_another_is_refused():
    small, large = (lip("medial_femur", size)[0].shapes[0] for size in (1.0, 6.0))
    osteophyte = pssf.Osteophyte(site="medial_femur", size_mm=1.0)
    with pytest.raises(pssf.InputError, match=r"must not hide the farthest point of another one, .*: make them"):
        osteophyte_growth._require_tips_not_hidden((osteophyte,), [small, large], "femur")


def test_two_lips_of_one_margin_are_one_mask():
    lips = tuple(pssf.Osteophyte(site="medial_tibia", size_mm=2.0, place=place) for place in (-0.8, 0.5))
    meshes = pssf.build(pssf.Knee(osteophytes=lips)).osteophyte_meshes()
    assert set(meshes) == {"medial_tibia"}
    places = meshes["medial_tibia"].vertices[:, 1]
    assert places.min() < -10
    assert places.max() > 10


@pytest.mark.parametrize(("side", "inwards"), [("medial", -1), ("lateral", 1)])
def test_a_spine_grows_into_a_ridge_that_leans_towards_the_other(side, inwards):
    grow, mean, form, _ = OF_BONE["tibia"]
    bare = extract_mesh(mean.outer).vertices
    bare = bare[bare[:, 0] * inwards < -1]
    top = bare[deform_template_points(bare, form)[:, 2].argmax()]
    grown = extract_mesh(grow(BUILD, (pssf.Osteophyte(site=f"{side}_spine", size_mm=2.0),)).outer).vertices
    ridge = grown[(grown[:, 2] > top[2] + 0.5) & (grown[:, 0] * inwards < 0)]
    assert np.ptp(ridge[:, 1]) > 5
    assert 1 < ((ridge.mean(axis=0) - top)[0]) * inwards < 2


def test_a_ridge_stands_out_by_its_size_where_a_form_turns_its_crest_up():
    build = resolve_bone_parameters(
        pssf.Knee(shape=(-1.9, 0.0, 2.6, 2.5, -2.9, 1.0, -1.0, -2.2, -2.2, 1.8, 2.8, 0.1)), TABLES
    )
    grown = bone_shells.grow_tibia_osteophytes(
        build, (pssf.Osteophyte(site="medial_spine", size_mm=2.0 * build.scale),)
    ).outer
    sides = (extract_mesh(solid).vertices for solid in (build.template_tibia.outer, grown))
    bare, tall = (deform_template_points(side[side[:, 0] > 1], build.tibia)[:, 2].max() for side in sides)
    assert tall - bare == pytest.approx(2.0, abs=1e-4)
