"""Formatting of numbers and intervals in report tables."""

import math
from typing import Any

import pandas as pd

# Text of a table cell without a value.
MISSING = "–"


def format_fixed(value: Any, digits: int = 2) -> str:
    """Format a number with fixed decimals.

    Parameters
    ----------
    value : Any
        Number, or a missing value.
    digits : int, default 2
        Number of decimals.

    Returns
    -------
    str
        Number as text, with a true minus sign; `MISSING` for a missing or infinite value.
    """
    if not _is_finite(value):
        return MISSING
    # Adding 0 makes a negative zero positive.
    return f"{round(float(value), digits) + 0.0:.{digits}f}".replace("-", "−")


def format_signed(value: Any) -> str:
    """Format a number with a sign and two decimals.

    Parameters
    ----------
    value : Any
        Number, or a missing value.

    Returns
    -------
    str
        Number as text, with a plus or a true minus sign; `MISSING` for a missing or infinite value.
    """
    return ("+" if _is_finite(value) and value > 0 else "") + format_fixed(value)


def format_short(value: float) -> str:
    """Format a number with three significant digits, or as a whole number if it is whole or at least 100.

    Parameters
    ----------
    value : float
        Number, or a missing value.

    Returns
    -------
    str
        Number as text, with a true minus sign; `MISSING` for a missing or infinite value.
    """
    if not _is_finite(value):
        return MISSING
    digits = ".0f" if abs(value) >= 100 or value == int(value) else ".3g"
    return f"{value + 0.0:{digits}}".replace("-", "−")


def format_interval(low: Any, high: Any, digits: int = 2, *, signs: bool = False) -> str:
    """Format an interval as "low to high".

    Parameters
    ----------
    low : Any
        Lower limit, or a missing value.
    high : Any
        Upper limit, or a missing value.
    digits : int, default 2
        Number of decimals; it is 2 if `signs` is True.
    signs : bool, default False
        If True, positive numbers have a plus sign.

    Returns
    -------
    str
        Interval as text; `MISSING` if a limit is missing or infinite.
    """
    if not (_is_finite(low) and _is_finite(high)):
        return MISSING
    ends = [format_signed(end) if signs else format_fixed(end, digits) for end in (low, high)]
    return " to ".join(ends)


def _is_finite(value: Any) -> bool:
    """Check whether a value is a finite number."""
    return not pd.isna(value) and math.isfinite(float(value))
