"""Check the measured tables of the validation pages: content, provenance and detection of stale tables."""

import ast
import json
import re
import string
import sys
from pathlib import Path

import pytest

from pssf.cli import measuring_commands
from pssf.io import run_record
from pssf.validation import DEFAULT_TABLES, OPTIONAL_TABLES, run_validation

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / "docs" / "_ext"))

import code_digest  # noqa: E402
import measured_tables  # noqa: E402
from table_store import TableStore, is_command_of  # noqa: E402

REAL = TableStore()
LAYOUTS = REAL.load_layouts()
MACHINE = r"\d+ cores, [\w-]+, \w+, Python 3\.\d+"
COMMAND = "pssf validate --tables decay --knees 7"
FILES = {
    "pssf/__init__.py": "",
    "pssf/measure.py": """
from .formula import RATE


def measure():
    from .late import OFFSET
    return RATE + OFFSET
""",
    "pssf/formula.py": """'''A formula.'''

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from .types import T

RATE = 2
UNIT = load_data_table("rate")
""",
    "pssf/late.py": "OFFSET = 1\n",
    "pssf/types.py": "T = int\n",
    "pssf/other.py": "SIZE = load_data_table('size')\n",
    "pssf/data/detector.toml": "# Gain.\ngain = 1.5\nlabel = 'gain'\n",
    "pssf/data/rate.toml": "rate = 2\n",
    "pssf/data/size.toml": "size = 3\n",
    "protocols/reference.toml": "tube_kv = 60\n",
    "docs/validation/page.md": "# Page\n\n```{measured-table} decay\n```\n",
    "docs/validation/tables/.keep": "",
    "docs/validation/tables.toml": f'[picture]\n[table.decay]\ncommand = "{COMMAND}"\nmeasured_by = ["pssf.measure"]\n'
    '[table.decay.columns]\n"rate, 1/s" = "{rate:.2f}"\n"sample" = "{sample!p}"\n',
    "run/decay.csv": "rate,sample\n0.333,a_b\n,c\n",
    "run/run.json": json.dumps(
        {"command": f"{COMMAND} --out run --workers 2", "date": "2026-11-22", "machine": "2 cores", "note": "quiet"}
    ),
}


@pytest.fixture
def checkout(tmp_path):
    for name, text in FILES.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text)
    return tmp_path


def replace_text(path, before, after):
    text = path.read_text()
    assert before in text
    path.write_text(text.replace(before, after))
    code_digest.load_package.cache_clear()
    code_digest._load_values.cache_clear()


def run(store, *words):
    return measured_tables.main([str(word) for word in words], store)


@pytest.mark.parametrize(
    ("file", "before", "after", "changed"),
    [
        ("pssf/formula.py", "RATE = 2", "RATE = 3", "code"),
        ("pssf/late.py", "OFFSET = 1", "OFFSET = 2", "code"),
        ("pssf/measure.py", "RATE + OFFSET", "RATE - OFFSET", "code"),
        ("pssf/data/detector.toml", "gain = 1.5", "gain = 1.6", "data"),
        ("pssf/data/rate.toml", "rate = 2", "rate = 3", "data"),
        ("protocols/reference.toml", "tube_kv = 60", "tube_kv = 70", "data"),
        ("pssf/formula.py", "A formula.", "Another text.", ""),
        ("pssf/formula.py", "RATE = 2", "# A comment.\nRATE  =  2", ""),
        ("pssf/data/detector.toml", "# Gain.", "# Gain of the detector.", ""),
        ("pssf/data/detector.toml", "label = 'gain'", "label = 'conversion'", ""),
        ("pssf/other.py", "SIZE =", "WIDTH =", ""),
        ("pssf/data/size.toml", "size = 3", "size = 4", ""),
        ("pssf/types.py", "T = int", "T = float", ""),
    ],
)
def test_a_table_digest_changes_only_with_its_code_and_data(file, before, after, changed, checkout):
    store = TableStore(checkout)
    layout = store.load_layouts()["decay"]
    first = store.compute_digest(layout)
    replace_text(checkout / file, before, after)
    second = store.compute_digest(layout)
    assert [part for part in first if first[part] != second[part]] == ([changed] if changed else [])


def test_update_writes_a_table_and_the_record_of_its_run(checkout, capsys):
    store = TableStore(checkout)
    assert run(store, "update", checkout / "run") == 0
    assert capsys.readouterr().out.split() == [f"{checkout / 'run'}:", "decay"]
    assert store.load_cells(store.load_layouts()["decay"]) == [["rate, 1/s", "sample"], ["0.33", "a b"], ["", "c"]]
    record = store.load_record("decay")
    assert record.pop("digest").keys() == {"code", "data", "command"}
    assert record == {"command": COMMAND, "date": "2026-11-22", "machine": "2 cores", "note": "quiet"}


def test_update_accepts_column_names_of_an_earlier_version(checkout):
    store = TableStore(checkout)
    replace_text(checkout / "run" / "decay.csv", "rate,", "ratio,")
    assert run(store, "update", checkout / "run", "--rename", "ratio=rate") == 0
    assert store.load_cells(store.load_layouts()["decay"])[1] == ["0.33", "a b"]


def test_a_table_is_listed_as_stale_until_it_is_confirmed(checkout, capsys):
    store = TableStore(checkout)
    run(store, "update", checkout / "run")
    capsys.readouterr()
    assert run(store, "stale") == 0
    assert capsys.readouterr().out == ""
    replace_text(checkout / "pssf" / "formula.py", "RATE = 2", "RATE = 1 + 1")
    assert run(store, "stale") == 1
    assert capsys.readouterr().out == "decay (page), measured on 2026-11-22: code changed\n"
    assert run(store, "confirm", "dec*", "--by", "the run gives the same bytes") == 0
    assert store.load_record("decay")["confirmed"]["by"] == "the run gives the same bytes"
    assert run(store, "stale") == 0
    replace_text(checkout / "protocols" / "reference.toml", "60", "70")
    assert store.explain_staleness(store.load_layouts()["decay"]) == "data changed"
    run(store, "update", checkout / "run")
    assert "confirmed" not in store.load_record("decay")


def test_a_table_with_another_command_or_without_digest_is_stale(checkout):
    store = TableStore(checkout)
    run(store, "update", checkout / "run")
    record = store.load_record("decay")
    store._save_record("decay", record | {"digest": "unknown"})
    assert store.list_stale()[0].reason == "code and data not recorded"
    replace_text(checkout / "docs" / "validation" / "tables.toml", "--knees 7", "--knees 8")
    assert store.list_stale()[0].reason == "command changed"


def test_a_run_of_another_checkout_is_stored_with_its_digest(checkout, tmp_path_factory):
    other = tmp_path_factory.mktemp("other")
    for name, text in FILES.items():
        (other / name).parent.mkdir(parents=True, exist_ok=True)
        (other / name).write_text(text)
    replace_text(other / "pssf" / "formula.py", "RATE = 2", "RATE = 9")
    store = TableStore(checkout)
    assert run(store, "update", checkout / "run", "--checkout", other) == 0
    assert store.list_stale()[0].reason == "code changed"


@pytest.mark.parametrize(
    ("file", "before", "after", "words", "message"),
    [
        ("run/decay.csv", "rate,", "ratio,", [], "columns of decay.csv must include 'rate', got ratio, sample"),
        ("run/run.json", "--knees 7", "--knees 9", [], "contains no table or picture that its command measures"),
        ("run/run.json", '"command"', '"was"', [], "contains no run.json: specify its command with --command"),
        ("run/run.json", "2", "2", ["--only", "decai"], "name must be one of decay, got decai"),
        ("run/run.json", "2", "2", ["--checkout", "run"], "checkout must be a source folder that contains pssf, got "),
        ("docs/validation/tables.toml", "pssf.measure", "pssf.gone", [], "must name modules of "),
    ],
)
def test_a_run_that_cannot_be_stored_gives_a_one_line_error(file, before, after, words, message, checkout, capsys):
    replace_text(checkout / file, before, after)
    assert run(TableStore(checkout), "update", checkout / "run", *words) == 2
    last = capsys.readouterr().err.strip().splitlines()[-1]
    assert last.startswith("measured_tables: ")
    assert message in last


@pytest.mark.parametrize(
    ("wanted", "command", "same"),
    [
        ("pssf study --preset paper", "pssf study --preset paper --out runs/paper --workers 2 --seed 0", True),
        ("pssf study --preset paper", "pssf study --out runs/quick", False),
        ("pssf study --preset paper", "pssf study --preset paper --seed 1", False),
        ("pssf validate --tables knees --knees 30", "pssf validate --out x", True),
        ("pssf validate --tables knees --knees 36", "pssf validate --tables builds,knees --knees=36", True),
        ("pssf validate --tables knees --knees 36", "pssf validate --tables builds --knees 36", False),
        ("pssf validate --tables knees --knees 36", "pssf validate --tables knees --knees 60", False),
        ("pssf validate --tables coverage", "pssf validate --tables coverage --knees 60", True),
        ("--group peers pssf validate --tables gvxr", "pssf validate --tables gvxr --out x", True),
        ("--directory tests python -m tools.page_latency", "python -m tools.page_latency runs/latency", True),
        (
            "pssf compare-patients --films FOLDER --protocol fixed_flexion --knees 200",
            "pssf compare-patients --bones /data/bones --films /data/films --protocol fixed_flexion --out x",
            True,
        ),
        (
            "pssf compare-patients --cohort population250 --protocol fixed_flexion",
            "pssf compare-patients --cohort runs/population250 --protocol fixed_flexion --out x",
            True,
        ),
        (
            "pssf compare-patients --cohort population250 --protocol fixed_flexion",
            "pssf compare-patients --films /data/films --protocol fixed_flexion --out x",
            False,
        ),
    ],
)
def test_a_table_accepts_only_runs_of_its_command(wanted, command, same):
    assert is_command_of(wanted, command) == same


def test_merged_rows_show_extremes_and_sums():
    rows = [
        {"knee": k, "rays_so_far": 1000 * (k + 1), "repaired": 2, "unrepaired": 0, "differs_mm": 1e-10 * k}
        for k in range(3)
    ]
    assert LAYOUTS["agreement"].format_cells(rows) == [["3", "3,000", "6", "0", "2e-10"]]


def test_rows_are_merged_if_column_headings_are_values():
    rows = [
        {"quantity": "tibial_ml_mm", "sex": sex, "value": value, "sd": 4.1, "reference": 77.5, "reference_sd": 4.0,
         "off_sd": 0.05, "source": "a"}
        for sex, value in (("male", 77.71), ("female", 68.7), ("", 1.0))
    ]  # fmt: skip
    assert LAYOUTS["sizes"].format_cells(rows) == [
        ["tibial ml mm", "a", "77.7 (4.1); 77.5 (4.0); +0.05", "68.7 (4.1); 77.5 (4.0); +0.05", ""]
    ]


def test_a_table_written_by_validate_matches_its_layout(checkout):
    folder = checkout / "physics"
    run_validation(folder, tables=["physics"])
    real = (REAL.pages / "tables.toml").read_text(encoding="utf-8")
    (checkout / "docs" / "validation" / "tables.toml").write_text(
        real.replace("pssf.validation.imaging.physics_reference", "pssf.measure")
    )
    store = TableStore(checkout)
    assert run(store, "update", folder, "--command", "pssf validate --tables physics") == 0
    cells = store.load_cells(LAYOUTS["physics"])
    assert ["attenuation of tissues at 40 and 60 keV", "16", "-0.02 to +0.01 %", "ICRU 46, xraylib"] in cells
    assert re.fullmatch(MACHINE, store.load_record("physics")["machine"])


@pytest.mark.parametrize(("load", "note"), [(0.2, ""), (7.0, "beside other work")])
def test_validate_records_command_machine_and_concurrent_load(load, note, tmp_path, monkeypatch):
    monkeypatch.setattr("os.getloadavg", lambda: (load, 0.0, 0.0), raising=False)
    monkeypatch.setattr(run_record, "count_cores", lambda: 2)
    monkeypatch.setattr("sys.argv", ["/bin/pssf", "validate", "--tables", "physics", "--out", "a b"])
    monkeypatch.setattr("pssf.validation.run_validation", lambda out, **options: [])
    measuring_commands.validate(out=tmp_path, tables="physics")
    record = json.loads((tmp_path / "run.json").read_text())
    assert record["command"] == "pssf validate --tables physics --out 'a b'"
    assert record["note"] == note
    assert re.fullmatch(r"20\d\d-\d\d-\d\d", record["date"])
    assert re.fullmatch(MACHINE, record["machine"])


def collect_texts(modules):
    """Collect string constants and keywords of modules, and patterns of their f-strings."""
    texts, patterns = set(), set()
    paths = [ROOT / f"{module.replace('.', '/')}.py" for module in modules]
    paths = [path if path.exists() else path.with_suffix("") / "__init__.py" for path in paths]
    for path in [*paths, ROOT / "tests" / "tools" / "page_latency.py"]:
        for node in ast.walk(ast.parse(path.read_bytes())):
            if isinstance(node, ast.Constant) and isinstance(node.value, str):
                texts.add(node.value)
            elif isinstance(node, ast.keyword) and node.arg:
                texts.add(node.arg)
            elif isinstance(node, ast.AnnAssign):
                texts.add(ast.unparse(node.target))
            elif isinstance(node, ast.JoinedStr) and len(node.values) > 1:
                parts = [re.escape(one.value) if isinstance(one, ast.Constant) else ".+" for one in node.values]
                patterns.add("".join(parts))
    return texts, [re.compile(text) for text in patterns if text.strip(".+")]


def test_every_column_of_a_layout_is_written_by_a_listed_module():
    modules = {
        name for layout in LAYOUTS.values() for name in code_digest.list_reached_modules(ROOT, layout.measured_by)
    }
    texts, patterns = collect_texts(modules)
    for layout in LAYOUTS.values():
        formats = [*layout.columns.values(), layout.pivot_format, layout.cell_format]
        columns = {name for text in formats for _, name, _, _ in string.Formatter().parse(text) if name} - {"count"}
        if layout.group_by is not None:
            columns = {re.sub("^(least|most|total)_", "", name) for name in columns} | set(layout.group_by)
        columns |= {name for one in layout.row_filters for name in one}
        missing = [name for name in columns - texts if not any(pattern.fullmatch(name) for pattern in patterns)]
        assert missing == [], layout.name


def test_every_table_of_a_command_is_shown_on_a_page():
    files = {Path(layout.file.partition("#")[0]).stem for layout in LAYOUTS.values() if layout.kind == "table"}
    assert {*DEFAULT_TABLES, *OPTIONAL_TABLES} <= files
    assert REAL.find_pages().keys() == LAYOUTS.keys()
    index = (REAL.pages / "index.md").read_text(encoding="utf-8")
    assert all(f"\n{page}\n" in index for page in REAL.find_pages().values())


@pytest.mark.parametrize("layout", LAYOUTS.values(), ids=LAYOUTS.keys())
def test_every_table_is_stored_with_command_date_and_machine(layout):
    record = REAL.load_record(layout.name)
    assert re.fullmatch(r"20\d\d-\d\d-\d\d", record["date"])
    assert re.fullmatch(MACHINE, record["machine"])
    assert re.search(r"^(--\S+ \S+ )?(pssf|python) \S", record["command"])
    assert code_digest.list_reached_modules(ROOT, layout.measured_by)
    if layout.kind == "picture":
        assert REAL.file_of(layout).read_bytes().startswith(b"\x89PNG")
        assert len(layout.alt) > 20
        return
    heads, *rows = REAL.load_cells(layout)
    assert heads == layout.list_headings()
    assert rows
    assert all(len(row) == len(heads) for row in rows)


def test_only_tables_with_a_layout_are_stored():
    stored = {path.stem for path in (REAL.pages / "tables").iterdir()}
    assert stored == LAYOUTS.keys()
