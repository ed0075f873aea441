"""Read the file that specifies an existing data set."""

from pathlib import Path
from typing import Any

from ..core.checks import InputError
from ..data.user_files import read_json
from ..io.dataset_files import SETTINGS_FILE
from .dataset_settings import DatasetSettings


def read_dataset_settings(folder: Path) -> DatasetSettings:
    """Read the settings of a data set from its folder.

    Parameters
    ----------
    folder : Path
        Folder of the data set.

    Returns
    -------
    DatasetSettings
        Settings.

    Raises
    ------
    InputError
        If the folder contains no data set, or the file is damaged.
    """
    path = folder / SETTINGS_FILE
    table: Any = _read_specification(folder).get("settings")
    try:
        values: dict[str, Any] = {name: tuple(of) if isinstance(of, list) else of for name, of in table.items()}
        return DatasetSettings(**values)
    except (AttributeError, TypeError) as error:
        raise InputError(
            f"file {path} must contain valid settings of a data set, got an unknown or missing entry: {error}"
        ) from None


def read_label_map(folder: Path) -> dict[str, int]:
    """Read the values of the label map from the folder of a data set.

    Parameters
    ----------
    folder : Path
        Folder of the data set.

    Returns
    -------
    dict of str to int
        Value of each class.

    Raises
    ------
    InputError
        If the folder contains no data set, or the file is damaged.
    """
    values = _read_specification(folder).get("label_map")
    if not isinstance(values, dict) or not all(isinstance(value, int) for value in values.values()):
        raise InputError(f"file {folder / SETTINGS_FILE} must contain the values of the label map, got {values!r}")
    return dict(values)


def _read_specification(folder: Path) -> dict[str, Any]:
    """Read the file that specifies a data set."""
    if not (folder / SETTINGS_FILE).exists():
        raise InputError(f"folder must contain a data set made by pssf dataset, got {folder} without {SETTINGS_FILE}")
    specified: dict[str, Any] = read_json(folder / SETTINGS_FILE, dict[str, Any])
    return specified
