"""Features of the greys of a film in standard form, in three groups: plate, first order, texture."""

import numpy as np
from scipy import stats
from skimage.feature import graycomatrix, graycoprops

from ..core.checks import Array
from ..radiomics.texture import texture
from .form import PITCH_MM
from .outline import Outline
from .shape_features import Features, plateau_edges, plateau_shares

PATCH_MM = 16.0
# Middle of each patch: shares of the plateau's width from its middle (medial positive), mm above its bone's contour.
PATCHES = {
    "medial_subchondral": ("tibia", 0.25, -11.0),
    "metaphysis": ("tibia", 0.0, -22.0),
    "medial_condyle": ("femur", 0.28, 14.0),
}
_GREYS = 32
_PROPERTIES = ("contrast", "homogeneity", "correlation", "energy")
_DEEP_MM = (8.0, 12.0)  # behind the plate, whose brightness is told over what is there
_KEPT = ("slope_0.2_0.8", "vertical_over_horizontal", "sd_over_mean", "skewness", "excess_kurtosis")


def grey_groups(film: Array, outline: Outline) -> dict[str, Features]:
    """Group -> feature -> value.

    film  (rows, cols)  standard form, grey 0 to 255
    """
    patches = {name: patch_of(film, outline, *place) for name, place in PATCHES.items()}
    return {
        "plate": _plate(film, outline),
        "first order": _first_order(film, patches),
        "texture": {
            f"{name}_{key}": value for name, patch in patches.items() for key, value in _texture(patch).items()
        },
    }


def patch_of(film: Array, outline: Outline, bone: str, share: float, above_mm: float) -> Array:
    """(side, side) square about a place told from a bone's contour, moved inwards where it would leave the film.

    film  (rows, cols)  grey, standard form
    """
    level, col = patch_base(outline, bone, share)
    side = round(PATCH_MM / PITCH_MM)
    top = int(np.clip(round(level - above_mm / PITCH_MM - side / 2), 0, film.shape[0] - side))
    start = int(np.clip(round(col - side / 2), 0, film.shape[1] - side))
    return film[top : top + side, start : start + side]


def patch_base(outline: Outline, bone: str, share: float) -> tuple[float, float]:
    """Row of a bone's contour, and column, at a share of the plateau's width from its middle."""
    left, right = plateau_edges(outline)
    col = (left + right) / 2 + share * (right - left)
    contour = outline.femur if bone == "femur" else outline.tibia
    # The spines are no plateau: in the middle the line between its sides is meant.
    level = np.median(contour) if share == 0 else np.interp(col, outline.columns, contour)
    return float(level), col


def _plate(film: Array, outline: Outline) -> Features:
    """Height, depth and width of the bright band under each contour, over the grey deep in the bone."""
    values: Features = {}
    share = plateau_shares(outline)
    for bone, contour, way in (("tibia", outline.tibia, 1), ("femur", outline.femur, -1)):
        for name, (low, high) in (("medial", (0.12, 0.38)), ("lateral", (-0.38, -0.12))):
            inside = (share > low) & (share < high)
            depth_px = np.arange(0, round(_DEEP_MM[1] / PITCH_MM) + 1)
            rows = np.clip(contour[inside].astype(int)[:, None] + way * depth_px, 0, len(film) - 1)
            profile = film[rows, outline.columns[inside].astype(int)[:, None]].mean(axis=0)
            deep = profile[depth_px * PITCH_MM >= _DEEP_MM[0]].mean()
            over = profile / max(deep, 1.0) - 1
            top = int(over[: round(6.0 / PITCH_MM)].argmax())
            values |= {
                f"{name}_{bone}_brightness": float(over[top]),
                f"{name}_{bone}_depth": top * PITCH_MM,
                f"{name}_{bone}_width": float((over > over[top] / 2).sum() * PITCH_MM) if over[top] > 0 else 0.0,
                f"{name}_{bone}_edge": float(over[top] - over[0]),
            }
    return values


def _first_order(film: Array, patches: dict[str, Array]) -> Features:
    values = {f"p{at}": float(np.percentile(film, at)) for at in (5, 25, 50, 75, 95)}
    values |= {"mean": float(film.mean()), "sd": float(film.std()), "skewness": float(stats.skew(film, axis=None))}
    for name, patch in patches.items():
        values |= {f"{name}_mean": float(patch.mean()), f"{name}_sd": float(patch.std())}
    return values


def _texture(patch: Array) -> Features:
    """Spectrum and grey-level co-occurrence of a patch; the latter of its ranks, so that tone does not count."""
    spectral = texture(patch, PITCH_MM)
    values = {name: spectral[name] for name in _KEPT}
    ranks = np.searchsorted(np.quantile(patch, np.linspace(0, 1, _GREYS + 1)[1:-1]), patch).astype(np.uint8)
    matrix = graycomatrix(ranks, [1, 3], [0, np.pi / 2], levels=_GREYS, symmetric=True, normed=True)
    for name in _PROPERTIES:
        for index, distance in enumerate((1, 3)):
            values[f"{name}_{distance}"] = float(graycoprops(matrix, name)[index].mean())
    return values
