"""What a file says of its radiograph: all that it was made from, what is known about it, and a hash over that and the
pixels, so that a bit that was flipped is seen."""

import hashlib
import json
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
    knees: tuple[dict[str, Any], ...] = ()
    truths: tuple[_Truth, ...] = ()
    scene: dict[str, Any] | None = None
    surgery: tuple[dict[str, Any], ...] = ()


def as_json(radiograph: Radiograph, indent: int | None = None) -> str:
    """All that a radiograph was made from, what is known about it, and a hash over that and its pixels."""
    fields = _fields(radiograph)
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
        "truths": tuple(map(_truth, described.truths)),
        "scene": described.scene,
        "surgery": described.surgery,
        "knee": None if described.knee is None else knee_from(described.knee, where),
        "truth": None if described.truth is None else _truth(described.truth),
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


def _truth(entry: _Truth) -> Truth:
    spaces = {float(fraction): space for fraction, space in entry.jsw_at_mm.items()}
    return Truth(**{**msgspec.structs.asdict(entry), "jsw_at_mm": spaces})


def _dumped(fields: dict[str, Any], indent: int | None = None) -> str:
    # Parameters may be numpy's numbers; they are written, and read back, as Python's.
    return json.dumps(fields, indent=indent, default=lambda number: number.item())


def _digest(text: str, pixels: NDArray[Any]) -> str:
    digest = hashlib.sha256(text.encode())
    digest.update(np.ascontiguousarray(pixels, "<u2").tobytes())
    return digest.hexdigest()
