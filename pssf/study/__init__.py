"""The radiomics study of a cohort: `run` takes a manifest to a report. Each part imports from those above it.

settings       StudySettings; selections and models by name
space          plan of a cohort                -> samples of the space of all parameters; pairs that differ in one
design         plan of a cohort                -> its knees taken with one thing of a protocol changed at a time
result         StudyResult
films          FilmSet: films to test on
tasks          grades, and which of them are told from which
predictions    the form in which predictions go from training to statistics

statistics/    numbers from numbers; no model is trained
  degenerate   features                        -> which carry nothing
  subjects     rows of subjects                -> grade that a subject counts under; samples of subjects
  metrics      truth, probability              -> AUC, balanced accuracy, macro F1
  scores       predictions                     -> scores by split and arm
  intervals    scores by split                 -> 95 % intervals from the splits; paired differences with p
  calibration  predictions                     -> slope, Brier score; confusion
  subgroups    predictions                     -> scores of women and men, of younger and older subjects
  importance   importances                     -> share of each feature and family
  dimensions   importances, subjects           -> subjects a feature; parameters that were chosen
  reliability  features                        -> ICC of every feature, its interval, shares of variance
  icc_by_subject   pairs of knees              -> intervals of ICCs by a bootstrap of subjects
  localisation joint line located and known    -> error by protocol and grade
  parameters   manifest, features              -> what the knees were built with; what each feature follows
  provenance   manifest                        -> refused, or sentences on how grades may leak
  claims       all of these                    -> what the paper says, and whether it holds here
  evidence     outcomes, features              -> all tables
  external     films' probabilities            -> scores with intervals
  ladder       AUC by what is known            -> intervals, paired differences, the best possible
  learning     AUC by subjects learnt from     -> curves; power and subjects needed for a chosen difference
  responses    features and models by step     -> response curves: value, ICC, threshold shift, AUC
  confounders  AUC where tied and not          -> what is gained, what it costs, what adjustment gives back
  space        radiographs of a sample, pairs  -> shares of variance of each feature; local slopes
  breaks       response curves                 -> where a conclusion breaks, with an interval

learn/         predictions from features
  split        subjects, grades                -> training, validation, test subjects
  selection    name of a selection             -> pipeline: leave out what repeats, standardise, select
  models       training, validation            -> fitted model
  baselines    features                        -> chance, body and joint space alone, as further models
  transfer     training radiographs            -> stable features; features harmonised across protocols
  permutation  fitted model, test part         -> what is lost without a feature
  saving       fitted model                    -> bytes without pickle
  scenarios    features of a cohort            -> predictions within, across and over all protocols, of one split
  each_split   a function, jobs                -> what it gives on every split, in parallel
  training     features of a cohort            -> one outcome a split, in parallel
  refit        features of a cohort            -> models that have learnt from all of it
  confounders  features, age, BMI, protocol    -> naive and adjusted models where one of these goes with grade
  responses    features by step of an axis     -> what models make of the same test knees at every step
  separability table of grades                 -> how well they could be told at best, from drawn parameters
  ladder       parameters, features            -> AUC by what is known: parameters, joint space, features, both
  network      regions, grades                 -> a small convolutional network (extra "cnn")
  frozen       features, regions, splits       -> predictions of the baselines of a frozen data set
  modelfile    a model, templates              -> one file that films can be read by, and back

external       films, a cohort                 -> models of the cohort as displayed, tested on films

report/        figures, cost, environment, checklist, and one HTML page with all of it

tables         the package's tables            -> what a study reads of them
manifest_checks  manifest                      -> refused, or with grades as integers
measuring      manifest                        -> regions and features
segmentation   regions, true masks             -> how the bone that is found agrees with the true one
questions      manifest, features              -> what only a simulator can ask: ladder, learning and response curves
pipeline       all of these in order; what `run` calls
reading        a model's file, films           -> features and probabilities
own_images     image, mask                     -> features without a model; feature_folder: of a folder
finished       folder, key                     -> what an earlier run ended with, if nothing has changed
"""

from collections.abc import Callable, Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..core.checks import InputError
from ..core.execution import Execution
from ..core.parallel import require_scheduler
from ..radiomics.backends import BACKENDS, default_backend
from .design import Designed
from .films import FilmSet
from .libraries import XGBOOST
from .result import StudyResult
from .settings import StudySettings

if TYPE_CHECKING:
    import pandas as pd

    from ..radiomics.patches import Template

__all__ = ["Designed", "FilmSet", "StudyResult", "StudySettings", "measure", "require_extra", "run"]

_NEEDED = {
    "sklearn": "scikit-learn",
    "xgboost": XGBOOST,
    "feature_engine": "feature-engine",
    "pandas": "pandas",
    "matplotlib": "matplotlib",
    "skimage": "scikit-image",
    "jinja2": "jinja2",
    "skops": "skops",
    "SALib": "salib",
}


def require_extra(scheduler: str | None = None) -> None:
    """Refuse to start without the libraries of the extra `study`, and say how to get them.

    scheduler  address of a Dask scheduler whose workers need them as well
    raises     InputError
    """
    missing = [package for module, package in _NEEDED.items() if find_spec(module) is None]
    if missing:
        raise InputError(
            f"the study needs {', '.join(missing)}; bring them, in the source folder, with: pip install '.[study]'"
        )
    backend = default_backend()
    if scheduler is not None:
        require_scheduler(scheduler, (*_NEEDED, BACKENDS[backend].module))


def run(
    manifest: "pd.DataFrame",
    load_pixels: Callable[[str], Any],
    templates: "Sequence[Template]",
    settings: StudySettings,
    out: Path,
    *,
    retest: "pd.DataFrame | None" = None,
    load_masks: Callable[[str], Any] | None = None,
    films: FilmSet | None = None,
    designed: Designed | None = None,
    execution: Execution | None = None,
) -> StudyResult:
    """Find the regions, measure them, train and test, and write report, pictures and tables into `out`.

    manifest     one row a radiograph: radiograph, subject, knee, side, grade, protocol, file, sha256, pixel_mm, sdd_mm,
                 sod_mm, truth_medial_row_px, truth_medial_col_px; for the baselines also sex, age_years, stature_mm,
                 nominal_jsw_medial_mm, without which they are left out
    load_pixels  entry of the column `file` -> (rows, cols) uint16, linear; picklable for more than one worker
    templates    radiographs of standard knees that differ in their joint space, the widest first
    retest       some knees taken again under the reference protocol: the manifest's columns, with the knee that each is
                 of, kind (noise | perturbation) and turn; only for the reliability of features
    load_masks   entry of the repeats' column `masks` -> name -> mask (rows, cols) bool of a bone, which judges the bone
                 that is segmented; picklable; None: nothing does
    films        to test on, beside the cohort
    designed     radiographs taken by design: the manifest's columns, with kind, turn and of_knee
    execution    who measures, trains and tests; stages that its timer has already come first in the report
    raises       InputError for a manifest that lacks a column or has too few subjects, repeats that are not of its
                 knees or no radiographs of their own, or a missing library;
                 WorkersLostError when workers keep being killed
    """
    require_extra()
    from .measuring import Run
    from .pipeline import run_study
    from .tables import study_tables

    given = Run(load_pixels, templates, settings, out, execution or Execution(), study_tables(), load_masks)
    return run_study(given, manifest, retest, films, designed)


def measure(
    manifest: "pd.DataFrame",
    load_pixels: Callable[[str], Any],
    templates: "Sequence[Template]",
    settings: StudySettings,
    out: Path,
    *,
    retest: "pd.DataFrame | None" = None,
    execution: Execution | None = None,
) -> Path:
    """The first stage of `run` alone: find the regions and measure them; returns the path of features.csv.

    raises  InputError and WorkersLostError as `run` does
    """
    require_extra()
    from .measuring import Run, measured
    from .tables import study_tables

    given = Run(load_pixels, templates, settings, out, execution or Execution(), study_tables())
    measured(given, manifest, retest)
    return out / "features.csv"
