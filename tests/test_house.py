"""Check conventions that no linter has a rule for, and that each check detects a planted violation.

The order of imports, docstrings, positional arguments and readers of tables are rules of import-linter and ruff; see
`test_linters.py`. A rule here has its reason beside it in `RULES`.
"""

import ast
import re
from collections.abc import Iterable, Iterator
from fnmatch import fnmatch
from pathlib import Path

import pytest
from numpydoc.docscrape import NumpyDocString

import pssf

PACKAGE = Path(pssf.__file__).parent
SOURCES = {path.relative_to(PACKAGE).as_posix(): path.read_text() for path in sorted(PACKAGE.rglob("*.py"))}
# The only packages that open files: the package's own tables and the user's cache, and everything else.
DISK = ("data", "io")
OPENS = ("open", "read_text", "write_text", "read_bytes", "mkdir", "unlink", "rename", "touch", "rmtree", "copyfile")
# As methods of a path, of numpy or of a table; functions of `io` may be called so.
METHODS = ("write_bytes", "savez", "savez_compressed", "savetxt", "tofile", "fromfile", "to_csv", "to_json")
ERRORS = ("InputError", "ValueError", "TypeError")
# Module -> functions that may call readers of tables, beside what users call (`pssf.__all__`): the doors of the house,
# see `pssf.data`. A star stands for any public name.
DOORS = {
    "cli/*": "*",
    "validation/*": "*",
    # Names become the records that formulas are given.
    "anatomy/posture/knee_assembly.py": "load_jsw_protocol",
    "model/sampling/knee_sampling.py": "load_knee_distributions",
    "model/kellgren_lawrence.py": "require_grade",
    "radiomics/radiomics_tables.py": "radiomics_tables",
    "study/design/experiment_settings.py": "read_settings",
    "study/design/study_tables.py": "resolve_sampling_laws load_study_tables",
    "xray/resolved_technique.py": "resolve_technique",
    # What users call by other names: both knees of a person, fields and their values.
    "anatomy/knee_pair.py": "build_pair",
    # What is made beside it, and what comes with the package.
    "anatomy/knee_trabeculae.py": "make_texture",
    # What is usual of a parameter, for a refusal.
    "anatomy/bones/parameter_conflicts.py": "explain_conflicts",
    # What was built is built again where it arrives.
    "anatomy/built_knee.py": "build_in_posture",
    "model/field_listing.py": "list_fields format_knee_template apply_settings",
    # Files that are read or written whole.
    "cohort/label_export.py": "write_labels",
    "io/dicom/dicom_radiograph.py": "write_radiograph read_linear_radiograph read_own_dataset read_metadata",
    "io/patients/patient_dicom.py": "is_own_linear_dicom read_dicom_film",
    "io/dicom/dicom_segmentation.py": "write_segmentation",
    # What the page asks for, what it lists, what is made ahead of it.
    "explore/prefetch.py": "compute_spectra",
    "explore/request_schema.py": "resolve_state",
    "explore/page_listing.py": "build_listing",
    # Beginnings: of a cohort, of what reads films, of a measurement; tables that are derived anew.
    "benchmark/benchmark_maker.py": "make_benchmark",
    "cohort/cohort_plan.py": "plan_cohort preset_names",
    "quality/exposure_index.py": "measure_exposure_quantities compute_exposure_index compute_entrance_kerma_ugy",
    "quality/quality_measurement.py": "measure_quality",
    "patient_comparison/comparison_run.py": "compare_with_patients",
    "study/prediction/film_prediction.py": "predict_films",
}
# Where all but doors are formulas: these call no door either, which would read a table for them. The other rooms use
# the package as its users do.
FORMULAS = (
    *("geometry", "anatomy", "raycast", "xray", "scatter", "detector", "stages.py", "radiomics", "quality"),
    *(
        "patient_comparison/bones/bone_registration.py",
        "patient_comparison/bones/bone_comparison.py",
        "patient_comparison/contours/landmark_comparison.py",
        "patient_comparison/bones/bone_measures.py",
    ),
    *(
        "study/learn",
        "study/statistics",
        "study/prediction/patient_test.py",
        "study/measurement.py",
        "study/simulator_analyses.py",
    ),
)
# Of numbers; a share and a probability are of 1, and "unit" is of "a unit vector", "any unit" or "its own unit".
UNITS = {
    "mm", "mm2", "mm3", "1/mm", "1/mm2", "keV/mm2", "keV2/mm2", "px", "keV", "kV", "mGy", "uGy", "DN", "deg",
    "degrees", "g/cm2", "counts",
    "share", "shares", "probability", "probabilities", "dimensionless", "SD", "unit", "grey",
}  # fmt: skip
UNITS_IN_NAMES = ("mm", "mm2", "mm3", "px", "kev", "kev2", "kv", "mgy", "deg", "dn")
# Elements of arrays that need no unit: numbers of things, and whether.
WHOLE = ("int", "bool", "Any", "Faces", "Indices", "Ints", "Masks", "Signs")
SAYS_NOTHING = ("found", "told")
# Words that the field does not use, and the terms to write instead.
PRIVATE_WORDS = {
    "amid": "neighbour_mean_matrix", "evened": "laplacian_smooth", "unfolded": "fix_inverted_faces",
    "settle": "project_to_surface", "onto": "project_to_surface", "halved": "split_edges", "widened": "dilate_rings",
    "Stance": "KneeAssembly", "Grown": "BoneWithOsteophytes", "Beak": "Lip", "march": "integrate_density",
    "behind": "transmit_through_grid", "few_nodes": "spectrum_quadrature", "Crew": "Execution", "Shot": "Exposure",
    "left_out": "ablation", "again": "retest", "Clock": "Timer", "Meter": "Timer", "Pace": "Timer",
    "Prune": "DropRedundant",
}  # fmt: skip
# Plain English for a value: what lies behind, what is taken once more, what is left out, onto which something is laid.
PLAIN_AS_VALUES = ("again", "behind", "left_out", "onto")
DOCUMENTED = (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)
ARRAYS = (
    *("Array", "NDArray", "Block", "Faces", "Floats", "Frequencies", "Image", "Indices", "Ints", "Map", "Masks"),
    *("Signs", "Triples"),
)


def ghosts(
    sources: dict[str, str],
    doors: Iterable[str] = DOORS,
    formulas: Iterable[str] = FORMULAS,
    disk: Iterable[str] = DISK,
) -> Iterator[str]:
    """Entries of the lists of this file that no longer exist."""
    yield from (f"DOORS: {door}" for door in doors if not any(fnmatch(path, door) for path in sources))
    yield from (f"FORMULAS: {start}" for start in formulas if not any(path.startswith(start) for path in sources))
    yield from (f"DISK: {room}" for room in disk if not any(path.startswith(f"{room}/") for path in sources))


def long_modules(sources: dict[str, str]) -> Iterator[str]:
    """Find modules of more than 300 lines, not counting docstrings, which numpydoc makes long."""
    for path, text in sources.items():
        nodes = [node for node in ast.walk(ast.parse(text)) if isinstance(node, DOCUMENTED) and ast.get_docstring(node)]
        docstrings = sum(node.body[0].end_lineno - node.body[0].lineno + 1 for node in nodes)
        lines = len(text.splitlines()) - docstrings
        if lines > 300:
            yield f"{path}: {lines} lines"


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


def open_the_disk(sources: dict[str, str]) -> Iterator[str]:
    for path, text in sources.items():
        # numba's cache is in files, and what it compiles is left of `data`.
        if path.split("/")[0] in DISK or path == "core/kernel_cache.py":
            continue
        for node in ast.walk(ast.parse(text)):
            if isinstance(node, ast.Call):
                method = getattr(node.func, "attr", "")
                name = node.func.id if isinstance(node.func, ast.Name) else method
                # Without a path a table gives text.
                if name in OPENS or (method in METHODS and (node.args or not method.startswith("to_"))):
                    yield f"{path}: {name}"


def readers(sources: dict[str, str]) -> set[str]:
    """Functions of `data` that read a table, or call one that does."""
    functions = {
        node.name: {call.func.id for call in ast.walk(node) if isinstance(call, ast.Call) and hasattr(call.func, "id")}
        for path, text in sources.items()
        for node in ast.parse(text).body
        if path.startswith("data/") and isinstance(node, ast.FunctionDef)
    }
    reading = {"load_data_table", "read_toml"}
    while True:
        more = {name for name, called in functions.items() if called & reading} - reading
        if not more:
            return reading
        reading |= more


def _uses(tree: ast.AST, names: set[str], where: str = "") -> Iterator[tuple[str, str]]:
    """The function, its class before it, in which one of some names is read, "" for a module itself; and the name."""
    for child in ast.iter_child_nodes(tree):
        if isinstance(child, ast.Name) and isinstance(child.ctx, ast.Load) and child.id in names:
            yield where, child.id
        inner = isinstance(child, ast.FunctionDef | ast.ClassDef)
        of_module = names - _own(child) if isinstance(child, ast.FunctionDef) else names
        yield from _uses(child, of_module, f"{where}.{child.name}".strip(".") if inner else where)


def _own(function: ast.FunctionDef) -> set[str]:
    """Names of arguments and variables of a function, which hide those of its module."""
    stored = {node.id for node in ast.walk(function) if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store)}
    return stored | {node.arg for node in ast.walk(function) if isinstance(node, ast.arg)}


def _places(sources: dict[str, str]) -> dict[str, dict[str, str]]:
    """Path -> name that is known there -> where it is from: "path:name" of a definition, "path:" of a module."""
    trees = {path: ast.parse(text) for path, text in sources.items()}
    places: dict[str, dict[str, str]] = {}
    for path, tree in trees.items():
        kinds = (ast.FunctionDef, ast.ClassDef)
        places[path] = {node.name: f"{path}:{node.name}" for node in tree.body if isinstance(node, kinds)}
        for node in ast.walk(tree):
            if isinstance(node, ast.ImportFrom) and node.level:
                base = path.split("/")[: -node.level] + (node.module or "").split(".")
                inside = "/".join(part for part in base if part)
                for alias in _named(node, trees.get(f"{inside}.py")):
                    whole = f"{inside}/{alias.name}".strip("/")
                    module = next((one for one in (f"{whole}.py", f"{whole}/__init__.py") if one in sources), None)
                    at = next((one for one in (f"{inside}.py", f"{inside}/__init__.py") if one in sources), inside)
                    places[path][alias.asname or alias.name] = f"{module}:" if module else f"{at}:{alias.name}"
    return places


def _named(node: ast.ImportFrom, module: ast.Module | None) -> list[ast.alias]:
    """What is imported by name; of a star all functions and classes of the module."""
    if node.names[0].name != "*" or module is None:
        return node.names
    return [ast.alias(one.name) for one in module.body if isinstance(one, ast.FunctionDef | ast.ClassDef)]


def _origin(places: dict[str, dict[str, str]], place: str) -> str:
    """Where a name is defined that others pass on."""
    path, name = place.split(":")
    further = places.get(path, {}).get(name, place) if name else place
    return place if further == place else _origin(places, further)


def users_verbs(front_page: str, places: dict[str, dict[str, str]]) -> set[str]:
    """Where the names of the front page are defined."""
    tree = ast.parse(front_page)
    tables = [node.value for node in tree.body if isinstance(node, ast.Assign) and node.targets[0].id == "_WHERE"]
    verbs = set()
    for module, names in (ast.literal_eval(tables[0]) if tables else {}).items():
        path = module.replace(".", "/")
        path = f"{path}.py" if f"{path}.py" in places else f"{path}/__init__.py"
        verbs |= {_origin(places, f"{path}:{name}") for name in names}
    return verbs


def _is_listed(path: str, function: str) -> bool:
    public = not any(part.startswith("_") for part in function.split("."))
    return public and any(
        fnmatch(path, module) and fnmatch(function, name) for module, names in DOORS.items() for name in names.split()
    )


def read_behind_the_door(sources: dict[str, str]) -> Iterator[str]:
    """Calls of readers elsewhere than at a door, calls of doors by formulas, and doors that are none: see `pssf.data`.

    A record of the model may read what its own fields may be, when it is made; what is sent to a process (__reduce__)
    names the door that makes it there.
    """
    places, reading = _places(sources), readers(sources)
    verbs = users_verbs(sources.get("__init__.py", ""), places)
    calls = list[tuple[str, str, str]]()
    for path, text in sources.items():
        origins = {name: _origin(places, place) for name, place in places[path].items()}
        tree = ast.parse(text)
        for function, name in _uses(tree, set(origins)):
            calls.append((path, function, origins[name]))
        if path.startswith("data/"):
            records = [node for node in tree.body if isinstance(node, ast.ClassDef)]
            yield from (f"{path}:{one.name} reads a table" for one in records if [*_uses(one, reading)])

    def is_door(place: str) -> bool:
        return place in verbs or _is_listed(*place.split(":"))

    def reads(origin: str) -> bool:
        # Behind a whole module its readers would not be seen.
        path, name = origin.split(":")
        return path.split("/")[0] == "data" and (name in reading or name in ("", "*", "data"))

    led = {f"{path}:{function}" for path, function, origin in calls if reads(origin) and not path.startswith("data/")}
    while more := {f"{path}:{function}" for path, function, origin in calls if origin in led} - led:
        led |= more
    for path, function, origin in calls:
        place = f"{path}:{function}"
        born = path.startswith("model/") and function.endswith(".__post_init__")
        sent = function.endswith(".__reduce__")
        script = not function and origin == f"{path}:main"
        if path.startswith("data/") or is_door(place) or born or sent or script:
            continue
        if reads(origin):
            yield f"{place} reads a table"
        elif path.startswith(FORMULAS) and origin in led:
            yield f"{place} is a formula, and has a table read for it by {origin}"
    listed = {f"{path}:{name}" for path, names in DOORS.items() if path in sources for name in names.split()}
    listed = {door for door in listed if "*" not in door}
    yield from (f"{door} is no door: it reads nothing" for door in sorted(listed - led))
    yield from (f"{door} is no door: it is private" for door in sorted(listed) if ":_" in door or "._" in door)


def refuse_without_value(sources: dict[str, str]) -> Iterator[str]:
    """Errors whose text is the same whatever was given, and has no name = value.

    What is not seen: a text from elsewhere (a variable, a function, pieces joined by + or %), and whether what an
    f-string has put into it is the value that is refused.
    """
    for path, text in sources.items():
        for node in ast.walk(ast.parse(text)):
            if isinstance(node, ast.Call) and getattr(node.func, "id", "") in ERRORS and node.args:
                said = _same_text(node.args[0])
                if said is not None and " = " not in said:
                    yield f"{path}:{node.lineno}: {said!r}"


def _same_text(node: ast.expr) -> str | None:
    """What a text always is, of an f-string too; None where something is put into it."""
    parts = node.values if isinstance(node, ast.JoinedStr) else [node]
    if all(isinstance(part, ast.Constant) for part in parts):
        return "".join(str(part.value) for part in parts)
    return None


def _array_arguments(sources: dict[str, str]) -> Iterator[tuple[str, str, str, list[str]]]:
    """Where, name, type and the lines of the docstrings that name it, of array arguments of public functions."""
    for path, text in sources.items():
        for node in ast.parse(text).body:
            methods = node.body if isinstance(node, ast.ClassDef) else [node]
            for function in methods:
                if isinstance(function, ast.FunctionDef) and not function.name.startswith("_"):
                    notes = ast.get_docstring(function) or ""
                    if function.name == "__init__":
                        notes = ast.get_docstring(node) or ""
                    for argument in _arguments(function):
                        if argument.annotation and _holds_arrays(argument.annotation):
                            kind = ast.unparse(argument.annotation)
                            yield f"{path}:{function.name}", argument.arg, kind, _naming(argument.arg, notes)


def _arguments(function: ast.FunctionDef) -> list[ast.arg]:
    args = function.args
    starred = [one for one in (args.vararg, args.kwarg) if one is not None]
    return [*args.posonlyargs, *args.args, *args.kwonlyargs, *starred]


def _holds_arrays(annotation: ast.expr) -> bool:
    """Whether a type is an array's, or of what may be one or holds some; functions of arrays are none."""
    if isinstance(annotation, ast.Constant) and isinstance(annotation.value, str):
        return _holds_arrays(ast.parse(annotation.value, mode="eval").body)
    if isinstance(annotation, ast.Subscript):
        name = ast.unparse(annotation.value)
        return name in ARRAYS or ("Callable" not in name and _holds_arrays(annotation.slice))
    if isinstance(annotation, ast.Name):
        return annotation.id in ARRAYS
    return any(_holds_arrays(part) for part in ast.iter_child_nodes(annotation) if isinstance(part, ast.expr))


def _naming(name: str, docstring: str) -> list[str]:
    """Find the numpydoc entry of a parameter: its type, then its description."""
    sections = NumpyDocString(docstring)
    for entry in (*sections["Parameters"], *sections["Attributes"]):
        if name in {one.strip(" *\\") for one in entry.name.split(",")}:
            return [entry.type, *entry.desc]
    return []


def arrays_without_shape(sources: dict[str, str]) -> Iterator[str]:
    """Find array parameters of public functions whose documented type has no shape."""
    for where, name, _, lines in _array_arguments(sources):
        if not any("(" in line and ")" in line for line in lines):
            yield f"{where}: {name}"


def arrays_without_unit(sources: dict[str, str]) -> Iterator[str]:
    """Find parameters that are arrays of floats with a unit neither in their name nor in their documentation."""
    for where, name, kind, lines in _array_arguments(sources):
        words = re.split(r"[\s,;()`*:.]+", " ".join(lines))
        whole = any(word in kind for word in WHOLE) and "float" not in kind
        named = any(name.endswith(f"_{unit}") for unit in UNITS_IN_NAMES)
        if not whole and not named and not UNITS & set(words):
            yield f"{where}: {name}"


def say_nothing(sources: dict[str, str]) -> Iterator[str]:
    """Variables, arguments and fields whose names do not say what they hold."""
    for path, text in sources.items():
        for node in ast.walk(ast.parse(text)):
            for kind in ("id", "arg", "attr", "name"):
                if str(getattr(node, kind, "")).strip("_") in SAYS_NOTHING:
                    yield f"{path}:{node.lineno}: {getattr(node, kind)}"


def private_words(sources: dict[str, str]) -> Iterator[str]:
    """Modules, functions, classes, arguments and variables by a word of our own, where the field has one."""
    for path, text in sources.items():
        nodes = list(ast.walk(ast.parse(text)))
        values = [node.id for node in nodes if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store)]
        values += [node.attr for node in nodes if isinstance(node, ast.Attribute) and isinstance(node.ctx, ast.Store)]
        values += [node.arg for node in nodes if isinstance(node, ast.arg)]
        defined = [node.name for node in nodes if isinstance(node, ast.FunctionDef | ast.ClassDef)]
        barred = [name for name in values if name.strip("_") not in PLAIN_AS_VALUES]
        for name in (Path(path).stem, *defined, *barred):
            if name.strip("_") in PRIVATE_WORDS:
                yield f"{path}: {name}, which is {PRIVATE_WORDS[name.strip('_')]}"


# A table and its reader.
TABLES = {"data/a.py": "def reader():\n    return load_data_table('a')\n"}
# A house with a door, a verb that reads a table, a helper that has it done, and a room that passes a reader on.
HOUSE = {
    **TABLES,
    "__init__.py": '_WHERE = {"detector": ("show",), "model.protocol": ("load_protocol",)}\n',
    "data/__init__.py": "",
    "data/b.py": "from .a import reader\ndef wrapped():\n    return reader()\n",
    "cohort/a.py": "from ..xray.resolved_technique import resolve_technique\ndef helper():\n    resolve_technique()\n",
    "detector/__init__.py": "from .showing import show\n",
    "detector/showing.py": "from ..data.a import reader\ndef show():\n    reader()\n",
    "model/passing.py": "from ..data.a import reader\n",
    "model/protocol.py": "from ..data.a import reader\ndef load_protocol():\n    reader()\n",
    "xray/resolved_technique.py": "from ..data.a import reader\ndef resolve_technique():\n    reader()\n",
}


def callees_from_python(sources: dict[str, str]) -> Iterator[str]:
    """Calls of a `kernel_helper` from functions that are not compiled: it has no entry from Python, and crashes."""
    places = _places(sources)
    functions = [
        (path, node)
        for path, text in sources.items()
        for node in ast.walk(ast.parse(text))
        if isinstance(node, ast.FunctionDef)
    ]

    def is_marked(node: ast.FunctionDef, *marks: str) -> bool:
        return any(ast.unparse(mark).split("(")[0] in marks for mark in node.decorator_list)

    helpers = {f"{path}:{node.name}" for path, node in functions if is_marked(node, "kernel_helper")}
    for path, node in functions:
        if not is_marked(node, "kernel", "kernel_helper"):
            called = {name for name, place in places[path].items() if _origin(places, place) in helpers}
            yield from (f"{path}:{node.name} calls {name}" for _, name in _uses(node, called))


RULES = {
    # ruff does not know decorators of this package.
    callees_from_python: {"core/a.py": "@kernel_helper\ndef f():\n    pass\ndef g():\n    f()\n"},
    # The lists are of this file.
    ghosts: {"core/a.py": ""},
    # ruff has no rule for the length of a module.
    long_modules: {"core/a.py": "x = 1\n" * 301},
    # PLR0915 of ruff counts statements; 40 lines below a docstring are stricter than 40 statements.
    long_functions: {"core/a.py": "def f():\n" + "    x = 1\n" * 41},
    # TID251 of ruff sees functions, but not methods such as `path.write_text`.
    open_the_disk: {"core/a.py": "open('x')\n"},
    # import-linter sees modules; this rule is about functions.
    read_behind_the_door: {**TABLES, "xray/a.py": "from ..data.a import reader\ndef f():\n    reader()\n"},
    # No linter reads shapes and units in the types of docstrings.
    arrays_without_unit: {
        "core/a.py": 'def f(a: Array):\n    """Do it.\n\n    Parameters\n    ----------\n    a : (n,) array\n    """\n'
    },
    arrays_without_shape: {"core/a.py": 'def f(a: Array):\n    """Nothing of a."""\n'},
    # ruff has no list of forbidden names.
    say_nothing: {"core/a.py": "def _found():\n    pass\n"},
    private_words: {"core/a.py": "class A:\n    def _amid(self):\n        pass\n"},
    # No linter reads the values in the text of an error.
    refuse_without_value: {"core/a.py": "raise InputError('no')\n"},
}


@pytest.mark.parametrize("rule", RULES, ids=lambda rule: rule.__name__)
def test_the_package_follows_the_rule(rule):
    assert SOURCES
    assert not list(rule(SOURCES))


@pytest.mark.parametrize("rule", RULES, ids=lambda rule: rule.__name__)
def test_the_rule_detects_a_planted_violation(rule):
    assert list(rule({"__init__.py": "", **RULES[rule]}))


@pytest.mark.parametrize(
    ("rule", "text"),
    [
        (open_the_disk, "table.to_csv('x')\n"),
        (open_the_disk, "path.write_bytes(b'x')\n"),
        (open_the_disk, "mkdir('x')\n"),
        (say_nothing, "def f(told):\n    pass\n"),
        (say_nothing, "class A:\n    found: int\n"),
        (say_nothing, "def f(a):\n    return a.found\n"),
        (say_nothing, "with a as told:\n    pass\n"),
        (say_nothing, "f(found=1)\n"),
        (private_words, "class Stance:\n    pass\n"),
        (private_words, "def f(amid):\n    pass\n"),
        (private_words, "def f(*, evened=None):\n    pass\n"),
        (private_words, "def f():\n    for amid in ():\n        pass\n"),
        (private_words, "class A:\n    halved: int\n"),
        (private_words, "def again():\n    pass\n"),
        (refuse_without_value, "raise ValueError('no')\n"),
        (refuse_without_value, "raise ValueError(f'no')\n"),
        (refuse_without_value, "raise ValueError('of two ' f'pieces')\n"),
        (arrays_without_shape, "def f(a: Array | None = None):\n    pass\n"),
        (arrays_without_shape, "def f(a: list[Array]):\n    pass\n"),
        (arrays_without_shape, "def f(a: 'Mapping[str, tuple[NDArray[np.float32], int]]'):\n    pass\n"),
        (arrays_without_shape, "def f(*, a: Rows | Array):\n    pass\n"),
        (arrays_without_shape, "def f(*a: Array):\n    pass\n"),
        (arrays_without_unit, "def f(a: Array | None = None):\n    pass\n"),
    ],
)
def test_the_rule_detects_a_variant_of_a_violation(rule, text):
    assert list(rule({"core/a.py": text}))


@pytest.mark.parametrize(
    ("argument", "entry", "kept"),
    [
        ("a_mm: Array", "a_mm : (n,) array", True),
        ("a: Array", "a : (n,) array, mm", True),
        ("a: NDArray[np.floating]", "a : (n,) array, in any unit", True),
        ("a: NDArray[np.int64]", "a : (n,) array of vertex numbers", True),
        ("a: NDArray[np.integer | np.floating]", "a : (n,) array of numbers", False),
        ("a: Array", "a : (n,) array", False),
        ("a: Array", "b : (n,) array, mm", False),
    ],
)
def test_the_unit_of_an_array_is_in_its_name_or_documentation(argument, entry, kept):
    text = f'def f({argument}):\n    """Do it.\n\n    Parameters\n    ----------\n    {entry}\n    """\n'
    assert kept is not any(arrays_without_unit({"core/a.py": text}))


@pytest.mark.parametrize(
    ("path", "text"),
    [
        ("xray/a.py", "from ..data.a import reader\nTABLE = reader()\n"),
        ("xray/a.py", "from ..data.a import reader as mine\nclass A:\n    def f(self):\n        mine()\n"),
        ("xray/a.py", "from ..data import a\ndef f():\n    a.reader()\n"),
        ("study/learn/a.py", "from ...data.b import wrapped\ndef f(make=wrapped):\n    make()\n"),
        ("model/a.py", "from ..data.a import reader\nclass A:\n    def other(self):\n        reader()\n"),
        ("anatomy/a.py", "from ..model.protocol import load_protocol\ndef f():\n    load_protocol('a')\n"),
        ("xray/resolved_technique.py", "def resolve_technique():\n    pass\n"),
        ("xray/a.py", "from .. import data\ndef f():\n    data.a.reader()\n"),
        ("xray/a.py", "from ..data.a import *\ndef f():\n    reader()\n"),
        ("xray/a.py", "from ..model.passing import reader\ndef f():\n    reader()\n"),
        ("xray/a.py", "def f():\n    from ..data.a import reader\n    reader()\n"),
        ("study/learn/a.py", "from ...detector import show\ndef f():\n    show()\n"),
        (
            "quality/a.py",
            "from ..xray.resolved_technique import resolve_technique\ndef f():\n    resolve_technique()\n",
        ),
        ("quality/a.py", "from ..cohort.a import helper\ndef f():\n    helper()\n"),
        ("data/c.py", "from .a import reader\nclass C:\n    def f(self):\n        return reader()\n"),
        ("cli/a.py", "from ..data.a import reader\ndef _f():\n    reader()\n"),
    ],
    ids=[
        *("constant", "renamed", "module", "wrapped", "not at birth", "protocol", "no door", "package", "star"),
        *("passed on", "inside", "verb", "door", "by a helper", "record", "private"),
    ],
)
def test_a_table_read_outside_an_entry_point_is_detected(path, text):
    assert list(read_behind_the_door({**HOUSE, path: text}))


@pytest.mark.parametrize(
    ("path", "text"),
    [
        ("xray/resolved_technique.py", "from ..data.a import reader\ndef resolve_technique():\n    reader()\n"),
        ("model/a.py", "from ..data.a import reader\nclass A:\n    def __post_init__(self):\n        reader()\n"),
        ("validation/a.py", "from ..model.protocol import load_protocol\ndef f():\n    load_protocol('a')\n"),
        ("xray/a.py", "from ..data.a import Kind\ndef f(reader: Kind):\n    reader()\n"),
        ("xray/a.py", "from ..detector import show\ndef f(show):\n    show()\n"),
        ("cohort/a.py", "from ..detector import show\ndef f():\n    show()\n"),
        ("detector/showing.py", "from ..data.a import reader\ndef show():\n    reader()\n"),
        ("validation/a.py", "from ..data.a import reader\ndef some_rows():\n    reader()\n"),
    ],
    ids=["door", "at birth", "measurement", "argument", "verb as argument", "user of a verb", "verb", "rows"],
)
def test_a_table_read_in_an_entry_point_is_allowed(path, text):
    assert not list(read_behind_the_door({**HOUSE, path: text}))


def test_public_functions_are_found_from_the_package_docstring():
    verbs = users_verbs(SOURCES["__init__.py"], _places(SOURCES))
    assert len(verbs) == len(set(pssf.__all__) - {"__version__"})
    assert {
        "anatomy/built_knee.py:build",
        "detector/display_rendering.py:render_for_display",
        "simulation.py:simulate",
    } < verbs


@pytest.mark.parametrize(
    ("lists", "why"),
    [
        ({"doors": [*DOORS, "anatomy/spirit.py"]}, "DOORS: anatomy/spirit.py"),
        ({"doors": [*DOORS, "spirit/*"]}, "DOORS: spirit/*"),
        ({"formulas": [*FORMULAS, "patient_comparison/spirit"]}, "FORMULAS: patient_comparison/spirit"),
        ({"disk": [*DISK, "spirit"]}, "DISK: spirit"),
    ],
)
def test_a_listed_name_that_no_longer_exists_is_detected(lists, why):
    assert list(ghosts(SOURCES, **lists)) == [why]


@pytest.mark.parametrize(
    "text", ["raise ValueError(f'a = {a}')\n", "raise ValueError('no' f' {a}')\n", "raise ValueError('a = 1')\n"]
)
def test_an_error_message_with_a_value_is_allowed(text):
    assert not list(refuse_without_value({"core/a.py": text}))


@pytest.mark.parametrize("kind", ["Callable[[Array], Array]", "Callable[[Array], Array] | None", "list[int]"])
def test_a_callable_with_array_arguments_needs_no_shape(kind):
    assert not list(arrays_without_shape({"core/a.py": f"def f(a: {kind}):\n    pass\n"}))
