"""Measured tables in the READMEs of a source checkout."""

import os
import re
from pathlib import Path

import pytest
import trimesh

import pssf
from pssf.cli.measuring_commands import compare_patients as realism_command
from pssf.core.checks import InputError
from pssf.data.analysis.readme_table import load_readme_tables
from pssf.io import readme_tables
from pssf.model.protocol import load_protocol
from pssf.patient_comparison import comparison_run as realism
from pssf.validation import DEFAULT_TABLES, OPTIONAL_TABLES, run_validation

ROOT = Path(__file__).resolve().parents[1]
READMES = [ROOT / name for name in load_readme_tables().files]
MARKED = re.compile(r"<!-- table: (\w+) -->\n(.*?)<!-- /table -->", re.DOTALL)
MACHINE = r"\d+ cores, [\w-]+, \w+, Python 3\.\d+"
NOTES = "measured on an earlier version|beside other work"
CAPTION = rf"\*20\d\d-\d\d-\d\d, {MACHINE}, `uv run [^`]+`(, ({NOTES}))?\*"
ORIGIN = readme_tables.Origin(day="2026-11-22", machine="2 cores, x86-64, Linux, Python 3.11", options={"knees": 7})
ROWS = [
    {"quantity": "error of varus_deg", "sex": "", "value": 0.05, "sd": "", "reference": "", "reference_sd": "",
     "off_sd": "", "people": "", "knees": 7, "source": ""},
    {"quantity": "tibial_ml_mm", "sex": "male", "value": 77.71, "sd": 4.1, "reference": 77.5, "reference_sd": 4.0,
     "off_sd": 0.05, "people": 12.5, "knees": 4, "source": "a | b"},
    {"quantity": "tibial_ml_mm", "sex": "female", "value": 68.7, "sd": 3.6, "reference": 68.5, "reference_sd": 3.6,
     "off_sd": -0.061, "people": "", "knees": 3, "source": "a | b"},
]  # fmt: skip


def marked(*names):
    return "".join(f"before {name}\n<!-- table: {name} -->\nold\n<!-- /table -->\nafter\n" for name in names)


def checkout(folder, *names):
    (folder / "meshes").mkdir(exist_ok=True)
    (folder / "README.md").write_text("# PSSF\n")
    (folder / "meshes" / "README.md").write_text(marked(*names))
    return folder


def test_rows_replace_what_stands_between_the_markers_and_nothing_else(tmp_path):
    written = readme_tables.write_tables(checkout(tmp_path, "label_errors", "sizes", "builds"), {"knees": ROWS}, ORIGIN)
    assert written == [tmp_path / "meshes" / "README.md"]
    caption = "*2026-11-22, 2 cores, x86-64, Linux, Python 3.11, `uv run pssf validate --tables knees --knees 7`*\n\n"
    assert written[0].read_text() == (
        "before label_errors\n<!-- table: label_errors -->\n"
        + caption
        + "| label | largest | knees |\n| --- | --- | --- |\n| error of varus deg | 0.05 | 7 |\n\n"
        "<!-- /table -->\nafter\nbefore sizes\n<!-- table: sizes -->\n"
        + caption
        + "| size | source | men | women | both |\n| --- | --- | --- | --- | --- |\n"
        "| tibial ml mm | a \\| b | 77.7 (4.1); 77.5 (4.0); +0.05 | 68.7 (3.6); 68.5 (3.6); -0.06 |  |\n\n"
        "<!-- /table -->\nafter\n" + marked("builds")
    )
    assert (tmp_path / "README.md").read_text() == "# PSSF\n"


def test_the_same_rows_give_the_same_bytes_again(tmp_path):
    path = readme_tables.write_tables(checkout(tmp_path, "label_errors", "sizes"), {"knees": ROWS}, ORIGIN)[0]
    once = path.read_bytes()
    readme_tables.write_tables(tmp_path, {"knees": ROWS}, ORIGIN)
    assert path.read_bytes() == once


def test_rows_alike_are_shown_as_one_with_their_extremes_and_sums(tmp_path):
    rows = [
        {"knee": k, "rays_so_far": 1000 * (k + 1), "repaired": 2, "unrepaired": 0, "differs_mm": 1e-10 * k}
        for k in range(3)
    ]
    assert "| 3 | 3,000 | 6 | 0 | 2e-10 |" in readme_tables.format_table(
        "agreement", rows, ORIGIN, load_readme_tables()
    )


@pytest.mark.parametrize(("load", "note"), [(0.2, ""), (7.0, "beside other work")])
def test_what_else_the_machine_does_is_noted(load, note, tmp_path, monkeypatch):
    monkeypatch.setattr(os, "getloadavg", lambda: (load, 0.0, 0.0), raising=False)
    monkeypatch.setattr(readme_tables, "count_cores", lambda: 2)
    open_one = readme_tables.open_checkout(checkout(tmp_path, "label_errors", "sizes"), ["knees"], knees=7)
    assert open_one.origin.note == note
    text = open_one.update_tables({"knees": ROWS})[0].read_text()
    caption = text.splitlines()[2]
    assert re.fullmatch(CAPTION, caption)
    assert caption.endswith(f"{note}*")


def test_rows_of_an_earlier_run_have_its_day(tmp_path):
    report = tmp_path / "report.html"
    report.write_text("")
    os.utime(report, (1_700_000_000, 1_700_000_000))
    open_one = readme_tables.open_checkout(checkout(tmp_path, "label_errors", "sizes"), ["knees"], knees=7)
    written = open_one.update_tables({"knees": ROWS}, measured_with=report)
    assert "\n*2023-11-1" in written[0].read_text()


@pytest.mark.parametrize(
    ("given", "command"),
    [
        ({"cohort": Path("runs/mine")}, "pssf compare-patients --cohort mine --protocol fixed_flexion"),
        ({"knees": 40}, "pssf compare-patients --protocol fixed_flexion --knees 40"),
    ],
    ids=["cohort", "drawn"],
)
def test_a_caption_of_contours_says_whose_they_are(given, command, tmp_path, monkeypatch):
    rows = {name: [] for name in realism.README_TABLES["contours"]}
    rows["contours_outside"] = [{"grade": 0, "knees": 50, "outside": 3, "of": 28}]
    done = realism.PatientComparison(page=tmp_path / "realism.html", summaries=(), paths=(), rows=rows)
    monkeypatch.setattr(realism, "compare_with_patients", lambda *folders, **options: done)
    folder = checkout(tmp_path, *realism.README_TABLES["contours"])
    realism_command(out=tmp_path / "out", workers=1, protocol="fixed_flexion", readme=folder, **given)
    assert f"`uv run {command}`" in (folder / "meshes" / "README.md").read_text().split("<!-- /table -->")[0]


def test_knees_by_other_grades_have_tables_of_their_own():
    names = ["films_found", "films_domains", "contours"]
    assert realism.select_readme_tables(names, "population") == {name: name for name in names}
    assert realism.select_readme_tables(names, "paper") == {"films_domains_paper": "films_domains"}
    assert realism.select_readme_tables(names, "own.toml") == {}


def test_pictures_that_a_readme_shows_are_copied_and_others_are_not(tmp_path):
    pictures = [tmp_path / "out" / name for name in ("engines.png", "engines.csv", "other.png")]
    pictures[0].parent.mkdir()
    for path in pictures:
        path.write_bytes(path.name.encode())
    open_one = readme_tables.open_checkout(checkout(tmp_path), [])
    assert open_one.update_tables({}, pictures) == [tmp_path / "examples" / "engines.png"]
    assert (tmp_path / "examples" / "engines.png").read_bytes() == b"engines.png"


def test_without_a_checkout_nothing_is_written(tmp_path):
    assert (
        readme_tables.open_checkout(None, ["no such table"]).update_tables(
            {"no such table": []}, [tmp_path / "engines.png"]
        )
        == []
    )


@pytest.mark.parametrize(
    ("prepare", "measured", "says"),
    [
        (
            lambda folder: checkout(folder, "sizes"),
            "knees",
            "must have the table 'label_errors', got none: add the lines ",
        ),
        (lambda folder: folder, "knees", "must be a source checkout with README.md, got no README"),
        (
            lambda folder: checkout(folder, "sizes"),
            "kneez",
            "table of the READMEs must be one of ablation, agreement, ",
        ),
    ],
)
def test_a_checkout_that_cannot_take_a_table_is_refused_by_name(prepare, measured, says, tmp_path):
    with pytest.raises(InputError, match=re.escape(says)):
        readme_tables.require_checkout(prepare(tmp_path), [measured])


def test_rows_without_a_column_that_is_to_be_shown_are_refused(tmp_path):
    with pytest.raises(InputError, match="table builds: columns must be among knees, got 'built'"):
        readme_tables.write_tables(checkout(tmp_path, "builds"), {"builds": [{"knees": 3}]}, ORIGIN)


def test_a_folder_that_is_no_checkout_is_refused_before_anything_is_measured(tmp_path):
    with pytest.raises(InputError, match="got no README"):
        run_validation(tmp_path / "out", tables=["knees"], readme=tmp_path)
    assert not (tmp_path / "out").exists()


def test_what_is_measured_goes_into_the_readme(tmp_path):
    checkout(tmp_path, "physics")
    paths = run_validation(tmp_path / "out", tables=["physics"], readme=tmp_path)
    assert tmp_path / "meshes" / "README.md" in paths
    text = (tmp_path / "meshes" / "README.md").read_text()
    assert re.search(CAPTION, text)
    assert "| attenuation of tissues at 40 and 60 keV | 16 | -0.02 to +0.01 % | ICRU 46, xraylib |" in text


def test_every_marker_has_a_layout_and_every_layout_a_marker():
    found = [name for path in READMES for name in re.findall(r"<!-- table: (\w+) -->", path.read_text())]
    assert sorted(found) == sorted(load_readme_tables().table)
    assert all(text.count("<!-- table: ") == text.count("<!-- /table -->") for text in map(Path.read_text, READMES))
    there = {*ROOT.glob("README.md"), *ROOT.glob("[!.]*/README.md"), *ROOT.glob("pssf/*/README.md")}
    assert there == set(READMES)


def test_every_layout_is_of_something_that_a_command_measures():
    studied = {"scores", "reliability", "claims", "cost", "quality_reference"}
    sources = {layout.rows or name for name, layout in load_readme_tables().table.items()}
    beside_people = {name for names in realism.README_TABLES.values() for name in names}
    beside = {f"{name}_{grades}" for grades, names in realism.README_TABLES_BY_GRADE_TABLE.items() for name in names}
    assert sources == {*DEFAULT_TABLES, *OPTIONAL_TABLES, *studied, *beside_people, *beside}


@pytest.mark.parametrize("path", READMES, ids=lambda path: str(path.relative_to(ROOT)))
def test_every_table_says_when_where_and_how_it_was_measured_under_its_declared_headings(path):
    for name, body in MARKED.findall(path.read_text()):
        caption, empty, headings, *_ = body.splitlines()
        assert re.fullmatch(CAPTION, caption), name
        assert empty == ""
        assert (
            headings
            == f"| {' | '.join(x.strip() for x in readme_tables.table_headings(load_readme_tables().table[name]))} |"
        ), name


@pytest.mark.parametrize("path", READMES, ids=lambda path: str(path.relative_to(ROOT)))
def test_every_table_stands_between_markers_and_every_link_leads_to_a_file(path):
    text = path.read_text()
    assert "\n|" not in MARKED.sub("", text)
    for place in re.findall(r"\]\(([^)#]+)\)", text):
        assert (path.parent / place).exists(), place


def test_the_front_page_has_at_most_900_words_and_no_table():
    text = (ROOT / "README.md").read_text()
    assert len(text.split()) <= 900
    assert "\n|" not in text
    assert "pip install uv && uv run pssf study --preset quick --out runs/quick" in text
    assert "pip install uv && uv run pytest" in text


def test_the_python_of_the_front_page_runs(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    small = tmp_path / "small.toml"
    small.write_text('base = "reference"\nrows = 96\ncols = 96\npixel_mm = 3.2\n')
    monkeypatch.setattr(pssf, "load_protocol", lambda name: load_protocol(small))
    monkeypatch.setattr("pssf.simulation.load_protocol", lambda name: load_protocol(small))
    code, shared, own = re.findall(r"```python\n(.*?)```", (ROOT / "README.md").read_text(), re.DOTALL)
    names = {}
    exec(code, names)
    assert names["radiograph"].pixels.shape == (96, 96)
    exec(shared, names)
    for name, radius_mm in (("leg", 60.0), ("femur", 15.0), ("nail", 4.0), ("screw", 3.0)):
        trimesh.creation.icosphere(subdivisions=2, radius=radius_mm).export(tmp_path / f"{name}.stl")
    exec(own, names)
    assert names["again"].pixels.shape == (512, 512)
    assert names["paths"].path_mm["cortical_bone"].max() > 1
    assert "screw" in names["with_screw"].part_meshes()


@pytest.mark.parametrize(
    ("path", "what"),
    [
        ("meshes", "a tissue"),
        ("meshes", "a table of grades"),
        ("protocols", "a protocol"),
        ("protocols", "a detector"),
        ("protocols", "a view"),
        ("pssf/study", "a feature family"),
    ],
)
def test_a_short_section_says_how_to_add(path, what):
    text = (ROOT / path / "README.md").read_text()
    (section,) = re.findall(rf"^## Adding {what}\n(.*?)(?=^## |\Z)", text, re.DOTALL | re.MULTILINE)
    assert 40 < len(section.split()) < 250
