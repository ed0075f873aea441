"""Check the parameters of simulated knees and their correlation with measured features."""

import json

import numpy as np
import pandas as pd
import pytest
from scipy.stats import spearmanr

from pssf.data.knees.grade_tables import load_grade_table
from pssf.io.cohort_records import read_manifest
from pssf.study.design.study_tables import resolve_sampling_laws
from pssf.study.statistics.analyses.knee_parameters import (
    correlate_with_parameters,
    extract_knee_parameters,
    select_strongest_correlations,
    summarise_composition,
    summarise_morphology,
)


def make_manifest() -> pd.DataFrame:
    rows = []
    for knee in range(12):
        beaks = [{"site": "medial_tibia", "size_mm": 0.5 * k} for k in range(knee % 4)]
        for protocol in ("reference", "low_dose"):
            row = {"radiograph": f"{knee}_{protocol}", "subject": knee // 2, "knee": knee, "grade": knee // 4}
            row |= {
                "protocol": protocol,
                "sex": "female" if knee % 3 else "male",
                "nominal_jsw_medial_mm": 5.5 - 0.1 * knee,
            }
            rows.append(row | {"osteophytes": json.dumps(beaks), "age_years": 50.0 + knee})
    return pd.DataFrame(rows)


def test_parameters_have_one_row_per_knee_with_osteophyte_size_and_count():
    found = extract_knee_parameters(make_manifest())
    assert len(found) == 12
    assert found["osteophyte_count"].tolist() == [0, 1, 2, 3] * 3
    assert found["largest_osteophyte_mm"].tolist() == [0.0, 0.0, 0.5, 1.0] * 3
    assert found["female"].sum() == 8
    assert "varus_deg" not in found


def test_morphology_is_listed_with_the_range_of_its_grade():
    table = summarise_morphology(extract_knee_parameters(make_manifest()), load_grade_table("paper")).set_index(
        ["parameter", "grade"]
    )
    space = table.loc[("nominal JSW medial, mm", 1)]
    assert (space["range_low"], space["range_high"]) == (3.5, 5.0)
    assert (space["minimum"], space["mean"], space["maximum"]) == pytest.approx((4.8, 4.95, 5.1))
    assert np.isnan(table.loc[("age, years", 0), "range_low"])


def test_a_feature_correlates_with_its_simulated_parameter():
    knees, rng = make_manifest(), np.random.default_rng(0)
    features = {"glcm_a": -knees["nominal_jsw_medial_mm"], "glcm_b": rng.normal(size=len(knees)), "glcm_c": 1.0}
    usable = knees[["knee", "grade", "protocol"]].assign(**features)
    table = correlate_with_parameters(usable, list(features), extract_knee_parameters(knees), "reference")
    first = usable[usable["protocol"] == "reference"]
    for name in ("glcm_a", "glcm_b"):
        for column, label in (("age_years", "age, years"), ("nominal_jsw_medial_mm", "nominal JSW medial, mm")):
            known = extract_knee_parameters(knees)[column]
            rho = table[(table["feature"] == name) & (table["parameter"] == label)]["rho"].item()
            assert rho == pytest.approx(spearmanr(first[name], known).statistic, abs=1e-12)
    assert table.query("feature == 'glcm_c'")["rho"].isna().all()
    best = select_strongest_correlations(table).set_index("feature")
    assert best.loc["glcm_a", "parameter"] == "nominal JSW medial, mm"
    assert best.loc["glcm_a", "rho"] == pytest.approx(-1)
    assert "glcm_c" not in best.index


def test_the_cohort_is_counted_per_grade_and_in_total():
    found = summarise_composition(make_manifest())
    assert found["grade"].tolist() == ["0", "1", "2", "Total"]
    assert found["knees"].tolist() == [4, 4, 4, 12]
    assert found["subjects"].tolist() == [2, 2, 2, 6]
    assert found["radiographs"].tolist() == [8, 8, 8, 24]
    assert set(found["protocols"]) == {"2 (reference, low dose)"}


def test_parameter_ranges_come_from_the_grade_table_of_the_manifest():
    knees = make_manifest().assign(grade_table="paper")
    laws = resolve_sampling_laws(knees)
    assert laws.grades == load_grade_table("paper")
    assert summarise_morphology(extract_knee_parameters(knees), laws.grades)["range_low"].notna().any()
    for other in (
        make_manifest(),
        knees.assign(grade_table="gone.toml"),
        knees.assign(grade_table=["paper", "population"] * 12),
    ):
        assert resolve_sampling_laws(other) is None
    assert summarise_morphology(extract_knee_parameters(knees), None)["range_low"].isna().all()
    assert (
        summarise_morphology(extract_knee_parameters(knees), load_grade_table("population"))["range_low"].isna().all()
    )


@pytest.mark.filterwarnings("error")
def test_a_manifest_with_many_columns_is_read_without_a_warning(tmp_path):
    rows = pd.DataFrame({f"truth_{k}": [1.5, 2.5] for k in range(150)})
    rows.assign(knee=[0, 1], subject=[0, 1], grade=[0, 2], sex=["female", "male"]).to_csv(
        tmp_path / "m.csv", index=False
    )
    assert extract_knee_parameters(read_manifest(tmp_path / "m.csv"))["female"].tolist() == [1.0, 0.0]
