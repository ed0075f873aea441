"""What becomes of grey values between a radiograph and its features, in the words of the IBSI's reporting items."""

from collections.abc import Collection

from .families import TEXTURES

# As both backends measure, and as the digital phantom of the IBSI is agreed with ("2D, averaged").
_TEXTURE = {
    "glcm": "neighbours at 1 pixel in 4 directions, symmetric, not weighted by distance; averaged over directions",
    "glrlm": "runs in 4 directions, not weighted by distance; averaged over directions",
    "glszm": "zones of pixels linked to any of their 8 neighbours, of the plane as a whole",
    "ngtdm": "8 neighbours at 1 pixel, of the plane as a whole",
    "gldm": "8 neighbours at 1 pixel, dependent where the bin is the same, of the plane as a whole",
}


def processing(region_px: int, bins: int, families: Collection[str]) -> dict[str, str | dict[str, str]]:
    """Step -> what is done in it; texture: of each family that is measured how its matrix is made.

    families  of FAMILIES; steps that only others need are left out
    """
    steps: dict[str, str | dict[str, str]] = {
        "images": "one linear radiograph for processing; no derived image",
        "normalisation": "z-score over the region for firstorder_z, else none" if "firstorder" in families else "none",
        "conversion": "none: grey values of the detector, linear in energy",
        "noise_suppression": "none",
        "interpolation": "none: the detector's own pixels",
        "segmentation": f"automatic: {region_px} x {region_px} pixels about the medial joint line, as it is found",
        "resegmentation": "none",
        "filters": "none",
    }
    if "shape2D" in families:
        steps["bone"] = "watershed of the logarithm's gradient, from markers by Otsu's threshold and a black top-hat"
    texture = {name: _TEXTURE[name] for name in TEXTURES if name in families}
    if texture:
        steps["discretisation"] = f"{bins} equal bins from the region's minimum to its maximum"
        steps["texture"] = texture
    return steps
