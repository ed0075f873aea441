"""What every knee was built with, as numbers: the truth that features can be held against."""

import json

import numpy as np
import pandas as pd
from scipy.stats import rankdata

from ...core.checks import Array
from ...data.grades import RangeGrades, SeverityGrades
from .degenerate import is_degenerate

# Column -> what it is; the first six are those that a KL-like grade is drawn by.
GRADED = {
    "nominal_jsw_medial_mm": "nominal JSW medial, mm",
    "nominal_jsw_lateral_mm": "nominal JSW lateral, mm",
    "largest_osteophyte_mm": "largest osteophyte, mm",
    "osteophyte_count": "osteophyte count",
    "subchondral_plate": "subchondral plate, relative",
    "varus_deg": "varus, deg",
}
BODY = {
    "age_years": "age, years",
    "bone_density": "bone density, relative",
    "stature_mm": "stature, mm",
    "bone_scale": "bone scale",
    "cortex_scale": "cortex scale",
    "bmi": "BMI, kg/m2",
    "limb_ap_mm": "limb, mm",
    "fat_mm": "fat, mm",
    "tibial_slope_deg": "tibial slope, deg",
    "flexion_deg": "flexion, deg",
    "rotation_deg": "rotation, deg",
    "female": "women (share)",
}
PARAMETERS = GRADED | BODY


def with_measures(table: pd.DataFrame) -> pd.DataFrame:
    """The table with sex as a number, `female`, where it has a column `sex`."""
    return table.assign(female=(table["sex"] == "female").astype(float)) if "sex" in table else table


def parameters_of(manifest: pd.DataFrame) -> pd.DataFrame:
    """One row a knee: knee, subject, grade, and those of PARAMETERS that the manifest tells of."""
    knees = with_measures(manifest).drop_duplicates("knee").reset_index(drop=True)
    if "osteophytes" in knees:
        sizes = knees["osteophytes"].map(lambda text: [float(one["size_mm"]) for one in json.loads(text)])
        knees = knees.assign(
            largest_osteophyte_mm=sizes.map(lambda of_knee: max(of_knee, default=0.0)), osteophyte_count=sizes.map(len)
        )
    return knees[["knee", "subject", "grade", *(name for name in PARAMETERS if name in knees)]]


def composition(table: pd.DataFrame) -> pd.DataFrame:
    """grade, subjects, knees, protocols (how many and which), radiographs; the last row is of all."""
    counted = {"subjects": ("subject", "nunique"), "knees": ("knee", "nunique"), "radiographs": ("knee", "size")}
    rows = table.assign(grade=table["grade"].astype(str)).groupby("grade").agg(**counted).reset_index()
    total = {"grade": "Total", "subjects": table["subject"].nunique(), "knees": table["knee"].nunique()}
    counts = pd.concat([rows, pd.DataFrame([{**total, "radiographs": len(table)}])], ignore_index=True)
    names = [str(name).replace("_", " ") for name in table["protocol"].unique()]
    return counts.assign(protocols=f"{len(names)} ({', '.join(names)})")


def morphology(parameters: pd.DataFrame, table: RangeGrades | SeverityGrades | None) -> pd.DataFrame:
    """What a grade may be and what was drawn.

    parameters  of `parameters_of`
    table       of grades that they were drawn by, or None
    returns     parameter, grade, low, high (NaN where no range is set), least, mean, most
    """
    ranges, rows = table.grade if isinstance(table, RangeGrades) else {}, []
    for name, label in PARAMETERS.items():
        if name not in parameters:
            continue
        for grade, part in parameters.groupby("grade"):
            low, high = getattr(ranges.get(str(grade)), name.removeprefix("nominal_"), (np.nan, np.nan))
            drawn = {"least": part[name].min(), "mean": part[name].mean(), "most": part[name].max()}
            rows.append({"parameter": label, "grade": int(grade), "low": low, "high": high, **drawn})
    columns = ["parameter", "grade", "low", "high", "least", "mean", "most"]
    return pd.DataFrame(rows, columns=columns)


def follows(usable: pd.DataFrame, names: list[str], parameters: pd.DataFrame, reference: str) -> pd.DataFrame:
    """Spearman's rho of every feature with every parameter, under the reference protocol.

    returns  feature, parameter, rho, rho_within (of ranks about their grade's mean): a row a pair, NaN where either
             does not vary
    """
    columns = [name for name in PARAMETERS if name in parameters]
    part = usable[usable["protocol"] == reference][["knee", *names]].merge(parameters, on="knee", how="left")
    ours, theirs = _ranks(part, names), _ranks(part, columns)
    rho = _correlation(ours, theirs)
    within = _correlation(*(_about_grade(one, part["grade"]) for one in (ours, theirs)))
    rows = [
        {"feature": feature, "parameter": PARAMETERS[column], "rho": rho[i, j], "rho_within": within[i, j]}
        for i, feature in enumerate(names)
        for j, column in enumerate(columns)
    ]
    return pd.DataFrame(rows, columns=["feature", "parameter", "rho", "rho_within"])


def _correlation(ours: Array, theirs: Array) -> Array:
    """(features, parameters) of columns whose mean is 0"""
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.asarray(ours.T @ theirs / np.sqrt((ours**2).sum(axis=0)[:, None] * (theirs**2).sum(axis=0)))


def _about_grade(ranks: Array, grades: pd.Series) -> Array:
    # Rounded, so that what a grade decides alone does not vary within it.
    return np.round(ranks - pd.DataFrame(ranks).groupby(grades.to_numpy()).transform("mean").to_numpy(), 9)


def strongest(table: pd.DataFrame) -> pd.DataFrame:
    """Of `follows`, the parameter that each feature follows most: feature, parameter, rho."""
    known = table.dropna(subset="rho")
    best = known.assign(size=known["rho"].abs()).sort_values("size", ascending=False, kind="stable")
    return best.drop_duplicates("feature").drop(columns="size").reset_index(drop=True)


def _ranks(table: pd.DataFrame, names: list[str]) -> Array:
    """(rows, names) ranks less their mean; zeros for what does not vary or has a hole"""
    if not names or table.empty:
        return np.zeros((len(table), len(names)))
    columns = [table[name].to_numpy(np.float64) for name in names]
    return np.column_stack(
        [np.zeros(len(one)) if is_degenerate(one) else rankdata(one) - (len(one) + 1) / 2 for one in columns]
    )
