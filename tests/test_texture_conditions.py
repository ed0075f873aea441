"""Test the comparison of texture measures between acquisitions."""

from dataclasses import asdict

import numpy as np
import pytest

from pssf.anatomy.trabeculae.strut_lattice import make_strut_lattice
from pssf.data.anatomy.trabecular_table import load_trabecular_bone
from pssf.study.statistics.features.icc_by_subject import sample_knee_weights
from pssf.validation.study_methods import texture_conditions as conditions
from pssf.validation.study_methods import texture_ranking, texture_structure


def test_equal_measurements_agree_and_shifted_ones_do_not():
    values = np.random.default_rng(1).normal(2.5, 0.1, 200)
    weights = sample_knee_weights(np.arange(200), replicates=500, seed=0)
    same = conditions._compare_pairs(np.stack((values, values), axis=1), weights)
    assert same == pytest.approx(
        {"r": 1.0, "icc": 1.0, "icc_low": 1.0, "icc_high": 1.0, "shift_sd": 0.0, "cv_percent": 0.0}
    )
    shifted = conditions._compare_pairs(np.stack((values, values + 0.2), axis=1), weights)
    spread = values.std(ddof=1)
    assert shifted["r"] == pytest.approx(1.0)
    assert shifted["shift_sd"] == pytest.approx(0.2 / spread)
    # Absolute agreement: between / (between + squared shift / 2) for noiseless pairs.
    assert shifted["icc"] == pytest.approx(spread**2 / (spread**2 + 0.2**2 / 2), rel=0.02)
    assert shifted["icc_low"] < shifted["icc"] < shifted["icc_high"]
    assert shifted["cv_percent"] == pytest.approx(100 * 0.2 / np.sqrt(2) / (values.mean() + 0.1))


def test_each_condition_differs_from_the_reference_in_one_respect():
    _, reference = conditions._sample_case(3)
    listed = conditions._list_conditions(reference, 3)
    changed = {
        name: {field for field, value in asdict(one).items() if value != asdict(reference)[field]}
        for name, one in listed.items()
    }
    assert changed.pop("noise") == set()
    assert len(changed.pop("repeat")) > 5
    assert changed.pop("pixel_0.2") == {"pixel_mm", "rows", "cols"}
    assert all(len(fields) == 1 for fields in changed.values()), changed
    assert listed["magnification"].sdd_mm / listed["magnification"].sod_mm == pytest.approx(
        reference.sdd_mm / reference.sod_mm / 0.91
    )


@pytest.mark.parametrize(
    ("noise", "verdict"), [(0.2, "holds"), (5.0, "does not hold"), (1.0, "not decidable")], ids=lambda value: str(value)
)
def test_the_ranking_is_decided_by_the_agreement_of_the_variance_orientation_transform(noise, verdict):
    rng = np.random.default_rng(3)
    knees = rng.normal(size=60)
    pairs = {
        method: np.stack((knees, knees + rng.normal(0, sd, 60)), axis=1)
        for method, sd in (("fractal_signature", 1.0), ("hot", 1.0), ("vot", noise))
    }
    row = texture_ranking._rank_methods(pairs, sample_knee_weights(np.arange(60), replicates=500, seed=0))
    assert row["verdict"] == verdict
    assert row["margin_low"] <= row["margin"] <= row["margin_high"]


def test_a_magnified_lattice_has_the_same_voxels():
    lattice = load_trabecular_bone().lattice
    block, unit = make_strut_lattice(5, lattice)
    # A power of two magnifies without rounding.
    magnified = texture_structure._magnify_lattice(lattice, 2.0)
    assert magnified.voxel_mm == tuple(2 * length for length in lattice.voxel_mm)
    other, other_unit = make_strut_lattice(5, magnified)
    # The cut-off of a power that is normalised in single precision may move a voxel by one level of 255.
    assert np.abs(block.astype(int) - other).max() <= 1
    assert other_unit == pytest.approx(unit, rel=1e-4)


def test_points_of_the_structure_design_cover_the_bounds():
    factors = texture_structure._FACTORS
    ends = texture_structure._scale_points(np.array([[0.0] * len(factors), [1.0] * len(factors)]))
    assert ends[0] == pytest.approx([one.low for one in factors.values()])
    assert ends[1] == pytest.approx([one.high for one in factors.values()])


def test_the_structure_of_a_knee_changes_all_its_bones_and_nothing_else():
    built, _ = texture_structure._build_knee()
    middle = dict(
        zip(texture_structure._FACTORS, texture_structure._scale_points(np.full((1, 10), 0.5))[0], strict=True)
    )
    assert set(texture_structure._find_densities(built.scene)) == {"femur", "tibia", "fibula", "patella"}
    tibia = texture_structure._find_densities(built.scene)["tibia"]
    thin, dense = (
        texture_structure._alter_trabeculae(
            built, "tibia", tibia, {**middle, "density": density}, load_trabecular_bone()
        )
        for density in (0.7, 1.3)
    )
    assert thin.lattice_table == dense.lattice_table
    assert thin.knee_to_bone == tibia.knee_to_bone
    assert dense.density_parameters.per_bvtv / thin.density_parameters.per_bvtv == pytest.approx(1.3 / 0.7)
