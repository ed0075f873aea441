"""Check conventions that no linter has a rule for, and that each check detects a planted violation.

The order of imports, docstrings, positional arguments and readers of tables are rules of import-linter and ruff; see
`test_linters.py`. The comments in `RULES` state why each rule is
checked here.
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
# The only packages that open files: `data` for package tables and the user cache, `io` for all other files.
FILE_PACKAGES = ("data", "io")
FILE_FUNCTIONS = (
    "open",
    "read_text",
    "write_text",
    "read_bytes",
    "mkdir",
    "unlink",
    "rename",
    "touch",
    "rmtree",
    "copyfile",
)
# Methods of paths, numpy arrays and tables that access files; functions of `io` may have the same names.
FILE_METHODS = ("write_bytes", "savez", "savez_compressed", "savetxt", "tofile", "fromfile", "to_csv", "to_json")
ERRORS = ("InputError", "ValueError", "TypeError")
# Module -> entry points: functions that may read tables (see `pssf.data`). The public functions in `pssf.__all__` are
# also entry points. A star means all public functions.
ENTRY_POINTS = {
    "cli/*": "*",
    "validation/*": "*",
    # Functions that accept a table name and load the record that the formulas use.
    "anatomy/posture/knee_assembly.py": "load_jsw_protocol",
    "model/sampling/knee_sampling.py": "load_knee_distributions",
    "model/kellgren_lawrence.py": "require_grade",
    "model/detector.py": "load_detectors load_detector resolve_detector",
    "radiomics/radiomics_tables.py": "radiomics_tables",
    "study/design/experiment_settings.py": "read_settings",
    "study/design/study_tables.py": "resolve_sampling_laws load_study_tables",
    "xray/resolved_technique.py": "resolve_technique",
    # Function behind a public function with another name.
    "anatomy/knee_pair.py": "build_pair",
    # Function that makes the trabecular texture with the table of the package.
    "anatomy/knee_trabeculae.py": "make_texture",
    # Function that quotes the usual values of parameters in an error message.
    "anatomy/bones/parameter_conflicts.py": "explain_conflicts",
    # Functions that rebuild a pickled knee, and that list fields and their values.
    "anatomy/built_knee.py": "build_in_posture",
    "model/field_listing.py": "list_fields format_knee_template apply_settings",
    # Functions that read or write complete files.
    "cohort/label_export.py": "write_labels",
    "io/dicom/dicom_radiograph.py": "write_radiograph read_linear_radiograph read_own_dataset read_metadata",
    "io/patients/patient_dicom.py": "is_own_linear_dicom read_dicom_film",
    "io/dicom/dicom_segmentation.py": "write_segmentation",
    # Functions that prefetch spectra, resolve requests and list fields for the interactive page.
    "explore/prefetch.py": "compute_spectra",
    "explore/request_schema.py": "resolve_state",
    "explore/page_listing.py": "build_listing",
    # Functions that start a benchmark, a cohort, a measurement, a comparison or a prediction.
    "benchmark/benchmark_maker.py": "make_benchmark",
    "cohort/cohort_plan.py": "plan_cohort preset_names",
    "dataset/dataset_tables.py": "load_dataset_tables",
    "quality/exposure_index.py": "measure_exposure_quantities compute_exposure_index compute_entrance_kerma_ugy",
    "quality/quality_measurement.py": "measure_quality",
    "patient_comparison/comparison_run.py": "compare_with_patients",
    "study/prediction/film_prediction.py": "predict_films",
    "trial/trial_design.py": "load_trial_design",
    "trial/trial_run.py": "run_trial",
}
# Modules that evaluate formulas: their functions, except entry points, must call neither readers of tables nor entry
# points. All other modules may call entry points.
FORMULA_MODULES = (
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
# Words that specify the unit of an array. "share" and "probability" are fractions of 1; "unit" occurs in "unit vector"
# and "any unit".
UNITS = {
    "mm", "mm2", "mm3", "1/mm", "1/mm2", "keV/mm2", "keV2/mm2", "px", "keV", "kV", "mGy", "uGy", "DN", "deg",
    "degrees", "g/cm2", "counts", "1/angstrom2",
    "share", "shares", "probability", "probabilities", "dimensionless", "SD", "unit", "grey",
}  # fmt: skip
UNITS_IN_NAMES = ("mm", "mm2", "mm3", "px", "kev", "kev2", "kv", "mgy", "deg", "dn")
# Element types of arrays that need no unit: counts, indices and booleans.
UNITLESS_TYPES = ("int", "bool", "Any", "Faces", "Indices", "Ints", "Masks", "Signs")
MEANINGLESS_NAMES = ("found", "told")
# Former private words -> names to use instead.
PRIVATE_WORDS = {
    "amid": "neighbour_mean_matrix", "evened": "laplacian_smooth", "unfolded": "fix_inverted_faces",
    "settle": "project_to_surface", "onto": "project_to_surface", "halved": "split_edges", "widened": "dilate_rings",
    "Stance": "KneeAssembly", "Grown": "BoneWithOsteophytes", "Beak": "Lip", "march": "integrate_density",
    "behind": "transmit_through_grid", "few_nodes": "spectrum_quadrature", "Crew": "Execution", "Shot": "Exposure",
    "left_out": "ablation", "again": "retest", "Clock": "Timer", "Meter": "Timer", "Pace": "Timer",
    "Prune": "DropRedundant",
}  # fmt: skip
# Private words that are allowed as names of variables, attributes and arguments.
ALLOWED_AS_VALUES = ("again", "behind", "left_out", "onto")
DOCUMENTED = (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)
ARRAYS = (
    *("Array", "NDArray", "Block", "Faces", "Floats", "Frequencies", "Image", "Indices", "Ints", "Map", "Masks"),
    *("Signs", "Triples"),
)


def outdated_list_entries(
    sources: dict[str, str],
    entry_points: Iterable[str] = ENTRY_POINTS,
    formulas: Iterable[str] = FORMULA_MODULES,
    file_packages: Iterable[str] = FILE_PACKAGES,
) -> Iterator[str]:
    """Find entries in the lists of this file that match no module of the package."""
    yield from (
        f"ENTRY_POINTS: {entry_point}"
        for entry_point in entry_points
        if not any(fnmatch(path, entry_point) for path in sources)
    )
    yield from (
        f"FORMULA_MODULES: {start}" for start in formulas if not any(path.startswith(start) for path in sources)
    )
    yield from (
        f"FILE_PACKAGES: {package}"
        for package in file_packages
        if not any(path.startswith(f"{package}/") for path in sources)
    )


def long_modules(sources: dict[str, str]) -> Iterator[str]:
    """Find modules of more than 300 lines, not counting docstrings, which are long in the numpydoc style."""
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


def file_access_elsewhere(sources: dict[str, str]) -> Iterator[str]:
    for path, text in sources.items():
        # The numba cache consists of files, and `core` must not import `data`.
        if path.split("/")[0] in FILE_PACKAGES or path == "core/kernel_cache.py":
            continue
        for node in ast.walk(ast.parse(text)):
            if isinstance(node, ast.Call):
                method = getattr(node.func, "attr", "")
                name = node.func.id if isinstance(node.func, ast.Name) else method
                # A table method without a path argument returns text instead of writing a file.
                if name in FILE_FUNCTIONS or (method in FILE_METHODS and (node.args or not method.startswith("to_"))):
                    yield f"{path}: {name}"


def readers(sources: dict[str, str]) -> set[str]:
    """Find functions of `data` that read a table directly or through another function."""
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


def _find_uses(tree: ast.AST, names: set[str], where: str = "") -> Iterator[tuple[str, str]]:
    """Yield each use of `names` as (function with its class, name); the function is "" at module level."""
    for child in ast.iter_child_nodes(tree):
        if isinstance(child, ast.Name) and isinstance(child.ctx, ast.Load) and child.id in names:
            yield where, child.id
        inner = isinstance(child, ast.FunctionDef | ast.ClassDef)
        of_module = names - _collect_local_names(child) if isinstance(child, ast.FunctionDef) else names
        yield from _find_uses(child, of_module, f"{where}.{child.name}".strip(".") if inner else where)


def _collect_local_names(function: ast.FunctionDef) -> set[str]:
    """Collect names of arguments and local variables of a function, which hide names of the module."""
    stored = {node.id for node in ast.walk(function) if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store)}
    return stored | {node.arg for node in ast.walk(function) if isinstance(node, ast.arg)}


def _map_origins(sources: dict[str, str]) -> dict[str, dict[str, str]]:
    """Map path -> name -> origin of all names in a module; origins are "path:name", or "path:" for a module."""
    trees = {path: ast.parse(text) for path, text in sources.items()}
    places: dict[str, dict[str, str]] = {}
    for path, tree in trees.items():
        kinds = (ast.FunctionDef, ast.ClassDef)
        places[path] = {node.name: f"{path}:{node.name}" for node in tree.body if isinstance(node, kinds)}
        for node in ast.walk(tree):
            if isinstance(node, ast.ImportFrom) and node.level:
                base = path.split("/")[: -node.level] + (node.module or "").split(".")
                inside = "/".join(part for part in base if part)
                for alias in _list_imported_names(node, trees.get(f"{inside}.py")):
                    whole = f"{inside}/{alias.name}".strip("/")
                    module = next((one for one in (f"{whole}.py", f"{whole}/__init__.py") if one in sources), None)
                    at = next((one for one in (f"{inside}.py", f"{inside}/__init__.py") if one in sources), inside)
                    places[path][alias.asname or alias.name] = f"{module}:" if module else f"{at}:{alias.name}"
    return places


def _list_imported_names(node: ast.ImportFrom, module: ast.Module | None) -> list[ast.alias]:
    """List the names that a statement imports; a star import gives all functions and classes of the module."""
    if node.names[0].name != "*" or module is None:
        return node.names
    return [ast.alias(one.name) for one in module.body if isinstance(one, ast.FunctionDef | ast.ClassDef)]


def _find_origin(places: dict[str, dict[str, str]], place: str) -> str:
    """Find the definition of a name that other modules re-export."""
    path, name = place.split(":")
    further = places.get(path, {}).get(name, place) if name else place
    return place if further == place else _find_origin(places, further)


def find_public_functions(front_page: str, places: dict[str, dict[str, str]]) -> set[str]:
    """Find the definitions of the public names in `pssf/__init__.py`."""
    tree = ast.parse(front_page)
    tables = [node.value for node in tree.body if isinstance(node, ast.Assign) and node.targets[0].id == "_WHERE"]
    public_functions = set()
    for module, names in (ast.literal_eval(tables[0]) if tables else {}).items():
        path = module.replace(".", "/")
        path = f"{path}.py" if f"{path}.py" in places else f"{path}/__init__.py"
        public_functions |= {_find_origin(places, f"{path}:{name}") for name in names}
    return public_functions


def _is_listed(path: str, function: str) -> bool:
    public = not any(part.startswith("_") for part in function.split("."))
    return public and any(
        fnmatch(path, module) and fnmatch(function, name)
        for module, names in ENTRY_POINTS.items()
        for name in names.split()
    )


def table_reads_outside_entry_points(sources: dict[str, str]) -> Iterator[str]:
    """Find tables that are read outside entry points, formulas that call entry points, and wrong entry points.

    The construction of a record of the model (__post_init__) may read the allowed values of its fields. Pickling
    (__reduce__) may refer to the entry point that rebuilds the object. See `pssf.data`.
    """
    places, reading = _map_origins(sources), readers(sources)
    public_functions = find_public_functions(sources.get("__init__.py", ""), places)
    calls = list[tuple[str, str, str]]()
    for path, text in sources.items():
        origins = {name: _find_origin(places, place) for name, place in places[path].items()}
        tree = ast.parse(text)
        for function, name in _find_uses(tree, set(origins)):
            calls.append((path, function, origins[name]))
        if path.startswith("data/"):
            records = [node for node in tree.body if isinstance(node, ast.ClassDef)]
            yield from (f"{path}:{one.name} reads a table" for one in records if [*_find_uses(one, reading)])

    def is_entry_point(place: str) -> bool:
        return place in public_functions or _is_listed(*place.split(":"))

    def reads(origin: str) -> bool:
        # Use of an entire module of `data` counts as a read, because the called functions are unknown.
        path, name = origin.split(":")
        return path.split("/")[0] == "data" and (name in reading or name in ("", "*", "data"))

    reading_functions = {
        f"{path}:{function}" for path, function, origin in calls if reads(origin) and not path.startswith("data/")
    }
    while (
        more := {f"{path}:{function}" for path, function, origin in calls if origin in reading_functions}
        - reading_functions
    ):
        reading_functions |= more
    for path, function, origin in calls:
        place = f"{path}:{function}"
        in_construction = path.startswith("model/") and function.endswith(".__post_init__")
        in_pickling = function.endswith(".__reduce__")
        script = not function and origin == f"{path}:main"
        if path.startswith("data/") or is_entry_point(place) or in_construction or in_pickling or script:
            continue
        if reads(origin):
            yield f"{place} reads a table"
        elif path.startswith(FORMULA_MODULES) and origin in reading_functions:
            yield f"{place} is a formula and must not call {origin}"
    listed = {f"{path}:{name}" for path, names in ENTRY_POINTS.items() if path in sources for name in names.split()}
    listed = {entry_point for entry_point in listed if "*" not in entry_point}
    yield from (
        f"{entry_point} must not be listed as entry point: it reads no table"
        for entry_point in sorted(listed - reading_functions)
    )
    yield from (
        f"{entry_point} must not be listed as entry point: it is private"
        for entry_point in sorted(listed)
        if ":_" in entry_point or "._" in entry_point
    )


def errors_without_value(sources: dict[str, str]) -> Iterator[str]:
    """Find errors with a constant message that contains no `name = value`.

    Messages from variables, functions, or strings joined by + or % are not checked. Whether an f-string contains the
    rejected value is not checked either.
    """
    for path, text in sources.items():
        for node in ast.walk(ast.parse(text)):
            if isinstance(node, ast.Call) and getattr(node.func, "id", "") in ERRORS and node.args:
                said = _constant_text(node.args[0])
                if said is not None and " = " not in said:
                    yield f"{path}:{node.lineno}: {said!r}"


def _constant_text(node: ast.expr) -> str | None:
    """Return the text of a constant string or f-string; None if the f-string inserts a value."""
    parts = node.values if isinstance(node, ast.JoinedStr) else [node]
    if all(isinstance(part, ast.Constant) for part in parts):
        return "".join(str(part.value) for part in parts)
    return None


def _array_arguments(sources: dict[str, str]) -> Iterator[tuple[str, str, str, list[str]]]:
    """Yield function, name, type and docstring entry of each array argument of public functions."""
    for path, text in sources.items():
        for node in ast.parse(text).body:
            methods = node.body if isinstance(node, ast.ClassDef) else [node]
            for function in methods:
                if isinstance(function, ast.FunctionDef) and not function.name.startswith("_"):
                    notes = ast.get_docstring(function) or ""
                    if function.name == "__init__":
                        notes = ast.get_docstring(node) or ""
                    for argument in _arguments(function):
                        if argument.annotation and _contains_arrays(argument.annotation):
                            kind = ast.unparse(argument.annotation)
                            yield (
                                f"{path}:{function.name}",
                                argument.arg,
                                kind,
                                _find_docstring_entry(argument.arg, notes),
                            )


def _arguments(function: ast.FunctionDef) -> list[ast.arg]:
    args = function.args
    starred = [one for one in (args.vararg, args.kwarg) if one is not None]
    return [*args.posonlyargs, *args.args, *args.kwonlyargs, *starred]


def _contains_arrays(annotation: ast.expr) -> bool:
    """Report whether a type is an array, or a union or container with arrays; callables do not count."""
    if isinstance(annotation, ast.Constant) and isinstance(annotation.value, str):
        return _contains_arrays(ast.parse(annotation.value, mode="eval").body)
    if isinstance(annotation, ast.Subscript):
        name = ast.unparse(annotation.value)
        return name in ARRAYS or ("Callable" not in name and _contains_arrays(annotation.slice))
    if isinstance(annotation, ast.Name):
        return annotation.id in ARRAYS
    return any(_contains_arrays(part) for part in ast.iter_child_nodes(annotation) if isinstance(part, ast.expr))


def _find_docstring_entry(name: str, docstring: str) -> list[str]:
    """Return the numpydoc entry of a parameter: type and lines of the description."""
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
    """Find arguments that are float arrays without a unit in the name or the documentation."""
    for where, name, kind, lines in _array_arguments(sources):
        words = re.split(r"[\s,;()`*:.]+", " ".join(lines))
        whole = any(word in kind for word in UNITLESS_TYPES) and "float" not in kind
        named = any(name.endswith(f"_{unit}") for unit in UNITS_IN_NAMES)
        if not whole and not named and not UNITS & set(words):
            yield f"{where}: {name}"


def meaningless_names(sources: dict[str, str]) -> Iterator[str]:
    """Find variables, arguments and fields with meaningless names."""
    for path, text in sources.items():
        for node in ast.walk(ast.parse(text)):
            for kind in ("id", "arg", "attr", "name"):
                if str(getattr(node, kind, "")).strip("_") in MEANINGLESS_NAMES:
                    yield f"{path}:{node.lineno}: {getattr(node, kind)}"


def private_words(sources: dict[str, str]) -> Iterator[str]:
    """Find modules, functions, classes, arguments and variables that are named by a private word."""
    for path, text in sources.items():
        nodes = list(ast.walk(ast.parse(text)))
        values = [node.id for node in nodes if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store)]
        values += [node.attr for node in nodes if isinstance(node, ast.Attribute) and isinstance(node.ctx, ast.Store)]
        values += [node.arg for node in nodes if isinstance(node, ast.arg)]
        defined = [node.name for node in nodes if isinstance(node, ast.FunctionDef | ast.ClassDef)]
        barred = [name for name in values if name.strip("_") not in ALLOWED_AS_VALUES]
        for name in (Path(path).stem, *defined, *barred):
            if name.strip("_") in PRIVATE_WORDS:
                yield f"{path}: {name}, which is {PRIVATE_WORDS[name.strip('_')]}"


# Example module that defines a reader of a table.
TABLES = {"data/a.py": "def reader():\n    return load_data_table('a')\n"}
# Example package with an entry point, public functions that read tables, a helper that calls the entry point, and a
# module that re-exports a reader.
EXAMPLE_PACKAGE = {
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
    """Find calls of a `kernel_helper` from functions that are not compiled; such a call would crash Python."""
    places = _map_origins(sources)
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
            called = {name for name, place in places[path].items() if _find_origin(places, place) in helpers}
            yield from (f"{path}:{node.name} calls {name}" for _, name in _find_uses(node, called))


RULES = {
    # ruff cannot check rules about the decorators of this package.
    callees_from_python: {"core/a.py": "@kernel_helper\ndef f():\n    pass\ndef g():\n    f()\n"},
    # The rule concerns only the lists in this file.
    outdated_list_entries: {"core/a.py": ""},
    # ruff has no rule for the length of a module.
    long_modules: {"core/a.py": "x = 1\n" * 301},
    # PLR0915 of ruff counts statements; 40 lines below a docstring are stricter than 40 statements.
    long_functions: {"core/a.py": "def f():\n" + "    x = 1\n" * 41},
    # TID251 of ruff detects functions, but not methods such as `path.write_text`.
    file_access_elsewhere: {"core/a.py": "open('x')\n"},
    # import-linter checks imports of modules; this rule concerns calls of functions.
    table_reads_outside_entry_points: {**TABLES, "xray/a.py": "from ..data.a import reader\ndef f():\n    reader()\n"},
    # No linter checks shapes and units in docstrings.
    arrays_without_unit: {
        "core/a.py": 'def f(a: Array):\n    """Do it.\n\n    Parameters\n    ----------\n    a : (n,) array\n    """\n'
    },
    arrays_without_shape: {"core/a.py": 'def f(a: Array):\n    """Nothing of a."""\n'},
    # ruff has no list of forbidden names.
    meaningless_names: {"core/a.py": "def _found():\n    pass\n"},
    private_words: {"core/a.py": "class A:\n    def _amid(self):\n        pass\n"},
    # No linter checks whether an error message contains the rejected value.
    errors_without_value: {"core/a.py": "raise InputError('no')\n"},
}


@pytest.mark.parametrize("rule", RULES, ids=lambda rule: rule.__name__)
def test_the_package_complies_with_every_rule(rule):
    assert SOURCES
    assert not list(rule(SOURCES))


@pytest.mark.parametrize("rule", RULES, ids=lambda rule: rule.__name__)
def test_every_rule_detects_a_planted_violation(rule):
    assert list(rule({"__init__.py": "", **RULES[rule]}))


@pytest.mark.parametrize(
    ("rule", "text"),
    [
        (file_access_elsewhere, "table.to_csv('x')\n"),
        (file_access_elsewhere, "path.write_bytes(b'x')\n"),
        (file_access_elsewhere, "mkdir('x')\n"),
        (meaningless_names, "def f(told):\n    pass\n"),
        (meaningless_names, "class A:\n    found: int\n"),
        (meaningless_names, "def f(a):\n    return a.found\n"),
        (meaningless_names, "with a as told:\n    pass\n"),
        (meaningless_names, "f(found=1)\n"),
        (private_words, "class Stance:\n    pass\n"),
        (private_words, "def f(amid):\n    pass\n"),
        (private_words, "def f(*, evened=None):\n    pass\n"),
        (private_words, "def f():\n    for amid in ():\n        pass\n"),
        (private_words, "class A:\n    halved: int\n"),
        (private_words, "def again():\n    pass\n"),
        (errors_without_value, "raise ValueError('no')\n"),
        (errors_without_value, "raise ValueError(f'no')\n"),
        (errors_without_value, "raise ValueError('of two ' f'pieces')\n"),
        (arrays_without_shape, "def f(a: Array | None = None):\n    pass\n"),
        (arrays_without_shape, "def f(a: list[Array]):\n    pass\n"),
        (arrays_without_shape, "def f(a: 'Mapping[str, tuple[NDArray[np.float32], int]]'):\n    pass\n"),
        (arrays_without_shape, "def f(*, a: Rows | Array):\n    pass\n"),
        (arrays_without_shape, "def f(*a: Array):\n    pass\n"),
        (arrays_without_unit, "def f(a: Array | None = None):\n    pass\n"),
    ],
)
def test_a_rule_detects_variants_of_a_violation(rule, text):
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
        *(
            "constant",
            "renamed",
            "module",
            "wrapped",
            "not in construction",
            "protocol",
            "no entry point",
            "package",
            "star",
        ),
        *("passed on", "inside", "public function", "entry point", "by a helper", "record", "private"),
    ],
)
def test_a_table_read_outside_an_entry_point_is_detected(path, text):
    assert list(table_reads_outside_entry_points({**EXAMPLE_PACKAGE, path: text}))


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
    ids=["entry point", "construction", "measurement", "argument", "shadowed", "caller", "public function", "rows"],
)
def test_a_table_read_in_an_entry_point_is_allowed(path, text):
    assert not list(table_reads_outside_entry_points({**EXAMPLE_PACKAGE, path: text}))


def test_public_functions_are_found_from_the_package_docstring():
    public_functions = find_public_functions(SOURCES["__init__.py"], _map_origins(SOURCES))
    assert len(public_functions) == len(set(pssf.__all__) - {"__version__"})
    assert {
        "anatomy/built_knee.py:build",
        "detector/display_rendering.py:render_for_display",
        "simulation.py:simulate",
    } < public_functions


@pytest.mark.parametrize(
    ("lists", "why"),
    [
        ({"entry_points": [*ENTRY_POINTS, "anatomy/spirit.py"]}, "ENTRY_POINTS: anatomy/spirit.py"),
        ({"entry_points": [*ENTRY_POINTS, "spirit/*"]}, "ENTRY_POINTS: spirit/*"),
        ({"formulas": [*FORMULA_MODULES, "patient_comparison/spirit"]}, "FORMULA_MODULES: patient_comparison/spirit"),
        ({"file_packages": [*FILE_PACKAGES, "spirit"]}, "FILE_PACKAGES: spirit"),
    ],
)
def test_a_listed_name_that_no_longer_exists_is_detected(lists, why):
    assert list(outdated_list_entries(SOURCES, **lists)) == [why]


@pytest.mark.parametrize(
    "text", ["raise ValueError(f'a = {a}')\n", "raise ValueError('no' f' {a}')\n", "raise ValueError('a = 1')\n"]
)
def test_an_error_message_with_a_value_is_allowed(text):
    assert not list(errors_without_value({"core/a.py": text}))


@pytest.mark.parametrize("kind", ["Callable[[Array], Array]", "Callable[[Array], Array] | None", "list[int]"])
def test_a_callable_with_array_arguments_needs_no_shape(kind):
    assert not list(arrays_without_shape({"core/a.py": f"def f(a: {kind}):\n    pass\n"}))
