"""Change one lesion of a knee, for a pair of images that differ in this lesion."""

from dataclasses import replace
from typing import Any

import numpy as np

from ..data.knees.oarsi_table import OarsiThresholds
from ..model.kellgren_lawrence import MAX_GRADE, allowed_grades, derive_grade
from ..model.knee import MARGIN_AND_SPINE_SITES, Knee, Osteophyte

# Size of an osteophyte that distinguishes the two knees of a pair, in mm.
_ADDED_OSTEOPHYTE_MM = (2.0, 6.0)


def change_one_lesion(knee: Knee, cuts: OarsiThresholds, rng: np.random.Generator) -> tuple[Knee, dict[str, Any]]:
    """Remove one osteophyte or cyst of a knee at random, or add an osteophyte to a knee without any.

    Parameters
    ----------
    knee : Knee
        Knee of the first image of a pair.
    cuts : OarsiThresholds
        Thresholds from which grades are derived.
    rng : numpy.random.Generator
        Random generator.

    Returns
    -------
    other : Knee
        Knee of the second image of the pair.
    change : dict of str to object
        Kind, site and size (mm) of the lesion, whether it was added, and the change of the grade.
    """
    lesions = [("osteophyte", one) for one in knee.osteophytes] + [("cyst", one) for one in knee.cysts]
    if not lesions:
        site, size = (
            MARGIN_AND_SPINE_SITES[int(rng.integers(len(MARGIN_AND_SPINE_SITES)))],
            round(float(rng.uniform(*_ADDED_OSTEOPHYTE_MM)), 2),
        )
        grown = replace(knee, osteophytes=(Osteophyte(site=site, size_mm=size),), grade=None)
        return _regrade(knee, grown, cuts, {"lesion": "osteophyte", "added": True, "site": site, "size_mm": size})
    kind, lost = lesions[int(rng.integers(len(lesions)))]
    kept: dict[str, Any] = {f"{kind}s": tuple(one for one in getattr(knee, f"{kind}s") if one is not lost)}
    size = lost.size_mm if isinstance(lost, Osteophyte) else lost.diameter_mm
    other = replace(knee, **kept, grade=None)
    return _regrade(knee, other, cuts, {"lesion": kind, "added": False, "site": lost.site, "size_mm": size})


def _regrade(knee: Knee, other: Knee, cuts: OarsiThresholds, change: dict[str, Any]) -> tuple[Knee, dict[str, Any]]:
    """Change the grade of a knee with another lesion by the change of its derived grade, as `progress` does.

    A removed lesion never raises the grade, and an added lesion never lowers it.
    """
    if knee.grade is None:
        return other, change
    low, high = allowed_grades(other, cuts)
    stepped = knee.grade + derive_grade(other, cuts) - derive_grade(replace(knee, grade=None), cuts)
    bounded = max(knee.grade, stepped) if change["added"] else min(knee.grade, stepped)
    grade = min(max(bounded, low), high)
    read = None if knee.reader_grade is None else min(max(knee.reader_grade + grade - knee.grade, 0), MAX_GRADE)
    return replace(other, grade=grade, reader_grade=read), {**change, "grade_change": grade - knee.grade}
