"""Finding the joint, and features of a region."""

from functools import partial

import numpy as np
import pytest
import SimpleITK as sitk  # noqa: N813
from conftest import change
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal
from radiomics.featureextractor import RadiomicsFeatureExtractor
from scipy.ndimage import gaussian_filter

from pssf.core.checks import InputError
from pssf.core.execution import Execution
from pssf.radiomics.bone import bone_mask
from pssf.radiomics.families import family
from pssf.radiomics.features import extract
from pssf.radiomics.region import Template, cut_region, find_joint
from pssf.radiomics.table import How, Job, extract_all, measure, settings_key

PIXEL_MM = 0.5
SHAPE = (320, 320)


def phantom(row, col, side="right", scale=1.0, noise=0.0, seed=0, tibia_mm=2.5):
    """(320, 320) uint16: two blocks of bone, the medial one's gap at (row, col), in a limb with air beside it.

    The femur begins 2.5 mm above that row, the tibia `tibia_mm` below.
    """
    rows, cols = np.mgrid[: SHAPE[0], : SHAPE[1]].astype(float)
    medial = (cols - col) * (1 if side == "right" else -1) * PIXEL_MM / scale  # mm, 0 in the medial gap
    up = (row - rows) * PIXEL_MM / scale
    limb = np.clip(1 - ((medial + 20) / 62) ** 2, 0, None)
    width = 17 - 0.12 * np.abs(up)
    bone = (np.abs(medial + 20) < 20 + width) & (np.abs(up) > np.where(up > 0, 2.5, tibia_mm) + 0.08 * np.abs(medial))
    notch = (np.abs(medial + 20) < 7) & (up > 0) & (up < 16)
    fibula = (np.abs(medial + 58) < 6) & (up < -12)
    path = 2.2 * limb + 0.7 * gaussian_filter((bone & ~notch).astype(float), 0.8) + 0.4 * fibula
    signal = 30000 * np.exp(-path)
    signal += noise * np.sqrt(signal) * np.random.default_rng(seed).standard_normal(SHAPE)
    return np.clip(np.rint(signal), 1, 65535).astype(np.uint16)


def texture(size: int, seed: int, smooth: float = 1.5):
    """(size, size) uint16 with every value far below 65535 / 3."""
    field = gaussian_filter(np.random.default_rng(seed).standard_normal((size, size)), smooth)
    return np.rint(8000 + 2000 * field / field.std()).clip(1, 20000).astype(np.uint16)


TEMPLATE = Template(pixels=phantom(160, 180), row=160, col=180, pixel_mm=PIXEL_MM)


@settings(max_examples=12)
@given(
    row=st.integers(130, 190),
    col=st.integers(150, 175),
    side=st.sampled_from(["right", "left"]),
    noise=st.sampled_from([0.0, 1.0]),
)
def test_a_shifted_joint_is_found_to_within_a_pixel_on_either_side(row, col, side, noise):
    joint = find_joint(phantom(row, col, side, noise=noise), [TEMPLATE], side=side, pixel_mm=PIXEL_MM, region_px=64)
    assert joint.status == "found"
    assert abs(joint.row - row) < 1
    assert abs(joint.col - col) < 1


@pytest.mark.parametrize("scale", [0.85, 1.1])
def test_a_larger_or_smaller_knee_is_found(scale):
    joint = find_joint(phantom(150, 170, scale=scale), [TEMPLATE], side="right", pixel_mm=PIXEL_MM, region_px=64)
    assert np.hypot(joint.row - 150, joint.col - 170) < 3
    assert abs(joint.scale - scale) < 0.06


def test_the_middle_of_a_narrow_joint_space_is_found_by_the_template_of_one():
    tibia_mm = 0.0
    narrow = phantom(160, 180, tibia_mm=tibia_mm)
    middle = 160 + (tibia_mm - 2.5) / 2 / PIXEL_MM
    narrow_template = Template(pixels=narrow, row=middle, col=180, pixel_mm=PIXEL_MM)
    image = phantom(150, 170, noise=1.0, tibia_mm=tibia_mm)
    by_one, by_two = (
        find_joint(image, templates, side="right", pixel_mm=PIXEL_MM, region_px=64)
        for templates in ([TEMPLATE], [TEMPLATE, narrow_template])
    )
    assert abs(by_two.row - (middle - 10)) < 0.3
    assert abs(by_one.row - (middle - 10)) > 0.6
    wide = find_joint(phantom(150, 170), [TEMPLATE, narrow_template], side="right", pixel_mm=PIXEL_MM, region_px=64)
    assert abs(wide.row - 150) < 0.3


def test_a_match_against_noise_is_refused_and_so_is_a_region_that_leaves_the_image():
    noise = np.random.default_rng(0).integers(1000, 2000, SHAPE).astype(np.uint16)
    assert find_joint(noise, [TEMPLATE], side="right", pixel_mm=PIXEL_MM, region_px=64).status == "low score"
    image = phantom(160, 170)
    assert find_joint(image, [TEMPLATE], side="right", pixel_mm=PIXEL_MM, region_px=400).status == "leaves image"


def test_an_image_too_small_for_a_knee_an_unknown_side_and_no_template_are_refused():
    with pytest.raises(InputError, match="holds a knee joint"):
        find_joint(np.ones((20, 20), np.uint16), [TEMPLATE], side="right", pixel_mm=PIXEL_MM)
    with pytest.raises(InputError, match="side"):
        find_joint(phantom(160, 180), [TEMPLATE], side="up", pixel_mm=PIXEL_MM)
    with pytest.raises(InputError, match="templates = none; allowed: one or more"):
        find_joint(phantom(160, 180), [], side="right", pixel_mm=PIXEL_MM)


@given(row=st.floats(8, 24), col=st.floats(8, 24))
def test_a_region_holds_its_centre_and_never_wraps(row, col):
    image = np.arange(32 * 32).reshape(32, 32)
    region = cut_region(image, row, col, 16)
    assert region.shape == (16, 16)
    assert region[8, 8] == image[round(row), round(col)]
    with pytest.raises(InputError, match="leaves the image"):
        cut_region(image, 7.4, col, 16)


def test_the_bone_mask_is_the_bone():
    image = phantom(160, 160)
    mask = bone_mask(image[96:224, 96:224])
    rows, cols = np.mgrid[-64:64, -64:64] * PIXEL_MM
    # Deep in femur and tibia; in the joint space; medial of the bone, where the limb thins.
    assert mask[(np.abs(rows) > 6) & (np.abs(cols + 2) < 10)].mean() > 0.99
    assert mask[(np.abs(rows) < 1.5) & (np.abs(cols) < 12)].mean() < 0.01
    assert mask[:, cols[0] > 20].mean() < 0.01


def test_a_region_of_one_grey_value_has_features():
    found = extract(np.full((32, 32), 500, np.uint16), PIXEL_MM)
    assert found["firstorder_linear_Mean"] == 500


def test_a_mask_of_ones_alone_is_refused_by_pyradiomics_and_the_border_avoids_it():
    region = texture(48, 1)
    extractor = RadiomicsFeatureExtractor(force2D=True, force2Ddimension=0, binCount=64, additionalInfo=False)

    def slices(pad: int):
        image = sitk.GetImageFromArray(np.pad(region, pad, mode="edge")[None])
        mask = sitk.GetImageFromArray(np.pad(np.ones(region.shape, np.uint8), pad)[None])
        for volume in (image, mask):
            volume.SetSpacing((0.15, 0.15, 1.0))
        return image, mask

    with pytest.raises(ValueError, match="No labels found"):
        extractor.execute(*slices(0))
    theirs = {name.removeprefix("original_"): float(value) for name, value in extractor.execute(*slices(1)).items()}
    ours = extract(region, 0.15)
    compared = 0
    for name, value in ours.items():
        if family(name) != "shape2D" and not name.startswith("firstorder_z"):
            assert_allclose(value, theirs[name.replace("_linear", "")], rtol=1e-12, err_msg=name)
            compared += 1
    assert compared == 18 + 24 + 16 + 16 + 5 + 14


@settings(max_examples=8)
@given(gain=st.integers(1, 3), offset=st.integers(0, 5000), seed=st.integers(0, 100))
def test_gain_and_offset_leave_texture_and_z_scored_features_alone(gain, offset, seed):
    region = texture(40, seed)
    plain, changed = extract(region, 0.15), extract((gain * region + offset).astype(np.uint16), 0.15)
    for name, value in plain.items():
        if family(name) != "shape2D" and not name.startswith("firstorder_linear"):
            assert_allclose(changed[name], value, rtol=1e-9, atol=1e-12, err_msg=name)
    assert_allclose(changed["firstorder_linear_Mean"], gain * plain["firstorder_linear_Mean"] + offset)


def test_grey_values_that_are_no_integers_are_refused():
    with pytest.raises(InputError, match="integers"):
        extract(np.ones((16, 16)), 0.15)


def test_pyradiomics_stays_silent(capfd):
    extract(texture(32, 0), 0.15)
    assert capfd.readouterr() == ("", "")


def load_phantom(file: str):
    """`row,col,seed` -> a noisy phantom; a function of this module, so that it can be sent to a process."""
    row, col, seed = map(int, file.split(","))
    return phantom(row, col, noise=1.0, seed=seed)


def jobs(count: int) -> list[Job]:
    files = [f"{150 + 3 * i},{160 + 2 * i},{i}" for i in range(count)]
    return [Job(radiograph=f"r{i}", file=f, sha256=f"sha{i}", side="right", pixel_mm=0.5) for i, f in enumerate(files)]


def test_features_are_the_same_for_one_worker_and_two():
    extract_of = partial(extract_all, jobs(4), load_pixels=load_phantom, templates=[TEMPLATE], how=How(region_px=96))
    (one, _), (two, _) = extract_of(), extract_of(execution=Execution(workers=2))
    assert [record["radiograph"] for record in two] == ["r0", "r1", "r2", "r3"]
    assert one == two


def test_what_is_measured_already_is_kept_until_its_settings_change():
    loaded: list[str] = []

    def load(file: str):
        loaded.append(file)
        return load_phantom(file)

    saved: list[list[dict]] = []
    first, _ = extract_all(
        jobs(3)[:2], load_pixels=load, templates=[TEMPLATE], how=How(region_px=96), save=saved.append
    )
    assert saved[-1] == first
    known = {record["sha256"]: record for record in first}
    loaded.clear()
    again, _ = extract_all(jobs(3), load_pixels=load, templates=[TEMPLATE], how=How(region_px=96), known=known)
    assert loaded == [jobs(3)[2].file]
    assert again[:2] == first
    loaded.clear()
    extract_all(jobs(2), load_pixels=load, templates=[TEMPLATE], how=How(region_px=96, bins=32), known=known)
    assert len(loaded) == 2


@pytest.mark.parametrize("name", ["row_px", "status", "glcm_Contrast"])
def test_a_record_in_which_something_was_changed_is_measured_again(name):
    extract_of = partial(extract_all, jobs(2), load_pixels=load_phantom, templates=[TEMPLATE], how=How(region_px=96))
    first, _ = extract_of()
    changed = {**first[0], name: "low score" if name == "status" else np.nextafter(first[0][name], np.inf)}
    again, _ = extract_of(known={"sha0": changed, "sha1": first[1]})
    assert again == first


def test_the_key_of_the_settings_changes_with_the_template():
    other = Template(pixels=TEMPLATE.pixels + 1, row=160, col=180, pixel_mm=PIXEL_MM)
    assert settings_key([TEMPLATE], How()) != settings_key([other], How())
    assert settings_key([TEMPLATE], How()) == settings_key([TEMPLATE], How())


@pytest.mark.parametrize("name", ["radiomics/features.py", "radiomics/families.py", "core/workers.py", "io/images.py"])
def test_the_key_of_the_settings_changes_with_the_code(copied_code, name):
    before = settings_key([TEMPLATE], How())
    change(copied_code / name)
    assert settings_key([TEMPLATE], How()) != before


def test_a_worker_with_other_code_measures_nothing():
    with pytest.raises(InputError, match=r"on .*: other code of pssf \(radiomics\)"):
        measure(jobs(1)[0], load_pixels=load_phantom, templates=[TEMPLATE], how=How(), code={"radiomics": "0"})


def test_a_refused_match_keeps_its_place_and_has_no_features():
    (record,), _ = extract_all(jobs(1), load_pixels=load_phantom, templates=[TEMPLATE], how=How(region_px=400))
    assert record["status"] == "leaves image"
    assert abs(record["row_px"] - 150) < 2
    assert not any(name.startswith("glcm") for name in record)


def test_the_first_order_of_the_z_score_has_mean_zero_and_variance_one():
    found = extract(texture(40, 3), 0.15)
    assert_allclose([found["firstorder_z_Mean"], found["firstorder_z_Variance"]], [0, 1], atol=1e-12)
    assert_array_equal(np.isfinite(list(found.values())), True)
