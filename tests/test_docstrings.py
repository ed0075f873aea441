"""Docstrings of public functions, classes and methods follow numpydoc."""

import ast
from collections.abc import Iterator

import pytest
from numpydoc.docscrape import NumpyDocString
from test_house import SOURCES

# Modules of commands: their docstrings are help texts, and the options are documented separately.
COMMANDS = (
    "cli/__init__.py",
    "cli/dataset_command.py",
    "cli/making_commands.py",
    "cli/measuring_commands.py",
    "cli/study_command.py",
)
COMMANDS += (
    "cli/benchmark_command.py",
    "cli/calibrate_command.py",
    "cli/explore_command.py",
    "cli/features_command.py",
    "cli/predict_command.py",
    "cli/reader_command.py",
    "cli/trial_command.py",
)
NOT_A_VERB = ("What", "Of", "Where", "How", "Whether", "Which", "Who", "The", "A", "An")
PROPERTIES = {"property", "cached_property"}


# `numpydoc lint` is not used: it rejects documented dataclass fields (54 messages) and properties (86 messages).
def faults(path: str, text: str) -> Iterator[str]:
    """Yield a line for each fault of the public docstrings of a module."""
    tree = ast.parse(text)
    for node in tree.body:
        if getattr(node, "name", "_").startswith("_"):
            continue
        where = f"{path}:{node.name}"
        if isinstance(node, ast.FunctionDef) and path not in COMMANDS:
            yield from (f"{where}: {fault}" for fault in faults_of_function(node))
        elif isinstance(node, ast.ClassDef):
            yield from (f"{where}: {fault}" for fault in faults_of_class(node))
            for method in node.body:
                if isinstance(method, ast.FunctionDef) and not method.name.startswith("_"):
                    yield from (f"{where}.{method.name}: {fault}" for fault in faults_of_function(method, method=True))


def faults_of_function(node: ast.FunctionDef, *, method: bool = False) -> Iterator[str]:
    docstring = ast.get_docstring(node)
    if not docstring:
        yield "no docstring"
        return
    sections = NumpyDocString(docstring)
    summary = " ".join(sections["Summary"])
    if len(sections["Summary"]) != 1 or not summary.endswith("."):
        yield "the summary must be one line that ends with a period"
    decorators = {ast.unparse(one).split("(")[0].split(".")[-1] for one in node.decorator_list}
    if decorators & PROPERTIES:
        return
    if summary.split(" ")[0] in NOT_A_VERB:
        yield f"the summary must open with a verb, got {summary!r}"
    documented = [name for entry in sections["Parameters"] for name in names_of(entry.name)]
    given = parameter_names(node, skip_first=method and "staticmethod" not in decorators)
    if documented != given:
        yield f"documented parameters must be {given}, got {documented}"
    for entry in sections["Parameters"]:
        if not entry.type and not entry.name.startswith(("*", "\\*")):
            yield f"parameter {entry.name} has no type"
        if not "".join(entry.desc).strip():
            yield f"parameter {entry.name} has no description"
    returns = ast.unparse(node.returns) if node.returns else ""
    if returns not in ("", "None", "NoReturn") and not sections["Returns"] and not sections["Yields"]:
        yield "no Returns section"


def faults_of_class(node: ast.ClassDef) -> Iterator[str]:
    docstring = ast.get_docstring(node)
    if not docstring:
        yield "no docstring"
        return
    sections = NumpyDocString(docstring)
    entries = (*sections["Parameters"], *sections["Attributes"])
    documented = {name for entry in entries for name in names_of(entry.name)}
    for one in node.body:
        if isinstance(one, ast.AnnAssign) and isinstance(one.target, ast.Name):
            name, kind = one.target.id, ast.unparse(one.annotation)
            if not name.startswith("_") and "ClassVar" not in kind and name not in documented:
                yield f"field {name} is not documented"


def names_of(entry: str) -> list[str]:
    return [name.strip().replace("\\*", "*") for name in entry.split(",")]


def parameter_names(node: ast.FunctionDef, *, skip_first: bool) -> list[str]:
    names = [one.arg for one in (*node.args.posonlyargs, *node.args.args)][int(skip_first) :]
    names += [f"*{node.args.vararg.arg}"] if node.args.vararg else []
    names += [one.arg for one in node.args.kwonlyargs]
    names += [f"**{node.args.kwarg.arg}"] if node.args.kwarg else []
    return [name for name in names if not name.startswith("_")]


@pytest.mark.parametrize("path", SOURCES)
def test_public_docstrings_follow_numpydoc(path):
    assert not list(faults(path, SOURCES[path]))


GOOD = '''
def scale(mesh, factor: float) -> int:
    """Scale a mesh.

    Parameters
    ----------
    mesh : Mesh
        Closed surface.
    factor : float
        Scale factor, dimensionless.

    Returns
    -------
    int
        Number of vertices.
    """
'''


@pytest.mark.parametrize(
    ("before", "after"),
    [
        ("Scale a mesh.", "What scales a mesh."),
        ("Scale a mesh.", "Scale a mesh"),
        ("    factor : float\n        Scale factor, dimensionless.\n", ""),
        ("factor : float", "factors : float"),
        ("factor : float", "factor"),
        ("        Scale factor, dimensionless.\n", ""),
        ("    Returns\n    -------\n    int\n        Number of vertices.\n", ""),
    ],
)
def test_a_faulty_docstring_is_detected(before, after):
    assert not list(faults("a.py", GOOD))
    assert before in GOOD
    assert list(faults("a.py", GOOD.replace(before, after)))
