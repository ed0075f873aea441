"""Fitted constants of the scatter kernel (``data/scatter.toml``)."""

from functools import cache

from ..data_files import load_data_table
from ..table_records import Pair, Record, parse_record


class ScatterTerm(Record, frozen=True):
    """Constants of one term of the scatter kernel.

    The equation is in ``data/scatter.toml``. Only the sum of the terms was fitted, so individual constants have no
    physical meaning.

    Attributes
    ----------
    log_strength : float
        Natural logarithm of the strength of the term.
    per_10_kv : float
        Change of the logarithmic strength per 10 kV.
    per_log : float
        Change of the logarithmic strength per unit of the mean logarithm of the primary transmission.
    mass_power : float
        Exponent of the relative mass per area.
    primary_power : float
        Exponent of the primary transmission.
    exit_power : float
        Exponent of the smoothed primary transmission, which models the attenuation of scatter that leaves the object.
    exit_mm : float
        Standard deviation of the Gaussian that smooths the logarithm of the primary transmission, in mm.
    inner_mm : float
        Standard deviation of the scatter spread inside the object at relative mass 1, in mm.
    slope : float
        Increase of the standard deviation of the scatter spread behind the object, in mm per mm of air gap.
    depth_mm : float
        Length added to the air gap, in mm.
    """

    log_strength: float
    per_10_kv: float
    per_log: float
    mass_power: float
    primary_power: float
    exit_power: float
    exit_mm: float
    inner_mm: float
    slope: float
    depth_mm: float


class ProjectionKernel(Record, frozen=True):
    """Terms of the scatter kernel of one projection.

    Attributes
    ----------
    projection : str
        Name of the projection, as in `Protocol`.
    inner_power : float
        Exponent with which the mean relative mass scales the scatter spread inside the object.
    term : tuple of ScatterTerm
        Terms whose sum is the scatter.
    """

    projection: str
    inner_power: float
    term: tuple[ScatterTerm, ...]


class FittedDetector(Record, frozen=True):
    """Detector for which the kernel was fitted, and constants of the correction for other detectors.

    Attributes
    ----------
    formula : str
        Chemical formula of the scintillator.
    density_g_per_cm3 : float
        Density of the scintillator without pores, in g/cm3.
    packing : float
        Fraction of the layer that the scintillator fills.
    thickness_mm : float
        Thickness of the layer, in mm.
    muscle_share : float
        Fraction of the muscle-equivalent thickness of the object that hardens the scatter.
    one_minus_cosine : float
        One minus the cosine of the scattering angle.
    oblique_excess : float
        Mean path of scatter in a thin scintillator divided by its thickness, minus 1, without an air gap.
    oblique_gap_mm : float
        Air gap at which this excess has decreased to 1/e, in mm.
    """

    formula: str
    density_g_per_cm3: float
    packing: float
    thickness_mm: float
    muscle_share: float
    one_minus_cosine: float
    oblique_excess: float
    oblique_gap_mm: float


class SmallFieldBias(Record, frozen=True):
    """Ratio of kernel scatter to Monte Carlo scatter in small fields.

    Attributes
    ----------
    side_mm : float
        Largest length of the shorter field side on the detector for which the ratios apply, in mm.
    low : float
        Smallest ratio of kernel scatter to Monte Carlo scatter.
    high : float
        Largest ratio of kernel scatter to Monte Carlo scatter.
    """

    side_mm: float
    low: float
    high: float


class ScatterKernel(Record, frozen=True):
    """Scatter kernel of all projections, with the range of its fit.

    Attributes
    ----------
    reference_g_per_cm2 : float
        Mass per area at relative mass 1, in g/cm2.
    reference_log : float
        Reference value of the mean natural logarithm of the primary transmission.
    reference_kv : float
        Reference tube voltage, in kV.
    tube_kv : (float, float)
        Range to which the tube voltage is clipped, in kV.
    most_mass : float
        Upper limit to which the relative mass is clipped.
    log_primary_range : (float, float)
        Range to which the mean natural logarithm of the primary transmission is clipped.
    checked_kv : (float, float)
        Range of the tube voltage in which the kernel was checked, in kV.
    checked_mm_al : (float, float)
        Range of the total filtration in which the kernel was checked, in mm aluminium.
    full_field_mm : (float, float)
        Width and height of the smallest field for which the kernel is valid, on the detector, in mm.
    small_fields : tuple of SmallFieldBias
        Bias of the kernel in smaller fields, in order of increasing `side_mm`.
    fitted_detector : FittedDetector
        Detector of the fit, and correction for other detectors.
    sums : tuple of ProjectionKernel
        Kernels of the projections.
    """

    reference_g_per_cm2: float
    reference_log: float
    reference_kv: float
    tube_kv: Pair
    most_mass: float
    log_primary_range: Pair
    checked_kv: Pair
    checked_mm_al: Pair
    full_field_mm: Pair
    small_fields: tuple[SmallFieldBias, ...]
    fitted_detector: FittedDetector
    sums: tuple[ProjectionKernel, ...]

    def for_projection(self, projection: str) -> ProjectionKernel:
        """Return the kernel of a projection.

        Parameters
        ----------
        projection : str
            Name of the projection, as in `Protocol`.

        Returns
        -------
        ProjectionKernel
            Kernel of the projection, or the first kernel (AP) if the projection has no fit.
        """
        return next((one for one in self.sums if one.projection == projection), self.sums[0])

    def is_checked_for(self, tube_kv: float, filtration_mm_al: float) -> bool:
        """Return whether the kernel was checked for a tube spectrum behind aluminium.

        Parameters
        ----------
        tube_kv : float
            Tube voltage, in kV.
        filtration_mm_al : float
            Total filtration, in mm aluminium.

        Returns
        -------
        bool
            True if both values are in the range of the check.
        """
        low, high = self.checked_kv
        least, most = self.checked_mm_al
        return low <= tube_kv <= high and least <= filtration_mm_al <= most

    def find_small_field_bias(self, width_mm: float, height_mm: float) -> SmallFieldBias | None:
        """Find the bias of the kernel in a field that is smaller than the fitted fields.

        Parameters
        ----------
        width_mm : float
            Width of the field on the detector, in mm.
        height_mm : float
            Height of the field on the detector, in mm.

        Returns
        -------
        SmallFieldBias or None
            Bias of the kernel; None for a field that is large enough.
        """
        width, height = self.full_field_mm
        if width_mm >= width and height_mm >= height:
            return None
        return next(one for one in self.small_fields if min(width_mm, height_mm) <= one.side_mm)


@cache
def load_scatter_kernel() -> ScatterKernel:
    """Load the scatter kernel of the package.

    Returns
    -------
    ScatterKernel
        Content of ``data/scatter.toml``.
    """
    return parse_record(ScatterKernel, load_data_table("scatter"), "scatter")
