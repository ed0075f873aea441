"""What a model of the image must do better than: chance, who the subject is, and the joint space width alone.

The joint space width is the nominal one, which the knee was specified with. A reader would measure it with an error,
and it is part of what defines a grade here. It is therefore an upper reference and no fair competitor.
"""

import pandas as pd

# Columns of the manifest that a baseline may use; a manifest that lacks them goes without it.
SOURCES = ("sex", "age_years", "stature_mm", "nominal_jsw_medial_mm")
_MEASURES = {"body": ("age_years", "female", "stature_mm"), "jsw": ("nominal_jsw_medial_mm",)}


def baselines_of(table: pd.DataFrame, features: list[str]) -> dict[str, tuple[str, list[str]]]:
    """Baseline -> classifier and its columns, of those whose columns the table of `parameters.with_measures` has.

    features  of the image, of which chance is shown one and uses none
    """
    baselines = {"chance": ("chance", features[:1])}
    for name, columns in _MEASURES.items():
        if set(columns) <= set(table.columns):
            baselines[name] = ("lr", list(columns))
    return baselines


def measures_of(table: pd.DataFrame) -> list[str]:
    """Columns of the table that any baseline reads."""
    return [name for columns in _MEASURES.values() for name in columns if name in table.columns]
