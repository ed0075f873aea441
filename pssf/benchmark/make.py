"""Makes the data set: images first, then what is written about them; goes on where an earlier run stopped."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ..cohort import make_cohort, plan_cohort, some_people
from ..core.execution import Execution
from ..core.parallel import ordered_map
from ..data.benchmark import FrozenSet, frozen_hashes, frozen_set
from ..experiment import radiograph_pixels, standard_templates
from ..io import results
from ..io.records import read_manifest, sha256
from ..simulation import versions
from ..study import StudySettings, require_extra
from .hashes import agreement, as_toml, hashes

if TYPE_CHECKING:
    import pandas as pd

_TABLES = ("manifest.csv", "splits.csv", "features.csv", "baselines.csv", "predictions.csv")
_REGION_MM = 512 * 0.15  # side of the study's region on the detector


@dataclass(frozen=True, kw_only=True)
class BenchmarkResult:
    """What was made.

    baselines  one row a task, predictor and protocol tested on
    notes      sentences on baselines that are not there, and on what tells a grade without a look at the knee
    frozen     how many people have the hash that the package has written down, and of how many it has one; none of
               another data set
    """

    folder: Path
    baselines: "pd.DataFrame"
    notes: tuple[str, ...]
    frozen: tuple[int, int]


def make_benchmark(
    out: Path,
    execution: Execution,
    *,
    people: int = 0,
    overrides: Mapping[str, Any] | None = None,
    engine: str = "scanline",
) -> BenchmarkResult:
    """The folder of the data set: a cohort's, with splits.csv, features.csv, baselines.csv, predictions.csv,
    datasheet.md, CITATION.cff, croissant.json and frozen.toml.

    people     so many of them, of the grades alike, with the same images as in the whole; 0: all
    overrides  entries that replace the preset's, as for `plan_cohort`, which makes another data set of it
    raises     InputError as `cohort.make_cohort` does, for too few people of a grade to split them, and where no region
               is found to learn from; WorkersLostError when workers keep being killed
    """
    require_extra(execution.scheduler)
    from ..study.learn.split import split_subjects
    from ..study.statistics.provenance import warnings_of
    from .croissant import croissant
    from .datasheet import About, citation, datasheet

    frozen = frozen_set()
    whole = plan_cohort(frozen.preset, seed=frozen.seed, overrides=overrides)
    plan = some_people(whole, people) if people else whole
    # Too few people are refused before hours of images, and not after.
    split_subjects(*zip(*((case.subject, case.knee.grade) for case in plan.cases), strict=True), seed=frozen.seed)
    with execution.stage("images", "radiographs", sum(len(case.exposures) for case in plan.cases)) as stage:
        how: dict[str, Any] = {"workers": execution.workers, "scheduler": execution.scheduler, "engine": engine}
        path = make_cohort(plan, out, progress=stage.advance, kept=stage.keep, **how)
    manifest = read_manifest(path)
    baselines, refused, notes = _baselines(out, manifest, frozen, execution)
    with execution.timer.stage("hashes"):
        made = hashes(manifest, partial(radiograph_pixels, out.absolute()))
    results.save_text(out / "frozen.toml", as_toml(made))
    about = About(
        frozen=frozen,
        manifest=manifest,
        whole=len({case.subject for case in whole.cases}),
        variant=" and ".join(overrides or {}).replace("_", " "),
        refused=refused,
        reference=str(manifest["protocol"].iloc[0]),
        baselines=baselines,
        notes=notes,
        warnings=warnings_of(manifest),
        versions=versions(),
    )
    results.save_text(out / "datasheet.md", datasheet(about))
    results.save_text(out / "CITATION.cff", citation(frozen, versions()))
    files = {name: (sha256(out / name), len(results.load_bytes(out / name))) for name in _TABLES}
    results.save_json(out / "croissant.json", croissant(frozen, files, list(manifest.columns)))
    agreed = agreement(made, {} if overrides else frozen_hashes())
    return BenchmarkResult(folder=out, baselines=baselines, notes=(*notes, *about.warnings), frozen=agreed)


def _baselines(
    out: Path, manifest: "pd.DataFrame", frozen: FrozenSet, execution: Execution
) -> tuple["pd.DataFrame", int, tuple[str, ...]]:
    """Splits, features and predictions are written; scores, radiographs without a region, and what there is not."""
    from ..study.learn.frozen import films_of, predict, splits_of, without_network
    from ..study.measuring import Run, measured
    from ..study.predictions import ARM
    from ..study.statistics.intervals import intervals, share_tested
    from ..study.statistics.parameters import parameters_of
    from ..study.statistics.scores import score_splits, summarise
    from ..study.statistics.tested import LEAST_OF_A_CLASS, LEAST_TESTED, enough
    from ..study.tables import study_tables

    region_px = max(16, round(_REGION_MM / float(manifest["pixel_mm"].iloc[0])))
    settings = StudySettings(
        region_px=region_px, repeats=frozen.splits, seed=frozen.seed, reference=str(manifest["protocol"].iloc[0])
    )
    splits = splits_of(manifest, settings)
    results.save_table(out / "splits.csv", splits)
    with execution.timer.stage("templates"):
        templates = standard_templates(workers=execution.workers)
    load_pixels = partial(radiograph_pixels, out.absolute())
    run = Run(load_pixels, templates, settings, out, execution, study_tables())
    table, names, _ = measured(run, manifest, None)
    usable = table[table["status"] == "found"]
    reason = without_network()
    images = None if reason or usable.empty else _images(usable, load_pixels, region_px, execution)
    films = films_of(usable, names, parameters_of(manifest), settings, images)
    predictions = predict(films, splits, settings, execution)
    results.save_table(out / "predictions.csv", predictions)
    scores = score_splits(predictions)
    baselines = summarise(scores).merge(intervals(scores, share_tested(splits)), on=ARM, validate="one_to_one")
    results.save_table(out / "baselines.csv", baselines)
    notes = [f"Small CNN: {reason}"] if reason else []
    if not all(enough(row) for row in baselines.to_dict("records")):
        few = f"fewer than {LEAST_TESTED} people or {LEAST_OF_A_CLASS} of a grade"
        notes.append(f"Some splits test {few}, of whom nothing can be decided")
    return baselines, len(table) - len(usable), tuple(notes)


def _images(
    usable: "pd.DataFrame", load_pixels: Any, region_px: int, execution: Execution
) -> dict[str, NDArray[np.float32]]:
    """Radiograph -> what the network sees of it."""
    rows = usable[["file", "row_px", "col_px", "side"]].to_dict("records")
    with execution.stage("regions for the network", "radiographs", len(rows)) as stage:
        shown = ordered_map(
            shown_to_network,
            rows,
            shared={"load_pixels": load_pixels, "region_px": region_px},
            workers=execution.workers,
            scheduler=execution.scheduler,
            arrived=lambda *_: stage.advance(),
        )
    return dict(zip(usable["radiograph"], shown, strict=True))


def shown_to_network(row: Mapping[str, Any], *, load_pixels: Any, region_px: int) -> NDArray[np.float32]:
    """(size, size) of `network.seen` of the region of one radiograph; logarithm of DN."""
    from ..radiomics.region import cut_region
    from ..study.learn.network import seen

    return seen(cut_region(load_pixels(row["file"]), row["row_px"], row["col_px"], region_px), row["side"])
