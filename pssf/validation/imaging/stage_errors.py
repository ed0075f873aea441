"""Run time, fraction of the total and error of each stage of ``simulate``."""

from collections.abc import Callable

import numpy as np

from ...anatomy import BuiltKnee, build
from ...geometry.scene import Scene
from ...model.knee import Knee
from ...model.protocol import Protocol, load_protocol
from ...quality.detector_quality import measure_mtf, measure_photon_transfer
from ...raycast import trace
from ...simulation import simulate
from ...xray.resolved_technique import Technique, resolve_technique
from ...xray.sampled_primary import compute_sampled_primary
from ...xray.spectrum_quadrature import RELATIVE_TOLERANCE
from ..raycasting.raycast_engines import Row
from .focal_spot_error import compute_blurred_primary
from .scatter_phantoms import ScatterCase, compare_kernel_with_monte_carlo
from .stage_times import measure_spectrum_nodes

# Number of timed runs; the fastest is reported.
_RUNS = 3
# Number of photons in the Monte Carlo simulation with which the scatter kernel is compared.
_PHOTONS = 4_000_000
# Case for the scatter comparison: object, tube voltage in kV, thickness in mm and air gap in mm.
_SCATTER_CASES: tuple[ScatterCase, ...] = (("knee", 70, 120, 82),)


def measure_imaging_chain(workers: int) -> list[Row]:
    """Measure run time and error of each stage of ``simulate`` with each ray-casting engine.

    The run time excludes building the knee. :func:`_make_error_measures` lists the error measures.

    Parameters
    ----------
    workers : int
        Number of worker threads.

    Returns
    -------
    list of dict
        One row per stage. ``*_seconds`` is the run time of the stage in the fastest of three runs, for each engine.
        ``*_time_fraction`` is the fraction of the total run time. ``error`` is the error of the stage, and ``error_of``
        describes the error measure.
    """
    built, technique = build(Knee()), resolve_technique(load_protocol("reference"))
    timed = {
        engine: _measure_stage_seconds(built, technique.protocol, engine, workers) for engine in ("scanline", "embree")
    }
    errors = _make_error_measures(built.scene, technique, workers)
    rows: list[Row] = []
    for stage in [name for name in timed["scanline"] if name != "anatomy"]:
        row: Row = {"stage": stage}
        for engine, seconds in timed.items():
            whole = sum(part for name, part in seconds.items() if name != "anatomy")
            row[f"{engine}_seconds"] = round(seconds[stage], 3)
            row[f"{engine}_time_fraction"] = round(seconds[stage] / whole, 3)
        what, error = errors.get(stage, ("", lambda: None))
        value = error()
        rows.append({**row, "error": "" if value is None else float(f"{value:.2g}"), "error_of": what})
    return rows


def _measure_stage_seconds(built: BuiltKnee, protocol: Protocol, engine: str, workers: int) -> dict[str, float]:
    """Time each stage; return the seconds of the fastest of three runs after a warm-up run."""
    runs = [dict(simulate(built, protocol, engine=engine, workers=workers).seconds) for _ in range(_RUNS + 1)]
    return min(runs[1:], key=lambda one: sum(one.values()))


def _make_error_measures(
    scene: Scene, technique: Technique, workers: int
) -> dict[str, tuple[str, Callable[[], float]]]:
    """Map each stage to the description of its error measure and to the function that measures the error."""
    joint = technique.replace_protocol(rows=512, cols=512)

    def rays() -> float:
        short, exact = (
            trace(scene, joint.protocol, precision=p, workers=workers).path_mm for p in ("float32", "float64")
        )
        return max(float(np.abs(short[name] - exact[name]).max()) for name in short)

    def attenuation() -> float:
        return float(measure_spectrum_nodes((RELATIVE_TOLERANCE,))[0]["max_relative_error"])

    def scatter() -> float:
        row = compare_kernel_with_monte_carlo(photons=_PHOTONS, workers=workers, cases=_SCATTER_CASES)[0]
        return abs(row["difference_percent"]) / 100

    def focal_spot() -> float:
        exact = compute_sampled_primary(scene, joint, "scanline", workers, 5).kev
        return float(np.sqrt(np.mean((compute_blurred_primary(scene, joint, workers) / exact - 1) ** 2)))

    def noise() -> float:
        return float(np.mean([abs(measured / meant - 1) for _, measured, meant in measure_photon_transfer(technique)]))

    def blur() -> float:
        curve = measure_mtf(technique)
        inside = (curve.frequency_per_mm > 0) & (curve.frequency_per_mm < 3)
        return float(np.abs(curve.measured / curve.model - 1)[inside].max())

    return {
        "rays": ("float32 against float64 path length, maximum, mm", rays),
        "attenuation": ("primary signal, reduced spectrum against all energies, maximum, relative", attenuation),
        "scatter": ("kernel against 4 million photons in the joint region, relative", scatter),
        "focal spot": ("primary signal of the joint against 25 points of the focal spot, RMS, relative", focal_spot),
        "quantum noise": ("variance of flat fields against the model, mean, relative", noise),
        "detector blur": ("slanted-edge MTF against the model up to 3/mm, maximum, relative", blur),
    }
