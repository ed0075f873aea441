"""Check the code hashes that identify the code behind a result."""

import ast
import subprocess
import sys
from pathlib import Path

import pytest
from conftest import append_byte

import pssf
from pssf import cohort
from pssf.cohort import cohort_maker
from pssf.data import code_hash
from pssf.data.knees.preset_table import CohortPreset
from pssf.radiomics.features import feature_table

ROOT = Path(pssf.__file__).parent


def test_a_copy_of_the_package_has_the_same_hash(copied_code):
    expected = code_hash.compute_code_hashes((".", "data"))
    code_hash.PACKAGE_ROOT = ROOT
    code_hash.compute_code_hashes.cache_clear()
    assert code_hash.compute_code_hashes((".", "data")) == expected


@pytest.mark.parametrize(
    "name", ["data/detector.toml", "detector/panel_readout.py", "study/report/templates/report.html.j2"]
)
def test_a_changed_byte_changes_only_the_hash_of_its_folder(copied_code, name):
    parts = ("data", "detector", "study", ".")
    before = code_hash.compute_code_hashes(parts)
    append_byte(copied_code / name)
    assert code_hash.format_differing_parts(before, code_hash.compute_code_hashes(parts)) == f"., {name.split('/')[0]}"


def test_a_new_file_changes_the_hash(copied_code):
    before = code_hash.compute_code_hashes()
    (copied_code / "data" / "new.toml").write_text("")
    code_hash.compute_code_hashes.cache_clear()
    assert code_hash.compute_code_hashes() != before


def test_bytecode_and_editor_backups_do_not_change_the_hash(copied_code):
    before = code_hash.compute_code_hashes()
    (copied_code / "__pycache__").mkdir()
    for name in ("__pycache__/cli.cpython-311.pyc", "data/detector.toml~"):
        (copied_code / name).write_text("anything")
    code_hash.compute_code_hashes.cache_clear()
    assert code_hash.compute_code_hashes() == before


def test_an_unknown_folder_of_the_package_is_rejected():
    with pytest.raises(pssf.InputError, match=r"part must be a module or folder below .*, got rays\.py"):
        code_hash.compute_code_hashes(("rays.py",))


def test_a_computer_with_different_code_raises_an_error():
    hashes = code_hash.compute_code_hashes(("core", "data"))
    code_hash.require_same_code(hashes)
    with pytest.raises(pssf.InputError, match=r"code of pssf on .* must be .*, got other code \(data\)"):
        code_hash.require_same_code({**hashes, "data": "0"})


def test_every_file_type_of_the_package_is_hashed():
    kinds = {path.suffix for path in ROOT.rglob("*") if path.is_file() and "__pycache__" not in path.parts}
    # Markdown files and the py.typed marker do not affect results.
    assert kinds - {".md", ".typed"} == set(code_hash.HASHED_SUFFIXES)


def find_imported_modules(name):
    """Return the paths below pssf/ of all modules that a module imports directly or indirectly."""
    modules = {}
    for path in ROOT.rglob("*.py"):
        parts = path.relative_to(ROOT).with_suffix("").parts
        modules[parts[:-1] if parts[-1] == "__init__" else parts] = path
    visited, todo = set(), [name]
    while todo:
        module = todo.pop()
        if module in visited:
            continue
        visited.add(module)
        path = modules[module]
        package = module if path.name == "__init__.py" else module[:-1]
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.ImportFrom) and node.level:
                start = package[: len(package) - node.level + 1]
                start += tuple(node.module.split(".")) if node.module else ()
                reached = [start, *((*start, alias.name) for alias in node.names)]
                reached += [start[:k] for k in range(1, len(start))]
                todo += [one for one in reached if one in modules]
    return {modules[module].relative_to(ROOT).as_posix() for module in visited if module}


COHORT = (*cohort_maker.CODE_PATHS, *code_hash.list_pixel_data_files())


@pytest.mark.parametrize(
    ("start", "parts"),
    [(("cohort", "cohort_maker"), COHORT), (("radiomics", "features", "feature_table"), feature_table._CODE_PACKAGES)],
)
def test_every_module_imported_for_a_result_is_hashed(start, parts):
    missing = {path for path in find_imported_modules(start) if not set(parts) & {path, path.split("/")[0]}}
    assert missing <= {"data/knees/preset_table.py"}
    assert "data/knees/preset_table.py" not in missing or start == ("cohort", "cohort_maker")


def test_every_data_file_is_hashed_or_listed_with_a_reason():
    files = {
        path.relative_to(ROOT).as_posix()
        for path in (ROOT / "data").rglob("*")
        if path.suffix in code_hash.HASHED_SUFFIXES
    }
    weights = {path for path in files if path.startswith(f"{code_hash.READER_FOLDER}/")}
    assert any(path.endswith(".onnx") for path in weights)
    named = {f"data/{name}" for names in code_hash.TABLES_NOT_AFFECTING_PIXELS for name in names}
    assert named <= files
    assert all(code_hash.TABLES_NOT_AFFECTING_PIXELS.values())
    parts = code_hash.list_pixel_data_files()
    unlisted = {path for path in files if not any(Path(path).is_relative_to(part) for part in parts)}
    assert unlisted == named | weights


def test_tables_that_do_not_affect_pixels_have_only_one_reader():
    made_by = find_imported_modules(("cohort", "cohort_maker")) - {"data/knees/preset_table.py"}
    called = [
        (path.relative_to(ROOT).as_posix(), ast.unparse(node.func), [ast.unparse(one) for one in node.args])
        for path in ROOT.rglob("*.py")
        for node in ast.walk(ast.parse(path.read_text()))
        if isinstance(node, ast.Call)
    ]
    readers = ("load_data_table", "data_files.load_data_table", "load_field_specs", "check_fields")
    for table_name, reader in code_hash.TABLES_NOT_AFFECTING_PIXELS:
        assert f"data/{reader}" not in made_by
        table_literal = repr(Path(table_name).stem)
        calls = [path for path, function, given in called if function in readers and table_literal in given]
        assert set(calls) == {f"data/{reader}"}


_WATCH_SCRIPT = """
import sys
from pathlib import Path
opened, read_text = set(), Path.read_text
# Tables are read as text, whereas hashes read the bytes of all files.
Path.read_text = lambda path, *given, **more: opened.add(path) or read_text(path, *given, **more)
from pssf import cohort
one = {"knees": [0, 0, 1], "protocols": [sys.argv[1]]}
plan = cohort.plan_cohort("quick", seed=1, overrides=one)
# The plan contains all settings of the preset; no other listed table may have been read for it.
assert not opened & {Path(path) for path in sys.argv[3:]}, opened
opened -= {path for path in opened if path.name == "presets.toml"}
cohort.make_cohort(plan, sys.argv[2], workers=1)
print("\\n".join(path.name for path in opened if path.suffix == ".toml" and path.parent.name == "data"))
"""


def test_only_the_cohort_plan_reads_presets():
    # `CohortPreset` only declares fields, so importing it alone does not count as reading presets.
    readers = [
        path.relative_to(ROOT).as_posix()
        for path in ROOT.rglob("*.py")
        for node in ast.walk(ast.parse(path.read_text()))
        if isinstance(node, ast.ImportFrom)
        and {one.name for one in node.names} & {"load_presets", "preset_table", "*"}
        and ("preset_table" in {*(node.module or "").split("."), *(one.name for one in node.names)})
    ]
    assert readers == ["cohort/cohort_plan.py"]


def test_a_plan_records_every_preset_field_that_affects_radiographs():
    one = {"knees": [0, 2, 2], "bilateral": 0, "protocols": ["reference"], "grade_table": "paper"}
    others = {
        "knees": [2, 0, 2], "bilateral": 1, "protocols": ["low_dose"], "grade_table": "population",
        "acquisition": "sampled", "doses": [0.5], "tilts_deg": [5.0],
        "matrix": 512, "settings": ["mas=3"],
    }  # fmt: skip
    assert set(CohortPreset.__struct_fields__) - {"repeats", "retested"} == set(others)
    request = cohort.plan_cohort("quick", seed=1, overrides=one).build_request()
    for name, value in others.items():
        assert cohort.plan_cohort("quick", seed=1, overrides={**one, name: value}).build_request() != request, name
    # These fields affect only splits and retests, not the radiographs of the cohort.
    for name in ("repeats", "retested"):
        assert cohort.plan_cohort("quick", seed=1, overrides={**one, name: 2}).build_request() == request


def test_making_a_cohort_reads_no_table_without_effect_on_pixels(small_protocols, tmp_path):
    unread = [str(ROOT / "data" / name) for name, _ in code_hash.TABLES_NOT_AFFECTING_PIXELS if name != "presets.toml"]
    command = [sys.executable, "-c", _WATCH_SCRIPT, small_protocols[0], str(tmp_path / "c"), *unread]
    opened = set(subprocess.run(command, capture_output=True, text=True, check=True).stdout.split())
    assert {"tissues.toml", "detector.toml", "anatomy.toml"} <= opened
    assert not opened & {table_name for table_name, _ in code_hash.TABLES_NOT_AFFECTING_PIXELS}
