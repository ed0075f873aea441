"""Compare the segmented bone of a region with the projected bone of the simulation."""

from dataclasses import replace
from functools import reduce

import numpy as np
import pytest
from block_phantom import PIXEL_MM, make_phantom
from scipy.ndimage import gaussian_filter

from pssf import load_protocol, sample_knee, simulate
from pssf.radiomics.features.bone_mask import segment_bone
from pssf.radiomics.features.mask_overlap import compute_mask_overlap
from pssf.radiomics.features.shape2d import measure_shape
from pssf.radiomics.localisation.region_of_interest import cut_region

PITCH_MM, REGION_PX = 0.45, 170


def simulate_region_and_bone(protocol: str, grade: int):
    """Return the region around the medial joint line of a sampled knee and the projected bone in it."""
    knee = sample_knee(grade=grade, rng=57 + grade, grade_table="population")
    wide = replace(load_protocol(protocol), rows=680, cols=680, pixel_mm=PITCH_MM)
    radiograph = simulate(knee, wide, engine="scanline", keep=("masks",), seed=3)
    assert radiograph.truth is not None
    row, col = radiograph.truth.medial_joint_line_px
    bone = reduce(np.logical_or, radiograph.truth.masks.values())
    return tuple(cut_region(of, row, col, REGION_PX) for of in (radiograph.pixels, bone))


@pytest.mark.parametrize(("protocol", "grade"), [("reference", 0), ("fixed_flexion", 2), ("ap_standing", 4)])
def test_the_bone_mask_agrees_with_the_projected_bones(protocol, grade):
    region, bone = simulate_region_and_bone(protocol, grade)
    agreement = compute_mask_overlap(segment_bone(region, PITCH_MM), bone, PITCH_MM)
    assert agreement["dice"] > 0.95
    assert 0.90 < agreement["area"] < 1.05
    # Otsu's threshold alone fills the joint space: the contours would differ by 3 to 10 mm.
    assert agreement["mean_mm"] < 2.5


def test_a_soft_tissue_gradient_does_not_move_the_bone_mask():
    image = make_phantom(160, 160)[96:224, 96:224].astype(float)
    # The gradient increases the signal 3.6-fold across the region.
    gradient = np.exp(0.01 * np.arange(128))
    plain, steep = (
        segment_bone(np.rint(of).astype(np.uint16), PIXEL_MM) for of in (image, image * gradient / gradient.max())
    )
    assert compute_mask_overlap(steep, plain, PIXEL_MM)["dice"] > 0.98


def test_the_bone_mask_does_not_depend_on_gain_or_low_dose_noise():
    image = make_phantom(160, 160)[96:224, 96:224]
    plain = segment_bone(image, PIXEL_MM)
    assert compute_mask_overlap(segment_bone(image * np.uint16(2), PIXEL_MM), plain, PIXEL_MM)["dice"] > 0.999
    noisy = make_phantom(160, 160, noise=4.0, seed=1)[96:224, 96:224]
    assert compute_mask_overlap(segment_bone(noisy, PIXEL_MM), plain, PIXEL_MM)["dice"] > 0.97


@pytest.mark.parametrize("size", [4, 16, 24])
def test_a_very_small_region_has_a_bone_mask(size):
    noise = np.random.default_rng(size).standard_normal((size, size))
    region = np.rint(1000 + 100 * gaussian_filter(noise, 1.0)).astype(np.uint16)
    mask = segment_bone(region, 0.5)
    assert mask.shape == region.shape
    assert mask.any()


def test_the_perimeter_of_the_bone_mask_is_stable_under_noise():
    perimeters = [
        measure_shape(segment_bone(make_phantom(160, 160, noise=4.0, seed=seed)[96:224, 96:224], PIXEL_MM), PIXEL_MM)[
            "Perimeter"
        ]
        for seed in range(4)
    ]
    assert np.ptp(perimeters) < 0.05 * np.mean(perimeters)
