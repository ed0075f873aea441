"""Test features of regions of the tibia, on linear and on displayed radiographs."""

from dataclasses import replace

import numpy as np
import pytest
from block_phantom import TEMPLATE
from scipy import ndimage
from test_texture_regions import PLACES

from pssf.core.checks import InputError
from pssf.data.analysis.ibsi_table import load_ibsi_tags
from pssf.radiomics import displayed_radiograph
from pssf.radiomics.displayed_radiograph import DisplayExtractionSettings, measure_display
from pssf.radiomics.features.area_features import require_resolved_texture, resample_around_plateau
from pssf.radiomics.features.feature_families import feature_family, name_in_area, split_area
from pssf.radiomics.features.feature_table import ExtractionSettings, MeasurementJob, measure_radiograph
from pssf.radiomics.features.ibsi_tags import find_ibsi_tag
from pssf.radiomics.localisation.region_placement import locate_joint_at
from pssf.radiomics.radiomics_tables import radiomics_tables
from pssf.study import StudySettings
from pssf.texture import make_texture_region, measure_texture_features

MM, SHAPE = 0.2, (500, 600)
LANDMARKS = {name: (row / MM, col / MM) for name, (row, col) in PLACES.items()}
TABLES = radiomics_tables()
SETTINGS = {"region_px": 64, "families": ("glcm", "vot"), "areas": ("square", "medial_subchondral")}


def make_pixels(seed=1, shape=SHAPE):
    texture = ndimage.gaussian_filter(np.random.default_rng(seed).normal(size=shape), 1.5)
    return np.rint(20000 + 3000 * texture / texture.std()).astype(np.uint16)


def measure(pixels, settings=SETTINGS, landmarks=LANDMARKS, side="right"):
    job = MeasurementJob(
        radiograph="one",
        file="one",
        sha256="0",
        side=side,
        pixel_mm=MM,
        place_px=(180.0, 400.0),
        landmarks_px=landmarks,
    )
    record, _ = measure_radiograph(
        job,
        load_pixels=lambda name: pixels,
        templates=[TEMPLATE],
        settings=ExtractionSettings(regions="truth", **settings),
        tables=TABLES,
        code={},
    )
    return record


def test_an_area_has_the_features_of_its_mask():
    pixels = make_pixels()
    record = measure(pixels)
    mask = make_texture_region("medial_subchondral", LANDMARKS, pixels, side="right", pixel_mm=MM)
    expected = measure_texture_features(pixels, pixel_mm=MM, mask=mask, families=["vot"])
    assert expected == {name: record[name_in_area(name, "medial_subchondral")] for name in expected}
    square = measure(pixels, SETTINGS | {"areas": ("square",)})
    assert {name: record[name] for name in square} == square
    alone = measure(pixels, SETTINGS | {"areas": ("medial_subchondral",)})
    features = {name for name in record if feature_family(name) in ("glcm", "vot")}
    assert {name for name in alone if feature_family(name) in ("glcm", "vot")} == {
        name for name in features if split_area(name)[1] == "medial_subchondral"
    }
    assert alone.items() <= record.items()


def test_a_feature_name_contains_its_area():
    name = name_in_area("glcm_Contrast", "medial_subchondral")
    assert name == "glcm_Contrast@medial_subchondral"
    assert split_area(name) == ("glcm_Contrast", "medial_subchondral")
    assert split_area("glcm_Contrast") == ("glcm_Contrast", "square")
    assert name_in_area("glcm_Contrast", "square") == "glcm_Contrast"
    assert feature_family(name) == "glcm"
    tags = load_ibsi_tags()
    assert find_ibsi_tag(name, tags) == find_ibsi_tag("glcm_Contrast", tags) != ""


def test_a_radiograph_whose_area_leaves_the_image_has_no_features():
    record = measure(make_pixels(shape=(240, 600)))
    assert record["status"] == "leaves image"
    assert not [name for name in record if name.startswith(("glcm", "vot"))]


def test_a_region_without_texture_has_a_status_and_no_features():
    flat = np.full(SHAPE, 20000, np.uint16)
    for areas in (("square",), ("medial_subchondral",)):
        record = measure(flat, SETTINGS | {"families": ("vot",), "areas": areas})
        assert record["status"] == "no texture"
        assert not [name for name in record if name.startswith("vot")]


def test_a_left_knee_has_the_features_of_its_mirror_image():
    pixels = ndimage.gaussian_filter(make_pixels(4).astype(float), (0.0, 2.0)).astype(np.uint16)
    right = measure(pixels, SETTINGS | {"areas": ("medial_subchondral",)})
    mirrored = {name: (row, SHAPE[1] - 1 - col) for name, (row, col) in LANDMARKS.items()}
    left = measure(pixels[:, ::-1], SETTINGS | {"areas": ("medial_subchondral",)}, mirrored, side="left")
    names = [name for name in right if name.startswith("vot")]
    # The border of the region may take other pixels.
    assert [left[name] for name in names] == pytest.approx([right[name] for name in names], abs=0.02)


def test_resampling_does_not_hide_large_pixels():
    joint = locate_joint_at((180.0, 400.0), SHAPE, side="right", pixel_mm=0.6, region_px=1)
    how = DisplayExtractionSettings(pixel_mm=MM, **SETTINGS | {"areas": ("square",)})
    record = displayed_radiograph._extract(make_pixels(), joint, how, TABLES, make_pixels(), np.asarray)
    assert record == {"status": "coarse pixels"}


def test_a_square_that_is_not_measured_may_leave_the_image():
    record = measure(make_pixels(), SETTINGS | {"region_px": 450})
    assert record["status"] == "leaves image"
    record = measure(make_pixels(), SETTINGS | {"region_px": 450, "areas": ("medial_subchondral",)})
    assert record["status"] == "found"
    assert "vot_MeanDimension@medial_subchondral" in record


def test_areas_need_landmarks_and_small_pixels():
    with pytest.raises(InputError, match="areas other than square need landmarks"):
        measure(make_pixels(), landmarks=None)
    with pytest.raises(InputError, match="areas must be square if regions is template, got epiphysis"):
        StudySettings(areas=("epiphysis",))
    with pytest.raises(InputError, match=r"pixel_mm must be at most 0\.2 mm for the families vot, got 0\.3 mm"):
        require_resolved_texture(0.3, ("glcm", "vot"))
    require_resolved_texture(0.3, ("glcm",))


def test_resampling_moves_landmarks_with_the_image():
    rows, cols = np.indices(SHAPE).astype(float)
    joint = replace(
        locate_joint_at((180.0, 400.0), SHAPE, side="right", pixel_mm=MM, region_px=1), landmarks_px=LANDMARKS
    )
    for ratio in (0.75, 1.0, 2.0):
        for values, axis in ((rows, 0), (cols, 1)):
            resampled, moved = resample_around_plateau(values, joint, ratio * MM)
            for name, at in moved.landmarks_px.items():
                row, col = (round(place) for place in at)
                # Linear grey values are kept by the resampling; half a new pixel remains from rounding.
                assert resampled[row, col] == pytest.approx(LANDMARKS[name][axis], abs=ratio / 2 + 1e-6)


def test_a_displayed_radiograph_has_the_areas_of_the_linear_one(monkeypatch):
    pixels = make_pixels(2)
    linear = measure(pixels, SETTINGS | {"families": ("vot", "hot")})
    fine = ndimage.zoom(pixels.astype(float), 4 / 3, order=3, grid_mode=False, mode="nearest")
    scale = (np.array(fine.shape) - 1) / (np.array(SHAPE) - 1)

    class Film:
        pixels = 1.0 - fine / 65535.0
        pixel_mm, side = MM / scale[0], "right"

    landmarks = {name: tuple(np.array(at) * scale) for name, at in LANDMARKS.items()}
    joint = locate_joint_at(
        (180.0 * scale[0], 400.0 * scale[1]), fine.shape, side="right", pixel_mm=MM / scale[0], region_px=1
    )
    monkeypatch.setattr(
        displayed_radiograph, "locate_joint_by_reader", lambda *args, **options: replace(joint, landmarks_px=landmarks)
    )
    how = DisplayExtractionSettings(pixel_mm=MM, regions="reader", **SETTINGS | {"families": ("vot", "hot")})
    job = MeasurementJob(radiograph="one", file="one", sha256="0", side="right", pixel_mm=None)
    record, _ = measure_display(
        job, load_pixels=lambda name: Film, templates=[TEMPLATE], settings=how, tables=TABLES, code={}
    )
    assert record["status"] == "found"
    # The grey values follow the histogram of the template, which changes the dimension a little.
    for name in ("vot_MeanDimension", "vot_HorizontalDimension", "hot_VerticalDimension"):
        assert record[f"{name}@medial_subchondral"] == pytest.approx(linear[f"{name}@medial_subchondral"], abs=0.12)
