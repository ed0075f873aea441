"""Measure grey-value features of a normalised radiograph: subchondral bone plate, first-order and texture features."""

import numpy as np
from scipy import stats
from skimage.feature import graycomatrix, graycoprops

from ...core.checks import Array
from ...radiomics.features.texture_measures import measure_texture
from .film_normalisation import PITCH_MM
from .film_outline import Outline
from .outline_features import Features, find_plateau_edges, plateau_fractions

# Edge length of a square image patch, in mm.
PATCH_MM = 16.0
# Position of each patch: bone, distance from the plateau middle as a fraction of the plateau width (medial positive),
# and height of the patch centre above the bone contour in mm.
PATCHES = {
    "medial_subchondral": ("tibia", 0.25, -11.0),
    "metaphysis": ("tibia", 0.0, -22.0),
    "medial_condyle": ("femur", 0.28, 14.0),
}
# Number of grey levels of the grey-level co-occurrence matrix.
_GREY_LEVELS = 32
# Properties of the grey-level co-occurrence matrix that are measured.
_PROPERTIES = ("contrast", "homogeneity", "correlation", "energy")
# Depth range of the reference bone for the brightness of the subchondral bone plate, in mm below the contour.
_DEEP_BONE_MM = (8.0, 12.0)
_SPECTRAL_FEATURES = ("slope_0.2_0.8", "vertical_over_horizontal", "sd_over_mean", "skewness", "excess_kurtosis")


def measure_grey_features(film: Array, outline: Outline) -> dict[str, Features]:
    """Measure the grey-value features of a normalised radiograph.

    Parameters
    ----------
    film : (rows, cols) array, grey
        Normalised radiograph, 0 to 255.
    outline : Outline
        Bone contours of the radiograph.

    Returns
    -------
    dict of str to dict of str to float
        Features keyed by group and by name.
    """
    patches = {name: cut_patch(film, outline, *place) for name, place in PATCHES.items()}
    return {
        "subchondral plate": _measure_subchondral_plate(film, outline),
        "first order": _measure_first_order(film, patches),
        "texture": {
            f"{name}_{key}": value for name, patch in patches.items() for key, value in _measure_texture(patch).items()
        },
    }


def cut_patch(film: Array, outline: Outline, bone: str, share: float, above_mm: float) -> Array:
    """Cut out a square patch at a position relative to a bone contour.

    A patch that would extend beyond the image is shifted inwards.

    Parameters
    ----------
    film : (rows, cols) array, grey
        Normalised radiograph.
    outline : Outline
        Bone contours of the radiograph.
    bone : {"femur", "tibia"}
        Bone whose contour defines the position.
    share : float
        Distance from the plateau middle, as a fraction of the plateau width; positive medially.
    above_mm : float
        Height of the patch centre above the contour, in mm.

    Returns
    -------
    (side, side) array
        Patch with an edge length of 16 mm.
    """
    level, col = locate_patch_base(outline, bone, share)
    side = round(PATCH_MM / PITCH_MM)
    top = int(np.clip(round(level - above_mm / PITCH_MM - side / 2), 0, film.shape[0] - side))
    start = int(np.clip(round(col - side / 2), 0, film.shape[1] - side))
    return film[top : top + side, start : start + side]


def locate_patch_base(outline: Outline, bone: str, share: float) -> tuple[float, float]:
    """Locate the reference point of a patch on a bone contour.

    Parameters
    ----------
    outline : Outline
        Bone contours.
    bone : {"femur", "tibia"}
        Bone whose contour defines the position.
    share : float
        Distance from the plateau middle, as a fraction of the plateau width; positive medially.

    Returns
    -------
    tuple of float
        Row and column of the reference point, in px.
    """
    left, right = find_plateau_edges(outline)
    col = (left + right) / 2 + share * (right - left)
    contour = outline.femur if bone == "femur" else outline.tibia
    # The median contour height is used in the middle of the plateau, because the tibial spines protrude.
    level = np.median(contour) if share == 0 else np.interp(col, outline.columns, contour)
    return float(level), col


def _measure_subchondral_plate(film: Array, outline: Outline) -> Features:
    """Measure brightness, depth and width of the subchondral bone plate, relative to bone at 8 to 12 mm depth."""
    values: Features = {}
    share = plateau_fractions(outline)
    for bone, contour, way in (("tibia", outline.tibia, 1), ("femur", outline.femur, -1)):
        for name, (low, high) in (("medial", (0.12, 0.38)), ("lateral", (-0.38, -0.12))):
            inside = (share > low) & (share < high)
            depth_px = np.arange(0, round(_DEEP_BONE_MM[1] / PITCH_MM) + 1)
            rows = np.clip(contour[inside].astype(int)[:, None] + way * depth_px, 0, len(film) - 1)
            profile = film[rows, outline.columns[inside].astype(int)[:, None]].mean(axis=0)
            deep = profile[depth_px * PITCH_MM >= _DEEP_BONE_MM[0]].mean()
            over = profile / max(deep, 1.0) - 1
            top = int(over[: round(6.0 / PITCH_MM)].argmax())
            values |= {
                f"{name}_{bone}_brightness": float(over[top]),
                f"{name}_{bone}_depth": top * PITCH_MM,
                f"{name}_{bone}_width": float((over > over[top] / 2).sum() * PITCH_MM) if over[top] > 0 else 0.0,
                f"{name}_{bone}_edge": float(over[top] - over[0]),
            }
    return values


def _measure_first_order(film: Array, patches: dict[str, Array]) -> Features:
    """Measure mean, SD, skewness and percentiles of the image, and mean and SD of each patch."""
    values = {f"p{at}": float(np.percentile(film, at)) for at in (5, 25, 50, 75, 95)}
    values |= {"mean": float(film.mean()), "sd": float(film.std()), "skewness": float(stats.skew(film, axis=None))}
    for name, patch in patches.items():
        values |= {f"{name}_mean": float(patch.mean()), f"{name}_sd": float(patch.std())}
    return values


def _measure_texture(patch: Array) -> Features:
    """Measure power-spectrum and grey-level co-occurrence features of a patch.

    Co-occurrence uses ranks of grey values, so monotonic grey-value transforms have no effect.
    """
    spectral = measure_texture(patch, PITCH_MM)
    values = {name: spectral[name] for name in _SPECTRAL_FEATURES}
    ranks = np.searchsorted(np.quantile(patch, np.linspace(0, 1, _GREY_LEVELS + 1)[1:-1]), patch).astype(np.uint8)
    matrix = graycomatrix(ranks, [1, 3], [0, np.pi / 2], levels=_GREY_LEVELS, symmetric=True, normed=True)
    for name in _PROPERTIES:
        for index, distance in enumerate((1, 3)):
            values[f"{name}_{distance}"] = float(graycoprops(matrix, name)[index].mean())
    return values
