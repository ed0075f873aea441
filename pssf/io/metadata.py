"""JSON metadata of a radiograph: parameters, ground truth, versions and two hashes.

One hash covers only the metadata, so that files without linear pixels can be verified. The other hash covers metadata
and pixels.
"""

import hashlib
import json
import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from ..core.checks import InputError
from ..data.table_records import Record
from ..model.knee import RENAMED_FIELDS as KNEE_FIELDS
from ..model.knee import knee_from_dict, knee_to_dict
from ..model.protocol import RENAMED_FIELDS as PROTOCOL_FIELDS
from ..model.protocol import protocol_from_dict, protocol_to_dict
from ..model.radiograph import Radiograph, Truth


class LabelWarning(UserWarning):
    """Warning that labels in a file refer to a different view and are omitted."""


class UnverifiedNotice(UserWarning):
    """Warning that a file contains no hash, so that damage to the file cannot be detected."""


# Mapping of former label names to current label names.
_TRUTH_FIELDS = {"taking": "acquisition", "grade_read": "reader_grade"}


class _TruthEntry(Record, frozen=True):
    """JSON fields of `model.radiograph.Truth`, without the masks."""

    jsw_medial_mm: float | None
    jsw_lateral_mm: float | None
    jsw_at_mm: dict[str, float]
    grade: int | None
    reader_grade: int | None
    attrition_mm: dict[str, float]
    readings: dict[str, int | float]
    acquisition: dict[str, int | float | str]
    landmarks_px: dict[str, tuple[float, float]]


class _MetadataEntry(Record, frozen=True):
    """JSON fields of the metadata of a radiograph.

    Protocol and knees are validated later, when the objects are constructed.
    """

    protocol: dict[str, Any]
    knee: dict[str, Any] | None
    seed: int
    truth: _TruthEntry | None
    engine: str
    audit: dict[str, int]
    versions: dict[str, str]
    pixels: str
    sha256: str
    parameters_sha256: str = ""
    knees: tuple[dict[str, Any], ...] = ()
    truths: tuple[_TruthEntry, ...] = ()
    scene: dict[str, Any] | None = None
    surgery: tuple[dict[str, Any], ...] = ()


def encode_metadata(radiograph: Radiograph, indent: int | None = None) -> str:
    """Encode the metadata of a radiograph as JSON, including a hash of the metadata and a hash of metadata and pixels.

    Parameters
    ----------
    radiograph : Radiograph
        Radiograph with the metadata to encode.
    indent : int or None
        Number of spaces per indentation level; None for a single line.

    Returns
    -------
    str
        JSON text.
    """
    fields = _build_metadata(radiograph)
    fields["parameters_sha256"] = hashlib.sha256(_dump_json(fields).encode()).hexdigest()
    whole = {**fields, "sha256": _hash_text_and_pixels(_dump_json(fields), radiograph.pixels)}
    return _dump_json(whole, indent)


def decode_metadata(text: str, path: Path) -> dict[str, Any]:
    """Decode JSON metadata that `encode_metadata` wrote.

    Parameters
    ----------
    text : str
        JSON text.
    path : Path
        Path shown in error messages.

    Returns
    -------
    dict of str to object
        Fields of `Radiograph` except pixels, keyed by field name.

    Raises
    ------
    InputError
        The text does not contain the metadata of a radiograph, or protocol or knee are invalid.

    Warns
    -----
    LabelWarning
        An earlier version wrote the file, so that the joint space labels are omitted.
    """
    try:
        described = msgspec.convert(_update_names(json.loads(text)), _MetadataEntry)
    except (ValueError, RecursionError) as error:  # msgspec raises subclasses of ValueError.
        allowed = "a radiograph or parameter file written by pssf"
        raise InputError(f"file {path} must be {allowed}, got invalid metadata ({error})") from None
    where = f"file {path}"
    return {
        "protocol": protocol_from_dict(described.protocol, where),
        "seed": described.seed,
        "knees": tuple(knee_from_dict(table, where) for table in described.knees),
        "truths": tuple(_make_truth(one, path) for one in described.truths),
        "scene": described.scene,
        "surgery": described.surgery,
        "knee": None if described.knee is None else knee_from_dict(described.knee, where),
        "truth": None if described.truth is None else _make_truth(described.truth, path),
        "engine": described.engine,
        "audit": described.audit,
        "versions": described.versions,
    }


def _update_names(entry: Any) -> Any:
    """Replace former field names by current field names in parsed JSON metadata."""
    if not isinstance(entry, dict):
        return entry
    parts = {"protocol": PROTOCOL_FIELDS, "knee": KNEE_FIELDS, "knees": KNEE_FIELDS}
    parts |= {"truth": _TRUTH_FIELDS, "truths": _TRUTH_FIELDS}
    for part, renamed in parts.items():
        tables = entry.get(part) or ()
        for table in tables if isinstance(tables, list) else (tables,):
            if isinstance(table, dict):
                table |= {now: table.pop(earlier) for earlier, now in renamed.items() if earlier in table}
    return entry


def require_intact_radiograph(text: str, pixels: NDArray[Any], path: Path) -> None:
    """Verify the pixels and the metadata of a file with the hash of metadata and pixels.

    Parameters
    ----------
    text : str
        JSON text that `encode_metadata` wrote.
    pixels : (rows, cols) uint16 array, DN
        Linear pixels of the file.
    path : Path
        Path shown in error messages.

    Raises
    ------
    InputError
        The pixels are not uint16, or pixels and metadata do not match the recorded hash.
    """
    if pixels.dtype != np.uint16:
        raise InputError(f"file {path}: pixels must be uint16, as written by pssf, got {pixels.dtype}")
    fields = json.loads(text)
    written = fields.pop("sha256")
    now = _hash_text_and_pixels(_dump_json(fields), pixels)
    if now != written:
        raise InputError(
            f"file {path}: pixels and metadata do not match their hash (sha256 {now[:12]}..., recorded "
            f"{written[:12]}...), because the file is damaged or was edited; save the radiograph again"
        )


def require_intact_metadata(text: str, path: Path, pixels: NDArray[Any] | None = None) -> None:
    """Verify the metadata of a file with the recorded hash.

    Parameters
    ----------
    text : str
        JSON text that `encode_metadata` wrote.
    path : Path
        Path shown in error messages.
    pixels : (rows, cols) array, DN, or None
        Linear pixels of the file, for metadata without a separate hash. None if the file has no linear pixels.

    Raises
    ------
    InputError
        The metadata do not match the recorded hash.

    Warns
    -----
    UnverifiedNotice
        An earlier version wrote the file without linear pixels and without a separate hash of the metadata.
    """
    fields = json.loads(text)
    fields.pop("sha256")
    written = fields.pop("parameters_sha256", "")
    if written:
        require_hash(path, hashlib.sha256(_dump_json(fields).encode()).hexdigest(), written, "parameters")
    elif pixels is not None:
        require_intact_radiograph(text, pixels, path)
    else:
        warn_unverified(path, "parameters")


def require_hash(path: Path, actual_sha256: str, expected_sha256: str, content: str) -> None:
    """Require that the hash of the content equals the hash recorded in the file.

    Parameters
    ----------
    path : Path
        Path shown in error messages.
    actual_sha256 : str
        Hash of the content that was read.
    expected_sha256 : str
        Hash that is recorded in the file.
    content : str
        Plural noun for the content in error messages, such as "masks".

    Raises
    ------
    InputError
        The two hashes differ.
    """
    if actual_sha256 != expected_sha256:
        raise InputError(
            f"file {path}: {content} do not match their hash (sha256 {actual_sha256[:12]}..., recorded "
            f"{expected_sha256[:12]}...), because the file is damaged or was edited; save the {content} again"
        )


def hash_masks(masks: Mapping[str, NDArray[np.bool_]]) -> str:
    """Compute the SHA-256 hash over the names, sizes and pixels of masks, in the order of the dict.

    Parameters
    ----------
    masks : dict of str to (rows, cols) bool array
        Masks, keyed by mask name.

    Returns
    -------
    str
        SHA-256 hash in hexadecimal digits.
    """
    digest = hashlib.sha256(json.dumps([(name, list(np.shape(mask))) for name, mask in masks.items()]).encode())
    for mask in masks.values():
        digest.update(np.packbits(np.asarray(mask, np.bool_)).tobytes())
    return digest.hexdigest()


def warn_unverified(path: Path, content: str) -> None:
    """Warn that an earlier version wrote a file without a hash.

    Parameters
    ----------
    path : Path
        Path of the file, shown in the warning.
    content : str
        Plural noun for the content in the warning, such as "masks".

    Warns
    -----
    UnverifiedNotice
        Always issued.
    """
    warnings.warn(
        f"file {path}: the {content} have no hash, because an earlier version wrote the file, so that damage "
        "cannot be detected; save the file again",
        UnverifiedNotice,
        stacklevel=4,
    )


def _build_metadata(radiograph: Radiograph) -> dict[str, Any]:
    """Collect the metadata of a radiograph as a JSON-ready dictionary, without hashes."""
    both = {
        "knees": [knee_to_dict(knee) for knee in radiograph.knees],
        "truths": [_build_truth_entry(truth) for truth in radiograph.truths],
    }
    return {
        "protocol": protocol_to_dict(radiograph.protocol),
        "knee": None if radiograph.knee is None else knee_to_dict(radiograph.knee),
        **(both if radiograph.knees else {}),
        **({} if radiograph.scene is None else {"scene": dict(radiograph.scene)}),
        **({"surgery": [dict(step) for step in radiograph.surgery]} if radiograph.surgery else {}),
        "seed": radiograph.seed,
        "truth": None if radiograph.truth is None else _build_truth_entry(radiograph.truth),
        "engine": radiograph.engine,
        "audit": dict(radiograph.audit),
        "versions": dict(radiograph.versions),
        "pixels": "linear in absorbed energy; row 0 proximal; columns towards +x",
    }


def _build_truth_entry(truth: Truth) -> dict[str, Any]:
    """Convert a Truth, without its masks, to a JSON-ready dictionary."""
    return {
        "jsw_medial_mm": truth.jsw_medial_mm,
        "jsw_lateral_mm": truth.jsw_lateral_mm,
        "jsw_at_mm": {f"{fraction:g}": space for fraction, space in truth.jsw_at_mm.items()},
        "grade": truth.grade,
        "reader_grade": truth.reader_grade,
        "attrition_mm": dict(truth.attrition_mm),
        "readings": dict(truth.readings),
        "acquisition": dict(truth.acquisition),
        "landmarks_px": {name: list(place) for name, place in truth.landmarks_px.items()},
    }


def _make_truth(entry: _TruthEntry, path: Path) -> Truth:
    """Construct a Truth from JSON fields, without joint space labels if an earlier version wrote the file."""
    fields = msgspec.structs.asdict(entry)
    fields["jsw_at_mm"] = {float(fraction): space for fraction, space in entry.jsw_at_mm.items()}
    if entry.jsw_medial_mm is not None and "medial_jsw_femur" not in entry.landmarks_px:
        warnings.warn(
            f"file {path} was written by an earlier version; its joint space labels were omitted, because they refer "
            "to a different view; simulate the knee again to obtain the labels",
            LabelWarning,
            stacklevel=2,
        )
        readings = {name: value for name, value in entry.readings.items() if not name.startswith("jsw_least_")}
        fields |= {"jsw_medial_mm": None, "jsw_lateral_mm": None, "jsw_at_mm": {}, "readings": readings}
    return Truth(**fields)


def _dump_json(fields: dict[str, Any], indent: int | None = None) -> str:
    """Encode fields as JSON, and convert NumPy numbers to Python numbers."""
    return json.dumps(fields, indent=indent, default=lambda number: number.item())


def _hash_text_and_pixels(text: str, pixels: NDArray[Any]) -> str:
    """Compute the SHA-256 hash over a text and linear pixels (rows, cols) in DN."""
    digest = hashlib.sha256(text.encode())
    digest.update(np.ascontiguousarray(pixels, "<u2").tobytes())
    return digest.hexdigest()
