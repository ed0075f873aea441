"""Data sets of labelled images: plans, files, label maps, randomisation and resumption."""

import csv
import dataclasses
import json
import tarfile
from importlib.util import find_spec

import numpy as np
import pytest
import tifffile
from command_line import run as run_pssf
from command_line import run_in_process
from PIL import Image

import pssf
from pssf.data.imaging.dataset_table import load_dataset_table
from pssf.dataset import (
    RECIPES,
    TRANSFORMS,
    DatasetSettings,
    count_parts,
    load_dataset_tables,
    make_dataset,
    make_sample,
    make_subject_samples,
    plan_subject,
    randomise,
    verify_dataset,
)
from pssf.dataset.coco_instances import decode_run_lengths, encode_run_lengths, make_annotations
from pssf.dataset.dataset_plan import find_part
from pssf.dataset.dataset_summary import summarise_index
from pssf.dataset.label_map import add_joint_space_masks, draw_label_map

SMALL = {"matrix": 96, "seed": 5}
VALUES = load_dataset_table().label_map


def plan(settings, tables, subjects):
    """Plan the images of subjects."""
    return [image for subject in subjects for image in plan_subject(settings, tables, subject, "train")]


@pytest.fixture(scope="module")
def sample_of_knee():
    """Plan and sample of one small image with settings and tables."""
    settings = DatasetSettings(images=4, **SMALL)
    tables = load_dataset_tables(settings)
    planned = plan(settings, tables, [0])[0]
    return planned, make_sample(planned, settings, tables), settings, tables


@pytest.mark.parametrize("pairs", ["none", "visit"])
def test_a_bilateral_protocol_gives_one_crop_of_the_same_radiograph_per_knee(pairs):
    settings = DatasetSettings(
        images=4, knees_per_subject=2, protocols=("bilateral",), crop_mm=140.0, crop_shift_mm=0.0, pairs=pairs, **SMALL
    )
    tables = load_dataset_tables(settings)
    planned = plan_subject(settings, tables, 0, "train")
    per_knee = 1 if pairs == "none" else 2
    right, left = planned[:per_knee], planned[per_knee:]
    for one, two in zip(right, left, strict=True):
        assert (one.knee, one.other) == (two.other, two.knee)
        assert (one.protocol, one.seed) == (two.protocol, two.seed)
        assert (one.knee.side, two.knee.side) == ("right", "left")
    samples = [make_sample(image, settings, tables) for image in (right[0], left[0])]
    radiograph = pssf.simulate(
        (right[0].knee, left[0].knee), right[0].protocol, rng=right[0].seed, engine=settings.engine
    )
    for sample, truth in zip(samples, radiograph.truths, strict=True):
        crop = sample.labels["crop"]
        rows, cols = (slice(crop[name], crop[name] + SMALL["matrix"]) for name in ("top_px", "left_px"))
        assert np.array_equal(sample.linear, radiograph.pixels[rows, cols])
        assert sample.labels["jsw_medial_mm"] == truth.jsw_medial_mm
        row, col = truth.landmarks_px["joint_centre"]
        assert sample.landmarks_px["joint_centre"] == (row - crop["top_px"], col - crop["left_px"])
        assert {sample.labels["side"], sample.labels["other_knee"]["side"]} == {"right", "left"}


def test_one_knee_per_subject_in_a_bilateral_radiograph_is_the_same_knee_as_in_other_protocols():
    one = DatasetSettings(images=6, **SMALL)
    two = dataclasses.replace(one, protocols=("bilateral",), crop_mm=140.0)
    plans = [plan(settings, load_dataset_tables(settings), range(6)) for settings in (one, two)]
    assert [image.knee for image in plans[0]] == [image.knee for image in plans[1]]
    assert all(image.other is None for image in plans[0])
    assert all({image.knee.side, image.other.side} == {"right", "left"} for image in plans[1])


@pytest.mark.parametrize("changes", [{}, {"knees_per_subject": 2}, {"pairs": "visit"}, {"layout": "shards"}])
def test_parts_cover_every_subject_once_without_mixing_subsets(changes):
    settings = DatasetSettings(images=101, shard_images=20, **changes)
    parts = [find_part(settings, index) for index in range(count_parts(settings))]
    subjects = [subject for part in parts for subject in range(part.first, part.first + part.count)]
    assert subjects == list(range(settings.subject_count))
    assert settings.subject_count * settings.images_per_subject >= 101
    fractions = [sum(part.count for part in parts if part.split == name) for name in ("train", "validation", "test")]
    assert np.allclose(np.array(fractions) / settings.subject_count, settings.split, atol=1 / settings.subject_count)
    with pytest.raises(IndexError, match="part must be an index below"):
        find_part(settings, len(parts))


def test_a_balanced_plan_has_the_same_number_of_subjects_of_each_grade_and_names_tell_nothing():
    settings = DatasetSettings(images=40, knees_per_subject=2, split=(1.0, 0.0, 0.0))
    tables = load_dataset_tables(settings)
    planned = plan(settings, tables, range(settings.subject_count))
    grades = [image.knee.grade for image in planned]
    assert [grades.count(grade) for grade in range(5)] == [8] * 5
    assert len({image.name for image in planned}) == 40
    assert len({image.subject for image in planned}) == 20
    for right, left in zip(planned[::2], planned[1::2], strict=True):
        assert (right.subject, right.knee.side, left.knee.side) == (left.subject, "right", "left")
        assert right.knee.stature_mm == left.knee.stature_mm
    # The order of the names is independent of the grades: a rank correlation of 40 grades has a spread of 0.16.
    order = np.argsort(np.argsort([image.name for image in planned]))
    assert abs(np.corrcoef(order, grades)[0, 1]) < 4 * 0.16


def test_prevalence_gives_grades_the_frequencies_of_the_osteoarthritis_initiative():
    settings = DatasetSettings(images=1000, grades="prevalence", split=(1.0, 0.0, 0.0))
    tables = load_dataset_tables(settings)
    planned = plan(settings, tables, range(160))
    counts = np.bincount([image.knee.grade for image in planned], minlength=5)
    share = np.array(tables.definitions.grades.prevalence) / 8260
    spread = np.sqrt(share * (1 - share) / len(planned))
    assert (abs(counts / len(planned) - share) < 4 * spread).all()


def test_pairs_differ_only_in_what_their_change_says():
    for pairs, protocols in (("lesion", 1), ("visit", 1), ("protocol", 2)):
        names = ("fixed_flexion", "reference")[:protocols]
        settings = DatasetSettings(images=20, pairs=pairs, protocols=names, seed=3)
        tables = load_dataset_tables(settings)
        planned = plan(settings, tables, range(4))
        for first, second in zip(planned[::2], planned[1::2], strict=True):
            assert (first.pair, first.role, second.role) == (second.pair, "first", "second")
            assert first.subject == second.subject
            if pairs == "lesion":
                kind = first.change["lesion"] + "s"
                before, after = (len(getattr(image.knee, kind)) for image in (first, second))
                assert after - before == (1 if first.change["added"] else -1)
                assert first.protocol == second.protocol
                assert first.appearance_seed == second.appearance_seed
                assert first.seed != second.seed
                # The sampled and the changed grade differ by the change of the derived grade, in its direction.
                step = second.knee.grade - first.knee.grade
                assert first.change["grade_change"] == step
                assert step >= 0 if first.change["added"] else step <= 0
                grades = {"grade": first.knee.grade, "reader_grade": first.knee.reader_grade}
                unchanged = dataclasses.replace(first.knee, **{kind: (), "grade": None})
                assert dataclasses.replace(second.knee, **{kind: (), **grades, "grade": None}) == unchanged
            elif pairs == "visit":
                assert pssf.true_change(first.knee, second.knee).items() <= first.change.items()
            else:
                assert first.knee == second.knee
                assert (first.protocol.name, second.protocol.name) == names


def test_the_label_map_holds_the_masks_and_the_joint_space_lies_between_the_bones(sample_of_knee):
    _, sample, _, tables = sample_of_knee
    values = tables.definitions.label_map
    assert set(np.unique(sample.label_map)) <= set(values.values())
    for side in ("medial", "lateral"):
        space = sample.masks[f"{side}_joint_space"]
        assert space.any()
        assert not (space & (sample.masks["femur"] | sample.masks["tibia"])).any()
        for col in np.flatnonzero(space.any(axis=0)):
            column = np.flatnonzero(space[:, col])
            assert sample.masks["femur"][column[0] - 1, col]
            assert sample.masks["tibia"][column[-1] + 1, col]
    only_femur = sample.masks["femur"] & ~np.logical_or.reduce(
        [mask for name, mask in sample.masks.items() if name != "femur"]
    )
    assert (sample.label_map[only_femur] == values["femur"]).all()


def test_masks_without_frontal_landmarks_have_no_joint_space():
    masks = {"femur": np.ones((3, 3), bool), "tibia": np.zeros((3, 3), bool)}
    assert add_joint_space_masks(masks, {}).keys() == masks.keys()
    assert draw_label_map({"screw_1": masks["femur"]}, {"femur": 1, "implant": 9}, (3, 3)).tolist() == [[9] * 3] * 3


def test_a_crop_is_the_same_image_about_the_joint_and_its_landmarks_follow(sample_of_knee):
    planned, whole, settings, tables = sample_of_knee
    side_mm = 40 * whole.pixel_mm
    cropped = make_sample(planned, dataclasses.replace(settings, crop_mm=side_mm, matrix=40), tables)
    crop = cropped.labels["crop"]
    rows, cols = (slice(crop[f"{edge}_px"], crop[f"{edge}_px"] + 40) for edge in ("top", "left"))
    assert (cropped.linear == whole.linear[rows, cols]).all()
    assert (cropped.label_map == whole.label_map[rows, cols]).all()
    row, col = cropped.landmarks_px["joint_centre"]
    # The shift is at most twice its standard deviation of 3 mm, and the crop has complete pixels.
    assert max(abs(row - 19.5), abs(col - 19.5)) * whole.pixel_mm <= 6 + whole.pixel_mm / 2
    assert (row + crop["top_px"], col + crop["left_px"]) == whole.landmarks_px["joint_centre"]


def test_a_crop_with_a_matrix_is_simulated_at_its_pixel_size():
    settings = DatasetSettings(images=1, crop_mm=140.0, matrix=224)
    (protocol,) = load_dataset_tables(settings).protocols
    assert protocol.pixel_mm == pytest.approx(140 / 224)
    nominal = pssf.load_protocol("fixed_flexion")
    for side in ("rows", "cols"):
        longer = getattr(protocol, side) * protocol.pixel_mm - getattr(nominal, side) * nominal.pixel_mm
        assert 0 <= longer < protocol.pixel_mm


@pytest.mark.parametrize("name", TRANSFORMS)
def test_each_transform_is_reproducible_and_only_the_affine_one_moves_labels(sample_of_knee, name):
    _, sample, _, _ = sample_of_knee
    once, again = (randomise(sample, (name,), np.random.default_rng(2), VALUES) for _ in range(2))
    assert (once.display == again.display).all()
    assert once.labels["randomised"] == [name]
    changed = any(
        (randomise(sample, (name,), np.random.default_rng(k), VALUES).display != sample.display).any() for k in range(8)
    )
    assert changed
    moved = once.landmarks_px != sample.landmarks_px
    assert moved == (name == "affine")
    assert (once.linear != sample.linear).any() == (name == "affine")


def test_affine_landmarks_stay_on_their_anatomy(sample_of_knee):
    _, sample, _, _ = sample_of_knee
    rows, cols = np.indices(sample.linear.shape)
    for row, col in ((40, 50), (60, 30)):
        blob = np.exp(-((rows - row) ** 2 + (cols - col) ** 2) / 18)
        marked = dataclasses.replace(
            sample, linear=np.rint(blob * 60000).astype(np.uint16), landmarks_px={"blob": (float(row), float(col))}
        )
        for seed in range(5):
            moved = randomise(marked, ("affine",), np.random.default_rng(seed), VALUES)
            weights = moved.linear / moved.linear.sum()
            centre = ((weights * rows).sum(), (weights * cols).sum())
            assert moved.landmarks_px["blob"] == pytest.approx(centre, abs=0.05)
            assert moved.pixel_mm != sample.pixel_mm


def test_sampled_equipment_varies_and_keeps_a_view_without_grid():
    settings = DatasetSettings(images=40, equipment="sampled", protocols=("fixed_flexion", "reference"))
    tables = load_dataset_tables(settings)
    values = tables.definitions.equipment
    planned = plan(settings, tables, range(40))
    for name in ("focal_spot_mm", "filtration_mm_al", "grid_ratio", "grid_lines_per_cm"):
        of_stand = {getattr(image.protocol, name) for image in planned if image.protocol.name == "fixed_flexion"}
        assert 1 < len(of_stand) <= len(getattr(values, name))
        assert of_stand <= set(getattr(values, name))
    assert {image.protocol.grid_ratio for image in planned if image.protocol.name == "reference"} == {0.0}


@pytest.mark.parametrize("fractions", [(0.3333333,) * 3, (0.3333334,) * 3])
def test_rounded_fractions_lose_no_subject(fractions):
    settings = DatasetSettings(images=10_000_000, split=fractions, layout="shards", shard_images=20_000)
    last = find_part(settings, count_parts(settings) - 1)
    assert last.first + last.count == settings.subject_count


def test_an_edited_grade_table_is_another_data_set(tmp_path):
    table = tmp_path / "mine.toml"
    table.write_text('base = "paper"\n[grade.2]\njsw_medial_mm = [2.0, 2.5]\n')
    settings = DatasetSettings(images=1, grade_table=str(table), matrix=32)
    make_dataset(settings, tmp_path / "set", workers=1)
    table.write_text('base = "paper"\n[grade.2]\njsw_medial_mm = [2.0, 2.4]\n')
    # A process reads a table once, so the edited table is used by a new process.
    options = ["--images", "1", "--matrix", "32", "--grade-table", table, "--out", tmp_path / "set"]
    result = run_in_process("dataset", *options, "--workers", "1")
    assert result.returncode == 2
    assert "contains a different dataset (grade_table.grade.2.jsw_medial_mm" in result.stderr


def test_a_landmark_in_the_padding_of_a_crop_is_not_visible():
    entry = {"rows": 10, "cols": 10, "kl": 1, "instances": [{"category_id": 100, "name": "knee"}]}
    entry |= {"landmarks_px": {"in": [5.0, 5.0], "padding": [5.0, 1.0]}}
    entry |= {"crop": {"top_px": 0, "left_px": -3, "whole_rows": 50, "whole_cols": 50}}
    (knee,) = make_annotations(entry, ["in", "padding", "other_view"], 1, 1)
    assert knee["keypoints"] == [5.0, 5.0, 2, 0, 0, 0, 0, 0, 0]
    assert knee["num_keypoints"] == 1
    # The same place one row further up, before a shift of the image by one row.
    moved = {**entry, "crop": {**entry["crop"], "left_px": 0}, "landmarks_px": {"in": [0.2, 5.0]}}
    moved["affine"] = {"matrix": [[1, 0], [0, 1]], "offset_px": [1.0, 0.0]}
    (knee,) = make_annotations(moved, ["in"], 1, 1)
    assert knee["num_keypoints"] == 0


def test_an_index_is_summarised_in_one_pass():
    rows = [
        {"split": "train", "kl": 1, "subject": "a", "x": None, "y": 1, "z": True},
        {"split": "train", "kl": 1, "subject": "a", "x": 2, "y": 1.5, "z": "no"},
        {"split": "test", "kl": 0, "subject": "b", "w": None, "x": None},
    ]
    summary = summarise_index(rows)
    kinds = {"split": "text", "kl": "integer", "subject": "text", "x": "integer", "y": "decimal", "z": "text"}
    assert summary.columns == {**kinds, "w": "text"}
    assert (summary.subjects, summary.images, summary.counts["train", 1]) == (2, 3, 2)


def test_run_lengths_reproduce_a_mask():
    rng = np.random.default_rng(1)
    for mask in (rng.random((7, 5)) < 0.5, np.ones((3, 2), bool), np.zeros((3, 2), bool)):
        coded = encode_run_lengths(mask)
        assert sum(coded["counts"]) == mask.size
        assert (decode_run_lengths(coded) == mask).all()
        if find_spec("pycocotools"):
            from pycocotools import mask as coco_mask

            assert (coco_mask.decode(coco_mask.frPyObjects(coded, *mask.shape)) == mask).all()


def _read_files(folder):
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def test_a_data_set_has_the_same_bytes_for_any_workers_and_after_an_interruption(tmp_path):
    settings = DatasetSettings(images=4, split=(0.5, 0.25, 0.25), maps=("cortical_bone",), randomise=("mild",), **SMALL)
    make_dataset(settings, tmp_path / "one", workers=1)
    expected = _read_files(tmp_path / "one")
    make_dataset(settings, tmp_path / "two", workers=2)
    assert _read_files(tmp_path / "two") == expected
    # A killed run leaves files without a record; a lost image makes its part incomplete.
    (tmp_path / "two/records/part-000000.json").unlink()
    next((tmp_path / "two/test/linear").iterdir()).unlink()
    (tmp_path / "two/index.csv").unlink()
    kept, made = [], []
    make_dataset(settings, tmp_path / "two", workers=1, progress=made.append, on_kept=kept.append)
    assert (sum(kept), sum(made)) == (1, 3)
    assert _read_files(tmp_path / "two") == expected
    assert verify_dataset(tmp_path / "two") == (4, [])
    _require_readable(tmp_path / "two", settings)
    damaged = next((tmp_path / "two/train/linear").iterdir())
    damaged.write_bytes(b"")
    (tmp_path / "two/notes.txt").touch()
    with open(tmp_path / "two/coco_train.json", "a") as file:
        file.write(" ")
    faults = [
        f"train/linear/{damaged.name}: changed",
        "coco_train.json: changed",
        "notes.txt: not part of the data set",
    ]
    assert verify_dataset(tmp_path / "two")[1] == faults
    with pytest.raises(pssf.InputError, match=r"must be unchanged, got other content; delete .*part-000000\.json"):
        make_dataset(settings, tmp_path / "two", workers=1)
    with pytest.raises(pssf.InputError, match=r"contains a different dataset \(settings\.seed = 5, requested 6\)"):
        make_dataset(dataclasses.replace(settings, seed=6), tmp_path / "one", workers=1)


def _require_readable(folder, settings):
    """Require that the files of a data set agree with each other."""
    tables = load_dataset_tables(settings)
    coco = json.loads((folder / "coco_train.json").read_text())
    assert len(coco["images"]) == 2
    for image in coco["images"]:
        name = image["file_name"].split("/")[-1].removesuffix(".png")
        display = np.array(Image.open(folder / image["file_name"]))
        labels = json.loads((folder / "train/labels" / f"{name}.json").read_text())
        linear = tifffile.imread(folder / "train/linear" / f"{name}.tif")
        assert display.shape == linear.shape == (image["height"], image["width"]) == (labels["rows"], labels["cols"])
        with tifffile.TiffFile(folder / "train/maps" / f"{name}.tif") as tiff:
            assert [page.tags["PageName"].value for page in tiff.pages] == ["cortical_bone"]
        *parts, knee = (one for one in coco["annotations"] if one["image_id"] == image["id"])
        whole = np.logical_or.reduce([decode_run_lengths(part["segmentation"]) for part in parts])
        assert (decode_run_lengths(knee["segmentation"]) == whole).all()
        assert knee["num_keypoints"] == len(labels["landmarks_px"])
        label_map = np.array(Image.open(folder / "train/label_map" / f"{name}.png"))
        assert {tables.definitions.label_map["femur"]} <= set(np.unique(label_map))
        assert {part["name"] for part in (*parts, knee)} == {part["name"] for part in labels["instances"]}
    header = (folder / "index.csv").read_text().splitlines()
    assert len(header) == 5


def test_parquet_and_croissant_describe_the_index(tmp_path):
    parquet = pytest.importorskip("pyarrow.parquet", reason="pyarrow (`parquet` extra) is not installed")
    settings = DatasetSettings(images=3, pairs="visit", parquet=True, split=(0.5, 0.5, 0.0), **SMALL)
    index = make_dataset(settings, tmp_path, workers=1)
    with index.open(newline="") as file:
        rows = list(csv.DictReader(file))
    table = parquet.read_table(tmp_path / "index.parquet")
    assert table.column_names == list(rows[0])
    for row, typed in zip(rows, table.to_pylist(), strict=True):
        for name, value in typed.items():
            if isinstance(value, float):
                assert float(row[name]) == value
            else:
                assert row[name] == ("" if value is None else str(value))
    sheet = (tmp_path / "datasheet.md").read_text()
    assert "4 simulated knee radiographs of 2 subjects" in sheet
    assert "{" not in sheet
    croissant = json.loads((tmp_path / "croissant.json").read_text())
    fields = croissant["recordSet"][0]["field"]
    assert [one["name"].removeprefix("index/") for one in fields] == table.column_names
    mlcroissant = pytest.importorskip("mlcroissant", reason="mlcroissant is not installed")
    read = mlcroissant.Dataset(jsonld=tmp_path / "croissant.json")
    assert not read.metadata.ctx.issues.errors
    records = list(read.records("index"))
    assert [record["index/kl"] for record in records] == [int(row["kl"]) for row in rows]
    images = list(read.records("display_by_name"))
    assert {image["display_by_name/name"].decode() for image in images} == {f"{row['name']}.png" for row in rows}


def test_shards_hold_all_files_of_an_image_under_one_key(tmp_path):
    settings = DatasetSettings(images=3, layout="shards", shard_images=2, split=(1.0, 0.0, 0.0), **SMALL)
    make_dataset(settings, tmp_path, workers=1)
    first, second = sorted((tmp_path / "train").iterdir())
    assert (first.name, second.name) == ("train-000000.tar", "train-000001.tar")
    with tarfile.open(first) as tar:
        members = tar.getnames()
        assert {entry.mtime for entry in tar.getmembers()} == {0}
    keys = {name.split(".", 1)[0] for name in members}
    assert len(keys) == 2
    assert {name.split(".", 1)[1] for name in members} == {"label_map.png", "linear.tif", "display.png", "json"}
    assert verify_dataset(tmp_path) == (3, [])


def test_grey_transforms_change_only_the_image_for_display(sample_of_knee):
    _, sample, settings, tables = sample_of_knee
    strong = dataclasses.replace(settings, randomise=("gamma", "noise"))
    (changed,) = make_subject_samples(strong, tables, 0, "train")
    assert (changed.linear == sample.linear).all()
    assert (changed.display != sample.display).any()


def test_a_subject_whose_knee_cannot_be_built_is_sampled_again_with_the_same_grade(monkeypatch, sample_of_knee):
    _, sample, settings, tables = sample_of_knee
    asked = []

    def refuse_twice(planned, settings, tables):
        asked.append(planned)
        if len(asked) < 3:
            raise pssf.InputError("knee must be possible, got another")
        return make_sample(planned, settings, tables)

    monkeypatch.setattr("pssf.dataset.subject_samples.make_sample", refuse_twice)
    (made,) = make_subject_samples(settings, tables, 0, "train")
    assert (made.labels["attempt"], made.labels["kl"]) == (2, sample.labels["kl"])
    assert len({planned.knee for planned in asked}) == len({planned.name for planned in asked}) == 3
    (again,) = make_subject_samples(settings, tables, 0, "train")
    assert again.labels == {**sample.labels, "attempt": 0}
    monkeypatch.setattr(
        "pssf.dataset.subject_samples.make_sample", lambda *_: (_ for _ in ()).throw(pssf.InputError("no"))
    )
    with pytest.raises(pssf.InputError, match="no"):
        make_subject_samples(settings, tables, 0, "train")


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--randomise", "mild,gamma"], "randomise must list each transform once, got gamma twice"),
        (["--randomise", "gama"], "randomise must be one of mild, strong, affine"),
        (["--split", "0.5,0.5"], "split must be three fractions, such as 0.7,0.15,0.15, got '0.5,0.5'"),
        (["--split", "0.5,0.5,0.5"], "the sum 1, got 0.5, 0.5, 0.5"),
        (["--pairs", "protocol"], "protocols must be exactly two names for pairs = protocol, got 1"),
        (["--protocols", "bilateral"], "crop_mm must be above 0 for the protocol bilateral, got 0 mm"),
        (["--crop-mm", "900"], "crop_mm must be at most"),
        (["--kinds", ""], "kinds must be one or more of linear, display, got none"),
        (["--layout", "zip"], "layout must be one of folder, shards, got 'zip'"),
        (["--images", "0"], "images must be"),
        (["--maps", "butter"], "maps must be"),
        (["--split", "nan,0.5,0.5"], "the sum 1, got nan, 0.5, 0.5"),
        (["--engine", "ray"], "engine must be one of embree, scanline, got 'ray'"),
        ([], "out must be a folder for the data set, got out = none: add --out FOLDER"),
    ],
)
def test_wrong_settings_give_one_line_and_exit_code_2(options, message, tmp_path):
    out = ["--out", str(tmp_path / "set")] if options else []
    count = [] if "--images" in options else ["--images", "2"]
    result = run_pssf("dataset", *count, *options, *out)
    assert result.returncode == 2
    assert message in result.stderr
    assert len(result.stderr.strip().splitlines()) == 1


def test_recipes_consist_of_known_transforms():
    assert all(name in TRANSFORMS for names in RECIPES.values() for name in names)


def test_a_dry_run_estimates_the_cost_and_writes_nothing(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    options = ["--images", "7200", "--matrix", "48", "--layout", "shards", "--workers", "2", "--dry-run"]
    result = run_pssf("dataset", *options)
    assert result.returncode == 0, result.stderr
    lines = dict(line.split(maxsplit=1) for line in result.stdout.splitlines())
    # 7,200 images in shards of 100 give 51 + 11 + 11 shards with one record each.
    assert lines["images"] == "7,200 in 146 files"
    cpu, run = (float(lines[name].split(maxsplit=1)[1].split()[0]) for name in ("CPU", "run"))
    assert run == pytest.approx(cpu / 2, abs=0.06)
    assert lines["run"].endswith("h with 2 workers on as many cores")
    assert lines["disk"].endswith(" MB")
    assert not list(tmp_path.iterdir())
