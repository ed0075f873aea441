"""Check arguments; every error message states the argument, its allowed values and its actual value."""

import math
import re
import sys
from collections.abc import Collection, Mapping
from dataclasses import MISSING, fields, is_dataclass
from difflib import get_close_matches
from numbers import Integral
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
T = TypeVar("T")
# Minimum length of words that an error message shortens, in characters (assumed: paths and numbers are shorter).
_LONG = 600
# Number of characters that remain at each end of a shortened word.
_KEPT = 80


class InputError(ValueError):
    """Report invalid input in a one-line message.

    Parameters
    ----------
    message : str
        Text for the user. Unprintable characters are escaped and very long words are shortened, so that a file name
        can neither break the line nor flood the terminal.
    """

    def __init__(self, message: str) -> None:
        super().__init__(format_one_line(message))


def format_one_line(text: str) -> str:
    """Escape unprintable characters, such as line breaks, and shorten words of 600 characters or more.

    Parameters
    ----------
    text : str
        Text to format.

    Returns
    -------
    str
        The text on one line.
    """
    whole = "".join(one if one.isprintable() else repr(one)[1:-1] for one in text)
    return re.sub(rf"\S{{{_LONG},}}", _shorten_word, whole)


def _shorten_word(word: re.Match[str]) -> str:
    """Replace the middle of a long word by the word's length in characters."""
    return f"{word[0][:_KEPT]}...({len(word[0])} characters)...{word[0][-_KEPT:]}"


def format_value(value: Any) -> str:
    """Format a value for an error message; an integer that is too long is replaced by its number of digits.

    Parameters
    ----------
    value : Any
        Value to format.

    Returns
    -------
    str
        Representation of the value, or its number of digits if Python cannot write the value.
    """
    try:
        return repr(value)
    except ValueError:  # Python refuses to write integers with more digits than sys.get_int_max_str_digits().
        if isinstance(value, int):
            return f"an integer of about {round(abs(value).bit_length() * math.log10(2))} digits"
        return f"a {type(value).__name__} with an integer of more than {sys.get_int_max_str_digits()} digits"


def require_path(path: Any, name: str = "path") -> Path:
    """Convert an argument to a path.

    Parameters
    ----------
    path : Any
        Value to convert.
    name : str, default "path"
        Name of the argument in the error message.

    Returns
    -------
    Path
        The value as a Path.

    Raises
    ------
    InputError
        If the value is neither a string nor a Path, or contains a null byte.
    """
    if not isinstance(path, str | Path) or "\0" in str(path):
        raise InputError(f"{name} must be text or a Path without null bytes, got {format_value(path)}")
    return Path(path)


def require_in_range(name: str, value: float, low: float, high: float, unit: str) -> None:
    """Require that a number is between two limits, both included.

    Parameters
    ----------
    name : str
        Name of the argument in the error message.
    value : float
        Number to check. NaN is out of range.
    low : float
        Lowest allowed value.
    high : float
        Highest allowed value.
    unit : str
        Unit of the value in the error message; may be empty.

    Raises
    ------
    InputError
        If the value is not a number, or is out of range.
    """
    number = isinstance(value, int | float | np.integer | np.floating) and not isinstance(value, bool)
    if not number or not low <= value <= high:  # The comparison is negated so that NaN is also rejected.
        given, allowed = (f"{text} {unit}".rstrip() for text in (format_value(value), f"{low:g} and {high:g}"))
        raise InputError(f"{name} must be between {allowed}, got {given}")


def require_integer(name: str, value: int, low: int, high: int, unit: str) -> None:
    """Require that a number is an integer between two limits, both included.

    Parameters
    ----------
    name : str
        Name of the argument in the error message.
    value : int
        Number to check. Booleans are not accepted.
    low : int
        Lowest allowed value.
    high : int
        Highest allowed value.
    unit : str
        Unit of the value in the error message; may be empty.

    Raises
    ------
    InputError
        If the value is not a whole number, or is out of range.
    """
    if not isinstance(value, Integral) or isinstance(value, bool) or not low <= value <= high:
        given, allowed = (f"{text} {unit}".rstrip() for text in (format_value(value), f"{low} to {high}"))
        raise InputError(f"{name} must be a whole number from {allowed}, got {given}")


def require_workers(workers: int, unit: str = "threads") -> None:
    """Require that a number of workers is between 1 and 256.

    Parameters
    ----------
    workers : int
        Number to check.
    unit : str, default "threads"
        Unit of the number in the error message, such as "threads".

    Raises
    ------
    InputError
        If the value is not a whole number from 1 to 256.
    """
    require_integer("workers", workers, 1, 256, unit)


def require_seed(seed: int) -> None:
    """Require that a seed is a whole number from 0 to 2**63 - 1.

    Parameters
    ----------
    seed : int
        Number to check.

    Raises
    ------
    InputError
        If the value is not a whole number from 0 to 2**63 - 1.
    """
    require_integer("seed", seed, 0, 2**63 - 1, "")


RNGLike = int | np.random.Generator


def resolve_generator(rng: RNGLike) -> np.random.Generator:
    """Create a random generator from a seed, or return a generator unchanged (Scientific Python SPEC 7).

    Parameters
    ----------
    rng : int or numpy.random.Generator
        Seed from 0 to 2**63 - 1, or a generator. A generator is not copied, so sampling advances its state.

    Returns
    -------
    numpy.random.Generator
        Generator for sampling.

    Raises
    ------
    InputError
        If `rng` is neither a seed nor a generator. None is not allowed, because random results must be reproducible.
    """
    return rng if isinstance(rng, np.random.Generator) else np.random.default_rng(resolve_seed(rng))


def resolve_seed(rng: RNGLike) -> int:
    """Return a seed unchanged, or sample a seed from a generator.

    Parameters
    ----------
    rng : int or numpy.random.Generator
        Seed from 0 to 2**63 - 1, or a generator.

    Returns
    -------
    int
        Seed from 0 to 2**63 - 1.

    Raises
    ------
    InputError
        If `rng` is neither a whole number from 0 to 2**63 - 1 nor a generator.
    """
    if isinstance(rng, np.random.Generator):
        return int(rng.integers(2**63))
    if not isinstance(rng, Integral) or isinstance(rng, bool) or not 0 <= rng < 2**63:
        raise InputError(
            f"rng must be a whole number from 0 to 2**63 - 1 or a numpy Generator, got {format_value(rng)}"
        )
    return int(rng)


def require_choice(name: str, value: Any, allowed: Collection[Any]) -> None:
    """Require that a value is one of the allowed values; the error message suggests the most similar name.

    Parameters
    ----------
    name : str
        Name of the argument in the error message.
    value : Any
        Value to check.
    allowed : collection
        Allowed values.

    Raises
    ------
    InputError
        If the value is not one of the allowed values.
    """
    if not any(_is_same(value, one) for one in allowed):
        raise InputError(
            f"{name} must be one of {', '.join(map(str, allowed))}, got {format_value(value)}"
            f"{suggest_name(value, allowed)}"
        )


def _is_same(value: Any, allowed_value: Any) -> bool:
    """Compare values and types, because True and 1.0 equal 1 in Python but are not valid grades."""
    kinds = [
        next((kind for kind in (bool, Integral, str) if isinstance(of, kind)), type(of))
        for of in (value, allowed_value)
    ]
    return kinds[0] is kinds[1] and bool(value == allowed_value)


def build_from_table(dataclass_type: type[T], table: Mapping[str, Any], label: str) -> T:
    """Construct a parameter dataclass from a mapping; reject unknown and missing field names.

    Parameters
    ----------
    dataclass_type : type
        Dataclass to construct.
    table : mapping of str to Any
        Field values, as read from a TOML or JSON file, keyed by field name.
    label : str
        Name of the file or object in the error message.

    Returns
    -------
    dataclass instance
        Instance of `dataclass_type`.

    Raises
    ------
    InputError
        If a field name is unknown, a required field is missing, or the dataclass rejects a value.
    """
    assert is_dataclass(dataclass_type)
    known = {f.name: f for f in fields(dataclass_type)}
    for name in table:
        if name not in known:
            raise InputError(
                f"{label}: fields must be among {', '.join(known)}, got {name!r}{suggest_name(name, known)}"
            )
    for name, field in known.items():
        if name not in table and field.default is MISSING and field.default_factory is MISSING:
            raise InputError(
                f"{label}: fields must include {', '.join(_required_fields(dataclass_type))}; {name!r} is missing"
            )
    try:
        return dataclass_type(**table)
    except InputError as error:
        raise InputError(f"{label}: {error}") from None


def _required_fields(dataclass_type: Any) -> list[str]:
    """List the names of the fields that have no default."""
    return [f.name for f in fields(dataclass_type) if f.default is MISSING and f.default_factory is MISSING]


def suggest_name(value: Any, allowed: Collection[Any]) -> str:
    """Format a suggestion of the valid name that is most similar to a value.

    Parameters
    ----------
    value : Any
        Value from the user; only text leads to a suggestion.
    allowed : collection
        Valid names.

    Returns
    -------
    str
        " (did you mean '...'?)" with the most similar name; an empty string if no name is similar.

    Notes
    -----
    A name is similar if the spelling is close, or if `value` is one of its words: ``kv`` is similar to ``tube_kv``.
    """
    if not isinstance(value, str) or not value:
        return ""
    names = [name for name in allowed if isinstance(name, str)]
    word = value.lower()
    near = [
        *(name for name in names if word in name.lower().split("_")),
        *get_close_matches(value, names, n=1),
        *(name for name in names if len(word) > 2 and word in name.lower()),
    ]
    return f" (did you mean {near[0]!r}?)" if near else ""
