"""The reader: frames, positions from heat maps, joint measures, and a whole reading with known heat maps."""

import csv
import io
import json
import pickle
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image

from pssf.cli.reader_command import landmarks
from pssf.core.checks import InputError
from pssf.core.label_names import CONTOUR_LANDMARKS
from pssf.data.analysis.ibsi_table import load_ibsi_tags
from pssf.data.analysis.landmark_table import load_landmark_reference
from pssf.io.landmark_files import read_pts, write_pts
from pssf.io.patients.landmark_annotations import read_landmark_annotations
from pssf.io.pictures import write_image_row
from pssf.radiomics.features.feature_extraction import extract_features
from pssf.radiomics.localisation.region_placement import find_polarity, locate_joint_by_reader, locate_region
from pssf.reader.film_overlay import draw_overlay
from pssf.reader.film_reading import read
from pssf.reader.joint_measures import measure_joint
from pssf.reader.knee_finder import KneeCandidate, find_knees
from pssf.reader.knee_frame import KneeFrame, fit_frame, fit_similarity, normalise_grey
from pssf.reader.knee_reading import Reader, load_reader
from pssf.reader.landmark_agreement import compare_landmarks, summarise_agreement
from pssf.reader.networks import Network, NetworkSettings, decode_heat_maps, load_network
from pssf.reader.reader_table import ReaderTable
from pssf.reader.reading_rows import make_rows
from pssf.reader.side_decision import decide_sides

CROP_PX = 96
PLATEAU_PX = 56.0
BONES = ("femur", "tibia", "fibula", "patella")
# Mean landmarks of annotated knees without osteoarthritis, as x and y in plateau widths.
SHAPE = np.array(load_landmark_reference().grade["0"].mean_share)
frames = st.builds(
    KneeFrame,
    centre_px=st.tuples(st.floats(50, 150), st.floats(50, 150)),
    width_px=st.floats(30, 200),
    angle_rad=st.floats(-0.5, 0.5),
    side=st.sampled_from(("right", "left")),
)


def place_landmarks(frame):
    """Return rows and columns of the mean shape in a frame."""
    return frame.map_to_image(np.column_stack((-SHAPE[:, 1], SHAPE[:, 0])), 1.0, 1)


@given(frames)
def test_mapping_to_a_crop_and_back_returns_the_points(frame):
    points = np.array([[0.0, 0.0], [40.0, 90.0], [95.0, 3.0]])
    there = frame.map_to_crop(points, PLATEAU_PX, CROP_PX)
    np.testing.assert_allclose(frame.map_to_image(there, PLATEAU_PX, CROP_PX), points, atol=1e-9)


@given(frames)
def test_frame_from_plateau_edges_equals_the_frame_of_the_knee(frame):
    edges = place_landmarks(frame)[[0, 8]]
    again = fit_frame(edges, frame.side)
    np.testing.assert_allclose(again.centre_px, frame.centre_px, atol=1e-9)
    np.testing.assert_allclose((again.width_px, again.angle_rad), (frame.width_px, frame.angle_rad), atol=1e-9)


@given(frames)
def test_crop_shows_the_plateau_horizontal_with_lateral_on_the_left(frame):
    lateral, medial = frame.map_to_crop(place_landmarks(frame)[[0, 8]], PLATEAU_PX, CROP_PX)
    middle = (CROP_PX - 1) / 2
    np.testing.assert_allclose(lateral, (middle, middle - PLATEAU_PX / 2), atol=1e-9)
    np.testing.assert_allclose(medial, (middle, middle + PLATEAU_PX / 2), atol=1e-9)


@pytest.mark.parametrize("side", ["right", "left"])
@pytest.mark.parametrize("width_px", [40.0, 110.0])
def test_crop_of_a_linear_image_has_the_grey_values_of_its_points(side, width_px):
    frame = KneeFrame(centre_px=(90.0, 110.0), width_px=width_px, angle_rad=0.2, side=side)
    rows, cols = np.indices((180, 220))
    crop, inside = frame.cut_crop((2.0 * rows + 3.0 * cols).astype(np.float32), PLATEAU_PX, CROP_PX)
    points = frame.map_to_image(np.moveaxis(np.indices((CROP_PX, CROP_PX)), 0, -1), PLATEAU_PX, CROP_PX)
    deep = ((points > 8) & (points < np.array([171, 211]))).all(axis=-1)
    assert deep.sum() > 1000
    np.testing.assert_allclose(crop[deep], (points @ [2.0, 3.0])[deep], atol=0.02)
    assert inside[deep].all()
    assert not crop[~inside].any()


def test_normalised_grey_values_ignore_pixels_outside_the_image():
    rng = np.random.default_rng(0)
    grey = rng.normal(100, 7, (50, 50)).astype(np.float32)
    inside = np.zeros((50, 50), bool)
    inside[10:40, 5:30] = True
    first = normalise_grey(grey, inside)
    second = normalise_grey(np.where(inside, 3 * grey + 11, -999).astype(np.float32), inside)
    np.testing.assert_allclose(first, second, atol=1e-4)
    assert abs(first[inside].mean()) < 1e-4
    assert abs(first[inside].std() - 1) < 1e-4


def draw_heat_maps(places, size, sd_px=2.5):
    """Draw logits of Gaussians around rows and columns in the input of a network with stride 2."""
    axis = 2 * np.arange(size) + 0.5
    squares = (axis[:, None] - places[:, 0, None, None]) ** 2 + (axis[None] - places[:, 1, None, None]) ** 2
    return (-squares / (2 * sd_px**2)).astype(np.float32)


@given(st.lists(st.tuples(st.floats(20, 75), st.floats(20, 75)), min_size=1, max_size=4))
def test_decoded_position_is_the_middle_of_the_gaussian(places):
    decoded = decode_heat_maps(draw_heat_maps(np.array(places), 48), 2)
    np.testing.assert_allclose(decoded.places_px, places, atol=0.02)
    np.testing.assert_allclose(decoded.spread_px, 2.5, atol=0.05)
    assert (decoded.mass > 0.99).all()


def test_second_maximum_lowers_the_confidence_and_not_the_position():
    near, far = (np.exp(draw_heat_maps(np.array([place]), 48)) for place in ([30.0, 30.0], [80.0, 80.0]))
    decoded = decode_heat_maps(np.log(near + 0.5 * far + 1e-30), 2)
    np.testing.assert_allclose(decoded.places_px, [[30, 30]], atol=0.02)
    np.testing.assert_allclose(decoded.mass, 2 / 3, atol=0.01)


@given(frames)
def test_joint_measures_do_not_depend_on_place_size_rotation_and_side(frame):
    reference = measure_joint(np.column_stack((-SHAPE[:, 1], SHAPE[:, 0])), "right")
    moved = measure_joint(place_landmarks(frame), frame.side)
    np.testing.assert_allclose(moved.plateau_width_px, frame.width_px, rtol=1e-9)
    for name in ("medial_jsw_share", "lateral_jsw_share", "joint_line_convergence_deg"):
        np.testing.assert_allclose(getattr(moved, name), getattr(reference, name), atol=1e-9)
    assert moved.jsw_at_share.keys() == reference.jsw_at_share.keys()


def test_joint_space_of_parallel_lines_is_their_distance():
    shape = SHAPE.copy()
    shape[:9, 1], shape[9:, 1] = 0.0, 0.06
    measures = measure_joint(100 * np.column_stack((-shape[:, 1], shape[:, 0])), "right")
    np.testing.assert_allclose([measures.medial_jsw_share, measures.lateral_jsw_share], 0.06, atol=1e-12)
    np.testing.assert_allclose(list(measures.jsw_at_share.values()), 0.06, atol=1e-12)
    assert abs(measures.joint_line_convergence_deg) < 1e-9


def test_joint_line_convergence_is_positive_if_the_joint_opens_medially():
    shape = SHAPE.copy()
    shape[9:, 1] = 0.05 + 0.1 * (shape[9:, 0] + 0.5)
    measures = measure_joint(100 * np.column_stack((-shape[:, 1], shape[:, 0])), "right")
    np.testing.assert_allclose(measures.joint_line_convergence_deg, np.rad2deg(np.arctan(0.1)), atol=0.3)
    assert measures.medial_jsw_share > measures.lateral_jsw_share


class KnownSession:
    """Session whose heat maps show the landmarks of known knees in the frame that the reader asked for."""

    def __init__(self, output):
        self.output = output

    def run(self, _, inputs):
        """Return the known heat maps and masks."""
        return self.output(inputs["image"][0, 0])


def draw_film(frame, shape=(300, 400)):
    """Draw a film with a bright spot at the lateral and a weaker spot at the medial edge of the plateau."""
    rows, cols = np.indices(shape)
    spots = [
        height * np.exp(-((rows - row) ** 2 + (cols - col) ** 2) / (2 * 4.0**2))
        for height, (row, col) in zip((2.0, 1.0), place_landmarks(frame)[[0, 8]], strict=True)
    ]
    return sum(spots)


def find_spots(crop):
    """Return the places of the two spots, the brighter one first."""
    values = crop - np.median(crop)
    places = []
    for _ in range(2):
        row, col = np.unravel_index(values.argmax(), values.shape)
        near = np.hypot(*(np.indices(values.shape) - np.array([row, col])[:, None, None])) < 7
        weight = np.where(near, np.maximum(values, 0), 0)
        places.append([(axis * weight).sum() / weight.sum() for axis in np.indices(values.shape)])
        values = np.where(near, 0, values)
    return np.array(places)


def make_reader(**thresholds):
    """Return a reader whose networks see the two spots of `draw_film`; its locator is wrong by 5 pixels."""

    def locate(image):
        spots = find_spots(image)
        maps = np.full((4, CROP_PX // 2, CROP_PX // 2), -20.0, np.float32)
        first = 0 if spots[0, 1] < spots[1, 1] else 2
        maps[first : first + 2] = 6 + draw_heat_maps(spots + 5.0, CROP_PX // 2, 4.0)
        return maps[None], np.zeros((1, 0, CROP_PX // 2, CROP_PX // 2), np.float32)

    def tell_side(image):
        spots = find_spots(image)
        logit = 6.0 if spots[0, 1] < spots[1, 1] else -6.0
        return np.full((1, 1, 1, 1), logit, np.float32), np.zeros((1, 0, 1, 1), np.float32)

    def mark(image):
        places = place_landmarks(fit_frame(find_spots(image), "right"))
        rows = 2 * np.arange(CROP_PX // 2) + 0.5
        femur = np.where(rows < (CROP_PX - 1) / 2, 5.0, -5.0)[:, None] * np.ones(CROP_PX // 2)
        masks = np.stack([femur, -femur, np.full_like(femur, -5.0), np.full_like(femur, -5.0)])
        return draw_heat_maps(places, CROP_PX // 2)[None], masks[None].astype(np.float32)

    def make(plateau_px, names, masks, output):
        return Network(
            session=KnownSession(output),
            settings=NetworkSettings(crop_px=CROP_PX, plateau_px=plateau_px, stride=2, landmarks=names, masks=masks),
        )

    table = {
        "min_score": 0.3,
        "min_side_confidence": 0.6,
        "min_confidence": 0.3,
        "max_shape_residual": 0.05,
        "mean_shape": tuple((-y, x) for x, y in SHAPE.tolist()),
    }
    edges = ("right_lateral", "right_medial", "left_lateral", "left_medial")
    return Reader(
        locator=make(0.0, edges, (), locate),
        sides=make(PLATEAU_PX, ("right",), (), tell_side),
        landmarks=make(PLATEAU_PX, CONTOUR_LANDMARKS, BONES, mark),
        table=ReaderTable(**(table | thresholds)),
    )


@pytest.mark.parametrize("side", ["right", "left"])
def test_reading_returns_side_landmarks_and_lengths_of_the_knee(side):
    frame = KneeFrame(centre_px=(150.0, 210.0), width_px=120.0, angle_rad=0.1, side=side)
    (knee,) = read(draw_film(frame), pixel_mm=0.6, reader=make_reader())
    assert (knee.side, knee.refusal) == (side, "")
    truth = place_landmarks(frame)
    np.testing.assert_allclose(np.array(list(knee.landmarks_px.values())), truth, atol=0.5)
    np.testing.assert_allclose(knee.plateau_width_mm, 72.0, atol=0.3)
    np.testing.assert_allclose(knee.medial_jsw_mm, 72.0 * measure_joint(truth, side).medial_jsw_share, atol=0.05)
    np.testing.assert_allclose(knee.angle_deg, np.rad2deg(0.1), atol=0.2)
    assert knee.shape_residual < 0.001
    above, below = (frame.map_to_image(np.array([[row, 0.0]]), 1.0, 1)[0].round().astype(int) for row in (-0.2, 0.2))
    assert knee.masks["femur"][tuple(above)]
    assert not knee.masks["femur"][tuple(below)]
    assert knee.masks["tibia"][tuple(below)]
    assert not knee.masks["tibia"][tuple(above)]
    assert not knee.masks["patella"].any()


@pytest.mark.parametrize(
    ("threshold", "reason"),
    [
        ({"max_shape_residual": -1.0}, "shape"),
        ({"min_confidence": 1.1}, "confidence"),
        ({"min_side_confidence": 1.1}, "probability of the side"),
    ],
)
def test_reading_beyond_a_threshold_is_refused_with_its_reason(threshold, reason):
    frame = KneeFrame(centre_px=(150.0, 210.0), width_px=120.0, angle_rad=0.0, side="right")
    (knee,) = read(draw_film(frame), reader=make_reader(**threshold))
    assert reason in knee.refusal
    assert make_rows("film.png", [knee])[0]["status"].startswith("refused: ")


def test_image_without_a_knee_gives_no_reading_and_a_row_that_says_so():
    frame = KneeFrame(centre_px=(150.0, 210.0), width_px=120.0, angle_rad=0.0, side="right")
    assert read(draw_film(frame), reader=make_reader(min_score=1.1)) == ()
    assert make_rows("hand.png", []) == [{"file": "hand.png", "status": "no knee"}]


def test_rows_have_shares_and_no_lengths_without_a_pixel_size():
    frame = KneeFrame(centre_px=(150.0, 210.0), width_px=120.0, angle_rad=0.0, side="right")
    (row,) = make_rows("film.png", read(draw_film(frame), reader=make_reader()))
    assert row["medial_jsw_mm"] is None
    assert row["plateau_width_mm"] is None
    assert 0.03 < row["medial_jsw_share"] < 0.1
    assert {f"{name}_row_px" for name in CONTOUR_LANDMARKS} <= row.keys()


def test_overlay_marks_landmarks_and_tints_bones():
    frame = KneeFrame(centre_px=(150.0, 210.0), width_px=120.0, angle_rad=0.0, side="right")
    image = draw_film(frame)
    knees = read(image, reader=make_reader())
    plain, drawn = draw_overlay(image, []), draw_overlay(image, knees)
    assert drawn.shape == (300, 400, 3)
    changed = (plain != drawn).any(axis=2)
    assert changed[140, 210]
    assert not changed[5, 5]


@pytest.mark.parametrize(
    ("image", "pixel_mm", "message"),
    [
        (np.zeros((10, 200)), None, "at least 64 x 64"),
        (np.zeros((100, 100, 3)), None, "at least 64 x 64"),
        (np.full((100, 100), np.nan), None, "finite"),
        (np.zeros((100, 100)), 9.0, "pixel_mm"),
    ],
)
def test_wrong_input_is_refused_in_one_line(image, pixel_mm, message):
    with pytest.raises(InputError, match=message):
        read(image, pixel_mm=pixel_mm, reader=make_reader())


def test_missing_and_damaged_networks_are_refused_in_one_line(tmp_path):
    pytest.importorskip("onnxruntime")
    with pytest.raises(InputError, match=r"locator\.onnx must be a network of the reader, got no file"):
        load_reader(tmp_path)
    (tmp_path / "locator.onnx").write_bytes(b"no network")
    with pytest.raises(InputError, match="must be a network of the reader"):
        load_network(tmp_path / "locator.onnx")


def annotate(error_mm=0.0):
    """Return the mean shape as annotation of a knee 80 mm wide, moved, turned and with random errors."""
    places = place_landmarks(KneeFrame(centre_px=(70.0, 60.0), width_px=80.0, angle_rad=-0.2, side="right"))
    noise = np.random.default_rng(4).normal(0, 1, (16, 2)) * error_mm
    return places[:, ::-1] + noise


@pytest.mark.parametrize("side", ["right", "left"])
def test_agreement_does_not_depend_on_place_scale_and_rotation(side):
    frame = KneeFrame(centre_px=(150.0, 210.0), width_px=120.0, angle_rad=0.1, side=side)
    (knee,) = read(draw_film(frame), reader=make_reader())
    row = compare_landmarks(knee, annotate(), side)
    assert (row["found"], row["side_right"], row["refused"]) == (1, 1, 0)
    assert row["distance_mm"] < 0.15
    np.testing.assert_allclose(row["medial_gap_mm"], row["medial_gap_annotated_mm"], atol=0.05)
    noisy = compare_landmarks(knee, annotate(1.0), side)
    assert noisy["distance_mm"] > 0.8
    # A displacement along the contour does not change the distance from the line.
    assert 0.3 < noisy["line_distance_mm"] < 0.8 * noisy["distance_mm"]


def test_similarity_fit_recovers_a_similarity():
    points = np.random.default_rng(1).normal(size=(9, 2))
    turn = np.array([[np.cos(0.7), -np.sin(0.7)], [np.sin(0.7), np.cos(0.7)]])
    target = 3.1 * points @ turn.T + [4.0, -9.0]
    np.testing.assert_allclose(fit_similarity(points, target), target, atol=1e-12)


def test_summary_counts_and_orders_the_radiographs():
    def make(distance, gap, *, found=1):
        gaps = {"medial_gap_mm": gap, "lateral_gap_mm": 6.0} if found else {}
        known = {"medial_gap_annotated_mm": gap - 0.5 - 0.01 * distance, "lateral_gap_annotated_mm": 6.0 + distance}
        return {
            "found": found,
            "refused": 0,
            "side_right": found,
            "distance_mm": distance,
            "line_distance_mm": distance / 2,
            **known,
            **gaps,
        }

    rows = [make(0.8, 5.0), make(1.2, 4.5), make(2.0, 1.0), make(3.0, 4.8), make(9.0, 1.0, found=0)]
    everything, *by_grade = summarise_agreement(rows, [0, 0, 4, 3, None])
    assert (everything["count"], everything["found"]) == (5, 4)
    np.testing.assert_allclose((everything["median_mm"], everything["line_median_mm"]), (1.6, 0.8))
    assert (everything["below_1_mm"], everything["below_1_5_mm"], everything["below_2_5_mm"]) == (0.25, 0.5, 0.75)
    np.testing.assert_allclose(everything["medial_gap_bias_mm"], 0.5 + 0.01 * 1.75)
    # KL 3 has a larger joint space than KL 0 in one of the four pairs.
    np.testing.assert_allclose(everything["auc"], 0.75)
    assert [row["radiographs"] for row in by_grade] == ["KL 0", "KL 3", "KL 4"]
    assert [row["auc"] for row in by_grade] == [None, 0.5, 1.0]


def test_annotations_are_read_and_wrong_tables_refused(tmp_path):
    columns = ["file", "side", "kl", *(f"{name}_{axis}_mm" for name in CONTOUR_LANDMARKS for axis in "xy")]
    values = ["a.png", "L", "2", *map(str, range(32))]
    path = tmp_path / "marks.csv"
    path.write_text(",".join(columns) + "\n" + ",".join(values) + "\n", encoding="utf-8")
    (one,) = read_landmark_annotations(path, CONTOUR_LANDMARKS)
    assert (one.file, one.side, one.grade) == ("a.png", "left", 2)
    np.testing.assert_array_equal(one.landmarks_mm, np.arange(32).reshape(16, 2))
    for old, new, message in (("L", "up", "side"), ("7", "seven", "numbers"), ("7", "nan", "finite"), ("2", "x", "kl")):
        changed = [new if value == old else value for value in values]
        path.write_text(",".join(columns) + "\n" + ",".join(changed) + "\n", encoding="utf-8")
        with pytest.raises(InputError, match=rf"line 2: .*{message}"):
            read_landmark_annotations(path, CONTOUR_LANDMARKS)
    path.write_text(",".join(columns[:-1]) + "\n", encoding="utf-8")
    with pytest.raises(InputError, match="femur_medial_edge_y_mm"):
        read_landmark_annotations(path, CONTOUR_LANDMARKS)


def test_command_writes_tables_points_and_pictures(tmp_path, monkeypatch, capsys):
    frame = KneeFrame(centre_px=(150.0, 210.0), width_px=120.0, angle_rad=0.1, side="left")
    film, other = tmp_path / "a.png", tmp_path / "b.png"
    Image.fromarray((draw_film(frame) / 2 * 255).astype(np.uint8)).save(film)
    other.write_bytes(b"no picture")
    places = annotate()
    columns = ["file", "side", "kl", *(f"{name}_{axis}_mm" for name in CONTOUR_LANDMARKS for axis in "xy")]
    marks = tmp_path / "marks.csv"
    marks.write_text(
        ",".join(columns) + "\n" + ",".join(["a.png", "L", "0", *map(str, places.ravel())]) + "\n", encoding="utf-8"
    )
    monkeypatch.setattr("pssf.reader.knee_reading.load_reader", lambda folder: make_reader())
    landmarks(films=[film, other], out=tmp_path / "out", pixel_mm=0.6, compare=marks)
    printed = capsys.readouterr()
    assert "1 of 2 knees read" in printed.out
    assert "b.png: unreadable" in printed.err
    rows = list(csv.DictReader((tmp_path / "out" / "landmarks.csv").open(encoding="utf-8")))
    assert [row["status"][:10] for row in rows] == ["read", "unreadable"]
    assert rows[0]["side"] == "left"
    np.testing.assert_allclose(float(rows[0]["plateau_width_mm"]), 72.0, atol=0.3)
    assert len(json.loads((tmp_path / "out" / "landmarks.json").read_text())) == 2
    points = (tmp_path / "out" / "points" / "a_left.pts").read_text().splitlines()
    assert points[:3] == ["version: 1", "n_points: 16", "{"]
    with Image.open(tmp_path / "out" / "pictures" / "a.png") as picture:
        assert picture.size == (400, 300)
    (agreement, _) = csv.DictReader((tmp_path / "out" / "reader_agreement.csv").open(encoding="utf-8"))
    assert (agreement["found"], agreement["side_right"]) == ("1", "1")


def locate_fixed(places, heights):
    """Return a locator of 96 x 96 images with peaks of given heights at the edges, in the order of its channels."""
    maps = np.array(
        [
            height + draw_heat_maps(np.array([place]), CROP_PX // 2, 4.0)[0]
            for place, height in zip(places, heights, strict=True)
        ]
    )
    output = maps[None].astype(np.float32), np.zeros((1, 0, CROP_PX // 2, CROP_PX // 2), np.float32)
    edges = ("right_lateral", "right_medial", "left_lateral", "left_medial")
    return Network(
        session=KnownSession(lambda _: output),
        settings=NetworkSettings(crop_px=CROP_PX, plateau_px=0.0, stride=2, landmarks=edges, masks=()),
    )


def test_both_knees_are_found_from_the_left_to_the_right_of_the_viewer():
    places = [(50.0, 12.0), (50.0, 34.0), (54.0, 84.0), (54.0, 62.0)]
    knees = find_knees(np.ones((192, 192), np.float32), locate_fixed(places, (4, 4, 4, 4)), 0.3)
    assert [knee.frame.side for knee in knees] == ["right", "left"]
    np.testing.assert_allclose([knee.frame.width_px for knee in knees], 44.0, atol=0.5)
    np.testing.assert_allclose([knee.frame.angle_rad for knee in knees], 0.0, atol=0.02)


@pytest.mark.parametrize(("heights", "side"), [((4, 4, 2, 2), "right"), ((1, 4, 3, 3), "left")])
def test_one_knee_has_the_side_with_the_higher_score(heights, side):
    places = [(50.0, 30.0), (50.0, 66.0), (50.0, 66.0), (50.0, 30.0)]
    (knee,) = find_knees(np.ones((96, 96), np.float32), locate_fixed(places, heights), 0.3)
    assert knee.frame.side == side


def test_knee_whose_edges_are_exchanged_is_not_reported():
    places = [(50.0, 66.0), (50.0, 30.0), (50.0, 30.0), (50.0, 66.0)]
    assert find_knees(np.ones((96, 96), np.float32), locate_fixed(places, (4, 4, -9, -9)), 0.3) == []


def test_landmark_file_is_read_as_it_was_written(tmp_path):
    places = {name: (10.5 + k, 20.25 - k) for k, name in enumerate(CONTOUR_LANDMARKS)}
    path = write_pts(tmp_path / "a.pts", places)
    assert read_pts(path, CONTOUR_LANDMARKS) == places
    with pytest.raises(InputError, match="must have 15 lines of column and row"):
        read_pts(path, CONTOUR_LANDMARKS[:15])


@pytest.mark.parametrize("text", ["", "{\n1 2\n}", "{\na b\n}", "{\n" + "1 nan\n" * 16 + "}"])
def test_damaged_landmark_file_is_refused(tmp_path, text):
    (tmp_path / "a.pts").write_text(text)
    with pytest.raises(InputError, match=r"a\.pts must have"):
        read_pts(tmp_path / "a.pts", CONTOUR_LANDMARKS)


def test_missing_landmark_file_is_refused(tmp_path):
    with pytest.raises(InputError, match=r"a\.pts must have"):
        read_pts(tmp_path / "a.pts", CONTOUR_LANDMARKS)


def make_template(plateau_mm=72.0):
    """Return a template of which only the plateau width matters."""
    return SimpleNamespace(plateau_mm=plateau_mm, known_plateau_mm=plateau_mm)


@pytest.mark.parametrize("side", ["right", "left"])
def test_region_of_the_reader_is_at_the_medial_joint_line(side):
    frame = KneeFrame(centre_px=(150.0, 210.0), width_px=120.0, angle_rad=0.1, side=side)
    joint = locate_joint_by_reader(draw_film(frame), make_template(), side=side, pixel_mm=0.6, reader=make_reader())
    assert (joint.status, joint.side, joint.pixel_mm_source) == ("found", side, "given")
    places = dict(zip(CONTOUR_LANDMARKS, place_landmarks(frame), strict=True))
    middle = (places["femur_medial_condyle"] + places["tibia_medial_1"]) / 2
    # The offset from the middle of the landmarks points towards the lateral side, along the plateau.
    offset = np.array([joint.row, joint.col]) - middle
    lateral = places["tibia_lateral_edge"] - places["tibia_medial_edge"]
    along = offset @ lateral / np.linalg.norm(lateral) / 120
    assert along == pytest.approx(0.0355, abs=0.002)
    assert joint.scale == pytest.approx(1.0, abs=0.01)
    (knee,) = read(draw_film(frame), reader=make_reader())
    np.testing.assert_array_equal(joint.bones, knee.masks["femur"] | knee.masks["tibia"])


def test_shape_features_describe_the_bones_of_the_reader():
    rng = np.random.default_rng(5)
    region = rng.integers(100, 4000, (128, 128))
    bones = np.zeros((128, 128), bool)
    bones[20:70, 30:110] = True
    measured = {
        name: extract_features(region, 0.3, load_ibsi_tags(), families=("firstorder", "shape2D"), bones=given)
        for name, given in (("reader", bones), ("segmented", None))
    }
    area = next(name for name in measured["reader"] if name.endswith("PixelSurface"))
    assert measured["reader"][area] == pytest.approx(50 * 80 * 0.3**2)
    assert measured["segmented"][area] != measured["reader"][area]
    for name, value in measured["segmented"].items():
        if name.startswith("firstorder"):
            assert measured["reader"][name] == value


def test_unknown_pixel_size_follows_from_the_plateau():
    frame = KneeFrame(centre_px=(150.0, 210.0), width_px=120.0, angle_rad=0.0, side="left")
    joint = locate_joint_by_reader(
        draw_film(frame), make_template(60.0), side=None, pixel_mm=None, reader=make_reader()
    )
    assert (joint.side, joint.pixel_mm_source) == ("left", "plateau")
    assert joint.pixel_mm == pytest.approx(0.5, abs=0.005)


@pytest.mark.parametrize(
    ("status", "side", "region_px", "thresholds"),
    [
        ("no knee", "right", 1, {"min_score": 1.1}),
        ("wrong side", "left", 1, {}),
        ("low score", "right", 1, {"min_confidence": 1.1}),
        ("leaves image", "right", 320, {}),
    ],
)
def test_region_of_the_reader_is_rejected_for_a_reason(status, side, region_px, thresholds):
    frame = KneeFrame(centre_px=(150.0, 210.0), width_px=120.0, angle_rad=0.0, side="right")
    joint = locate_joint_by_reader(
        draw_film(frame),
        make_template(),
        side=side,
        pixel_mm=0.6,
        region_px=region_px,
        reader=make_reader(**thresholds),
    )
    assert joint.status == status
    assert np.isnan(joint.row) == (status == "no knee")


def test_polarity_is_that_of_the_bones():
    frame = KneeFrame(centre_px=(150.0, 210.0), width_px=120.0, angle_rad=0.0, side="right")
    (knee,) = read(draw_film(frame), reader=make_reader())
    bones = knee.masks["femur"] | knee.masks["tibia"]
    assert find_polarity(np.where(bones, 3.0, 1.0), knee) == "bone bright"
    assert find_polarity(np.where(bones, 1.0, 3.0), knee) == "bone dark"


def test_region_of_the_truth_is_at_the_label():
    chosen = {"templates": (), "table": None, "side": "left", "pixel_mm": 0.3, "regions": "truth"}
    joint = locate_region(np.ones((80, 90)), region_px=40, place_px=(30.25, 50.5), **chosen)
    assert (joint.status, joint.row, joint.col, joint.side) == ("found", 30.25, 50.5, "left")
    assert locate_region(np.ones((80, 90)), region_px=70, place_px=(30.25, 50.5), **chosen).status == "leaves image"
    with pytest.raises(InputError, match="no true position"):
        locate_region(np.ones((80, 90)), region_px=40, place_px=None, **chosen)


def test_file_is_read_with_its_picture_and_rows(tmp_path):
    frame = KneeFrame(centre_px=(150.0, 210.0), width_px=120.0, angle_rad=0.0, side="right")
    film = np.clip(100 * draw_film(frame), 0, 255).astype(np.uint8)
    path = write_image_row([film], tmp_path / "knee.png")
    knees = read(path, pixel_mm=0.6, reader=make_reader())
    (knee,) = knees
    ((row,), (made,)) = knees.rows(), make_rows(str(path), read(film, pixel_mm=0.6, reader=make_reader()))
    # A file is read with grey values from 0 to 1.
    assert row == {key: pytest.approx(value, abs=0.01) for key, value in made.items()}
    assert row["plateau_width_mm"] == pytest.approx(72.0, abs=0.5)
    drawn = knees.draw()
    assert drawn.shape == (300, 400, 3)
    shown = np.asarray(Image.open(io.BytesIO(knees._repr_png_())))
    np.testing.assert_array_equal(shown, drawn)
    again = pickle.loads(pickle.dumps(knees))
    assert again.rows() == [row]
    assert again[0].landmarks_px == knee.landmarks_px


def test_missing_file_is_refused(tmp_path):
    with pytest.raises(InputError, match=r"none\.png"):
        read(tmp_path / "none.png", reader=make_reader())


@pytest.mark.parametrize("side", ["right", "left"])
@pytest.mark.parametrize(("locator_logit", "decided"), [(1.0, True), (-1.0, True), (-4.0, False)])
def test_side_follows_from_both_networks(side, locator_logit, decided):
    """The side network is sure with a logit of 6, of which half counts."""
    frame = KneeFrame(centre_px=(150.0, 210.0), width_px=120.0, angle_rad=0.1, side=side)
    film = draw_film(frame).astype(np.float32)
    other = "left" if side == "right" else "right"
    shown = replace(frame, side=side if locator_logit > 0 else other)
    knee = KneeCandidate(frame=shown, score=0.9, side_logit=abs(locator_logit))
    ((made, sure),) = decide_sides(film, [knee], make_reader().sides)
    assert (made.frame.side == side) == decided
    evidence = abs(3.0 + locator_logit)
    assert sure == pytest.approx(1 / (1 + np.exp(-evidence)), rel=1e-4)


def test_two_knees_have_different_sides():
    right = KneeFrame(centre_px=(150.0, 100.0), width_px=100.0, angle_rad=0.0, side="right")
    left = KneeFrame(centre_px=(150.0, 300.0), width_px=100.0, angle_rad=0.0, side="left")
    film = (draw_film(right) + draw_film(left)).astype(np.float32)
    # The first network has exchanged the sides, and is unsure of one of them.
    wrong = [
        KneeCandidate(frame=replace(right, side="left"), score=0.9, side_logit=0.1),
        KneeCandidate(frame=replace(left, side="right"), score=0.9, side_logit=4.0),
    ]
    decided = decide_sides(film, wrong, make_reader().sides)
    assert [knee.frame.side for knee, _ in decided] == ["right", "left"]
    assert decided[0][1] == decided[1][1]
