"""severity_fields: what a grade moves in a knee, by one latent severity that its parameters follow in part."""

from functools import cache
from typing import Any

import numpy as np
from scipy.optimize import brentq

from ..core.checks import Array
from ..data.grades import Around, Margins, SeverityGrades
from ..data.records import Pair
from .advanced import advanced_fields, central_osteophytes, in_part
from .knee import Osteophyte, other_compartment

# No value of a normal law is farther from its mean.
_FARTHEST_SD = 2.5
_LEAST_MM = 0.2


def severity_fields(
    table: SeverityGrades, grade: int, sex: str, bone_scale: float, rng: np.random.Generator
) -> dict[str, Any]:
    """Fields of a knee of a grade that its severity moves.

    bone_scale  as drawn, which is widened
    rng         of a stream of its own
    """
    severity = _cut(rng.standard_normal())
    narrowed, other = ("medial", "lateral") if rng.random() < table.side.medial else ("lateral", "medial")
    spaces = _spaces_mm(table, grade, sex, narrowed, severity, rng)
    rest = table.rest
    towards = 1.0 if narrowed == "medial" else -1.0
    plate, varus_deg = (_with(severity, table, law[grade], rng) for law in (rest.plate, rest.varus_deg))
    age = _law(rest.age_years[grade], rng)
    of_advanced, of_central = rng.spawn(2)
    return {
        "jsw_as": "read",
        f"jsw_{narrowed}_mm": spaces[0],
        f"jsw_{other}_mm": spaces[1],
        "subchondral_plate": round(float(np.clip(plate, 0.7, 2.5)), 4),
        "varus_deg": round(float(np.clip(towards * varus_deg, -8.0, 8.0)), 4),
        "age_years": round(float(np.clip(age, 40.0, 90.0)), 4),
        "bone_scale": round(float(np.clip(bone_scale * rest.wider[grade], 0.85, 1.15)), 4),
        "osteophytes": _osteophytes(table, grade, narrowed, severity, rng)
        + central_osteophytes(table.central, grade, narrowed, of_central),
        "grade_read": read_grade(grade, table.reader.kappa, len(table.grades), rng),
        **advanced_fields(table, grade, narrowed, severity, of_advanced),
    }


def _spaces_mm(
    table: SeverityGrades, grade: int, sex: str, narrowed: str, severity: float, rng: np.random.Generator
) -> list[float]:
    """Of the compartment that narrows and of the other one: those of a person hang together, and go with severity."""
    laws = getattr(table.spaces, narrowed)[str(grade)]
    one, other = rng.standard_normal(2)
    together = table.spaces.correlation
    scores = [one, together * one + np.sqrt(1 - together**2) * other]
    with_severity = table.side.shape_with if grade >= 2 else 0.0
    scores[0] = in_part(-severity, with_severity, scores[0])
    # Centred, so that the mean of a half of men and a half of women is that of the table.
    more = table.spaces.men_more_mm * (0.5 if sex == "male" else -0.5)
    within = []
    for (mean, sd), score in zip(laws, scores, strict=True):
        left = np.sqrt(max(sd**2 - (table.spaces.men_more_mm / 2) ** 2, 0.0))
        within.append(round(float(np.clip(mean + more + left * _cut(score), table.spaces.least_mm, 8.0)), 4))
    return within


def _osteophytes(
    table: SeverityGrades, grade: int, narrowed: str, severity: float, rng: np.random.Generator
) -> tuple[Osteophyte, ...]:
    law = table.osteophytes
    oarsi = _oarsi(law, grade, narrowed, table.side.shape_with * severity, rng)
    sizes = {}
    for site, degree in oarsi.items():
        low, high = law.size_mm[degree]
        most = law.doubtful_mm if grade == 1 else high
        sizes[site] = float(rng.uniform(min(low, most), min(high, most)))
    for side, share in ((narrowed, 1.0), (other_compartment(narrowed), law.spine_other)):
        spiked, size_mm = rng.random() < share * law.spine[grade], float(rng.uniform(*law.spine_mm))
        if spiked:
            sizes[f"{side}_spine"] = size_mm
    # Below this an osteophyte cannot be told from the margin's own rounding, nor seen in a 0.15 mm pixel.
    sites = {site: mm for site, mm in sizes.items() if mm >= _LEAST_MM}
    placed = [(site, mm, 0.0) for site, mm in sites.items()]
    placed += [one for site, mm in sites.items() if site in oarsi for one in _around(law.around, site, mm, rng)]
    return tuple(
        Osteophyte(site=site, size_mm=round(mm, 4), place=place, curve_deg=_curve_deg(law, site, rng))
        for site, mm, place in placed
    )


def _curve_deg(law: Margins, site: str, rng: np.random.Generator) -> float:
    return round(_law(law.curve_deg[site], rng), 3) if site in law.curve_deg else 0.0


def _around(law: Around, site: str, size_mm: float, rng: np.random.Generator) -> list[tuple[str, float, float]]:
    """What else is on the margin of an osteophyte, in front of it and behind: site, size (mm) and place."""
    beside = []
    for end in (-1.0, 1.0):
        there, share, place = rng.random() < law.share, rng.uniform(*law.size), rng.uniform(*law.place)
        if there and size_mm >= law.from_mm:
            beside.append((site, float(share) * size_mm, round(end * float(place), 3)))
    return beside


def _oarsi(law: Margins, grade: int, narrowed: str, severity: float, rng: np.random.Generator) -> dict[str, int]:
    """Site -> OARSI grade of its osteophyte, as the definition of a KL grade allows."""
    person = law.person_sd * rng.standard_normal() + severity
    latent = {}
    for site, offset in law.site.items():
        beside = law.narrowed_side if site.startswith(narrowed) else 0.0
        latent[site] = law.level[grade] + offset + beside + person + law.site_sd * rng.standard_normal()
    degrees = {site: int(np.searchsorted([0.0, 1.0, 2.0], value)) for site, value in latent.items()}
    if grade < 2:
        return {site: min(degree, grade) for site, degree in degrees.items()}
    greatest = max(latent, key=lambda site: latent[site])
    return degrees | {greatest: max(1, degrees[greatest])}


def read_grade(grade: int, kappa: float, grades: int, rng: np.random.Generator) -> int:
    """What a reader calls a knee of a grade: it, or a neighbour of it, so often that kappa comes out.

    kappa  unweighted, where all grades are alike frequent
    """
    return int(rng.choice(grades, p=_reading(_wrong_share(kappa, grades), grades)[grade]))


@cache  # one reader reads all knees of a table
def _wrong_share(kappa: float, grades: int) -> float:
    """Of knees, the share that is called by a neighbouring grade."""
    return float(brentq(lambda share: _kappa(_reading(share, grades)) - kappa, 0.0, 1.0)) if kappa < 1 else 0.0


def _reading(wrong: float, grades: int) -> Array:
    """(grades, grades)  probability of the grade read (columns) of the one meant"""
    table = np.eye(grades) * (1 - wrong)
    for grade in range(grades):
        beside = [other for other in (grade - 1, grade + 1) if 0 <= other < grades]
        table[grade, beside] = wrong / len(beside)
    return table


def _kappa(reading: Array) -> float:
    """Cohen's kappa of a table of probabilities whose rows are alike frequent."""
    joint = reading / len(reading)
    by_chance = float(joint.sum(axis=0) @ joint.sum(axis=1))
    return (float(np.trace(joint)) - by_chance) / (1 - by_chance)


def _with(severity: float, table: SeverityGrades, law: Pair, rng: np.random.Generator) -> float:
    """A value of a law, the higher the more severe, in part."""
    return law[0] + law[1] * _cut(in_part(severity, table.side.shape_with, rng.standard_normal()))


def _law(law: Pair, rng: np.random.Generator) -> float:
    return law[0] + law[1] * _cut(rng.standard_normal())


def _cut(score: float) -> float:
    return float(np.clip(score, -_FARTHEST_SD, _FARTHEST_SD))
