"""Error against run time, measured on the user's own machine.

engines    ray casting: seconds, memory and error by engine, triangles, pixels and precision; how they grow
agreement  both engines on random knees from random sides
stages     simulate from cold to warm; nodes of the spectrum
chain      the stages of simulate: seconds, share, error
physics    spectrum, attenuation, primary and scatter beside references
morphometry  drawn knees beside published sizes, and the errors of their labels
views      what beams and turns do to films, beside films of people; the kernel of scatter in each view
solids     spheres as polyhedra, and their exact chords
builds     random knees, built or refused
tessellation  outlines of the bones by triangles
texture    trabeculae: integrals by step, their part in a trace, and their look on radiographs beside real ones
monte_carlo  the Monte Carlo of scatter beside an independent one
scatter    the kernel of scatter beside the Monte Carlo (scatter_fit fits it once more)
focal      blur of the focal spot against rays from points of it
localisation  the joint found and refused: simulations right and wrong on purpose  (extra "study"; not among "all")
coverage   how often the study's intervals hold the truth            (extra "study"; not among "all")
refutation what the study claims of random labels                  (extra "study"; not among "all")
ablation   run time of the study against what is left out of it  (extra "study"; not among "all")
backends   features by MIRP beside those by pyradiomics   (group "peers"; not among "all")
gvxr       the ray caster beside gVirtualXray           (group "peers"; not among "all")
latency    from a slider of pssf explore to the picture (extra "explore"; not among "all")
figure     error against run time, drawn                      (extra "study")
"""

import os
import platform
from collections.abc import Callable, Collection
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from ..core.checks import require_choice
from ..explore.latency import latency_rows
from ..io.atomic import folder, write_bytes
from ..io.readme import open_checkout
from ..io.records import write_csv, write_json
from ..simulation import versions
from .agreement import agreement_rows
from .builds import build_rows
from .chain import chain_rows
from .criteria import criterion_rows
from .engines import Row, engine_rows, growth_rows, nested_rows
from .focal import focal_rows
from .gvxr import gvxr_rows
from .localisation import limit_rows, localisation_rows
from .monte_carlo import reference_rows
from .morphometry import knee_rows
from .physics import physics_rows
from .scatter import scatter_rows
from .stages import spectrum_rows, stage_rows
from .tessellation import tessellation_rows
from .texture import spread_rows, step_rows, trace_rows
from .view_scatter import view_scatter_rows
from .views import view_rows

# Those that measure memory come first: a process that is started begins with the peak of the one that started it.
TABLES = (
    "engines", "growth", "nested", "stages", "chain", "agreement", "spectrum", "focal_spot", "physics",
    "monte_carlo", "scatter", "tessellation", "texture_steps", "texture_trace", "texture", "builds", "knees", "views",
    "view_scatter", "criteria",
)  # fmt: skip
# Only by name: minutes long and about the study rather than about a radiograph; and those that need another package.
BY_NAME = (
    "localisation", "localisation_limits", "coverage", "refutation", "ablation", "backends", "gvxr", "latency",
)  # fmt: skip


def measure(
    out: Path,
    *,
    workers: int = 2,
    tables: Collection[str] = TABLES,
    knees: int = 30,
    readme: Path | None = None,
    progress: Callable[[str], None] = lambda line: None,
) -> list[Path]:
    """Measure what is asked for and write it as CSV, with machine.json and a figure; returns their paths.

    tables    of TABLES or BY_NAME; "growth" is worked out from "engines"
    knees     how many are drawn for "agreement", "texture", "builds", "knees", "views" and "criteria"
    readme    source checkout whose READMEs get the tables, too
    progress  told what is being measured
    raises    InputError for an unknown table, a folder that is no checkout, a disk that is full or cannot be written
    """
    for name in tables:
        require_choice("table", name, (*TABLES, *BY_NAME))
    checkout = open_checkout(readme, tables, knees=knees)
    folder(out)
    engines: list[Row] = []
    if {"engines", "growth"} & set(tables):
        progress("ray casting")
        engines = engine_rows(workers)
    jobs, paths = _jobs(engines, knees, workers, progress), []
    for name in (name for name in (*TABLES, *BY_NAME) if name in tables):
        progress(name)
        rows = jobs[name]()
        paths.append(out / f"{name}.csv")
        write_csv(paths[-1], rows)
        paths += checkout.take({name: rows})
    paths.append(out / "machine.json")
    write_json(paths[-1], _machine())
    if engines and find_spec("matplotlib"):
        from .figure import draw

        paths.append(out / "engines.png")
        write_bytes(paths[-1], draw(engines))
        paths += checkout.take({}, paths[-1:])
    return paths


def _jobs(
    engines: list[Row], knees: int, workers: int, say: Callable[[str], None]
) -> dict[str, Callable[[], list[Row]]]:
    """Table -> what measures it."""
    return {
        "engines": lambda: engines,
        "growth": lambda: growth_rows(engines),
        "nested": lambda: nested_rows(workers),
        "stages": lambda: stage_rows(workers),
        "chain": lambda: chain_rows(workers),
        "agreement": lambda: agreement_rows(knees, workers),
        "spectrum": spectrum_rows,
        "focal_spot": lambda: focal_rows(workers),
        "physics": physics_rows,
        "monte_carlo": lambda: reference_rows(workers),
        "scatter": lambda: scatter_rows(workers=workers),
        "tessellation": tessellation_rows,
        "texture_steps": step_rows,
        "texture_trace": trace_rows,
        "texture": lambda: spread_rows(knees, workers),
        "builds": lambda: build_rows(knees, workers, say),
        "knees": lambda: knee_rows(knees, workers),
        "views": lambda: view_rows(knees, workers),
        "view_scatter": lambda: view_scatter_rows(workers),
        "criteria": lambda: criterion_rows(knees, workers),
        "localisation": lambda: localisation_rows(knees, workers),
        "localisation_limits": lambda: limit_rows(knees, workers),
        "coverage": lambda: _of_study("coverage").coverage_rows(workers),
        "refutation": lambda: _of_study("refutation").refutation_rows(workers),
        "ablation": lambda: _of_study("ablation").ablation_rows(workers),
        "backends": lambda: _of_study("backends").backend_rows(),
        "gvxr": lambda: gvxr_rows(workers),
        "latency": latency_rows,
    }


def _machine() -> dict[str, str | int | None]:
    return {"machine": platform.processor() or platform.machine(), "cores": os.cpu_count(), **versions()}


def _of_study(name: str) -> Any:
    """A module of this folder that needs the extra `study`."""
    from ..study import require_extra

    require_extra()
    return import_module(f".{name}", __package__)
