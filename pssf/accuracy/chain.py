"""The stages of simulate: seconds, share of the whole, and the error of each, measured here."""

from collections.abc import Callable

import numpy as np

from ..anatomy import BuiltKnee, build
from ..geometry.scene import Scene
from ..model.knee import Knee
from ..model.protocol import Protocol, load_protocol
from ..quality.detector import mtf, photon_transfer
from ..raycast import trace
from ..simulation import simulate
from ..stages import sampled_primary
from ..xray.quadrature import TOLERANCE
from ..xray.technique import Technique, technique_of
from .engines import Row
from .focal import blurred_primary
from .scatter import Case, scatter_rows
from .stages import spectrum_rows

_RUNS = 3
_PHOTONS = 4_000_000
_LIMB: tuple[Case, ...] = (("knee", 70, 120, 82),)


def chain_rows(workers: int) -> list[Row]:
    """One row a stage: seconds and share with either engine (best of three, knee built before), and its error.

    The error of a stage is measured on the spot against what it stands for: see `_errors`.
    """
    built, technique = build(Knee()), technique_of(load_protocol("reference"))
    timed = {engine: _seconds(built, technique.protocol, engine, workers) for engine in ("scanline", "embree")}
    errors = _errors(built.scene, technique, workers)
    rows: list[Row] = []
    for stage in [name for name in timed["scanline"] if name != "anatomy"]:
        row: Row = {"stage": stage}
        for engine, seconds in timed.items():
            whole = sum(part for name, part in seconds.items() if name != "anatomy")
            row |= {f"{engine}_seconds": round(seconds[stage], 3), f"{engine}_share": round(seconds[stage] / whole, 3)}
        what, error = errors.get(stage, ("", lambda: None))
        value = error()
        rows.append({**row, "error": "" if value is None else float(f"{value:.2g}"), "error_of": what})
    return rows


def _seconds(built: BuiltKnee, protocol: Protocol, engine: str, workers: int) -> dict[str, float]:
    """Stage -> seconds of the fastest of a few runs, after one that loads what is loaded once."""
    runs = [dict(simulate(built, protocol, engine=engine, workers=workers).seconds) for _ in range(_RUNS + 1)]
    return min(runs[1:], key=lambda one: sum(one.values()))


def _errors(scene: Scene, technique: Technique, workers: int) -> dict[str, tuple[str, Callable[[], float]]]:
    """Stage -> what its error is of, and how to measure it."""
    joint = technique.taken(rows=512, cols=512)

    def rays() -> float:
        short, exact = (
            trace(scene, joint.protocol, precision=p, workers=workers).path_mm for p in ("float32", "float64")
        )
        return max(float(np.abs(short[name] - exact[name]).max()) for name in short)

    def attenuation() -> float:
        return float(spectrum_rows((TOLERANCE,))[0]["max_relative_error"])

    def scatter() -> float:
        row = scatter_rows(photons=_PHOTONS, workers=workers, cases=_LIMB)[0]
        return abs(row["difference_percent"]) / 100

    def focal_spot() -> float:
        exact = sampled_primary(scene, joint, "scanline", workers, 5).kev
        return float(np.sqrt(np.mean((blurred_primary(scene, joint, workers) / exact - 1) ** 2)))

    def noise() -> float:
        return float(np.mean([abs(measured / meant - 1) for _, measured, meant in photon_transfer(technique)]))

    def blur() -> float:
        curve = mtf(technique)
        inside = (curve.per_mm > 0) & (curve.per_mm < 3)
        return float(np.abs(curve.measured / curve.model - 1)[inside].max())

    return {
        "rays": ("path length in float32, mm, largest", rays),
        "attenuation": ("primary signal, few energies for all, relative, largest", attenuation),
        "scatter": ("kernel in the joint region against 4 million photons, relative", scatter),
        "focal spot": ("primary signal of the joint against 25 points of the spot, relative, RMS", focal_spot),
        "quantum noise": ("variance of flat fields against the one meant, relative, mean", noise),
        "detector blur": ("MTF of a slanted edge against the one meant up to 3/mm, relative, largest", blur),
    }
