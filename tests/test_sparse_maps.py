"""Check sparse maps of path lengths: the same values as dense arrays with less memory."""

import dataclasses
import tracemalloc

import numpy as np
import pytest

import pssf
from pssf.raycast import trace_sparse
from pssf.raycast.engines.projected_surface import BAND_ROWS
from pssf.raycast.engines.sparse_map import SparseMap
from pssf.stages import LatentImage, StageContext, run_stages
from pssf.xray.resolved_technique import resolve_technique

SMALL = {"rows": 75, "cols": 90, "pixel_mm": 3.4}


def make_protocol(name="reference", **changes):
    return dataclasses.replace(pssf.load_protocol(name), **{**SMALL, **changes})


@pytest.fixture(scope="module")
def built():
    return pssf.build(pssf.Knee(), make_protocol())


@pytest.mark.parametrize("engine", ["embree", "scanline"])
def test_sparse_maps_contain_the_path_lengths_of_trace(built, engine):
    paths = pssf.trace(built.scene, make_protocol(), engine=engine)
    strips, audit = trace_sparse(built.scene, make_protocol(), engine=engine)
    assert audit == paths.audit
    assert list(strips) == list(paths.path_mm)
    for name, lengths in paths.path_mm.items():
        assert (np.asarray(strips[name]) == lengths).all()
        assert (strips[name][20:71] == lengths[20:71]).all()
        assert (strips[name].max(), strips[name].min()) == (lengths.max(), lengths.min())


@pytest.mark.parametrize(
    "changes",
    [
        {},
        {"grid_ratio": 8.0},
        {"focal_spot": "sampled", "focal_spot_mm": 1.2, "grid_ratio": 8.0},
        {"noise": "none", "detector_blur": "none", "focal_spot_mm": 0.0},
        {"scatter": "none", "marker": "R"},
        {"texture": "none", "rows": 64, "cols": 64, "pixel_mm": 0.15},
    ],
    ids=lambda changes: ", ".join(changes) or "reference",
)
def test_a_radiograph_from_sparse_maps_has_identical_pixels(built, changes):
    technique = make_protocol(**changes)
    whole = pssf.simulate(
        built, technique, rng=3, engine="scanline", paths=pssf.trace(built.scene, technique, engine="scanline")
    )
    assert (pssf.simulate(built, technique, rng=3, engine="scanline").pixels == whole.pixels).all()


def test_a_sparse_map_returns_the_array_that_was_written():
    rng = np.random.default_rng(0)
    values = rng.random((2 * BAND_ROWS + 5, 40), np.float32)
    values[:, :7] = 0
    values[BAND_ROWS : 2 * BAND_ROWS] = 0
    strips = SparseMap(values.shape)
    for first in range(0, len(values), BAND_ROWS):
        strips[first : min(first + BAND_ROWS, len(values))] = values[first : first + BAND_ROWS]
    for start, stop in ((0, len(values)), (3, 50), (BAND_ROWS, BAND_ROWS), (2 * BAND_ROWS + 1, len(values))):
        assert (strips[start:stop] == values[start:stop]).all()
    assert (strips.min(), strips.max()) == (0.0, values.max())
    strips[0:BAND_ROWS] = np.full((BAND_ROWS, 40), np.nan, np.float32)
    assert np.isnan(strips.min())
    strips[0:BAND_ROWS] = np.zeros((BAND_ROWS, 40), np.float32)
    assert not np.asarray(strips)[:BAND_ROWS].any()


def test_the_minimum_of_a_full_map_is_not_zero():
    strips = SparseMap((BAND_ROWS, 4))
    strips[0:BAND_ROWS] = np.full((BAND_ROWS, 4), 2.0)
    assert (strips.min(), strips.max()) == (2.0, 2.0)


@pytest.mark.parametrize("keep", [(), ("primary", "scatter")])
def test_an_exposed_image_stores_only_the_requested_images(built, keep):
    technique = resolve_technique(make_protocol(grid_ratio=8.0))
    path_mm, _ = trace_sparse(built.scene, technique.protocol)
    image = LatentImage(path_mm=path_mm, scene=built.scene)
    run_stages(image, StageContext(technique=technique, keep=frozenset(keep)))
    assert (image.path_mm, image.primary, image.scatter, image.frequencies) == ({}, None, None, None)
    assert set(image.kept) == set(keep)


def test_a_large_detector_needs_memory_for_fewer_than_eight_maps(built):
    technique = make_protocol(rows=1536, cols=1536, pixel_mm=0.2)
    # A first simulation fills the caches, whose memory is not measured.
    pssf.simulate(built, technique, rng=1)
    tracemalloc.start()
    pssf.simulate(built, technique, rng=1)
    most = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    # Memory is expressed in float32 maps; dense arrays of all path lengths would need 17 maps.
    assert most / (4 * 1536**2) < 8
