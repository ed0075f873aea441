"""Radiographs on disk: 16-bit TIFF that carries all it was made from, PNG for eyes."""

import json
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
import tifffile
from PIL import Image, PngImagePlugin

from ..checks import InputError
from ..detector import present
from ..knee import knee_from, knee_table
from ..protocol import protocol_from, protocol_table
from ..radiograph import Radiograph, Truth
from .atomic import write_bytes, writing

SUFFIXES = (".tif", ".tiff", ".png")


def save(radiograph: Radiograph, path: str | Path) -> Path:
    """Write a radiograph, by suffix: .tif (16 bit, linear, with all parameters) or .png (8 bit, for eyes).

    raises  InputError for another suffix, or a disk that is full or cannot be written
    """
    path = Path(path)
    suffix = path.suffix.lower()
    if suffix not in SUFFIXES:
        raise InputError(f"file {path}: suffix {suffix!r}; allowed: {', '.join(SUFFIXES)}")
    with writing(path) as temporary:
        if suffix == ".png":
            note = PngImagePlugin.PngInfo()
            note.add_text("Description", _as_json(radiograph))
            Image.fromarray(present(radiograph.pixels)).save(temporary, format="PNG", pnginfo=note)
        else:
            per_cm = float(10.0 / radiograph.protocol.pixel_mm)
            tifffile.imwrite(
                temporary,
                radiograph.pixels,
                photometric="minisblack",
                resolution=(per_cm, per_cm),
                resolutionunit="CENTIMETER",
                software=f"pssf {version('pssf')}",
                description=_as_json(radiograph),
                metadata=None,
            )
    return path


def load(path: str | Path) -> Radiograph:
    """A radiograph from a TIFF that `save` wrote: the same pixels, protocol, knee, seed, truth, audit and versions.

    raises  InputError for a file that is missing, damaged, or not written by this package
    """
    try:
        with tifffile.TiffFile(path) as tiff:
            page = tiff.pages[0]
            pixels, text = page.asarray(), page.description  # type: ignore[union-attr]
        told = json.loads(text)
        return Radiograph(
            pixels=np.asarray(pixels, np.uint16),
            protocol=protocol_from(told["protocol"], f"file {path}"),
            seed=told["seed"],
            knee=None if told["knee"] is None else knee_from(told["knee"], f"file {path}"),
            truth=None if told["truth"] is None else _truth(told["truth"]),
            engine=told["engine"],
            audit=told["audit"],
            versions=told["versions"],
        )
    except InputError:
        raise
    except OSError as error:
        raise InputError(f"file {path}: {error.strerror or error}; allowed: a readable TIFF by pssf") from None
    except Exception as error:  # a damaged TIFF can fail anywhere in its reader
        reason = f"{type(error).__name__}: {error}".splitlines()[0]
        raise InputError(f"file {path}: damaged or not by pssf ({reason}); allowed: a TIFF by pssf") from None


def description(radiograph: Radiograph) -> dict[str, Any]:
    """All that a radiograph was made from and what is known about it, JSON-ready."""
    truth = radiograph.truth
    return {
        "protocol": protocol_table(radiograph.protocol),
        "knee": None if radiograph.knee is None else knee_table(radiograph.knee),
        "seed": radiograph.seed,
        "truth": None
        if truth is None
        else {
            "jsw_medial_mm": truth.jsw_medial_mm,
            "jsw_lateral_mm": truth.jsw_lateral_mm,
            "jsw_at_mm": {f"{fraction:g}": space for fraction, space in truth.jsw_at_mm.items()},
            "grade": truth.grade,
            "landmarks_px": {name: list(place) for name, place in truth.landmarks_px.items()},
        },
        "engine": radiograph.engine,
        "audit": dict(radiograph.audit),
        "versions": dict(radiograph.versions),
        "pixels": "linear in absorbed energy; row 0 proximal; columns towards +x",
    }


def save_parameters(radiograph: Radiograph, path: str | Path) -> Path:
    """Write all that a radiograph was made from as JSON.

    raises  InputError for a disk that is full or cannot be written
    """
    path = Path(path)
    write_bytes(path, (_as_json(radiograph, indent=2) + "\n").encode())
    return path


def _as_json(radiograph: Radiograph, indent: int | None = None) -> str:
    # Parameters may be numpy's numbers; they are written, and read back, as Python's.
    return json.dumps(description(radiograph), indent=indent, default=lambda number: number.item())


def _truth(table: dict[str, Any]) -> Truth:
    spots = {name: (float(row), float(col)) for name, (row, col) in table["landmarks_px"].items()}
    spaces = {float(fraction): space for fraction, space in table["jsw_at_mm"].items()}
    return Truth(**{**table, "landmarks_px": spots, "jsw_at_mm": spaces})
