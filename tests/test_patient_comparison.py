"""Check the complete comparison with patients: film sources, command, page and repeated runs."""

import json
import shutil
import sys
from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from block_phantom import PIXEL_MM, TEMPLATE, make_phantom
from command_line import run as run_pssf
from PIL import Image
from test_contour_comparison import make_contours

import pssf
from pssf.core.processes.execution import Execution
from pssf.data.analysis.localisation_table import load_localisation_settings
from pssf.io.patients.patient_radiographs import list_films
from pssf.patient_comparison import comparison_run
from pssf.patient_comparison.films import film_features

sys.path.insert(0, str(Path(__file__).parents[1] / "docs" / "_ext"))

from table_layout import read_rows
from table_store import TableStore


def write_phantom_film(path, seed, gap_mm, side="right", inverted=False):
    """Write a film of the phantom as an 8-bit image with log display and bright bone."""
    rng = np.random.default_rng(seed)
    row, col = 150 + rng.integers(-8, 8), (180 if side == "right" else 140) + rng.integers(-8, 8)
    density = -np.log(make_phantom(row, col, side=side, noise=1.0, seed=seed, tibia_mm=gap_mm))
    grey = np.clip((density - density.min()) / np.ptp(density) * 255, 0, 255).astype(np.uint8)
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(255 - grey if inverted else grey).save(path)


def write_films(folder, count=12):
    """Write films of grades 0 and 2 with different joint spaces; one is inverted and one shows only air."""
    for index in range(count):
        side = "RL"[index % 2]
        grade = index % 4 // 2 * 2
        name = folder / str(grade) / f"p{index:03d}1{side}.png"
        write_phantom_film(name, index, 3.5 - grade, "right" if side == "R" else "left", inverted=index == 3)
    Image.fromarray(np.random.default_rng(0).integers(0, 9, (320, 320)).astype(np.uint8)).save(
        folder / "0" / "air9R.png"
    )
    return folder


@pytest.fixture
def phantoms_for_knees(monkeypatch, tmp_path):
    """Replace templates and simulated films by phantoms, which are computed faster."""
    phantoms = write_films(tmp_path / "phantoms")
    (phantoms / "0" / "air9R.png").unlink()

    def simulate_films(where, plan, known, execution):
        shutil.copytree(phantoms, where, dirs_exist_ok=True)
        return film_features.FilmSource(name=comparison_run.SIMULATED, folder=where, films=list_films(where))

    def load_landmarks(cohort, protocol):
        assert (cohort / "0").exists()
        assert protocol == "reference"
        return make_contours(count=6)

    monkeypatch.setattr(comparison_run, "make_standard_templates", lambda engine, workers: (TEMPLATE,))
    monkeypatch.setattr(comparison_run, "simulate_films", simulate_films)
    monkeypatch.setattr(comparison_run, "load_cohort_landmarks", load_landmarks)


def test_a_film_folder_is_one_source_or_has_one_source_per_subfolder(tmp_path):
    write_films(tmp_path / "all" / "first", 4)
    write_films(tmp_path / "all" / "second", 4)
    (tmp_path / "all" / "notes").mkdir()
    assert [source.name for source in comparison_run.find_film_sources(tmp_path / "all")] == ["first", "second"]
    (one,) = comparison_run.find_film_sources(tmp_path / "all" / "first")
    assert (one.name, len(one.films)) == ("first", 5)
    assert Counter(film.grade for film in one.films) == {0: 3, 2: 2}


def test_a_folder_without_films_and_a_reserved_name_raise_an_error(tmp_path):
    with pytest.raises(pssf.InputError, match="must be a folder with radiographs, or with one subfolder"):
        comparison_run.find_film_sources(tmp_path / "nowhere")
    with pytest.raises(pssf.InputError, match="must contain subfolders named 0 to 4"):
        comparison_run.find_film_sources(tmp_path)
    write_films(tmp_path / "simulated", 4)
    with pytest.raises(pssf.InputError, match="reserved for simulated radiographs"):
        comparison_run.find_film_sources(tmp_path)


def test_films_are_measured_once_and_listed_on_the_page(phantoms_for_knees, tmp_path, monkeypatch):
    given = write_films(tmp_path / "clinic")
    settings = {"films": given, "knees": 6, "grade_table": "paper", "seed": 1}
    first = comparison_run.compare_with_patients(tmp_path / "out", Execution(), **settings)
    assert [line.split(":")[0] for line in first.summaries] == ["Contours", "Radiographs"]
    assert all(path.exists() for path in first.paths)
    facts = json.loads((tmp_path / "out" / "patient_comparison.json").read_text())
    found = {row["source"]: row for row in facts["radiographs"]["found"]}
    assert found["clinic"]["radiographs"] == 13
    assert found["clinic"]["found"] >= 11
    assert found["simulated"]["found"] >= 11
    assert {"contours_outside", "source_separability"} <= {path.stem for path in first.paths}
    layouts = TableStore().load_layouts()
    for name in ("contours_outside", "contours_sizes", "films_found", "films_domains"):
        assert layouts[name].format_cells(read_rows(layouts[name], tmp_path / "out", {}))
    page = first.page.read_text()
    assert "data:image/png;base64" in page
    monkeypatch.setattr(film_features, "measure_film", lambda *_, **__: pytest.fail("measured again"))
    again = comparison_run.compare_with_patients(tmp_path / "out", Execution(), **settings)
    assert again.page.read_text() == page


def measure_one_source(sources):
    """Measure the films of one source."""
    known = {source.name: {} for source in sources}
    (records,) = film_features.measure_films(
        sources,
        (TEMPLATE,),
        load_localisation_settings(),
        Execution(),
        previous_records=known,
        save=lambda name, records: None,
    ).values()
    return records


def test_records_of_every_source_are_saved_during_measurement(tmp_path, monkeypatch):
    for name in ("a", "b"):
        write_phantom_film(tmp_path / name / "1R.png", 5, 2.5)
    sources, saved = comparison_run.find_film_sources(tmp_path), []
    monkeypatch.setattr(film_features, "make_interval_check", lambda seconds: lambda: True)
    known = {source.name: {} for source in sources}
    film_features.measure_films(
        sources, (TEMPLATE,), load_localisation_settings(), Execution(), previous_records=known,
        save=lambda name, records: saved.append((name, len(records))),
    )  # fmt: skip
    assert saved == [("a", 1), ("b", 0), ("a", 1), ("b", 1), ("a", 1), ("b", 1)]


def test_the_pixel_size_of_a_template_changes_the_key_of_records(tmp_path):
    write_phantom_film(tmp_path / "1R.png", 5, 2.5)
    (source,) = comparison_run.find_film_sources(tmp_path)
    other = replace(TEMPLATE, pixel_mm=1.1 * TEMPLATE.pixel_mm)
    keys = {
        film_features.measure_films(
            (source,),
            (template,),
            load_localisation_settings(),
            Execution(),
            previous_records={source.name: {}},
            save=lambda *_: None,
        )[source.name][0]["key"]
        for template in (TEMPLATE, TEMPLATE, other)
    }
    assert len(keys) == 2


def test_an_unreadable_film_is_counted_and_the_others_are_measured(tmp_path):
    given = write_films(tmp_path / "clinic", 2)
    (given / "0" / "torn1R.png").write_bytes(b"\x89PNG torn")
    records = measure_one_source(comparison_run.find_film_sources(given))
    status = {record["file"].split("/")[-1]: record["status"] for record in records}
    assert status["torn1R.png"] == "unreadable"
    assert status["p0001R.png"] == "found"
    assert status["air9R.png"] != "found"


def test_an_inverted_film_has_the_measures_of_the_original(tmp_path):
    for name, inverted in (("a1R.png", False), ("b1R.png", True)):
        write_phantom_film(tmp_path / name, 5, 2.5, inverted=inverted)
    plain, inverted = measure_one_source(comparison_run.find_film_sources(tmp_path))
    assert (plain["polarity"], inverted["polarity"]) == ("bone bright", "bone dark")
    assert inverted["joint space|medial_mean"] == pytest.approx(plain["joint space|medial_mean"], abs=0.01)
    assert plain["pixel_from"] == "plateau"
    assert plain["pixel_mm"] == pytest.approx(PIXEL_MM, rel=0.15)


@pytest.mark.parametrize(
    ("options", "line"),
    [
        (("--knees", "3"), "pssf: knees must be a whole number from 10 to 100000, got 3"),
        (
            ("--films", "nowhere"),
            "pssf: films must be a folder with radiographs, or with one subfolder ",
        ),
        (("--bones", "nowhere"), "pssf: folder nowhere must contain one .npz"),
        (("--protocol", "referense"), "pssf: "),
    ],
)
def test_invalid_input_gives_a_one_line_error_and_no_files(options, line, tmp_path):
    done = run_pssf("compare-patients", *options, "--out", tmp_path / "o")
    assert done.returncode == 2
    assert done.stderr.startswith(line)
    assert done.stderr.count("\n") == 1
    assert not (tmp_path / "o").exists()
