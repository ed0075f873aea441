"""Check skin folds: skin and fat are indented equally outside the fascia, and other tissues do not change."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pssf import (
    InputError,
    Knee,
    build,
    load_protocol,
    sample_knee,
)
from pssf.anatomy.meshing.solids import make_column_rings
from pssf.anatomy.soft_tissue.skin_folds import add_skin_folds
from pssf.data.anatomy.anatomy_tables import load_anatomy_tables
from pssf.raycast import trace

FOLDS = load_anatomy_tables().template.soft.folds
HEIGHTS_MM = np.linspace(-200.0, 200.0, 38)
FAT_MM, SKIN_MM = 12.0, 1.6


def make_rings(wider_mm):
    sections = np.array([[-206.0, 50.0, 55.0, 10.0, 0.0], [0.0, 48.0, 58.0, 6.0, 2.0], [206.0, 70.0, 74.0, 2.0, 3.0]])
    return make_column_rings(sections + np.array([0.0, wider_mm, wider_mm, 0.0, 0.0]), HEIGHTS_MM, 2.25, 64)


def find_surface(built, name):
    return next(one.mesh for one in built.scene.surfaces if one.name == name)


@settings(max_examples=25, deadline=None)
@given(depth=st.floats(0.01, 0.85), seed=st.integers(0, 2**32), scale=st.floats(0.85, 1.15))
def test_skin_folds_indent_skin_and_fat_equally_outside_the_fascia(depth, seed, scale):
    skin, fat = add_skin_folds(
        make_rings(FAT_MM + SKIN_MM), make_rings(FAT_MM), make_rings(0.0), FOLDS, depth, scale, seed
    )
    heights_mm = skin[:, 0, 2]
    assert (np.diff(heights_mm) > 0).all()
    assert np.isin(HEIGHTS_MM, heights_mm).all()
    assert np.array_equal(fat[..., 2], skin[..., 2])

    def interpolate(rings):
        columns = rings.reshape(len(rings), -1)
        interpolated = [np.interp(heights_mm, HEIGHTS_MM, column) for column in columns.T]
        return np.column_stack(interpolated).reshape(-1, *rings.shape[1:])

    fascia, unfolded = interpolate(make_rings(0.0)), interpolate(make_rings(FAT_MM))
    np.testing.assert_allclose(skin - fat, interpolate(make_rings(FAT_MM + SKIN_MM)) - unfolded, rtol=0, atol=1e-9)
    left = np.linalg.norm(fat - fascia, axis=-1) / np.linalg.norm(unfolded - fascia, axis=-1)
    assert left.min() >= 1 - depth - 1e-9
    assert left.max() <= 1 + 1e-9
    assert left.min() < 1 - 0.01 * depth
    # Far from all folds the outline is unchanged.
    far = np.abs(heights_mm) > 110.0
    np.testing.assert_allclose(left[far], 1.0, rtol=0, atol=1e-9)


def test_skin_folds_change_only_skin_and_fat():
    plain, deep = build(Knee(bmi=36.0)), build(Knee(bmi=36.0, skin_folds=0.85))
    for one in plain.scene.surfaces:
        same = np.array_equal(one.mesh.vertices, find_surface(deep, one.name).vertices)
        assert same == (one.name not in ("skin", "adipose")), one.name
    lost = [find_surface(plain, name).volume - find_surface(deep, name).volume for name in ("skin", "adipose")]
    assert 100.0 < lost[1] < 10_000.0
    assert lost[0] == pytest.approx(lost[1], rel=0.15)


def test_path_lengths_through_skin_folds_are_not_negative():
    protocol = replace(load_protocol("fixed_flexion"), rows=256, cols=256, pixel_mm=1.2)
    traced = [
        trace(built.scene, built.aim_beam(protocol))
        for built in (build(Knee(bmi=38.0, fat_mm=24.0, skin_folds=depth)) for depth in (0.0, 0.85))
    ]
    assert min(path.min() for one in traced for path in one.path_mm.values()) >= 0.0
    thinner = traced[0].path_mm["adipose"] - traced[1].path_mm["adipose"]
    assert thinner.max() > 4.0
    assert np.median(np.abs(thinner)) < 0.05


def test_fold_depth_depends_on_bmi_and_is_zero_in_the_paper_grade_table():
    def sample_folds(bmi, grade_table="population"):
        streams = (np.random.default_rng(seed) for seed in range(40))
        return np.array([sample_knee(grade=1, rng=rng, grade_table=grade_table, bmi=bmi).skin_folds for rng in streams])

    assert not sample_folds(21.0).any()
    assert not sample_folds(38.0, "paper").any()
    assert sample_folds(30.0).max() <= 0.4
    assert sample_folds(38.0).max() <= 0.72
    assert sample_folds(38.0).mean() == pytest.approx(0.36, abs=3 * 0.72 / np.sqrt(12 * 40))


def test_skin_folds_as_deep_as_the_subcutaneous_fat_raise_an_error():
    with pytest.raises(InputError, match=r"skin_folds must be .*, got 1"):
        Knee(skin_folds=1.0)
