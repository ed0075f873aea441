"""Design of a virtual trial: population, visits, views, treatment, sites and readers."""

from collections.abc import Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

import msgspec

from ..core.checks import InputError, require_choice, require_in_range, require_integer, require_seed, suggest_name
from ..data.analysis.trial_table import TrialDesign, TrialPopulation, load_default_trial
from ..data.data_files import read_toml
from ..data.table_records import MSGSPEC_LOCK
from ..detector.display_rendering import DISPLAY_PROCESSING

READERS = ("label", "network", "human")
# Causes of measurement error -> protocol fields that have their nominal values without the cause. The causes "noise"
# and "display" are not protocol fields of the acquisition.
CAUSES = {
    "beam": ("beam_angle_deg",),
    "rotation": ("rotation_deg", "tilt_deg"),
    "flexion": ("flexion_deg", "tibia_forward_deg"),
    "magnification": ("sdd_mm", "sod_mm", "centre_x_mm", "centre_z_mm"),
    "noise": ("mas", "tube_kv"),
    "display": (),
}
# Causes that change only the image, not the projected joint space.
IMAGE_CAUSES = ("noise", "display")
_MAX_SITES = 50


def load_trial_design(file: str | Path | None = None, **settings: Any) -> TrialDesign:
    """Load a trial design: the default, changed by a file and by settings.

    Parameters
    ----------
    file : str or Path, optional
        TOML file with entries that differ from the default design.
    **settings
        Entries of the highest level, such as `subjects`, which replace those of the file; None is ignored.

    Returns
    -------
    TrialDesign
        Checked design.

    Raises
    ------
    InputError
        The file cannot be read, or an entry is unknown or not allowed.
    """
    table = describe_design(load_default_trial())
    if file is not None:
        table = _merge(table, read_toml(Path(file)), Path(file))
    table |= {name: value for name, value in settings.items() if value is not None}
    try:
        with MSGSPEC_LOCK:
            design = msgspec.convert(table, TrialDesign)
    except msgspec.ValidationError as error:
        raise InputError(f"trial design must have the entries of a design file, got: {error}") from None
    check_design(design)
    return design


def _merge(table: dict[str, Any], given: Mapping[str, Any], path: Path) -> dict[str, Any]:
    """Replace the entries of the default design by those of a file; tables are merged entry by entry."""
    merged = dict(table)
    for name, value in given.items():
        if name not in table:
            raise InputError(
                f"{path}: entry must be one of {', '.join(table)}, got {name!r}{suggest_name(name, table)}"
            )
        both_tables = isinstance(value, dict) and isinstance(table.get(name), dict)
        merged[name] = {**table[name], **value} if both_tables else value
    return merged


def check_design(design: TrialDesign) -> None:
    """Check the entries of a design.

    Parameters
    ----------
    design : TrialDesign
        Design of a trial.

    Raises
    ------
    InputError
        If an entry is not allowed.
    """
    require_integer("subjects", design.subjects, 4, 100_000, "")
    require_integer("repeats", design.repeats, 2, 20, "")
    require_integer("cause_subjects", design.cause_subjects, 0, 100_000, "")
    require_seed(design.seed)
    if design.pixel_mm:
        require_in_range("pixel_mm", design.pixel_mm, 0.05, 1.0, "mm")
    months = design.visits_months
    if not months or months[0] != 0 or any(late <= early for early, late in pairwise(months)):
        given = ", ".join(f"{month:g}" for month in months)
        raise InputError(f"visits_months must be increasing and begin with 0, got {given}")
    require_in_range("visits_months", months[-1], 0, 240, "months")
    _require_distinct("views", design.views)
    _require_distinct("readers", design.readers)
    for name in design.readers:
        require_choice("readers", name, READERS)
    if "label" not in design.readers:
        raise InputError(f"readers must include label, got {', '.join(design.readers)}")
    _check_population(design.population)
    require_in_range("treatment fraction", design.treatment.fraction, 0, 1, "")
    require_choice("treatment compartment", design.treatment.compartment, ("medial", "lateral", "both"))
    require_in_range("treatment treated", design.treatment.treated, 0, 1, "")
    require_in_range("dropout per_year", design.dropout.per_year, 0, 0.9, "")
    require_in_range("human sd_mm", design.human.sd_mm, 0, 5, "mm")
    require_in_range("human bias_mm", design.human.bias_mm, -5, 5, "mm")
    require_integer("number of sites", len(design.sites), 1, _MAX_SITES, "")
    _require_distinct("site names", [site.name for site in design.sites])
    for site in design.sites:
        require_in_range(f"share of site {site.name}", site.share, 1e-6, 1e6, "")
        require_in_range(f"positioning of site {site.name}", site.positioning, 0, 5, "")
        require_in_range(f"beam_offset_deg of site {site.name}", site.beam_offset_deg, -10, 10, "degrees")
        require_choice(f"display of site {site.name}", site.display, ("sampled", *DISPLAY_PROCESSING))


def _check_population(population: TrialPopulation) -> None:
    """Raise InputError if an entry of the population is not allowed."""
    if not population.grades or len(population.grades) != len(population.shares):
        raise InputError(
            f"population shares must have one number for each of the {len(population.grades)} grades, got "
            f"{len(population.shares)}"
        )
    for grade, share in zip(population.grades, population.shares, strict=True):
        require_integer("population grades", grade, 0, 4, "")
        require_in_range("population shares", share, 1e-6, 1e6, "")
    require_in_range("population female", population.female, 0, 1, "")
    require_integer("population knees", population.knees, 1, 2, "")
    if not population.bmi[0] < population.bmi[1]:
        low, high = population.bmi
        raise InputError(f"population bmi must be a smaller and a larger value, got {low:g} and {high:g}")


def _require_distinct(label: str, names: Sequence[str]) -> None:
    """Raise InputError if there is no name, or a name occurs twice."""
    if not names or len(set(names)) < len(names):
        raise InputError(f"{label} must be one or more different names, got {', '.join(names) or 'none'}")


def describe_design(design: TrialDesign) -> dict[str, Any]:
    """Return a design as a JSON-ready dict.

    Parameters
    ----------
    design : TrialDesign
        Design.

    Returns
    -------
    dict of str to object
        Entries of a design file.
    """
    content: dict[str, Any] = msgspec.json.decode(msgspec.json.encode(design))
    return content
