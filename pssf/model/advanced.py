"""What comes with osteoarthritis beside what narrows and grows at margins: central osteophytes, cysts, slip, growth."""

from typing import Any

import numpy as np

from ..data.grades import Central, Cysts, Laws, SeverityGrades
from ..data.records import Pair
from .knee import Cyst, Osteophyte, other_compartment

# Apart in the measure of their places, as `Knee` wants those of one site, with chance left for each.
_PLACES = (-0.7, 0.0, 0.7)
_AROUND = 0.09


def advanced_fields(
    table: SeverityGrades, grade: int, narrowed: str, severity: float, rng: np.random.Generator
) -> dict[str, Any]:
    """Fields of a knee of a grade beyond `severity_fields`.

    narrowed  the side that narrows, medial or lateral
    severity  of the knee within its grade, in deviations
    rng       of a stream of its own
    """
    of_cysts, of_subluxation, of_notch = rng.spawn(3)
    cysts = () if table.cysts is None else _cysts(table.cysts, grade, narrowed, of_cysts)
    (of_effusion,) = rng.spawn(1)
    slip, notch, effusion = table.subluxation, table.notch, table.effusion

    def millimetres(laws: Laws, bounds: Pair, chance: np.random.Generator) -> float:
        mean, sd = laws[grade]
        score = in_part(severity, table.side.shape_with, chance.standard_normal())
        return round(float(np.clip(mean + sd * score, *bounds)), 4)

    slipped = grown = swollen = 0.0
    if slip is not None and narrowed == "medial":
        slipped = millimetres(slip.lateral_mm, slip.bounds_mm, of_subluxation)
    if notch is not None:
        grown = millimetres(notch.growth_mm, notch.bounds_mm, of_notch)
    if effusion is not None:
        swollen = millimetres(effusion.swelling_mm, effusion.bounds_mm, of_effusion)
    return {"cysts": cysts, "subluxation_mm": slipped, "notch_growth_mm": grown, "effusion_mm": swollen}


def central_osteophytes(
    law: Central | None, grade: int, narrowed: str, rng: np.random.Generator
) -> tuple[Osteophyte, ...]:
    """An osteophyte in the middle of a joint surface, or none.

    narrowed  the side that narrows, medial or lateral
    rng       of a stream of its own
    """
    if law is None or rng.random() >= law.share[grade]:
        return ()
    other = other_compartment(narrowed)
    side = narrowed if rng.random() < law.narrowed else other
    surface = "condyle" if rng.random() < law.femur else "plateau"
    size_mm, place = rng.uniform(*law.size_mm), rng.uniform(-1.0, 1.0)
    return (Osteophyte(site=f"{side}_{surface}", size_mm=round(float(size_mm), 4), place=round(float(place), 4)),)


def in_part(severity: float, correlation: float, chance: float) -> float:
    """A standard score that goes with severity so much, and else is chance."""
    return float(correlation * severity + np.sqrt(1 - correlation**2) * chance)


def _cysts(law: Cysts, grade: int, narrowed: str, rng: np.random.Generator) -> tuple[Cyst, ...]:
    has, count = rng.random() < law.share[grade], int(rng.integers(1, law.most + 1))
    other = other_compartment(narrowed)
    places = rng.permutation(_PLACES)
    drawn = []
    for place in places[:count]:
        side = narrowed if rng.random() < law.narrowed else other
        bone = "tibia" if rng.random() < law.tibia else "femur"
        size_mm, about, outward = rng.uniform(*law.diameter_mm), rng.uniform(-_AROUND, _AROUND), rng.random()
        drawn.append(Cyst(
            site=f"{side}_{bone}",
            diameter_mm=round(float(size_mm), 4),
            place=round(float(place + about), 4),
            outward=round(float(outward), 4),
        ))  # fmt: skip
    return tuple(drawn) if has else ()
