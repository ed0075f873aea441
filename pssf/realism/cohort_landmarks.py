"""cohort_landmarks: a cohort's folder -> contour landmarks of its radiographs, to stand beside people's."""

from pathlib import Path

import numpy as np

from ..core.checks import InputError, require_choice
from ..io.images import load_parameters
from ..io.records import read_csv
from .contours import LandmarkSample, film_mm


def cohort_landmarks(cohort: Path, protocol: str) -> LandmarkSample:
    """Landmarks of every radiograph of a cohort under a protocol, as they are labelled.

    protocol  its name in the manifest
    raises    InputError for a folder that holds no whole cohort, a protocol that it has not, a radiograph of no grade
    """
    manifest = cohort / "manifest.csv"
    if not manifest.exists():
        raise InputError(f"folder {cohort}: no manifest.csv; allowed: a cohort that is made")
    rows = read_csv(manifest, ("protocol", "file"))
    require_choice(f"folder {cohort}: protocol", protocol, sorted({row["protocol"] for row in rows}))
    places, grades = [], []
    for row in rows:
        if row["protocol"] != protocol:
            continue
        made = load_parameters(cohort / row["file"])
        knee, truth = made["knee"], made["truth"]
        if knee is None or truth is None or truth.grade is None:
            raise InputError(f"file {row['file']}: grade = None; allowed: radiographs of knees that have one")
        places.append(film_mm(truth.landmarks_px, knee.side, made["protocol"].pixel_mm))
        grades.append(truth.grade)
    return LandmarkSample(places_mm=np.array(places), grades=np.array(grades))
