"""Kernels compiled in a process of their own: when, which, and that pixels do not know of it."""

import hashlib
import importlib.util
import json
import os
import subprocess
import sys
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import pytest
from numba.core import config

import pssf
from pssf import precompile
from pssf.precompile import is_compiled, list_kernels, precompile_in_background

SMALL = {"rows": 96, "cols": 96, "pixel_mm": 2.0}
# A process whose cache is empty: what it compiles itself, and its pixels.
COLD = """
import dataclasses, hashlib, json, sys
import numba.core.event as event
import pssf

class Compiled(event.Listener):
    names = set()
    def on_start(self, event):
        self.names.add(event.data["dispatcher"].py_func.__module__)
    def on_end(self, event):
        pass

event.register("numba:compile", Compiled())
protocol = dataclasses.replace(pssf.load_protocol("reference"), **json.loads(sys.argv[1]))
radiograph = pssf.simulate(pssf.Knee(), protocol)
print(json.dumps([hashlib.sha256(radiograph.pixels.tobytes()).hexdigest(), sorted(Compiled.names)]))
"""
TOY = """
from pssf.core.numba_kernel import kernel

@kernel()
def doubled(x):
    return {factor} * x
"""


def toy(path, name="toy", factor=2):
    """A module with one kernel, as another process would import it."""
    path.write_text(TOY.format(factor=factor))
    spec = importlib.util.spec_from_file_location(name, path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module.doubled


@pytest.fixture
def started(monkeypatch):
    """Arguments of the processes that would be started."""
    calls = []

    @contextmanager
    def noted(*arguments, environment, timeout_s):
        calls.append(arguments)
        yield

    monkeypatch.setattr(precompile, "run_in_background", noted)
    monkeypatch.setattr(precompile, "_attempted", set())
    monkeypatch.setattr(precompile, "can_run_in_background", lambda: True)
    monkeypatch.setattr(precompile, "compile_other_kernels", lambda: None)
    monkeypatch.setattr(precompile, "is_compiled", lambda kernel: False)
    return calls


def enter(workers=2):
    with precompile_in_background("embree", textured=True, workers=workers):
        pass


def test_what_is_not_compiled_is_compiled_aside_once(started):
    enter()
    enter()
    assert started == [("pssf.precompile", "compile_ray_kernels", "embree", "trabecular")]


@pytest.mark.parametrize(
    ("where", "name", "value"),
    [
        (precompile, "is_compiled", lambda kernel: True),
        (precompile, "can_run_in_background", lambda: False),
        (config, "DISABLE_JIT", 1),
        (os, "access", lambda path, mode: False),
    ],
)
def test_nothing_is_started_where_it_is_of_no_use(started, monkeypatch, where, name, value):
    monkeypatch.setattr(where, name, value)
    enter()
    assert not started


def test_nothing_is_started_for_one_worker(started):
    enter(workers=1)
    assert not started


def test_a_kernel_is_compiled_if_the_cache_has_it_of_this_source(tmp_path):
    first = toy(tmp_path / "toy.py")
    assert not is_compiled(first)
    assert first(2) == 4
    assert is_compiled(first)
    assert is_compiled(toy(tmp_path / "toy.py"))
    assert not is_compiled(toy(tmp_path / "toy.py", factor=3))


def test_where_nobody_knows_a_kernel_counts_as_compiled():
    assert is_compiled(len)


@pytest.mark.parametrize("engine", ["embree", "scanline"])
@pytest.mark.parametrize("textured", [True, False])
def test_the_kernels_looked_for_are_those_that_rays_compile(engine, textured):
    precompile.compile_ray_kernels(engine, "trabecular" if textured else "none")
    protocol = replace(pssf.load_protocol("reference"), **SMALL, texture="trabecular" if textured else "none")
    before = [kernel.signatures for kernel in list_kernels(engine, textured)]
    assert all(len(types) > 0 for types in before)
    pssf.simulate(pssf.Knee(), protocol, engine=engine)
    assert [kernel.signatures for kernel in list_kernels(engine, textured)] == before


def test_after_an_installation_rays_are_compiled_aside_and_pixels_are_the_same(tmp_path):
    protocol = replace(pssf.load_protocol("reference"), **SMALL)
    warm = hashlib.sha256(pssf.simulate(pssf.Knee(), protocol).pixels.tobytes()).hexdigest()
    done = subprocess.run(
        [sys.executable, "-c", COLD, json.dumps(SMALL)],
        env=os.environ | {"NUMBA_CACHE_DIR": str(tmp_path)},
        cwd=Path(__file__).parents[1],
        stdout=subprocess.PIPE,
        check=True,
    )
    cold, compiled = json.loads(done.stdout)
    assert cold == warm
    assert "pssf.geometry.mesh_containment" in compiled
    rays = {kernel.py_func.__module__ for kernel in list_kernels("embree", True)}
    assert not rays & set(compiled)


def said_by(code, folder):
    """Standard error of a process with an empty cache of compiled code."""
    return subprocess.run(
        [sys.executable, "-c", code],
        env=os.environ | {"NUMBA_CACHE_DIR": str(folder)},
        cwd=Path(__file__).parents[1],
        stderr=subprocess.PIPE,
        text=True,
        check=True,
    ).stderr


REPAIR = """
import numpy as np
from pssf.geometry.mesh_repair import repair_mesh
corners = np.array([[0.0, 0, 0], [9, 0, 0], [0, 9, 0], [0, 0, 9]])
faces = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
def mend():
    repair_mesh(corners, faces, "tetrahedron")
"""
WORKER = """
import multiprocessing, sys
sys.path.insert(0, {folder!r})
if __name__ == "__main__":
    from mending import mend
    worker = multiprocessing.get_context("spawn").Process(target=mend)
    worker.start()
    worker.join()
    assert worker.exitcode == 0
"""


def test_the_first_compilation_after_an_installation_is_announced_in_one_line(tmp_path):
    cold, warm = (said_by(f"{REPAIR}\nmend()\nmend()", tmp_path) for _ in range(2))
    assert cold.startswith("pssf: compiling")
    assert "once after an installation" in cold
    assert cold.count("\n") == 1
    assert warm == ""


def test_the_line_can_be_switched_off_by_its_logger(tmp_path):
    silent = "import logging\nlogging.getLogger('pssf').setLevel(logging.ERROR)"
    assert said_by(f"{silent}\n{REPAIR}\nmend()", tmp_path) == ""


def test_workers_compile_without_a_word(tmp_path):
    (tmp_path / "mending.py").write_text(REPAIR)
    (tmp_path / "main.py").write_text(WORKER.format(folder=str(tmp_path)))
    run = f"runpy.run_path({str(tmp_path / 'main.py')!r}, run_name='__main__')"
    assert said_by(f"import runpy\nif __name__ == '__main__':\n    {run}", tmp_path / "cache") == ""
