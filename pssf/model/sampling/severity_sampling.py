"""Sample the knee fields that depend on the KL grade, correlated through a latent severity."""

from functools import cache
from typing import Any

import numpy as np
from scipy.optimize import brentq

from ...core.checks import Array
from ...data.knees.grade_records import AccompanyingOsteophytes, OsteophyteDistributions, SeverityGradeTable
from ...data.table_records import Pair
from ..knee import Osteophyte, other_compartment
from .advanced_osteoarthritis import correlated_score, sample_advanced_fields, sample_central_osteophytes

# Limit to which standard scores are clipped, in standard deviations.
_TRUNCATION_SD = 2.5
# Smallest osteophyte, in mm. A pixel of 0.15 mm does not show smaller osteophytes, and they cannot be distinguished
# from the natural rounding of the margin.
_MIN_OSTEOPHYTE_MM = 0.2


def sample_severity_fields(
    table: SeverityGradeTable, grade: int, sex: str, bone_scale: float, rng: np.random.Generator
) -> dict[str, Any]:
    """Sample the knee fields that depend on KL grade and latent severity.

    Parameters
    ----------
    table : SeverityGradeTable
        Grade table with the distributions of the sampled fields.
    grade : int
        KL grade of the knee.
    sex : {"male", "female"}
        Sex, which affects the joint space widths.
    bone_scale : float
        Sampled relative bone size, which is multiplied by a factor for the grade.
    rng : numpy.random.Generator
        Generator with its own random stream.

    Returns
    -------
    dict of str to object
        Sampled values keyed by `Knee` field: joint spaces and their definition, subchondral bone plate, varus, age,
        bone scale, osteophytes, reader grade, and the fields of `sample_advanced_fields`.
    """
    severity = _truncate(rng.standard_normal())
    narrowed, other = ("medial", "lateral") if rng.random() < table.side.medial else ("lateral", "medial")
    spaces = _sample_joint_spaces_mm(table, grade, sex, narrowed, severity, rng)
    rest = table.rest
    towards = 1.0 if narrowed == "medial" else -1.0
    plate, varus_deg = (_sample_with_severity(severity, table, law[grade], rng) for law in (rest.plate, rest.varus_deg))
    age = _sample_normal(rest.age_years[grade], rng)
    of_advanced, of_central = rng.spawn(2)
    return {
        "jsw_definition": "read",
        f"jsw_{narrowed}_mm": spaces[0],
        f"jsw_{other}_mm": spaces[1],
        "subchondral_plate": round(float(np.clip(plate, 0.7, 2.5)), 4),
        "varus_deg": round(float(np.clip(towards * varus_deg, -8.0, 8.0)), 4),
        "age_years": round(float(np.clip(age, 40.0, 90.0)), 4),
        "bone_scale": round(float(np.clip(bone_scale * rest.bone_scale_factor[grade], 0.85, 1.15)), 4),
        "osteophytes": _sample_osteophytes(table, grade, narrowed, severity, rng)
        + sample_central_osteophytes(table.central, grade, narrowed, of_central),
        "reader_grade": sample_reader_grade(grade, table.reader.kappa, len(table.grades), rng),
        **sample_advanced_fields(table, grade, narrowed, severity, of_advanced),
    }


def _sample_joint_spaces_mm(
    table: SeverityGradeTable, grade: int, sex: str, narrowed_side: str, severity: float, rng: np.random.Generator
) -> list[float]:
    """Sample the joint space widths of the narrowed and the other compartment, in this order, in mm.

    The two widths correlate with each other. At KL 2 and above, the width of the narrowed compartment also correlates
    with severity.
    """
    laws = getattr(table.spaces, narrowed_side)[str(grade)]
    one, other = rng.standard_normal(2)
    together = table.spaces.correlation
    scores = [one, together * one + np.sqrt(1 - together**2) * other]
    with_severity = table.side.severity_correlation if grade >= 2 else 0.0
    scores[0] = correlated_score(-severity, with_severity, scores[0])
    # Half of the sex difference is added for men and subtracted for women, because the table contains means of both
    # sexes.
    more = table.spaces.male_excess_mm * (0.5 if sex == "male" else -0.5)
    within = []
    for (mean, sd), score in zip(laws, scores, strict=True):
        left = np.sqrt(max(sd**2 - (table.spaces.male_excess_mm / 2) ** 2, 0.0))
        within.append(round(float(np.clip(mean + more + left * _truncate(score), table.spaces.least_mm, 8.0)), 4))
    return within


def _sample_osteophytes(
    table: SeverityGradeTable, grade: int, narrowed_side: str, severity: float, rng: np.random.Generator
) -> tuple[Osteophyte, ...]:
    """Sample the osteophytes at joint margins and tibial spines, with sizes, positions and curvatures."""
    law = table.osteophytes
    oarsi = _sample_oarsi_grades(law, grade, narrowed_side, table.side.severity_correlation * severity, rng)
    sizes = {}
    for site, degree in oarsi.items():
        low, high = law.size_mm[degree]
        most = law.doubtful_mm if grade == 1 else high
        sizes[site] = float(rng.uniform(min(low, most), min(high, most)))
    for side, share in ((narrowed_side, 1.0), (other_compartment(narrowed_side), law.spine_other)):
        spiked, size_mm = rng.random() < share * law.spine[grade], float(rng.uniform(*law.spine_mm))
        if spiked:
            sizes[f"{side}_spine"] = size_mm
    sites = {site: mm for site, mm in sizes.items() if mm >= _MIN_OSTEOPHYTE_MM}
    placed = [(site, mm, 0.0) for site, mm in sites.items()]
    placed += [
        one
        for site, mm in sites.items()
        if site in oarsi
        for one in _sample_adjacent_osteophytes(law.around, site, mm, rng)
    ]
    return tuple(
        Osteophyte(site=site, size_mm=round(mm, 4), place=place, curve_deg=_sample_curve_deg(law, site, rng))
        for site, mm, place in placed
    )


def _sample_curve_deg(law: OsteophyteDistributions, site: str, rng: np.random.Generator) -> float:
    """Sample the curvature of an osteophyte at a site, in degrees."""
    return round(_sample_normal(law.curve_deg[site], rng), 3) if site in law.curve_deg else 0.0


def _sample_adjacent_osteophytes(
    law: AccompanyingOsteophytes, site: str, size_mm: float, rng: np.random.Generator
) -> list[tuple[str, float, float]]:
    """Sample osteophytes in front of and behind an osteophyte at the same margin; return site, size (mm) and place."""
    beside = []
    for end in (-1.0, 1.0):
        there, share, place = rng.random() < law.share, rng.uniform(*law.size), rng.uniform(*law.place)
        if there and size_mm >= law.from_mm:
            beside.append((site, float(share) * size_mm, round(end * float(place), 3)))
    return beside


def _sample_oarsi_grades(
    law: OsteophyteDistributions, grade: int, narrowed_side: str, severity: float, rng: np.random.Generator
) -> dict[str, int]:
    """Sample the OARSI osteophyte grade at each site, consistent with the definition of the KL grade."""
    person = law.person_sd * rng.standard_normal() + severity
    latent = {}
    for site, offset in law.site.items():
        beside = law.narrowed_side if site.startswith(narrowed_side) else 0.0
        latent[site] = law.level[grade] + offset + beside + person + law.site_sd * rng.standard_normal()
    degrees = {site: int(np.searchsorted([0.0, 1.0, 2.0], value)) for site, value in latent.items()}
    if grade < 2:
        return {site: min(degree, grade) for site, degree in degrees.items()}
    greatest = max(latent, key=lambda site: latent[site])
    return degrees | {greatest: max(1, degrees[greatest])}


def sample_reader_grade(grade: int, kappa: float, grade_count: int, rng: np.random.Generator) -> int:
    """Sample the KL grade that a reader assigns: the true grade or an adjacent grade.

    Parameters
    ----------
    grade : int
        True KL grade.
    kappa : float
        Unweighted Cohen's kappa between assigned and true grades, for equally frequent true grades.
    grade_count : int
        Number of KL grades in the grade table.
    rng : numpy.random.Generator
        Generator; the only source of randomness.

    Returns
    -------
    int
        KL grade that the reader assigns.
    """
    return int(
        rng.choice(grade_count, p=_confusion_matrix(_solve_misread_fraction(kappa, grade_count), grade_count)[grade])
    )


@cache  # All knees of a grade table have the same reader, so the solution is cached.
def _solve_misread_fraction(kappa: float, grade_count: int) -> float:
    """Find the fraction of knees graded one grade too low or too high that results in the requested kappa."""
    return (
        float(brentq(lambda share: _kappa(_confusion_matrix(share, grade_count)) - kappa, 0.0, 1.0))
        if kappa < 1
        else 0.0
    )


def _confusion_matrix(misread_fraction: float, grade_count: int) -> Array:
    """Compute the probabilities of assigned grades (columns) for true grades (rows), shape (grades, grades)."""
    table = np.eye(grade_count) * (1 - misread_fraction)
    for grade in range(grade_count):
        beside = [other for other in (grade - 1, grade + 1) if 0 <= other < grade_count]
        table[grade, beside] = misread_fraction / len(beside)
    return table


def _kappa(confusion: Array) -> float:
    """Compute Cohen's kappa from a matrix of grade probabilities, for equally frequent true grades (rows)."""
    joint = confusion / len(confusion)
    by_chance = float(joint.sum(axis=0) @ joint.sum(axis=1))
    return (float(np.trace(joint)) - by_chance) / (1 - by_chance)


def _sample_with_severity(severity: float, table: SeverityGradeTable, law: Pair, rng: np.random.Generator) -> float:
    """Sample a value from a normal distribution (mean, SD) that correlates with severity."""
    return law[0] + law[1] * _truncate(
        correlated_score(severity, table.side.severity_correlation, rng.standard_normal())
    )


def _sample_normal(law: Pair, rng: np.random.Generator) -> float:
    """Sample a normal distribution (mean, SD), clipped at 2.5 SD."""
    return law[0] + law[1] * _truncate(rng.standard_normal())


def _truncate(score: float) -> float:
    """Clip a standard score to 2.5 standard deviations."""
    return float(np.clip(score, -_TRUNCATION_SD, _TRUNCATION_SD))
