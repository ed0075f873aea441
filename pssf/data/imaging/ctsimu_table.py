"""Reference values of the CTSimU test suite (``data/ctsimu.toml``)."""

from functools import cache

from ..data_files import load_data_table
from ..table_records import Numbers, Record, parse_record


class WedgeMaterial(Record, frozen=True):
    """Material and path lengths of a step wedge.

    Attributes
    ----------
    density_g_per_cm3 : float
        Density, in g/cm3.
    thinnest_mm : float
        Path length in the thinnest of the nine steps, in mm.
    step_mm : float
        Increase of the path length per step, in mm.
    """

    density_g_per_cm3: float
    thinnest_mm: float
    step_mm: float


class WedgeGeometry(Record, frozen=True):
    """Geometry of a step wedge, whose steps are parts of spherical shells around the source.

    Attributes
    ----------
    sdd_mm : float
        Distance from the source to the detector, in mm.
    middle_mm : float
        Distance from the source to the middle of each step, in mm.
    pixel_mm : float
        Pixel pitch of the detector, in mm.
    pixels_per_step : int
        Height of the projection of a step, and of the free beam above the steps, in pixels.
    width_mm : float
        Width of the projection of the wedge, in mm.
    """

    sdd_mm: float
    middle_mm: float
    pixel_mm: float
    pixels_per_step: int
    width_mm: float


class WedgeReference(Record, frozen=True):
    """Grey values of one wedge by two Monte Carlo codes, from the thickest step to the free beam.

    Attributes
    ----------
    detector : str
        Scintillator and its thickness in micrometres, or ``ideal``.
    material : str
        Symbol of the wedge material.
    beam : str
        Photon energy in keV or tube voltage in kV, with unit.
    rosi, mcray : tuple of float
        Mean primary grey values of the codes.
    rosi_sd, mcray_sd : tuple of float
        Standard deviations of the primary grey values of the codes.
    rosi_total, mcray_total : tuple of float
        Mean grey values of the codes with scatter. Empty if unknown.
    rosi_total_sd, mcray_total_sd : tuple of float
        Standard deviations of the grey values of the codes with scatter. Empty if unknown.
    """

    detector: str
    material: str
    beam: str
    rosi: Numbers
    rosi_sd: Numbers
    mcray: Numbers
    mcray_sd: Numbers
    rosi_total: Numbers = ()
    rosi_total_sd: Numbers = ()
    mcray_total: Numbers = ()
    mcray_total_sd: Numbers = ()


class CtsimuTable(Record, frozen=True):
    """Step wedges of the CTSimU test suite.

    Attributes
    ----------
    window_mm_al : float
        Window of the X-ray tube, in mm aluminium.
    anode_angle_deg : float
        Angle of the tungsten anode, in degrees.
    geometry : WedgeGeometry
        Geometry of the wedges.
    material : dict of str to WedgeMaterial
        Materials, keyed by symbol.
    wedge : tuple of WedgeReference
        Reference values of each wedge.
    """

    window_mm_al: float
    anode_angle_deg: float
    geometry: WedgeGeometry
    material: dict[str, WedgeMaterial]
    wedge: tuple[WedgeReference, ...]


@cache
def load_ctsimu() -> CtsimuTable:
    """Load the reference values of the test suite.

    Returns
    -------
    CtsimuTable
        Content of ``data/ctsimu.toml``.
    """
    return parse_record(CtsimuTable, load_data_table("ctsimu"), "ctsimu")
