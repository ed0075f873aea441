"""The rules of the house that a program can keep, each with a planted violation that it must see."""

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

import pssf

PACKAGE = Path(pssf.__file__).parent
SOURCES = {path.relative_to(PACKAGE).as_posix(): path.read_text() for path in sorted(PACKAGE.rglob("*.py"))}
# The only packages that open files: the package's own tables and the user's cache, and everything else.
DISK = ("data", "io")
OPENS = ("open", "read_text", "write_text", "read_bytes", "mkdir", "unlink", "rename", "touch", "rmtree", "copyfile")
# As methods of a path, of numpy or of a table; functions of `io` may be called so.
METHODS = ("write_bytes", "savez", "savez_compressed", "savetxt", "tofile", "fromfile", "to_csv", "to_json")
ERRORS = ("InputError", "ValueError", "TypeError")
ARRAYS = ("Array", "NDArray", "Map", "Block", "Faces", "Floats", "Ints", "Signs", "Frequencies")


def listed_order(front_page: str) -> list[str]:
    """Names of packages and modules in the order of the front page's docstring."""
    text = ast.get_docstring(ast.parse(front_page)) or ""
    return [line.split()[0] for line in text.split("\n\n")[1].splitlines()]


def module_name(path: str) -> str:
    parts = path.removesuffix(".py").split("/")
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def imports(sources: dict[str, str]) -> dict[str, set[str]]:
    """Module -> modules of the package that it imports, wherever it does; types that only a checker reads aside."""
    names = {module_name(path) for path in sources}
    graph: dict[str, set[str]] = {}
    for path, text in sources.items():
        name = module_name(path)
        package = name.split(".") if path.endswith("__init__.py") else name.split(".")[:-1]
        tree = ast.parse(text)
        skipped = {id(n) for block in ast.walk(tree) if _type_checking(block) for n in ast.walk(block)}
        targets: set[str] = set()
        for node in ast.walk(tree):
            if id(node) in skipped or not isinstance(node, ast.ImportFrom) or not node.level:
                continue
            base = [part for part in package if part][: len([p for p in package if p]) - node.level + 1]
            base += node.module.split(".") if node.module else []
            for alias in node.names:
                whole = ".".join([*base, alias.name])
                targets.add(whole if whole in names else ".".join(base))
        graph[name] = {target for target in targets if target in names and target != name}
    return graph


def _type_checking(node: ast.AST) -> bool:
    return isinstance(node, ast.If) and isinstance(node.test, ast.Name) and node.test.id == "TYPE_CHECKING"


def cycles(graph: dict[str, set[str]]) -> Iterator[str]:
    """A line for each module that reaches itself."""
    for start in graph:
        seen, left = set[str](), list(graph[start])
        while left:
            name = left.pop()
            if name == start:
                yield f"{start} imports itself, by others"
                break
            if name not in seen:
                seen.add(name)
                left += graph.get(name, ())


def one_way(sources: dict[str, str]) -> Iterator[str]:
    order = listed_order(sources["__init__.py"])
    graph = imports(sources)
    yield from cycles(graph)
    for name, targets in graph.items():
        room = name.split(".")[0]
        if room in ("", "__main__"):
            continue
        if room not in order:
            yield f"{room} is not on the front page"
            continue
        for target in targets:
            other = target.split(".")[0]
            if other and (other not in order or order.index(other) > order.index(room)):
                yield f"{name} imports {target}, which is to its right"


def long_modules(sources: dict[str, str]) -> Iterator[str]:
    for path, text in sources.items():
        if len(text.splitlines()) > 300:
            yield f"{path}: {len(text.splitlines())} lines"


def _functions(sources: dict[str, str]) -> Iterator[tuple[str, ast.FunctionDef]]:
    for path, text in sources.items():
        for node in ast.walk(ast.parse(text)):
            if isinstance(node, ast.FunctionDef):
                yield f"{path}:{node.name}", node


def long_functions(sources: dict[str, str]) -> Iterator[str]:
    for where, node in _functions(sources):
        body = node.body[1:] if ast.get_docstring(node) else node.body
        if body and body[-1].end_lineno - body[0].lineno + 1 > 40:
            yield f"{where}: {body[-1].end_lineno - body[0].lineno + 1} lines"


def many_arguments(sources: dict[str, str]) -> Iterator[str]:
    for where, node in _functions(sources):
        count = len([a for a in (*node.args.posonlyargs, *node.args.args) if a.arg not in ("self", "cls")])
        if count > 7:
            yield f"{where}: {count} positional arguments"


def without_docstring(sources: dict[str, str]) -> Iterator[str]:
    for path, text in sources.items():
        tree = ast.parse(text)
        if not ast.get_docstring(tree):
            yield f"{path}: the module"
        for node in tree.body:
            public = isinstance(node, ast.FunctionDef | ast.ClassDef) and not node.name.startswith("_")
            if public and not ast.get_docstring(node):
                yield f"{path}:{node.name}"


def open_the_disk(sources: dict[str, str]) -> Iterator[str]:
    for path, text in sources.items():
        if path.split("/")[0] in DISK:
            continue
        for node in ast.walk(ast.parse(text)):
            if isinstance(node, ast.Call):
                method = getattr(node.func, "attr", "")
                name = node.func.id if isinstance(node.func, ast.Name) else method
                # Without a path a table gives text.
                if name in OPENS or (method in METHODS and (node.args or not method.startswith("to_"))):
                    yield f"{path}: {name}"


def absolute_imports(sources: dict[str, str]) -> Iterator[str]:
    """Imports of the package by its name, which `one_way` would not see."""
    for path, text in sources.items():
        for node in ast.walk(ast.parse(text)):
            names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
            names += [node.module or ""] if isinstance(node, ast.ImportFrom) and not node.level else []
            if path != "__main__.py" and any(name.split(".")[0] == "pssf" for name in names):
                yield f"{path}:{node.lineno}"


def read_tables(sources: dict[str, str]) -> Iterator[str]:
    """Formulas get records; a table is read where it becomes one."""
    for path, text in sources.items():
        if path.split("/")[0] == "data":
            continue
        for node in ast.walk(ast.parse(text)):
            taken = isinstance(node, ast.ImportFrom) and (node.module or "").split(".")[-1] == "tables"
            if (taken and any(alias.name == "data" for alias in node.names)) or "tables.data(" in text:
                yield f"{path}: tables.data"
                break


def refuse_without_value(sources: dict[str, str]) -> Iterator[str]:
    for path, text in sources.items():
        for node in ast.walk(ast.parse(text)):
            refuses = isinstance(node, ast.Call) and getattr(node.func, "id", "") in ERRORS and node.args
            if refuses and isinstance(node.args[0], ast.Constant) and " = " not in node.args[0].value:
                yield f"{path}:{node.lineno}: {node.args[0].value!r}"


def arrays_without_shape(sources: dict[str, str]) -> Iterator[str]:
    """Array arguments of public functions whose docstring does not give a shape beside their name."""
    for path, text in sources.items():
        for node in ast.parse(text).body:
            methods = node.body if isinstance(node, ast.ClassDef) else [node]
            for function in methods:
                if isinstance(function, ast.FunctionDef) and not function.name.startswith("_"):
                    notes = (ast.get_docstring(function) or "") + (ast.get_docstring(node) or "")
                    for argument in (*function.args.args, *function.args.kwonlyargs):
                        kind = ast.unparse(argument.annotation) if argument.annotation else ""
                        if kind.split("[")[0] in ARRAYS and not _has_shape(argument.arg, notes):
                            yield f"{path}:{function.name}: {argument.arg}"


def _has_shape(name: str, notes: str) -> bool:
    """Whether a line names the argument and gives a shape, or the text gives one right after it."""
    for line in notes.splitlines():
        words = {word.strip("`*:.") for word in line.replace(",", " ").replace(";", " ").split()}
        if words & {name, name.removesuffix("_mm")} and "(" in line and ")" in line:
            return True
    return False


RULES = {
    one_way: {"core/checks.py": "from ..model import knee\n", "model/knee.py": ""},
    long_modules: {"core/a.py": "x = 1\n" * 301},
    long_functions: {"core/a.py": "def f():\n" + "    x = 1\n" * 41},
    many_arguments: {"core/a.py": "def f(a, b, c, d, e, f, g, h):\n    pass\n"},
    without_docstring: {"core/a.py": '"""A."""\ndef f():\n    pass\n'},
    open_the_disk: {"core/a.py": "open('x')\n"},
    absolute_imports: {"core/a.py": "from pssf.model import knee\n"},
    read_tables: {"xray/a.py": "tables.data('x')\n"},
    refuse_without_value: {"core/a.py": "raise InputError('no')\n"},
    arrays_without_shape: {"core/a.py": 'def f(a: Array):\n    """Nothing of a."""\n'},
}


@pytest.mark.parametrize("rule", RULES, ids=lambda rule: rule.__name__)
def test_the_package_keeps_the_rule(rule):
    assert SOURCES
    assert not list(rule(SOURCES))


@pytest.mark.parametrize("rule", RULES, ids=lambda rule: rule.__name__)
def test_the_rule_sees_a_planted_violation(rule):
    page = '"""P.\n\ncore  checks\nmodel  knee\nxray  beam\n"""\n'
    assert list(rule({"__init__.py": page, **RULES[rule]}))


@pytest.mark.parametrize(
    ("rule", "text"),
    [
        (open_the_disk, "table.to_csv('x')\n"),
        (open_the_disk, "path.write_bytes(b'x')\n"),
        (open_the_disk, "mkdir('x')\n"),
        (read_tables, "from ..data.tables import data\ndata('x')\n"),
        (absolute_imports, "import pssf.model.knee\n"),
        (refuse_without_value, "raise ValueError('no')\n"),
    ],
)
def test_the_rule_sees_a_violation_in_other_words(rule, text):
    assert list(rule({"core/a.py": text}))


@pytest.mark.parametrize(
    ("path", "text", "why"),
    [
        ("newroom/a.py", '"""A."""\n', "is not on the front page"),
        ("core/a.py", "from . import b\n", "imports itself"),
        ("core/a.py", "from ..model.knee import Knee\n", "to its right"),
    ],
)
def test_an_unknown_room_a_cycle_and_a_look_to_the_right_are_each_seen(path, text, why):
    others = {"core/b.py": "from . import a\n", "model/knee.py": ""}
    assert any(why in line for line in one_way({"__init__.py": SOURCES["__init__.py"], **others, path: text}))
