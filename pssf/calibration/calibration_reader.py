"""Read the images and the table of steps of a calibration from files."""

import re
from collections.abc import Sequence
from dataclasses import fields
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..core.checks import InputError
from ..io.csv_rows import read_csv_rows
from ..io.patients.stored_pixels import read_linear_pixels
from .calibration_images import CalibrationImages, Step, Wedge

# Largest difference between the pixel pitches of files of one detector, in mm.
_SAME_PIXEL_MM = 1e-4
# Last number in the name of a file, which is the tube voltage of a wedge image.
_LAST_NUMBER = re.compile(r"(\d+(?:[.p]\d+)?)(?=\D*$)")


def read_calibration_images(
    *,
    darks: Sequence[Path] = (),
    radiographs: Sequence[Path] = (),
    flats: Sequence[Path] = (),
    flat_mas: Sequence[float] = (),
    edge: Path | None = None,
    wedges: Sequence[Path] = (),
    wedge_kv: Sequence[float] = (),
    steps: Path | None = None,
    step_material: str = "Al@2.70",
    pixel_mm: float | None = None,
    default_pixel_mm: float = 0.15,
) -> CalibrationImages:
    """Read the images of a calibration.

    Parameters
    ----------
    darks, radiographs, flats : sequence of Path
        TIFF, PNG or DICOM files with linear pixels. Flat fields are sorted by the numbers in their names.
    flat_mas : sequence of float
        mAs of each flat field, in the order of the sorted names.
    edge : Path, optional
        Image of a slanted edge.
    wedges : sequence of Path
        Images of a step wedge, each at another tube voltage.
    wedge_kv : sequence of float
        Tube voltage of each wedge image, in kV. The default is the last number in the name of each file.
    steps : Path, optional
        CSV file with the columns thickness_mm, top, bottom, left and right.
    step_material : str, default "Al@2.70"
        Material of the wedge.
    pixel_mm : float, optional
        Pixel pitch, in mm. The default is that of the DICOM files.
    default_pixel_mm : float, default 0.15
        Pixel pitch if neither `pixel_mm` nor a DICOM file specifies it, in mm.

    Returns
    -------
    CalibrationImages
        Images and settings.

    Raises
    ------
    InputError
        If a file cannot be read, has no linear pixels, or does not belong to the others.
    """
    pitches_mm: set[float] = set()

    def read(path: Path) -> NDArray[np.uint16]:
        stored = read_linear_pixels(path)
        if stored.pixel_mm is not None:
            pitches_mm.add(stored.pixel_mm)
        return stored.pixels

    if wedges and steps is None:
        raise InputError(f"steps must be a CSV file if there are wedge images, got {steps}")
    kvs = list(wedge_kv) or [_parse_kv(path) for path in wedges]
    if len(kvs) != len(wedges):
        raise InputError(f"wedge-kv must be one number per wedge image, got {len(kvs)} for {len(wedges)}")
    images = {
        "darks": tuple(read(path) for path in darks),
        "radiographs": tuple(read(path) for path in radiographs),
        "flats": tuple(read(path) for path in sorted(flats, key=natural_key)),
    }
    edge_pixels = None if edge is None else read(edge)
    wedge_images = tuple(Wedge(image=read(path), tube_kv=kv) for path, kv in zip(wedges, kvs, strict=True))
    return CalibrationImages(
        pixel_mm=pixel_mm or _choose_pixel_mm(pitches_mm, default_pixel_mm),
        **images,
        flat_mas=tuple(flat_mas),
        edge=edge_pixels,
        wedges=wedge_images,
        steps=read_steps(steps) if steps is not None else (),
        step_material=step_material,
    )


def natural_key(path: Path) -> tuple[object, ...]:
    """Make a sort key by which flat_2 comes before flat_10.

    Parameters
    ----------
    path : Path
        Path of a file.

    Returns
    -------
    tuple
        Parts of the name, with numbers as numbers.
    """
    parts = re.split(r"(\d+(?:\.\d+)?)", path.stem)
    return tuple((1, float(part), "") if number % 2 else (0, 0.0, part) for number, part in enumerate(parts))


def _parse_kv(path: Path) -> float:
    """Parse the tube voltage in kV from the last number in the name of a file, such as wedge_70.tif."""
    match = _LAST_NUMBER.search(path.stem)
    if match is None:
        raise InputError(f"file {path} must end with its tube voltage, such as wedge_70.tif, or use --wedge-kv")
    return float(match.group(1).replace("p", "."))


def _choose_pixel_mm(pitches_mm: set[float], default_mm: float) -> float:
    """Return the pixel pitch in mm that all DICOM files have, or the default."""
    if not pitches_mm:
        return default_mm
    if max(pitches_mm) - min(pitches_mm) > _SAME_PIXEL_MM:
        raise InputError(f"files must have the same pixel pitch, got {min(pitches_mm):g} and {max(pitches_mm):g} mm")
    return min(pitches_mm)


def read_steps(path: Path) -> tuple[Step, ...]:
    """Read the steps of a wedge from a CSV file.

    Parameters
    ----------
    path : Path
        File with one row per step and the columns thickness_mm (mm), top, bottom, left and right (pixels).

    Returns
    -------
    tuple of Step
        Steps in the order of the file.

    Raises
    ------
    InputError
        If the file cannot be read, a column is missing, or a value is not a number.
    """
    columns, rows = read_csv_rows(path)
    wanted = [field.name for field in fields(Step)]
    missing = [name for name in wanted if name not in columns]
    if missing:
        raise InputError(f"file {path} must have the columns {', '.join(wanted)}, got no {', '.join(missing)}")
    steps = []
    for number, row in enumerate(rows, start=2):
        try:
            values = {name: float(row[name]) for name in wanted}
        except ValueError:
            raise InputError(f"file {path}, line {number}: values must be numbers, got {list(row.values())}") from None
        regions = {name: int(value) for name, value in values.items() if name != "thickness_mm"}
        steps.append(Step(thickness_mm=values["thickness_mm"], **regions))
    return tuple(steps)
