"""Encode the files of one image: label map, images, path length maps and labels."""

import json
from collections.abc import Iterator
from typing import Any

from ..io import dataset_files
from .coco_instances import list_instances
from .dataset_settings import DatasetSettings
from .dataset_tables import DatasetTables
from .sample import Sample


def collect_labels(sample: Sample) -> dict[str, Any]:
    """Collect the labels of an image as JSON-ready values.

    Parameters
    ----------
    sample : Sample
        Image with its labels.

    Returns
    -------
    dict of str to object
        Name, subject, subset, size, landmarks and all labels.
    """
    rows, cols = sample.linear.shape
    return {
        "name": sample.name,
        "subject": sample.subject,
        "split": sample.split,
        "rows": rows,
        "cols": cols,
        "pixel_mm": round(sample.pixel_mm, 9),
        **sample.labels,
        "landmarks_px": {name: [round(row, 4), round(col, 4)] for name, (row, col) in sample.landmarks_px.items()},
    }


def encode_sample(sample: Sample, settings: DatasetSettings, tables: DatasetTables) -> Iterator[tuple[str, bytes]]:
    """Encode the files of one image.

    Parameters
    ----------
    sample : Sample
        Image with its labels.
    settings : DatasetSettings
        Settings of the data set.
    tables : DatasetTables
        Tables and protocols.

    Yields
    ------
    tuple of (str, bytes)
        Path relative to the data set, or name in the shard, and content.
    """
    contents = {"label_map": dataset_files.encode_png(sample.label_map)}
    if "linear" in settings.kinds:
        contents["linear"] = dataset_files.encode_tiff(sample.linear, sample.pixel_mm)
    if "display" in settings.kinds:
        contents["display"] = dataset_files.encode_png(sample.display)
    if settings.maps:
        contents["maps"] = dataset_files.encode_maps(sample.maps)
    entry = {**collect_labels(sample), "instances": list_instances(sample, tables.definitions.label_map)}
    contents["labels"] = (json.dumps(entry) + "\n").encode()
    for kind, content in contents.items():
        if settings.layout == "shards":
            yield dataset_files.name_shard_member(kind, sample.name), content
        else:
            yield dataset_files.name_sample_file(sample.split, kind, sample.name), content
