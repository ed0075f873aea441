"""Joint location from the landmarks of the reader, or from the true labels of a simulated radiograph.

These replace the search with templates (`joint_localisation`).
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ...core.checks import Array, InputError
from ...core.label_names import TIBIAL_LANDMARKS
from ...data.analysis.localisation_table import LocalisationSettings
from ...io.cohort_records import hash_file
from ...reader.knee_frame import PLATEAU_EDGES, fit_frame
from ...reader.knee_reading import (
    LANDMARK_FILE,
    LOCATOR_FILE,
    SIDE_FILE,
    KneeReading,
    Reader,
    load_reader,
    read_knees,
)
from ...reader.reader_table import PACKAGE_FOLDER, TABLE_FILE
from .joint_localisation import ORIENTATIONS, JointLocation, Landmarks, locate_joint_in_radiograph
from .region_of_interest import region_fits
from .templates import Template, compute_density

# Source of the position of a region: search with templates, landmarks of the reader, or true labels.
REGIONS = ("template", "reader", "truth")
# Row and column of the medial joint line relative to the middle between the landmarks `femur_medial_condyle` and
# `tibia_medial_1`, in the frame of a right knee, as fractions of the plateau width: means over 2,000 simulated
# radiographs in fixed flexion (SD 0.3 and 1.1 mm).
_MEDIAL_LINE_OFFSET = (-0.0059, -0.0355)
# Width of the tissue beside the bones that is compared with the bones, as a fraction of the plateau width.
_BESIDE = 0.15


def hash_reader() -> list[str]:
    """Return the SHA-256 hash of each file of the networks of the package.

    Returns
    -------
    list of str
        Hashes.

    Raises
    ------
    InputError
        A file is missing.
    """
    return [hash_file(PACKAGE_FOLDER / name) for name in (LOCATOR_FILE, SIDE_FILE, LANDMARK_FILE, TABLE_FILE)]


def locate_region(
    pixels: NDArray[np.integer | np.floating],
    templates: Sequence[Template],
    table: LocalisationSettings,
    *,
    regions: str,
    side: str,
    pixel_mm: float,
    region_px: int,
    place_px: tuple[float, float] | None,
    landmarks_px: Landmarks | None = None,
) -> JointLocation:
    """Locate the joint in the linear pixels of a radiograph, by the chosen source.

    Parameters
    ----------
    pixels : (rows, cols) array, DN
        Linear pixels.
    templates : sequence of Template
        Template radiographs.
    table : LocalisationSettings
        Search settings and thresholds.
    regions : {"template", "reader", "truth"}
        Source of the position.
    side : {"right", "left"}
        Left or right knee.
    pixel_mm : float
        Pixel size, in mm.
    region_px : int
        Edge length of the region that must be inside the image, in pixels.
    place_px : (row, column) tuple or None
        True position of the medial joint line, in pixels; None if unknown.
    landmarks_px : dict of str to (row, column) tuple, optional
        True landmarks of the tibia, in pixels; only `regions` "truth" uses them.

    Returns
    -------
    JointLocation
        Location of the joint.

    Raises
    ------
    InputError
        The true position is required and unknown, or the networks of the reader are missing.
    """
    if regions == "truth":
        if place_px is None:
            raise InputError("regions = 'truth' needs simulated radiographs with labels, got no true position")
        true = locate_joint_at(place_px, pixels.shape, side=side, pixel_mm=pixel_mm, region_px=region_px)
        return replace(true, landmarks_px=landmarks_px)
    if regions == "reader":
        density = compute_density(pixels)
        return locate_joint_by_reader(density, templates[0], side=side, pixel_mm=pixel_mm, region_px=region_px)
    return locate_joint_in_radiograph(pixels, templates, table, side=side, pixel_mm=pixel_mm, region_px=region_px)


def locate_joint_by_reader(
    pixels: NDArray[np.integer | np.floating],
    template: Template,
    *,
    side: str | None,
    pixel_mm: float | None,
    region_px: int = 1,
    reader: Reader | None = None,
) -> JointLocation:
    """Locate the medial joint line by the landmarks of the reader.

    Parameters
    ----------
    pixels : (rows, cols) array, grey
        Grey values of either polarity; linear pixels must be converted to a density (`templates.compute_density`).
    template : Template
        Template radiograph; its plateau width gives the scale, or the pixel size if it is unknown.
    side : {"right", "left"} or None
        Left or right knee; None if unknown.
    pixel_mm : float or None
        Pixel size, in mm; None if unknown.
    region_px : int, default 1
        Edge length of the region that must be inside the image, in pixels.
    reader : Reader, optional
        Networks; None: the networks of the package.

    Returns
    -------
    JointLocation
        Location of the joint. `score` is the score of the knee, `compartment_score` the median confidence of the
        landmarks, and the margins are 1 or -1. The position is NaN if no knee was read. `bones`,
        `landmarks_px` and `jsw_shares` are those of the reader.

    Raises
    ------
    InputError
        The networks are missing.
    """
    knees = read_knees(pixels.astype(np.float32), None, load_reader() if reader is None else reader)
    if not knees:
        return _make_location("no knee", side or "right", pixel_mm or 1.0)
    of_side = [knee for knee in knees if side in (None, knee.side)]
    knee = max(of_side or knees, key=lambda one: one.score)
    row, col = find_medial_joint_line(knee)
    if not of_side:
        status = "wrong side"
    elif knee.refusal:
        status = "low score"
    else:
        status = "found" if region_fits(pixels.shape, row, col, region_px) else "leaves image"
    width_px = knee.measures.plateau_width_px
    scale = 1.0
    if pixel_mm is not None and template.plateau_mm is not None:
        scale = width_px * pixel_mm / template.plateau_mm
    location = _make_location(
        status,
        knee.side,
        pixel_mm or template.known_plateau_mm / width_px,
        row=row,
        col=col,
        score=knee.score,
        compartment_score=float(np.median(list(knee.confidence.values()))),
        agrees=bool(of_side),
        polarity=find_polarity(pixels, knee),
        scale=scale,
        pixel_mm_source="plateau" if pixel_mm is None else "given",
    )
    tibia = {name: knee.landmarks_px[name] for name in TIBIAL_LANDMARKS}
    return replace(
        location,
        bones=knee.masks["femur"] | knee.masks["tibia"],
        landmarks_px=tibia,
        jsw_shares=(knee.measures.medial_jsw_share, knee.measures.lateral_jsw_share),
    )


def locate_joint_at(
    place_px: tuple[float, float], shape: tuple[int, ...], *, side: str, pixel_mm: float, region_px: int
) -> JointLocation:
    """Return the joint location at the true medial joint line of a simulated radiograph.

    Parameters
    ----------
    place_px : (row, column) tuple
        Position of the medial joint line, in pixels.
    shape : tuple of int
        Rows and columns of the radiograph.
    side : {"right", "left"}
        Left or right knee.
    pixel_mm : float
        Pixel size, in mm.
    region_px : int
        Edge length of the region that must be inside the image, in pixels.

    Returns
    -------
    JointLocation
        Location with scores of 1.
    """
    row, col = place_px
    status = "found" if region_fits(shape, row, col, region_px) else "leaves image"
    return _make_location(status, side, pixel_mm, row=row, col=col, score=1.0, compartment_score=1.0)


def find_medial_joint_line(knee: KneeReading) -> tuple[float, float]:
    """Find the middle of the medial joint space at the centre of the compartment.

    Parameters
    ----------
    knee : KneeReading
        Reading.

    Returns
    -------
    row, col : float
        Position, in pixels.
    """
    places = np.array(list(knee.landmarks_px.values()))
    frame = fit_frame(places[PLATEAU_EDGES], knee.side)
    ends = [knee.landmarks_px[name] for name in ("femur_medial_condyle", "tibia_medial_1")]
    middle = frame.map_to_crop(np.array(ends), 1.0, 1).mean(axis=0)
    row, col = frame.map_to_image((middle + _MEDIAL_LINE_OFFSET)[None], 1.0, 1)[0]
    return float(row), float(col)


def find_polarity(pixels: NDArray[np.integer | np.floating], knee: KneeReading) -> str:
    """Find whether bones are brighter than the tissue beside them.

    Parameters
    ----------
    pixels : (rows, cols) array, grey
        Grey values.
    knee : KneeReading
        Reading, with the masks of the bones.

    Returns
    -------
    {"bone bright", "bone dark"}
        Polarity.
    """
    bones = np.logical_or.reduce([*knee.masks.values()])
    rows, cols = np.flatnonzero(bones.any(axis=1)), np.flatnonzero(bones.any(axis=0))
    if not rows.size:
        return "bone bright"
    margin = round(_BESIDE * knee.measures.plateau_width_px)
    box = np.s_[max(rows[0] - margin, 0) : rows[-1] + margin, max(cols[0] - margin, 0) : cols[-1] + margin]
    inside: Array = np.asarray(pixels[box], np.float64)
    bright = inside[bones[box]].mean()
    beside = inside[~bones[box]]
    return "bone bright" if not beside.size or bright >= beside.mean() else "bone dark"


def _make_location(
    status: str,
    side: str,
    pixel_mm: float,
    *,
    row: float = np.nan,
    col: float = np.nan,
    score: float = 0.0,
    compartment_score: float = 0.0,
    agrees: bool = True,
    polarity: str = "bone bright",
    scale: float = 1.0,
    pixel_mm_source: str = "given",
) -> JointLocation:
    """Make a location without a match of templates."""
    margin = 1.0 if agrees else -1.0
    return JointLocation(
        row=row,
        col=col,
        status=status,
        score=score,
        compartment_score=compartment_score,
        side=side,
        side_margin=margin,
        side_evidence=margin,
        orientation=ORIENTATIONS[0],
        orientation_margin=1.0,
        polarity=polarity,
        scale=scale,
        pixel_mm=pixel_mm,
        pixel_mm_source=pixel_mm_source,
        match_distance_mm=0.0,
        visible_fraction=1.0,
    )
