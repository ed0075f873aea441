"""Grade tables: distributions of knee parameters for each KL grade, loaded by name or from a user's TOML file."""

import os
import warnings
from collections.abc import Sized
from functools import cache
from pathlib import Path
from typing import Any

from ...core.checks import InputError, require_path
from ..data_files import read_toml
from ..table_records import parse_record
from ..user_files import convert_os_errors
from .grade_records import RangeGradeTable, SeverityGradeTable, SharedGradeTable

_FOLDER = Path(__file__).resolve().parents[1] / "grades"
# Mapping of deprecated table names to current table names.
_RENAMED_TABLES = {"people": "population"}
# Entries that are allowed only in tables with a latent severity.
_SEVERITY_ENTRIES = frozenset(SeverityGradeTable.__struct_fields__) - frozenset(SharedGradeTable.__struct_fields__)


def list_grade_tables() -> list[str]:
    """List the names of the grade tables in the package.

    Returns
    -------
    list of str
        Names in alphabetical order.
    """
    return list(_list_names())


@cache  # The names are cached, because they are requested for every knee that has a grade.
def _list_names() -> tuple[str, ...]:
    """Return the cached names of the grade tables in the package."""
    return tuple(sorted(path.stem for path in _FOLDER.glob("*.toml")))


def resolve_grade_table_name(name: str) -> str:
    """Return the current name of a grade table.

    Parameters
    ----------
    name : str
        Current or deprecated name.

    Returns
    -------
    str
        Current name; an unknown name is returned unchanged.

    Warns
    -----
    DeprecationWarning
        If the name is deprecated.
    """
    if name not in _RENAMED_TABLES:
        return name
    warnings.warn(
        f"grade table {name!r} is now {_RENAMED_TABLES[name]!r}, but the former name will be removed; "
        f"use {_RENAMED_TABLES[name]!r}",
        DeprecationWarning,
        stacklevel=4,
    )
    return _RENAMED_TABLES[name]


def list_tables_with_grade(grade: int) -> list[str]:
    """List the grade tables of the package that define a KL grade.

    Parameters
    ----------
    grade : int
        KL grade.

    Returns
    -------
    list of str
        Names of the tables.
    """
    return [name for name in list_grade_tables() if grade in load_grade_table(name).grades]


@cache
def load_grade_table(name_or_path: str) -> RangeGradeTable | SeverityGradeTable:
    """Load a grade table by name, or from a TOML file.

    A file may name another table as its ``base`` and list only the entries that differ from the base table. For
    example, the entry ``[grade.0]`` replaces the listed ranges of grade 0. The entry ``[grade.3]`` adds grade 3 if the
    base table does not define it.

    Parameters
    ----------
    name_or_path : str
        Name of a grade table in the package, or path of a .toml file.

    Returns
    -------
    RangeGradeTable or SeverityGradeTable
        Grade table; its type depends on the entries of the file.

    Raises
    ------
    InputError
        If the name is unknown, the file is not readable TOML or not a grade table, or the chain of base tables is
        circular.
    """
    path = _resolve_path(name_or_path)
    table = _read_with_base(path, ())
    kind: type[RangeGradeTable] | type[SeverityGradeTable] = RangeGradeTable if "grade" in table else SeverityGradeTable
    try:
        made = parse_record(kind, table, f"grades {path.name}")
    except ValueError as error:
        raise InputError(str(error)) from None
    if isinstance(made, SeverityGradeTable):
        _require_every_grade(made, path.name)
    return made


def _read_with_base(path: Path, ancestors: tuple[Path, ...]) -> dict[str, Any]:
    """Read a grade table and add the entries of its base table.

    If the base table has the other type, only the entries that both types contain are added.
    """
    with convert_os_errors(path, "a readable TOML file"):
        here = Path(os.path.realpath(path))
    if here in ancestors:
        raise InputError(f"bases of grade table {ancestors[0].name} must not be circular, got {path.name} twice")
    table = read_toml(path)
    base = table.pop("base", None)
    if base is None:
        return table
    if not isinstance(base, str):
        raise InputError(f"base of grade table {path.name} must be the name or path of a table, got {base!r}")
    below = path.parent / base if base.endswith(".toml") else _resolve_path(base)
    of_base = _read_with_base(below, (*ancestors, here))
    kinds = ["grade" in one if one.keys() & {"grade", *_SEVERITY_ENTRIES} else None for one in (table, of_base)]
    if None not in kinds and kinds[0] != kinds[1]:
        of_base = {name: part for name, part in of_base.items() if name in SharedGradeTable.__struct_fields__}
    return _merge_tables(of_base, table)


def _merge_tables(base: dict[str, Any], table: dict[str, Any]) -> dict[str, Any]:
    """Merge a table into its base table, entry by entry.

    The entries remain in the order of the base table, because sampled values depend on the order.
    """
    merged = dict(base)
    for name, value in table.items():
        both = isinstance(value, dict) and isinstance(base.get(name), dict)
        merged[name] = _merge_tables(base[name], value) if both else value
    return merged


def _resolve_path(name_or_path: str) -> Path:
    """Return the path of the grade table with a given name or path; raise InputError if the name is unknown."""
    require_path(name_or_path, "grade_table")
    if Path(name_or_path).suffix == ".toml":
        return Path(name_or_path)
    name = resolve_grade_table_name(str(name_or_path))
    if name not in list_grade_tables():
        allowed = ", ".join(list_grade_tables())
        raise InputError(f"grade_table must be {allowed}, or the path of a .toml file, got {str(name_or_path)!r}")
    return _FOLDER / f"{name}.toml"


def _require_every_grade(table: SeverityGradeTable, name: str) -> None:
    """Raise InputError if a list in a severity grade table does not have one entry per grade."""
    grades = [str(grade) for grade in table.grades]
    lists: dict[str, Sized] = {
        "osteophytes.level": table.osteophytes.level,
        "osteophytes.spine": table.osteophytes.spine,
        "rest.plate": table.rest.plate,
        "rest.varus_deg": table.rest.varus_deg,
        "rest.age_years": table.rest.age_years,
        "rest.women": table.rest.women,
        "rest.bmi_offset": table.rest.bmi_offset,
        "rest.density_offset": table.rest.density_offset,
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
            raise InputError(
                f"{entry} of grade table {name} must have {len(grades)} entries, as many as rest.bone_scale_factor, "
                f"got {len(values)}"
            )
    for entry, laws in (("spaces.medial", table.spaces.medial), ("spaces.lateral", table.spaces.lateral)):
        if sorted(laws) != grades:
            raise InputError(
                f"{entry} of grade table {name} must have the grades {', '.join(grades)}, got {', '.join(sorted(laws))}"
            )
