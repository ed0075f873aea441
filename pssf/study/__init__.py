"""The radiomics study of a cohort: `run` takes a manifest to a report.

split.split_subjects      subjects, grades       -> training, validation, test subjects
selection.preparation     name of a selection    -> pipeline: prune, standardise, select
models.tune               training, validation   -> fitted model
metrics.score             truth, probability     -> AUC, balanced accuracy, macro F1
baselines.baselines_of    features               -> chance, body and joint space alone, as further models
transfer                  training radiographs   -> stable features; features harmonised across protocols
scenarios.one_split       features of a cohort   -> predictions within, across and over all protocols
intervals                 predictions            -> 95 % intervals; paired differences with p
calibration               predictions            -> slope, Brier score; confusion
reliability               features of a cohort   -> ICC of every feature, its interval, shares of variance
importance                importances            -> share of each feature and family; permutation
saving.dumps              fitted model           -> bytes without pickle
evidence                  outcomes, features     -> all tables
parameters                manifest, features     -> what the knees were built with; what each feature follows
subgroups                 predictions            -> scores of women and men, of younger and older subjects
localisation.summarise    found and known places -> error by protocol and grade
cost.Meter                stages                 -> seconds, seconds each, growth
finished.earlier          folder, key            -> what an earlier run ended with, if nothing has changed
training.train            features of a cohort   -> one outcome a split, in parallel
figures                   tables                 -> PNG
report.render             all of these           -> one HTML page
pipeline.run_study        all of these, in order; what `run` calls
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..core.checks import InputError, require, require_choice, require_seed, require_whole
from ..core.parallel import require_scheduler
from ..radiomics import FAMILIES
from .report.cost import Meter

if TYPE_CHECKING:
    import pandas as pd

    from ..radiomics.region import Template

Progress = Callable[[str, int, int], None]
SELECTIONS, MODELS = ("l1", "mrmr"), ("lr", "rf", "xgb")
_NEEDED = {
    "radiomics": "pyradiomics",
    "sklearn": "scikit-learn",
    "xgboost": "xgboost-cpu",
    "feature_engine": "feature-engine",
    "pandas": "pandas",
    "matplotlib": "matplotlib",
    "skimage": "scikit-image",
    "jinja2": "jinja2",
    "skops": "skops",
}


@dataclass(frozen=True, kw_only=True)
class StudySettings:
    """What the results depend on, beside the cohort.

    region_px      side of the region about the medial joint line
    bins           of grey value, for texture
    min_score      a template match below it is refused, and counted as a failure
    repeats        splits of the subjects
    rho            |Spearman's rho| above which the later of two features is left out
    most_features  that a selection may keep
    replicates     of the bootstrap; the least p is 2 / (replicates + 1)
    families       of features; one that is left out costs nothing
    reference      protocol of the within-protocol scenario, and that ICCs are paired with
    raises         InputError for a value out of range
    """

    region_px: int = 512
    bins: int = 64
    min_score: float = 0.5
    repeats: int = 10
    seed: int = 0
    rho: float = 0.9
    most_features: int = 10
    replicates: int = 2000
    families: tuple[str, ...] = FAMILIES
    selections: tuple[str, ...] = SELECTIONS
    models: tuple[str, ...] = MODELS
    reference: str = "reference"

    def __post_init__(self) -> None:
        require_whole("region_px", self.region_px, 16, 4096, "pixels")
        require_whole("bins", self.bins, 8, 256, "grey values")
        require("min_score", self.min_score, -1, 1, "(correlation)")
        require_whole("repeats", self.repeats, 1, 1000, "splits")
        require_seed(self.seed)
        require("rho", self.rho, 0.1, 1, "(correlation)")
        require_whole("most_features", self.most_features, 1, 100, "features")
        require_whole("replicates", self.replicates, 100, 100_000, "samples")
        for name, allowed in (("families", FAMILIES), ("selections", SELECTIONS), ("models", MODELS)):
            given = getattr(self, name)
            if not given:
                raise InputError(f"{name} = (); allowed: one or more of {', '.join(allowed)}")
            for choice in given:
                require_choice(name, choice, allowed)
            if len(set(given)) < len(given):
                raise InputError(f"{name} = {', '.join(given)}; allowed: each once")


@dataclass(frozen=True, kw_only=True)
class StudyResult:
    """Where everything is, and the tables that the report was made from.

    pictures      name -> PNG
    tables        name -> CSV
    models        name -> skops file: fitted within protocol on the first split, 0 vs 2
    scores        one row an arm: mean, spread and interval of AUC, balanced accuracy, macro F1
    differences   one row a pair of arms and metric: paired difference, interval, p, p after Holm
    reliability   one row a feature and set of conditions: ICC(2,1), ICC(3,1), intervals, shares of variance
    localisation  one row a protocol and grade
    seconds       wall time of each stage, those before the study included
    origin        this run, or an earlier run: nothing had changed since
    """

    report: Path
    pictures: dict[str, Path]
    tables: dict[str, Path]
    models: dict[str, Path]
    scores: "pd.DataFrame"
    differences: "pd.DataFrame"
    reliability: "pd.DataFrame"
    localisation: "pd.DataFrame"
    seconds: dict[str, float]
    origin: str = "this run"


def require_extra(scheduler: str | None = None) -> None:
    """Refuse to start without the libraries of the extra `study`, and say how to get them.

    scheduler  address of a Dask scheduler whose workers need them as well
    raises     InputError
    """
    missing = [package for module, package in _NEEDED.items() if find_spec(module) is None]
    if missing:
        raise InputError(
            f"the study needs {', '.join(missing)}; bring them, in the source folder, with: uv sync --extra study "
            "(plain pip cannot build pyradiomics)"
        )
    if scheduler is not None:
        require_scheduler(scheduler, tuple(_NEEDED))


def run(
    manifest: "pd.DataFrame",
    load_pixels: Callable[[str], Any],
    templates: "Sequence[Template]",
    settings: StudySettings,
    out: Path,
    *,
    again: "pd.DataFrame | None" = None,
    meter: Meter | None = None,
    workers: int = 1,
    scheduler: str | None = None,
    progress: Progress | None = None,
) -> StudyResult:
    """Find the regions, measure them, train and test, and write report, pictures and tables into `out`.

    manifest     one row a radiograph: radiograph, subject, knee, side, grade, protocol, file, sha256, pixel_mm, sdd_mm,
                 sod_mm, truth_medial_row_px, truth_medial_col_px; for the baselines also sex, age_years, stature_mm,
                 jsw_medial_mm, without which they are left out
    load_pixels  entry of the column `file` -> (rows, cols) uint16, linear; picklable if workers > 1
    templates    radiographs of standard knees that differ in their joint space, the widest first
    again        some knees taken again under the reference protocol: the manifest's columns, with the knee that it is
                 again, kind (noise | perturbation) and turn; only for the reliability of features
    meter        of the stages before this one, for the report; those of the study are added to it
    workers      processes; no result depends on them
    scheduler    address of a Dask scheduler whose workers measure, train and test instead
    progress     is told stage, done, of how many
    raises       InputError for a manifest that lacks a column or has too few subjects, or a missing library
    """
    require_extra()
    from .pipeline import Run, run_study

    how = Run(load_pixels, templates, settings, out, meter or Meter(), workers, scheduler, progress or _silent)
    return run_study(how, manifest, again)


def measure(
    manifest: "pd.DataFrame",
    load_pixels: Callable[[str], Any],
    templates: "Sequence[Template]",
    settings: StudySettings,
    out: Path,
    *,
    again: "pd.DataFrame | None" = None,
    meter: Meter | None = None,
    workers: int = 1,
    scheduler: str | None = None,
    progress: Progress | None = None,
) -> Path:
    """The first stage of `run` alone: find the regions and measure them; returns the path of features.csv."""
    require_extra()
    from .pipeline import Run, measured

    how = Run(load_pixels, templates, settings, out, meter or Meter(), workers, scheduler, progress or _silent)
    measured(how, manifest, again)
    return out / "features.csv"


def _silent(stage: str, done: int, of: int) -> None:
    """Progress that nobody wants to see."""
