"""Which code something was made by."""

import ast
import subprocess
import sys
from pathlib import Path

import pytest
from conftest import change

import pssf
from pssf import cohort
from pssf.cohort import cohort_maker
from pssf.data import code_hash
from pssf.data.knees.preset_table import CohortPreset
from pssf.radiomics.features import feature_table

ROOT = Path(pssf.__file__).parent


def test_a_copy_has_the_digest_of_what_it_is_copied_from(copied_code):
    there = code_hash.compute_code_hashes((".", "data"))
    code_hash.PACKAGE_ROOT = ROOT
    code_hash.compute_code_hashes.cache_clear()
    assert code_hash.compute_code_hashes((".", "data")) == there


@pytest.mark.parametrize("name", ["data/detector.toml", "detector/panel_readout.py", "study/report/report.html.j2"])
def test_a_byte_changes_the_digest_of_its_part_and_of_no_other(copied_code, name):
    parts = ("data", "detector", "study", ".")
    before = code_hash.compute_code_hashes(parts)
    change(copied_code / name)
    assert code_hash.format_differing_parts(before, code_hash.compute_code_hashes(parts)) == f"., {name.split('/')[0]}"


def test_a_file_that_is_moved_or_new_changes_the_digest(copied_code):
    before = code_hash.compute_code_hashes()
    (copied_code / "data" / "new.toml").write_text("")
    code_hash.compute_code_hashes.cache_clear()
    assert code_hash.compute_code_hashes() != before


def test_what_is_compiled_or_left_by_an_editor_does_not_count(copied_code):
    before = code_hash.compute_code_hashes()
    (copied_code / "__pycache__").mkdir()
    for name in ("__pycache__/cli.cpython-311.pyc", "data/detector.toml~"):
        (copied_code / name).write_text("anything")
    code_hash.compute_code_hashes.cache_clear()
    assert code_hash.compute_code_hashes() == before


@pytest.mark.parametrize("name", sorted(code_hash.DOCUMENTATION_FILES))
def test_what_only_tells_of_results_does_not_count(copied_code, name):
    before = code_hash.compute_code_hashes((".", "data", "io"))
    change(copied_code / name)
    assert code_hash.compute_code_hashes((".", "data", "io")) == before


def test_a_part_that_is_not_there_is_refused():
    with pytest.raises(pssf.InputError, match=r"part must be a module or folder below .*, got rays\.py"):
        code_hash.compute_code_hashes(("rays.py",))


def test_other_code_is_refused_by_the_machine_that_has_it():
    here = code_hash.compute_code_hashes(("core", "data"))
    code_hash.require_same_code(here)
    with pytest.raises(pssf.InputError, match=r"code of pssf on .* must be .*, got other code \(data\)"):
        code_hash.require_same_code({**here, "data": "0"})


def test_every_kind_of_file_in_the_package_counts():
    kinds = {path.suffix for path in ROOT.rglob("*") if path.is_file() and "__pycache__" not in path.parts}
    # Prose, and the mark that a package has types, change no result.
    assert kinds - {".md", ".typed"} == set(code_hash.HASHED_SUFFIXES)


def imported(name):
    """Every module of the package that a module imports, directly or not, by its path below pssf/."""
    modules = {}
    for path in ROOT.rglob("*.py"):
        parts = path.relative_to(ROOT).with_suffix("").parts
        modules[parts[:-1] if parts[-1] == "__init__" else parts] = path
    seen, todo = set(), [name]
    while todo:
        module = todo.pop()
        if module in seen:
            continue
        seen.add(module)
        path = modules[module]
        package = module if path.name == "__init__.py" else module[:-1]
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.ImportFrom) and node.level:
                start = package[: len(package) - node.level + 1]
                start += tuple(node.module.split(".")) if node.module else ()
                reached = [start, *((*start, alias.name) for alias in node.names)]
                reached += [start[:k] for k in range(1, len(start))]
                todo += [one for one in reached if one in modules]
    return {modules[module].relative_to(ROOT).as_posix() for module in seen if module}


COHORT = (*cohort_maker._CODE_PATHS, *code_hash.list_pixel_data_files())


@pytest.mark.parametrize(
    ("start", "parts"),
    [(("cohort", "cohort_maker"), COHORT), (("radiomics", "features", "feature_table"), feature_table._CODE_PACKAGES)],
)
def test_all_that_is_imported_on_the_way_to_a_result_counts(start, parts):
    missing = {path for path in imported(start) if not set(parts) & {path, path.split("/")[0]}}
    assert missing <= {"data/knees/preset_table.py"}
    assert "data/knees/preset_table.py" not in missing or start == ("cohort", "cohort_maker")


def test_every_file_of_data_counts_for_pixels_unless_it_is_named_with_a_reason():
    files = {
        path.relative_to(ROOT).as_posix()
        for path in (ROOT / "data").rglob("*")
        if path.suffix in code_hash.HASHED_SUFFIXES
    }
    named = {f"data/{name}" for names in code_hash.TABLES_NOT_AFFECTING_PIXELS for name in names}
    assert named <= files
    assert all(code_hash.TABLES_NOT_AFFECTING_PIXELS.values())
    parts = code_hash.list_pixel_data_files()
    assert {path for path in files if not any(Path(path).is_relative_to(part) for part in parts)} == named | {
        path for path in code_hash.DOCUMENTATION_FILES if path.startswith("data/")
    }


def test_tables_that_no_pixel_hangs_on_are_read_by_their_readers_alone_and_those_by_nothing_that_makes_pixels():
    made_by = imported(("cohort", "cohort_maker")) - {"data/knees/preset_table.py"}
    called = [
        (path.relative_to(ROOT).as_posix(), ast.unparse(node.func), [ast.unparse(one) for one in node.args])
        for path in ROOT.rglob("*.py")
        for node in ast.walk(ast.parse(path.read_text()))
        if isinstance(node, ast.Call)
    ]
    readers = ("load_data_table", "data_files.load_data_table", "load_field_specs", "check_fields")
    for table_name, reader in code_hash.TABLES_NOT_AFFECTING_PIXELS:
        assert f"data/{reader}" not in made_by
        asked = repr(Path(table_name).stem)
        calls = [path for path, function, given in called if function in readers and asked in given]
        assert set(calls) == {f"data/{reader}"}


_WATCH = """
import sys
from pathlib import Path
opened, read_text = set(), Path.read_text
# As text, as tables are read; digests read the bytes of all.
Path.read_text = lambda path, *given, **more: opened.add(path) or read_text(path, *given, **more)
from pssf import cohort
one = {"knees": [0, 0, 1], "protocols": [sys.argv[1]]}
plan = cohort.plan_cohort("quick", seed=1, overrides=one)
# A plan has all that came of a preset; nothing else that is named may have been read for it.
assert not opened & {Path(path) for path in sys.argv[3:]}, opened
opened -= {path for path in opened if path.name == "presets.toml"}
cohort.make_cohort(plan, sys.argv[2], workers=1)
print("\\n".join(path.name for path in opened if path.suffix == ".toml" and path.parent.name == "data"))
"""


def test_presets_are_read_where_a_cohort_is_planned_and_by_nothing_that_makes_one():
    readers = [
        path.relative_to(ROOT).as_posix()
        for path in ROOT.rglob("*.py")
        for node in ast.walk(ast.parse(path.read_text()))
        if isinstance(node, ast.ImportFrom) and (node.module or "").split(".")[-1] == "preset_table"
    ]
    assert readers == ["cohort/cohort_plan.py"]


def test_a_plan_and_so_the_claim_of_a_folder_has_all_that_a_preset_says_of_radiographs():
    one = {"knees": [0, 2, 2], "bilateral": 0, "protocols": ["reference"], "grade_table": "paper"}
    others = {
        "knees": [2, 0, 2], "bilateral": 1, "protocols": ["low_dose"], "grade_table": "population",
        "acquisition": "sampled", "doses": [0.5], "tilts_deg": [5.0],
        "matrix": 512, "settings": ["mas=3"],
    }  # fmt: skip
    assert set(CohortPreset.__struct_fields__) - {"repeats", "retested"} == set(others)
    asked = cohort.plan_cohort("quick", seed=1, overrides=one).build_request()
    for name, value in others.items():
        assert cohort.plan_cohort("quick", seed=1, overrides={**one, name: value}).build_request() != asked, name
    # These say nothing of a cohort's own radiographs: repeats of splits, and knees of a plan of its own.
    for name in ("repeats", "retested"):
        assert cohort.plan_cohort("quick", seed=1, overrides={**one, name: 2}).build_request() == asked


def test_no_table_that_is_named_is_read_while_a_cohort_is_made(small_protocols, tmp_path):
    unread = [str(ROOT / "data" / name) for name, _ in code_hash.TABLES_NOT_AFFECTING_PIXELS if name != "presets.toml"]
    command = [sys.executable, "-c", _WATCH, small_protocols[0], str(tmp_path / "c"), *unread]
    opened = set(subprocess.run(command, capture_output=True, text=True, check=True).stdout.split())
    assert {"tissues.toml", "detector.toml", "anatomy.toml"} <= opened
    assert not opened & {table_name for table_name, _ in code_hash.TABLES_NOT_AFFECTING_PIXELS}
