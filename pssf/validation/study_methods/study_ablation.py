"""Run time of the study if one step is omitted, for each step; needs the optional dependencies ``study``."""

from dataclasses import dataclass, field
from pathlib import Path
from time import perf_counter
from typing import Any

from ...core.processes.execution import Execution
from ...experiment import make_experiment, measure_experiment, run_experiment
from ...io.atomic_write import make_temporary_folder
from ...io.study_results import save_text
from ..raycasting.raycast_engines import Row

# Settings of the cohort. It has one knee per grade more than a split needs, because a region may be rejected in an
# ablation of noise, texture or scatter.
_COHORT = {"knees": [4, 4, 4], "bilateral": 0}
_PROTOCOLS = ("reference", "low_dose", "geometry_shift")


@dataclass(frozen=True)
class AblationCase:
    """One ablation: the omitted step of the study, and the settings that omit it.

    Parameters
    ----------
    omitted : str
        Description of the omitted step.
    cohort : dict
        Changed cohort settings.
    protocol_toml : str
        TOML lines added to each protocol.
    settings : dict
        Changed study settings.
    last_step : {"report", "features", "cohort"}, default "report"
        Last step of the study that is run.
    """

    omitted: str
    cohort: dict[str, Any] = field(default_factory=dict)
    protocol_toml: str = ""
    settings: dict[str, Any] = field(default_factory=dict)
    last_step: str = "report"


ABLATION_CASES = (
    AblationCase("nothing"),
    AblationCase("two of three protocols", cohort={"protocols": ["reference"]}),
    AblationCase("repeat acquisitions", cohort={"retested": 0}),
    AblationCase("trabecular texture", protocol_toml='texture = "none"\n'),
    AblationCase("scatter", protocol_toml='scatter = "none"\n'),
    AblationCase("noise, scatter and blur", protocol_toml='noise = "none"\nscatter = "none"\ndetector_blur = "none"\n'),
    AblationCase("texture families of features", settings={"families": ("firstorder", "shape2D")}),
    AblationCase("mRMR, forest, XGBoost", settings={"selections": ("l1",), "models": ("lr",)}),
    AblationCase("models and report (features only)", last_step="features"),
    AblationCase("regions, features, models and report (cohort only)", last_step="cohort"),
)


def measure_ablations(workers: int, cases: tuple[AblationCase, ...] = ABLATION_CASES) -> list[Row]:
    """Measure the run time of the study for each ablation, with twelve knees and an empty output folder.

    Parameters
    ----------
    workers : int
        Number of worker processes.
    cases : tuple of AblationCase
        Ablations to measure; the first must be the complete study.

    Returns
    -------
    list of dict
        One row per ablation: omitted step, number of radiographs, seconds, and run time divided by that of the complete
        study (``time_fraction``). The last row is the run time to resume a completed study.

    Notes
    -----
    A warm-up study is run first and not reported, so that compiled code is available to every ablation.
    """
    with make_temporary_folder() as folder:
        _time_case(folder / "warm", AblationCase("warm", cohort={"protocols": ["reference"], "retested": 0}), workers)
        rows: list[Row] = []
        for index, case in enumerate(cases):
            radiographs, seconds = _time_case(folder / str(index), case, workers)
            rows.append({"left_out": case.omitted, "radiographs": radiographs, "seconds": seconds})
        if cases[0] == ABLATION_CASES[0]:
            radiographs, seconds = _time_case(folder / "0", cases[0], workers)
            rows.append({"left_out": "everything (study resumed)", "radiographs": radiographs, "seconds": seconds})
    whole = rows[0]["seconds"]
    return [
        row | {"seconds": round(row["seconds"], 1), "time_fraction": round(row["seconds"] / whole, 3)} for row in rows
    ]


def _time_case(out: Path, case: AblationCase, workers: int) -> tuple[int, float]:
    """Run one ablation; return the number of radiographs and the seconds of the run."""
    cohort: dict[str, Any] = _COHORT | {"protocols": list(_PROTOCOLS)} | case.cohort
    if case.protocol_toml:
        cohort["protocols"] = [_write_protocol_variant(out, name, case.protocol_toml) for name in cohort["protocols"]]
    execution, start = Execution(workers=workers), perf_counter()
    made = make_experiment(out, execution, cohort | case.settings)
    if case.last_step == "features":
        measure_experiment(made, execution)
    elif case.last_step == "report":
        run_experiment(made, execution)
    retested = 0 if made.retest is None else len(made.retest)
    return len(made.manifest) + retested, perf_counter() - start


def _write_protocol_variant(out: Path, name: str, technique: str) -> str:
    """Write a protocol file with additional TOML lines, and return the path of the file."""
    path = out / "protocols" / f"{name}.toml"
    save_text(path, f'base = "{name}"\n{technique}')
    return str(path)
