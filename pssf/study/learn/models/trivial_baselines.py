"""Baselines that an image model must outperform: chance, age, sex and stature, and JSW alone.

JSW is the nominal value of the simulated knee, without the measurement error of a reader. JSW is also one of the
grading criteria. The JSW baseline is therefore an upper reference and not a fair comparison.
"""

import pandas as pd

# Manifest columns that the baselines use; a baseline with missing columns is omitted.
BASELINE_MANIFEST_COLUMNS = ("sex", "age_years", "stature_mm", "nominal_jsw_medial_mm")
# Predictor columns of each baseline.
_BASELINE_PREDICTORS = {"body": ("age_years", "female", "stature_mm"), "jsw": ("nominal_jsw_medial_mm",)}


def find_baselines(table: pd.DataFrame, features: list[str]) -> dict[str, tuple[str, list[str]]]:
    """Find the baselines for which a table contains all columns.

    Parameters
    ----------
    table : DataFrame
        Radiographs, with the column ``female`` from `knee_parameters.add_sex_indicator`.
    features : list of str
        Names of the image features. The chance baseline uses the first feature as a placeholder and ignores its values.

    Returns
    -------
    dict of str to tuple
        Classifier and columns of each baseline, keyed by baseline name.
    """
    baselines = {"chance": ("chance", features[:1])}
    for name, columns in _BASELINE_PREDICTORS.items():
        if set(columns) <= set(table.columns):
            baselines[name] = ("lr", list(columns))
    return baselines


def find_baseline_columns(table: pd.DataFrame) -> list[str]:
    """Find the table columns that the baselines use as predictors.

    Parameters
    ----------
    table : DataFrame
        Table of radiographs.

    Returns
    -------
    list of str
        Names of all predictor columns of the baselines.
    """
    return [name for columns in _BASELINE_PREDICTORS.values() for name in columns if name in table.columns]
