"""Make the benchmark data set: images, splits, features, baselines and documents."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ..cohort import make_cohort, plan_cohort, select_subjects
from ..core.processes.execution import Execution
from ..core.processes.parallel_map import map_in_parallel
from ..data.analysis.benchmark_table import BenchmarkDefinition, load_benchmark_definition, load_benchmark_hashes
from ..experiment import load_radiograph_pixels
from ..io import study_results
from ..io.cohort_records import hash_file, read_manifest
from ..simulation import collect_versions
from ..standard_templates import make_standard_templates
from ..study import StudySettings, require_extra
from .image_hashes import count_matching_hashes, format_hashes_toml, hash_subject_pixels

if TYPE_CHECKING:
    import pandas as pd

# CSV files that the Croissant metadata describes.
_TABLE_FILES = ("manifest.csv", "splits.csv", "features.csv", "baselines.csv", "predictions.csv")
# Side length of the region of interest on the detector, in mm: 512 pixels of 0.15 mm, as in the study.
_REGION_MM = 512 * 0.15


@dataclass(frozen=True, kw_only=True)
class BenchmarkResult:
    """Result of `make_benchmark`.

    Attributes
    ----------
    folder : Path
        Folder of the data set.
    baselines : DataFrame
        Scores of the baselines, with one row per task, predictor and test protocol.
    notes : tuple of str
        Notes on missing baselines, on splits with too few subjects, and on variables that predict the grade without the
        image.
    hash_agreement : tuple of int
        Number of subjects whose hash equals the published hash, and number of subjects with a published hash. Both
        numbers are 0 for a changed data set.
    """

    folder: Path
    baselines: "pd.DataFrame"
    notes: tuple[str, ...]
    hash_agreement: tuple[int, int]


def make_benchmark(
    out: Path,
    execution: Execution,
    *,
    subjects: int = 0,
    overrides: Mapping[str, Any] | None = None,
    engine: str = "scanline",
) -> BenchmarkResult:
    """Make the benchmark data set: a cohort with splits, features, baselines and documents.

    The folder contains the output of `cohort.make_cohort`, and splits.csv, features.csv, baselines.csv,
    predictions.csv, datasheet.md, CITATION.cff, croissant.json and frozen.toml. If a run was interrupted, another call
    with the same folder resumes it.

    Parameters
    ----------
    out : Path
        Folder of the data set.
    execution : Execution
        Workers, progress display and timer.
    subjects : int, default 0
        Number of subjects, distributed equally over the grades. Their images are the same as in the complete data set.
        The value 0 selects all subjects.
    overrides : mapping of str to object, optional
        New values for entries of the preset, as in `cohort.plan_cohort`. The result is then a different data set.
    engine : {"scanline", "embree"}, default "scanline"
        Ray caster.

    Returns
    -------
    BenchmarkResult
        Baselines, notes, and agreement with the published hashes.

    Raises
    ------
    InputError
        Under the same conditions as in `cohort.make_cohort`. Also if a grade has too few subjects for a split, or if
        the region of interest is not located in any training radiograph.
    WorkersLostError
        If workers are killed repeatedly.
    """
    require_extra(execution.scheduler)
    from ..study.learn.subject_split import split_subjects
    from ..study.statistics.analyses.leakage_checks import find_leakage_warnings
    from .croissant import build_croissant_metadata
    from .datasheet import DatasheetContent, render_citation, render_datasheet

    frozen = load_benchmark_definition()
    whole = plan_cohort(frozen.preset, seed=frozen.seed, overrides=overrides)
    plan = select_subjects(whole, subjects) if subjects else whole
    # The planned subjects are split first, so that too few subjects raise an error before the simulation, which takes
    # hours.
    split_subjects(*zip(*((case.subject, case.knee.grade) for case in plan.cases), strict=True), seed=frozen.seed)
    with execution.stage("images", "radiographs", sum(len(case.exposures) for case in plan.cases)) as stage:
        how: dict[str, Any] = {"workers": execution.workers, "scheduler": execution.scheduler, "engine": engine}
        path = make_cohort(plan, out, progress=stage.advance, on_kept=stage.add_already_done, **how)
    manifest = read_manifest(path)
    baselines, refused, notes = _compute_baselines(out, manifest, frozen, execution)
    with execution.timer.stage("hashes"):
        made = hash_subject_pixels(manifest, partial(load_radiograph_pixels, out.absolute()))
    study_results.save_text(out / "frozen.toml", format_hashes_toml(made))
    about = DatasheetContent(
        dataset_spec=frozen,
        manifest=manifest,
        total_subjects=len({case.subject for case in whole.cases}),
        variant=" and ".join(overrides or {}).replace("_", " "),
        unlocated_radiographs=refused,
        reference_protocol=str(manifest["protocol"].iloc[0]),
        baselines=baselines,
        notes=notes,
        warnings=find_leakage_warnings(manifest),
        versions=collect_versions(),
    )
    study_results.save_text(out / "datasheet.md", render_datasheet(about))
    study_results.save_text(out / "CITATION.cff", render_citation(frozen, collect_versions()))
    files = {name: (hash_file(out / name), len(study_results.load_bytes(out / name))) for name in _TABLE_FILES}
    study_results.save_json(out / "croissant.json", build_croissant_metadata(frozen, files, list(manifest.columns)))
    agreed = count_matching_hashes(made, {} if overrides else load_benchmark_hashes())
    return BenchmarkResult(folder=out, baselines=baselines, notes=(*notes, *about.warnings), hash_agreement=agreed)


def _compute_baselines(
    out: Path, manifest: "pd.DataFrame", frozen: BenchmarkDefinition, execution: Execution
) -> tuple["pd.DataFrame", int, tuple[str, ...]]:
    """Write splits, features and predictions.

    Return the scores, the number of radiographs without a region, and notes.
    """
    from ..study.design.study_tables import load_study_tables
    from ..study.learn import benchmark_baselines as learning
    from ..study.measurement import measure_features
    from ..study.predictions import ARM_COLUMNS
    from ..study.statistics.analyses.knee_parameters import extract_knee_parameters
    from ..study.statistics.scores import tested_subjects as tested
    from ..study.statistics.scores.confidence_intervals import compute_arm_intervals, compute_test_train_ratio
    from ..study.statistics.scores.split_scores import score_splits, summarise_scores
    from ..study.study_data import StudyContext

    region_px = max(16, round(_REGION_MM / float(manifest["pixel_mm"].iloc[0])))
    settings = StudySettings(
        region_px=region_px, repeats=frozen.splits, seed=frozen.seed, reference=str(manifest["protocol"].iloc[0])
    )
    splits = learning.make_splits(manifest, settings)
    study_results.save_table(out / "splits.csv", splits)
    with execution.timer.stage("templates"):
        templates = make_standard_templates(workers=execution.workers)
    load_pixels = partial(load_radiograph_pixels, out.absolute())
    run = StudyContext(load_pixels, templates, settings, out, execution, load_study_tables())
    table, names, _ = measure_features(run, manifest, None)
    usable = table[table["status"] == "found"]
    reason = learning.explain_missing_network()
    images = None if reason or usable.empty else _load_network_inputs(usable, load_pixels, region_px, execution)
    films = learning.build_benchmark_data(usable, names, extract_knee_parameters(manifest), settings, images)
    predictions = learning.predict_baselines(films, splits, settings, execution)
    study_results.save_table(out / "predictions.csv", predictions)
    scores = score_splits(predictions)
    baselines = summarise_scores(scores).merge(
        compute_arm_intervals(scores, compute_test_train_ratio(splits)), on=ARM_COLUMNS, validate="one_to_one"
    )
    study_results.save_table(out / "baselines.csv", baselines)
    notes = [f"Small CNN: {reason}"] if reason else []
    if not all(tested.has_enough_test_subjects(row) for row in baselines.to_dict("records")):
        least, per_grade = tested.MIN_TEST_SUBJECTS, tested.MIN_TEST_SUBJECTS_PER_CLASS
        few = f"fewer than {least} subjects, or fewer than {per_grade} subjects of a grade"
        notes.append(f"Some test subsets have {few}; these numbers are too small to compare methods")
    return baselines, len(table) - len(usable), tuple(notes)


def _load_network_inputs(
    usable: "pd.DataFrame", load_pixels: Any, region_px: int, execution: Execution
) -> dict[str, NDArray[np.float32]]:
    """Load the network input of every radiograph with a located region, keyed by the name of the radiograph."""
    rows = usable[["file", "row_px", "col_px", "side"]].to_dict("records")
    with execution.stage("regions for the network", "radiographs", len(rows)) as stage:
        shown = map_in_parallel(
            prepare_network_input,
            rows,
            shared={"load_pixels": load_pixels, "region_px": region_px},
            workers=execution.workers,
            scheduler=execution.scheduler,
            on_result=lambda *_: stage.advance(),
        )
    return dict(zip(usable["radiograph"], shown, strict=True))


def prepare_network_input(row: Mapping[str, Any], *, load_pixels: Any, region_px: int) -> NDArray[np.float32]:
    """Crop the region of interest of one radiograph and convert it to the input of the network.

    Parameters
    ----------
    row : mapping of str to object
        Values of the columns ``file``, ``row_px``, ``col_px`` and ``side`` for one radiograph.
    load_pixels : callable
        Function that maps an entry of the column ``file`` to a (rows, cols) uint16 array, in DN.
    region_px : int
        Side length of the region, in pixels.

    Returns
    -------
    (size, size) float32 array
        Network input computed from the logarithm of the pixel values, as returned by
        `study.learn.models.small_network.make_network_input`.
    """
    from ..radiomics.localisation.region_of_interest import cut_region
    from ..study.learn.models.small_network import make_network_input

    return make_network_input(
        cut_region(load_pixels(row["file"]), row["row_px"], row["col_px"], region_px), row["side"]
    )
