"""Features and class indices of radiographs, in the format for classifiers."""

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from ...design.classification_tasks import Classes
from ...predictions import find_class_indices

# Features (rows, features) and class indices (rows,).
LabelledFeatures = tuple[pd.DataFrame, NDArray[np.int64]]


def make_labelled_features(table: pd.DataFrame, names: list[str], classes: Classes) -> LabelledFeatures:
    """Extract the features and class indices of radiographs.

    Parameters
    ----------
    table : DataFrame
        Radiographs with columns for grade and features.
    names : list of str
        Names of the features.
    classes : tuple of tuple of int
        Grades in each class.

    Returns
    -------
    features : DataFrame
        Features (rows, features).
    truth : (rows,) int64 array
        Class index of each row.
    """
    return table[names], find_class_indices(table["grade"].to_numpy(), classes)
