"""Check the solids of cartilage and other joint tissues."""

import numpy as np
import pytest
from manifold3d import Manifold

import pssf
from pssf.anatomy.soft_tissue.joint_tissues import _subtract_bones


def make_box(side_mm, x_mm=0.0):
    return Manifold.cube((side_mm,) * 3, center=True).translate((x_mm, 0.0, 0.0))


def test_subtracting_bones_preserves_a_piece_enclosed_by_bone():
    shell = make_box(6.0, 20.0) - make_box(2.0, 20.0)
    near, far = _subtract_bones([make_box(10.0), make_box(10.0, 20.0)], [shell])
    assert near.volume() == pytest.approx(1000)
    assert far.volume() == pytest.approx(1000 - 6**3 + 2**3)


def test_cartilage_in_a_tight_crease_does_not_overlap_itself():
    """Build the knee (1 of 2,000 of `pssf validate --tables builds`) that once had a cartilage path of -0.037 mm."""
    rng = np.random.default_rng(np.random.SeedSequence(1533, spawn_key=(1,)))
    built = pssf.build(
        pssf.sample_knee(grade=3, rng=rng, grade_table="population"), pssf.load_protocol("fixed_flexion")
    )
    layers = [
        pssf.Surface(surface.mesh_arrays, inside="cartilage", outside="air", name=surface.name)
        for surface in built.scene.surfaces
        if surface.name in ("femur_cartilage", "tibia_cartilage")
    ]
    paths = pssf.trace(pssf.Scene(layers), pssf.load_protocol("fixed_flexion"), engine="scanline", precision="float64")
    assert paths.path_mm["cartilage"].min() >= 0
    assert paths.path_mm["cartilage"].max() > 1
