"""Write the files that describe a complete data set: index, COCO files, Croissant metadata and datasheet."""

import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from ..io.atomic_write import write_bytes
from ..io.cohort_records import hash_file, write_json
from ..io.dataset_files import (
    CROISSANT_FILE,
    DESCRIPTION,
    NO_LIMIT,
    SETTINGS_FILE,
    PartRecord,
    name_sample_file,
    read_part,
    read_sample_labels,
    write_part_record,
)
from ..io.dataset_index_files import (
    write_coco_file,
    write_index_table,
    write_parquet_table,
)
from .coco_instances import make_annotations, make_categories
from .dataset_croissant import build_croissant_metadata
from .dataset_plan import count_parts, find_part
from .dataset_settings import SPLITS, DatasetSettings
from .dataset_summary import summarise_index
from .dataset_tables import DatasetTables
from .datasheet import render_dataset_datasheet

Row = dict[str, Any]


def write_description(settings: DatasetSettings, tables: DatasetTables, folder: Path) -> Path:
    """Write index, Croissant metadata and datasheet; with single files, also one COCO file per subset with images.

    The parts are read one at a time.

    Parameters
    ----------
    settings : DatasetSettings
        Settings of the data set.
    tables : DatasetTables
        Tables and protocols.
    folder : Path
        Folder of the data set, with all parts.

    Returns
    -------
    Path
        Path of index.csv.

    Raises
    ------
    InputError
        The disk is full, or a file cannot be written.
    """
    # The columns are collected first, because images of different views have different landmarks.
    summary, path = summarise_index(_iterate_flat_rows(settings, folder)), folder / "index.csv"
    write_index_table(path, list(summary.columns), _iterate_flat_rows(settings, folder))
    names = [path.name, "datasheet.md"]
    if settings.parquet:
        names.append("index.parquet")
        write_parquet_table(folder / "index.parquet", summary.columns, _iterate_flat_rows(settings, folder))
    if settings.layout == "folder":
        with_images = {split for split, _ in summary.counts}
        for split in (split for split in SPLITS if split in with_images):
            names.append(f"coco_{split}.json")
            _write_coco(settings, tables, folder / names[-1], split, summary.landmarks)
    write_bytes(folder / "datasheet.md", render_dataset_datasheet(settings, tables, summary).encode())
    hashes = {name: hash_file(folder / name, max_bytes=NO_LIMIT) for name in names}
    # The publisher may have added a licence to an existing file.
    if not (folder / CROISSANT_FILE).exists():
        metadata = build_croissant_metadata(settings, summary, hashes[path.name], path.stat().st_size)
        write_json(folder / CROISSANT_FILE, metadata)
    claim = hash_file(folder / SETTINGS_FILE)
    write_part_record(folder, DESCRIPTION, PartRecord(rows=[], files=hashes, settings_sha256=claim))
    return path


def iterate_rows(settings: DatasetSettings, folder: Path, split: str | None = None) -> Iterator[Row]:
    """Yield the labels of all images, or those of a subset, in the order of the parts.

    Parameters
    ----------
    settings : DatasetSettings
        Settings of the data set.
    folder : Path
        Folder of the data set.
    split : str, optional
        Subset; None: all subsets.

    Yields
    ------
    dict of str to object
        Labels of an image.
    """
    for index in range(count_parts(settings)):
        if split not in (None, find_part(settings, index).split):
            continue
        record = read_part(folder, index)
        yield from record.rows if record else ()


def flatten_row(row: Mapping[str, Any], prefix: str = "") -> Row:
    """Flatten labels to one number or text per column.

    Parameters
    ----------
    row : mapping of str to object
        Labels of an image.
    prefix : str
        Prefix of the column names.

    Returns
    -------
    dict of str to object
        Values keyed by column. The names of nested labels are joined by an underscore. A landmark has two columns,
        which end in ``_row_px`` and ``_col_px``. Other lists are JSON text.
    """
    flat: Row = {}
    for name, value in row.items():
        if name == "landmarks_px":
            for place, (at_row, at_col) in value.items():
                flat |= {f"{place}_row_px": at_row, f"{place}_col_px": at_col}
        elif isinstance(value, Mapping):
            flat |= flatten_row(value, f"{prefix}{name}_")
        else:
            flat[f"{prefix}{name}"] = json.dumps(value) if isinstance(value, list) else value
    return flat


def _iterate_flat_rows(settings: DatasetSettings, folder: Path) -> Iterator[Row]:
    """Yield the flat labels of all images."""
    return (flatten_row(row) for row in iterate_rows(settings, folder))


def _write_coco(settings: DatasetSettings, tables: DatasetTables, path: Path, split: str, keypoints: list[str]) -> None:
    """Write the COCO file of a subset image by image."""
    folder, kind = path.parent, "display" if "display" in settings.kinds else "linear"
    images = (
        {
            "id": image_id,
            "file_name": name_sample_file(split, kind, row["name"]),
            "height": row["rows"],
            "width": row["cols"],
        }
        for image_id, row in enumerate(iterate_rows(settings, folder, split), start=1)
    )
    write_coco_file(
        path,
        info={"description": "Knee radiographs simulated by pssf; labels are true by construction."},
        categories=make_categories(tables.definitions.label_map, keypoints),
        images=images,
        annotations=_iterate_annotations(settings, folder, split, keypoints),
    )


def _iterate_annotations(settings: DatasetSettings, folder: Path, split: str, keypoints: list[str]) -> Iterator[Row]:
    """Yield the COCO annotations of a subset with their numbers."""
    number = 1
    for image_id, row in enumerate(iterate_rows(settings, folder, split), start=1):
        entry = read_sample_labels(folder, split, row["name"])
        for annotation in make_annotations(entry, keypoints, image_id, number):
            yield annotation
            number += 1
