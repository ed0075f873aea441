"""Settings of a whole experiment: cohort, study, patient radiographs and designed experiments.

The settings file is a flat TOML file with the setting names of the command line, cohort presets and `StudySettings`.
"""

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path
from typing import Any, get_type_hints

import msgspec
from msgspec import structs

from ...core.checks import InputError, format_value, suggest_name
from ...data.data_files import read_toml
from ...data.knees.preset_table import CohortPreset
from ...data.table_records import MSGSPEC_LOCK
from .study_settings import StudySettings

# Description of each setting type in error messages.
_TYPE_NAMES = {
    str: "text",
    int: "a whole number",
    float: "a number",
    tuple[str, ...]: "a list of strings",
    tuple[int, ...]: "a list of integers",
    tuple[float, ...]: "a list of numbers",
}
# Preset fields that are named differently from their setting, with the name of the setting.
_SETTING_OF_ENTRY = {"settings": "set"}
# Ratio of detector width to default region width, such as 2048 to 512 pixels.
_REGION_FRACTION = 4
# Minimum side length of a region, in px.
_LEAST_REGION_PX = 16


@dataclass(frozen=True, kw_only=True)
class PatientFilms:
    """Patient radiographs on disk, and settings of the models that are tested on the radiographs.

    Parameters
    ----------
    folder : Path
        Folder of images, or a CSV file with a list of images (`io.patients.patient_radiographs.list_films`).
    protocol : str, optional
        Protocol of the cohort radiographs used for training. If None, the reference protocol of the study is used.
    pixel_mm : float, optional
        Pixel pitch to which patient and cohort radiographs are resampled, in mm. If None, see `study.FilmSet`.
    region_mm : float, optional
        Side length of the region, in mm. If None, see `study.FilmSet`.
    """

    folder: Path
    protocol: str | None = None
    pixel_mm: float | None = None
    region_mm: float | None = None


@dataclass(frozen=True, kw_only=True)
class DesignSizes:
    """Sizes of the designed experiments that extend a cohort; an experiment of size 0 is omitted.

    Parameters
    ----------
    curve_knees : int, default 0
        Number of knees with response curves (`study.design.response_curve_design`).
    sobol_samples : int, default 0
        Number of samples of the Sobol design (`study.design.sensitivity_plan`), 64 or more.
    sensitivity_knees : int, default 0
        Number of knees with sensitivity pairs, in which one parameter at a time is changed.
    """

    curve_knees: int = 0
    sobol_samples: int = 0
    sensitivity_knees: int = 0


@dataclass(frozen=True, kw_only=True)
class ExperimentSettings:
    """All settings that affect the results of an experiment.

    Parameters
    ----------
    preset : str
        Name of a cohort preset.
    seed : int
        Seed of the cohort and of the study.
    engine : {"scanline", "embree"}
        Ray casting engine.
    cohort : mapping of str to object
        Fields that replace fields of the preset; see `cohort.plan_cohort`.
    study : mapping of str to object
        Fields of `StudySettings` that replace the defaults.
    films : PatientFilms or None
        Patient radiographs of the external test set; None for no external test.
    design_sizes : DesignSizes
        Sizes of the designed experiments.
    """

    preset: str = "quick"
    seed: int = 0
    engine: str = "scanline"
    cohort: Mapping[str, Any] = field(default_factory=dict)
    study: Mapping[str, Any] = field(default_factory=dict)
    films: PatientFilms | None = None
    design_sizes: DesignSizes = field(default_factory=DesignSizes)


# Sections of a settings file: name and type of each setting, by section title. The settings `repeats` and `seed` belong
# to both cohort and study, and are listed only in the cohort section.
_OF_STUDY = {name: kind for name, kind in get_type_hints(StudySettings).items() if name not in ("seed", "repeats")}
_OF_COHORT = {_SETTING_OF_ENTRY.get(one.name, one.name): one.type for one in structs.fields(CohortPreset)}
_OF_FILMS = {"films": str, "films_protocol": str, "films_pixel_mm": float, "films_region_mm": float}
_OF_DESIGNS = {one.name: int for one in fields(DesignSizes)}
_PARTS: dict[str, dict[str, Any]] = {
    "Cohort": {"preset": str, "seed": int, "engine": str, **_OF_COHORT},
    "Features, models and statistics": _OF_STUDY,
    "Patient radiographs": _OF_FILMS,
    "Designed experiments": _OF_DESIGNS,
}
# Type of each setting, keyed by setting name.
SETTING_TYPES: dict[str, Any] = {name: kind for part in _PARTS.values() for name, kind in part.items()}


def check_setting_types(given: Mapping[str, Any], label: str = "settings") -> dict[str, Any]:
    """Check the names and types of settings, but not the range of their values.

    Parameters
    ----------
    given : mapping of str to object
        Settings by name.
    label : str
        Name of the file or object in error messages.

    Returns
    -------
    dict of str to object
        Settings with lists converted to tuples.

    Raises
    ------
    InputError
        A name is unknown, or a value has the wrong type.
    """
    checked = {}
    for name, value in given.items():
        if name not in SETTING_TYPES:
            names = ", ".join(SETTING_TYPES)
            raise InputError(
                f"{label}: setting must be one of {names}, got {name!r}{suggest_name(name, SETTING_TYPES)}"
            )
        try:
            with MSGSPEC_LOCK:
                checked[name] = msgspec.convert(value, SETTING_TYPES[name])
        except msgspec.ValidationError:
            allowed = _TYPE_NAMES[SETTING_TYPES[name]]
            raise InputError(f"{label}: {name} must be {allowed}, got {format_value(value)}") from None
    return checked


def merge_settings(*layers: Mapping[str, Any]) -> ExperimentSettings:
    """Merge layers of settings by name; a later layer overrides an earlier one.

    Within one layer, `knees` without `bilateral` sets `bilateral` to 0. `matrix` without `region_px` sets the side
    length of the region to a quarter of the matrix, so that the region width in mm is unchanged.

    Parameters
    ----------
    *layers : mapping of str to object
        Settings by name, such as the settings of a file, followed by the settings of the command line.

    Returns
    -------
    ExperimentSettings
        Settings of the experiment.

    Raises
    ------
    InputError
        A name is unknown, a value has the wrong type, or patient radiograph settings are specified without `films`.
    """
    merged: dict[str, Any] = {}
    for layer in layers:
        checked = check_setting_types(layer)
        implied = {"bilateral": 0} if "knees" in checked else {}
        if checked.get("matrix"):
            implied["region_px"] = max(_LEAST_REGION_PX, checked["matrix"] // _REGION_FRACTION)
        merged |= implied | checked
    of_films = {name.removeprefix("films_"): merged[name] for name in _OF_FILMS if name in merged and name != "films"}
    if of_films and "films" not in merged:
        names = ", ".join(f"films_{name}" for name in of_films)
        raise InputError(f"films must be a folder if {names} is used, got films = none")
    entries = {setting: entry for entry, setting in _SETTING_OF_ENTRY.items()}
    return ExperimentSettings(
        **{name: merged[name] for name in ("preset", "seed", "engine") if name in merged},
        cohort={entries.get(name, name): merged[name] for name in _OF_COHORT if name in merged},
        study={name: merged[name] for name in _OF_STUDY if name in merged},
        films=PatientFilms(folder=Path(merged["films"]), **of_films) if "films" in merged else None,
        design_sizes=DesignSizes(**{name: merged[name] for name in _OF_DESIGNS if name in merged}),
    )


def read_settings(path: Path) -> dict[str, Any]:
    """Read a settings file.

    Parameters
    ----------
    path : Path
        TOML file, such as ``study.toml`` in the study folder.

    Returns
    -------
    dict of str to object
        Settings by name, as input of `merge_settings`.

    Raises
    ------
    InputError
        The file cannot be read, a name is unknown, or a value has the wrong type.
    """
    return check_setting_types(read_toml(path), path.name)


def format_settings(settings: ExperimentSettings, cohort: CohortPreset, study: StudySettings) -> str:
    """Format all settings of an experiment as a TOML file with which the experiment can be repeated.

    Parameters
    ----------
    settings : ExperimentSettings
        Settings of the experiment; default values are not filled in.
    cohort : CohortPreset
        Cohort preset, in which all replaced fields are set.
    study : StudySettings
        Settings of the study.

    Returns
    -------
    str
        Content of a settings file, in which settings without a value are omitted.
    """
    films = {} if settings.films is None else asdict(settings.films)
    named = {"films" if name == "folder" else f"films_{name}": value for name, value in films.items()}
    values = asdict(study) | {"preset": settings.preset, "seed": settings.seed, "engine": settings.engine}
    values |= {_SETTING_OF_ENTRY.get(name, name): value for name, value in structs.asdict(cohort).items()}
    values |= {"repeats": study.repeats} | named | asdict(settings.design_sizes)
    lines = ["# All settings of a study. To repeat the study: pssf study --config FILE --out FOLDER"]
    lines.append("# Relative paths are relative to the working folder.")
    for title, part in _PARTS.items():
        rows = [f"{name} = {_format_toml_value(values[name])}" for name in part if values.get(name) is not None]
        lines += ["", f"# {title}", *rows] if rows else []
    return "\n".join(lines) + "\n"


def _format_toml_value(value: Any) -> str:
    """Format a string, a number or a list as a TOML value."""
    if isinstance(value, tuple | list):
        return f"[{', '.join(map(_format_toml_value, value))}]"
    if isinstance(value, int | float):
        return repr(value)
    # JSON and TOML escape strings in the same way, except for the control character DEL.
    return json.dumps(str(value), ensure_ascii=False).replace("\x7f", "\\u007F")
