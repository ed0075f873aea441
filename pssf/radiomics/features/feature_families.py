"""Feature families: names of the families, and the family to which a feature belongs."""

FAMILIES = ("firstorder", "shape2D", "glcm", "glrlm", "glszm", "ngtdm", "gldm")
TEXTURES = tuple(name for name in FAMILIES if name not in ("firstorder", "shape2D"))


def feature_family(name: str) -> str:
    """Return the family of a feature.

    Parameters
    ----------
    name : str
        Feature name, such as glcm_Contrast.

    Returns
    -------
    str
        Name of the family, one of FAMILIES.
    """
    return name.split("_", 1)[0]
