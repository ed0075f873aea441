"""Check a study with designed acquisitions, from the manifests to the report."""

import re
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from block_knee_cohort import LIGHT, TEMPLATE, Cohort

from pssf import InputError, study
from pssf.core.processes.execution import Execution
from pssf.core.resample import downsample_by_blocks
from pssf.experiment import make_experiment
from pssf.io.study_results import load_typed_table
from pssf.study.design.response_curve_design import PROTOCOL_AXES
from pssf.study.design.sensitivity_plan import PARAMETER_SPACE
from pssf.study.statistics.analyses import sensitivity_analysis as statistics

BOUNDS = {"nominal_jsw_medial_mm": (2.0, 5.0), "mas": (1.0, 4.0), "chance": (0.0, 1.0)}
SAMPLES = 2
COARSE = PROTOCOL_AXES["pixel_size"].steps.index(2.0) + 1


class DesignedCohort:
    """Block knees and repeated acquisitions, with a separate file for each kind and repeat number."""

    def __init__(self) -> None:
        self.cohort = Cohort(5)
        rows = [row for row in self.cohort.rows if row["protocol"] == "reference" and row["grade"] != 1]
        self.manifest = pd.DataFrame(rows).assign(nominal_jsw_medial_mm=lambda t: 5.0 - t["grade"], mas=2.0)
        # Identifiers of subjects and knees are strings, as is common in tables from other sources.
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

    def repeat(self, knees: int, acquisitions: list[tuple[str, int]]) -> pd.DataFrame:
        rows = []
        for row in self.manifest.head(knees).to_dict("records"):
            for kind, turn in acquisitions:
                name = f"{row['file']}:{kind}:{turn}"
                coarser = 2.0 if (kind, turn) == ("pixel_size", COARSE) else 1.0
                changed = {"radiograph": name, "file": name, "sha256": name, "source_knee": row["knee"]}
                changed |= {"kind": kind, "repeat_index": turn, "pixel_mm": coarser * row["pixel_mm"]}
                rows.append(row | changed | ({"mas": 2.2} if kind == "mas" else {}))
        return pd.DataFrame(rows)


COHORT = DesignedCohort()


def make_designed_manifests() -> study.DesignedManifests:
    groups = len({PARAMETER_SPACE[name].group for name in BOUNDS})
    sobol_samples = COHORT.repeat(1, [("sobol", turn + 1) for turn in range(SAMPLES * (groups + 2))])
    steps = [("dose", turn + 1) for turn in range(7)] + [("pixel_size", COARSE)]
    pairs = COHORT.repeat(4, [("mas", 1)])
    return study.DesignedManifests(
        response_curves=COHORT.repeat(8, steps),
        sobol_samples=sobol_samples,
        sobol_sample_count=SAMPLES,
        sensitivity_pairs=pairs,
        bounds=BOUNDS,
    )


@pytest.fixture(scope="module", autouse=True)
def reduce_minimum_samples():
    """Lower the minimum number of samples from 32, whose radiographs would take a minute."""
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(statistics, "_MIN_COMPLETE_SAMPLES", SAMPLES)
        yield


@pytest.fixture(scope="module")
def result(tmp_path_factory) -> study.StudyResult:
    out = tmp_path_factory.mktemp("designed")
    return study.run(
        COHORT.manifest, COHORT.load, [TEMPLATE], LIGHT, out, designed=make_designed_manifests(), execution=Execution()
    )


def test_designed_acquisitions_appear_in_the_tables_and_the_report(result):
    assert {"curve_dose", "curve_pixel_size", "breakpoints", "sobol_indices", "slopes"} <= set(result.tables)
    assert {"curve_dose", "curve_pixel_size", "sensitivity"} <= set(result.pictures)
    page = result.report.read_text(encoding="utf-8")
    assert all(f'<section id="{name}">' in page for name in ("curves", "sensitivity"))
    # The manifest names no grade table, so the report shows no ranges.
    built = page[page.index("<h3>Knee parameters") : page.index("<h3>Methods")]
    assert "Sampled: mean" in built
    assert "distributions that overlap between grades" in built
    assert not re.search(r"Range<|>same<", built)
    dose = load_typed_table(result.tables["curve_dose"])
    assert sorted(set(dose["step"])) == sorted(PROTOCOL_AXES["dose"].steps)
    assert set(dose["measure"]) >= {"median ICC(2,1)", "AUC", "threshold shift, log odds"}


def test_the_region_size_in_mm_does_not_depend_on_the_pixel_size(result):
    out = result.report.parent
    assert len(load_typed_table(out / "features_response_curves_80.csv")) == 8 * 7
    assert len(load_typed_table(out / "features_response_curves_40.csv")) == 8
    area = load_typed_table(result.tables["curve_pixel_size"]).query("feature == 'shape2D_PixelSurface'")
    # A region with the same number of pixels would have four times the area, a difference of about ten SD.
    assert (area.query("measure == 'feature, SD'")["value"].abs() < 2).all()


def test_correlations_include_slopes_and_protocol_parameters(result):
    follows = load_typed_table(result.tables["feature_parameter_correlations"])
    assert {"rho", "rho_within", "slope", "total"} <= set(follows.columns)
    assert set(follows.query("parameter == 'mAs'")["feature"]) == set(follows["feature"])


def test_a_second_run_writes_the_same_tables_and_pictures(result, tmp_path):
    for name in (
        "features.csv",
        "features_response_curves_80.csv",
        "features_sensitivity_pairs_80.csv",
        "features_sobol_samples_80.csv",
    ):
        (tmp_path / name).write_bytes((result.report.parent / name).read_bytes())
    again = study.run(
        COHORT.manifest,
        COHORT.load,
        [TEMPLATE],
        LIGHT,
        Path(tmp_path),
        designed=make_designed_manifests(),
        execution=Execution(),
    )
    for name in ("breakpoints", "curve_dose", "sobol_indices", "feature_parameter_correlations"):
        assert again.tables[name].read_bytes() == result.tables[name].read_bytes()
    assert again.pictures["curve_dose"].read_bytes() == result.pictures["curve_dose"].read_bytes()


@pytest.mark.parametrize("sizes", [{"sobol_samples": 3}, {"curve_knees": 2}, {"sensitivity_knees": 1}])
def test_invalid_design_sizes_are_rejected_before_any_file_is_written(tmp_path, sizes):
    with pytest.raises(InputError, match=f"{next(iter(sizes))} must be"):
        make_experiment(tmp_path / "out", Execution(), {"preset": "quick", "engine": "scanline"} | sizes)
    assert not (tmp_path / "out").exists()
