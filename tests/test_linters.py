"""Check that ruff and import-linter, with the settings of the project, detect planted violations."""

import ast
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import grimp
import pytest

import pssf

ROOT = Path(__file__).parents[1]
LAYERS = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["importlinter"]["contracts"][0]["layers"]
LINT_IMPORTS = "from importlinter.cli import lint_imports_command; lint_imports_command()"
DOCUMENTED = '"""Module."""\n\n\n'
# A circular import: package a imports module a.b, which imports module a.c, which imports package a.
CIRCLE = {"__init__.py": "", "a/__init__.py": "from .b import x\n", "a/b.py": "from . import c\n"}
CIRCLE |= {"a/c.py": "from ..a import y\n"}


def write_files(folder, files):
    """Write texts by path below a folder."""
    for path, text in files.items():
        (folder / path).parent.mkdir(parents=True, exist_ok=True)
        (folder / path).write_text(text)


def lint_planted_imports(folder, files):
    """Run import-linter on an example package that contains all layers of the contract and additional files."""
    shutil.copy(ROOT / "pyproject.toml", folder)
    write_files(folder / "pssf", {"__init__.py": "", **{f"{layer}/__init__.py": "" for layer in LAYERS}, **files})
    command = [sys.executable, "-c", LINT_IMPORTS, "--no-cache", "--no-logo"]
    return subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)


def find_circles_of_packages(name):
    """Find modules that import a parent package that imports them; import-linter does not detect such circles."""
    graph = grimp.build_graph(name, exclude_type_checking_imports=True, cache_dir=None)
    return [
        (module, package)
        for module in graph.modules
        for package in graph.find_modules_directly_imported_by(module)
        if module.startswith(f"{package}.") and graph.chain_exists(importer=package, imported=module)
    ]


def test_imports_in_the_order_of_the_contract_are_allowed(tmp_path):
    done = lint_planted_imports(tmp_path, {"cli/a.py": "from ..core import b\n", "core/b.py": ""})
    assert done.returncode == 0, done.stdout + done.stderr


@pytest.mark.parametrize(
    ("files", "message"),
    [
        ({"core/a.py": "from ..model import knee\n", "model/knee.py": ""}, "pssf.core.a -> pssf.model.knee"),
        ({"data/a.py": "def f():\n    from pssf.cli import a\n", "cli/a.py": ""}, "pssf.data.a -> pssf.cli.a"),
        ({"io/a.py": "from . import b\n", "io/b.py": "from . import a\n"}, "No cycles are allowed in pssf.io"),
        ({"new_folder/__init__.py": ""}, "pssf.new_folder"),
    ],
    ids=["upward", "absolute", "circle", "unknown folder"],
)
def test_import_linter_detects_planted_imports(tmp_path, files, message):
    done = lint_planted_imports(tmp_path, files)
    assert done.returncode == 1
    assert message in done.stdout


def test_no_module_imports_a_parent_package_that_imports_the_module():
    assert not find_circles_of_packages("pssf")


def test_a_planted_circular_import_of_package_and_module_is_detected(tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(tmp_path)
    write_files(tmp_path / "planted", CIRCLE)
    assert find_circles_of_packages("planted") == [("planted.a.c", "planted.a")]


def test_the_package_docstring_lists_the_layers_of_the_import_contract():
    text = ast.get_docstring(ast.parse(Path(pssf.__file__).read_text()))
    assert [line.split()[0] for line in text.split("\n\n")[1].splitlines()] == LAYERS[::-1]


def check_text(path, text):
    """Return the messages of ruff about a text that is checked under a file name."""
    command = [sys.executable, "-m", "ruff", "check", "--output-format", "concise", "--stdin-filename", path, "-"]
    return subprocess.run(command, cwd=ROOT, input=text, capture_output=True, text=True, check=False).stdout


@pytest.mark.parametrize(
    ("path", "text", "rule"),
    [
        ("pssf/core/a.py", "x = 1\n", "D100"),
        ("pssf/core/a.py", f"{DOCUMENTED}class A:\n    pass\n", "D101"),
        ("pssf/core/a.py", f"{DOCUMENTED}def f():\n    pass\n", "D103"),
        ("pssf/core/__init__.py", "x = 1\n", "D104"),
        ("pssf/core/a.py", f"{DOCUMENTED}def _f(a, b, c, d, e, f, g, h):\n    pass\n", "PLR0917"),
        ("pssf/xray/a.py", f"{DOCUMENTED}from ..data.data_files import load_data_table\n", "TID251"),
        ("pssf/xray/a.py", f"{DOCUMENTED}from ..data import data_files\n\ndata_files.load_data_table(1)\n", "TID251"),
    ],
)
def test_ruff_detects_planted_violations(path, text, rule):
    assert f" {rule} " in check_text(path, text)


@pytest.mark.parametrize(
    ("path", "text", "rule"),
    [
        ("pssf/core/a.py", f"{DOCUMENTED}def _f(a, b, c, d, e, f, g, *, h):\n    pass\n", "PLR0917"),
        ("pssf/data/a.py", f"{DOCUMENTED}from .data_files import load_data_table\n", "TID251"),
    ],
)
def test_ruff_allows_statements_that_are_valid_in_their_package(path, text, rule):
    assert f" {rule} " not in check_text(path, text)
