"""The stages of simulate, and the nodes of the spectrum, measured."""

import json
import os
import subprocess
from pathlib import Path
from time import perf_counter

import numpy as np

from ..anatomy import build
from ..core.child_processes import python_command
from ..io.atomic import empty_folder
from ..model.knee import Knee
from ..model.protocol import load_protocol
from ..raycast import trace
from ..simulation import simulate
from ..xray import primary
from ..xray.quadrature import TOLERANCE
from ..xray.spectrum import beam_for, beam_of
from ..xray.technique import technique_of
from .engines import Row, peak_mb


def spectrum_rows(tolerances: tuple[float, ...] = (1e-1, 1e-2, 3e-3, 1e-3, 5e-4, 1e-4, 1e-5)) -> list[Row]:
    """One row a tolerance: nodes of the spectrum, error and seconds of the attenuation of a knee under `reference`.

    error    largest relative error of the signal, of all pixels, against bins of 0.5 keV
    seconds  of the attenuation on 2048 x 2048 pixels, best of three
    """
    protocol = load_protocol("reference")
    technique = technique_of(protocol)
    paths = trace(build(Knee()).scene, protocol, engine="scanline").path_mm
    most_mm = {name: float(lengths.max()) for name, lengths in paths.items()}
    full = primary.transmit(paths, beam_of(technique), technique).kev
    rows: list[Row] = []
    for tolerance in tolerances:
        beam, seconds = beam_for(technique, most_mm, tolerance), []
        for _ in range(3):
            start = perf_counter()
            kev = primary.transmit(paths, beam, technique).kev
            seconds.append(perf_counter() - start)
        error = float(np.abs(kev / full - 1).max())
        rows.append({
            "tolerance": tolerance, "used": tolerance == TOLERANCE, "nodes": len(beam.energies_kev),
            "max_relative_error": float(f"{error:.2g}"), "seconds": round(min(seconds), 3),
        })  # fmt: skip
    return rows


def stage_rows(workers: int) -> list[Row]:
    """One row an engine and run: seconds of each stage of simulate, full knee, protocol reference; peak memory in MB.

    Each engine has processes of its own. A "cold" run is the first after an installation: compiled code, bytecode and
    what the package keeps (spectra) are sought in an empty folder, and made; memory is without that of the process that
    compiles beside it. The "first" of another process, with that folder, loads libraries and what is kept; the "second"
    is what one more radiograph costs. Bytecode is written even where the environment says otherwise
    (PYTHONDONTWRITEBYTECODE), since each process would compile all that it loads.
    """
    rows = []
    for engine in ("embree", "scanline"):
        with empty_folder() as folder:
            rows += _in_a_new_process(engine, workers, ("cold",), folder)
            rows += _in_a_new_process(engine, workers, ("first", "second"), folder)
    return rows


def _environment(folder: Path) -> dict[str, str]:
    """The environment, but all that outlives a process is kept in a folder."""
    kept = {"NUMBA_CACHE_DIR": "numba", "PSSF_CACHE_DIR": "pssf", "PYTHONPYCACHEPREFIX": "bytecode"}
    others = {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}
    return others | {name: str(folder / below) for name, below in kept.items()}


def _in_a_new_process(engine: str, workers: int, runs: tuple[str, ...], folder: Path) -> list[Row]:
    # Pools pass options of this process on, such as not to write bytecode.
    code = f"from {__name__} import print_runs; print_runs({engine!r}, {workers}, {runs!r})"
    done = subprocess.run(python_command(code), env=_environment(folder), stdout=subprocess.PIPE, text=True, check=True)
    rows: list[Row] = json.loads(done.stdout)
    return rows


def print_runs(engine: str, workers: int, runs: tuple[str, ...]) -> None:
    """Write rows of so many runs in this process to its output, as JSON."""
    print(json.dumps(_timed_runs(engine, workers, runs)))


def _timed_runs(engine: str, workers: int, runs: tuple[str, ...]) -> list[Row]:
    protocol, rows = load_protocol("reference"), []
    for run in runs:
        start = perf_counter()
        radiograph = simulate(Knee(), protocol, rng=1, engine=engine, workers=workers)
        total = perf_counter() - start
        stages = {name: round(seconds, 3) for name, seconds in radiograph.seconds.items()}
        rows.append({"engine": engine, "run": run, "seconds": round(total, 3), "peak_mb": peak_mb(), **stages})
    return rows
