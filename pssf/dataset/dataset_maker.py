"""Make the images of a data set part by part, in local processes or on a cluster."""

from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import msgspec

from ..cohort.run_environment import CODE_PATHS, RunEnvironment, find_file_library_versions, require_same_environment
from ..core.checks import InputError, require_workers
from ..core.processes.parallel_map import count_cores, map_in_parallel, require_scheduler
from ..data.code_hash import compute_code_hashes, list_pixel_data_files
from ..io import dataset_files
from ..io.atomic_write import delete_stale_temporary_files
from ..io.cohort_records import claim_folder
from ..io.dataset_index_files import require_parquet
from ..model.protocol import protocol_to_dict
from ..simulation import collect_versions
from .dataset_index import write_description
from .dataset_plan import count_parts, find_part
from .dataset_settings import DatasetSettings
from .dataset_tables import DatasetTables, load_dataset_tables
from .sample_files import collect_labels, encode_sample
from .subject_samples import make_subject_samples

# Further code that affects the files of a data set: its own, and rates of progression for the second visit of a pair.
_OWN_CODE_PATHS = ("dataset", "data/progress.toml", "data/knees/progression_table.py")
# Number of parts whose files are checked together.
_PARTS_PER_BATCH = 10_000


def make_dataset(
    settings: DatasetSettings,
    folder: str | Path,
    *,
    workers: int | None = None,
    scheduler: str | None = None,
    progress: Callable[[int], None] = lambda made: None,
    on_kept: Callable[[int], None] = lambda stood: None,
) -> Path:
    """Make the missing images of a data set, and write its index.

    The same settings, code and library versions give byte-identical files for any number of workers.

    Parameters
    ----------
    settings : DatasetSettings
        Settings of the data set.
    folder : str or Path
        Output folder. Files from an earlier run are verified against their hashes and reused.
    workers : int, optional
        Number of local processes, 1 to 256. None starts one process per available core.
    scheduler : str, optional
        Address of a Dask scheduler, whose workers must access `folder` under the same path.
    progress : callable
        Function that is called after each finished part, with its number of images.
    on_kept : callable
        Function that is called for each part that an earlier run finished, with its number of images.

    Returns
    -------
    Path
        Path of the index, a CSV file with one row per image.

    Raises
    ------
    InputError
        If a table or protocol is unknown, the folder contains a different data set or a damaged file, the disk is not
        writable, or the scheduler cannot be reached.
    WorkersLostError
        If workers are killed repeatedly.
    """
    if settings.parquet:
        require_parquet()
    workers = count_cores() if workers is None else workers
    require_workers(workers, "processes")
    if scheduler is not None:
        require_scheduler(scheduler)
    folder, tables = Path(folder), load_dataset_tables(settings)
    versions = {**collect_versions(), **find_file_library_versions()}
    code = compute_code_hashes((*CODE_PATHS, *_OWN_CODE_PATHS, *list_pixel_data_files()))
    specified = {
        "settings": settings.to_dict(),
        "grade_table": msgspec.json.decode(msgspec.json.encode(tables.distributions.grades)),
        "protocols": [protocol_to_dict(protocol) for protocol in tables.protocols],
        "label_map": dict(tables.definitions.label_map),
        "versions": versions,
        "code": code,
    }
    claim = claim_folder(folder / dataset_files.SETTINGS_FILE, specified)
    _remove_temporary_files(folder)
    missing = _find_missing_parts(settings, folder, claim, workers, on_kept)
    site = RunEnvironment(
        folder=folder.absolute(),
        claim=dataset_files.SETTINGS_FILE,
        claim_sha256=claim,
        versions=versions,
        code_hashes=code,
    )
    shared = {"settings": settings, "tables": tables, "site": site}
    map_in_parallel(
        make_part,
        missing,
        shared=shared,
        workers=workers,
        scheduler=scheduler,
        on_result=lambda index, made: progress(made),
    )
    _remove_temporary_files(folder)
    return write_description(settings, tables, folder)


def make_part(index: int, settings: DatasetSettings, tables: DatasetTables, site: RunEnvironment) -> int:
    """Make and save the images of one part, then write its record.

    Parameters
    ----------
    index : int
        Index of the part.
    settings : DatasetSettings
        Settings of the data set.
    tables : DatasetTables
        Tables and protocols.
    site : RunEnvironment
        Folder, library versions and code hashes that the worker must match.

    Returns
    -------
    int
        Number of images.

    Raises
    ------
    InputError
        If the folder, a library version or the code differs from that on the machine that started the run.
    """
    require_same_environment(site)
    part, rows = find_part(settings, index), list[dict[str, Any]]()

    def make_files() -> Iterator[tuple[str, bytes]]:
        """Yield the files of all images of the part, and collect the rows of the index."""
        for subject in range(part.first, part.first + part.count):
            for sample in make_subject_samples(settings, tables, subject, part.split):
                rows.append(collect_labels(sample))
                yield from encode_sample(sample, settings, tables)

    if settings.layout == "shards":
        name = f"{part.split}/{part.split}-{part.split_index:06d}.tar"
        hashes = dataset_files.write_shard(site.folder, name, make_files())
        rows = [{**row, "file": name} for row in rows]
    else:
        hashes = dataset_files.write_files(site.folder, make_files())
    record = dataset_files.PartRecord(rows=rows, files=hashes, settings_sha256=site.claim_sha256)
    dataset_files.write_part_record(site.folder, index, record)
    return len(rows)


def _find_missing_parts(
    settings: DatasetSettings, folder: Path, claim: str, workers: int, on_kept: Callable[[int], None]
) -> list[int]:
    """List the parts that are not finished; raise InputError if a finished part is damaged."""

    def check_part(index: int) -> int | None:
        """Return the number of images of a finished part, or None."""
        record = dataset_files.read_part(folder, index, claim)
        if record is None:
            return None
        faults = dict(dataset_files.iterate_faults(folder, record))
        changed = next((name for name, fault in faults.items() if fault == dataset_files.CHANGED), None)
        if changed is not None:
            hint = f"delete {dataset_files.record_path(folder, index)} to make its part again"
            raise InputError(f"file {folder / changed} must be unchanged, got other content; {hint}")
        return None if faults else len(record.rows)

    missing = list[int]()
    with ThreadPoolExecutor(workers) as pool:
        # The parts of a large data set are checked in batches, because the pool holds all submitted calls in memory.
        for first in range(0, count_parts(settings), _PARTS_PER_BATCH):
            batch = range(first, min(first + _PARTS_PER_BATCH, count_parts(settings)))
            for index, kept in zip(batch, pool.map(check_part, batch), strict=True):
                if kept is None:
                    missing.append(index)
                else:
                    on_kept(kept)
    return missing


def _remove_temporary_files(folder: Path) -> None:
    """Delete temporary files of interrupted runs."""
    for path in (folder, folder / "records", *folder.glob("*/"), *folder.glob("*/*/")):
        delete_stale_temporary_files(path)
