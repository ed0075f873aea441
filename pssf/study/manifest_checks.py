"""Checks of the values of a manifest, row by row, whoever made it: the same as of tables on the command line."""

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
import pandas as pd

from ..core.checks import InputError, require, require_choice
from ..io.film_list import GRADES, SIDES
from .design import Designed

# What names a thing: neither nothing nor NaN, which would be one subject, or many.
_NAMES = ("radiograph", "subject", "knee", "protocol", "file", "sha256")
_LENGTHS_MM = {"pixel_mm": (0.001, 50.0), "sdd_mm": (10.0, 20_000.0), "sod_mm": (10.0, 20_000.0)}
# Numbers that may be unknown.
_OPTIONAL = ("truth_medial_row_px", "truth_medial_col_px", "age_years", "stature_mm", "jsw_medial_mm")


def require_manifest(manifest: Any, called: str = "manifest") -> pd.DataFrame:
    """Refuse a manifest with a value that cannot be meant; `check_manifest` says which columns it must have.

    Parameters
    ----------
    manifest : DataFrame
        One row per radiograph. Columns that are missing are not asked for.
    called : str
        What an error says that it is.

    Returns
    -------
    DataFrame
        The manifest with grades as integers: a data frame makes 2.0 of 2 where it has held gaps.

    Raises
    ------
    InputError
        It is no data frame, is empty or has a column twice; a name is missing or of two kinds (1 and "1"); a grade is
        not 0 to 4, a side neither right nor left, a length no number or out of range.
    """
    if not isinstance(manifest, pd.DataFrame):
        raise InputError(f"{called} must be a pandas DataFrame, got {type(manifest).__name__}")
    if manifest.columns.has_duplicates:
        twice = manifest.columns[manifest.columns.duplicated()][0]
        raise InputError(f"{called}: column {twice!r} is given twice; allowed: each column once")
    if manifest.empty:
        raise InputError(f"{called} must have one row per radiograph, got none")
    for name in _NAMES:
        _each(manifest, name, called, _require_name)
        _require_one_kind(manifest, name, called)
    _each(manifest, "grade", called, _require_grade)
    _each(manifest, "side", called, lambda name, value: require_choice(name, value, SIDES))
    for name, (low_mm, high_mm) in _LENGTHS_MM.items():
        _each(manifest, name, called, partial(_require_length, low_mm, high_mm))
    for name in _OPTIONAL:
        _each(manifest, name, called, _require_number)
    return manifest.assign(grade=manifest["grade"].astype("int64")) if "grade" in manifest else manifest


def _each(manifest: pd.DataFrame, column: str, called: str, check: Callable[[str, Any], None]) -> None:
    """Check the values of a column, if it is there; those that repeat once."""
    if column not in manifest:
        return
    values, labels = manifest[column].tolist(), manifest.get("radiograph", manifest.index)
    seen: set[tuple[type, Any]] = set()
    for label, value in zip(labels, values, strict=True):
        key = (type(value), value if value.__hash__ else repr(value))
        if key not in seen:
            check(f"{called}: radiograph {label}: {column}", value)
            seen.add(key)


def _require_name(name: str, value: Any) -> None:
    is_number = isinstance(value, int | np.integer | float | np.floating) and not isinstance(value, bool)
    if not (isinstance(value, str) and value.strip()) and not (is_number and np.isfinite(value)):
        raise InputError(f"{name} must be text or a number, got {value!r}")


def _require_one_kind(manifest: pd.DataFrame, column: str, called: str) -> None:
    kinds = {isinstance(value, str) for value in manifest[column]} if column in manifest else set()
    if len(kinds) > 1:
        raise InputError(
            f'{called}: {column} must be text in all rows or numbers in all rows, got both: 1 and "1" would be two'
        )


def _require_grade(name: str, value: Any) -> None:
    whole = isinstance(value, float | np.floating) and float(value).is_integer()
    require_choice(name, int(value) if whole else value, GRADES)


def _require_length(low_mm: float, high_mm: float, name: str, value: Any) -> None:
    require(name, value, low_mm, high_mm, "mm")


def _require_number(name: str, value: Any) -> None:
    is_number = isinstance(value, int | np.integer | float | np.floating) and not isinstance(value, bool)
    if not is_number or np.isinf(value):
        raise InputError(f"{name} must be a number, or nan where it is not known, got {value!r}")


def require_designed(designed: Designed) -> Designed:
    """Refuse manifests of radiographs taken by design with a value that cannot be meant.

    Raises
    ------
    InputError
        As `require_manifest`, but for grades, which samples of the space of all parameters do not have.
    """
    for name, table in (("curves", designed.curves), ("shares", designed.shares), ("pairs", designed.pairs)):
        if table is not None:
            without_grade = table.drop(columns="grade", errors="ignore") if isinstance(table, pd.DataFrame) else table
            require_manifest(without_grade, f"manifest of {name}")
    return designed


def require_files_once(manifest: pd.DataFrame, called: str = "manifest") -> None:
    """Refuse a file in two rows, by its path or its content: it would stand in training and test, or repeat itself.

    Raises
    ------
    InputError
        Two rows have one `file` or one `sha256`.
    """
    for column in ("file", "sha256"):
        again = manifest[column].duplicated()
        if again.any():
            first = manifest[column][again].iloc[0]
            one, other = manifest["radiograph"][manifest[column] == first].head(2)
            raise InputError(
                f"{called}: radiographs {one} and {other} have one {column} = {str(first)[:40]}; allowed: a file of "
                "its own for each"
            )
