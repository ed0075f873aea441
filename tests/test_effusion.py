"""Check that an effusion swells the limb and displaces fat but keeps bones and joint spaces."""

import itertools

import numpy as np
import pytest
from scipy.stats import mannwhitneyu

from pssf import (
    InputError,
    Knee,
    build,
    load_protocol,
    sample_knee,
)
from pssf.anatomy.soft_tissue.joint_tissues import _add_effusion_cover
from pssf.data.anatomy.anatomy_tables import load_anatomy_tables

REFERENCE = load_protocol("reference")
TABLE = load_anatomy_tables().template.effusion


@pytest.fixture(scope="module")
def dry_and_swollen():
    """Build a knee without and with an effusion of 6 mm."""
    return build(Knee()), build(Knee(effusion_mm=6.0))


def get_surface(built, name):
    return next(one for one in built.scene.surfaces if one.name == name)


def measure_extent(built, name, z_mm):
    """Return the minimum and maximum x and y of a surface near a height."""
    points = get_surface(built, name).mesh.vertices
    near = points[np.abs(points[:, 2] - z_mm) < 12.0]
    return near[:, :2].min(axis=0), near[:, :2].max(axis=0)


def test_an_effusion_does_not_change_bones_or_joint_spaces(dry_and_swollen):
    dry, _ = dry_and_swollen
    names = [one.name for one in dry.scene.surfaces if one.inside in ("cortical_bone", "trabecular_bone", "marrow")]
    assert len(names) >= 6
    for name in names:
        assert np.array_equal(*(get_surface(built, name).mesh.vertices for built in dry_and_swollen))
    truths = [one.truth(one.aim_beam(REFERENCE)) for one in dry_and_swollen]
    spaces = [(truth.jsw_medial_mm, truth.jsw_lateral_mm) for truth in truths]
    np.testing.assert_allclose(spaces[1], spaces[0], rtol=0, atol=1e-9)


def test_the_limb_swells_anteriorly_posteriorly_and_medially_at_the_joint(dry_and_swollen):
    # The limb is thick enough for the patella; a limb that is widened to contain its bones would swell less.
    wide_limbs = [build(Knee(limb_ap_mm=128.0, effusion_mm=effusion_mm)) for effusion_mm in (0.0, 6.0)]
    (low, high), (low_swollen, high_swollen) = (measure_extent(built, "muscle", 0.0) for built in wide_limbs)
    more = np.concatenate([low - low_swollen, high_swollen - high])
    # Order: lateral, anterior, medial, posterior. The limb without effusion may be up to 1 mm wider at prominent bones.
    by = 6.0 * np.array([0.0, TABLE.front_and_back, TABLE.medial, TABLE.front_and_back])
    np.testing.assert_allclose(more, by, rtol=0, atol=1.0)
    far, far_swollen = (measure_extent(built, "muscle", -120.0) for built in dry_and_swollen)
    np.testing.assert_allclose(far_swollen, far, rtol=0, atol=0.2)


def test_an_effusion_displaces_intermuscular_fat(dry_and_swollen):
    def measure_fat_mm3(built):
        mesh = get_surface(built, "intermuscular_fat").mesh
        corners = mesh.vertices[mesh.faces]
        volumes = np.einsum("ij,ij->i", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])) / 6
        return volumes.sum()

    dry, swollen = (measure_fat_mm3(built) for built in dry_and_swollen)
    assert 0.5 * dry < swollen < 0.95 * dry


def test_an_effusion_thickens_the_cover_only_within_the_joint_capsule():
    cover = load_anatomy_tables().template.deep_fat.cover
    assert _add_effusion_cover(cover, TABLE.height_profile, 0.0) is cover
    usual, thick = np.array(sorted(cover)).T, np.array(_add_effusion_cover(cover, TABLE.height_profile, 5.0)).T
    heights = np.linspace(-60, 110, 171)
    more = np.interp(heights, *thick) - np.interp(heights, *usual)
    np.testing.assert_allclose(more, 5.0 * np.interp(heights, *np.array(TABLE.height_profile).T), rtol=0, atol=1e-12)
    assert more[heights == 0] == pytest.approx(5.0)
    np.testing.assert_allclose(more[np.abs(heights - 25) > 66], 0.0, rtol=0, atol=1e-12)


def test_an_effusion_of_10_mm_can_be_built_and_more_is_rejected():
    build(
        sample_knee(
            grade=4,
            rng=np.random.default_rng(5),
            grade_table="population",
            effusion_mm=10.0,
            fat_mm=2.0,
            limb_ap_mm=90.0,
        )
    )
    with pytest.raises(InputError, match=r"effusion_mm must be .*, got 10\.5"):
        Knee(effusion_mm=10.5)


def test_effusion_rises_with_grade_but_does_not_separate_adjacent_grades():
    def sample_effusion_mm(grade, seed, **options):
        return sample_knee(grade=grade, rng=np.random.default_rng(seed), **options).effusion_mm

    by_grade = [
        np.array([sample_effusion_mm(grade, seed, grade_table="population") for seed in range(200)])
        for grade in range(5)
    ]
    assert np.all(np.diff([swollen.mean() for swollen in by_grade]) > 0)
    # The margin is three standard errors of an AUC from 200 knees per grade.
    error = 3 * np.sqrt(1 / (6 * 200))
    for less, more in itertools.pairwise(by_grade):
        assert mannwhitneyu(more, less).statistic / 200**2 < 0.75 + error
    assert sample_effusion_mm(2, 0, grade_table="paper") == 0.0
