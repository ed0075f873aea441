"""Check the array cache: cached arrays equal computed arrays, and code changes cause recomputation."""

import ast
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec import structs

from pssf.anatomy.meshing.solids import extract_mesh
from pssf.anatomy.template.template_bone import SOURCES, SubchondralPlates
from pssf.anatomy.template.template_femur import make_template_femur
from pssf.anatomy.template.template_tibia import make_template_tibia
from pssf.data import array_cache, code_hash
from pssf.data.anatomy.anatomy_tables import load_anatomy_tables
from pssf.xray.spectrum import tube_spectrum

ORIGIN = array_cache.CacheKey(sources=("core",), libraries=("numpy",))


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.setenv("PSSF_CACHE_DIR", str(tmp_path))
    return tmp_path


def clear_caches():
    array_cache.compute_cache_digest.cache_clear()
    code_hash.compute_code_hashes.cache_clear()


def make_counted_function():
    calls = []

    def make():
        calls.append(1)
        return {"a": np.arange(3.0)}

    return make, calls


def test_arrays_are_computed_once_and_loaded_unchanged(folder):
    make, calls = make_counted_function()
    for _ in range(2):
        np.testing.assert_array_equal(array_cache.load_or_make_arrays("thing", ORIGIN, make)["a"], np.arange(3.0))
    assert len(calls) == 1
    assert len(list(folder.iterdir())) == 1


def test_a_change_of_code_or_library_recomputes_the_arrays(folder, tmp_path, monkeypatch):
    make, calls = make_counted_function()
    array_cache.load_or_make_arrays("thing", ORIGIN, make)
    package = tmp_path / "package"
    (package / "core").mkdir(parents=True)
    monkeypatch.setattr(code_hash, "PACKAGE_ROOT", package)
    for version in range(7):
        (package / "core" / "checks.py").write_text(f"version = {version}\n")
        clear_caches()
        array_cache.load_or_make_arrays("thing", ORIGIN, make)
        array_cache.load_or_make_arrays("thing", ORIGIN, make)
    array_cache.load_or_make_arrays(
        "thing", array_cache.CacheKey(sources=("core",), libraries=("numpy", "scipy")), make
    )
    clear_caches()
    assert len(calls) == 9
    assert len(list(folder.glob("thing-*"))) == 4


def test_arrays_are_recomputed_if_the_cache_is_damaged_or_disabled(folder, monkeypatch):
    make, calls = make_counted_function()
    array_cache.load_or_make_arrays("thing", ORIGIN, make)
    next(folder.iterdir()).write_bytes(b"PK nothing of the kind")
    assert array_cache.load_or_make_arrays("thing", ORIGIN, make)["a"][2] == 2.0
    for named in ("off", "/proc/nowhere"):
        monkeypatch.setenv("PSSF_CACHE_DIR", named)
        assert array_cache.load_or_make_arrays("thing", ORIGIN, make)["a"][2] == 2.0
    assert len(calls) == 4


@given(position=st.integers(0, 2**16), value=st.integers(0, 255), length=st.integers(0, 9))
def test_an_altered_cache_file_never_gives_wrong_arrays(position, value, length):
    whole = np.arange(300.0) ** 0.5
    with TemporaryDirectory() as name, pytest.MonkeyPatch.context() as patch:
        patch.setenv("PSSF_CACHE_DIR", name)
        array_cache.load_or_make_arrays("thing", ORIGIN, lambda: {"a": whole})
        (path,) = Path(name).iterdir()
        content = path.read_bytes()
        position %= len(content)
        path.write_bytes(content[:position] + bytes([value] * length) + content[position + length :])
        np.testing.assert_array_equal(
            array_cache.load_or_make_arrays("thing", ORIGIN, lambda: {"a": whole})["a"], whole
        )


def test_a_cached_spectrum_equals_the_computed_one(folder):
    beams = []
    for _ in range(2):
        tube_spectrum.cache_clear()
        beams.append(tube_spectrum(71.5, 12.0, 3.0))
    for one, two in zip(*beams, strict=True):
        np.testing.assert_array_equal(one, two)
    assert [path.name.rsplit("-", 1)[0] for path in folder.iterdir()] == ["spectrum-71.5-12.0-3.0-0.0"]


def test_packaged_arrays_are_used_unless_the_code_has_changed(folder, tmp_path, monkeypatch):
    make, calls = make_counted_function()
    package = tmp_path / "package"
    (package / "core").mkdir(parents=True)
    (package / "core" / "checks.py").write_text("version = 1\n")
    for module in (code_hash, array_cache):
        monkeypatch.setattr(module, "PACKAGE_ROOT", package)
    clear_caches()
    # Saving an array a second time replaces the first array.
    for value in (1.0, 2.0):
        array_cache.save_to_package("thing", ORIGIN, {"a": np.array([value])})
    shipped = list((package / array_cache.PACKAGED_FOLDER).iterdir())
    assert array_cache.load_or_make_arrays("thing", ORIGIN, make)["a"] == 2.0
    # Unlike cached arrays, packaged arrays are valid for all library versions.
    assert (
        array_cache.load_or_make_arrays("thing", array_cache.CacheKey(sources=("core",), libraries=("scipy",)), make)[
            "a"
        ]
        == 2.0
    )
    assert len(shipped) == 1
    assert not calls
    assert (
        len(
            array_cache.load_or_make_arrays("thing", array_cache.CacheKey(sources=("core",), facts=b"other"), make)["a"]
        )
        == 3
    )
    (package / "core" / "checks.py").write_text("version = 2\n")
    clear_caches()
    assert len(array_cache.load_or_make_arrays("thing", ORIGIN, make)["a"]) == 3
    assert len(calls) == 2
    clear_caches()


def list_imports(module):
    """List the modules of pssf that a module imports, as paths below the package."""
    names = set()
    for node in ast.walk(ast.parse((code_hash.PACKAGE_ROOT / module).read_text())):
        if isinstance(node, ast.ImportFrom) and node.level:
            start = (code_hash.PACKAGE_ROOT / module).parents[node.level - 1]
            names |= {start.joinpath(*(node.module or "").split(".")).with_suffix(".py")}
    return {path.relative_to(code_hash.PACKAGE_ROOT).as_posix() for path in names if path.exists()}


def test_the_key_of_template_bones_covers_all_modules_that_make_them():
    needed, new = set(), {"anatomy/template/template_femur.py", "anatomy/template/template_tibia.py"}
    while new:
        needed |= new
        new = {name for module in new for name in list_imports(module)} - needed
    # Only modules of anatomy and geometry affect the bones; data tables are hashed by their content.
    assert {name for name in needed if name.startswith(("anatomy/", "geometry/"))} == set(SOURCES)


@pytest.mark.parametrize("mean", [make_template_femur, make_template_tibia])
def test_packaged_template_bones_equal_those_made_by_the_current_code(folder, mean):
    name = mean.__name__.removeprefix("make_template_")
    mean.cache_clear()
    bone = mean(getattr(load_anatomy_tables().template, name), load_anatomy_tables().shape_model)
    assert (
        bone.outer.num_tri()
        > len(bone.build_inner_mesh(bone.compute_depth_mm(1.0, SubchondralPlates(1.0, 1.0, 10.0))).faces)
        > 1000
    )
    assert not list(folder.iterdir()), "made by other code: CONTRIBUTING.md says how they are made anew"
    made, kept = bone.make_arrays(), array_cache.load_or_make_arrays(name, bone.origin, dict)
    assert made.keys() == kept.keys()
    for key, values in made.items():
        # Coordinates may differ in rounding between computers; face indices may not.
        np.testing.assert_allclose(kept[key], values, rtol=0, atol=0 if "faces" in key else 1)


def test_template_bones_of_modified_tables_are_cached_unchanged(folder, monkeypatch):
    shape = structs.replace(load_anatomy_tables().template.femur, edge_mm=4.0, tolerance_mm=0.3)
    solids = []
    for named in ("off", str(folder), str(folder)):
        monkeypatch.setenv("PSSF_CACHE_DIR", named)
        make_template_femur.cache_clear()
        bone = make_template_femur(shape, load_anatomy_tables().shape_model)
        solids.append(
            [
                extract_mesh(bone.outer),
                bone.build_inner_mesh(bone.compute_depth_mm(1.0, SubchondralPlates(1.0, 1.0, 10.0))),
            ]
        )
    for other in solids[1:]:
        for one, two in zip(solids[0], other, strict=True):
            np.testing.assert_array_equal(one.vertices, two.vertices)
            np.testing.assert_array_equal(one.faces, two.faces)
    assert [path.name.split("-")[0] for path in folder.iterdir()] == ["femur"]
    make_template_femur.cache_clear()
