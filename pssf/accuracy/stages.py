"""The stages of simulate, and the nodes of the spectrum, measured."""

import os
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from multiprocessing import get_context
from time import perf_counter

import numpy as np

from ..checks import Array
from ..detector.materials import attenuation_per_mm
from ..detector.spectrum import beam_of
from ..files.atomic import empty_folder
from ..knee import Knee
from ..protocol import load_protocol
from ..simulate import simulate
from .engines import Row, peak_mb


def spectrum_rows(nodes: tuple[int, ...] = (4, 8, 12, 18, 28, 56)) -> list[Row]:
    """One row a number of nodes: greatest relative error of the signal, 0-150 mm of tissue with 0-15 mm of cortex."""
    protocol = load_protocol("reference")

    def signal(count: int) -> Array:
        beam = beam_of(protocol, nodes=count)
        soft, bone = np.meshgrid(np.linspace(0, 150, 31), np.linspace(0, 15, 16))
        mu = [attenuation_per_mm(m, beam.energies_kev) for m in ("muscle", "cortical_bone")]
        exponent = soft[..., None] * mu[0] + bone[..., None] * mu[1]
        return np.asarray((beam.photons_per_mm2 * beam.signal_kev * np.exp(-exponent)).sum(axis=-1))

    full = signal(100_000)
    rows = []
    for count in nodes:
        folded = signal(count)
        rows.append({"nodes": count, "max_relative_error": float(f"{abs(folded / full - 1).max():.2g}")})
    return rows


def stage_rows(workers: int) -> list[Row]:
    """One row an engine and run: seconds of each stage of simulate, full knee, protocol reference; peak memory in MB.

    Each engine has processes of its own. A "cold" run, the first after installation, compiles; the "first" of a process
    loads libraries and compiled code; the "second" is what one more radiograph costs.
    """
    rows = []
    for engine in ("embree", "scanline"):
        with empty_folder() as folder, _environment(NUMBA_CACHE_DIR=str(folder)):
            rows += _in_a_new_process(engine, workers, ("cold",))
        rows += _in_a_new_process(engine, workers, ("first", "second"))
    return rows


@contextmanager
def _environment(**variables: str) -> Iterator[None]:
    """Environment variables for processes that are started within."""
    before = dict(os.environ)
    os.environ.update(variables)
    try:
        yield
    finally:
        os.environ.clear()
        os.environ.update(before)


def _in_a_new_process(engine: str, workers: int, runs: tuple[str, ...]) -> list[Row]:
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
        return pool.submit(_timed_runs, engine, workers, runs).result()


def _timed_runs(engine: str, workers: int, runs: tuple[str, ...]) -> list[Row]:
    protocol, rows = load_protocol("reference"), []
    for run in runs:
        start = perf_counter()
        radiograph = simulate(Knee(), protocol, seed=1, engine=engine, workers=workers)
        total = perf_counter() - start
        stages = {name: round(seconds, 3) for name, seconds in radiograph.seconds.items()}
        rows.append({"engine": engine, "run": run, "seconds": round(total, 3), "peak_mb": peak_mb(), **stages})
    return rows
