"""Sample the signs of advanced osteoarthritis: central osteophytes, cysts, subluxation, notch growth and effusion."""

from typing import Any

import numpy as np

from ...data.knees.grade_records import (
    CentralOsteophyteDistribution,
    CystDistribution,
    MeanSdByGrade,
    SeverityGradeTable,
)
from ...data.table_records import Pair
from ..knee import Cyst, Osteophyte, other_compartment

# Cyst positions before the random shift, in units of `Cyst.place`. Shifted cysts are still at least 0.5
# apart, the minimum that `Knee` requires at one site.
_CYST_POSITIONS = (-0.7, 0.0, 0.7)
# Largest random shift of a cyst position, in units of `Cyst.place`.
_POSITION_JITTER = 0.09


def sample_advanced_fields(
    table: SeverityGradeTable, grade: int, narrowed_side: str, severity: float, rng: np.random.Generator
) -> dict[str, Any]:
    """Sample the cysts, subluxation, notch growth and effusion of a knee from its KL grade.

    Parameters
    ----------
    table : SeverityGradeTable
        Grade table with the distributions of the sampled fields.
    grade : int
        KL grade of the knee.
    narrowed_side : {"medial", "lateral"}
        Compartment with joint space narrowing.
    severity : float
        Severity of osteoarthritis within the KL grade, as a standard score.
    rng : numpy.random.Generator
        Generator with its own random stream.

    Returns
    -------
    dict of str to object
        The fields ``cysts``, ``subluxation_mm``, ``notch_growth_mm`` and ``effusion_mm`` of a `Knee`. If the table does
        not define a field, its value is an empty tuple or 0.
    """
    of_cysts, of_subluxation, of_notch = rng.spawn(3)
    cysts = () if table.cysts is None else _sample_cysts(table.cysts, grade, narrowed_side, of_cysts)
    (of_effusion,) = rng.spawn(1)
    slip, notch, effusion = table.subluxation, table.notch, table.effusion

    def millimetres(laws: MeanSdByGrade, bounds: Pair, chance: np.random.Generator) -> float:
        """Sample a value in mm that correlates with severity, and clip the value to `bounds`."""
        mean, sd = laws[grade]
        score = correlated_score(severity, table.side.severity_correlation, chance.standard_normal())
        return round(float(np.clip(mean + sd * score, *bounds)), 4)

    slipped = grown = swollen = 0.0
    if slip is not None and narrowed_side == "medial":
        slipped = millimetres(slip.lateral_mm, slip.bounds_mm, of_subluxation)
    if notch is not None:
        grown = millimetres(notch.growth_mm, notch.bounds_mm, of_notch)
    if effusion is not None:
        swollen = millimetres(effusion.swelling_mm, effusion.bounds_mm, of_effusion)
    return {"cysts": cysts, "subluxation_mm": slipped, "notch_growth_mm": grown, "effusion_mm": swollen}


def sample_central_osteophytes(
    law: CentralOsteophyteDistribution | None, grade: int, narrowed_side: str, rng: np.random.Generator
) -> tuple[Osteophyte, ...]:
    """Sample at most one osteophyte in the middle of a joint surface.

    Parameters
    ----------
    law : CentralOsteophyteDistribution or None
        Distribution of frequency, location and size. None: no central osteophytes.
    grade : int
        KL grade of the knee.
    narrowed_side : {"medial", "lateral"}
        Compartment with joint space narrowing.
    rng : numpy.random.Generator
        Generator with its own random stream.

    Returns
    -------
    tuple of Osteophyte
        One osteophyte, or an empty tuple.
    """
    if law is None or rng.random() >= law.share[grade]:
        return ()
    other = other_compartment(narrowed_side)
    side = narrowed_side if rng.random() < law.narrowed else other
    surface = "condyle" if rng.random() < law.femur else "plateau"
    size_mm, place = rng.uniform(*law.size_mm), rng.uniform(-1.0, 1.0)
    return (Osteophyte(site=f"{side}_{surface}", size_mm=round(float(size_mm), 4), place=round(float(place), 4)),)


def correlated_score(severity: float, correlation: float, independent_score: float) -> float:
    """Compute a standard score that has a specified correlation with severity.

    Parameters
    ----------
    severity : float
        Severity as a standard score.
    correlation : float
        Correlation between the returned score and the severity, -1 to 1.
    independent_score : float
        Standard score that is independent of the severity.

    Returns
    -------
    float
        Standard score with the specified correlation.
    """
    return float(correlation * severity + np.sqrt(1 - correlation**2) * independent_score)


def _sample_cysts(law: CystDistribution, grade: int, narrowed_side: str, rng: np.random.Generator) -> tuple[Cyst, ...]:
    """Sample the number, sites, sizes and positions of the cysts of a knee."""
    has, count = rng.random() < law.share[grade], int(rng.integers(1, law.max_count + 1))
    other = other_compartment(narrowed_side)
    places = rng.permutation(_CYST_POSITIONS)
    drawn = []
    for place in places[:count]:
        side = narrowed_side if rng.random() < law.narrowed else other
        bone = "tibia" if rng.random() < law.tibia else "femur"
        size_mm, about, outward = (
            rng.uniform(*law.diameter_mm),
            rng.uniform(-_POSITION_JITTER, _POSITION_JITTER),
            rng.random(),
        )
        drawn.append(Cyst(
            site=f"{side}_{bone}",
            diameter_mm=round(float(size_mm), 4),
            place=round(float(place + about), 4),
            outward=round(float(outward), 4),
        ))  # fmt: skip
    return tuple(drawn) if has else ()
