"""Simulate radiographs with the acquisition and display variability of patient radiographs."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from ...cohort import Plan, make_cohort, plan_cohort
from ...core.processes.execution import Execution
from ...data.imaging.display_table import DisplayProcessing
from ...io.cohort_records import read_manifest
from ...io.patients.patient_radiographs import Film
from ...model.sampling.display_sampling import sample_processing_from_table
from .film_features import FilmSource, Record

# Source name of simulated radiographs.
SIMULATED = "simulated"
# Key of the random stream for display processing, which differs from the random stream keys of the cohort.
_LOOKS = 301
# Key of the random stream for pixel sizes.
_PITCHES = 302


def plan_simulated_films(protocol: str, knees: int, grade_table: str, grade_count: int, seed: int) -> Plan:
    """Plan a cohort with equally frequent KL grades and one sampled acquisition per knee.

    Parameters
    ----------
    protocol : str
        Name or path of the protocol.
    knees : int
        Number of knees.
    grade_table : str
        Grade table from which knees are sampled.
    grade_count : int
        Number of grades in the grade table.
    seed : int
        Seed of the cohort.

    Returns
    -------
    Plan
        Plan of the cohort.
    """
    each = [knees // grade_count + (index < knees % grade_count) for index in range(grade_count)]
    asked = {"knees": each, "protocols": [protocol], "acquisition": "sampled", "grade_table": grade_table}
    return plan_cohort("quick", seed=seed, overrides=asked)


def simulate_films(folder: Path, plan: Plan, known: DisplayProcessing, execution: Execution) -> FilmSource:
    """Simulate the radiographs of a cohort, and sample display processing for each radiograph.

    Parameters
    ----------
    folder : Path
        Folder of the cohort.
    plan : Plan
        Plan of the cohort.
    known : DisplayProcessing
        Default display processing and distributions of its parameters.
    execution : Execution
        Worker processes, timer and progress display.

    Returns
    -------
    FilmSource
        Radiograph source with the simulated radiographs.
    """
    with execution.stage(
        "simulated radiographs", "radiographs", sum(len(case.exposures) for case in plan.cases)
    ) as stage:
        manifest = read_manifest(make_cohort(
            plan,
            folder,
            workers=execution.workers,
            scheduler=execution.scheduler,
            progress=stage.advance,
            on_kept=stage.add_already_done,
        ))  # fmt: skip
    columns = ["file", "grade", "subject", "side", "pixel_mm", "sha256"]
    films = []
    for number, row in enumerate(manifest[columns].to_dict("records")):
        chance = np.random.SeedSequence(plan.seed, spawn_key=(_LOOKS, number))
        processing = sample_processing_from_table(known, rng=np.random.default_rng(chance))
        films.append(Film(**{**row, "subject": str(row["subject"]), "processing": processing}))
    return FilmSource(name=SIMULATED, folder=folder, films=tuple(films))


def match_pixel_sizes(simulated: FilmSource, records: Mapping[str, Sequence[Record]], seed: int) -> FilmSource:
    """Sample pixel sizes of simulated radiographs from the patient source with the largest number of localised joints.

    Parameters
    ----------
    simulated : FilmSource
        Simulated radiographs.
    records : mapping of str to sequence of dict
        Records of the patient sources.
    seed : int
        Seed of the sampling.

    Returns
    -------
    FilmSource
        Simulated radiographs with sampled pixel sizes for downsampling; the pixel sizes do not depend on grade.

    Notes
    -----
    Downsampling blurs a radiograph, so a classifier could distinguish downsampled patient radiographs from original
    simulated radiographs. Patient crops are downsampled to a fixed number of pixels, so the pixel size relative to the
    knee differs between crops.
    """
    pitches = [sorted(float(one["pitch_mm"]) for one in of if one["status"] == "found") for of in records.values()]
    known = max(pitches, key=len, default=[])
    if not known:
        return simulated
    chance = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(_PITCHES,)))
    drawn = chance.choice(known, len(simulated.films)).tolist()
    films = (replace(film, resampled_pixel_mm=mm) for film, mm in zip(simulated.films, drawn, strict=True))
    return replace(simulated, films=tuple(films))
