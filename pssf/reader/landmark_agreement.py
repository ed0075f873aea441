"""Compare the landmarks of the reader with landmarks that a person has marked on the same radiographs.

Place and scale of the annotations in the image need not be known: the landmarks of the reader are laid on the
annotation by the least-squares similarity (translation, rotation, scale) before distances are measured.
"""

from collections.abc import Collection, Sequence
from typing import Any

import numpy as np
from scipy import stats

from ..core.checks import Array
from ..core.label_names import CONTOUR_LANDMARKS, FEMORAL_LANDMARKS, TIBIAL_LANDMARKS
from .joint_measures import measure_joint
from .knee_frame import fit_similarity
from .knee_reading import KneeReading

Row = dict[str, Any]
# Limits of the mean distance per radiograph for which the fraction of radiographs is given, in mm.
_LIMITS_MM = (1.0, 1.5, 2.5)
# KL grades between which the smaller joint space discriminates.
_NORMAL, _SEVERE = (0,), (3, 4)


def select_annotated_knee(knees: Sequence[KneeReading], side: str) -> KneeReading | None:
    """Select the knee that was annotated.

    Parameters
    ----------
    knees : sequence of KneeReading
        Readings of one radiograph.
    side : {"right", "left"}
        Side of the annotated knee.

    Returns
    -------
    KneeReading or None
        The knee of this side. A single knee is compared even if the reader has taken it for the other side.
    """
    return next((one for one in knees if one.side == side), knees[0] if len(knees) == 1 else None)


def compare_landmarks(reading: KneeReading | None, landmarks_mm: Array, side: str) -> Row:
    """Compare the reading of one radiograph with its annotation.

    Parameters
    ----------
    reading : KneeReading or None
        Reading of the annotated knee; None if the knee was not found.
    landmarks_mm : (16, 2) array
        Annotated x and y of each landmark, in mm; y points downwards, and x from lateral to medial.
    side : {"right", "left"}
        Side of the annotated knee.

    Returns
    -------
    dict of str to object
        ``found``, ``refused`` and ``side_right`` (0 or 1), the mean distance ``distance_mm``, the mean distance
        ``line_distance_mm`` from the lines through the annotated landmarks of each bone, the distance of each landmark,
        and the joint spaces of reader and annotation, in mm of the annotation.
    """
    truth = measure_joint(landmarks_mm[:, ::-1], "right")
    known = {
        "medial_gap_annotated_mm": truth.medial_jsw_share * truth.plateau_width_px,
        "lateral_gap_annotated_mm": truth.lateral_jsw_share * truth.plateau_width_px,
    }
    if reading is None:
        return {"found": 0, "refused": 0, "side_right": 0, **known}
    places = np.array([reading.landmarks_px[name] for name in CONTOUR_LANDMARKS])[:, ::-1]
    if reading.side == "left":
        places = places * (-1.0, 1.0)
    fitted = fit_similarity(places, landmarks_mm)
    distance = np.hypot(*(fitted - landmarks_mm).T)
    return {
        "found": 1,
        "refused": int(bool(reading.refusal)),
        "side_right": int(reading.side == side),
        "distance_mm": float(distance.mean()),
        "line_distance_mm": float(_measure_line_distances(fitted, landmarks_mm).mean()),
        **known,
        "medial_gap_mm": reading.measures.medial_jsw_share * truth.plateau_width_px,
        "lateral_gap_mm": reading.measures.lateral_jsw_share * truth.plateau_width_px,
        **{f"{name}_mm": float(value) for name, value in zip(CONTOUR_LANDMARKS, distance, strict=True)},
    }


def _measure_line_distances(places_mm: Array, landmarks_mm: Array) -> Array:
    """Measure the distance of each landmark (16, 2) from the line through the annotated landmarks of its bone."""
    distances = []
    for bone in (TIBIAL_LANDMARKS, FEMORAL_LANDMARKS):
        own = [CONTOUR_LANDMARKS.index(name) for name in bone]
        starts, steps = landmarks_mm[own[:-1]], np.diff(landmarks_mm[own], axis=0)
        from_starts = places_mm[own][:, None] - starts
        share = (from_starts * steps).sum(axis=2) / (steps**2).sum(axis=1)
        nearest = np.clip(share, 0.0, 1.0)[..., None] * steps
        distances.append(np.hypot(*np.moveaxis(from_starts - nearest, 2, 0)).min(axis=1))
    return np.concatenate(distances)


def summarise_agreement(rows: Sequence[Row], grades: Sequence[int | None]) -> list[Row]:
    """Summarise the comparison over all radiographs and over each KL grade.

    Parameters
    ----------
    rows : sequence of dict
        Results of `compare_landmarks`.
    grades : sequence of int or None
        KL grade of each radiograph.

    Returns
    -------
    list of dict
        One row per group of radiographs: counts, median and 90th percentile of the mean distance, median of the mean
        distance from the annotated lines, fractions of radiographs below limits, and bias, mean absolute error and
        correlation of the joint spaces. ``auc`` is the AUC of the smaller joint space against KL 0: for KL 3 and 4 in
        the first row, and for the grade of the row in the others.
    """
    groups: list[tuple[str, list[Row]]] = [("all", list(rows))]
    for grade in sorted({grade for grade in grades if grade is not None}):
        groups.append((f"KL {grade}", [row for row, of in zip(rows, grades, strict=True) if of == grade]))
    summary = [{"radiographs": name, **_summarise(group)} for name, group in groups]
    summary[0]["auc"] = _compute_auc(rows, grades, _SEVERE)
    for row in summary[1:]:
        grade = int(row["radiographs"].removeprefix("KL "))
        row["auc"] = None if grade in _NORMAL else _compute_auc(rows, grades, (grade,))
    return summary


def _summarise(rows: Sequence[Row]) -> Row:
    """Summarise one group of radiographs."""
    read = [row for row in rows if row["found"]]
    summary: Row = {
        "count": len(rows),
        "found": len(read),
        "refused": sum(row["refused"] for row in rows),
        "side_right": sum(row["side_right"] for row in rows),
    }
    if len(read) < 2:
        return summary
    distance = np.array([row["distance_mm"] for row in read])
    summary |= {"median_mm": float(np.median(distance)), "p90_mm": float(np.quantile(distance, 0.9))}
    summary["line_median_mm"] = float(np.median([row["line_distance_mm"] for row in read]))
    summary |= {f"below_{limit:g}_mm".replace(".", "_"): float((distance < limit).mean()) for limit in _LIMITS_MM}
    for side in ("medial", "lateral"):
        ours, theirs = (np.array([row[f"{side}_gap{kind}_mm"] for row in read]) for kind in ("", "_annotated"))
        summary |= {
            f"{side}_gap_bias_mm": float((ours - theirs).mean()),
            f"{side}_gap_mae_mm": float(np.abs(ours - theirs).mean()),
            f"{side}_gap_correlation": float(np.corrcoef(ours, theirs)[0, 1]),
        }
    return summary


def _compute_auc(rows: Sequence[Row], grades: Sequence[int | None], against: Collection[int]) -> float | None:
    """Compute the AUC of the smaller joint space of grades against normal knees; None without both groups."""
    least = [
        (grade, min(row["medial_gap_mm"], row["lateral_gap_mm"]))
        for row, grade in zip(rows, grades, strict=True)
        if row["found"]
    ]
    normal = np.array([gap for grade, gap in least if grade in _NORMAL])
    narrow = np.array([gap for grade, gap in least if grade in against])
    if not (normal.size and narrow.size):
        return None
    # `study` has the AUC of its scores, but the reader works without its libraries.
    return float(stats.mannwhitneyu(normal, narrow).statistic / (normal.size * narrow.size))
