"""Check regions of interest, bone masks and features of a region."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from block_phantom import PIXEL_MM, TEMPLATE, make_phantom
from conftest import append_byte
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal
from scipy.ndimage import gaussian_filter

from pssf.core.checks import InputError
from pssf.core.processes.execution import Execution
from pssf.data.analysis.ibsi_table import load_ibsi_tags
from pssf.radiomics.features.bone_mask import segment_bone
from pssf.radiomics.features.feature_extraction import extract_features
from pssf.radiomics.features.feature_families import feature_family
from pssf.radiomics.features.feature_table import (
    ExtractionSettings,
    MeasurementJob,
    hash_settings,
    measure_radiograph,
    measure_radiographs,
)
from pssf.radiomics.localisation.region_of_interest import cut_region
from pssf.radiomics.localisation.templates import Template
from pssf.radiomics.radiomics_tables import radiomics_tables

TAGS, TABLES = load_ibsi_tags(), radiomics_tables()


def make_texture(size: int, seed: int, smooth: float = 1.5):
    """Make a random texture (size, size) of uint16 with values below 65535 / 3."""
    field = gaussian_filter(np.random.default_rng(seed).standard_normal((size, size)), smooth)
    return np.rint(8000 + 2000 * field / field.std()).clip(1, 20000).astype(np.uint16)


@given(row=st.floats(8, 24), col=st.floats(8, 24))
def test_a_region_is_centred_and_does_not_wrap_around_image_borders(row, col):
    image = np.arange(32 * 32).reshape(32, 32)
    region = cut_region(image, row, col, 16)
    assert region.shape == (16, 16)
    assert region[8, 8] == image[round(row), round(col)]
    with pytest.raises(InputError, match="must fit into the image"):
        cut_region(image, 7.4, col, 16)


def test_the_bone_mask_covers_bone_and_excludes_joint_space():
    image = make_phantom(160, 160)
    mask = segment_bone(image[96:224, 96:224], PIXEL_MM)
    rows, cols = np.mgrid[-64:64, -64:64] * PIXEL_MM
    # Checked areas: inside femur and tibia, in the joint space, and in the thinner limb medial to the bone.
    assert mask[(np.abs(rows) > 6) & (np.abs(cols + 2) < 10)].mean() > 0.99
    assert mask[(np.abs(rows) < 1.5) & (np.abs(cols) < 12)].mean() < 0.01
    assert mask[:, cols[0] > 20].mean() < 0.01


def test_a_region_of_constant_grey_value_has_features():
    found = extract_features(np.full((32, 32), 500, np.uint16), PIXEL_MM, TAGS)
    assert found["firstorder_linear_Mean"] == 500


def test_a_padded_mask_of_ones_gives_the_features_of_pyradiomics():
    pytest.importorskip("radiomics", reason="no pyradiomics")
    import SimpleITK as sitk  # noqa: N813
    from radiomics.featureextractor import RadiomicsFeatureExtractor

    region = make_texture(48, 1)
    extractor = RadiomicsFeatureExtractor(force2D=True, force2Ddimension=0, binCount=64, additionalInfo=False)

    def make_volumes(pad: int):
        image = sitk.GetImageFromArray(np.pad(region, pad, mode="edge")[None])
        mask = sitk.GetImageFromArray(np.pad(np.ones(region.shape, np.uint8), pad)[None])
        for volume in (image, mask):
            volume.SetSpacing((0.15, 0.15, 1.0))
        return image, mask

    with pytest.raises(ValueError, match="No labels found"):
        extractor.execute(*make_volumes(0))
    theirs = {
        name.removeprefix("original_"): float(value) for name, value in extractor.execute(*make_volumes(1)).items()
    }
    ours = extract_features(region, 0.15, TAGS)
    compared = 0
    for name, value in ours.items():
        if feature_family(name) != "shape2D" and not name.startswith("firstorder_z"):
            assert_allclose(value, theirs[name.replace("_linear", "")], rtol=1e-12, err_msg=name)
            compared += 1
    assert compared == 18 + 24 + 16 + 16 + 5 + 14


@settings(max_examples=8)
@given(gain=st.integers(1, 3), offset=st.integers(0, 5000), seed=st.integers(0, 100))
def test_gain_and_offset_do_not_change_texture_and_z_scored_features(gain, offset, seed):
    region = make_texture(40, seed)
    plain, changed = (
        extract_features(region, 0.15, TAGS),
        extract_features((gain * region + offset).astype(np.uint16), 0.15, TAGS),
    )
    for name, value in plain.items():
        if feature_family(name) != "shape2D" and not name.startswith("firstorder_linear"):
            assert_allclose(changed[name], value, rtol=1e-9, atol=1e-12, err_msg=name)
    assert_allclose(changed["firstorder_linear_Mean"], gain * plain["firstorder_linear_Mean"] + offset)


def test_grey_values_that_are_not_integers_raise_an_error():
    with pytest.raises(InputError, match="integer type"):
        extract_features(np.ones((16, 16)), 0.15, TAGS)


def test_pyradiomics_prints_nothing(capfd):
    extract_features(make_texture(32, 0), 0.15, TAGS)
    assert capfd.readouterr() == ("", "")


def load_phantom(file: str):
    """Make a noisy phantom from `row,col,seed`; a module function, so that it can be pickled."""
    row, col, seed = map(int, file.split(","))
    return make_phantom(row, col, noise=1.0, seed=seed)


def make_jobs(count: int) -> list[MeasurementJob]:
    files = [f"{150 + 3 * i},{160 + 2 * i},{i}" for i in range(count)]
    return [
        MeasurementJob(radiograph=f"r{i}", file=f, sha256=f"sha{i}", side="right", pixel_mm=0.5)
        for i, f in enumerate(files)
    ]


def test_features_are_the_same_for_one_worker_and_two():
    measure = partial(
        measure_radiographs,
        make_jobs(4),
        load_pixels=load_phantom,
        templates=[TEMPLATE],
        tables=TABLES,
        settings=ExtractionSettings(region_px=96),
    )
    (one, _), (two, _) = measure(), measure(execution=Execution(workers=2))
    assert [record["radiograph"] for record in two] == ["r0", "r1", "r2", "r3"]
    assert one == two


def test_measured_records_are_reused_until_the_settings_change():
    loaded: list[str] = []

    def load(file: str):
        loaded.append(file)
        return load_phantom(file)

    saved: list[list[dict]] = []
    first, _ = measure_radiographs(
        make_jobs(3)[:2],
        load_pixels=load,
        templates=[TEMPLATE],
        tables=TABLES,
        settings=ExtractionSettings(region_px=96),
        save=saved.append,
    )
    assert saved[-1] == first
    known = {record["sha256"]: record for record in first}
    loaded.clear()
    again, _ = measure_radiographs(
        make_jobs(3),
        load_pixels=load,
        templates=[TEMPLATE],
        tables=TABLES,
        settings=ExtractionSettings(region_px=96),
        known_records=known,
    )
    assert loaded == [make_jobs(3)[2].file]
    assert again[:2] == first
    loaded.clear()
    measure_radiographs(
        make_jobs(2),
        load_pixels=load,
        templates=[TEMPLATE],
        tables=TABLES,
        settings=ExtractionSettings(region_px=96, bins=32),
        known_records=known,
    )
    assert len(loaded) == 2


@pytest.mark.parametrize("name", ["row_px", "status", "glcm_Contrast"])
def test_a_modified_feature_record_is_measured_again(name):
    measure = partial(
        measure_radiographs,
        make_jobs(2),
        load_pixels=load_phantom,
        templates=[TEMPLATE],
        tables=TABLES,
        settings=ExtractionSettings(region_px=96),
    )
    first, _ = measure()
    changed = {**first[0], name: "low score" if name == "status" else np.nextafter(first[0][name], np.inf)}
    again, _ = measure(known_records={"sha0": changed, "sha1": first[1]})
    assert again == first


def test_the_settings_key_changes_with_the_template():
    other = Template(pixels=TEMPLATE.pixels + 1, row=160, col=180, pixel_mm=PIXEL_MM)
    assert hash_settings([TEMPLATE], ExtractionSettings()) != hash_settings([other], ExtractionSettings())
    assert hash_settings([TEMPLATE], ExtractionSettings()) == hash_settings([TEMPLATE], ExtractionSettings())


@pytest.mark.parametrize(
    "name",
    [
        "radiomics/features/mirp_backend.py",
        "radiomics/features/feature_families.py",
        "core/processes/worker_processes.py",
        "io/radiograph_files.py",
    ],
)
def test_the_settings_key_changes_with_the_code(copied_code, name):
    before = hash_settings([TEMPLATE], ExtractionSettings())
    append_byte(copied_code / name)
    assert hash_settings([TEMPLATE], ExtractionSettings()) != before


def test_a_worker_with_other_code_raises_an_error():
    with pytest.raises(InputError, match=r"code of pssf on .* must be .*, got other code \(radiomics\)"):
        measure_radiograph(
            make_jobs(1)[0],
            load_pixels=load_phantom,
            templates=[TEMPLATE],
            tables=TABLES,
            settings=ExtractionSettings(),
            code={"radiomics": "0"},
        )


def test_a_rejected_match_has_a_location_but_no_features():
    (record,), _ = measure_radiographs(
        make_jobs(1),
        load_pixels=load_phantom,
        templates=[TEMPLATE],
        tables=TABLES,
        settings=ExtractionSettings(region_px=400),
    )
    assert record["status"] == "leaves image"
    assert abs(record["row_px"] - 150) < 2
    assert not any(name.startswith("glcm") for name in record)


def test_a_region_of_the_truth_is_measured_at_its_place():
    job = replace(make_jobs(1)[0], place_px=(140.0, 155.0))
    how = ExtractionSettings(region_px=100, regions="truth", families=("firstorder",))
    (record,), _ = measure_radiographs(
        [job], load_pixels=load_phantom, templates=[TEMPLATE], tables=TABLES, settings=how
    )
    assert (record["status"], record["row_px"], record["col_px"]) == ("found", 140.0, 155.0)
    region = cut_region(load_phantom(job.file), 140.0, 155.0, 100)
    expected = extract_features(region, PIXEL_MM, TAGS, how.bins, how.families, how.backend)
    assert {name: record[name] for name in expected} == expected


def test_z_scored_first_order_features_have_mean_0_and_variance_1():
    found = extract_features(make_texture(40, 3), 0.15, TAGS)
    assert_allclose([found["firstorder_z_Mean"], found["firstorder_z_Variance"]], [0, 1], atol=1e-12)
    assert_array_equal(np.isfinite(list(found.values())), True)
