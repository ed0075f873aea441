"""Test the regions of the tibia for texture measures."""

import numpy as np
import pytest

from pssf.core.checks import InputError
from pssf.core.label_names import TIBIAL_LANDMARKS
from pssf.texture import TEXTURE_REGIONS, make_texture_region

MM = 0.4
SHAPE = (260, 300)
# Row and column of the tibial landmarks of a right knee, in mm.
PLACES = dict(
    zip(
        TIBIAL_LANDMARKS,
        [(40, 22), (41, 36), (38, 47), (31, 54), (34, 58), (30, 64), (41, 70), (43, 83), (40, 98)],
        strict=True,
    )
)


def list_landmarks(mirrored=False, turn_deg=0.0, centre=(40.0, 60.0)):
    """Return landmarks in pixels of a knee that is mirrored or turned around the middle of its plateau."""
    angle = np.deg2rad(turn_deg)
    turned = {}
    for name, (row, col) in PLACES.items():
        down, right = row - 40.0, (60.0 - col if mirrored else col - 60.0)
        at = (
            centre[0] + np.cos(angle) * down + np.sin(angle) * right,
            centre[1] + np.cos(angle) * right - np.sin(angle) * down,
        )
        turned[name] = (at[0] / MM, at[1] / MM)
    return turned


def make_image(seed=1):
    return np.random.default_rng(seed).normal(size=SHAPE)


def make_region(name, landmarks=None, side="right", **options):
    return make_texture_region(name, landmarks or list_landmarks(), make_image(), side=side, pixel_mm=MM, **options)


def find_box(mask):
    rows, cols = np.nonzero(mask)
    return np.array([rows.min(), rows.max(), cols.min(), cols.max()]) * MM


def test_the_medial_subchondral_region_has_the_size_of_kraus():
    # 6 mm high, from 2 mm below the lowest landmark; 3/4 of the 34 mm between edge and spine.
    assert find_box(make_region("medial_subchondral")) == pytest.approx(
        [45.0, 51.0, 81.0 - 12.75, 81.0 + 12.75], abs=MM
    )
    assert find_box(make_region("medial_subarticular")) == pytest.approx([51.0, 57.0, 68.25, 93.75], abs=MM)
    assert find_box(make_region("lateral_subchondral")) == pytest.approx([43.0, 49.0, 26.0, 50.0], abs=MM)


def test_the_patches_cover_a_grid_without_overlap():
    patches = [make_region(name) for name in TEXTURE_REGIONS if name.startswith("patch")]
    assert len(patches) == 16
    assert np.sum(patches, axis=0).max() == 1
    side_mm = 0.9 * 76 / 8
    for patch in patches:
        assert np.count_nonzero(patch) * MM**2 == pytest.approx(side_mm**2, rel=0.12)
    first, last = find_box(patches[0]), find_box(patches[-1])
    assert first[0] == pytest.approx(45.0, abs=MM)
    assert first[2] < last[2]


def test_lateral_and_medial_follow_the_side_of_the_knee():
    right = make_region("medial_subchondral")
    left = make_region("medial_subchondral", list_landmarks(mirrored=True), side="left")
    assert np.nonzero(right)[1].mean() > 60 / MM > np.nonzero(left)[1].mean()
    assert np.count_nonzero(left) == pytest.approx(np.count_nonzero(right), rel=0.05)


@pytest.mark.parametrize("name", ["medial_subchondral", "epiphysis", "metaphysis", "patch_25"])
def test_regions_turn_with_the_plateau(name):
    upright, turned = make_region(name), make_region(name, list_landmarks(turn_deg=12.0))
    assert np.count_nonzero(turned) == pytest.approx(np.count_nonzero(upright), rel=0.08)
    down, right = (np.mean(at) * MM - middle for at, middle in zip(np.nonzero(upright), (40.0, 60.0), strict=True))
    angle = np.deg2rad(12.0)
    expected = (
        40.0 + np.cos(angle) * down + np.sin(angle) * right,
        60.0 + np.cos(angle) * right - np.sin(angle) * down,
    )
    assert [np.mean(at) * MM for at in np.nonzero(turned)] == pytest.approx(expected, abs=0.3)


def test_an_adaptive_region_includes_a_spot_across_its_lower_border():
    rows, cols = np.indices(SHAPE) * MM
    spot = np.hypot(rows - 54.0, cols - 81.0) < 2.5
    image = 0.05 * make_image() + 5.0 * spot
    mask = make_texture_region("medial_adaptive", list_landmarks(), image, side="right", pixel_mm=MM)
    assert find_box(mask)[0] >= 45.0 - MM
    below = rows > 55.0
    assert mask[spot & below].mean() > 0.8
    assert 0.6 < np.count_nonzero(mask) * MM**2 / (10 * 25.5) < 1.5


def test_regions_of_the_epiphysis_exclude_the_plate_of_a_deep_plateau():
    deep = {
        name: (row + (6.0 / MM if name == "tibia_medial_1" else 0.0), col)
        for name, (row, col) in list_landmarks().items()
    }
    assert find_box(make_region("epiphysis"))[0] == pytest.approx(45.0, abs=MM)
    assert find_box(make_region("epiphysis", deep))[0] == pytest.approx(51.0, abs=MM)


@pytest.mark.parametrize(
    ("name", "changes", "message"),
    [
        ("medial", {}, "name must be one of"),
        ("epiphysis", {"side": "medial"}, "side must be one of"),
        ("epiphysis", {"landmarks": {"notch_top": (1.0, 1.0)}}, "landmarks_px must contain all tibial landmarks"),
        ("metaphysis", {"landmarks": list_landmarks(centre=(90.0, 60.0))}, "image must contain the region metaphysis"),
    ],
)
def test_regions_that_cannot_be_placed_raise_an_error(name, changes, message):
    with pytest.raises(InputError, match=message):
        make_region(name, **changes)
