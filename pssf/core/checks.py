"""Checks of input: every refusal names the thing, its value and what is allowed."""

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
# A word of so many characters is no path or number of anybody's; so many are kept at either end.
_LONG, _KEPT = 600, 80


class InputError(ValueError):
    """Something that the user gave cannot be used; the message is one line for the user, whatever its names hold."""

    def __init__(self, message: str) -> None:
        super().__init__(one_line(message))


def one_line(text: str) -> str:
    """Write out what is no character for eyes, such as the end of a line in a file's name; shorten endless words."""
    whole = "".join(one if one.isprintable() else repr(one)[1:-1] for one in text)
    return re.sub(rf"\S{{{_LONG},}}", _shortened, whole)


def _shortened(word: re.Match[str]) -> str:
    return f"{word[0][:_KEPT]}...({len(word[0])} characters)...{word[0][-_KEPT:]}"


def shown(value: Any) -> str:
    """Give the representation of a value; of an integer that Python does not write out, how many digits it has."""
    try:
        return repr(value)
    except ValueError:  # more digits than sys.get_int_max_str_digits()
        if isinstance(value, int):
            return f"an integer of some {round(abs(value).bit_length() * math.log10(2))} digits"
        return f"a {type(value).__name__} with an integer of more than {sys.get_int_max_str_digits()} digits"


def require_path(path: Any, what: str = "path") -> Path:
    """A path from what a caller gave for one.

    raises  InputError for anything but text or a path of text, and for a null byte in it
    """
    if not isinstance(path, str | Path) or "\0" in str(path):
        raise InputError(f"{what} = {shown(path)}; allowed: text or a Path, without a null byte")
    return Path(path)


def require(name: str, value: float, low: float, high: float, unit: str) -> None:
    """Refuse a number outside [low, high]; NaN and things that are no number are outside.

    raises  InputError
    """
    number = isinstance(value, int | float | np.integer | np.floating) and not isinstance(value, bool)
    if not number or not low <= value <= high:  # this way round, so that NaN is refused too
        raise InputError(f"{name} = {shown(value)} {unit}; allowed: {low:g} to {high:g} {unit}")


def require_whole(name: str, value: int, low: int, high: int, unit: str) -> None:
    """Refuse anything but a whole number in [low, high].

    raises  InputError
    """
    if not isinstance(value, Integral) or isinstance(value, bool) or not low <= value <= high:
        given, allowed = (f"{text} {unit}".rstrip() for text in (shown(value), f"{low} to {high}"))
        raise InputError(f"{name} = {given}; allowed: whole numbers from {allowed}")


def require_workers(workers: int, unit: str = "threads") -> None:
    """Refuse a number of workers outside 1 to 256.

    raises  InputError
    """
    require_whole("workers", workers, 1, 256, unit)


def require_seed(seed: int) -> None:
    """Refuse anything but a whole number from 0 to 2**63 - 1.

    raises  InputError
    """
    require_whole("seed", seed, 0, 2**63 - 1, "")


Chance = int | np.random.Generator


def generator_of(rng: Chance) -> np.random.Generator:
    """Return a numpy Generator from a seed, or the one that is given (Scientific Python's SPEC 7).

    Parameters
    ----------
    rng : int or numpy.random.Generator
        A seed from 0 to 2**63 - 1, or the generator itself, whose state then moves on.

    Raises
    ------
    InputError
        For anything else, None included: chance is always named, so that a result can be made again.
    """
    return rng if isinstance(rng, np.random.Generator) else np.random.default_rng(seed_of(rng))


def seed_of(rng: Chance) -> int:
    """Return a seed as it is, or one that a numpy Generator draws.

    Raises
    ------
    InputError
        For anything but a whole number from 0 to 2**63 - 1 or a Generator.
    """
    if isinstance(rng, np.random.Generator):
        return int(rng.integers(2**63))
    if not isinstance(rng, Integral) or isinstance(rng, bool) or not 0 <= rng < 2**63:
        raise InputError(f"rng must be a whole number from 0 to 2**63 - 1 or a numpy Generator, got {shown(rng)}")
    return int(rng)


def require_choice(name: str, value: Any, allowed: Collection[Any]) -> None:
    """Refuse a value that is not among those listed, naming the nearest.

    raises  InputError
    """
    if not any(_same(value, one) for one in allowed):
        raise InputError(f"{name} = {shown(value)}; allowed: {', '.join(map(str, allowed))}{hint(value, allowed)}")


def _same(value: Any, one: Any) -> bool:
    """Equal, and of one kind: True and 1.0 are 1 to Python, but no grade."""
    kinds = [next((kind for kind in (bool, Integral, str) if isinstance(of, kind)), type(of)) for of in (value, one)]
    return kinds[0] is kinds[1] and bool(value == one)


def from_table(kind: type[T], table: Mapping[str, Any], what: str) -> T:
    """A parameter dataclass from a mapping, strict about unknown and missing names.

    table  field name -> value, as a TOML or JSON file gives it
    what   how the file or object is called in a refusal
    raises InputError for a misspelt or missing field, or a value its checks refuse
    """
    assert is_dataclass(kind)
    known = {f.name: f for f in fields(kind)}
    for name in table:
        if name not in known:
            raise InputError(f"{what}: unknown field {name!r}{hint(name, known)}; allowed: {', '.join(known)}")
    for name, field in known.items():
        if name not in table and field.default is MISSING and field.default_factory is MISSING:
            raise InputError(f"{what}: field {name!r} is missing; required: {', '.join(_required(kind))}")
    try:
        return kind(**table)
    except InputError as error:
        raise InputError(f"{what}: {error}") from None


def _required(kind: Any) -> list[str]:
    return [f.name for f in fields(kind) if f.default is MISSING and f.default_factory is MISSING]


def hint(value: Any, allowed: Collection[Any]) -> str:
    """Return " (did you mean ...?)" with the name nearest to a text; "" where none is near.

    A name is near that is spelt alike, or has the text among its words: `kv` is near `tube_kv`.
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
