"""Check the cache of compiled kernels: damaged or missing files only cause a new compilation."""

import importlib
import os
import random
import subprocess
import sys
from pathlib import Path

import pytest
from numba.core.caching import NullCache

from pssf.core import kernel_cache
from pssf.core.kernel_cache import KernelCache, make_kernel_cache

TOY = """
from pssf.core.numba_kernel import kernel

@kernel()
def toy_kernel(x):
    return {factor} * x
"""
# Damage to a file, as caused by a full disk, a crash or a bad sector: name -> function of the file content.
DAMAGES = {
    "empty": lambda content: b"",
    "cut": lambda content: content[: len(content) // 2],
    "short": lambda content: content[:9],
    "zeros": lambda content: bytes(len(content)),
    "garbage": lambda content: random.Random(1).randbytes(20),
    "flipped": lambda content: content[:-200] + bytes([content[-200] ^ 255]) + content[-199:],
}
KERNELS = """
import importlib, importlib.util, pkgutil, sys
import pssf
from numba.core.dispatcher import Dispatcher

def is_missing(*extras):
    return any(importlib.util.find_spec(extra) is None for extra in extras)

skipped = ("pssf.torch",) * is_missing("torch") + ("pssf.reader_training.",) * is_missing("torch", "monai", "kornia")
for module in pkgutil.walk_packages(pssf.__path__, "pssf."):
    if not module.name.rpartition(".")[2].startswith("__") and not module.name.startswith(skipped):
        importlib.import_module(module.name)
found = {
    id(one): type(one._cache).__name__
    for name, module in sys.modules.items() if name.startswith("pssf.")
    for one in vars(module).values()
    if isinstance(one, Dispatcher) and not one.targetoptions.get("no_cpython_wrapper")
}
print(len(found), *sorted(set(found.values())))
"""


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """Set and return the cache folder of compiled kernels."""
    import numba

    monkeypatch.setattr(numba.config, "CACHE_DIR", str(tmp_path / "cache"))
    return tmp_path / "cache"


def toy(path, factor=2):
    """Import a module with one kernel anew, as another process would, and return the kernel."""
    path.write_text(TOY.format(factor=factor))
    spec = importlib.util.spec_from_file_location("toy", path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module.toy_kernel


def hits(function):
    return sum(function.stats.cache_hits.values())


@pytest.mark.parametrize("suffix", ["nbi", "nbc"])
@pytest.mark.parametrize("damage", DAMAGES)
def test_a_damaged_cache_file_is_compiled_again_and_replaced(folder, tmp_path, suffix, damage):
    assert toy(tmp_path / "toy.py")(2) == 4
    (file,) = folder.rglob(f"*.{suffix}")
    # An index may be shorter than 200 bytes; in that case its bytes are reversed.
    content = file.read_bytes()
    flipped = DAMAGES[damage](content) if damage != "flipped" or len(content) > 200 else content[::-1]
    file.write_bytes(flipped)
    again = toy(tmp_path / "toy.py")
    assert again(2) == 4
    assert hits(again) == 0
    third = toy(tmp_path / "toy.py")
    assert third(2) == 4
    assert hits(third) == 1


def test_cached_machine_code_for_other_types_is_not_run(folder, tmp_path):
    function = toy(tmp_path / "toy.py")
    assert function(2) == 4
    assert function(2.5) == 5.0
    one, two = sorted(folder.rglob("*.nbc"))
    # Two processes that compile for different types at the same time can produce this state.
    two.write_bytes(one.read_bytes())
    again = toy(tmp_path / "toy.py")
    assert again(2) == 4
    assert again(2.5) == 5.0
    assert hits(again) == 1


def test_a_full_disk_for_the_kernel_cache_raises_no_error(folder, tmp_path, monkeypatch):
    def full(*arguments):
        raise OSError(28, "No space left on device")

    function = toy(tmp_path / "toy.py")
    monkeypatch.setattr(kernel_cache._CheckedFile, "_save_data", full)
    assert function(2) == 4


def unwritable(monkeypatch, but=None):
    """Make all cache folders unwritable except those below the folder `but`."""
    ensure = kernel_cache._CacheLocator.ensure_cache_path

    def refused(self):
        if but is None or not Path(self.get_cache_path()).is_relative_to(but):
            raise PermissionError(13, "Permission denied")
        ensure(self)

    monkeypatch.setattr(kernel_cache._CacheLocator, "ensure_cache_path", refused)


def test_a_temporary_cache_folder_is_used_if_no_other_is_writable(tmp_path, monkeypatch):
    temporary = tmp_path / "temporary"
    temporary.mkdir()
    monkeypatch.setattr(kernel_cache.tempfile, "gettempdir", lambda: str(temporary))
    unwritable(monkeypatch, but=temporary)
    assert toy(tmp_path / "toy.py")(2) == 4
    again = toy(tmp_path / "toy.py")
    assert again(2) == 4
    assert hits(again) == 1
    (made,) = temporary.iterdir()
    assert made.stat().st_mode & 0o077 == 0 or os.name == "nt"


@pytest.mark.skipif(os.name == "nt", reason="Windows has no such modes")
@pytest.mark.parametrize("kind", ["link", "open"])
def test_a_temporary_folder_writable_by_other_users_is_not_used(tmp_path, monkeypatch, kind):
    temporary, other = tmp_path / "temporary", tmp_path / "other"
    temporary.mkdir()
    other.mkdir(mode=0o777)
    other.chmod(0o777)
    name = temporary / f"pssf-numba-{os.getuid()}"
    if kind == "link":
        name.symlink_to(other)
    else:
        name.mkdir()
        name.chmod(0o777)
    monkeypatch.setattr(kernel_cache.tempfile, "gettempdir", lambda: str(temporary))
    unwritable(monkeypatch, but=temporary)
    function = toy(tmp_path / "toy.py")
    assert isinstance(function._cache, NullCache)
    assert function(2) == 4
    assert not list(other.iterdir())


def test_a_kernel_compiles_without_any_writable_cache_folder(tmp_path, monkeypatch):
    unwritable(monkeypatch)
    function = toy(tmp_path / "toy.py")
    assert isinstance(function._cache, NullCache)
    assert function(2) == 4
    assert function.stats.cache_path is None


def test_every_kernel_of_the_package_uses_the_kernel_cache():
    done = subprocess.run([sys.executable, "-W", "ignore", "-c", KERNELS], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    count, *kinds = done.stdout.split()
    assert kinds == [KernelCache.__name__]
    assert int(count) > 30


def test_a_function_without_a_source_file_has_no_cache():
    exec(compile("def nowhere(x):\n    return x", "<nowhere>", "exec"), made := {})
    assert isinstance(make_kernel_cache(made["nowhere"]), NullCache)


REPAIR = """
import numpy as np
from pssf.geometry.mesh_repair import repair_mesh
corners = np.array([[0.0, 0, 0], [9, 0, 0], [0, 9, 0], [0, 0, 9]])
faces = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
def repair():
    repair_mesh(corners, faces, "tetrahedron")
"""
WORKER = """
import multiprocessing, sys
sys.path.insert(0, {folder!r})
if __name__ == "__main__":
    from repairing import repair
    worker = multiprocessing.get_context("spawn").Process(target=repair)
    worker.start()
    worker.join()
    assert worker.exitcode == 0
"""


def capture_standard_error(code, folder):
    """Run code in a new process with a specified kernel cache folder, and return the standard error."""
    return subprocess.run(
        [sys.executable, "-c", code],
        env=os.environ | {"NUMBA_CACHE_DIR": str(folder)},
        cwd=Path(__file__).parents[1],
        stderr=subprocess.PIPE,
        text=True,
        check=True,
    ).stderr


def test_the_first_compilation_after_an_installation_logs_one_line(tmp_path):
    cold, warm = (capture_standard_error(f"{REPAIR}\nrepair()\nrepair()", tmp_path) for _ in range(2))
    assert cold.startswith("pssf: compiling")
    assert "once after an installation" in cold
    assert cold.count("\n") == 1
    assert warm == ""


def test_damaged_cache_files_are_replaced_without_an_error(tmp_path):
    """Empty first every index, then all compiled code."""
    capture_standard_error(f"{REPAIR}\nrepair()", tmp_path)
    for suffix in ("nbi", "nbc"):
        files = list(tmp_path.rglob(f"*.{suffix}"))
        assert files
        for file in files:
            file.write_bytes(b"")
        log = capture_standard_error(f"{REPAIR}\nrepair()", tmp_path)
        assert [line[:15] for line in log.splitlines()] == ["pssf: compiling"]
    assert capture_standard_error(f"{REPAIR}\nrepair()", tmp_path) == ""


def test_the_compilation_message_can_be_switched_off_by_its_logger(tmp_path):
    silent = "import logging\nlogging.getLogger('pssf').setLevel(logging.ERROR)"
    assert capture_standard_error(f"{silent}\n{REPAIR}\nrepair()", tmp_path) == ""


def test_workers_log_no_compilation_message(tmp_path):
    (tmp_path / "repairing.py").write_text(REPAIR)
    (tmp_path / "main.py").write_text(WORKER.format(folder=str(tmp_path)))
    run = f"runpy.run_path({str(tmp_path / 'main.py')!r}, run_name='__main__')"
    code = f"import runpy\nif __name__ == '__main__':\n    {run}"
    assert capture_standard_error(code, tmp_path / "cache") == ""
