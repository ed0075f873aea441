"""Define the detector of a radiograph: scintillator, blur, noise and readout."""

from dataclasses import dataclass, replace
from functools import cache
from itertools import pairwise
from os import PathLike
from typing import Any

from ..core.checks import InputError, build_from_table, require_choice, require_in_range
from ..core.keyword_arguments import check_keywords
from ..data.data_files import list_detectors, read_detector_fields
from ..data.knees.field_definitions import check_fields

# Largest thickness of a filter or cover layer, in mm.
_MAX_LAYER_MM = 100.0
# Largest number of entries of a table in a protocol or detector.
_MAX_TABLE = 2000
# Largest value of a transfer function. Values above 1 occur in panels with edge enhancement.
_MAX_TRANSFER = 2.0
# Largest spatial frequency of a transfer table, in 1/mm.
_MAX_PER_MM = 1e4


@check_keywords()
@dataclass(frozen=True, kw_only=True)
class Detector:
    """Scintillator, blur, noise and readout of a flat panel.

    Parameters
    ----------
    name : str
        Name of the detector, used in DICOM files and messages. Allowed: 1 to 64 letters, digits, _ and -.
    formula : str
        Chemical formula of the scintillator. Allowed: text of 1 to 64 characters.
    density_g_per_cm3 : float
        Density of the solid scintillator. Allowed: 0.01 to 30 g/cm3.
    thickness_mm : float
        Thickness of the scintillator layer. Allowed: 0.001 to 20 mm.
    packing : float
        Fraction of the volume of the layer that the scintillator fills. Only the product of density, packing and
        thickness, the mass per area, affects the image. Allowed: 0.01 to 1.
    mtf_f0_per_mm : float
        Spatial frequency f0 of the presampled MTF 1 / (1 + (f / f0)^power), which includes the pixel aperture. Allowed:
        0.01 to 1000 1/mm.
    mtf_power : float
        Exponent of the MTF. Allowed: 0.1 to 20.
    ntf_f0_per_mm : float
        Spatial frequency f0 of the noise transfer function (NTF) of quantum noise, which has the same equation as the
        MTF. The normalised noise power spectrum at high dose is proportional to the squared NTF. Allowed: 0.01 to 1000
        1/mm.
    ntf_power : float
        Exponent of the NTF. Allowed: 0.1 to 20.
    swank : float
        Swank factor of the light: relative variance of the number of electrons for equal deposited energies, as 1 / (1
        + relative variance). With escape = "none", the Swank factor of the entire conversion. Allowed: 0.05 to 1.
    electrons_per_kev : float
        Electrons per keV absorbed. Allowed: 1e-06 to 1e+06 1/keV.
    readout_electrons : float
        Readout noise of a pixel, as an RMS number of electrons. Allowed: 0 to 1e+09 electrons.
    electrons_per_dn_mm2 : float
        Electrons per DN and per mm2 of pixel area. Allowed: 0.001 to 1e+12 electrons/mm2.
    offset_dn : float
        Value of a pixel without signal. Allowed: 0 to 65535 DN.
    dead_seed : int, default 0
        Seed of the positions of dead pixels and of the gains of the pixels. Allowed: 0 to 2**63 - 1.
    absorption : {"layer", "all"}, default "layer"
        "layer" absorbs as a scintillator layer does. "all" is an ideal detector that absorbs the entire energy of every
        photon; the fields of the layer then have no effect.
    escape : {"simulated", "none"}, default "simulated"
        "simulated" includes the energy that K fluorescence and scattered photons carry out of the layer. With "none",
        each photon that interacts deposits its entire energy.
    cover : tuple of (str, float), default ()
        Layers in front of the scintillator, such as housing and reflector: material and thickness of each. They
        attenuate; their scatter is neglected. Allowed: pairs of a material and a thickness of 0 to 100 mm, such as
        [['C@1.8', 1.0], ['Al@2.7', 0.03]].
    mtf : tuple of (float, float), optional
        Presampled MTF as a table that replaces the equation, interpolated linearly; beyond the last frequency, the last
        value holds. None: the equation is used. Allowed: 2 to 2000 pairs of a spatial frequency in 1/mm (from 0,
        ascending) and a value of 0 to 2; the first value is 1.
    ntf : tuple of (float, float), optional
        NTF as a table that replaces the equation. None: the equation is used. Allowed: 2 to 2000 pairs of a spatial
        frequency in 1/mm (from 0, ascending) and a value of 0 to 2; the first value is 1.
    glare_fraction : float, default 0
        Fraction of the signal that is spread widely by light in the panel; it lowers the MTF by this fraction above a
        low frequency. 0 is no glare. Allowed: 0 to 0.9.
    glare_mm : float, default 20
        Length d of the glare, whose transfer function is 1 / (1 + (2 pi d f)^2)^1.5. Allowed: 0.01 to 1000 mm.
    saturation_dn : int, default 65_535
        Largest pixel value. Allowed: 1 to 65535 DN.
    response : tuple of (float, float), optional
        Pixel value after the conversion, as a function of the linear pixel value, both above the offset; interpolated
        linearly. None: the response is linear. Allowed: 2 to 2000 pairs of a linear value and a pixel value in DN, both
        ascending, the first [0, 0].
    gain_variation : float, default 0
        Relative standard deviation of the gain from pixel to pixel, as it remains after flat-field correction; the same
        in every exposure. Allowed: 0 to 0.5.

    Raises
    ------
    InputError
        If a value is out of range (``data/detector_fields.toml``).

    Notes
    -----
    ``pssf protocols --detector NAME`` lists the fields with typical values and sources.

    Examples
    --------
    >>> import dataclasses, pssf
    >>> thin = dataclasses.replace(pssf.load_detector("csi"), name="thin", thickness_mm=0.3)
    >>> protocol = dataclasses.replace(pssf.load_protocol("reference"), detector=thin)
    >>> protocol.detector.thickness_mm
    0.3
    """

    name: str
    formula: str
    density_g_per_cm3: float
    thickness_mm: float
    packing: float
    mtf_f0_per_mm: float
    mtf_power: float
    ntf_f0_per_mm: float
    ntf_power: float
    swank: float
    electrons_per_kev: float
    readout_electrons: float
    electrons_per_dn_mm2: float
    offset_dn: float
    dead_seed: int = 0
    absorption: str = "layer"
    escape: str = "simulated"
    cover: tuple[tuple[str, float], ...] = ()
    mtf: tuple[tuple[float, float], ...] | None = None
    ntf: tuple[tuple[float, float], ...] | None = None
    glare_fraction: float = 0.0
    glare_mm: float = 20.0
    saturation_dn: int = 65535
    response: tuple[tuple[float, float], ...] | None = None
    gain_variation: float = 0.0

    def __post_init__(self) -> None:
        check_fields("detector", self)
        object.__setattr__(self, "cover", check_layers("cover", self.cover))
        for name in ("mtf", "ntf"):
            if getattr(self, name) is not None:
                table = check_pairs(name, getattr(self, name), (0.0, _MAX_PER_MM, "1/mm"), (0.0, _MAX_TRANSFER, ""))
                if table[0] != (0.0, 1.0):
                    raise InputError(f"{name} must begin with frequency 0 and value 1, got {list(table[0])}")
                object.__setattr__(self, name, table)
        if self.response is not None:
            object.__setattr__(self, "response", _check_response(self.response))
        if self.offset_dn >= self.saturation_dn:
            raise InputError(
                f"offset_dn must be less than saturation_dn = {self.saturation_dn}, got {self.offset_dn:g}"
            )

    @property
    def mg_per_cm2(self) -> float:
        """Mass of scintillator per area, in mg/cm2."""
        return self.density_g_per_cm3 * self.packing * self.thickness_mm * 100.0

    def without_escape(self) -> "Detector":
        """Make a copy in which each photon that interacts deposits its entire energy.

        Returns
        -------
        Detector
            Copy with ``escape = "none"``.
        """
        return replace(self, escape="none")


def _check_response(response: Any) -> tuple[tuple[float, float], ...]:
    """Check the response curve and convert it to tuples of linear and recorded value."""
    curve = check_pairs("response", response, (0.0, 1e9, "DN"), (0.0, 65535.0, "DN"))
    if curve[0] != (0.0, 0.0):
        raise InputError(f"response must begin with [0, 0], got {list(curve[0])}")
    falls = next((high for (_, low), (_, high) in pairwise(curve) if high < low), None)
    if falls is not None:
        raise InputError(f"values of response must not fall, got {falls:g} after a larger value")
    return curve


def check_layers(name: str, layers: Any) -> tuple[tuple[str, float], ...]:
    """Check filters or cover layers and convert them to tuples of material and thickness.

    Parameters
    ----------
    name : str
        Name of the field, shown in error messages.
    layers : sequence of (str, float)
        Material and thickness in mm of each layer.

    Returns
    -------
    tuple of (str, float)
        Material and thickness in mm of each layer.

    Raises
    ------
    InputError
        If `layers` has another form, or a thickness is not between 0 and 100 mm.
    """
    if not isinstance(layers, list | tuple) or not all(
        isinstance(each, list | tuple) and len(each) == 2 and isinstance(each[0], str) for each in layers
    ):
        raise InputError(
            f"{name} must be pairs of a material and a thickness, such as [['Cu@8.96', 0.1]], got {layers!r}"
        )
    for material, mm in layers:
        require_in_range(f"thickness of {material} in {name}", mm, 0, _MAX_LAYER_MM, "mm")
    return tuple((material, float(mm)) for material, mm in layers)


def check_pairs(
    name: str, pairs: Any, first: tuple[float, float, str], second: tuple[float, float, str]
) -> tuple[tuple[float, float], ...]:
    """Check a table of two columns, of which the first ascends, and convert it to tuples of numbers.

    Parameters
    ----------
    name : str
        Name of the field, shown in error messages.
    pairs : sequence of (float, float)
        Rows of the table.
    first, second : (float, float, str)
        Lowest and highest value, and unit, of each column.

    Returns
    -------
    tuple of (float, float)
        Rows of the table.

    Raises
    ------
    InputError
        If the table has another form, a value is out of range, or the first column does not ascend.
    """
    if (
        not isinstance(pairs, list | tuple)
        or not 2 <= len(pairs) <= _MAX_TABLE
        or not all(isinstance(each, list | tuple) and len(each) == 2 for each in pairs)
    ):
        got = f"{len(pairs)} entries" if isinstance(pairs, list | tuple) else repr(pairs)
        raise InputError(f"{name} must be 2 to {_MAX_TABLE} pairs of numbers, got {got}")
    for each in pairs:
        for column, value, (low, high, unit) in zip(("first", "second"), each, (first, second), strict=True):
            require_in_range(f"{column} column of {name}", value, low, high, unit)
    rows = tuple((float(one), float(other)) for one, other in pairs)
    wrong = next((after for (before, _), (after, _) in pairwise(rows) if not before < after), None)
    if wrong is not None:
        raise InputError(f"first column of {name} must ascend, got {wrong:g} after a value that is not smaller")
    return rows


@cache
def load_detectors() -> dict[str, Detector]:
    """Load all detectors of the package.

    Returns
    -------
    dict of str to Detector
        Detectors, keyed by name.
    """
    return {name: load_detector(name) for name in list_detectors()}


def load_detector(name_or_path: str | PathLike[str]) -> Detector:
    """Load a built-in detector by name, or a detector of the user from a TOML file.

    The entry ``base`` of a file is the name of a built-in detector or the relative path of another detector file. A
    file with a ``base`` specifies only the fields that differ from the base detector.

    Parameters
    ----------
    name_or_path : str or path-like
        Name of a detector, such as "csi", or path of a ``.toml`` file.

    Returns
    -------
    Detector
        Constructed and checked detector.

    Raises
    ------
    InputError
        If the name is unknown, the file cannot be read, a field name is unknown or missing, a value is not allowed, or
        the chain of ``base`` files is circular.

    Examples
    --------
    >>> import pssf
    >>> pssf.load_detector("gos").formula
    'Gd2O2S'
    """
    table, what = read_detector_fields(name_or_path)
    return build_from_table(Detector, table, what)


def resolve_detector(detector: str | Detector) -> Detector:
    """Return a detector, looked up by name if necessary.

    Parameters
    ----------
    detector : str or Detector
        Name of a detector of the package, or a detector.

    Returns
    -------
    Detector
        The detector.

    Raises
    ------
    InputError
        If the name is unknown.
    """
    if isinstance(detector, Detector):
        return detector
    require_choice("detector", detector, tuple(load_detectors()))
    return load_detectors()[detector]
