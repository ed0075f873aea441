"""Several rays per pixel: covered area at an edge, uniform parts, automatic choice, and the MTF."""

import dataclasses

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal

import pssf

# The plate is at the detector, so that a pixel covers 0.2 mm of it.
EDGE = dataclasses.replace(
    pssf.load_protocol("reference"),
    rows=48, cols=64, pixel_mm=0.2, mono_kev=20.0, mas=1.0, sdd_mm=1000.0, sod_mm=999.9, focal_spot_mm=0.0,
    scatter="none", noise="none", detector_blur="none", detector="ideal",
)  # fmt: skip


def make_plate(angle_deg, across_mm=0.0):
    """Make a scene with an opaque plate that covers one side of a line through the centre of the image."""
    plate = trimesh.creation.box((60, 0.1, 200))
    plate.apply_translation((30 + across_mm, 0, 0))
    plate.apply_transform(trimesh.transformations.rotation_matrix(np.deg2rad(angle_deg), (0, 1, 0)))
    return pssf.Scene([pssf.Surface(plate, "Pb@30", "air", "plate")], size_mm=(0, 1e6))


def compute_covered_area(angle_deg, across_mm):
    """Compute the covered fraction of each pixel by sampling, to 0.003."""
    fine = (np.arange(200) + 0.5) / 200 - 0.5
    rows, cols = np.mgrid[: EDGE.rows, : EDGE.cols]
    x = (cols - (EDGE.cols - 1) / 2)[..., None, None] + fine
    z = ((EDGE.rows - 1) / 2 - rows)[..., None, None] - fine[:, None]
    angle = np.deg2rad(angle_deg)
    return np.mean((x * np.cos(angle) - z * np.sin(angle)) * EDGE.pixel_mm > across_mm, axis=(2, 3))


def take_primary(scene, subpixels, **changes):
    """Return the primary of a scene relative to its largest value."""
    protocol = dataclasses.replace(EDGE, subpixels=subpixels, **changes)
    kev = pssf.simulate(scene, protocol, engine="scanline", keep=("primary",)).kept["primary"]
    return kev.astype(np.float64) / kev.max()


@settings(max_examples=8, deadline=None)
@given(angle_deg=st.floats(-60, 60), across_mm=st.floats(-0.3, 0.3), subpixels=st.sampled_from([2, 5]))
def test_a_partly_covered_pixel_has_a_signal_between_those_of_both_sides(angle_deg, across_mm, subpixels):
    signal, covered = (
        take_primary(make_plate(angle_deg, across_mm), subpixels),
        compute_covered_area(angle_deg, across_mm),
    )
    # The rule of n x n squares has an error of at most about half a row of squares.
    assert np.abs(1 - signal - covered).max() < 0.55 / subpixels
    part = (covered > 0.01) & (covered < 0.99)
    assert ((signal[part] > 1e-3) & (signal[part] < 0.999)).all()


def test_more_rays_do_not_change_uniform_parts_and_field_factors():
    scene = pssf.Scene([pssf.Surface(trimesh.creation.box((900, 20, 900)), "muscle", "air", "slab")])
    changes = {"field_width_mm": 8.0, "field_height_mm": 6.0, "sod_mm": 900.0, "detector": "csi"}
    one, many = (take_primary(scene, subpixels, **changes) for subpixels in (1, 3))
    assert_allclose(many, one, rtol=2e-5)


def test_a_sampled_focal_spot_can_be_combined_with_subpixels():
    changes = {"focal_spot": "sampled", "focal_spot_mm": 1.0, "sod_mm": 900.0}
    one, many = (take_primary(make_plate(90.0), subpixels, **changes) for subpixels in (1, 4))
    # Both approximate the penumbra of 0.11 mm, which is narrower than a pixel, but only one averages over the pixel.
    assert len(np.unique(many.round(3))) > len(np.unique(one.round(3)))
    assert_allclose(many.mean(), one.mean(), atol=0.01)


def test_the_automatic_choice_takes_one_ray_unless_the_scene_has_edges():
    slab = pssf.Scene([pssf.Surface(trimesh.creation.box((900, 20, 900)), "muscle", "air", "slab")])
    assert_array_equal(take_primary(slab, 0), take_primary(slab, 1))
    assert_array_equal(take_primary(make_plate(5.0), 0), take_primary(make_plate(5.0), 5))


@pytest.mark.parametrize("across_mm", [0.0, 0.05, 0.1])
def test_the_automatic_choice_does_not_miss_a_wire_between_pixel_centres(across_mm):
    wire = trimesh.creation.cylinder(0.02, 30.0, sections=24).apply_translation((across_mm, 0, 0))
    # A thick body of the same surface, outside the field, does not hide the wire.
    block = trimesh.creation.box((30, 30, 30)).apply_translation((200, 0, 0))
    both = trimesh.util.concatenate([wire, block])
    scene = pssf.Scene([pssf.Surface(both, "Pb@11.35", "air", "wire")], size_mm=(0, 1e6))
    lost = 1 - take_primary(scene, 0)[24]
    # The wire absorbs 0.92 of the energy on its width, which is a fifth of a pixel; the rays are 0.3 diameters apart.
    assert 0.15 < lost.sum() < 0.22
    assert lost.max() < 0.25


def test_the_mtf_is_that_of_the_detector_with_one_and_with_many_rays():
    """The pixel aperture, which the MTF of a detector includes, is not applied twice."""
    angle = np.deg2rad(3.0)
    protocol = {"detector_blur": "mtf", "detector": "csi", "rows": 256, "cols": 256}
    cols = np.arange(256) - 127.5
    rows = 127.5 - np.arange(256)
    distance = (cols * np.cos(angle) - rows[:, None] * np.sin(angle)).ravel()
    spread = []
    for subpixels in (1, 5):
        radiograph = pssf.simulate(
            make_plate(3.0), dataclasses.replace(EDGE, subpixels=subpixels, mas=0.5, **protocol), engine="scanline"
        )
        pixels = radiograph.pixels.astype(np.float64).ravel()
        place = np.floor((distance + 20) * 8).astype(int)
        inside = (place >= 0) & (place < 320)
        edge = np.bincount(place[inside], pixels[inside], 320) / np.bincount(place[inside], minlength=320)
        spread.append(np.abs(np.fft.rfft(np.diff(edge) * np.hanning(319)))[:20])
    one, many = (curve / curve[0] for curve in spread)
    frequency = np.arange(20) / (319 / 8)  # cycles per pixel, up to 0.48
    assert_allclose(many[frequency < 0.4], one[frequency < 0.4], atol=0.03)


def test_given_paths_are_refused_with_subpixels():
    scene = make_plate(5.0)
    paths = pssf.trace(scene, EDGE)
    with pytest.raises(pssf.InputError, match=r"subpixels must be 1 with paths, got 2"):
        pssf.simulate(scene, dataclasses.replace(EDGE, subpixels=2), paths=paths)
