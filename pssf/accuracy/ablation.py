"""Run time of the study against what is left out of it (needs the extra `study`)."""

from dataclasses import dataclass, field
from pathlib import Path
from time import perf_counter
from typing import Any

from ..core.execution import Execution
from ..experiment import make_experiment, measure_experiment, run_experiment
from ..io.atomic import empty_folder
from ..io.results import save_text
from .engines import Row

# One a grade more than can be split: without noise, texture or scatter a region may be refused.
_COHORT = {"knees": [4, 4, 4], "bilateral": 0}
_PROTOCOLS = ("reference", "low_dose", "geometry_shift")


@dataclass(frozen=True)
class Case:
    """What is left out, and how: of the cohort, of each protocol, of the study's settings, of the stages."""

    what: str
    cohort: dict[str, Any] = field(default_factory=dict)
    technique: str = ""
    settings: dict[str, Any] = field(default_factory=dict)
    until: str = "report"


CASES = (
    Case("nothing"),
    Case("two of three protocols", cohort={"protocols": ["reference"]}),
    Case("knees taken again", cohort={"retested": 0}),
    Case("trabecular texture", technique='texture = "none"\n'),
    Case("scatter", technique='scatter = "none"\n'),
    Case("noise, scatter and blur", technique='noise = "none"\nscatter = "none"\ndetector_blur = "none"\n'),
    Case("texture families of features", settings={"families": ("firstorder", "shape2D")}),
    Case("mRMR, forest, XGBoost", settings={"selections": ("l1",), "models": ("lr",)}),
    Case("models and report (features only)", until="features"),
    Case("regions, features, models, report (cohort only)", until="cohort"),
)


def ablation_rows(workers: int, cases: tuple[Case, ...] = CASES) -> list[Row]:
    """One row a case, each from an empty folder, twelve knees: what is left out, radiographs, seconds, share of all.

    The first row is the whole study; before it one is run that is not counted, so that all find compiled code. The last
    row asks for a study that is there already.
    """
    with empty_folder() as folder:
        _timed(folder / "warm", Case("warm", cohort={"protocols": ["reference"], "retested": 0}), workers)
        rows: list[Row] = []
        for index, case in enumerate(cases):
            radiographs, seconds = _timed(folder / str(index), case, workers)
            rows.append({"left_out": case.what, "radiographs": radiographs, "seconds": seconds})
        if cases[0] == CASES[0]:
            radiographs, seconds = _timed(folder / "0", cases[0], workers)
            rows.append({"left_out": "everything: it is finished", "radiographs": radiographs, "seconds": seconds})
    whole = rows[0]["seconds"]
    return [row | {"seconds": round(row["seconds"], 1), "share": round(row["seconds"] / whole, 3)} for row in rows]


def _timed(out: Path, case: Case, workers: int) -> tuple[int, float]:
    """Radiographs, and seconds of the run."""
    cohort: dict[str, Any] = _COHORT | {"protocols": list(_PROTOCOLS)} | case.cohort
    if case.technique:
        cohort["protocols"] = [_variant(out, name, case.technique) for name in cohort["protocols"]]
    execution, start = Execution(workers=workers), perf_counter()
    made = make_experiment(
        out, execution, preset="quick", seed=0, engine="scanline", cohort=cohort, settings=case.settings
    )
    if case.until == "features":
        measure_experiment(made, execution)
    elif case.until == "report":
        run_experiment(made, execution)
    retested = 0 if made.retest is None else len(made.retest)
    return len(made.manifest) + retested, perf_counter() - start


def _variant(out: Path, name: str, technique: str) -> str:
    path = out / "protocols" / f"{name}.toml"
    save_text(path, f'base = "{name}"\n{technique}')
    return str(path)
