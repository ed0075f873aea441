"""Description of the image processing from radiograph to features, following the IBSI reporting items."""

from collections.abc import Collection

from ...texture import SCALES_MM, TEXTURE_FAMILIES
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

_SCALES = f"at {len(SCALES_MM)} scales from {SCALES_MM[0]:g} to {SCALES_MM[-1]:g} mm"
_BONE_PROCESSING = {
    "fsa": f"fractal signature by dilation and erosion with horizontal and vertical rods {_SCALES}",
    "vot": f"variance orientation transform in 36 directions {_SCALES}",
    "hot": f"Hurst orientation transform in 18 directions {_SCALES}",
    "lbp": "rotation-invariant uniform local binary patterns of 8 points at radii of 0.4 and 0.8 mm, of ranked grey "
    "values",
    "spectrum": f"exponent of the power spectrum for half periods from {SCALES_MM[0]:g} to {SCALES_MM[-1]:g} mm",
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
        Measured families, from ALL_FAMILIES. Processing steps that these families do not need are omitted.

    Returns
    -------
    dict of str to str, or to dict of str to str
        Description of each processing step, keyed by step. The steps "texture" and
        "bone_texture" have one description per family.
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
    of_bone = {name: _BONE_PROCESSING[name] for name in TEXTURE_FAMILIES if name in families}
    if of_bone:
        steps["bone_texture"] = of_bone
    return steps
