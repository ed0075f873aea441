"""Results of a trial with another effect of the treatment or another human reader, without a new simulation."""

from collections.abc import Mapping

import pandas as pd
from msgspec import structs

from ..core.checks import InputError, require_choice
from ..data.analysis.trial_table import TrialDesign
from .trial_design import check_design
from .trial_statistics import summarise_measures

CHANGES = ("fraction", "human_sd_mm", "human_bias_mm")
# Columns that need treated knees, whose course was simulated with the effect of the design.
_OF_TREATED = ("difference", "p")
# Column that follows from the joint space of a knee in steps, and is therefore not additive.
_GRADE = "human_narrowing"


def change_design(design: TrialDesign, changes: Mapping[str, float]) -> TrialDesign:
    """Change entries of a design whose effect is additive.

    Parameters
    ----------
    design : TrialDesign
        Design of the trial.
    changes : mapping of str to float
        New values by name: ``fraction`` is that of the treatment; ``human_sd_mm`` and ``human_bias_mm`` are those of
        the human reader, in mm.

    Returns
    -------
    TrialDesign
        Changed design.

    Raises
    ------
    InputError
        If a name is unknown, a value is not allowed, or the human reader is changed but is not part of the trial or has
        no error.
    """
    for name in changes:
        require_choice("what-if change", name, CHANGES)
    human = structs.replace(
        design.human,
        sd_mm=changes.get("human_sd_mm", design.human.sd_mm),
        bias_mm=changes.get("human_bias_mm", design.human.bias_mm),
    )
    treatment = structs.replace(design.treatment, fraction=changes.get("fraction", design.treatment.fraction))
    changed = structs.replace(design, human=human, treatment=treatment)
    check_design(changed)
    if human != design.human and ("human" not in design.readers or design.human.sd_mm == 0):
        raise InputError(
            "human reader must be part of the trial and have an sd_mm above 0, got "
            f"{', '.join(design.readers)} and {design.human.sd_mm:g} mm"
        )
    return changed


def estimate_what_if(radiographs: pd.DataFrame, design: TrialDesign, changed: TrialDesign) -> pd.DataFrame:
    """Estimate the measures of a trial with additive changes.

    Parameters
    ----------
    radiographs : DataFrame
        One row per radiograph of the trial.
    design : TrialDesign
        Design of the trial.
    changed : TrialDesign
        Changed design, from `change_design`.

    Returns
    -------
    DataFrame
        Columns of `trial_statistics.summarise_measures` without those of treated knees. The numbers of knees per arm
        are from the untreated knees. The errors of the human reader keep their random numbers.
    """
    table = radiographs[~(radiographs["treated"] & (radiographs["month"] > 0))]
    if changed.human != design.human:
        table = _read_again(table, design, changed)
    return summarise_measures(table, changed).drop(columns=list(_OF_TREATED))


def _read_again(radiographs: pd.DataFrame, design: TrialDesign, changed: TrialDesign) -> pd.DataFrame:
    """Replace bias and standard deviation of the readings of the human reader."""
    ratio = changed.human.sd_mm / design.human.sd_mm
    columns = {}
    for name in (name for name in radiographs if name.startswith("human_") and name != _GRADE):
        exact = radiographs[name.replace("human_", "label_", 1)]
        columns[name] = exact + changed.human.bias_mm + ratio * (radiographs[name] - exact - design.human.bias_mm)
    return radiographs.assign(**columns, **{_GRADE: float("nan")})
