"""Define the protocol of a radiograph: exposure technique, geometry, detector and enabled simulation stages."""

import math
from dataclasses import asdict, dataclass, fields, replace
from os import PathLike
from typing import Any

from ..core.checks import InputError, build_from_table, require_integer, require_path
from ..core.keyword_arguments import check_keywords, renamed_attribute, update_field_names
from ..data.data_files import read_protocol_fields, read_spectrum
from ..data.knees.field_definitions import check_fields
from .detector import Detector, check_layers, check_pairs, load_detector

# Rotation of the leg for each projection: axis (0 is x, 2 is z) and angle in degrees, before the knee is mirrored in y.
# ML and LM turn the lateral side of a right leg to the detector, and axial turns the foot to the detector.
_VIEW_ROTATIONS = {"AP": (2, 0.0), "PA": (2, 0.0), "ML": (2, -90.0), "LM": (2, -90.0), "axial": (0, -90.0)}

# Largest tangent of the angle from the central ray to the edge of the field, as a fraction of the tangent of the anode
# angle. The limit is assumed: nearer to the anode cut-off, the intensity is below two fifths of its central value.
_MAX_CUT_OFF_FRACTION = 0.95
# Range and unit of the photon energies of a spectrum from the user.
_SPECTRUM_KEV = (1.0, 500.0, "keV")
# Range and unit of the photons in a bin of a spectrum from the user.
_SPECTRUM_PHOTONS = (0.0, 1e12, "per mm2 and mAs")


@dataclass(frozen=True, kw_only=True)
class Posture:
    """Posture of a leg in front of the detector; by default the leg is straight and imaged from the front.

    Parameters
    ----------
    projection : {"AP", "PA", "ML", "LM", "axial"}, default "AP"
        Direction of the beam, as in `Protocol`.
    flexion_deg : float, default 0
        Flexion by positioning, in degrees, which is added to `Knee.flexion_deg`.
    tibia_forward_deg : float, default 0
        Forward lean of the tibia, in degrees, as in `Protocol`.
    rotation_deg : float, default 0
        Rotation about the long axis by positioning, in degrees, which is added to `Knee.rotation_deg`; positive is
        internal.
    tilt_deg : float, default 0
        Lean in the plane of the radiograph by positioning, in degrees, which is added to `Knee.lean_deg`; positive
        moves the foot medially.
    """

    projection: str = "AP"
    flexion_deg: float = 0.0
    tibia_forward_deg: float = 0.0
    rotation_deg: float = 0.0
    tilt_deg: float = 0.0

    @property
    def mirror_y(self) -> float:
        """Factor for y coordinates: -1 for projections that mirror the knee in y (PA, LM and axial), else 1."""
        return -1.0 if self.projection in ("PA", "LM", "axial") else 1.0

    @property
    def view_rotation(self) -> tuple[int, float]:
        """Last rotation of the posed leg: axis (0 is x, 1 is y, 2 is z) and angle in degrees."""
        return _VIEW_ROTATIONS[self.projection]

    @property
    def is_frontal(self) -> bool:
        """Whether the projection is AP or PA, which show the tibiofemoral joint space in the frontal plane."""
        return self.view_rotation == _VIEW_ROTATIONS["AP"]


# Deprecated field name -> current field name.
RENAMED_FIELDS = {"apart_mm": "knee_distance_mm"}


@check_keywords(**RENAMED_FIELDS)
@dataclass(frozen=True, kw_only=True)
class Protocol:
    """Exposure technique, geometry and detector of a radiograph, and the enabled simulation stages.

    Parameters
    ----------
    name : str
        Name of the protocol, used in file names. Allowed: 1 to 64 letters, digits, _ and -.
    tube_kv : float
        Peak tube voltage. Allowed: 20 to 300 kV.
    mas : float
        Product of tube current and exposure time; 0 gives no exposure. Allowed: 0 to 500 mAs.
    filtration_mm_al : float
        Total filtration of the beam. Allowed: 0 to 40 mm Al.
    anode_angle_deg : float
        Angle of the tungsten anode. Allowed: 6 to 45 degrees.
    focal_spot_mm : float
        Size of the focal spot: side length of a square, or full width at half maximum of a Gaussian; 0 is a point
        source without focal-spot blur. Allowed: 0 to 3 mm.
    sdd_mm : float
        Distance from the source to the detector. Allowed: 200 to 3000 mm.
    sod_mm : float
        Distance from the source to the centre of the joint; must be less than sdd_mm. Allowed: 10 to 2900 mm.
    beam_angle_deg : float
        Rotation of the source about the x axis, relative to the direction set by beam_along; positive angles point the
        beam caudally. Allowed: -30 to 30 degrees.
    rows : int
        Number of detector rows. Allowed: 1 to 8192 pixels.
    cols : int
        Number of detector columns. Allowed: 1 to 8192 pixels.
    pixel_mm : float
        Pixel pitch of the detector. Allowed: 0.001 to 50 mm.
    mono_kev : float, optional
        Photon energy of a monochromatic beam with 1e6 photons per mm2 and mAs at 1 m, which replaces the tube spectrum.
        None: the tube spectrum is used. Allowed: 5 to 500 keV.
    filters : tuple of (str, float), default ()
        Filters between tube and knee, in addition to the total filtration: material and thickness of each filter.
        Allowed: pairs of a material and a thickness of 0 to 100 mm, such as [['Cu@8.96', 0.1]].
    spectrum : tuple of (float, float), optional
        Spectrum behind the total filtration, which replaces the computed spectrum: photon energy in keV, and photons
        per mm2 and mAs at 1 m, of each bin. A protocol file may contain the name of a CSV file with two columns. None:
        the spectrum is computed. Allowed: 2 to 2000 pairs of an energy (1 to 500 keV, ascending) and a number of
        photons.
    heel : {"none", "anode_proximal", "anode_distal"}, default "none"
        Heel effect: the intensity decreases towards the anode, which is at the proximal or the distal end.
    projection : {"AP", "PA", "ML", "LM", "axial"}, default "AP"
        Direction of the beam. The detector is behind the knee (AP), in front of the knee (PA), or lateral (ML), medial
        (LM) or distal (axial) to the knee.
    flexion_deg : float, default 0
        Flexion that positioning adds to the flexion of the knee. Allowed: 0 to 60 degrees.
    tibia_forward_deg : float, default 0
        Forward lean of the tibia from the vertical, seen from the side. In axial projection: angle between tibia and
        beam; positive values move the foot backwards. Allowed: -15 to 45 degrees.
    rotation_deg : float, default 0
        Rotation of the leg about its long axis that positioning adds to the rotation of the knee; positive is internal.
        Allowed: -20 to 20 degrees.
    tilt_deg : float, default 0
        Lean of the leg in the plane of the radiograph that positioning adds to the lean of the knee; positive values
        move the foot medially. Allowed: -15 to 15 degrees.
    knee_distance_mm : float, default 0
        Distance between the two knees of a bilateral radiograph; 0 images one knee. Allowed: 0 to 350 mm.
    beam_along : {"horizontal", "medial_plateau"}, default "horizontal"
        Reference direction of the beam. "medial_plateau" aligns the beam with the medial plateau of each knee, as under
        fluoroscopy: the anterior and posterior plateau margins coincide.
    centre_x_mm : float, default 0
        Horizontal distance from the middle of the knee to the central ray, in the joint plane; positive is to the right
        of the radiograph. Allowed: -150 to 150 mm.
    centre_z_mm : float, default 0
        Vertical distance from the joint line to the central ray, in the joint plane; positive is upwards. Allowed: -150
        to 150 mm.
    detector_offset_x_mm : float, default 0
        Horizontal distance from the central ray to the centre of the detector and of the collimated field, in the
        detector plane; positive is to the right of the radiograph. Allowed: -500 to 500 mm.
    detector_offset_z_mm : float, default 0
        Vertical distance from the central ray to the centre of the detector and of the collimated field, in the
        detector plane; positive is upwards. Allowed: -500 to 500 mm.
    field_width_mm : float, default 0
        Width of the collimated field on the detector, centred on the detector; 0 irradiates the full detector width.
        Allowed: 0 to 3000 mm.
    field_height_mm : float, default 0
        Height of the collimated field on the detector, centred on the detector; 0 irradiates the full detector height.
        Allowed: 0 to 3000 mm.
    marker : {"none", "R", "L"}, default "none"
        Lead marker on the detector cover: letter R on the left, or letter L on the right of the radiograph.
    texture : {"trabecular", "none"}, default "trabecular"
        Trabecular texture. "none" gives the trabecular bone a uniform density.
    focal_spot_shape : {"square", "gaussian"}, default "square"
        Intensity distribution of the focal spot: uniform over a square, or Gaussian in both directions.
    focal_spot : {"blur", "sampled"}, default "blur"
        Model of focal-spot blur. "blur" applies the blur in the joint plane to the entire image. "sampled" casts rays
        from 3 x 3 points of the focal spot, which is correct at every depth.
    subpixels : int, default 1
        Square root of the number of rays per pixel, whose signals are averaged over the pixel area before detector
        blur. 1 casts one ray through the pixel centre. 0 casts 25 rays per pixel if the scene has edges that one ray
        per pixel does not resolve, up to 256 if it has bodies thinner than a pixel, and otherwise one ray. Allowed: 0
        to 16.
    scatter : {"kernel", "monte_carlo", "none"}, default "kernel"
        Model of scattered radiation. "kernel" is fast and fitted to Monte Carlo results. "monte_carlo" transports
        photons through the voxels of the scene and takes about 20 s.
    scatter_photons : int, default 20_000_000
        Number of photons in the scatter model "monte_carlo"; the statistical error decreases with the square root of
        this number. Allowed: 32 to 1e+12.
    grid_ratio : float, default 0
        Grid ratio of a moving anti-scatter grid: height of the lead strips divided by the distance between them; 0 is
        no grid. Allowed: 0 to 20.
    grid_lines_per_cm : float, default 40
        Number of grid strips per cm; strips are 0.05 mm of lead with aluminium between them. Allowed: 20 to 120
        lines/cm.
    detector : {"csi", "gos", "ideal"} or Detector, default "csi"
        Detector: name, or path of a detector file, relative to the protocol file. "csi" is a caesium iodide flat panel,
        "gos" is a gadolinium oxysulphide screen with less mass per area, and "ideal" absorbs the entire energy of every
        photon without blur or readout noise.
    detector_blur : {"mtf", "none"}, default "mtf"
        Detector blur. "mtf" applies the presampled modulation transfer function (MTF) of the detector.
    dead_pixels : float, default 0
        Fraction of pixels without signal; the dead pixels are the same in every exposure with the same detector.
        Allowed: 0 to 0.1.
    noise : {"quantum", "none"}, default "quantum"
        Noise model. "quantum" adds Poisson noise of the absorbed photons and readout noise.

    Raises
    ------
    InputError
        If a value is out of range (``data/protocol_fields.toml``), or two fields contradict each other.

    Notes
    -----
    The central ray passes through the origin of the knee frame, shifted by `centre_x_mm` and `centre_z_mm`;
    `geometry.view.resolve_view` computes the positions of source and detector. ``pssf protocols`` lists the fields with
    typical values and sources. A disabled simulation stage takes no time.

    Examples
    --------
    >>> import dataclasses, pssf
    >>> protocol = dataclasses.replace(pssf.load_protocol("reference"), name="low_mas", mas=1.0)
    >>> protocol.tube_kv, protocol.mas
    (70.0, 1.0)
    """

    name: str
    tube_kv: float
    mas: float
    filtration_mm_al: float
    anode_angle_deg: float
    focal_spot_mm: float
    sdd_mm: float
    sod_mm: float
    beam_angle_deg: float
    rows: int
    cols: int
    pixel_mm: float
    mono_kev: float | None = None
    filters: tuple[tuple[str, float], ...] = ()
    spectrum: tuple[tuple[float, float], ...] | None = None
    heel: str = "none"
    projection: str = "AP"
    flexion_deg: float = 0.0
    tibia_forward_deg: float = 0.0
    rotation_deg: float = 0.0
    tilt_deg: float = 0.0
    knee_distance_mm: float = 0.0
    beam_along: str = "horizontal"
    centre_x_mm: float = 0.0
    centre_z_mm: float = 0.0
    detector_offset_x_mm: float = 0.0
    detector_offset_z_mm: float = 0.0
    field_width_mm: float = 0.0
    field_height_mm: float = 0.0
    marker: str = "none"
    texture: str = "trabecular"
    focal_spot_shape: str = "square"
    focal_spot: str = "blur"
    subpixels: int = 1
    scatter: str = "kernel"
    scatter_photons: int = 20_000_000
    grid_ratio: float = 0.0
    grid_lines_per_cm: float = 40.0
    detector: str | Detector = "csi"
    detector_blur: str = "mtf"
    dead_pixels: float = 0.0
    noise: str = "quantum"

    # Deprecated names, available for one more version.
    apart_mm = renamed_attribute("knee_distance_mm")

    def __post_init__(self) -> None:
        object.__setattr__(self, "detector", _convert_detector(self.detector))
        check_fields("protocol", self)
        object.__setattr__(self, "filters", check_layers("filters", self.filters))
        if self.filters and self.mono_kev is not None:
            raise InputError(
                f"filters must be empty with mono_kev, whose photons are counted behind all filters, got {self.filters}"
            )
        if self.spectrum is not None:
            object.__setattr__(self, "spectrum", _convert_spectrum(self.spectrum))
            self._check_own_spectrum()
        if not self.sod_mm < self.sdd_mm:
            raise InputError(f"sod_mm must be less than sdd_mm = {self.sdd_mm!r} mm, got {self.sod_mm!r} mm")
        if not self.posture.is_frontal:
            self._check_lateral_or_axial()
        if self.heel != "none":
            self._check_heel()

    def _check_lateral_or_axial(self) -> None:
        """Check that fields that apply only to frontal views (AP and PA) have their default values."""
        if self.beam_along != "horizontal":
            raise InputError(
                f"beam_along must be 'horizontal' with projection = {self.projection!r}, got {self.beam_along!r}: only "
                "in AP and PA are the plateau margins edge-on to the beam"
            )
        if self.knee_distance_mm and self.projection != "axial":
            raise InputError(
                f"knee_distance_mm must be 0 with projection = {self.projection!r}, got {self.knee_distance_mm:g} mm: "
                "one knee would cover the other; use AP, PA or axial for two knees"
            )

    def _check_own_spectrum(self) -> None:
        """Check that no other field contradicts a spectrum from the user."""
        if self.mono_kev is not None:
            raise InputError(f"mono_kev must be None with a spectrum of your own, got {self.mono_kev:g} keV")
        if self.heel != "none":
            raise InputError(
                f"heel must be 'none' with a spectrum of your own, got {self.heel!r}: the heel effect needs the "
                "spectrum at every angle, which pssf computes only for a tungsten anode"
            )

    def _check_heel(self) -> None:
        """Check that the entire field is within the anode cut-off, beyond which the intensity is zero."""
        least_deg = math.degrees(math.atan(self.field_edge_tangent / _MAX_CUT_OFF_FRACTION))
        if self.anode_angle_deg < least_deg:
            raise InputError(
                f"anode_angle_deg must be at least {math.ceil(10 * least_deg) / 10:g} deg with heel = {self.heel!r}, "
                f"got {self.anode_angle_deg:g} deg: the anode cuts off the field; set field_height_mm or raise sdd_mm"
            )

    @property
    def field_edge_tangent(self) -> float:
        """Tangent of the angle between the central ray and the farther of the upper and lower edges of the field."""
        whole_mm = self.rows * self.pixel_mm
        # The field includes the outer half of the penumbra on both sides, which is less than 15 mm wide.
        lit_mm = min(whole_mm, 1.1 * self.field_height_mm + 30.0) if self.field_height_mm > 0 else whole_mm
        return (lit_mm / 2 + abs(self.detector_offset_z_mm)) / self.sdd_mm

    @property
    def has_plain_beam(self) -> bool:
        """True if the beam is the computed tube spectrum behind aluminium alone."""
        return self.mono_kev is None and self.spectrum is None and not self.filters

    def resample(self, matrix: int) -> "Protocol":
        """Change the number of pixels and the pixel pitch without changing the detector size.

        Parameters
        ----------
        matrix : int
            Number of pixels along the longer side of the detector, 1 to 8192. The length of the shorter side changes by
            at most half a pixel.

        Returns
        -------
        Protocol
            Copy of the protocol with new `rows`, `cols` and `pixel_mm`.

        Raises
        ------
        InputError
            If `matrix` is out of range.

        Examples
        --------
        >>> import pssf
        >>> small = pssf.load_protocol("reference").resample(512)
        >>> small.rows, small.cols, small.pixel_mm
        (512, 512, 0.6)
        """
        require_integer("matrix", matrix, 1, 8192, "pixels")
        most = max(self.rows, self.cols)
        rows, cols = (max(1, round(side * matrix / most)) for side in (self.rows, self.cols))
        return replace(self, rows=rows, cols=cols, pixel_mm=round(self.pixel_mm * most / matrix, 9))

    @property
    def posture(self) -> Posture:
        """Leg posture that the protocol specifies."""
        return Posture(**{field.name: getattr(self, field.name) for field in fields(Posture)})


def _convert_detector(detector: Any) -> Any:
    """Convert the path of a detector file, or the fields of a detector, to a Detector; leave other values unchanged."""
    if isinstance(detector, dict):
        return build_from_table(Detector, detector, "detector")
    if isinstance(detector, PathLike) or (isinstance(detector, str) and detector.endswith(".toml")):
        return load_detector(detector)
    if not isinstance(detector, str | Detector):
        raise InputError(f"detector must be a name, the path of a .toml file or a Detector, got {detector!r}")
    return detector


def _convert_spectrum(spectrum: Any) -> tuple[tuple[float, float], ...]:
    """Check a spectrum, or the path of its file, and convert it to tuples of energy in keV and number of photons."""
    if isinstance(spectrum, str | PathLike):
        spectrum = read_spectrum(require_path(spectrum, "spectrum"))
    bins = check_pairs("spectrum", spectrum, _SPECTRUM_KEV, _SPECTRUM_PHOTONS)
    if not any(photons for _, photons in bins):
        raise InputError(f"spectrum must have photons in at least one bin, got 0 in all {len(bins)} bins")
    return bins


def protocol_from_dict(table: dict[str, Any], source_name: str) -> Protocol:
    """Construct a protocol from a mapping of its fields.

    Parameters
    ----------
    table : dict of str to object
        Values keyed by field name, such as a parsed TOML or JSON file.
    source_name : str
        Name of the file or object, shown at the start of error messages.

    Returns
    -------
    Protocol
        Constructed and checked protocol.

    Raises
    ------
    InputError
        If a field name is unknown or missing, or a value is not allowed.
    """
    return build_from_table(Protocol, update_field_names(table, RENAMED_FIELDS, source_name), source_name)


def load_protocol(name_or_path: str | PathLike[str]) -> Protocol:
    """Load a built-in protocol by name, or a user protocol from a TOML file.

    The entry ``base`` of a file is the name or the relative path of another protocol. A file with a ``base`` specifies
    only the fields that differ from the base protocol.

    Parameters
    ----------
    name_or_path : str or path-like
        Name of a protocol, such as "reference" or "fixed_flexion", or path of a ``.toml`` file.

    Returns
    -------
    Protocol
        Constructed and checked protocol.

    Raises
    ------
    InputError
        If the name is unknown, the file cannot be read, a field name is unknown or missing, a value is not allowed, or
        the chain of ``base`` files is circular.

    Examples
    --------
    >>> import pssf
    >>> pssf.load_protocol("fixed_flexion").projection
    'PA'
    """
    table, what = read_protocol_fields(name_or_path)
    return protocol_from_dict(table, what)


def protocol_to_dict(protocol: Protocol) -> dict[str, Any]:
    """Convert a protocol to a JSON-compatible mapping, which `protocol_from_dict` converts back.

    Parameters
    ----------
    protocol : Protocol
        Protocol to convert.

    Returns
    -------
    dict of str to object
        Values keyed by field name. Tuples become lists, and a detector becomes a mapping of its fields.
    """
    return {name: _convert_to_lists(value) for name, value in asdict(protocol).items()}


def _convert_to_lists(value: Any) -> Any:
    """Convert the tuples of a field value to lists, as they are read from JSON."""
    if isinstance(value, dict):
        return {name: _convert_to_lists(one) for name, one in value.items()}
    return [_convert_to_lists(one) for one in value] if isinstance(value, tuple) else value
