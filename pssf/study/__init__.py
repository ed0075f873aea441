"""Radiomics study of a cohort: `run` computes tables, models and a report from a manifest.

Each module imports only from modules that are listed before it:

- `design.study_settings`: study settings; names of feature selections and classifiers.
- `design.experiment_settings`: settings of cohort, study, patient radiographs and designed experiments; settings file.
- `design.sensitivity_plan`: radiographs for Sobol indices and local slopes.
- `design.response_curve_design`: radiographs of knees at steps of one protocol parameter.
- `design.patient_sets`: patient radiographs used as an external test set.
- `design.classification_tasks`: KL grades, and the classification tasks between grades.
- `design.manifest_checks`: checks of manifest values.
- `design.study_tables`: data tables of the package that a study needs.
- `study_result`: paths and main tables of a finished study.
- `predictions`: prediction tables, passed from training to statistics.
- `study_data`: inputs, features, predictions and tables, passed between stages.
- `statistics.features`: degenerate features, ICC, localisation error, importance, dimensions.
- `statistics.scores`: metrics, 95 % intervals, calibration, subgroups, claims, patient scores.
- `statistics.analyses`: leakage, incremental value, learning curves, response curves, sensitivity.
- `statistics.result_tables`: all tables computed from predictions and features.
- `learn.subject_split`: training, validation and test subjects.
- `learn.models`: feature selection, classifiers, baselines, network, model files.
- `learn.protocol_scenarios`: training and testing within one protocol, across protocols and on several protocols.
- `learn.protocol_transfer`: stable features and harmonisation across protocols.
- `learn.training`: parallel training of all splits.
- `learn.incremental_value`: AUC of JSW, of features, and of JSW with features.
- `learn.response_curves`: predictions at every step of a protocol parameter.
- `learn.confounded_training`: models for data in which age, BMI or site is associated with grade.
- `learn.grade_separability`: upper limit of the AUC, estimated from the parameters of sampled knees.
- `learn.benchmark_baselines`: baselines of a benchmark data set.
- `measurement`: joint regions and their features, measured for a manifest.
- `segmentation_accuracy`: agreement of the segmented bone with the true masks.
- `prediction.patient_test`: test of models on patient radiographs.
- `report`: figures, run cost, environment, checklist and HTML page.
- `simulator_analyses`: analyses that need simulated data.
- `study_pipeline`: all stages in order.
- `prediction.film_prediction`: predictions of a saved model for patient radiographs.
- `prediction.own_images`: features of user images and masks.
- `prediction.feature_folder`: features of all images in a folder.
- `resume`: reuse of a finished run with unchanged inputs.
"""

from collections.abc import Callable, Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..core.checks import InputError
from ..core.processes.execution import Execution
from ..core.processes.parallel_map import require_scheduler
from ..radiomics.features.feature_backends import BACKENDS, default_backend
from .design.patient_sets import FilmSet
from .design.response_curve_design import DesignedManifests
from .design.study_settings import StudySettings
from .libraries import XGBOOST
from .study_result import StudyResult

if TYPE_CHECKING:
    import pandas as pd

    from ..radiomics.localisation.templates import Template

__all__ = ["DesignedManifests", "FilmSet", "StudyResult", "StudySettings", "measure", "require_extra", "run"]

_REQUIRED_PACKAGES = {
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
    """Check that all libraries of the ``study`` extra are installed.

    Parameters
    ----------
    scheduler : str, optional
        Address of a Dask scheduler whose workers must also have the libraries; None to check only this process.

    Raises
    ------
    InputError
        A library is missing in this process or on a worker; the message contains the installation command.
    """
    missing = [package for module, package in _REQUIRED_PACKAGES.items() if find_spec(module) is None]
    if missing:
        raise InputError(
            f"packages required by the study are not installed: {', '.join(missing)}; install them in the source "
            "folder with: pip install '.[study]'"
        )
    backend = default_backend()
    if scheduler is not None:
        require_scheduler(scheduler, (*_REQUIRED_PACKAGES, BACKENDS[backend].module))


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
    designed: DesignedManifests | None = None,
    execution: Execution | None = None,
) -> StudyResult:
    """Locate regions, measure features, train and test models, and write report, figures and tables.

    Parameters
    ----------
    manifest : DataFrame
        One row per radiograph: radiograph, subject, knee, side, grade, protocol, file, sha256, pixel_mm, sdd_mm,
        sod_mm, truth_medial_row_px, truth_medial_col_px. The baselines also need sex, age_years, stature_mm and
        nominal_jsw_medial_mm; a baseline with missing columns is omitted.
    load_pixels : callable
        Function that returns (rows, cols) uint16 pixels, linear in the signal, for an entry of the column ``file``. It
        must be picklable if there is more than one worker.
    templates : sequence of Template
        Radiographs of standard knees with different joint space widths; the knee with the widest joint space is first.
    settings : StudySettings
        Study settings, which do not include cohort settings.
    out : Path
        Output folder.
    retest : DataFrame, optional
        Repeat radiographs of some knees under the reference protocol, used only for the reliability of features. The
        columns are the manifest columns, ``kind`` ("noise" or "perturbation") and ``repeat_index``.
    load_masks : callable, optional
        Function that returns bone masks by name, each (rows, cols) bool, for an entry of the column ``masks`` in
        `retest`. The segmented bone is compared with the masks. The function must be picklable. None skips the
        comparison.
    films : FilmSet, optional
        Patient radiographs used as an external test set.
    designed : DesignedManifests, optional
        Manifests of response curves, Sobol samples and sensitivity pairs. Their columns are the columns of `manifest`,
        kind, repeat_index and source_knee.
    execution : Execution, optional
        Workers, scheduler, timer and progress bar. Stages already in the timer are listed first in the report.

    Returns
    -------
    StudyResult
        Paths of all output files, and the main tables.

    Raises
    ------
    InputError
        The manifest lacks a column or has too few subjects. A repeat radiograph shows a knee that is not in the
        manifest, or reuses a file. A library is missing.
    WorkersLostError
        Worker processes are killed repeatedly.
    """
    require_extra()
    from .design.study_tables import load_study_tables
    from .study_data import StudyContext
    from .study_pipeline import run_study

    given = StudyContext(
        load_pixels, templates, settings, out, execution or Execution(), load_study_tables(), load_masks
    )
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
    """Run only the first stage of `run`: locate the regions and measure their features.

    Parameters
    ----------
    manifest : DataFrame
        One row per radiograph, as for `run`.
    load_pixels : callable
        Function that returns (rows, cols) uint16 pixels, linear in the signal, for an entry of the column ``file``.
    templates : sequence of Template
        Radiographs of standard knees; the knee with the widest joint space is first.
    settings : StudySettings
        Study settings; only region size, grey-level bins, feature families and backend are used.
    out : Path
        Output folder for ``features.csv``.
    retest : DataFrame, optional
        Repeat radiographs of some knees, as for `run`.
    execution : Execution, optional
        Workers, scheduler, timer and progress bar.

    Returns
    -------
    Path
        Path of ``features.csv``.

    Raises
    ------
    InputError
        An input is not valid; see `run`.
    WorkersLostError
        Worker processes are killed repeatedly.
    """
    require_extra()
    from .design.study_tables import load_study_tables
    from .measurement import measure_features
    from .study_data import StudyContext

    given = StudyContext(load_pixels, templates, settings, out, execution or Execution(), load_study_tables())
    measure_features(given, manifest, retest)
    return out / "features.csv"
