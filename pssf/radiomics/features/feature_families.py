"""Feature families and measured areas: their names, and those to which a feature belongs."""

from ...texture import TEXTURE_FAMILIES, TEXTURE_REGIONS

FAMILIES = ("firstorder", "shape2D", "glcm", "glrlm", "glszm", "ngtdm", "gldm")
TEXTURES = tuple(name for name in FAMILIES if name not in ("firstorder", "shape2D"))

# The families of radiomics are measured by default, the texture measures of osteoarthritis research on request.
ALL_FAMILIES = (*FAMILIES, *TEXTURE_FAMILIES)
# Areas of a radiograph that are measured: the square around the medial joint line, and regions of the tibia.
SQUARE = "square"
AREAS = (SQUARE, *TEXTURE_REGIONS)
# Sign between the name of a feature and its area. Features of the square have no area in their names.
_AREA_SIGN = "@"


def name_in_area(name: str, area: str) -> str:
    """Return the name of a feature of an area.

    Parameters
    ----------
    name : str
        Feature name, such as glcm_Contrast.
    area : str
        One of AREAS.

    Returns
    -------
    str
        Name with the area, such as glcm_Contrast@medial_subchondral.
    """
    return name if area == SQUARE else f"{name}{_AREA_SIGN}{area}"


def split_area(name: str) -> tuple[str, str]:
    """Split the name of a feature into its name without area, and its area.

    Parameters
    ----------
    name : str
        Feature name, such as glcm_Contrast@medial_subchondral.

    Returns
    -------
    name : str
        Name without area.
    area : str
        One of AREAS.
    """
    plain, _, area = name.partition(_AREA_SIGN)
    return plain, area or SQUARE


def feature_family(name: str) -> str:
    """Return the family of a feature.

    Parameters
    ----------
    name : str
        Feature name, such as glcm_Contrast.

    Returns
    -------
    str
        Name of the family, one of ALL_FAMILIES.
    """
    return name.split("_", 1)[0]
