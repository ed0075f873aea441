"""The whole study, from a manifest to a report."""

import hashlib
import re
from functools import cache

import numpy as np
import pandas as pd
import pytest
from made_up import PROTOCOLS
from numpy.testing import assert_allclose
from scipy.ndimage import gaussian_filter

from pssf import study
from pssf.core.checks import InputError
from pssf.core.execution import Execution
from pssf.data.readmes import readmes
from pssf.experiment import SHOWN, shown_rows
from pssf.io.readme import open_checkout
from pssf.io.results import load_table
from pssf.radiomics.patches import Template
from pssf.radiomics.table import TEXT
from pssf.study import StudySettings
from pssf.study.learn.saving import loads

SIZE, PIXEL_MM = 256, 0.6


def draw(grade: int, row: float, col: float, side: str, coarse: float, gain: float, seed: int) -> np.ndarray:
    """(256, 256) uint16: a limb with two blocks of bone; with the grade the gap narrows and the texture coarsens."""
    rng = np.random.default_rng(seed)
    rows, cols = np.mgrid[:SIZE, :SIZE].astype(float)
    medial = (cols - col) * (1 if side == "right" else -1) * PIXEL_MM
    up = (row - rows) * PIXEL_MM
    limb = np.clip(1 - ((medial + 20) / 62) ** 2, 0, None)
    bone = (np.abs(medial + 20) < 37 - 0.12 * np.abs(up)) & (np.abs(up) > 3.0 - 0.5 * grade + 0.08 * np.abs(medial))
    notch = (np.abs(medial + 20) < 7) & (up > 0) & (up < 16)
    field = gaussian_filter(rng.standard_normal((SIZE, SIZE)), coarse + 0.6 * grade)
    inside = gaussian_filter((bone & ~notch).astype(float), 0.8)
    signal = gain * np.exp(-2.2 * limb - inside * (0.7 + 0.05 * field / field.std()))
    signal += np.sqrt(signal) * rng.standard_normal(signal.shape)
    return np.clip(np.rint(signal), 1, 65535).astype(np.uint16)


class Cohort:
    """A manifest of 3 x `per_grade` subjects under three protocols, and pixels that are drawn when asked for."""

    def __init__(self, per_grade: int) -> None:
        rng = np.random.default_rng(11)
        self.rows = []
        for subject in range(3 * per_grade):
            place = {"side": ["right", "left"][subject % 2], "subject": subject, "knee": subject, "grade": subject % 3}
            row, col = rng.uniform(115, 140), rng.uniform(115, 140)
            for protocol in PROTOCOLS:
                name = f"s{subject:03d}_{protocol}"
                truth = {"truth_medial_row_px": row, "truth_medial_col_px": col, "pixel_mm": PIXEL_MM}
                file = {"radiograph": name, "file": name, "sha256": hashlib.sha256(name.encode()).hexdigest()}
                self.rows.append(place | truth | file | {"protocol": protocol, "sdd_mm": 1150.0, "sod_mm": 950.0})
        self.manifest = pd.DataFrame(self.rows)

    def retest(self, knees: int) -> pd.DataFrame:
        """The first knees taken twice more with other noise, and twice with other noise and a little further left."""
        rows = []
        for row in [row for row in self.rows if row["protocol"] == "reference"][:knees]:
            for place, (kind, turn) in enumerate((k, t) for k in ("noise", "perturbation") for t in ("1", "2")):
                name = f"{row['radiograph']}_{kind}{turn}"
                file = {"radiograph": name, "file": name, "sha256": hashlib.sha256(name.encode()).hexdigest()}
                moved = {"truth_medial_col_px": row["truth_medial_col_px"] - 0.4 * (kind == "perturbation")}
                rows.append(
                    row | file | moved | {"kind": kind, "turn": turn, "draw": 10_000 + 10 * row["knee"] + place}
                )
        self.rows += [row for row in rows if row["radiograph"] not in {known["radiograph"] for known in self.rows}]
        return pd.DataFrame(rows)

    def load(self, file: str) -> np.ndarray:
        row = next(row for row in self.rows if row["file"] == file)
        gain = {"reference": 30000, "low_dose": 6000, "geometry_shift": 25000}[row["protocol"]]
        at = row["truth_medial_row_px"], row["truth_medial_col_px"]
        seed = row.get("draw", 100 * row["subject"] + PROTOCOLS.index(row["protocol"]))
        return draw(row["grade"], *at, row["side"], 1.0, gain, seed)


TEMPLATE = Template(pixels=draw(0, 128, 140, "right", 3.0, 60000, 0), row=128, col=140, pixel_mm=PIXEL_MM)
SMALL = StudySettings(region_px=80, bins=32, repeats=2, replicates=200, selections=("l1",), models=("lr", "rf"))


@cache
def cohort() -> Cohort:
    return Cohort(5)


@pytest.fixture(scope="module")
def result(tmp_path_factory) -> study.StudyResult:
    out = tmp_path_factory.mktemp("study")
    execution = Execution()
    with execution.stage("cohort", "radiographs", 45) as stage:
        stage.advance(45)
    retest = cohort().retest(3)
    return study.run(cohort().manifest, cohort().load, [TEMPLATE], SMALL, out, retest=retest, execution=execution)


def test_a_study_finds_the_regions_and_tells_the_grades_apart(result):
    everything = result.localisation.iloc[-1]
    assert everything["radiographs"] == 45
    assert everything["refused"] == everything["leaves_image"] == everything["gross"] == 0
    assert everything["mean_px"] < 2
    scores = result.scores
    within = scores[(scores["task"] == "0 vs 2") & (scores["scenario"] == "within")]
    assert within["auc"].max() > 0.8
    assert list(result.seconds) == [
        "cohort",
        "regions and features",
        "training and testing",
        "intervals and differences",
        "reliability and figures",
        "claims",
    ]


def test_the_readme_of_a_checkout_takes_what_a_study_found(result, tmp_path):
    names = [name for source in SHOWN for name in readmes().shown(source)]
    (tmp_path / "README.md").write_text("".join(f"<!-- table: {name} -->\n<!-- /table -->\n" for name in names))
    checkout = open_checkout(tmp_path, SHOWN, preset="mine")
    written = checkout.take(shown_rows(result), result.pictures.values(), measured_with=result.report)
    assert [path.name for path in written] == ["README.md", "robustness.png", "stability.png"]
    text = written[0].read_text()
    assert text.count("`uv run pssf study --preset mine`") == len(names)
    within = result.scores.query("task == '0 vs 2' and scenario == 'within' and model == 'lr'").iloc[0]
    line = next(line for line in text.splitlines() if line.startswith("| 0 vs 2 | reference, reference | "))
    assert line.split(" | ")[2].startswith(f"{within['auc']:.2f} (")
    assert "| cohort | " in text
    assert "| A subset of features is stable | " in text


def test_the_report_is_one_page_with_everything_in_it(result):
    page = result.report.read_text(encoding="utf-8")
    for target in re.findall(r"(?:src|href)=(\S{30}|\S+)", page):
        assert target.startswith(('"data:image/png;base64,', '"#')), target
    assert not re.search(r"<script|<link|@import|url\(|https?://", page)
    pictures = re.findall(r"<img[^>]*>", page)
    assert len(pictures) == len(result.pictures) == 7
    assert all(re.search(r'alt="[^"]{20,}"', picture) for picture in pictures)
    assert "43 of 107" in page
    for path in [*result.pictures.values(), *result.tables.values()]:
        assert path.stat().st_size > 0
    assert not [path for path in result.report.parent.rglob("*") if path.name.startswith(".")]


def test_a_second_run_measures_nothing_again_and_writes_the_same_bytes(result, tmp_path):
    (tmp_path / "features.csv").write_bytes(result.tables["features"].read_bytes())
    asked: list[str] = []

    def load(file: str) -> np.ndarray:
        asked.append(file)
        return cohort().load(file)

    again = study.run(cohort().manifest, load, [TEMPLATE], SMALL, tmp_path, retest=cohort().retest(3))
    assert len(asked) == 9  # the panel's
    for name, path in result.tables.items():
        assert again.tables[name].read_bytes() == path.read_bytes(), name
    for name, path in result.pictures.items():
        assert again.pictures[name].read_bytes() == path.read_bytes(), name
    for name, path in result.models.items():
        assert again.models[name].read_bytes() == path.read_bytes(), name


def test_a_row_of_features_that_was_changed_by_hand_is_measured_again(result, tmp_path):
    lines = result.tables["features"].read_text(encoding="utf-8").splitlines(keepends=True)
    head, row = lines[0].split(","), lines[2].split(",")
    row[head.index("glcm_Contrast")] = "1.5"
    (tmp_path / "features.csv").write_text("".join([*lines[:2], ",".join(row), *lines[3:]]), encoding="utf-8")
    asked: list[str] = []

    def load(file: str) -> np.ndarray:
        asked.append(file)
        return cohort().load(file)

    path = study.measure(cohort().manifest, load, [TEMPLATE], SMALL, tmp_path, retest=cohort().retest(3))
    assert len(asked) == 1
    assert path.read_text(encoding="utf-8") == "".join(lines)


def test_repeats_have_their_own_reliability_and_no_part_in_training_or_localisation(result):
    across = result.reliability.groupby("across")["knees"].max()
    assert across["repeated noise"] == across["small perturbations"] == 3
    assert across["all protocols"] == 15
    assert result.localisation.iloc[-1]["radiographs"] == 45
    tested = set(pd.read_csv(result.tables["predictions"])["radiograph"])
    assert not [name for name in tested if "noise" in name or "perturbation" in name]
    page = result.report.read_text(encoding="utf-8")
    assert "repeated noise" in page
    assert "are not in it" not in page


def test_a_model_on_disk_gives_the_probabilities_of_the_first_split(result):
    told = pd.read_csv(result.tables["predictions"]).query("task == '0 vs 2' and scenario == 'within' and repeat == 0")
    features = load_table(result.tables["features"], TEXT)
    features = features.set_index("radiograph")
    assert set(result.models) == {"lr_l1", "rf_l1"}
    for name, path in result.models.items():
        rows = told[told["model"] == name.split("_")[0]]
        model = loads(path.read_bytes())
        found = model.predict_proba(features.loc[rows["radiograph"], list(model[0].feature_names_in_)])
        assert_allclose(found[:, 1], rows["p1"], rtol=1e-12)


def test_repeats_that_cannot_serve_are_refused_by_name(tmp_path):
    manifest, retest = cohort().manifest, cohort().retest(2)
    for broken, told in (
        (retest.drop(columns="turn"), "turn"),
        (retest.assign(kind="shake"), "kind of repeat = 'shake'"),
        (retest.assign(radiograph=manifest["radiograph"].iloc[0]), "listed twice"),
    ):
        with pytest.raises(InputError, match=told):
            study.run(manifest, cohort().load, [TEMPLATE], SMALL, tmp_path, retest=broken)


def test_refused_regions_are_counted_and_left_out(tmp_path):
    manifest = cohort().manifest
    blank = set(manifest[manifest["subject"] == 14]["file"])

    def load(file: str) -> np.ndarray:
        if file in blank:
            return np.random.default_rng(0).integers(900, 1100, (SIZE, SIZE)).astype(np.uint16)
        return cohort().load(file)

    found = study.run(manifest, load, [TEMPLATE], SMALL, tmp_path)
    assert found.localisation.iloc[-1]["refused"] == 3
    assert "14" not in set(pd.read_csv(found.tables["predictions"])["subject"].astype(str))


def test_a_cohort_of_one_protocol_and_two_grades_has_a_report_too(tmp_path):
    manifest = cohort().manifest
    part = manifest[(manifest["protocol"] == "reference") & (manifest["grade"] != 1)]
    found = study.run(part, cohort().load, [TEMPLATE], SMALL, tmp_path)
    assert set(found.scores["scenario"]) == {"within"}
    assert found.reliability.empty
    page = found.report.read_text(encoding="utf-8")
    assert "nothing to compare" in page
    assert "no knees of all three grades" in page


def test_a_manifest_that_cannot_serve_is_refused_by_name(tmp_path):
    manifest = cohort().manifest
    for broken, told in (
        (manifest.drop(columns="sha256"), "sha256"),
        (manifest[manifest["protocol"] != "reference"], "reference"),
        (pd.concat([manifest, manifest.head(1)]), "listed twice"),
    ):
        with pytest.raises(InputError, match=told):
            study.run(broken, cohort().load, [TEMPLATE], SMALL, tmp_path)
