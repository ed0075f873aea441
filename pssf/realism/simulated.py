"""Films of drawn knees, as sites take and show them, to stand beside people's."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from ..cohort import Plan, make_cohort, plan_cohort
from ..core.execution import Execution
from ..data.looks import Looks
from ..io.films import Film
from ..io.records import read_manifest
from ..model.look import drawn_look
from .films import Record, Source
from .films_section import SIMULATED

# Of the chance that looks and sizes of pixels are drawn by, beside the cohort's own.
_LOOKS, _PITCHES = 301, 302


def films_plan(protocol: str, knees: int, grade_table: str, count: int, seed: int) -> Plan:
    """Of drawn knees, so many grades alike: takings of a protocol, as people's films are."""
    each = [knees // count + (index < knees % count) for index in range(count)]
    asked = {"knees": each, "protocols": [protocol], "exposures": "drawn", "grade_table": grade_table}
    return plan_cohort("quick", seed=seed, overrides=asked)


def simulated_films(where: Path, plan: Plan, known: Looks, execution: Execution) -> Source:
    """The cohort as films, each shown as a site of its own shows them."""
    with execution.stage("simulated films", "radiographs", sum(len(case.exposures) for case in plan.cases)) as stage:
        manifest = read_manifest(make_cohort(
            plan,
            where,
            workers=execution.workers,
            scheduler=execution.scheduler,
            progress=stage.advance,
            kept=stage.keep,
        ))  # fmt: skip
    columns = ["file", "grade", "subject", "side", "pixel_mm", "sha256"]
    films = []
    for number, row in enumerate(manifest[columns].to_dict("records")):
        chance = np.random.SeedSequence(plan.seed, spawn_key=(_LOOKS, number))
        look = drawn_look(known, rng=np.random.default_rng(chance))
        films.append(Film(**{**row, "subject": str(row["subject"]), "look": look}))
    return Source(name=SIMULATED, folder=where, films=tuple(films))


def in_pixels_as_large(simulated: Source, records: Mapping[str, Sequence[Record]], seed: int) -> Source:
    """Simulated films in pixels as large as those of the real source of which most were found, whatever their grade.

    What a film is made smaller by blurs it, and tells it from one that was not. Crops are made smaller to one number of
    pixels, so that how large these are, over the knee, hangs on each crop: a pitch is drawn from the real ones.
    """
    pitches = [sorted(float(one["pitch_mm"]) for one in of if one["status"] == "found") for of in records.values()]
    known = max(pitches, key=len, default=[])
    if not known:
        return simulated
    chance = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(_PITCHES,)))
    drawn = chance.choice(known, len(simulated.films)).tolist()
    films = (replace(film, coarse_mm=mm) for film, mm in zip(simulated.films, drawn, strict=True))
    return replace(simulated, films=tuple(films))
