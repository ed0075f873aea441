"""Load the contour landmarks of the radiographs in a cohort folder."""

from pathlib import Path

import numpy as np

from ...core.checks import InputError, require_choice
from ...io.cohort_records import read_csv
from ...io.radiograph_files import load_parameters
from .landmark_comparison import LandmarkSample, convert_landmarks_to_mm


def load_cohort_landmarks(cohort: Path, protocol: str) -> LandmarkSample:
    """Load the landmark labels of all cohort radiographs that were simulated with one protocol.

    Parameters
    ----------
    cohort : Path
        Cohort folder.
    protocol : str
        Protocol name in the cohort manifest.

    Returns
    -------
    LandmarkSample
        Contour landmarks and KL grades.

    Raises
    ------
    InputError
        The folder contains no complete cohort or no radiograph with `protocol`, or a radiograph has no grade.
    """
    manifest = cohort / "manifest.csv"
    if not manifest.exists():
        raise InputError(f"cohort must be a folder with a complete cohort, got {cohort} without manifest.csv")
    rows = read_csv(manifest, ("protocol", "file"))
    require_choice(f"folder {cohort}: protocol", protocol, sorted({row["protocol"] for row in rows}))
    places, grades = [], []
    for row in rows:
        if row["protocol"] != protocol:
            continue
        made = load_parameters(cohort / row["file"])
        knee, truth = made["knee"], made["truth"]
        if knee is None or truth is None or truth.grade is None:
            raise InputError(f"grade of every radiograph must be known, got no grade for file {row['file']}")
        places.append(convert_landmarks_to_mm(truth.landmarks_px, knee.side, made["protocol"].pixel_mm))
        grades.append(truth.grade)
    return LandmarkSample(landmarks_mm=np.array(places), grades=np.array(grades))
