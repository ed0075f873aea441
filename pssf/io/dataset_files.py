"""Files of a data set: encoding of images, label maps and path length maps, tar shards, and part records."""

import hashlib
import io
import tarfile
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from importlib.metadata import version
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import tifffile
from numpy.typing import NDArray
from PIL import Image

from ..core.checks import InputError
from ..data.table_records import Record
from ..data.user_files import convert_os_errors, read_json
from .atomic_write import replace_file, write_bytes
from .cohort_records import hash_file

# Name of the file that specifies the data set.
SETTINGS_FILE = "dataset.json"
# Metadata of the data set; its publisher may change this file.
CROISSANT_FILE = "croissant.json"
# Suffix of the files of an image, keyed by their content.
FILE_SUFFIXES = {"linear": "tif", "display": "png", "label_map": "png", "maps": "tif", "labels": "json"}
# Faults of a file.
MISSING, CHANGED = "missing", "changed"
# Size limit of hashed files, in bytes: none.
NO_LIMIT = 2**63
# Index of the record of the files that describe the complete data set.
DESCRIPTION = -1


class PartRecord(Record, frozen=True):
    """Record of one part of a data set.

    Attributes
    ----------
    rows : list of dict
        Rows of the index, one per image.
    files : dict of str to str
        SHA-256 hash of each file, keyed by path relative to the folder of the data set.
    settings_sha256 : str
        SHA-256 hash of the file dataset.json.
    """

    rows: list[dict[str, Any]]
    files: dict[str, str]
    settings_sha256: str


def encode_tiff(image: NDArray[np.uint16], pixel_mm: float) -> bytes:
    """Encode a 16-bit image as compressed TIFF.

    Parameters
    ----------
    image : (rows, cols) uint16 array
        Pixel values.
    pixel_mm : float
        Pixel size, in mm.

    Returns
    -------
    bytes
        Content of the file.
    """
    buffer = io.BytesIO()
    per_cm = 10.0 / pixel_mm
    tifffile.imwrite(
        buffer,
        image,
        photometric="minisblack",
        compression="zlib",
        compressionargs={"level": 1},
        predictor=True,
        resolution=(per_cm, per_cm),
        resolutionunit="CENTIMETER",
        software=f"pssf {version('pssf')}",
        metadata=None,
    )
    return buffer.getvalue()


def encode_maps(maps: Mapping[str, NDArray[np.float32]]) -> bytes:
    """Encode maps as TIFF with one page per map; the tag PageName contains the name of the map.

    Parameters
    ----------
    maps : mapping of str to (rows, cols) float32 array, mm
        Path lengths keyed by material.

    Returns
    -------
    bytes
        Content of the file.
    """
    buffer = io.BytesIO()
    with tifffile.TiffWriter(buffer) as tiff:
        for name, image in maps.items():
            tiff.write(
                np.asarray(image, np.float32),
                compression="zlib",
                compressionargs={"level": 1},
                metadata=None,
                software=f"pssf {version('pssf')}",
                extratags=[(285, "s", 0, name, True)],
            )
    return buffer.getvalue()


def encode_png(image: NDArray[np.uint8]) -> bytes:
    """Encode an 8-bit image as PNG.

    Parameters
    ----------
    image : (rows, cols) uint8 array
        Grey levels, or values of a label map.

    Returns
    -------
    bytes
        Content of the file.
    """
    buffer = io.BytesIO()
    Image.fromarray(image).save(buffer, format="PNG", compress_level=4)
    return buffer.getvalue()


def name_sample_file(split: str, kind: str, name: str) -> str:
    """Return the path of a file of an image, relative to the folder of the data set.

    Parameters
    ----------
    split : str
        Subset.
    kind : {"linear", "display", "label_map", "maps", "labels"}
        Content of the file.
    name : str
        Name of the image.

    Returns
    -------
    str
        Path with forward slashes.
    """
    return f"{split}/{kind}/{name}.{FILE_SUFFIXES[kind]}"


def name_shard_member(kind: str, name: str) -> str:
    """Return the name of a file of an image in a shard.

    Parameters
    ----------
    kind : {"linear", "display", "label_map", "maps", "labels"}
        Content of the file.
    name : str
        Name of the image.

    Returns
    -------
    str
        Name of the image, and the content of the file as ending; labels have the ending ``json``.
    """
    return f"{name}.json" if kind == "labels" else f"{name}.{kind}.{FILE_SUFFIXES[kind]}"


def read_pixels(folder: Path, split: str, kind: str, name: str) -> NDArray[Any]:
    """Read an image or a label map of a data set.

    Parameters
    ----------
    folder : Path
        Folder of the data set.
    split : str
        Subset.
    kind : {"linear", "display", "label_map"}
        Kind of image.
    name : str
        Name of the image.

    Returns
    -------
    (rows, cols) uint8 or uint16 array
        Pixel values.

    Raises
    ------
    InputError
        The file is missing or damaged.
    """
    path = folder / name_sample_file(split, kind, name)
    with _convert_read_errors(path):
        if kind == "linear":
            return np.asarray(tifffile.imread(path))
        with Image.open(path) as image:
            return np.asarray(image)


def read_maps(folder: Path, split: str, name: str) -> dict[str, NDArray[np.float32]]:
    """Read the path length maps of an image.

    Parameters
    ----------
    folder : Path
        Folder of the data set.
    split : str
        Subset.
    name : str
        Name of the image.

    Returns
    -------
    dict of str to (rows, cols) float32 array
        Path lengths keyed by material, in mm.

    Raises
    ------
    InputError
        The file is missing or damaged.
    """
    path = folder / name_sample_file(split, "maps", name)
    with _convert_read_errors(path), tifffile.TiffFile(path) as tiff:
        return {page.tags["PageName"].value: page.asarray() for page in tiff.pages}  # type: ignore[union-attr]


def read_sample_labels(folder: Path, split: str, name: str) -> dict[str, Any]:
    """Read all labels of an image.

    Parameters
    ----------
    folder : Path
        Folder of the data set.
    split : str
        Subset.
    name : str
        Name of the image.

    Returns
    -------
    dict of str to object
        Labels.

    Raises
    ------
    InputError
        The file is missing or damaged.
    """
    labels: dict[str, Any] = read_json(folder / name_sample_file(split, "labels", name), dict[str, Any])
    return labels


@contextmanager
def _convert_read_errors(path: Path) -> Iterator[None]:
    """Raise InputError if a file of a data set is missing or damaged."""
    try:
        with convert_os_errors(path, "a file of the data set"):
            yield
    except InputError:
        raise
    except Exception as error:  # Reading a damaged file can raise any exception.
        raise InputError(f"file {path} must be an intact image of the data set, got a damaged file ({error})") from None


def write_files(folder: Path, entries: Iterable[tuple[str, bytes]]) -> dict[str, str]:
    """Write files one by one.

    Parameters
    ----------
    folder : Path
        Folder of the data set.
    entries : iterable of (str, bytes) tuples
        Path relative to `folder`, and content.

    Returns
    -------
    dict of str to str
        SHA-256 hash of each file, keyed by path.

    Raises
    ------
    InputError
        The disk is full, or a file cannot be written.
    """
    hashes = {}
    for name, content in entries:
        write_bytes(folder / name, content)
        hashes[name] = hashlib.sha256(content).hexdigest()
    return hashes


def write_shard(folder: Path, name: str, entries: Iterable[tuple[str, bytes]]) -> dict[str, str]:
    """Write files to a tar archive that depends only on their names and contents.

    Parameters
    ----------
    folder : Path
        Folder of the data set.
    name : str
        Path of the archive, relative to `folder`.
    entries : iterable of (str, bytes) tuples
        File name and content. In a WebDataset, files of one sample have the same name up to the first dot.

    Returns
    -------
    dict of str to str
        SHA-256 hash of the archive, keyed by `name`.

    Raises
    ------
    InputError
        The disk is full, or the archive cannot be written.
    """
    with (
        replace_file(folder / name) as temporary,
        tarfile.open(temporary, mode="w", format=tarfile.USTAR_FORMAT) as tar,
    ):
        for member, content in entries:
            entry = tarfile.TarInfo(member)
            entry.size, entry.mode = len(content), 0o644
            tar.addfile(entry, io.BytesIO(content))
    return {name: hash_file(folder / name, max_bytes=NO_LIMIT)}


def write_part_record(folder: Path, index: int, record: PartRecord) -> None:
    """Write the record of a part, after all its files.

    Parameters
    ----------
    folder : Path
        Folder of the data set.
    index : int
        Index of the part.
    record : PartRecord
        Record of the part.

    Raises
    ------
    InputError
        The disk is full, or the file cannot be written.
    """
    write_bytes(record_path(folder, index), msgspec.json.encode(record) + b"\n")


def read_part(folder: Path, index: int, claim: str | None = None) -> PartRecord | None:
    """Read the record of a part.

    Parameters
    ----------
    folder : Path
        Folder of the data set.
    index : int
        Index of the part.
    claim : str, optional
        Expected SHA-256 hash of dataset.json; None: not checked.

    Returns
    -------
    PartRecord or None
        Record; None if the part is unfinished.

    Raises
    ------
    InputError
        The record is damaged or belongs to another data set.
    """
    path = record_path(folder, index)
    if not path.exists():
        return None
    record: PartRecord = read_json(path, PartRecord)
    if claim is not None and record.settings_sha256 != claim:
        raise InputError(f"file {path} must belong to this data set, got the record of another one; use a new folder")
    return record


def iterate_faults(folder: Path, record: PartRecord) -> Iterator[tuple[str, str]]:
    """Yield each missing or changed file of a part.

    Parameters
    ----------
    folder : Path
        Folder of the data set.
    record : PartRecord
        Record of the part.

    Yields
    ------
    tuple of (str, str)
        Path relative to `folder`, and `MISSING` or `CHANGED`.
    """
    for name, digest in record.files.items():
        if not (folder / name).exists():
            yield name, MISSING
        elif hash_file(folder / name, max_bytes=NO_LIMIT) != digest:
            yield name, CHANGED


def record_path(folder: Path, index: int) -> Path:
    """Return the path of the record of a part.

    Parameters
    ----------
    folder : Path
        Folder of the data set.
    index : int
        Index of the part, or `DESCRIPTION`.

    Returns
    -------
    Path
        Path of the record.
    """
    name = "description" if index == DESCRIPTION else f"part-{index:06d}"
    return folder / "records" / f"{name}.json"


def list_files(folder: Path) -> list[str]:
    """List all files of a folder and its subfolders.

    Parameters
    ----------
    folder : Path
        Folder of the data set.

    Returns
    -------
    list of str
        Paths relative to `folder`, sorted.
    """
    return sorted(path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file())
