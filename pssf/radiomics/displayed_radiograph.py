"""Measure displayed radiographs: localisation, resampling to a common pixel size, histogram matching and features.

The image is resampled before the histogram is matched. An unknown tone curve then affects the result only through
interpolation and blur of neighbouring pixels.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from time import perf_counter
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from skimage.exposure import match_histograms

from ..core.checks import (
    Array,
    InputError,
    require_choice,
    require_in_range,
    require_integer,
)
from ..core.resample import downsample_by_blocks
from ..data.analysis.localisation_table import LocalisationSettings
from ..data.code_hash import require_same_code
from ..texture import TEXTURE_FAMILIES
from .features.area_features import (
    COARSE,
    measure_areas,
    require_resolved_texture,
    resample_around_plateau,
    resolves_texture,
)
from .features.feature_backends import default_backend
from .features.feature_families import FAMILIES, SQUARE
from .features.feature_table import (
    FILM_COLUMNS,
    JSW_COLUMNS,
    SCORE_COLUMNS,
    ExtractionSettings,
    Measurement,
    MeasurementJob,
    Record,
    make_landmark_columns,
    measure_radiograph,
)
from .localisation.joint_localisation import (
    JointLocation,
    locate_joint,
    scale_to_full_resolution,
)
from .localisation.pixel_aspect import locate_joint_in_film, resample_to_square_pixels
from .localisation.region_placement import locate_joint_by_reader, locate_region
from .localisation.second_knee import has_second_knee
from .localisation.templates import MAX_SEARCH_PIXEL_MM, Template, compute_density
from .radiomics_tables import RadiomicsTables

# Feature families that remain informative after histogram matching; see `match_template_histogram`.
TONE_INVARIANT_FAMILIES = tuple(family for family in FAMILIES if family != "firstorder")
FILM_FAMILIES = (*TONE_INVARIANT_FAMILIES, *TEXTURE_FAMILIES)
UNREADABLE = "unreadable"


class DisplayedImage(Protocol):
    """Interface of a displayed radiograph, such as `io.patients.patient_radiographs.FilmImage`."""

    @property
    def pixels(self) -> Array:
        """Grey values (rows, cols), 0 to 1."""

    @property
    def pixel_mm(self) -> float | None:
        """Pixel size in mm; None if the file does not specify it."""

    @property
    def side(self) -> str | None:
        """Knee side, "right" or "left"; None if the file does not specify it."""


@dataclass(frozen=True, kw_only=True)
class DisplayExtractionSettings:
    """Settings for the measurement of displayed radiographs.

    Parameters
    ----------
    pixel_mm : float
        Pixel size to which radiographs are resampled, 0.02 to 20 mm.
    region_px : int
        Edge length of the region, 16 to 4096 resampled pixels.
    bins : int
        Number of grey-level bins.
    families : tuple of str
        Feature families to measure. First-order features are excluded by default, because they depend on the tone
        curve.
    backend : str
        Feature library, "pyradiomics" or "mirp". The default is pyradiomics if it is installed, else MIRP.
    regions : {"template", "reader"}
        Source of the position of the region.
    areas : tuple of str
        Areas to measure, from `feature_families.AREAS`. Areas other than "square" need landmarks.

    Raises
    ------
    InputError
        A value is out of range, pixels are too large for a texture measure, or no backend is installed.
    """

    pixel_mm: float
    region_px: int
    bins: int = 64
    families: tuple[str, ...] = TONE_INVARIANT_FAMILIES
    backend: str = field(default_factory=default_backend)
    regions: str = "template"
    areas: tuple[str, ...] = (SQUARE,)

    def __post_init__(self) -> None:
        """Check pixel size, region size, the source of the position, and that pixels resolve the texture."""
        require_in_range("pixel_mm of films", self.pixel_mm, 0.02, 20, "mm")
        require_integer("region_px at pixel_mm of films", self.region_px, 16, 4096, "pixels")
        require_choice("regions of films", self.regions, ("template", "reader"))
        require_resolved_texture(self.pixel_mm, self.families)


def require_plateau_width(templates: Sequence[Template]) -> None:
    """Check that the templates have a plateau width, which is required to estimate the pixel size of a radiograph.

    Parameters
    ----------
    templates : sequence of Template
        Template radiographs. The first template is checked.

    Raises
    ------
    InputError
        `templates` is empty, or the first template has no plateau width.
    """
    if not templates or templates[0].plateau_mm is None:
        raise InputError(
            "template plateau_mm must be the width in mm, got plateau_mm = None: pixel size estimation needs the width"
        )


def measure_display(
    job: MeasurementJob,
    *,
    load_pixels: Callable[[str], DisplayedImage],
    templates: Sequence[Template],
    settings: DisplayExtractionSettings,
    tables: RadiomicsTables,
    code: Mapping[str, str],
) -> Measurement:
    """Measure one displayed radiograph.

    Knee side and pixel size come from the job or from the file; if neither specifies them, they are estimated. The
    record has no features if the radiograph cannot be read or no knee is found.

    Parameters
    ----------
    job : MeasurementJob
        Radiograph to measure.
    load_pixels : callable
        Function of file name that returns the displayed image.
    templates : sequence of Template
        Template radiographs. The first template also provides the histogram and the plateau width.
    settings : DisplayExtractionSettings
        Resampling and feature settings.
    tables : RadiomicsTables
        Localisation settings and IBSI tags.
    code : dict of str to str
        Code hashes from `compute_code_hashes` in the process that started the run.

    Returns
    -------
    record : dict of str to object
        Joint location, scores and features, keyed by column name.
    seconds : dict of str to float
        Run time of the steps "localisation" and "features".

    Raises
    ------
    InputError
        The code of this process differs from `code`.
    """
    require_same_code(code)
    began = perf_counter()
    refused = UNREADABLE
    try:
        film = load_pixels(job.file)
        refused = "no knee"  # If localisation raises InputError, the image is too small for a search.
        side, pixel_mm = job.side or film.side, job.pixel_mm or film.pixel_mm
        joint = (
            locate_joint_by_reader(film.pixels, templates[0], side=side, pixel_mm=pixel_mm)
            if settings.regions == "reader"
            else locate_joint_in_display(film.pixels, templates, tables.localisation, side, pixel_mm)
        )
    except InputError:
        nothing: Record = {"radiograph": job.radiograph, "sha256": job.sha256, "status": refused}
        return nothing | dict.fromkeys(FILM_COLUMNS, ""), {"localisation": perf_counter() - began, "features": 0.0}
    located = perf_counter()
    region = (
        cut_resampled_region(film.pixels, joint, settings.pixel_mm, settings.region_px)
        if joint.status == "found"
        else None
    )
    record = _make_record(job, joint, region)
    square = resample_to_square_pixels(film.pixels, joint.pixel_height)
    record["film_knees"] = _count_knees(square, record, joint.pixel_mm, templates, tables.localisation)
    if region is not None:
        bright = region if joint.polarity == "bone bright" else -region
        signal = match_template_histogram(bright, templates[0], settings.pixel_mm)
        to_signal = partial(_convert_grey_values, region=region, signal=signal, bone_dark=joint.polarity == "bone dark")
        record |= _extract(signal, joint, settings, tables, square, to_signal)
        record |= make_landmark_columns(joint, settings.areas)
        if joint.jsw_shares is not None:
            record |= dict(zip(JSW_COLUMNS, joint.jsw_shares, strict=True))
    return record, {"localisation": located - began, "features": perf_counter() - located}


def measure_linear(
    job: MeasurementJob,
    *,
    load_pixels: Callable[[str], NDArray[np.uint16]],
    templates: Sequence[Template],
    settings: DisplayExtractionSettings,
    tables: RadiomicsTables,
    code: Mapping[str, str],
) -> Measurement:
    """Measure one radiograph with linear pixels of any pixel size.

    A radiograph with the pixel size of `settings` is measured without resampling; see `measure_radiograph`.

    Parameters
    ----------
    job : MeasurementJob
        Radiograph to measure, with known side and pixel size.
    load_pixels : callable
        Function of file name that returns linear pixels (rows, cols) in DN.
    templates : sequence of Template
        Template radiographs.
    settings : DisplayExtractionSettings
        Resampling and feature settings.
    tables : RadiomicsTables
        Localisation settings and IBSI tags.
    code : dict of str to str
        Code hashes from `compute_code_hashes` in the process that started the run.

    Returns
    -------
    record : dict of str to object
        Joint location, scores and features, keyed by column name.
    seconds : dict of str to float
        Run time of the steps "localisation" and "features".

    Raises
    ------
    InputError
        The code of this process differs from `code`.
    """
    require_same_code(code)
    assert job.side is not None
    assert job.pixel_mm is not None
    began = perf_counter()
    pixels = load_pixels(job.file)
    if np.isclose(job.pixel_mm, settings.pixel_mm, rtol=1e-6):
        same = {name: value for name, value in vars(settings).items() if name != "pixel_mm"}
        plain = ExtractionSettings(**same)
        record, seconds = measure_radiograph(
            job, load_pixels=lambda _: pixels, templates=templates, settings=plain, tables=tables, code=code
        )
        record |= _make_given_columns(job)
        density = compute_density(pixels)
        return record | {
            "film_knees": _count_knees(density, record, job.pixel_mm, templates, tables.localisation)
        }, seconds
    joint = locate_region(
        pixels,
        templates,
        tables.localisation,
        regions=settings.regions,
        side=job.side,
        pixel_mm=job.pixel_mm,
        region_px=1,
        place_px=None,
    )
    located = perf_counter()
    region = (
        cut_resampled_region(pixels, joint, settings.pixel_mm, settings.region_px) if joint.status == "found" else None
    )
    record = _make_record(job, joint, region) | _make_given_columns(job)
    record["film_knees"] = _count_knees(compute_density(pixels), record, job.pixel_mm, templates, tables.localisation)
    if region is not None:
        signal = np.clip(np.rint(region), 0, 65535).astype(np.uint16)
        record |= _extract(signal, joint, settings, tables, pixels, lambda values: values)
        record |= make_landmark_columns(joint, settings.areas)
    return record, {"localisation": located - began, "features": perf_counter() - located}


def _make_given_columns(job: MeasurementJob) -> Record:
    """Make the record columns for side, polarity and pixel size of a radiograph with linear pixels."""
    said = {"film_side": job.side, "film_polarity": "linear"}
    return said | {"film_pixel_from": "given", "film_pixel_mm": job.pixel_mm}


def _count_knees(
    density: Array, record: Record, pixel_mm: float, templates: Sequence[Template], table: LocalisationSettings
) -> str:
    """Return "two" for a radiograph of both knees, "one" for a single knee, and "" if no knee is found.

    `density` (rows, cols) has square pixels of size `pixel_mm`, in any unit.
    """
    if record["status"] != "found":
        return ""
    two = has_second_knee(density, str(record["film_side"]), float(record["col_px"]), pixel_mm, templates, table)
    return "two" if two else "one"


def _make_record(job: MeasurementJob, joint: JointLocation, region: Array | None) -> Record:
    """Make the localisation columns of a record; status is "leaves image" if the region extends beyond the image."""
    status = "leaves image" if joint.status == "found" and region is None else joint.status
    record: Record = {"radiograph": job.radiograph, "sha256": job.sha256, "status": status}
    record |= {"film_side": joint.side, "film_polarity": joint.polarity}
    record |= {"film_pixel_from": joint.pixel_mm_source, "film_pixel_mm": joint.pixel_mm}
    return record | {"row_px": joint.row, "col_px": joint.col, **{name: getattr(joint, name) for name in SCORE_COLUMNS}}


def locate_joint_in_display(
    pixels: Array, templates: Sequence[Template], table: LocalisationSettings, side: str | None, pixel_mm: float | None
) -> JointLocation:
    """Locate the joint in a displayed radiograph; see `locate_joint_in_film`.

    Parameters
    ----------
    pixels : (rows, cols) array, grey
        Grey values, 0 to 1, of either polarity.
    templates : sequence of Template
        Template radiographs.
    table : LocalisationSettings
        Search settings and thresholds.
    side : {"right", "left"} or None
        Left or right knee; None if unknown.
    pixel_mm : float or None
        Pixel size, in mm; None if unknown.

    Returns
    -------
    JointLocation
        Location of the joint, in pixels of the radiograph.

    Raises
    ------
    InputError
        The arguments are invalid; see `locate_joint`.
    """
    step = 1 if pixel_mm is None else max(1, int(MAX_SEARCH_PIXEL_MM / pixel_mm))
    if step == 1:
        return locate_joint_in_film(pixels, templates, table, side=side, pixel_mm=pixel_mm)
    assert pixel_mm is not None
    joint = locate_joint(downsample_by_blocks(pixels, step), templates, table, side=side, pixel_mm=pixel_mm * step)
    return scale_to_full_resolution(joint, step, pixel_mm)


def cut_resampled_region(
    pixels: NDArray[np.integer | np.floating], joint: JointLocation, pixel_mm: float, region_px: int
) -> Array | None:
    """Resample the square region around the joint line to another pixel size, without aliasing.

    A Gaussian filter removes detail that the new pixel size cannot represent. Cubic splines interpolate between pixels.

    Parameters
    ----------
    pixels : (rows, cols) array, any unit
        Displayed or linear pixels.
    joint : JointLocation
        Location of the medial joint line.
    pixel_mm : float
        Pixel size of the region, in mm.
    region_px : int
        Edge length of the region, in resampled pixels.

    Returns
    -------
    (region_px, region_px) array or None
        Region with the joint line at the centre of pixel region_px // 2; None if the region extends beyond the image.
    """
    pixels, ratio = resample_to_square_pixels(pixels, joint.pixel_height), pixel_mm / joint.pixel_mm
    offsets = (np.arange(region_px) - region_px // 2) * ratio
    rows, cols = joint.square_pixel_row + offsets, joint.col + offsets
    for places, length in ((rows, pixels.shape[0]), (cols, pixels.shape[1])):
        if places[0] < -0.5 or places[-1] > length - 0.5:
            return None
    soft = pixels.astype(np.float64)
    if ratio > 1.0:
        soft = ndimage.gaussian_filter(soft, 0.5 * np.sqrt(ratio**2 - 1.0), mode="nearest")
    return np.asarray(
        ndimage.map_coordinates(soft, np.meshgrid(rows, cols, indexing="ij"), order=3, mode="nearest"), np.float64
    )


def _convert_grey_values(values: Array, *, region: Array, signal: NDArray[np.uint16], bone_dark: bool) -> Array:
    """Convert grey values (rows, cols) to DN by the tone curve between a region and its signal, both (size, size)."""
    sign = -1.0 if bone_dark else 1.0
    grey, signals = np.sort(sign * region, axis=None), np.sort(signal, axis=None)[::-1].astype(np.float64)
    return np.asarray(np.interp(sign * values, grey, signals))


def _extract(
    signal: NDArray[np.uint16],
    joint: JointLocation,
    settings: DisplayExtractionSettings,
    tables: RadiomicsTables,
    pixels: NDArray[np.generic],
    to_signal: Callable[[Array], Array],
) -> dict[str, Any]:
    """Measure a resampled region (region_px, region_px), and the areas of the image (rows, cols) of which it is part.

    `to_signal` converts grey values of the image to the signal of the region, in DN.
    """
    # Resampling cannot restore detail that larger pixels have lost.
    if not resolves_texture(joint.pixel_mm, settings.families):
        return {"status": COARSE}
    whole, moved = signal, joint
    if set(settings.areas) != {SQUARE}:
        resampled, moved = resample_around_plateau(pixels, joint, settings.pixel_mm)
        whole = np.clip(np.rint(to_signal(resampled)), 0, 65535).astype(np.uint16)
    bones = _cut_bones(joint, settings)
    return measure_areas(whole, signal, moved, settings.pixel_mm, tables.tags, settings=settings, bones=bones)


def _cut_bones(joint: JointLocation, settings: DisplayExtractionSettings) -> NDArray[np.bool_] | None:
    """Resample the masks of the bones, if there are any, to the region that is measured."""
    if joint.bones is None:
        return None
    region = cut_resampled_region(joint.bones.astype(np.float32), joint, settings.pixel_mm, settings.region_px)
    return None if region is None else region > 0.5


def match_template_histogram(region: Array, template: Template, pixel_mm: float) -> NDArray[np.uint16]:
    """Match the histogram of a displayed region to the histogram of a template region (Gonzalez and Woods 2018, 3.3).

    The tone curve of a displayed radiograph is unknown: the grey value may be any increasing function of the signal.
    Histogram matching inverts the tone curve, except where the curve is flat. First-order features then contain no
    information, because they are equal to the template features.

    Parameters
    ----------
    region : (size, size) array, grey
        Displayed grey values, bone bright.
    template : Template
        Template whose signal provides the histogram.
    pixel_mm : float
        Pixel size of the region, in mm.

    Returns
    -------
    (size, size) uint16 array
        Estimated linear signal, in DN.
    """
    half_mm = region.shape[0] * pixel_mm / 2
    signal = _cut_template_region(template, half_mm)
    matched = match_histograms(-region, signal)
    return np.clip(np.rint(matched), 0, 65535).astype(np.uint16)


def _cut_template_region(template: Template, half_mm: float) -> Array:
    """Cut out the linear signal (rows, cols) of a template within `half_mm` of the medial joint line."""
    reach = half_mm / template.pixel_mm
    top, left = (max(0, round(at - reach)) for at in (template.row, template.col))
    bottom, right = (round(at + reach) for at in (template.row, template.col))
    return np.asarray(template.pixels[top:bottom, left:right], np.float64)
