"""Check that a body inside bone of varying density must specify the same density field."""

import dataclasses

import numpy as np
import pytest
import trimesh
from numpy.testing import assert_allclose

import pssf


def add_cube(built, **densities):
    """Add a titanium cube to the trabecular bone of the tibia of a built knee."""
    cube = trimesh.creation.box((6, 6, 6)).apply_translation((20, 0, -25))
    return pssf.Scene([*built.scene.surfaces, pssf.Surface(cube, "Ti@4.51", "trabecular_bone", "screw", **densities)])


def get_density(built, name):
    return next(surface.inside_density for surface in built.scene.surfaces if surface.name == name)


@pytest.fixture(scope="module")
def coarse():
    return pssf.load_protocol("reference").resample(96)


def test_a_body_without_the_surrounding_density_is_rejected(built, coarse):
    scene = add_cube(built)
    report = pssf.check(scene, coarse)
    assert not report.ok
    assert "screw: outside_density must be the density of the trabecular_bone around it" in str(report)
    for use in (pssf.trace, pssf.simulate):
        with pytest.raises(pssf.InputError, match=r"screw: outside_density must be .*, got None.*built\.insert"):
            use(scene, coarse, engine="scanline")


def test_a_body_with_the_surrounding_density_replaces_that_bone(built, coarse):
    density = get_density(built, "tibia_trabecular")
    scene = add_cube(built, outside_density=density)
    assert str(pssf.check(scene, coarse)) == "no faults"
    paths = [pssf.trace(one, coarse, engine="scanline", precision="float64") for one in (scene, built.scene)]
    bone = paths[1].path_mm["trabecular_bone"] - paths[0].path_mm["trabecular_bone"]
    metal = paths[0].path_mm["Ti@4.51"]
    assert metal.max() > 5
    # Bone path lengths contain the relative density, which is not 1 everywhere.
    assert (np.abs(bone - metal)[metal > 1] > 0.01).any()
    assert_allclose(bone[metal == 0], 0, atol=1e-9)


def test_check_reports_a_body_with_the_density_of_another_bone(built, coarse):
    scene = add_cube(built, outside_density=get_density(built, "femur_trabecular"))
    report = str(pssf.check(scene, coarse))
    assert (
        "screw: outside is trabecular_bone, but rays find trabecular_bone of another density (tibia_trabecular)"
        in report
    )


def test_no_density_is_required_without_texture(built, coarse):
    smooth = dataclasses.replace(coarse, texture="none")
    assert str(pssf.check(add_cube(built), smooth)) == "no faults"
    pssf.trace(add_cube(built), smooth, engine="scanline")


def test_equal_density_fields_are_treated_as_the_same_density(coarse):
    waves = [pssf.PlaneWaves(mean=0.5, amplitudes=(0.1,), waves_per_mm=((1.0, 0.0, 0.0),), phases=(0.0,)) for _ in "ab"]
    outer, inner = (trimesh.creation.box(3 * [side]) for side in (60, 20))
    scene = pssf.Scene([
        pssf.Surface(outer, "muscle", "air", "outer", inside_density=waves[0]),
        pssf.Surface(inner, "Ti@4.51", "muscle", "inner", outside_density=waves[1]),
    ])  # fmt: skip
    assert str(pssf.check(scene, coarse)) == "no faults"
    pssf.trace(scene, coarse, engine="scanline")


def test_a_density_that_differs_from_the_surrounding_one_is_rejected(coarse):
    outer, inner = (trimesh.creation.box(3 * [side]) for side in (60, 20))
    scene = pssf.Scene([
        pssf.Surface(outer, "muscle", "air", "outer"),
        pssf.Surface(inner, "Ti@4.51", "muscle", "inner", outside_density=pssf.PlaneWaves(mean=0.5)),
    ])  # fmt: skip
    with pytest.raises(pssf.InputError, match=r"inner: outside_density must be .* \(inside outer\), got another"):
        pssf.trace(scene, coarse, engine="scanline")
