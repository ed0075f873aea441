"""Training of the reader: labels follow the random geometry, and an interrupted training continues exactly."""

from dataclasses import replace

import numpy as np
import pytest

torch = pytest.importorskip("torch")
pytest.importorskip("monai")
pytest.importorskip("kornia")

from pssf.core.checks import InputError  # noqa: E402
from pssf.core.label_names import CONTOUR_LANDMARKS  # noqa: E402
from pssf.io.landmark_files import write_pts  # noqa: E402
from pssf.io.patients.patient_list import Film  # noqa: E402
from pssf.io.pictures import write_image_row  # noqa: E402
from pssf.reader.networks import NetworkSettings, decode_heat_maps, load_network  # noqa: E402
from pssf.reader_training import (  # noqa: E402
    fine_tuning,
    grey_randomisation,
    hold_out,
    landmark_batches,
    locator_batches,
    losses,
    random_deformation,
    reader_maker,
    training_images,
)
from pssf.reader_training.reader_export import export_network  # noqa: E402
from pssf.reader_training.training_images import (  # noqa: E402
    STORED_PX,
    STORED_SPAN,
    WHOLE_PX,
    TrainingImages,
)
from pssf.reader_training.training_settings import FineTuningSettings, ReaderTrainingSettings  # noqa: E402
from pssf.reader_training.unet import ReaderUNet, compute_expected_places  # noqa: E402


@pytest.fixture(autouse=True)
def one_thread():
    """Use one thread, so that tests in several processes do not wait for one another."""
    torch.set_num_threads(1)


@pytest.fixture(scope="module")
def images():
    """Make six images in which each landmark is the middle of a bright spot on a dark ground."""
    rng = np.random.default_rng(0)
    landmarks = STORED_PX / 2 + rng.uniform(-80, 80, (6, 16, 2))
    rows, cols = np.indices((STORED_PX, STORED_PX))
    crops = [
        sum(np.exp(-((rows - row) ** 2 + (cols - col) ** 2) / 18) for row, col in places).clip(0, 1)
        for places in landmarks
    ]
    edges = np.array([[WHOLE_PX / 2, WHOLE_PX / 2 - 40], [WHOLE_PX / 2, WHOLE_PX / 2 + 40]])
    whole_rows, whole_cols = np.indices((WHOLE_PX, WHOLE_PX))
    # The lateral spot is brighter than the medial spot.
    whole = sum(
        height * np.exp(-((whole_rows - row) ** 2 + (whole_cols - col) ** 2) / 18)
        for height, (row, col) in zip((250, 150), edges, strict=True)
    )
    return TrainingImages(
        crops=np.rint(255 * np.array(crops)).astype(np.uint8),
        coded_masks=np.full((6, STORED_PX, STORED_PX), 0b10000001, np.uint8),
        landmarks_px=landmarks.astype(np.float32),
        plateau_mm=np.full(6, 78.0, np.float32),
        whole=np.repeat(whole.astype(np.uint8)[None], 6, axis=0),
        whole_edges_px=np.repeat(edges[None], 6, axis=0).astype(np.float32),
    )


@pytest.mark.parametrize("deformation_sd", [0.0, 0.03])
def test_landmarks_follow_the_random_frame_and_deformation(images, deformation_sd):
    torch.manual_seed(1)
    made = landmark_batches.make_landmark_batch(
        images,
        np.arange(6),
        crop_px=192,
        plateau_px=112.0,
        randomise_grey=torch.nn.Identity(),
        deformation_sd=deformation_sd,
    )
    seen = 0
    for image, places, visible in zip(made.image[:, 0], made.places_px, made.visible, strict=True):
        for row, col in places[visible > 0].round().int().tolist():
            assert image[row, col] > image.median() + 1
            seen += 1
    assert seen > 40


def test_undone_displacements_lead_back_to_the_points():
    torch.manual_seed(4)
    moved = random_deformation.draw_displacements(5, 192, 8.0)
    matrix = 1.8 * torch.linalg.qr(torch.randn(5, 2, 2))[0]
    pixels = torch.randint(0, 192, (5, 40, 2))
    steps = torch.stack([moved[k][:, pixels[k, :, 0], pixels[k, :, 1]].T for k in range(5)])
    target = torch.einsum("bij,bkj->bki", matrix, pixels - 95.5) + steps
    np.testing.assert_allclose(random_deformation.undo_displacements(target, moved, matrix), pixels - 95.5, atol=0.01)
    # The random factor and the interpolation between the points of the grid reduce the standard deviation.
    assert 3.0 < steps.std() < 8.0


def test_crop_without_randomness_has_the_stored_scale(images):
    made = landmark_batches.make_landmark_batch(
        images, np.arange(6), crop_px=192, plateau_px=112.0, randomise_grey=None
    )
    scale = 112.0 / (STORED_PX / STORED_SPAN)
    expected = (images.landmarks_px - (STORED_PX - 1) / 2) * scale + 95.5
    np.testing.assert_allclose(made.places_px, expected, atol=1e-3)
    assert (made.visible == 1).all()
    assert (made.bones[:, 0] == 1).all()


def test_image_edges_hide_landmarks_and_grey_values(images):
    torch.manual_seed(0)
    made = landmark_batches.make_landmark_batch(
        images, np.zeros(64, int), crop_px=192, plateau_px=112.0, randomise_grey=torch.nn.Identity()
    )
    outside = torch.nn.functional.interpolate(made.inside, scale_factor=2) == 0
    cropped = outside.any(dim=3).any(dim=2).float().mean()
    assert 0.35 < cropped < 0.85
    assert (made.image[outside].abs() < 1e-6).float().mean() > 0.97


def test_locator_labels_mark_the_edges_of_each_side(images):
    torch.manual_seed(2)
    image, edges = locator_batches.make_locator_batch(images, 60, 192, np.random.default_rng(3), torch.nn.Identity())
    known = ~torch.isnan(edges).any(dim=2)
    assert (known[:, 0] == known[:, 1]).all()
    assert (known[:, 2] == known[:, 3]).all()
    both, none = known.all(dim=1).float().mean(), (~known.any(dim=1)).float().mean()
    assert 0.1 < both < 0.4
    assert 0.08 < none < 0.4
    for picture, places, shown in zip(image[:, 0], edges, known, strict=True):
        for side in (0, 2):
            if not shown[side]:
                continue
            (lateral, medial) = places[side : side + 2].round().int().clamp(0, 191).tolist()
            assert picture[tuple(lateral)] > picture[tuple(medial)] > picture.median()
            # The lateral side of a right knee is on the viewer's left.
            assert (lateral[1] < medial[1]) == (side == 0)


def test_expected_places_equal_the_positions_of_narrow_gaussians():
    places = torch.tensor([[[30.2, 41.7], [80.0, 20.5]]])
    logits = losses.draw_targets(places, 64, 2.0).clamp(min=1e-12).log()
    torch.testing.assert_close(compute_expected_places(logits), places, atol=0.05, rtol=0)
    decoded = decode_heat_maps(logits[0].numpy(), 2)
    np.testing.assert_allclose(decoded.places_px, places[0], atol=0.05)


def test_losses_are_least_at_the_truth():
    places = torch.tensor([[[30.0, 40.0], [80.0, 20.0]]])
    logits = losses.draw_targets(places, 64, 2.5).clamp(min=1e-12).log()
    bones = torch.zeros(1, 1, 64, 64)
    bones[:, :, :30] = 1
    masks, inside, visible = 20 * (bones - 0.5), torch.ones(1, 1, 64, 64), torch.ones(1, 2)

    def compute(moved=0.0, turned=1.0, seen=visible):
        return losses.compute_landmark_loss(logits, turned * masks, places + moved, seen, bones, inside)

    assert compute() < compute(moved=3.0)
    assert compute() < compute(turned=-1.0)
    assert compute(seen=torch.tensor([[1.0, 0.0]]), moved=torch.tensor([[[0.0, 0], [50, 50]]])) < compute(moved=3.0)
    there = 12 * losses.draw_targets(places, 64, 4.0) - 6
    assert losses.compute_edge_loss(there, places) < losses.compute_edge_loss(there, places + 9)
    nothing = torch.full_like(places, torch.nan)
    assert losses.compute_edge_loss(there - 12, nothing) < losses.compute_edge_loss(there, nothing)


@pytest.mark.parametrize("recipe", ["none", "mild", "strong"])
def test_grey_recipes_keep_shape_and_repeat_with_the_seed(recipe):
    change = grey_randomisation.build_grey_randomisation(recipe)
    image = torch.rand(4, 1, 64, 64)
    results = []
    for seed in (5, 5, 6):
        torch.manual_seed(seed)
        results.append(change(image))
    assert results[0].shape == image.shape
    assert torch.isfinite(results[0]).all()
    assert torch.equal(results[0], results[1])
    assert torch.equal(results[0], results[2]) == (recipe == "none")


def test_interrupted_training_gives_the_same_network(images, tmp_path, monkeypatch):
    monkeypatch.setattr("pssf.reader_training.training_loop._CHECKPOINT_STEPS", 2)
    settings = ReaderTrainingSettings(
        images=20, landmark_steps=4, locator_steps=1, batch=2, crop_px=64, plateau_px=36.0
    )

    def stop(name, done, of, loss):
        if done == 2:
            raise KeyboardInterrupt

    def ignore(*_):
        pass

    (tmp_path / "a").mkdir()
    (tmp_path / "b").mkdir()
    whole = reader_maker.train_landmark_network(images, settings, tmp_path / "a", ignore)
    with pytest.raises(KeyboardInterrupt):
        reader_maker.train_landmark_network(images, settings, tmp_path / "b", stop)
    again = reader_maker.train_landmark_network(images, settings, tmp_path / "b", ignore)
    for first, second in zip(whole.state_dict().values(), again.state_dict().values(), strict=True):
        assert torch.equal(first, second)


def test_exported_network_gives_the_same_logits(images, tmp_path):
    pytest.importorskip("onnxruntime")
    pytest.importorskip("onnxscript")
    settings = ReaderTrainingSettings(
        images=20, landmark_steps=1, locator_steps=1, batch=2, crop_px=64, plateau_px=36.0
    )
    network = reader_maker.train_landmark_network(images, settings, tmp_path, lambda *_: None)
    loaded = load_network(tmp_path / "landmarks.onnx")
    assert (loaded.settings.crop_px, loaded.settings.plateau_px) == (64, 36.0)
    crop = np.random.default_rng(0).normal(size=(64, 64)).astype(np.float32)
    with torch.no_grad():
        expected = network(torch.from_numpy(crop)[None, None])
    for ours, theirs in zip(loaded.run(crop), expected, strict=True):
        np.testing.assert_allclose(ours, theirs[0], atol=1e-3)


def test_network_of_another_shape_has_as_many_outputs():
    heat_maps, masks = ReaderUNet(4, 0, 8)(torch.zeros(2, 1, 64, 64))
    assert heat_maps.shape == (2, 4, 32, 32)
    assert masks.shape == (2, 0, 32, 32)


@pytest.mark.parametrize(
    ("field", "value"),
    [("images", 1), ("batch", 1), ("learning_rate", 2.0), ("crop_px", 10), ("randomisation", "wild")],
)
def test_settings_outside_their_range_are_refused(field, value):
    with pytest.raises(InputError, match=field):
        ReaderTrainingSettings(**{field: value})


@pytest.mark.parametrize("side", ["right", "left"])
def test_prepared_image_has_masks_and_landmarks_where_the_knee_is(side):
    from pssf.dataset.coco_instances import encode_run_lengths

    femur, osteophyte = np.zeros((200, 240), bool), np.zeros((200, 240), bool)
    femur[30:90, 80:160], osteophyte[80:96, 150:175] = True, True
    # The lateral edge of a right knee is on the viewer's left.
    lateral, medial = ((100.0, 75.0), (100.0, 165.0)) if side == "right" else ((100.0, 165.0), (100.0, 75.0))
    landmarks = dict.fromkeys(CONTOUR_LANDMARKS, (90.0, 150.0))
    landmarks |= {"tibia_lateral_edge": lateral, "tibia_medial_edge": medial}
    names = ("femur", "lateral_femur_osteophyte")
    labels = {
        "instances": [
            {"name": name, "segmentation": encode_run_lengths(mask)}
            for name, mask in zip(names, (femur, osteophyte), strict=True)
        ],
    }
    pixels = np.where(femur | osteophyte, 200, 20).astype(np.uint8)
    places = np.array([landmarks[name] for name in CONTOUR_LANDMARKS])
    masks = training_images._code_masks(labels, pixels.shape)
    made = training_images.collect_training_images([training_images.prepare_image(pixels, places, masks, side, 0.9)])
    bone, inside = made.coded_masks[0] & 1, made.coded_masks[0] >> 7
    bright = made.crops[0] > 110
    assert (bone.astype(bool) != bright)[inside == 1].mean() < 0.01
    assert bone.sum() / (STORED_PX / STORED_SPAN / 90) ** 2 == pytest.approx((femur | osteophyte).sum(), rel=0.01)
    np.testing.assert_allclose(made.plateau_mm, 81.0)
    middle, half = (STORED_PX - 1) / 2, STORED_PX / STORED_SPAN / 2
    np.testing.assert_allclose(
        made.landmarks_px[0, [0, 8]], [[middle, middle - half], [middle, middle + half]], atol=1e-3
    )
    row, col = made.landmarks_px[0, 3].round().astype(int)
    assert bone[row - 3, col] == 1
    assert made.whole.shape == (1, WHOLE_PX, WHOLE_PX)
    across = made.whole_edges_px[0, 1] - made.whole_edges_px[0, 0]
    np.testing.assert_allclose(across, (0, 90 * WHOLE_PX / 240), atol=1e-3)


@pytest.mark.parametrize("shift_px", [0.0, 2.0])
def test_hold_out_errors_are_the_shift_of_the_femur(images, shift_px):
    settings = ReaderTrainingSettings(batch=3)
    # A knee whose femur is 30 px above its tibia: each landmark is at its own column.
    places = np.zeros((6, 16, 2), np.float32)
    places[:, :9] = np.stack((np.full(9, 250), np.linspace(130, 320, 9)), axis=1)
    places[:, 9:] = np.stack((np.full(7, 220), np.linspace(130, 320, 7)), axis=1)
    knees = replace(images, landmarks_px=places, coded_masks=images.coded_masks | 0b1111)
    rows, cols = torch.meshgrid(*[2 * torch.arange(96.0) + 0.5] * 2, indexing="ij")
    made = landmark_batches.make_landmark_batch(
        knees, np.arange(6), crop_px=192, plateau_px=settings.plateau_px, randomise_grey=None
    )
    down = torch.zeros(16)
    down[9:] = shift_px

    class Shifted(torch.nn.Module):
        def forward(self, image):
            at = made.places_px[: len(image), :, :, None, None]
            distance = (rows - at[:, :, 0] - down[:, None, None]) ** 2 + (cols - at[:, :, 1]) ** 2
            return -distance / 18, torch.ones(len(image), 4, 96, 96)

    errors = hold_out.measure_hold_out(Shifted(), knees, settings)
    mm = 78.0 / settings.plateau_px
    assert errors.landmark_mm["tibia_lateral_edge"] == pytest.approx(0, abs=0.01)
    assert errors.landmark_mm["femur_medial_edge"] == pytest.approx(shift_px * mm, abs=0.01)
    for side in ("medial", "lateral"):
        assert errors.jsw_bias_mm[side] == pytest.approx(-shift_px * mm, abs=0.01)
        assert errors.jsw_mae_mm[side] == pytest.approx(shift_px * mm, abs=0.01)
    assert set(errors.dice.values()) == {1.0}


@pytest.fixture(scope="module")
def small_reader(tmp_path_factory):
    """Write a reader with random weights, and return its folder."""
    folder = tmp_path_factory.mktemp("reader")
    torch.manual_seed(0)
    network = ReaderUNet(16, 4, 8)
    # Statistics of the normalisation layers, as after a training.
    network(torch.randn(4, 1, 64, 64))
    described = NetworkSettings(
        crop_px=64, plateau_px=36.0, stride=2, landmarks=CONTOUR_LANDMARKS, masks=training_images.BONES
    )
    export_network(network, described, folder / "landmarks.onnx")
    for name in ("locator.onnx", "side.onnx", "reader.json"):
        (folder / name).write_bytes(b"unchanged")
    return folder


def test_loaded_network_gives_the_logits_of_its_file(small_reader):
    present = load_network(small_reader / "landmarks.onnx")
    network = fine_tuning.load_exported_network(small_reader / "landmarks.onnx", present)
    image = np.random.default_rng(0).normal(size=(64, 64)).astype(np.float32)
    with torch.no_grad():
        made = network(torch.from_numpy(image)[None, None])
    for ours, theirs in zip(made, present.run(image), strict=True):
        np.testing.assert_allclose(ours[0].numpy(), theirs, atol=2e-4 * np.abs(theirs).max())


@pytest.fixture
def annotated(tmp_path):
    """Write seven radiographs with a landmark file each, in which the landmarks are bright spots."""
    rng = np.random.default_rng(3)
    listed = []
    for number in range(7):
        columns = np.r_[np.linspace(60, 140, 9), np.linspace(62, 138, 7)]
        places = np.column_stack((np.r_[np.full(9, 110.0), np.full(7, 90.0)], columns)) + rng.normal(0, 2, (16, 2))
        rows, cols = np.indices((200, 200))
        grey = sum(200 * np.exp(-((rows - row) ** 2 + (cols - col) ** 2) / 8) for row, col in places)
        write_image_row([np.clip(grey, 0, 255).astype(np.uint8)], tmp_path / f"{number}R.png")
        write_pts(
            tmp_path / "points" / f"{number}R_right.pts",
            {name: tuple(place) for name, place in zip(CONTOUR_LANDMARKS, places, strict=True)},
        )
        listed.append(
            Film(
                file=str(tmp_path / f"{number}R.png"), grade=None, subject=str(number), side="right", pixel_mm=None,
                sha256="",
            )
        )  # fmt: skip
    return listed, tmp_path / "points"


def test_fine_tuning_reduces_the_error_and_repeats_to_the_byte(small_reader, annotated, tmp_path):
    settings = FineTuningSettings(steps=12, batch=4, learning_rate=0.004, threads=1)
    made = [
        fine_tuning.fine_tune_reader(*annotated, small_reader, settings, tmp_path / name, lambda *_: None)
        for name in "ab"
    ]
    assert made[0] == made[1]
    assert made[0].knees == 1
    assert made[0].after < made[0].before
    files = [(tmp_path / name / "landmarks.onnx").read_bytes() for name in "ab"]
    assert files[0] == files[1] != (small_reader / "landmarks.onnx").read_bytes()
    assert (tmp_path / "a" / "reader.json").read_bytes() == b"unchanged"
    assert load_network(tmp_path / "a" / "landmarks.onnx").settings.plateau_px == 36.0


def test_fine_tuning_without_annotations_or_subjects_is_refused(small_reader, annotated, tmp_path):
    listed, points = annotated
    for films, folder, message in ((listed[:4], points, "at least 5 subjects, got 4"), (listed, tmp_path, "got none")):
        with pytest.raises(InputError, match=message):
            fine_tuning.fine_tune_reader(
                films, folder, small_reader, FineTuningSettings(threads=1), tmp_path / "x", lambda *_: None
            )


def test_subjects_are_kept_with_all_their_knees():
    subjects = [str(number // 2) for number in range(20)]
    kept = fine_tuning.choose_kept_subjects(subjects, seed=1)
    assert kept.sum() == 4
    assert (kept[::2] == kept[1::2]).all()


@pytest.mark.slow  # The training takes half a minute.
def test_side_network_learns_from_mirrored_crops(images, tmp_path):
    """In each image, the spots are at other places, so that a network can learn which images are mirrored."""
    losses = []
    reader_maker.train_side_network(
        images,
        ReaderTrainingSettings(side_steps=30, randomisation="none", learning_rate=0.01),
        tmp_path,
        lambda *progress: losses.append(progress[-1]),
    )
    sides = load_network(tmp_path / "side.onnx")
    assert sides.settings.landmarks == ("right",)
    crop = (
        landmark_batches.make_landmark_batch(images, np.arange(6), crop_px=72, plateau_px=36.0, randomise_grey=None)
        .image[:, 0]
        .numpy()
    )
    right = np.array(
        [[sides.run(np.ascontiguousarray(one))[0].item() for one in (image, image[:, ::-1])] for image in crop]
    )
    assert (right[:, 0] > right[:, 1]).mean() > 0.8
    assert losses[-1] < np.log(2)
