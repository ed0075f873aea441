"""Results of a study as the tables and pictures of a README."""

from pathlib import Path

from ...io import results
from ...io.readme import copy_picture, origin_of, require_checkout, write_tables
from .. import StudyResult
from ..statistics.reliability import count_stable

_TABLES = ("scores", "reliability", "claims", "cost")
_PICTURES = ("robustness", "stability")


def require_readme(checkout: Path) -> None:
    """Refuse a folder whose READMEs cannot take the tables of a study.

    raises  InputError, see `io.readme.require_checkout`
    """
    require_checkout(checkout, _TABLES)


def write_readme(checkout: Path, result: StudyResult, preset: str) -> list[Path]:
    """Put the result of a study into the READMEs of a source checkout; returns the paths of what was written.

    The caption has the day on which the report was made, which an earlier run may have done.
    """
    out = result.report.parent
    rows = {
        "scores": result.scores.to_dict("records"),
        "reliability": count_stable(result.reliability).to_dict("records"),
        "claims": results.load_typed_table(result.tables["claims"]).to_dict("records"),
        "cost": results.load_json(out / "study.json")["cost"],
    }
    written = write_tables(checkout, rows, origin_of(result.report, preset=preset))
    for name in _PICTURES:
        written += copy_picture(checkout, name, result.pictures[name])
    return written
