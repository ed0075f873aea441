"""grade_table: a table of grades by name, or from a user's own TOML file."""

import os
import warnings
from collections.abc import Sized
from functools import cache
from pathlib import Path
from typing import Any

from ..core.checks import InputError, require_path
from .grades import RangeGrades, SeverityGrades, SharedGrades
from .records import record
from .tables import read_toml
from .userfiles import refusing

_FOLDER = Path(__file__).resolve().parent / "grades"
# Earlier name of a table -> its name.
_EARLIER = {"people": "population"}
# Entries of a table by severity that a table by ranges lacks.
_OF_SEVERITY = frozenset(SeverityGrades.__struct_fields__) - frozenset(SharedGrades.__struct_fields__)


def grade_tables() -> list[str]:
    """Return the names of the tables that come with the package."""
    return list(_names())


@cache  # asked of every knee with a grade
def _names() -> tuple[str, ...]:
    return tuple(sorted(path.stem for path in _FOLDER.glob("*.toml")))


def grade_table_name(name: str) -> str:
    """Return the name of a table of grades as it is now; warn where an earlier one is given."""
    if name not in _EARLIER:
        return name
    warnings.warn(
        f"grade table {name!r} is now {_EARLIER[name]!r}; the earlier name will be removed",
        DeprecationWarning,
        stacklevel=4,
    )
    return _EARLIER[name]


def tables_with(grade: int) -> list[str]:
    """Return the names of the package's tables that have a grade."""
    return [name for name in grade_tables() if grade in grade_table(name).grades]


@cache
def grade_table(name_or_path: str) -> RangeGrades | SeverityGrades:
    """Read a table of grades by name, or from a TOML file.

    A file may name another table as its `base` and give only what differs: a partial `[grade.0]` changes these ranges
    of the base's grade 0 and keeps the others; `[grade.3]` adds a grade.

    raises  InputError for an unknown name, a file that is not readable TOML, one that is no table of grades, or a base
            that leads back to itself
    """
    path = _path(name_or_path)
    table = _with_base(path, ())
    kind: type[RangeGrades] | type[SeverityGrades] = RangeGrades if "grade" in table else SeverityGrades
    try:
        made = record(kind, table, f"grades {path.name}")
    except ValueError as error:
        raise InputError(str(error)) from None
    if isinstance(made, SeverityGrades):
        _require_every_grade(made, path.name)
    return made


def _with_base(path: Path, above: tuple[Path, ...]) -> dict[str, Any]:
    """A table with what its base has besides; of a base of the other kind, what both kinds share."""
    with refusing(path, "a readable TOML file"):
        here = Path(os.path.realpath(path))
    if here in above:
        raise InputError(f"base of grade table {above[0].name} must not lead back to itself, got {path.name}")
    table = read_toml(path)
    base = table.pop("base", None)
    if base is None:
        return table
    if not isinstance(base, str):
        raise InputError(f"base of grade table {path.name} must be the name or path of a table, got {base!r}")
    below = path.parent / base if base.endswith(".toml") else _path(base)
    of_base = _with_base(below, (*above, here))
    kinds = ["grade" in one if one.keys() & {"grade", *_OF_SEVERITY} else None for one in (table, of_base)]
    if None not in kinds and kinds[0] != kinds[1]:
        of_base = {name: part for name, part in of_base.items() if name in SharedGrades.__struct_fields__}
    return _merged(of_base, table)


def _merged(base: dict[str, Any], table: dict[str, Any]) -> dict[str, Any]:
    """The base's entries, each with what the table has of it; in the base's order, by which values are sampled."""
    merged = dict(base)
    for name, value in table.items():
        both = isinstance(value, dict) and isinstance(base.get(name), dict)
        merged[name] = _merged(base[name], value) if both else value
    return merged


def _path(name_or_path: str) -> Path:
    require_path(name_or_path, "grade_table")
    if Path(name_or_path).suffix == ".toml":
        return Path(name_or_path)
    name = grade_table_name(str(name_or_path))
    if name not in grade_tables():
        allowed = ", ".join(grade_tables())
        raise InputError(f"grade_table must be {allowed}, or the path of a .toml file, got {str(name_or_path)!r}")
    return _FOLDER / f"{name}.toml"


def _require_every_grade(table: SeverityGrades, name: str) -> None:
    grades = [str(grade) for grade in table.grades]
    lists: dict[str, Sized] = {
        "osteophytes.level": table.osteophytes.level,
        "osteophytes.spine": table.osteophytes.spine,
        "rest.plate": table.rest.plate,
        "rest.varus_deg": table.rest.varus_deg,
        "rest.age_years": table.rest.age_years,
        "rest.women": table.rest.women,
        "rest.bmi_more": table.rest.bmi_more,
        "rest.density_more": table.rest.density_more,
    }
    if table.central is not None:
        lists["central.share"] = table.central.share
    if table.cysts is not None:
        lists["cysts.share"] = table.cysts.share
    if table.subluxation is not None:
        lists["subluxation.lateral_mm"] = table.subluxation.lateral_mm
    if table.notch is not None:
        lists["notch.growth_mm"] = table.notch.growth_mm
    for entry, values in lists.items():
        if len(values) != len(grades):
            raise InputError(f"grades {name}: {entry} has {len(values)} entries; allowed: {len(grades)}, as rest.wider")
    for entry, laws in (("spaces.medial", table.spaces.medial), ("spaces.lateral", table.spaces.lateral)):
        if sorted(laws) != grades:
            raise InputError(f"grades {name}: {entry} has {', '.join(sorted(laws))}; allowed: {', '.join(grades)}")
