"""Check predictions for films with a saved model (`pssf predict`)."""

import dataclasses
import io
import json
import sys
import zipfile
from pathlib import Path, PurePosixPath

import block_knee_cohort
import numpy as np
import pandas as pd
import pytest
import skops.io
from numpy.testing import assert_allclose
from PIL import Image
from sklearn.pipeline import Pipeline
from sklearn.preprocessing import StandardScaler

import pssf
from pssf import cli
from pssf.io.cohort_records import hash_file
from pssf.io.patients.patient_radiographs import Film
from pssf.io.study_results import load_table
from pssf.radiomics.features.feature_table import TEXT_COLUMNS
from pssf.study.learn.models.model_bytes import unzip_files, zip_files
from pssf.study.learn.models.model_file import (
    SavedModel,
    _compress_pixels,
    _load_template,
    _make_template_record,
    describe_version_differences,
    unpack_model,
)
from pssf.study.prediction.film_prediction import predict_films


@pytest.fixture(scope="module")
def files(film_study) -> dict[str, Path]:
    return film_study.models


def load_model(path: Path) -> SavedModel:
    return unpack_model(path.read_bytes(), path.name)


def describe_film(path: Path, **more) -> Film:
    fields = {"grade": None, "subject": path.stem, "side": None, "pixel_mm": None}
    return Film(file=path.name, sha256=hash_file(path), **fields | more)


def run(monkeypatch, capsys, *arguments) -> tuple[int, str, str]:
    """Run the command line; return exit code, output and errors."""
    monkeypatch.setattr(sys, "argv", ["pssf", *map(str, arguments)])
    with pytest.raises(SystemExit) as ended:
        cli.main()
    captured = capsys.readouterr()
    return ended.value.code or 0, captured.out, captured.err


@pytest.fixture
def linear(tmp_path) -> tuple[Path, pd.Series]:
    """Save a linear radiograph of the block knee cohort; return its path and its row of the manifest."""
    row = block_knee_cohort.select_text_subjects().iloc[1]
    protocol = dataclasses.replace(pssf.load_protocol("reference"), rows=256, cols=256, pixel_mm=0.6)
    pixels = block_knee_cohort.make_cohort().load(row["file"])
    radiograph = pssf.Radiograph(pixels=pixels, protocol=protocol, seed=0, knee=pssf.Knee(side=row["side"]))
    return pssf.save(radiograph, tmp_path / "linear.tif"), row


def test_a_model_file_describes_the_images_it_was_trained_on(files):
    display, linear = (load_model(files[f"lr_l1_0v2_{on}"]) for on in ("films", "reference"))
    assert set(files) == {"lr_l1_0v2_films", "lr_l1_0v2_reference"}
    for model, reads in ((display, "display"), (linear, "linear")):
        assert model.card.reads == reads
        assert model.card.grades == (0, 2)
        assert model.card.grade_names == ("normal", "mild OA")
        assert model.card.subjects == model.card.radiographs == 10
        assert [(one.protocol, one.pixel_mm) for one in model.card.trained_on] == [("reference", 0.6)]
        assert {feature.split("_")[0] for feature in model.card.features} <= set(block_knee_cohort.LIGHT.families)
        assert model.templates[0].plateau_mm == block_knee_cohort.TEMPLATE.plateau_mm
        assert describe_version_differences(model.card) == ""
    assert (linear.card.pixel_mm, linear.card.region_px) == (0.6, 80)
    assert_allclose(display.card.pixel_mm * display.card.region_px, 48.0, atol=display.card.pixel_mm / 2)


@pytest.mark.parametrize("severe", [False, True])
def test_a_template_is_restored_unchanged_from_its_file_record(severe):
    kept = dataclasses.replace(
        block_knee_cohort.TEMPLATE, pixels=block_knee_cohort.TEMPLATE.pixels.astype(np.float32), severe=severe
    )
    back = _load_template(_make_template_record(kept), _compress_pixels(kept.pixels.tobytes()))
    for field in dataclasses.fields(kept):
        assert np.array_equal(getattr(back, field.name), getattr(kept, field.name)), field.name


def test_skops_alone_loads_the_pipeline_of_a_model_file(files):
    content = files["lr_l1_0v2_films"].read_bytes()
    pipeline = skops.io.loads(content, trusted=skops.io.get_untrusted_types(data=content))
    assert type(pipeline[-1]).__name__ == "LogisticRegression"
    assert list(pipeline[0].feature_names_in_) == list(load_model(files["lr_l1_0v2_films"]).card.features)
    assert b"pickle" not in content


def test_predicting_a_linear_file_gives_the_features_of_the_study(film_study, files, linear):
    path, row = linear
    model = load_model(files["lr_l1_0v2_reference"])
    done = predict_films(model, [describe_film(path)], path.parent)
    measured = load_table(film_study.tables["features"], TEXT_COLUMNS).set_index("radiograph").loc[row["radiograph"]]
    features = list(model.card.features)
    assert done.warnings == ()
    # The saved template is the averaged and cropped template of the study.
    assert_allclose(done.table[features].iloc[0], measured[features].astype(float), rtol=1e-9)
    assert done.table["film_polarity"].iloc[0] == "linear"
    assert_allclose(done.table["p grade 0"] + done.table["p grade 2"], 1.0)


def test_a_linear_file_of_both_knees_or_without_a_side_is_rejected(files, linear, tmp_path):
    single = pssf.load(linear[0])
    both = dataclasses.replace(single, knee=None, knees=(pssf.Knee(), pssf.Knee(side="left")))
    scene = dataclasses.replace(single, knee=None, scene={"ambient": "air", "surfaces": []})
    paths = [pssf.save(one, tmp_path / f"{name}.tif") for name, one in (("both", both), ("scene", scene))]
    model = load_model(files["lr_l1_0v2_reference"])
    done = predict_films(model, [describe_film(path) for path in paths], tmp_path)
    assert done.table["status"].tolist() == ["both knees", "side not given"]
    assert done.table["p grade 0"].isna().all()
    assert done.warnings == ()
    with_side = predict_films(model, [describe_film(paths[1], side=single.knee.side)], tmp_path).table.iloc[0]
    own = predict_films(model, [describe_film(linear[0])], linear[0].parent).table.iloc[0]
    assert with_side["status"] == "found"
    assert with_side["p grade 0"] == own["p grade 0"]


def test_a_linear_file_is_resampled_to_the_pixel_size_of_the_model(files, linear):
    path, _ = linear
    at_own = predict_films(load_model(files["lr_l1_0v2_reference"]), [describe_film(path)], path.parent).table.iloc[0]
    coarser = predict_films(
        load_model(files["lr_l1_0v2_reference"]), [describe_film(path, pixel_mm=0.61)], path.parent
    ).table.iloc[0]
    assert coarser["status"] == at_own["status"] == "found"
    assert coarser["film_pixel_mm"] == 0.61
    assert_allclose(coarser["shape2D_MeshSurface"], at_own["shape2D_MeshSurface"], rtol=0.08)


def test_a_model_of_linear_pixels_warns_about_display_images(files, tmp_path):
    path = block_knee_cohort.write_film(tmp_path / "f1R.png", 2, "right", 3)
    done = predict_films(load_model(files["lr_l1_0v2_reference"]), [describe_film(path)], tmp_path)
    assert done.table["status"].iloc[0] == "found"
    assert "trained on linear pixels" in done.warnings[0]
    assert predict_films(load_model(files["lr_l1_0v2_films"]), [describe_film(path)], tmp_path).warnings == ()


def test_predicting_films_again_gives_the_results_of_the_study(film_study, files):
    folder = film_study.report.parents[1] / "films"
    listed = pd.read_csv(film_study.tables["films"]).set_index("file")
    wanted = ["0/p001L.png", "3/p004R.png"]
    films = [film for film in block_knee_cohort.make_film_set(folder).films if film.file in wanted]
    done = predict_films(load_model(files["lr_l1_0v2_films"]), films, folder).table.set_index("file")
    for name in ("p grade 0", "p grade 2"):
        assert_allclose(done.loc[wanted, name], listed.loc[wanted, f"lr_l1_0v2_films {name[2:]}"], rtol=1e-9)
    assert list(done.loc[wanted, "film_side"]) == ["left", "right"]


def test_the_command_writes_a_table_an_image_and_a_line_per_film(files, tmp_path, monkeypatch, capsys):
    folder = tmp_path / "mine"
    block_knee_cohort.write_film(folder / "f1R.png", 2, "right", 3)
    air = np.random.default_rng(0).integers(90, 110, (200, 200)).astype(np.uint8)
    Image.fromarray(air).save(folder / "air.png")
    (folder / "torn.png").write_bytes(b"torn")
    other = block_knee_cohort.write_film(tmp_path / "f1R.png", 0, "right", 4, polarity="bone dark")
    out = tmp_path / "o"
    code, output, errors = run(
        monkeypatch, capsys, "predict", files["lr_l1_0v2_films"], folder, other, "--out", out, "--workers", 1
    )
    assert code == 0
    lines = dict(line.split("  ", 1) for line in output.splitlines())
    assert lines[f"{folder}/air.png"] == "rejected: no knee"
    assert lines[f"{folder}/torn.png"] == "rejected: unreadable"
    assert lines[f"{folder}/f1R.png"].startswith("grade 0 (normal) ")
    assert "torn.png" in errors
    table = pd.read_csv(out / "film_predictions.csv")
    assert list(table["status"]) == ["no knee", "found", "unreadable", "found"]
    assert list(table["p grade 2"].isna()) == [True, False, True, False]
    assert "glcm_Contrast" in table
    assert sorted(path.name for path in (out / "pictures").iterdir()) == ["air.png", "f1R.png", "f1R_2.png"]
    found, rejected = (np.asarray(Image.open(out / "pictures" / f"{name}.png")) for name in ("f1R", "air"))
    assert max(found.shape) == 800
    yellow, orange = ([240, 228, 66], [213, 94, 0])
    assert (found == yellow).all(axis=-1).sum() > 500
    assert (rejected == orange).all(axis=-1).sum() > 500


def test_side_and_pixel_size_can_be_set_by_options(files, tmp_path, monkeypatch, capsys):
    path = block_knee_cohort.write_film(tmp_path / "unnamed.png", 2, "left", 5)
    read = ("predict", files["lr_l1_0v2_films"], path, "--workers", 1)
    assert run(monkeypatch, capsys, *read, "--out", tmp_path / "a", "--side", "left", "--pixel-mm", 0.75)[0] == 0
    row = pd.read_csv(tmp_path / "a" / "film_predictions.csv").iloc[0]
    assert (row["film_pixel_mm"], row["film_pixel_from"], row["film_side"]) == (0.75, "given", "left")
    assert run(monkeypatch, capsys, *read, "--out", tmp_path / "b", "--side", "right")[0] == 0
    row = pd.read_csv(tmp_path / "b" / "film_predictions.csv").iloc[0]
    assert (row["film_side"], row["film_pixel_from"]) == ("right", "plateau")


def change_card(content: bytes, **changes) -> bytes:
    """Change entries of the model card in a model file."""
    members = unzip_files(content)
    card = json.loads(members["pssf/model.json"]) | changes
    return zip_files(members | {"pssf/model.json": json.dumps(card).encode()})


def remove_card(content: bytes) -> bytes:
    return zip_files({name: part for name, part in unzip_files(content).items() if name != "pssf/model.json"})


def remove_templates(content: bytes) -> bytes:
    return zip_files({name: part for name, part in unzip_files(content).items() if not name.endswith(".xz")})


def change_schema(content: bytes, change) -> bytes:
    """Change the skops schema of a model file."""
    members = unzip_files(content)
    return zip_files(members | {"schema.json": change(members["schema.json"].decode()).encode()})


def remove_array(content: bytes) -> bytes:
    return zip_files({name: part for name, part in unzip_files(content).items() if name != "0.npy"})


def replace_pipeline(content: bytes, replacement: object) -> bytes:
    """Replace the pipeline of a model file by another object; model card and templates stay unchanged."""
    members = {name: part for name, part in unzip_files(content).items() if name.startswith("pssf/")}
    return zip_files(members | unzip_files(skops.io.dumps(replacement)))


NO_MODEL = "content must be a model saved by pssf study (.skops), got a damaged file or another file type"


@pytest.mark.parametrize(
    ("damage", "why"),
    [
        (remove_array, f"{NO_MODEL} (KeyError"),
        (lambda content: change_schema(content, lambda text: "[" * 100_000), f"{NO_MODEL} (RecursionError"),
        (lambda content: change_schema(content, lambda text: text[:-9]), f"{NO_MODEL} (JSONDecodeError"),
        (lambda content: change_schema(content, lambda text: "{}"), f"{NO_MODEL} ("),
        (
            lambda content: change_schema(content, lambda text: text.replace("SimpleImputer", "Sumple")),
            NO_MODEL,
        ),
        (
            lambda content: replace_pipeline(content, PurePosixPath("x")),
            f"{NO_MODEL} (UntrustedTypesFoundException: Untrusted types found in the file: ['pathlib",
        ),
        (lambda content: replace_pipeline(content, {"a": 1}), "content must be a scikit-learn Pipeline, got dict"),
        (lambda content: replace_pipeline(content, Pipeline([("s", StandardScaler())])), f"{NO_MODEL} ("),
        (lambda content: b"not a zip", NO_MODEL),
        (lambda content: content[: len(content) // 2], NO_MODEL),
        (remove_card, NO_MODEL),
        (remove_templates, NO_MODEL),
        (
            lambda content: change_card(content, format="pssf model 9"),
            "format must be 'pssf model 1', got 'pssf model 9'",
        ),
        (lambda content: change_card(content, bins="many"), NO_MODEL),
    ],
)
def test_an_invalid_model_file_gives_a_one_line_error(damage, why, files, tmp_path, monkeypatch, capsys):
    path = tmp_path / "model.skops"
    path.write_bytes(damage(files["lr_l1_0v2_films"].read_bytes()))
    film = block_knee_cohort.write_film(tmp_path / "f1R.png", 2, "right", 3)
    code, _, errors = run(monkeypatch, capsys, "predict", path, film, "--out", tmp_path / "o")
    assert code == 2
    assert errors.startswith(f"pssf: file {path}: {why}")
    assert errors.count("\n") == 1
    assert not (tmp_path / "o").exists()


@pytest.mark.parametrize(
    ("more", "why"),
    [
        (("nowhere.png",), "file nowhere.png must be "),
        (("film.txt",), "file film.txt: suffix must be one of "),
        ((".", "--side", "up"), "side must be one of right, left, got 'up'"),
        ((".", "--pixel-mm", "-1"), "pixel-mm must be between 0.01 and 5 mm, got -1.0 mm"),
    ],
)
def test_invalid_films_give_a_one_line_error(more, why, files, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    code, _, errors = run(monkeypatch, capsys, "predict", files["lr_l1_0v2_films"], *more, "--out", "o")
    assert code == 2
    assert errors.startswith(f"pssf: {why}")
    assert errors.count("\n") == 1


def test_a_missing_model_file_gives_an_error(tmp_path, monkeypatch, capsys):
    code, _, errors = run(monkeypatch, capsys, "predict", tmp_path / "no.skops", "film.png", "--out", tmp_path / "o")
    assert code == 2
    assert "No such file" in errors


def test_a_model_of_other_versions_is_loaded_with_a_warning(files, tmp_path, monkeypatch, capsys):
    content = files["lr_l1_0v2_films"].read_bytes()
    made_by = json.loads(unzip_files(content)["pssf/model.json"])["made_by"]
    made_by["versions"]["numpy"] = "0.1"
    made_by["code"]["radiomics"] = "another"
    path = tmp_path / "model.skops"
    path.write_bytes(change_card(content, made_by=made_by))
    film = block_knee_cohort.write_film(tmp_path / "f1R.png", 2, "right", 3)
    code, output, errors = run(monkeypatch, capsys, "predict", path, film, "--out", tmp_path / "o", "--workers", 1)
    assert code == 0
    assert "numpy 0.1, here" in errors
    assert "different pssf code (radiomics)" in errors
    assert "grade 2 (mild OA)" in output


def test_display_images_need_a_template_with_a_plateau_width(files, tmp_path):
    model = load_model(files["lr_l1_0v2_films"])
    templates = tuple(dataclasses.replace(template, plateau_mm=None) for template in model.templates)
    path = block_knee_cohort.write_film(tmp_path / "f1R.png", 2, "right", 3)
    with pytest.raises(pssf.InputError, match="plateau_mm = None"):
        predict_films(dataclasses.replace(model, templates=templates), [describe_film(path)], tmp_path)


def test_entries_of_a_model_file_have_a_fixed_time_and_order(files):
    with zipfile.ZipFile(io.BytesIO(files["lr_l1_0v2_films"].read_bytes())) as packed:
        assert {part.date_time for part in packed.infolist()} == {(1980, 1, 1, 0, 0, 0)}
        assert [name for name in packed.namelist() if name.startswith("pssf/")] == [
            "pssf/model.json",
            "pssf/template_0.xz",
        ]


def test_prediction_without_films_raises_an_error(files):
    with pytest.raises(pssf.InputError, match="films must contain at least one patient radiograph, got 0"):
        predict_films(load_model(files["lr_l1_0v2_films"]), [], Path())
