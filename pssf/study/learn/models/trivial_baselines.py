"""Baselines that an image model must outperform: chance, the subject's body, and JSW alone.

JSW is the nominal value with which the knee was specified. A reader would measure it with an error. It also defines
part of a grade, so it is an upper reference and not a fair competitor.
"""

import pandas as pd

# Columns of the manifest that baselines use; a baseline without its columns is left out.
BASELINE_MANIFEST_COLUMNS = ("sex", "age_years", "stature_mm", "nominal_jsw_medial_mm")
# Predictors of each baseline.
_BASELINE_PREDICTORS = {"body": ("age_years", "female", "stature_mm"), "jsw": ("nominal_jsw_medial_mm",)}


def find_baselines(table: pd.DataFrame, features: list[str]) -> dict[str, tuple[str, list[str]]]:
    """Find the baselines whose columns a table has.

    Parameters
    ----------
    table : DataFrame
        Radiographs, with the column ``female`` of `knee_parameters.add_sex_indicator`.
    features : list of str
        Names of the image features; chance is given one and ignores it.

    Returns
    -------
    dict of str to tuple
        Classifier and columns of each baseline.
    """
    baselines = {"chance": ("chance", features[:1])}
    for name, columns in _BASELINE_PREDICTORS.items():
        if set(columns) <= set(table.columns):
            baselines[name] = ("lr", list(columns))
    return baselines


def find_baseline_columns(table: pd.DataFrame) -> list[str]:
    """Find the columns of a table that any baseline uses.

    Parameters
    ----------
    table : DataFrame
        Radiographs.

    Returns
    -------
    list of str
        Names of the columns.
    """
    return [name for columns in _BASELINE_PREDICTORS.values() for name in columns if name in table.columns]
