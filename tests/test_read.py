"""A saved model on films: `pssf predict`."""

import dataclasses
import io
import json
import sys
import zipfile
from pathlib import Path, PurePosixPath

import drawn
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


def model_of(path: Path) -> SavedModel:
    return unpack_model(path.read_bytes(), path.name)


def film_of(path: Path, **more) -> Film:
    said = {"grade": None, "subject": path.stem, "side": None, "pixel_mm": None}
    return Film(file=path.name, sha256=hash_file(path), **said | more)


def run(monkeypatch, capsys, *arguments) -> tuple[int, str, str]:
    """Exit code, output and errors of the command line."""
    monkeypatch.setattr(sys, "argv", ["pssf", *map(str, arguments)])
    with pytest.raises(SystemExit) as ended:
        cli.main()
    said = capsys.readouterr()
    return ended.value.code or 0, said.out, said.err


@pytest.fixture
def linear(tmp_path) -> tuple[Path, pd.Series]:
    """A linear radiograph of the drawn cohort as a file of this package, and its row of the manifest."""
    row = drawn.text_subjects().iloc[1]
    protocol = dataclasses.replace(pssf.load_protocol("reference"), rows=256, cols=256, pixel_mm=0.6)
    pixels = drawn.cohort().load(row["file"])
    radiograph = pssf.Radiograph(pixels=pixels, protocol=protocol, seed=0, knee=pssf.Knee(side=row["side"]))
    return pssf.save(radiograph, tmp_path / "linear.tif"), row


def test_a_model_file_says_all_that_a_film_is_read_by(files):
    shown, linear = (model_of(files[f"lr_l1_0v2_{on}"]) for on in ("films", "reference"))
    assert set(files) == {"lr_l1_0v2_films", "lr_l1_0v2_reference"}
    for model, reads in ((shown, "display"), (linear, "linear")):
        assert model.card.reads == reads
        assert model.card.grades == (0, 2)
        assert model.card.grade_names == ("normal", "mild OA")
        assert model.card.subjects == model.card.radiographs == 10
        assert [(one.protocol, one.pixel_mm) for one in model.card.trained_on] == [("reference", 0.6)]
        assert {feature.split("_")[0] for feature in model.card.features} <= set(drawn.LIGHT.families)
        assert model.templates[0].plateau_mm == drawn.TEMPLATE.plateau_mm
        assert describe_version_differences(model.card) == ""
    assert (linear.card.pixel_mm, linear.card.region_px) == (0.6, 80)
    assert_allclose(shown.card.pixel_mm * shown.card.region_px, 48.0, atol=shown.card.pixel_mm / 2)


@pytest.mark.parametrize("severe", [False, True])
def test_a_template_comes_back_as_it_was_kept(severe):
    kept = dataclasses.replace(drawn.TEMPLATE, pixels=drawn.TEMPLATE.pixels.astype(np.float32), severe=severe)
    back = _load_template(_make_template_record(kept), _compress_pixels(kept.pixels.tobytes()))
    for field in dataclasses.fields(kept):
        assert np.array_equal(getattr(back, field.name), getattr(kept, field.name)), field.name


def test_whoever_has_skops_alone_loads_the_pipeline(files):
    content = files["lr_l1_0v2_films"].read_bytes()
    pipeline = skops.io.loads(content, trusted=skops.io.get_untrusted_types(data=content))
    assert type(pipeline[-1]).__name__ == "LogisticRegression"
    assert list(pipeline[0].feature_names_in_) == list(model_of(files["lr_l1_0v2_films"]).card.features)
    assert b"pickle" not in content


def test_a_linear_file_has_the_features_and_probability_of_the_study(film_study, files, linear):
    path, row = linear
    model = model_of(files["lr_l1_0v2_reference"])
    done = predict_films(model, [film_of(path)], path.parent)
    measured = load_table(film_study.tables["features"], TEXT_COLUMNS).set_index("radiograph").loc[row["radiograph"]]
    features = list(model.card.features)
    assert done.warnings == ()
    # The template is the study's, averaged and cut to what is read of it.
    assert_allclose(done.table[features].iloc[0], measured[features].astype(float), rtol=1e-9)
    assert done.table["film_polarity"].iloc[0] == "linear"
    assert_allclose(done.table["p grade 0"] + done.table["p grade 2"], 1.0)


def test_a_linear_file_of_both_knees_or_of_no_known_side_is_refused_with_the_reason(files, linear, tmp_path):
    made = pssf.load(linear[0])
    both = dataclasses.replace(made, knee=None, knees=(pssf.Knee(), pssf.Knee(side="left")))
    scene = dataclasses.replace(made, knee=None, scene={"ambient": "air", "surfaces": []})
    paths = [pssf.save(one, tmp_path / f"{name}.tif") for name, one in (("both", both), ("scene", scene))]
    model = model_of(files["lr_l1_0v2_reference"])
    done = predict_films(model, [film_of(path) for path in paths], tmp_path)
    assert done.table["status"].tolist() == ["both knees", "side not given"]
    assert done.table["p grade 0"].isna().all()
    assert done.warnings == ()
    told = predict_films(model, [film_of(paths[1], side=made.knee.side)], tmp_path).table.iloc[0]
    own = predict_films(model, [film_of(linear[0])], linear[0].parent).table.iloc[0]
    assert told["status"] == "found"
    assert told["p grade 0"] == own["p grade 0"]


def test_a_linear_file_of_another_pitch_is_brought_to_the_models(files, linear):
    path, _ = linear
    at_own = predict_films(model_of(files["lr_l1_0v2_reference"]), [film_of(path)], path.parent).table.iloc[0]
    coarser = predict_films(
        model_of(files["lr_l1_0v2_reference"]), [film_of(path, pixel_mm=0.61)], path.parent
    ).table.iloc[0]
    assert coarser["status"] == at_own["status"] == "found"
    assert coarser["film_pixel_mm"] == 0.61
    assert_allclose(coarser["shape2D_MeshSurface"], at_own["shape2D_MeshSurface"], rtol=0.08)


def test_a_model_of_linear_pixels_reads_displays_and_says_that_it_has_not_learnt_from_such(files, tmp_path):
    path = drawn.film(tmp_path / "f1R.png", 2, "right", 3)
    done = predict_films(model_of(files["lr_l1_0v2_reference"]), [film_of(path)], tmp_path)
    assert done.table["status"].iloc[0] == "found"
    assert "trained on linear pixels" in done.warnings[0]
    assert predict_films(model_of(files["lr_l1_0v2_films"]), [film_of(path)], tmp_path).warnings == ()


def test_reading_films_again_gives_what_the_study_found_on_them(film_study, files):
    folder = film_study.report.parents[1] / "films"
    listed = pd.read_csv(film_study.tables["films"]).set_index("file")
    wanted = ["0/p001L.png", "3/p004R.png"]
    films = [film for film in drawn.film_set(folder).films if film.file in wanted]
    done = predict_films(model_of(files["lr_l1_0v2_films"]), films, folder).table.set_index("file")
    for name in ("p grade 0", "p grade 2"):
        assert_allclose(done.loc[wanted, name], listed.loc[wanted, f"lr_l1_0v2_films {name[2:]}"], rtol=1e-9)
    assert list(done.loc[wanted, "film_side"]) == ["left", "right"]


def test_the_command_writes_a_table_and_a_picture_of_each_film_and_says_a_line_of_each(
    files, tmp_path, monkeypatch, capsys
):
    folder = tmp_path / "mine"
    drawn.film(folder / "f1R.png", 2, "right", 3)
    air = np.random.default_rng(0).integers(90, 110, (200, 200)).astype(np.uint8)
    Image.fromarray(air).save(folder / "air.png")
    (folder / "torn.png").write_bytes(b"torn")
    other = drawn.film(tmp_path / "f1R.png", 0, "right", 4, polarity="bone dark")
    out = tmp_path / "o"
    code, said, warned = run(
        monkeypatch, capsys, "predict", files["lr_l1_0v2_films"], folder, other, "--out", out, "--workers", 1
    )
    assert code == 0
    lines = dict(line.split("  ", 1) for line in said.splitlines())
    assert lines[f"{folder}/air.png"] == "rejected: no knee"
    assert lines[f"{folder}/torn.png"] == "rejected: unreadable"
    assert lines[f"{folder}/f1R.png"].startswith("grade 0 (normal) ")
    assert "torn.png" in warned
    table = pd.read_csv(out / "read.csv")
    assert list(table["status"]) == ["no knee", "found", "unreadable", "found"]
    assert list(table["p grade 2"].isna()) == [True, False, True, False]
    assert "glcm_Contrast" in table
    assert sorted(path.name for path in (out / "pictures").iterdir()) == ["air.png", "f1R.png", "f1R_2.png"]
    found, refused = (np.asarray(Image.open(out / "pictures" / f"{name}.png")) for name in ("f1R", "air"))
    assert max(found.shape) == 800
    yellow, orange = ([240, 228, 66], [213, 94, 0])
    assert (found == yellow).all(axis=-1).sum() > 500
    assert (refused == orange).all(axis=-1).sum() > 500


def test_side_and_pitch_can_be_told(files, tmp_path, monkeypatch, capsys):
    path = drawn.film(tmp_path / "unnamed.png", 2, "left", 5)
    read = ("predict", files["lr_l1_0v2_films"], path, "--workers", 1)
    assert run(monkeypatch, capsys, *read, "--out", tmp_path / "a", "--side", "left", "--pixel-mm", 0.75)[0] == 0
    row = pd.read_csv(tmp_path / "a" / "read.csv").iloc[0]
    assert (row["film_pixel_mm"], row["film_pixel_from"], row["film_side"]) == (0.75, "given", "left")
    assert run(monkeypatch, capsys, *read, "--out", tmp_path / "b", "--side", "right")[0] == 0
    row = pd.read_csv(tmp_path / "b" / "read.csv").iloc[0]
    assert (row["film_side"], row["film_pixel_from"]) == ("right", "plateau")


def broken(content: bytes, **changes) -> bytes:
    """A model file whose card has other entries."""
    members = unzip_files(content)
    card = json.loads(members["pssf/model.json"]) | changes
    return zip_files(members | {"pssf/model.json": json.dumps(card).encode()})


def without_card(content: bytes) -> bytes:
    return zip_files({name: part for name, part in unzip_files(content).items() if name != "pssf/model.json"})


def without_templates(content: bytes) -> bytes:
    return zip_files({name: part for name, part in unzip_files(content).items() if not name.endswith(".xz")})


def with_schema(content: bytes, change) -> bytes:
    """A model file with another skops schema."""
    members = unzip_files(content)
    return zip_files(members | {"schema.json": change(members["schema.json"].decode()).encode()})


def without_array(content: bytes) -> bytes:
    return zip_files({name: part for name, part in unzip_files(content).items() if name != "0.npy"})


def of_another(content: bytes, held: object) -> bytes:
    """The card and the templates of a model file around another object."""
    members = {name: part for name, part in unzip_files(content).items() if name.startswith("pssf/")}
    return zip_files(members | unzip_files(skops.io.dumps(held)))


NO_MODEL = "content must be a model saved by a study of pssf (.skops), got a damaged or foreign file"


@pytest.mark.parametrize(
    ("harm", "why"),
    [
        (without_array, f"{NO_MODEL} (KeyError"),
        (lambda content: with_schema(content, lambda text: "[" * 100_000), f"{NO_MODEL} (RecursionError"),
        (lambda content: with_schema(content, lambda text: text[:-9]), f"{NO_MODEL} (JSONDecodeError"),
        (lambda content: with_schema(content, lambda text: "{}"), f"{NO_MODEL} ("),
        (
            lambda content: with_schema(content, lambda text: text.replace("SimpleImputer", "Sumple")),
            NO_MODEL,
        ),
        (
            lambda content: of_another(content, PurePosixPath("x")),
            f"{NO_MODEL} (UntrustedTypesFoundException: Untrusted types found in the file: ['pathlib",
        ),
        (lambda content: of_another(content, {"a": 1}), "content must be a Pipeline, got dict"),
        (lambda content: of_another(content, Pipeline([("s", StandardScaler())])), f"{NO_MODEL} ("),
        (lambda content: b"not a zip", NO_MODEL),
        (lambda content: content[: len(content) // 2], NO_MODEL),
        (without_card, NO_MODEL),
        (without_templates, NO_MODEL),
        (lambda content: broken(content, format="pssf model 9"), "format must be 'pssf model 1', got 'pssf model 9'"),
        (lambda content: broken(content, bins="many"), NO_MODEL),
    ],
)
def test_a_file_that_is_no_model_is_refused_in_one_line(harm, why, files, tmp_path, monkeypatch, capsys):
    path = tmp_path / "model.skops"
    path.write_bytes(harm(files["lr_l1_0v2_films"].read_bytes()))
    film = drawn.film(tmp_path / "f1R.png", 2, "right", 3)
    code, _, warned = run(monkeypatch, capsys, "predict", path, film, "--out", tmp_path / "o")
    assert code == 2
    assert warned.startswith(f"pssf: file {path}: {why}")
    assert warned.count("\n") == 1
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
def test_films_that_cannot_be_listed_are_refused_in_one_line(more, why, files, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    code, _, warned = run(monkeypatch, capsys, "predict", files["lr_l1_0v2_films"], *more, "--out", "o")
    assert code == 2
    assert warned.startswith(f"pssf: {why}")
    assert warned.count("\n") == 1


def test_a_model_that_is_not_there_is_refused(tmp_path, monkeypatch, capsys):
    code, _, warned = run(monkeypatch, capsys, "predict", tmp_path / "no.skops", "film.png", "--out", tmp_path / "o")
    assert code == 2
    assert "No such file" in warned


def test_a_model_made_by_others_is_read_with_a_warning(files, tmp_path, monkeypatch, capsys):
    content = files["lr_l1_0v2_films"].read_bytes()
    made_by = json.loads(unzip_files(content)["pssf/model.json"])["made_by"]
    made_by["versions"]["numpy"] = "0.1"
    made_by["code"]["radiomics"] = "another"
    path = tmp_path / "model.skops"
    path.write_bytes(broken(content, made_by=made_by))
    film = drawn.film(tmp_path / "f1R.png", 2, "right", 3)
    code, said, warned = run(monkeypatch, capsys, "predict", path, film, "--out", tmp_path / "o", "--workers", 1)
    assert code == 0
    assert "numpy 0.1, here" in warned
    assert "other code of pssf (radiomics)" in warned
    assert "grade 2 (mild OA)" in said


def test_displays_are_refused_where_the_pitch_cannot_be_estimated(files, tmp_path):
    model = model_of(files["lr_l1_0v2_films"])
    templates = tuple(dataclasses.replace(template, plateau_mm=None) for template in model.templates)
    path = drawn.film(tmp_path / "f1R.png", 2, "right", 3)
    with pytest.raises(pssf.InputError, match="plateau_mm = None"):
        predict_films(dataclasses.replace(model, templates=templates), [film_of(path)], tmp_path)


def test_the_parts_of_a_model_file_have_no_time_and_no_chance(files):
    with zipfile.ZipFile(io.BytesIO(files["lr_l1_0v2_films"].read_bytes())) as packed:
        assert {part.date_time for part in packed.infolist()} == {(1980, 1, 1, 0, 0, 0)}
        assert [name for name in packed.namelist() if name.startswith("pssf/")] == [
            "pssf/model.json",
            "pssf/template_0.xz",
        ]


def test_without_a_film_there_is_nothing_to_read(files):
    with pytest.raises(pssf.InputError, match="films must hold at least one patient radiograph, got 0"):
        predict_films(model_of(files["lr_l1_0v2_films"]), [], Path())
