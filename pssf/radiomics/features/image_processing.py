"""Description of the image processing from radiograph to features, following the IBSI reporting items."""

from collections.abc import Collection

from .feature_families import TEXTURES

# Texture settings of both backends. With these settings, both backends reproduce the reference values of the IBSI
# digital phantom for the aggregation "2D, averaged".
_TEXTURE_PROCESSING = {
    "glcm": "neighbours at a distance of 1 pixel in 4 directions, symmetric, not weighted by distance; "
    "averaged over directions",
    "glrlm": "runs in 4 directions, not weighted by distance; averaged over directions",
    "glszm": "zones of pixels connected to any of their 8 neighbours; one matrix for all in-plane directions",
    "ngtdm": "8 neighbours at a distance of 1 pixel; one matrix for all in-plane directions",
    "gldm": "8 neighbours at a distance of 1 pixel, dependent if in the same bin; "
    "one matrix for all in-plane directions",
}


def describe_processing(region_px: int, bins: int, families: Collection[str]) -> dict[str, str | dict[str, str]]:
    """Describe each grey-value processing step in words.

    Parameters
    ----------
    region_px : int
        Edge length of the region, in pixels.
    bins : int
        Number of grey-level bins.
    families : collection of str
        Measured families, from FAMILIES. Processing steps that these families do not need are omitted.

    Returns
    -------
    dict of str to str, or to dict of str to str
        Description of each processing step, keyed by step. The step "texture" has one matrix description per family.
    """
    steps: dict[str, str | dict[str, str]] = {
        "images": "one linear radiograph (DICOM For Processing); no derived images",
        "normalisation": "z-score over the region for firstorder_z; otherwise none"
        if "firstorder" in families
        else "none",
        "conversion": "none: detector grey values, linear in absorbed energy",
        "noise_suppression": "none",
        "interpolation": "none: detector pixels are used",
        "segmentation": f"automatic: {region_px} x {region_px} pixels centred on the located medial joint line",
        "resegmentation": "none",
        "filters": "none",
    }
    if "shape2D" in families:
        steps["bone"] = "watershed of the log-signal gradient, with markers from Otsu's threshold and a black top-hat"
    texture = {name: _TEXTURE_PROCESSING[name] for name in TEXTURES if name in families}
    if texture:
        steps["discretisation"] = f"{bins} bins of equal width from the minimum to the maximum of the region"
        steps["texture"] = texture
    return steps
