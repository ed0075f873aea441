"""Radiographs as displayed, films of any source among them: found, brought to one pitch and one tone, and measured.

The pitch comes first, so that a tone curve shows in what interpolation and blur make of neighbours, and nowhere else.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from time import perf_counter
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from skimage.exposure import match_histograms

from ..core.blocks import block_mean
from ..core.checks import Array, InputError, require, require_whole
from ..data.code import require_code
from ..data.localisation import Localisation
from .aspect import locate_film, with_square_pixels
from .backends import default_backend
from .families import FAMILIES
from .features import extract
from .locate import Located, find_joint, in_pixels, locate
from .patches import LINEAR_MM, Template, density_of
from .second_knee import shows_other_knee
from .table import FOUND, SCORES, How, Job, Measured, Record, measure
from .tables import RadiomicsTables

# What a tone without a meaning says nothing of; see `as_signal`.
TONELESS = tuple(family for family in FAMILIES if family != "firstorder")
UNREADABLE = "unreadable"


class Displayed(Protocol):
    """A radiograph as displayed; `io.films.FilmImage` is one."""

    @property
    def pixels(self) -> Array:
        """(rows, cols) 0 to 1"""

    @property
    def pixel_mm(self) -> float | None:
        """Pitch, where the file says so."""

    @property
    def side(self) -> str | None:
        """right | left, where the file says so."""


@dataclass(frozen=True, kw_only=True)
class DisplayHow:
    """How a radiograph as displayed is measured: everything but its pixels that a record depends on.

    pixel_mm   pitch that it is brought to
    region_px  side of the region at that pitch
    raises     InputError for a value out of range
    """

    pixel_mm: float
    region_px: int
    bins: int = 64
    families: tuple[str, ...] = TONELESS
    backend: str = field(default_factory=default_backend)

    def __post_init__(self) -> None:
        require("films' pixel_mm", self.pixel_mm, 0.02, 20, "mm")
        require_whole("region_px at films' pixel_mm", self.region_px, 16, 4096, "pixels")


def require_plateau(templates: Sequence[Template]) -> None:
    """Refuse templates by which the pitch of a film cannot be estimated.

    raises  InputError
    """
    if not templates or templates[0].plateau_mm is None:
        raise InputError("template plateau_mm = None; allowed: its width, mm, to estimate the pitch of films by")


def measure_display(
    job: Job,
    *,
    load_pixels: Callable[[str], Displayed],
    templates: Sequence[Template],
    how: DisplayHow,
    tables: RadiomicsTables,
    code: Mapping[str, str],
) -> Measured:
    """The record of one radiograph as displayed, and the seconds each step took.

    Side and pitch are as the job gives them, else as the file does, else as they are found.

    tables  by which the joint is found and features known
    code    of `code_digest` where the run started
    raises  InputError where the code is another here
    """
    require_code(code)
    began = perf_counter()
    refused = UNREADABLE
    try:
        film = load_pixels(job.file)
        refused = "no knee"  # in what is so small that no knee can be looked for
        side, pixel_mm = job.side or film.side, job.pixel_mm or film.pixel_mm
        joint = find_in_display(film.pixels, templates, tables.localisation, side, pixel_mm)
    except InputError:
        nothing: Record = {"radiograph": job.radiograph, "sha256": job.sha256, "status": refused}
        return nothing | dict.fromkeys(FOUND, ""), {"localisation": perf_counter() - began, "features": 0.0}
    located = perf_counter()
    region = cut_display(film.pixels, joint, how.pixel_mm, how.region_px) if joint.status == "found" else None
    record = _record(job, joint, region)
    square = with_square_pixels(film.pixels, joint.pixel_height)
    record["film_knees"] = _knees(square, record, joint.pixel_mm, templates, tables.localisation)
    if region is not None:
        bright = region if joint.polarity == "bone bright" else -region
        signal = as_signal(bright, templates[0], how.pixel_mm)
        record |= extract(signal, how.pixel_mm, tables.tags, how.bins, how.families, how.backend)
    return record, {"localisation": located - began, "features": perf_counter() - located}


def measure_linear(
    job: Job,
    *,
    load_pixels: Callable[[str], NDArray[np.uint16]],
    templates: Sequence[Template],
    how: DisplayHow,
    tables: RadiomicsTables,
    code: Mapping[str, str],
) -> Measured:
    """`table.measure` of a radiograph of any pitch: at the one asked for, pixel by pixel; else brought to it.

    load_pixels  file -> (rows, cols) linear
    raises       InputError where the code is another here
    """
    require_code(code)
    assert job.side is not None
    assert job.pixel_mm is not None
    if np.isclose(job.pixel_mm, how.pixel_mm, rtol=1e-6):
        plain = How(region_px=how.region_px, bins=how.bins, families=how.families, backend=how.backend)
        record, seconds = measure(
            job, load_pixels=load_pixels, templates=templates, how=plain, tables=tables, code=code
        )
        record |= _said(job)
        density = density_of(load_pixels(job.file))
        return record | {"film_knees": _knees(density, record, job.pixel_mm, templates, tables.localisation)}, seconds
    began = perf_counter()
    pixels = load_pixels(job.file)
    joint = find_joint(pixels, templates, tables.localisation, side=job.side, pixel_mm=job.pixel_mm, region_px=1)
    located = perf_counter()
    region = cut_display(pixels, joint, how.pixel_mm, how.region_px) if joint.status == "found" else None
    record = _record(job, joint, region) | _said(job)
    record["film_knees"] = _knees(density_of(pixels), record, job.pixel_mm, templates, tables.localisation)
    if region is not None:
        signal = np.clip(np.rint(region), 0, 65535).astype(np.uint16)
        record |= extract(signal, how.pixel_mm, tables.tags, how.bins, how.families, how.backend)
    return record, {"localisation": located - began, "features": perf_counter() - located}


def _said(job: Job) -> Record:
    said = {"film_side": job.side, "film_polarity": "linear"}
    return said | {"film_pixel_from": "given", "film_pixel_mm": job.pixel_mm}


def _knees(density: Array, record: Record, pixel_mm: float, templates: Sequence[Template], table: Localisation) -> str:
    """Count the knees on a film of which one is read: "one" or "two"; "" where none is read.

    density   (rows, cols) square pixels
    pixel_mm  their pitch
    """
    if record["status"] != "found":
        return ""
    two = shows_other_knee(density, str(record["film_side"]), float(record["col_px"]), pixel_mm, templates, table)
    return "two" if two else "one"


def _record(job: Job, joint: Located, region: Array | None) -> Record:
    status = "leaves image" if joint.status == "found" and region is None else joint.status
    record: Record = {"radiograph": job.radiograph, "sha256": job.sha256, "status": status}
    record |= {"film_side": joint.side, "film_polarity": joint.polarity}
    record |= {"film_pixel_from": joint.pixel_from, "film_pixel_mm": joint.pixel_mm}
    return record | {"row_px": joint.row, "col_px": joint.col, **{name: getattr(joint, name) for name in SCORES}}


def find_in_display(
    pixels: Array, templates: Sequence[Template], table: Localisation, side: str | None, pixel_mm: float | None
) -> Located:
    """`locate_film` on a display; row, column and pitch are those of its own pixels.

    pixels    (rows, cols) share of white, 0 to 1, of either polarity
    pixel_mm  pitch; None where it is not known
    raises    InputError as `locate`
    """
    step = 1 if pixel_mm is None else max(1, int(LINEAR_MM / pixel_mm))
    if step == 1:
        return locate_film(pixels, templates, table, side=side, pixel_mm=pixel_mm)
    assert pixel_mm is not None
    joint = locate(block_mean(pixels, step), templates, table, side=side, pixel_mm=pixel_mm * step)
    return in_pixels(joint, step, pixel_mm)


def cut_display(
    pixels: NDArray[np.integer | np.floating], joint: Located, pixel_mm: float, region_px: int
) -> Array | None:
    """The square about the joint line at another pitch, without aliases; None where it leaves the film.

    A Gaussian takes away what the new pitch cannot hold; cubic splines lie between the pixels.

    pixels    (rows, cols) as displayed or linear, any unit
    pixel_mm  pitch to bring it to
    returns   (region_px, region_px) of whose pixel region_px // 2 the joint line is the centre
    """
    pixels, ratio = with_square_pixels(pixels, joint.pixel_height), pixel_mm / joint.pixel_mm
    offsets = (np.arange(region_px) - region_px // 2) * ratio
    rows, cols = joint.square_row + offsets, joint.col + offsets
    for places, length in ((rows, pixels.shape[0]), (cols, pixels.shape[1])):
        if places[0] < -0.5 or places[-1] > length - 0.5:
            return None
    soft = pixels.astype(np.float64)
    if ratio > 1.0:
        soft = ndimage.gaussian_filter(soft, 0.5 * np.sqrt(ratio**2 - 1.0), mode="nearest")
    return np.asarray(
        ndimage.map_coordinates(soft, np.meshgrid(rows, cols, indexing="ij"), order=3, mode="nearest"), np.float64
    )


def as_signal(region: Array, template: Template, pixel_mm: float) -> NDArray[np.uint16]:
    """(size, size) linear  a region as displayed, under the tone that gives it the histogram of the template's region.

    What a film's grey values mean is not known: any rising curve may lie between them and the signal. So that curve is
    taken which makes each signal as frequent as in the standard knee (histogram matching: Gonzalez and Woods 2018,
    3.3). What is left does not depend on the tone curve, but where that is flat, and says nothing by its first-order
    statistics, which are those of the template.

    region    (size, size) grey, bone bright
    pixel_mm  its pitch
    """
    half_mm = region.shape[0] * pixel_mm / 2
    signal = _about(template, half_mm)
    matched = match_histograms(-region, signal)
    return np.clip(np.rint(matched), 0, 65535).astype(np.uint16)


def _about(template: Template, half_mm: float) -> Array:
    """(rows, cols)  the template's linear signal within so much of its joint line."""
    reach = half_mm / template.pixel_mm
    top, left = (max(0, round(at - reach)) for at in (template.row, template.col))
    bottom, right = (round(at + reach) for at in (template.row, template.col))
    return np.asarray(template.pixels[top:bottom, left:right], np.float64)
