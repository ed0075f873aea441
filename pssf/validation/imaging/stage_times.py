"""Run time of each stage of ``simulate`` in first and later runs, and of the attenuation by number of energies."""

import json
import os
import subprocess
from pathlib import Path
from time import perf_counter

import numpy as np

from ...anatomy import build
from ...core.processes.child_processes import build_python_command
from ...io.atomic_write import make_temporary_folder
from ...model.knee import Knee
from ...model.protocol import load_protocol
from ...raycast import trace
from ...simulation import simulate
from ...xray import primary_beam
from ...xray.resolved_technique import resolve_technique
from ...xray.spectrum import compute_beam, compute_reduced_beam
from ...xray.spectrum_quadrature import RELATIVE_TOLERANCE
from ..raycasting.raycast_engines import Row, peak_memory_mb


def measure_spectrum_nodes(tolerances: tuple[float, ...] = (1e-1, 1e-2, 3e-3, 1e-3, 5e-4, 1e-4, 1e-5)) -> list[Row]:
    """Measure error and run time of the attenuation of a knee for several tolerances of the reduced spectrum.

    Parameters
    ----------
    tolerances : tuple of float
        Relative tolerances of the reduced spectrum.

    Returns
    -------
    list of dict
        One row per tolerance, for the protocol ``reference``. ``nodes`` is the number of energies.
        ``max_relative_error`` is the largest relative error of the signal of a pixel, compared with energy bins of 0.5
        keV. ``seconds`` is the run time of the attenuation of 2048 x 2048 pixels, fastest of three runs.
    """
    protocol = load_protocol("reference")
    technique = resolve_technique(protocol)
    paths = trace(build(Knee()).scene, protocol, engine="scanline").path_mm
    most_mm = {name: float(lengths.max()) for name, lengths in paths.items()}
    full = primary_beam.transmit(paths, compute_beam(technique), technique).kev
    rows: list[Row] = []
    for tolerance in tolerances:
        beam, seconds = compute_reduced_beam(technique, most_mm, tolerance), []
        for _ in range(3):
            start = perf_counter()
            kev = primary_beam.transmit(paths, beam, technique).kev
            seconds.append(perf_counter() - start)
        error = float(np.abs(kev / full - 1).max())
        rows.append({
            "tolerance": tolerance, "used": tolerance == RELATIVE_TOLERANCE, "nodes": len(beam.energies_kev),
            "max_relative_error": float(f"{error:.2g}"), "seconds": round(min(seconds), 3),
        })  # fmt: skip
    return rows


def measure_cold_and_warm_runs(workers: int) -> list[Row]:
    """Measure run time and peak memory of ``simulate`` in the first run after installation and in later runs.

    Each engine runs in new processes, with the default knee and the protocol ``reference``.

    Parameters
    ----------
    workers : int
        Number of worker threads.

    Returns
    -------
    list of dict
        One row per engine and run: seconds of each stage, and peak memory in MB (``peak_mb``).

    Notes
    -----
    The ``cold`` run starts with empty caches of compiled code, bytecode and spectra, and fills the caches. Its peak
    memory excludes the process that compiles code in parallel. The ``first`` run is in a new process, which loads
    libraries and filled caches. The ``second`` run simulates another radiograph in the same process. Bytecode is
    written even if ``PYTHONDONTWRITEBYTECODE`` is set, because otherwise each process would compile every module.
    """
    rows = []
    for engine in ("embree", "scanline"):
        with make_temporary_folder() as folder:
            rows += _run_in_new_process(engine, workers, ("cold",), folder)
            rows += _run_in_new_process(engine, workers, ("first", "second"), folder)
    return rows


def _make_cache_environment(folder: Path) -> dict[str, str]:
    """Copy the environment variables, and set all cache folders to subfolders of a folder."""
    kept = {"NUMBA_CACHE_DIR": "numba", "PSSF_CACHE_DIR": "pssf", "PYTHONPYCACHEPREFIX": "bytecode"}
    others = {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}
    return others | {name: str(folder / below) for name, below in kept.items()}


def _run_in_new_process(engine: str, workers: int, runs: tuple[str, ...], folder: Path) -> list[Row]:
    """Measure the duration of simulation runs in a new Python process and return the table rows."""
    # A process pool is not used, because its processes inherit interpreter options such as -B (write no bytecode).
    code = f"from {__name__} import print_runs; print_runs({engine!r}, {workers}, {runs!r})"
    done = subprocess.run(
        build_python_command(code), env=_make_cache_environment(folder), stdout=subprocess.PIPE, text=True, check=True
    )
    rows: list[Row] = json.loads(done.stdout)
    return rows


def print_runs(engine: str, workers: int, runs: tuple[str, ...]) -> None:
    """Measure the duration of simulation runs in this process and print the table rows as JSON.

    Parameters
    ----------
    engine : str
        Ray-casting engine.
    workers : int
        Number of worker threads.
    runs : tuple of str
        Names of the runs, in order of execution.
    """
    print(json.dumps(_time_runs(engine, workers, runs)))


def _time_runs(engine: str, workers: int, runs: tuple[str, ...]) -> list[Row]:
    """Simulate one radiograph per run and time its stages."""
    protocol, rows = load_protocol("reference"), []
    for run in runs:
        start = perf_counter()
        radiograph = simulate(Knee(), protocol, rng=1, engine=engine, workers=workers)
        total = perf_counter() - start
        stages = {name: round(seconds, 3) for name, seconds in radiograph.seconds.items()}
        rows.append({"engine": engine, "run": run, "seconds": round(total, 3), "peak_mb": peak_memory_mb(), **stages})
    return rows
