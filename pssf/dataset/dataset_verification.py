"""Verify the files of a data set against the hashes in its records."""

from pathlib import Path

from ..io.cohort_records import hash_file
from ..io.dataset_files import (
    CROISSANT_FILE,
    DESCRIPTION,
    SETTINGS_FILE,
    iterate_faults,
    list_files,
    read_part,
    record_path,
)
from .dataset_plan import count_parts
from .dataset_specification import read_dataset_settings


def verify_dataset(folder: str | Path) -> tuple[int, list[str]]:
    """Verify that a data set is complete, that its files are unchanged, and that it contains no other files.

    Parameters
    ----------
    folder : str or Path
        Folder of the data set.

    Returns
    -------
    images : int
        Number of images in finished parts.
    faults : list of str
        One line for each missing, changed or extra file and each unfinished part.

    Raises
    ------
    InputError
        If the folder contains no data set, or a record is damaged.
    """
    folder = Path(folder)
    settings = read_dataset_settings(folder)
    claim = hash_file(folder / SETTINGS_FILE)
    images, faults, known = 0, list[str](), {SETTINGS_FILE, CROISSANT_FILE}
    # The last record lists the files that describe the complete data set.
    for index in (*range(count_parts(settings)), DESCRIPTION):
        record = read_part(folder, index, claim)
        if record is None:
            faults.append("index.csv: not finished" if index == DESCRIPTION else f"part {index}: not finished")
            continue
        images += len(record.rows)
        faults += [f"{name}: {fault}" for name, fault in iterate_faults(folder, record)]
        known |= {*record.files, record_path(folder, index).relative_to(folder).as_posix()}
    return images, [*faults, *(f"{name}: not part of the data set" for name in list_files(folder) if name not in known)]
