"""Verify the files of a data set against the hashes in its records."""

from pathlib import Path
from typing import Any

from ..core.checks import InputError
from ..data.user_files import read_json
from ..io.cohort_records import hash_file
from ..io.dataset_files import SETTINGS_FILE, list_faults, read_part
from .dataset_plan import count_parts
from .dataset_settings import DatasetSettings, read_settings


def verify_dataset(folder: str | Path) -> tuple[int, list[str]]:
    """Verify that a data set is complete and that its files are unchanged.

    Parameters
    ----------
    folder : str or Path
        Folder of the data set.

    Returns
    -------
    images : int
        Number of images in finished parts.
    faults : list of str
        One line for each missing or changed file and each unfinished part.

    Raises
    ------
    InputError
        If the folder contains no data set, or a record is damaged.
    """
    folder = Path(folder)
    settings = read_dataset_settings(folder)
    claim = hash_file(folder / SETTINGS_FILE)
    images, faults = 0, list[str]()
    for index in range(count_parts(settings)):
        record = read_part(folder, index, claim)
        if record is None:
            faults.append(f"part {index}: not finished")
        else:
            images += len(record.rows)
            faults += list_faults(folder, record)
    if not (folder / "index.csv").exists():
        faults.append("index.csv: missing")
    return images, faults


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
    if not (folder / SETTINGS_FILE).exists():
        raise InputError(f"folder must contain a data set made by pssf dataset, got {folder} without {SETTINGS_FILE}")
    specified: dict[str, Any] = read_json(folder / SETTINGS_FILE, dict[str, Any])
    return read_settings(specified.get("settings"), folder / SETTINGS_FILE)
