"""The networks of the package read simulated radiographs, and refuse what is no frontal knee."""

import numpy as np
import pytest

import pssf
from pssf.reader.joint_measures import measure_joint
from pssf.reader.reader_table import PACKAGE_FOLDER

SIDES = ("right", "left")


@pytest.fixture(scope="module", params=SIDES)
def radiograph(request):
    """Return a simulated radiograph of a knee of each side."""
    knee = pssf.sample_knee(grade=SIDES.index(request.param), rng=3, side=request.param)
    return pssf.simulate(knee, pssf.load_protocol("fixed_flexion").resample(384), rng=5, keep=("masks",))


@pytest.fixture(scope="module")
def film(radiograph):
    """Return the radiograph for display."""
    return pssf.render_for_display(radiograph)


def test_landmarks_and_joint_space_are_near_the_labels(radiograph, film):
    (knee,) = pssf.read(film, pixel_mm=radiograph.protocol.pixel_mm)
    assert (knee.side, knee.refusal) == (radiograph.knee.side, "")
    truth = np.array([radiograph.truth.landmarks_px[name] for name in knee.landmarks_px])
    distance = np.linalg.norm(np.array(list(knee.landmarks_px.values())) - truth, axis=1)
    assert distance.mean() * radiograph.protocol.pixel_mm < 1.5
    expected = measure_joint(truth, knee.side)
    width_mm = expected.plateau_width_px * radiograph.protocol.pixel_mm
    assert knee.plateau_width_mm == pytest.approx(width_mm, abs=3.0)
    assert knee.medial_jsw_mm == pytest.approx(expected.medial_jsw_share * width_mm, abs=1.5)
    for bone in ("femur", "tibia"):
        mask, true = knee.masks[bone], radiograph.truth.masks[bone]
        # The masks of the reader end with its crop.
        box = np.s_[: int(truth[:, 0].max()) + 20] if bone == "femur" else np.s_[int(truth[:, 0].min()) :]
        assert (mask[box] & true[box]).sum() / mask[box].sum() > 0.9


def test_polarity_and_bit_depth_do_not_matter(film):
    (plain,), (inverted,), (deep,) = (pssf.read(one) for one in (film, 255.0 - film, film * 16.0 + 100))
    for other in (inverted, deep):
        assert other.side == plain.side
        moved = np.array(list(other.landmarks_px.values())) - np.array(list(plain.landmarks_px.values()))
        assert np.linalg.norm(moved, axis=1).mean() < 0.03 * plain.measures.plateau_width_px


@pytest.mark.parametrize("change", ["upside down", "blank", "noise", "gradient"])
def test_images_without_a_frontal_knee_are_not_read(film, change):
    wrong = {
        "upside down": film[::-1],
        "blank": np.full(film.shape, 100.0),
        "noise": np.random.default_rng(0).normal(size=film.shape),
        "gradient": np.add.outer(np.arange(200.0), np.arange(200.0)),
    }[change]
    assert all(knee.refusal for knee in pssf.read(wrong))


def test_networks_are_small():
    assert sum(path.stat().st_size for path in PACKAGE_FOLDER.iterdir()) < 10e6
