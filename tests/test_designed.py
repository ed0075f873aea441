"""A study with radiographs taken by design, from their manifests to the report."""

import re
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from drawn import LIGHT, TEMPLATE, Cohort

from pssf import InputError, study
from pssf.core.processes.execution import Execution
from pssf.core.resample import downsample_by_blocks
from pssf.experiment import DesignSizes, make_experiment
from pssf.io.study_results import load_typed_table
from pssf.study.design.response_curve_design import PROTOCOL_AXES
from pssf.study.design.sensitivity_plan import PARAMETER_SPACE
from pssf.study.statistics.analyses import sensitivity_analysis as statistics

BOUNDS = {"nominal_jsw_medial_mm": (2.0, 5.0), "mas": (1.0, 4.0), "chance": (0.0, 1.0)}
SAMPLES = 2
COARSE = PROTOCOL_AXES["pixel_size"].steps.index(2.0) + 1


class Taken:
    """Knees of blocks, some of them taken again: by kind and turn, each a file of its own."""

    def __init__(self) -> None:
        self.cohort = Cohort(5)
        rows = [row for row in self.cohort.rows if row["protocol"] == "reference" and row["grade"] != 1]
        self.manifest = pd.DataFrame(rows).assign(nominal_jsw_medial_mm=lambda t: 5.0 - t["grade"], mas=2.0)
        # Subjects and knees are called by texts, as in tables from elsewhere.
        self.manifest[["subject", "knee"]] = "P" + self.manifest[["subject", "knee"]].astype(str)
        self.known = {row["file"]: row for row in rows}

    def load(self, file: str) -> np.ndarray:
        name, *again = file.split(":")
        pixels = self.cohort.load(name)
        if not again:
            return pixels
        rng = np.random.default_rng(sum(map(ord, file)))
        noisy = np.clip(pixels + np.sqrt(pixels) * rng.standard_normal(pixels.shape), 1, 65535)
        return np.rint(downsample_by_blocks(noisy, 2) if again == ["pixel_size", str(COARSE)] else noisy).astype(
            np.uint16
        )

    def again(self, knees: int, taken: list[tuple[str, int]]) -> pd.DataFrame:
        rows = []
        for row in self.manifest.head(knees).to_dict("records"):
            for kind, turn in taken:
                name = f"{row['file']}:{kind}:{turn}"
                coarser = 2.0 if (kind, turn) == ("pixel_size", COARSE) else 1.0
                changed = {"radiograph": name, "file": name, "sha256": name, "of_knee": row["knee"]}
                changed |= {"kind": kind, "turn": turn, "pixel_mm": coarser * row["pixel_mm"]}
                rows.append(row | changed | ({"mas": 2.2} if kind == "mas" else {}))
        return pd.DataFrame(rows)


TAKEN = Taken()


def designed() -> study.DesignedManifests:
    groups = len({PARAMETER_SPACE[name].group for name in BOUNDS})
    shares = TAKEN.again(1, [("share", turn + 1) for turn in range(SAMPLES * (groups + 2))])
    steps = [("dose", turn + 1) for turn in range(7)] + [("pixel_size", COARSE)]
    pairs = TAKEN.again(4, [("mas", 1)])
    return study.DesignedManifests(
        response_curves=TAKEN.again(8, steps),
        sobol_samples=shares,
        sobol_sample_count=SAMPLES,
        sensitivity_pairs=pairs,
        bounds=BOUNDS,
    )


@pytest.fixture(scope="module", autouse=True)
def few_samples_are_enough():
    """Of 32 samples, as many as a study wants, radiographs would take a minute."""
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(statistics, "_MIN_COMPLETE_SAMPLES", SAMPLES)
        yield


@pytest.fixture(scope="module")
def result(tmp_path_factory) -> study.StudyResult:
    out = tmp_path_factory.mktemp("designed")
    return study.run(TAKEN.manifest, TAKEN.load, [TEMPLATE], LIGHT, out, designed=designed(), execution=Execution())


def test_what_is_taken_by_design_is_in_the_tables_and_in_the_report(result):
    assert {"curve_dose", "curve_pixel_size", "breakpoints", "sobol_indices", "slopes"} <= set(result.tables)
    assert {"curve_dose", "curve_pixel_size", "meaning"} <= set(result.pictures)
    page = result.report.read_text(encoding="utf-8")
    assert all(f'<section id="{name}">' in page for name in ("curves", "meaning"))
    # Its grades are of no table of ranges, so that none is told.
    built = page[page.index("Parameters of the knees") : page.index("<h3>Methods")]
    assert "Sampled: mean" in built
    assert "These grades have no ranges" in built
    assert not re.search(r"Range<|>same<", built)
    dose = load_typed_table(result.tables["curve_dose"])
    assert sorted(set(dose["step"])) == sorted(PROTOCOL_AXES["dose"].steps)
    assert set(dose["measure"]) >= {"median ICC(2,1)", "AUC", "threshold shift, log odds"}


def test_a_region_has_the_same_side_in_mm_whatever_the_pixel(result):
    out = result.report.parent
    assert len(load_typed_table(out / "features_response_curves_80.csv")) == 8 * 7
    assert len(load_typed_table(out / "features_response_curves_40.csv")) == 8
    area = load_typed_table(result.tables["curve_pixel_size"]).query("feature == 'shape2D_PixelSurface'")
    # Of the same pixels it would be four times the area, some ten spreads more.
    assert (area.query("measure == 'feature, SD'")["value"].abs() < 2).all()


def test_correlations_have_slopes_beside_them_and_those_of_the_protocol_are_there(result):
    follows = load_typed_table(result.tables["feature_parameter_correlations"])
    assert {"rho", "rho_within", "slope", "total"} <= set(follows.columns)
    assert set(follows.query("parameter == 'mAs'")["feature"]) == set(follows["feature"])


def test_a_second_run_writes_the_same_bytes(result, tmp_path):
    for name in (
        "features.csv",
        "features_response_curves_80.csv",
        "features_sensitivity_pairs_80.csv",
        "features_sobol_samples_80.csv",
    ):
        (tmp_path / name).write_bytes((result.report.parent / name).read_bytes())
    again = study.run(
        TAKEN.manifest, TAKEN.load, [TEMPLATE], LIGHT, Path(tmp_path), designed=designed(), execution=Execution()
    )
    for name in ("breakpoints", "curve_dose", "sobol_indices", "feature_parameter_correlations"):
        assert again.tables[name].read_bytes() == result.tables[name].read_bytes()
    assert again.pictures["curve_dose"].read_bytes() == result.pictures["curve_dose"].read_bytes()


@pytest.mark.parametrize(
    "wanted", [DesignSizes(sobol_samples=3), DesignSizes(curve_knees=2), DesignSizes(sensitivity_knees=1)]
)
def test_what_cannot_be_taken_is_refused_before_anything_is_made(tmp_path, wanted):
    with pytest.raises(InputError, match="must be"):
        make_experiment(tmp_path / "out", Execution(), preset="quick", seed=0, engine="scanline", design_sizes=wanted)
    assert not (tmp_path / "out").exists()
