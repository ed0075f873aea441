"""Description of the image processing from radiograph to features, by the reporting items of the IBSI."""

from collections.abc import Collection

from .feature_families import TEXTURES

# Texture settings of the two backends. With these settings, both reproduce the reference values of the IBSI digital
# phantom for the aggregation "2D, averaged".
_TEXTURE_PROCESSING = {
    "glcm": "neighbours at 1 pixel in 4 directions, symmetric, not weighted by distance; averaged over directions",
    "glrlm": "runs in 4 directions, not weighted by distance; averaged over directions",
    "glszm": "zones of pixels connected to any of their 8 neighbours; one matrix for the plane",
    "ngtdm": "8 neighbours at 1 pixel; one matrix for the plane",
    "gldm": "8 neighbours at 1 pixel, dependent if in the same bin; one matrix for the plane",
}


def describe_processing(region_px: int, bins: int, families: Collection[str]) -> dict[str, str | dict[str, str]]:
    """Describe each step of the grey-value processing in words.

    Parameters
    ----------
    region_px : int
        Edge length of the region, in pixels.
    bins : int
        Number of grey-level bins.
    families : collection of str
        Measured families, from FAMILIES. Steps that these families do not need are omitted.

    Returns
    -------
    dict of str to str, or to dict of str to str
        Description of each step, keyed by step. The step "texture" has a description of the matrix of each family.
    """
    steps: dict[str, str | dict[str, str]] = {
        "images": "one linear radiograph for processing; no derived image",
        "normalisation": "z-score over the region for firstorder_z, else none" if "firstorder" in families else "none",
        "conversion": "none: grey values of the detector, linear in energy",
        "noise_suppression": "none",
        "interpolation": "none: the detector's own pixels",
        "segmentation": f"automatic: {region_px} x {region_px} pixels about the located medial joint line",
        "resegmentation": "none",
        "filters": "none",
    }
    if "shape2D" in families:
        steps["bone"] = "watershed of the logarithm's gradient, from markers by Otsu's threshold and a black top-hat"
    texture = {name: _TEXTURE_PROCESSING[name] for name in TEXTURES if name in families}
    if texture:
        steps["discretisation"] = f"{bins} equal bins from the region's minimum to its maximum"
        steps["texture"] = texture
    return steps
