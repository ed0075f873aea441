"""The rules of the house that a program can keep."""

import ast
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
MODULES = sorted((ROOT / "pssf").rglob("*.py"))
# A module imports from its left only.
ORDER = [
    "checks",
    "files",
    "knee",
    "protocol",
    "geometry",
    "density",
    "topology",
    "mending",
    "scene",
    "radiograph",
    "anatomy",
    "raycast",
    "detector",
]
ORDER += ["simulate", "cohort", "radiomics", "study", "experiment", "validation", "accuracy", "cli"]


@pytest.mark.parametrize("path", MODULES, ids=str)
def test_a_module_fits_in_300_lines(path):
    assert len(path.read_text().splitlines()) <= 300


@pytest.mark.parametrize("path", MODULES, ids=str)
def test_a_function_fits_in_40_lines_below_its_docstring(path):
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.FunctionDef):
            body = node.body[1:] if ast.get_docstring(node) else node.body
            if body:
                assert body[-1].end_lineno - body[0].lineno + 1 <= 40, f"{path.name}:{node.name}"


@pytest.mark.parametrize("path", MODULES, ids=str)
def test_a_public_function_has_a_docstring(path):
    for node in ast.parse(path.read_text()).body:
        if isinstance(node, ast.FunctionDef | ast.ClassDef) and not node.name.startswith("_"):
            assert ast.get_docstring(node), f"{path.name}:{node.name}"


@pytest.mark.parametrize("path", MODULES, ids=str)
def test_imports_go_one_way(path):
    parts = path.relative_to(ROOT / "pssf").with_suffix("").parts
    if parts[0] not in ORDER or parts[0] == "files":
        return
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.ImportFrom) and node.level == len(parts):
            names = [node.module.split(".")[0]] if node.module else [alias.name for alias in node.names]
            for name in names:
                assert name not in ORDER or ORDER.index(name) <= ORDER.index(parts[0]), f"{parts} imports {name}"


@pytest.mark.parametrize("path", [p for p in MODULES if "files" not in p.parts], ids=str)
def test_only_files_touches_the_disk(path):
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Call):
            name = node.func.id if isinstance(node.func, ast.Name) else getattr(node.func, "attr", "")
            assert name not in ("open", "write_text", "write_bytes_to", "read_text", "mkdir", "unlink"), (
                f"{path}: {name}"
            )
