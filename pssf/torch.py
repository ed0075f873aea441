"""Data sets for PyTorch: images from a folder, or images that are simulated during training.

This module needs PyTorch (extra ``torch``); no other module of the package imports it.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .core.checks import InputError, require_choice, require_integer
from .dataset import DatasetSettings, DatasetTables, load_dataset_tables, make_subject_samples
from .dataset.coco_instances import decode_run_lengths
from .dataset.dataset_settings import IMAGE_KINDS, SPLITS
from .dataset.dataset_specification import read_dataset_settings, read_label_map
from .dataset.dataset_summary import list_landmarks
from .dataset.label_map import find_mask_class
from .dataset.sample_files import collect_labels
from .io.dataset_files import read_maps, read_pixels, read_sample_labels
from .io.dataset_index_files import read_index_table

try:
    import torch
    from torch.utils.data import Dataset, IterableDataset, get_worker_info
except ImportError as error:
    raise ImportError("pssf.torch needs PyTorch: pip install 'pssf[torch]'") from error

Item = dict[str, Any]
Transform = Callable[[Item], Item]

# Parts of an item that are read or computed only on request.
_OPTIONAL_PARTS = ("masks", "maps")
# Largest number of loader processes, each of which counts its epochs.
_MOST_WORKERS = 1024
# Number of pixels along the longer side of the images that only list the landmarks of a view.
_SMALL_MATRIX = 32


class KneeDataset(Dataset[Item]):
    """Map-style data set over a folder that ``pssf dataset`` made with the layout ``folder``.

    Parameters
    ----------
    folder : str or Path
        Folder of the data set.
    split : {"train", "validation", "test"}
        Subset.
    image : {"display", "linear"}
        Kind of image: 8 bits processed for display, or 16 bits linear in the absorbed energy.
    keep : sequence of {"masks", "maps"}
        Additional fields of each item.
    transform : callable, optional
        Function of an item that returns the item for training; None: no function.

    Attributes
    ----------
    names : list of str
        Names of the images.
    kl : list of int
        KL grade of each image, for example for a weighted sampler.
    landmark_names : tuple of str
        Name of each row of ``landmarks_px``.
    label_map : dict of str to int
        Value of each class in the label map.
    map_names : tuple of str
        Material of each path length map.

    Raises
    ------
    InputError
        If the folder contains no complete data set in single files, or lacks the requested kind of image or maps.

    Notes
    -----
    An item is a dict with these fields:

    - ``image``: (1, rows, cols) float32, 0 to 1
    - ``label_map``: (rows, cols) int64
    - ``landmarks_px``: (landmarks, 2) float32, row and column; NaN if the view lacks the landmark
    - ``kl``: int64
    - ``jsw_medial_mm``, ``jsw_lateral_mm``: float32; NaN if the view has no joint space labels
    - ``pixel_mm``: float32
    - ``name``, ``subject``: str
    - ``masks``: (classes, rows, cols) bool, in the order of `label_map` without background; masks can overlap
    - ``maps``: (materials, rows, cols) float32, in mm
    """

    def __init__(
        self,
        folder: str | Path,
        split: str = "train",
        *,
        image: str = "display",
        keep: Sequence[str] = (),
        transform: Transform | None = None,
    ) -> None:
        require_choice("split", split, SPLITS)
        self.folder, self.split, self.image, self.transform = Path(folder), split, image, transform
        settings = read_dataset_settings(self.folder)
        self.keep, self.map_names = _require_parts(keep, settings), settings.maps
        require_choice("image", image, settings.kinds)
        if settings.layout != "folder":
            raise InputError(f"layout must be folder, got layout = {settings.layout}: read shards with webdataset")
        columns, rows = read_index_table(self.folder / "index.csv", split, ("name", "kl"))
        if not rows:
            raise InputError(f"split must be a subset with images, got {split!r}, to which --split gave no subject")
        self.names = [name for name, _ in rows]
        self.kl = [int(kl) for _, kl in rows]
        self.landmark_names = tuple(list_landmarks(columns))
        self.label_map = read_label_map(self.folder)

    def __len__(self) -> int:
        """Return the number of images."""
        return len(self.names)

    def __getitem__(self, index: int) -> Item:
        """Read one image with its labels."""
        name, labels = self.names[index], self.read_labels(index)
        pixels, drawn = (read_pixels(self.folder, self.split, kind, name) for kind in (self.image, "label_map"))
        coded = labels["instances"] if "masks" in self.keep else []
        masks = {one["name"]: decode_run_lengths(one["segmentation"]) for one in coded}
        maps = read_maps(self.folder, self.split, name) if "maps" in self.keep else {}
        item = _make_item(pixels, drawn, labels, self.landmark_names)
        _add_parts(item, self.keep, masks, maps, self.label_map, self.map_names)
        return item if self.transform is None else self.transform(item)

    def read_labels(self, index: int) -> dict[str, Any]:
        """Read all labels of an image.

        Parameters
        ----------
        index : int
            Index of the image in the subset.

        Returns
        -------
        dict of str to object
            Content of the JSON file of the image.

        Raises
        ------
        InputError
            If the file is missing or damaged.
        """
        return read_sample_labels(self.folder, self.split, self.names[index])


class KneeStream(IterableDataset[Item]):
    """Iterable data set that simulates images of new subjects in every epoch.

    Parameters
    ----------
    settings : DatasetSettings
        Settings; ``images`` is the number of images per epoch. The settings ``split``, ``layout``, ``kinds``,
        ``shard_images`` and ``parquet`` have no effect.
    image : {"display", "linear"}
        Kind of image, as in `KneeDataset`.
    keep : sequence of {"masks", "maps"}
        Additional fields of each item.
    transform : callable, optional
        Function of an item that returns the item for training; None: no function.

    Attributes
    ----------
    landmark_names : tuple of str
        Name of each row of ``landmarks_px``.
    label_map : dict of str to int
        Value of each class in the label map.
    map_names : tuple of str
        Material of each path length map.

    Raises
    ------
    InputError
        If a table or protocol is unknown, or a part of the items is not available.

    Notes
    -----
    Items have the same fields as in `KneeDataset`. An epoch contains the same images for any number of
    loader processes, if this number does not change between epochs; their order depends on this number. After a change,
    call `set_epoch`. In distributed training, use another seed for each rank. The subjects of the first epoch are those
    of a data set with the same settings; use another seed for the images on which a network is tested.
    """

    def __init__(
        self,
        settings: DatasetSettings,
        *,
        image: str = "display",
        keep: Sequence[str] = (),
        transform: Transform | None = None,
    ) -> None:
        require_choice("image", image, IMAGE_KINDS)
        self.settings, self.image, self.transform = settings, image, transform
        self.keep, self.map_names = _require_parts(keep, settings), settings.maps
        self._tables = load_dataset_tables(settings)
        self.landmark_names = _list_landmarks(settings, self._tables)
        self.label_map = dict(self._tables.definitions.label_map)
        # Number of the next epoch of each loader process. Shared memory keeps it when processes are started again.
        self._epochs = torch.zeros(_MOST_WORKERS, dtype=torch.int64).share_memory_()

    def set_epoch(self, epoch: int) -> None:
        """Set the number of the next epoch, for example to continue an interrupted training.

        Parameters
        ----------
        epoch : int
            Number of the epoch, from 0.

        Raises
        ------
        InputError
            If the number is negative or not an integer.
        """
        # Streams of random numbers are distinct for subject numbers below 2**32.
        require_integer("epoch", epoch, 0, 2**32 // self.settings.subject_count - 1, "")
        self._epochs.fill_(epoch)

    def __iter__(self) -> Iterator[Item]:
        """Yield the images that this loader process simulates in the next epoch."""
        worker = get_worker_info()
        place, count = (0, 1) if worker is None else (worker.id, worker.num_workers)
        epoch = int(self._epochs[place])
        self._epochs[place] += 1
        first = epoch * self.settings.subject_count
        for subject in range(first + place, first + self.settings.subject_count, count):
            for sample in make_subject_samples(self.settings, self._tables, subject, "train"):
                pixels = sample.display if self.image == "display" else sample.linear
                item = _make_item(pixels, sample.label_map, collect_labels(sample), self.landmark_names)
                _add_parts(item, self.keep, sample.masks, sample.maps, self.label_map, self.map_names)
                yield item if self.transform is None else self.transform(item)


def _require_parts(keep: Sequence[str], settings: DatasetSettings) -> tuple[str, ...]:
    """Return the requested parts; raise InputError if a part is unknown or the data set has no maps."""
    for part in keep:
        require_choice("keep", part, _OPTIONAL_PARTS)
        if part == "maps" and not settings.maps:
            raise InputError(f"keep must not contain maps for a data set without maps, got {part}: make it with --maps")
    return tuple(keep)


def _list_landmarks(settings: DatasetSettings, tables: DatasetTables) -> tuple[str, ...]:
    """List the landmarks of all protocols; the first subject is simulated with few pixels."""
    names = dict[str, None]()
    plain = replace(settings, knees_per_subject=1, pairs="none", crop_mm=0.0, randomise=(), maps=())
    for protocol in tables.protocols:
        small = replace(tables, protocols=(protocol.resample(_SMALL_MATRIX),))
        names |= dict.fromkeys(make_subject_samples(plain, small, 0, "train")[0].landmarks_px)
    return tuple(sorted(names))


def _make_item(
    pixels: NDArray[Any], label_map: NDArray[np.uint8], labels: Mapping[str, Any], landmark_names: Sequence[str]
) -> Item:
    """Make the item of an image."""
    missing, places = (np.nan, np.nan), labels["landmarks_px"]
    grey = pixels.astype(np.float32) / np.float32(np.iinfo(pixels.dtype).max)
    lengths = {
        name: torch.tensor(np.nan if labels.get(name) is None else labels[name], dtype=torch.float32)
        for name in ("jsw_medial_mm", "jsw_lateral_mm", "pixel_mm")
    }
    return {
        "image": torch.from_numpy(grey[None]),
        "label_map": torch.from_numpy(label_map.astype(np.int64)),
        "landmarks_px": torch.tensor([places.get(name, missing) for name in landmark_names], dtype=torch.float32),
        "kl": torch.tensor(labels["kl"], dtype=torch.int64),
        **lengths,
        "name": labels["name"],
        "subject": labels["subject"],
    }


def _add_parts(
    item: Item,
    keep: Sequence[str],
    masks: Mapping[str, NDArray[np.bool_]],
    maps: Mapping[str, NDArray[np.float32]],
    label_map: Mapping[str, int],
    map_names: Sequence[str],
) -> None:
    """Add the requested parts to an item: the union of the masks of each class, and path lengths."""
    if "masks" in keep:
        shape, kinds = item["label_map"].shape, [kind for kind, value in label_map.items() if value]
        united = np.zeros((len(kinds), *shape), bool)
        for name, mask in masks.items():
            united[kinds.index(find_mask_class(name, label_map))] |= mask
        item["masks"] = torch.from_numpy(united)
    if "maps" in keep:
        item["maps"] = torch.from_numpy(np.stack([maps[name] for name in map_names]).astype(np.float32))
