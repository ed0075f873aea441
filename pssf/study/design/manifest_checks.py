"""Checks of the values in a manifest and in tables specified on the command line."""

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
import pandas as pd

from ...core.checks import InputError, require_choice, require_in_range
from ...io.patients.patient_list import GRADES, SIDES
from .response_curve_design import DesignedManifests

# Identifier columns. Empty text and NaN are not allowed, because rows without an identifier could belong to one subject
# or to several.
_IDENTIFIER_COLUMNS = ("radiograph", "subject", "knee", "protocol", "file", "sha256")
# Allowed range of each length column, in mm.
_LENGTH_RANGES_MM = {"pixel_mm": (0.001, 50.0), "sdd_mm": (10.0, 20_000.0), "sod_mm": (10.0, 20_000.0)}
# Numeric columns in which NaN is allowed for unknown values.
_OPTIONAL_NUMBERS = ("truth_medial_row_px", "truth_medial_col_px", "age_years", "stature_mm", "jsw_medial_mm")


def require_manifest(manifest: Any, table_name: str = "manifest") -> pd.DataFrame:
    """Check the values in all columns of a manifest; `measurement.check_manifest` finds missing columns.

    Parameters
    ----------
    manifest : DataFrame
        One row per radiograph. Missing columns are allowed.
    table_name : str
        Name of the table in error messages.

    Returns
    -------
    DataFrame
        Manifest with integer grades; pandas stores grade 2 as 2.0 in a column with missing values.

    Raises
    ------
    InputError
        The manifest is not a data frame, is empty or contains a column twice. An identifier is missing, or a column of
        identifiers contains both text and numbers (1 and "1"). A grade is not 0 to 4, a side is neither right nor left,
        or a length is not a number or out of range.
    """
    if not isinstance(manifest, pd.DataFrame):
        raise InputError(f"{table_name} must be a pandas DataFrame, got {type(manifest).__name__}")
    if manifest.columns.has_duplicates:
        twice = manifest.columns[manifest.columns.duplicated()][0]
        raise InputError(f"{table_name} must contain each column once, got {twice!r} twice")
    if manifest.empty:
        raise InputError(f"{table_name} must have one row per radiograph, got no rows")
    for name in _IDENTIFIER_COLUMNS:
        _check_column(manifest, name, table_name, _require_name)
        _require_one_kind(manifest, name, table_name)
    _check_column(manifest, "grade", table_name, _require_grade)
    _check_column(manifest, "side", table_name, lambda name, value: require_choice(name, value, SIDES))
    for name, (low_mm, high_mm) in _LENGTH_RANGES_MM.items():
        _check_column(manifest, name, table_name, partial(_require_length, low_mm, high_mm))
    for name in _OPTIONAL_NUMBERS:
        _check_column(manifest, name, table_name, _require_number)
    return manifest.assign(grade=manifest["grade"].astype("int64")) if "grade" in manifest else manifest


def _check_column(manifest: pd.DataFrame, column: str, table_name: str, check: Callable[[str, Any], None]) -> None:
    """Check each distinct value of a column once, if the table contains the column."""
    if column not in manifest:
        return
    values, labels = manifest[column].tolist(), manifest.get("radiograph", manifest.index)
    seen: set[tuple[type, Any]] = set()
    for label, value in zip(labels, values, strict=True):
        key = (type(value), value if value.__hash__ else repr(value))
        if key not in seen:
            check(f"{table_name}: radiograph {label}: {column}", value)
            seen.add(key)


def _require_name(name: str, value: Any) -> None:
    """Raise InputError unless an identifier is a non-empty string or a finite number."""
    is_number = isinstance(value, int | np.integer | float | np.floating) and not isinstance(value, bool)
    if not (isinstance(value, str) and value.strip()) and not (is_number and np.isfinite(value)):
        raise InputError(f"{name} must be text or a number, got {value!r}")


def _require_one_kind(manifest: pd.DataFrame, column: str, table_name: str) -> None:
    """Raise InputError if a column of identifiers mixes text and numbers."""
    kinds = {isinstance(value, str) for value in manifest[column]} if column in manifest else set()
    if len(kinds) > 1:
        raise InputError(
            f"{table_name}: {column} must be text in all rows or numbers in all rows, got both: "
            '1 and "1" would be two identifiers'
        )


def _require_grade(name: str, value: Any) -> None:
    """Raise InputError unless a grade is one of the KL grades; 2.0 is accepted as 2."""
    whole = isinstance(value, float | np.floating) and float(value).is_integer()
    require_choice(name, int(value) if whole else value, GRADES)


def _require_length(low_mm: float, high_mm: float, name: str, value: Any) -> None:
    """Raise InputError unless a length in mm is within its range."""
    require_in_range(name, value, low_mm, high_mm, "mm")


def _require_number(name: str, value: Any) -> None:
    """Raise InputError unless a value is a finite number or NaN."""
    is_number = isinstance(value, int | np.integer | float | np.floating) and not isinstance(value, bool)
    if not is_number or np.isinf(value):
        raise InputError(f"{name} must be a number, or nan if unknown, got {value!r}")


def require_designed(designed: DesignedManifests) -> DesignedManifests:
    """Check the values of the manifests of designed radiographs.

    Parameters
    ----------
    designed : DesignedManifests
        Manifests of response curves, Sobol samples and sensitivity pairs.

    Returns
    -------
    DesignedManifests
        The manifests in `designed`, unchanged.

    Raises
    ------
    InputError
        A value is not allowed; see `require_manifest`. Grades are not checked, because Sobol samples have no grade.
    """
    for name, table in (
        ("response_curves", designed.response_curves),
        ("sobol_samples", designed.sobol_samples),
        ("sensitivity_pairs", designed.sensitivity_pairs),
    ):
        if table is not None:
            without_grade = table.drop(columns="grade", errors="ignore") if isinstance(table, pd.DataFrame) else table
            require_manifest(without_grade, f"manifest of {name}")
    return designed


def require_unique_files(manifest: pd.DataFrame, table_name: str = "manifest") -> None:
    """Check that no two rows have the same file path or file content.

    A file in two rows could be in both the training set and the test set, or be used as its own repeat radiograph.

    Parameters
    ----------
    manifest : DataFrame
        One row per radiograph: radiograph, file, sha256.
    table_name : str
        Name of the table in error messages.

    Raises
    ------
    InputError
        Two rows have the same `file` or the same `sha256`.
    """
    for column in ("file", "sha256"):
        again = manifest[column].duplicated()
        if again.any():
            first = manifest[column][again].iloc[0]
            one, other = manifest["radiograph"][manifest[column] == first].head(2)
            raise InputError(
                f"{table_name}: radiographs {one} and {other} must have different files, "
                f"got the same {column} = {str(first)[:40]}"
            )
