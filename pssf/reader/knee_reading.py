"""Read landmarks, masks and joint measures of the knees on a radiograph."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from ..core.checks import Array
from ..core.label_names import CONTOUR_LANDMARKS
from .joint_measures import JointMeasures, measure_joint
from .knee_finder import KneeCandidate, find_knees
from .knee_frame import PLATEAU_EDGES, Grey, KneeFrame, fit_frame, fit_similarity, normalise_grey
from .networks import DecodedHeatMaps, Network, NetworkSettings, decode_heat_maps, load_network
from .reader_table import PACKAGE_FOLDER, ReaderTable, load_reader_table
from .side_decision import decide_sides

LOCATOR_FILE = "locator.onnx"
SIDE_FILE = "side.onnx"
LANDMARK_FILE = "landmarks.onnx"


@dataclass(frozen=True, kw_only=True, eq=False)
class KneeReading:
    """Knee on a radiograph, as the reader sees it.

    Attributes
    ----------
    side : {"right", "left"}
        Side, under the convention that the lateral side of a right knee is on the viewer's left.
    angle_deg : float
        Rotation of the tibial plateau in the image, in degrees, clockwise positive.
    landmarks_px : dict of str to tuple of float
        Row and column of the sixteen contour landmarks, in pixels.
    confidence : dict of str to float
        Confidence in each landmark: probability of the heat map near the landmark, 0 to 1.
    masks : dict of str to (rows, cols) bool array
        Masks of femur, tibia, fibula and patella; osteophytes belong to their bone.
    measures : JointMeasures
        Joint space widths as fractions of the plateau width, and joint-line convergence.
    pixel_mm : float or None
        Pixel size, in mm; None if unknown.
    score : float
        Score with which the knee was found, 0 to 1.
    side_confidence : float
        Probability of the side, 0.5 to 1.
    shape_residual : float
        Root-mean-square distance of the landmarks from the mean shape of simulated knees after a similarity fit, as a
        fraction of the plateau width.
    refusal : str
        Reason why the reading must not be used; empty if there is none.
    """

    side: str
    angle_deg: float
    landmarks_px: dict[str, tuple[float, float]]
    confidence: dict[str, float]
    masks: dict[str, NDArray[np.bool_]]
    measures: JointMeasures
    pixel_mm: float | None
    score: float
    side_confidence: float
    shape_residual: float
    refusal: str

    @property
    def plateau_width_mm(self) -> float | None:
        """Width of the tibial plateau on the detector, in mm; None if the pixel size is unknown."""
        return None if self.pixel_mm is None else self.measures.plateau_width_px * self.pixel_mm

    @property
    def medial_jsw_mm(self) -> float | None:
        """Minimum medial joint space width on the detector, in mm; None if the pixel size is unknown."""
        width = self.plateau_width_mm
        return None if width is None else self.measures.medial_jsw_share * width

    @property
    def lateral_jsw_mm(self) -> float | None:
        """Minimum lateral joint space width on the detector, in mm; None if the pixel size is unknown."""
        width = self.plateau_width_mm
        return None if width is None else self.measures.lateral_jsw_share * width


@dataclass(frozen=True, kw_only=True, eq=False)
class Reader:
    """Loaded networks and thresholds of the reader.

    Attributes
    ----------
    locator : Network
        Network that finds knees.
    sides : Network
        Network that tells right from left knees.
    landmarks : Network
        Network that finds landmarks and masks in the frame of a knee.
    table : ReaderTable
        Mean shape and thresholds.
    """

    locator: Network
    sides: Network
    landmarks: Network
    table: ReaderTable


def load_reader(folder: str | Path | None = None) -> Reader:
    """Load the networks of the reader.

    Parameters
    ----------
    folder : str or Path, optional
        Folder with the output of ``pssf train-reader``; None: the networks of the package.

    Returns
    -------
    Reader
        Networks and thresholds.

    Raises
    ------
    InputError
        ONNX Runtime is not installed, or a file is missing or damaged.
    """
    return _load_reader(PACKAGE_FOLDER if folder is None else Path(folder))


@lru_cache(maxsize=2)
def _load_reader(folder: Path) -> Reader:
    """Load and keep the networks of a folder."""
    return Reader(
        locator=load_network(folder / LOCATOR_FILE),
        sides=load_network(folder / SIDE_FILE),
        landmarks=load_network(folder / LANDMARK_FILE),
        table=load_reader_table(folder),
    )


def read_knees(image: Grey, pixel_mm: float | None, reader: Reader) -> tuple[KneeReading, ...]:
    """Read the knees on a frontal radiograph.

    Parameters
    ----------
    image : (rows, cols) float32 array
        Grey values, of any range and polarity.
    pixel_mm : float or None
        Pixel size, in mm; None if unknown.
    reader : Reader
        Networks and thresholds.

    Returns
    -------
    tuple of KneeReading
        Knees from the viewer's left to the viewer's right; empty if the image shows no frontal knee.
    """
    knees = find_knees(image, reader.locator, reader.table.min_score)
    decided = decide_sides(image, knees, reader.sides)
    return tuple(_read_knee(image, knee, sure, pixel_mm, reader) for knee, sure in decided)


def _read_knee(
    image: Grey, knee: KneeCandidate, side_confidence: float, pixel_mm: float | None, reader: Reader
) -> KneeReading:
    """Read one knee. A second reading in the frame of its own landmarks would not be more exact."""
    settings, read_in = reader.landmarks.settings, knee.frame
    crop = normalise_grey(*read_in.cut_crop(image, settings.plateau_px, settings.crop_px))
    heat_maps, logits = reader.landmarks.run(crop)
    decoded = decode_heat_maps(heat_maps, settings.stride)
    places = read_in.map_to_image(decoded.places_px, settings.plateau_px, settings.crop_px)
    frame = fit_frame(places[PLATEAU_EDGES], read_in.side)
    residual = compute_shape_residual(places, frame, reader.table.mean_shape)
    return KneeReading(
        side=frame.side,
        angle_deg=float(np.rad2deg(frame.angle_rad)),
        landmarks_px=_name(places),
        confidence=dict(zip(CONTOUR_LANDMARKS, decoded.mass.tolist(), strict=True)),
        masks=draw_masks(logits, read_in, settings, image.shape),
        measures=measure_joint(places, frame.side),
        pixel_mm=pixel_mm,
        score=knee.score,
        side_confidence=side_confidence,
        shape_residual=residual,
        refusal=_find_refusal(side_confidence, decoded, residual, reader.table),
    )


def _name(places: Array) -> dict[str, tuple[float, float]]:
    """Return landmark positions (16, 2) by name."""
    return {name: (float(row), float(col)) for name, (row, col) in zip(CONTOUR_LANDMARKS, places, strict=True)}


def compute_shape_residual(places_px: Array, frame: KneeFrame, mean_shape: Sequence[Sequence[float]]) -> float:
    """Compute how far landmarks are from the mean shape after a similarity fit.

    Parameters
    ----------
    places_px : (16, 2) array
        Row and column of each landmark, in pixels.
    frame : KneeFrame
        Frame of the knee.
    mean_shape : (16, 2) sequence of float
        Mean row and column of each landmark in the frame of the knee, as fractions of the plateau width.

    Returns
    -------
    float
        Root-mean-square distance as a fraction of the plateau width.
    """
    here = frame.map_to_crop(places_px, 1.0, 1)
    distance = fit_similarity(np.asarray(mean_shape), here) - here
    return float(np.sqrt((distance**2).sum(axis=1).mean()))


def _find_refusal(side_confidence: float, decoded: DecodedHeatMaps, residual: float, table: ReaderTable) -> str:
    """Return the reason why a reading must not be used, or an empty text."""
    if residual > table.max_shape_residual:
        return (
            f"shape differs from that of a knee by {residual:.3f} plateau widths, above {table.max_shape_residual:.3f}"
        )
    least = float(np.median(decoded.mass))
    if least < table.min_confidence:
        return f"median confidence of the landmarks is {least:.4f}, below {table.min_confidence:.4f}"
    if side_confidence < table.min_side_confidence:
        return f"probability of the side is {side_confidence:.2f}, below {table.min_side_confidence:.2f}"
    return ""


def draw_masks(
    logits: Grey, frame: KneeFrame, settings: NetworkSettings, shape: tuple[int, ...]
) -> dict[str, NDArray[np.bool_]]:
    """Map the masks of a crop to the image.

    Parameters
    ----------
    logits : (masks, rows, cols) float32 array
        Logits of each mask in the crop.
    frame : KneeFrame
        Frame of the crop.
    settings : NetworkSettings
        Settings of the network.
    shape : tuple of int
        Rows and columns of the image.

    Returns
    -------
    dict of str to (rows, cols) bool array
        Mask of each bone.
    """
    box = frame.find_box(shape, settings.plateau_px, settings.crop_px)
    points = np.moveaxis(np.mgrid[box].astype(float), 0, -1)
    places = frame.map_to_crop(points, settings.plateau_px, settings.crop_px)
    # With pixel unshuffling, pixel k of the output covers pixels stride k to stride k + stride - 1 of the crop.
    at = np.moveaxis((places - (settings.stride - 1) / 2) / settings.stride, -1, 0)
    masks = {name: np.zeros(shape, bool) for name in settings.masks}
    for mask, values in zip(masks.values(), logits, strict=True):
        mask[box] = ndimage.map_coordinates(values, at, order=1, mode="constant", cval=-1.0) > 0
    return masks
