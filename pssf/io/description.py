"""What a file says of its radiograph: all that it was made from, what is known about it, and two hashes, so that a bit
that was flipped is seen: one over that alone, for files that hold no linear pixels, and one over that and the pixels.
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
from ..data.records import Record
from ..model.knee import knee_from, knee_table
from ..model.protocol import protocol_from, protocol_table
from ..model.radiograph import Radiograph, Truth


class LabelWarning(UserWarning):
    """Labels that a file holds are not those of its radiograph and are left out."""


class UnverifiedNotice(UserWarning):
    """A file was read that has no hash: whether it is as it was written is not known."""


class _Truth(Record, frozen=True):
    """`model.radiograph.Truth`, but for its masks, as JSON has it."""

    jsw_medial_mm: float | None
    jsw_lateral_mm: float | None
    jsw_at_mm: dict[str, float]
    grade: int | None
    grade_read: int | None
    attrition_mm: dict[str, float]
    readings: dict[str, int | float]
    taking: dict[str, int | float | str]
    landmarks_px: dict[str, tuple[float, float]]


class _Described(Record, frozen=True):
    """A description as it is read; protocol and knees are checked where they become such."""

    protocol: dict[str, Any]
    knee: dict[str, Any] | None
    seed: int
    truth: _Truth | None
    engine: str
    audit: dict[str, int]
    versions: dict[str, str]
    pixels: str
    sha256: str
    parameters_sha256: str = ""
    knees: tuple[dict[str, Any], ...] = ()
    truths: tuple[_Truth, ...] = ()
    scene: dict[str, Any] | None = None
    surgery: tuple[dict[str, Any], ...] = ()


def as_json(radiograph: Radiograph, indent: int | None = None) -> str:
    """All that a radiograph was made from, what is known about it, a hash over that, and one over it and the pixels."""
    fields = _fields(radiograph)
    fields["parameters_sha256"] = hashlib.sha256(_dumped(fields).encode()).hexdigest()
    whole = {**fields, "sha256": _digest(_dumped(fields), radiograph.pixels)}
    return _dumped(whole, indent)


def parameters(text: str, path: Path) -> dict[str, Any]:
    """Fields of a Radiograph but for its pixels, from what `as_json` gave; `path` is named in a refusal.

    raises  InputError for another text
    """
    try:
        described = msgspec.convert(json.loads(text), _Described)
    except (ValueError, RecursionError) as error:  # of which msgspec's own is one
        raise InputError(f"file {path}: damaged or not by pssf ({error}); allowed: what pssf wrote") from None
    where = f"file {path}"
    return {
        "protocol": protocol_from(described.protocol, where),
        "seed": described.seed,
        "knees": tuple(knee_from(table, where) for table in described.knees),
        "truths": tuple(_truth(one, path) for one in described.truths),
        "scene": described.scene,
        "surgery": described.surgery,
        "knee": None if described.knee is None else knee_from(described.knee, where),
        "truth": None if described.truth is None else _truth(described.truth, path),
        "engine": described.engine,
        "audit": described.audit,
        "versions": described.versions,
    }


def require_as_written(text: str, pixels: NDArray[Any], path: Path) -> None:
    """Refuse pixels or a description that are not those of one radiograph.

    text    of `as_json`
    pixels  (rows, cols) as the file has them
    raises  InputError
    """
    if pixels.dtype != np.uint16:
        raise InputError(f"file {path}: pixels = {pixels.dtype}; allowed: uint16, as pssf writes them")
    fields = json.loads(text)
    written = fields.pop("sha256")
    now = _digest(_dumped(fields), pixels)
    if now != written:
        raise InputError(
            f"file {path}: damaged (sha256 {now[:12]}..., when it was written {written[:12]}...); "
            "allowed: pixels and description as pssf wrote them"
        )


def require_parameters(text: str, path: Path, pixels: NDArray[Any] | None = None) -> None:
    """Refuse a description that is not as it was written.

    Parameters
    ----------
    text
        Of `as_json`.
    path
        Is named in a refusal.
    pixels : (rows, cols) array, DN, or None
        Linear pixels of the same file, by which a description without a hash of its own is verified.

    Raises
    ------
    InputError
        The description differs from its hash.

    Warns
    -----
    UnverifiedNotice
        An earlier version wrote no hash of the description alone, and there are no pixels.
    """
    fields = json.loads(text)
    fields.pop("sha256")
    written = fields.pop("parameters_sha256", "")
    if written:
        require_hash(path, hashlib.sha256(_dumped(fields).encode()).hexdigest(), written, "parameters")
    elif pixels is not None:
        require_as_written(text, pixels, path)
    else:
        warn_unverified(path, "parameters")


def require_hash(path: Path, now: str, written: str, what: str) -> None:
    """Refuse what a file holds if its hash is another than the one that was written with it.

    Raises
    ------
    InputError
    """
    if now != written:
        raise InputError(
            f"file {path}: {what} must be as pssf wrote them (sha256 {written[:12]}...), got {now[:12]}...: the file "
            "is damaged or was edited; make it again"
        )


def digest_of(masks: Mapping[str, NDArray[np.bool_]]) -> str:
    """Hash names, sizes and pixels of masks (rows, cols), in their order."""
    digest = hashlib.sha256(json.dumps([(name, list(np.shape(mask))) for name, mask in masks.items()]).encode())
    for mask in masks.values():
        digest.update(np.packbits(np.asarray(mask, np.bool_)).tobytes())
    return digest.hexdigest()


def warn_unverified(path: Path, what: str) -> None:
    """Warn of a file by an earlier version, which wrote no hash.

    Warns
    -----
    UnverifiedNotice
    """
    warnings.warn(
        f"file {path}: its {what} have no hash, as of an earlier version; an alteration would not be seen; save it "
        "again",
        UnverifiedNotice,
        stacklevel=4,
    )


def _fields(radiograph: Radiograph) -> dict[str, Any]:
    both = {
        "knees": [knee_table(knee) for knee in radiograph.knees],
        "truths": [_truth_table(truth) for truth in radiograph.truths],
    }
    return {
        "protocol": protocol_table(radiograph.protocol),
        "knee": None if radiograph.knee is None else knee_table(radiograph.knee),
        **(both if radiograph.knees else {}),
        **({} if radiograph.scene is None else {"scene": dict(radiograph.scene)}),
        **({"surgery": [dict(step) for step in radiograph.surgery]} if radiograph.surgery else {}),
        "seed": radiograph.seed,
        "truth": None if radiograph.truth is None else _truth_table(radiograph.truth),
        "engine": radiograph.engine,
        "audit": dict(radiograph.audit),
        "versions": dict(radiograph.versions),
        "pixels": "linear in absorbed energy; row 0 proximal; columns towards +x",
    }


def _truth_table(truth: Truth) -> dict[str, Any]:
    return {
        "jsw_medial_mm": truth.jsw_medial_mm,
        "jsw_lateral_mm": truth.jsw_lateral_mm,
        "jsw_at_mm": {f"{fraction:g}": space for fraction, space in truth.jsw_at_mm.items()},
        "grade": truth.grade,
        "grade_read": truth.grade_read,
        "attrition_mm": dict(truth.attrition_mm),
        "readings": dict(truth.readings),
        "taking": dict(truth.taking),
        "landmarks_px": {name: list(place) for name, place in truth.landmarks_px.items()},
    }


def _truth(entry: _Truth, path: Path) -> Truth:
    fields = msgspec.structs.asdict(entry)
    fields["jsw_at_mm"] = {float(fraction): space for fraction, space in entry.jsw_at_mm.items()}
    if entry.jsw_medial_mm is not None and "medial_jsw_femur" not in entry.landmarks_px:
        warnings.warn(
            f"file {path} was written by an earlier version, whose joint space labels are those of another view; they "
            "are left out; simulate the knee again to get them",
            LabelWarning,
            stacklevel=2,
        )
        readings = {name: value for name, value in entry.readings.items() if not name.startswith("jsw_least_")}
        fields |= {"jsw_medial_mm": None, "jsw_lateral_mm": None, "jsw_at_mm": {}, "readings": readings}
    return Truth(**fields)


def _dumped(fields: dict[str, Any], indent: int | None = None) -> str:
    # Parameters may be numpy's numbers; they are written, and read back, as Python's.
    return json.dumps(fields, indent=indent, default=lambda number: number.item())


def _digest(text: str, pixels: NDArray[Any]) -> str:
    digest = hashlib.sha256(text.encode())
    digest.update(np.ascontiguousarray(pixels, "<u2").tobytes())
    return digest.hexdigest()
