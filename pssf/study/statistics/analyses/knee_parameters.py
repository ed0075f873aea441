"""True parameters of every knee as numbers, for comparison with features."""

import json

import numpy as np
import pandas as pd
from scipy.stats import rankdata

from ....core.checks import Array
from ....data.knees.grade_records import RangeGradeTable, SeverityGradeTable
from ..features.degenerate_features import is_degenerate

# Parameters whose distributions depend on the KL-like grade: manifest column -> label.
GRADE_PARAMETERS = {
    "nominal_jsw_medial_mm": "nominal JSW medial, mm",
    "nominal_jsw_lateral_mm": "nominal JSW lateral, mm",
    "largest_osteophyte_mm": "largest osteophyte, mm",
    "osteophyte_count": "osteophyte count",
    "subchondral_plate": "subchondral bone plate, relative",
    "varus_deg": "varus, deg",
}
# Other parameters of knee and subject: manifest column -> label.
SUBJECT_PARAMETERS = {
    "age_years": "age, years",
    "bone_density": "bone density, relative",
    "stature_mm": "stature, mm",
    "bone_scale": "bone scale",
    "cortex_scale": "cortex scale",
    "bmi": "BMI, kg/m2",
    "limb_ap_mm": "limb AP thickness, mm",
    "fat_mm": "subcutaneous fat, mm",
    "tibial_slope_deg": "tibial slope, deg",
    "flexion_deg": "flexion, deg",
    "rotation_deg": "rotation, deg",
    "female": "women (fraction)",
}
PARAMETERS = GRADE_PARAMETERS | SUBJECT_PARAMETERS


def add_sex_indicator(table: pd.DataFrame) -> pd.DataFrame:
    """Add the column ``female`` (0 or 1) to a table that has a column ``sex``.

    Parameters
    ----------
    table : DataFrame
        Table of radiographs or knees.

    Returns
    -------
    DataFrame
        The table with the new column, or unchanged if it has no column ``sex``.
    """
    return table.assign(female=(table["sex"] == "female").astype(float)) if "sex" in table else table


def extract_knee_parameters(manifest: pd.DataFrame) -> pd.DataFrame:
    """Extract the true parameters of every knee.

    Parameters
    ----------
    manifest : DataFrame
        Manifest of the cohort.

    Returns
    -------
    DataFrame
        One row per knee: knee, subject, grade, and all `PARAMETERS` that can be derived from the manifest.
    """
    knees = add_sex_indicator(manifest).drop_duplicates("knee").reset_index(drop=True)
    if "osteophytes" in knees:
        sizes = knees["osteophytes"].map(lambda text: [float(one["size_mm"]) for one in json.loads(text)])
        knees = knees.assign(
            largest_osteophyte_mm=sizes.map(lambda of_knee: max(of_knee, default=0.0)), osteophyte_count=sizes.map(len)
        )
    return knees[["knee", "subject", "grade", *(name for name in PARAMETERS if name in knees)]]


def summarise_composition(table: pd.DataFrame) -> pd.DataFrame:
    """Count subjects, knees and radiographs by grade.

    Parameters
    ----------
    table : DataFrame
        One row per radiograph: subject, knee, grade, protocol.

    Returns
    -------
    DataFrame
        Columns: grade, subjects, knees, radiographs, protocols (number and names). The last row
        is the total.
    """
    counted = {"subjects": ("subject", "nunique"), "knees": ("knee", "nunique"), "radiographs": ("knee", "size")}
    rows = table.assign(grade=table["grade"].astype(str)).groupby("grade").agg(**counted).reset_index()
    total = {"grade": "Total", "subjects": table["subject"].nunique(), "knees": table["knee"].nunique()}
    counts = pd.concat([rows, pd.DataFrame([{**total, "radiographs": len(table)}])], ignore_index=True)
    names = [str(name).replace("_", " ") for name in table["protocol"].unique()]
    return counts.assign(protocols=f"{len(names)} ({', '.join(names)})")


def summarise_morphology(parameters: pd.DataFrame, table: RangeGradeTable | SeverityGradeTable | None) -> pd.DataFrame:
    """Compare the allowed range of each parameter with the sampled values for each grade.

    Parameters
    ----------
    parameters : DataFrame
        Table from `extract_knee_parameters`.
    table : RangeGradeTable or SeverityGradeTable or None
        Grade table from which the knees were sampled; None if unknown.

    Returns
    -------
    DataFrame
        Columns: parameter, grade, range_low, range_high (allowed range; NaN if the table defines none), minimum, mean,
        maximum (sampled values).
    """
    ranges, rows = table.grade if isinstance(table, RangeGradeTable) else {}, []
    for name, label in PARAMETERS.items():
        if name not in parameters:
            continue
        for grade, part in parameters.groupby("grade"):
            low, high = getattr(ranges.get(str(grade)), name.removeprefix("nominal_"), (np.nan, np.nan))
            drawn = {"minimum": part[name].min(), "mean": part[name].mean(), "maximum": part[name].max()}
            rows.append({"parameter": label, "grade": int(grade), "range_low": low, "range_high": high, **drawn})
    columns = ["parameter", "grade", "range_low", "range_high", "minimum", "mean", "maximum"]
    return pd.DataFrame(rows, columns=columns)


def correlate_with_parameters(
    usable: pd.DataFrame, names: list[str], parameters: pd.DataFrame, reference: str
) -> pd.DataFrame:
    """Correlate every feature with every parameter under the reference protocol (Spearman's rho).

    Parameters
    ----------
    usable : DataFrame
        Radiographs with a located region: knee, protocol and features.
    names : list of str
        Names of the features.
    parameters : DataFrame
        Table from `extract_knee_parameters`.
    reference : str
        Reference protocol.

    Returns
    -------
    DataFrame
        One row per feature and parameter: feature, parameter, rho, and rho_within (correlation of ranks centred within
        each grade); NaN if feature or parameter does not vary.
    """
    columns = [name for name in PARAMETERS if name in parameters]
    part = usable[usable["protocol"] == reference][["knee", *names]].merge(parameters, on="knee", how="left")
    ours, theirs = _compute_centred_ranks(part, names), _compute_centred_ranks(part, columns)
    rho = _correlate_columns(ours, theirs)
    within = _correlate_columns(*(_centre_within_grade(one, part["grade"]) for one in (ours, theirs)))
    rows = [
        {"feature": feature, "parameter": PARAMETERS[column], "rho": rho[i, j], "rho_within": within[i, j]}
        for i, feature in enumerate(names)
        for j, column in enumerate(columns)
    ]
    return pd.DataFrame(rows, columns=["feature", "parameter", "rho", "rho_within"])


def _correlate_columns(feature_ranks: Array, parameter_ranks: Array) -> Array:
    """Correlate the columns of two arrays whose columns have mean 0; return a (features, parameters) array."""
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.asarray(
            feature_ranks.T
            @ parameter_ranks
            / np.sqrt((feature_ranks**2).sum(axis=0)[:, None] * (parameter_ranks**2).sum(axis=0))
        )


def _centre_within_grade(ranks: Array, grades: pd.Series) -> Array:
    """Centre the ranks (rows, columns) within each grade."""
    # Rounding removes numerical noise, so a parameter that depends only on grade has no variance within a grade.
    return np.round(ranks - pd.DataFrame(ranks).groupby(grades.to_numpy()).transform("mean").to_numpy(), 9)


def select_strongest_correlations(table: pd.DataFrame) -> pd.DataFrame:
    """For each feature, select the parameter with the strongest correlation.

    Parameters
    ----------
    table : DataFrame
        Table from `correlate_with_parameters`.

    Returns
    -------
    DataFrame
        One row per feature: feature, parameter, rho.
    """
    known = table.dropna(subset="rho")
    best = known.assign(size=known["rho"].abs()).sort_values("size", ascending=False, kind="stable")
    return best.drop_duplicates("feature").drop(columns="size").reset_index(drop=True)


def _compute_centred_ranks(table: pd.DataFrame, names: list[str]) -> Array:
    """Compute centred ranks (rows, names); the ranks of a column are 0 if it is constant or has a missing value."""
    if not names or table.empty:
        return np.zeros((len(table), len(names)))
    columns = [table[name].to_numpy(np.float64) for name in names]
    return np.column_stack(
        [np.zeros(len(one)) if is_degenerate(one) else rankdata(one) - (len(one) + 1) / 2 for one in columns]
    )
