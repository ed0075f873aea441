"""The families of features, and which of them a feature is of."""

FAMILIES = ("firstorder", "shape2D", "glcm", "glrlm", "glszm", "ngtdm", "gldm")
TEXTURES = tuple(name for name in FAMILIES if name not in ("firstorder", "shape2D"))


def family(name: str) -> str:
    """The family of a feature, one of FAMILIES."""
    return name.split("_", 1)[0]
