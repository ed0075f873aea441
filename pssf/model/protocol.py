"""Protocol: how a radiograph is taken. Technique, geometry, detector, and which stages of the chain are wanted."""

import math
from dataclasses import asdict, dataclass, fields, replace
from os import PathLike
from typing import Any

from ..core.checks import InputError, from_table, require_whole
from ..core.keywords import keywords
from ..data.fields import check_fields
from ..data.tables import read_protocol

# A right leg's lateral side comes to the detector (ML, LM), or its foot (axial), before it is mirrored in y.
_TURNS = {"AP": (2, 0.0), "PA": (2, 0.0), "ML": (2, -90.0), "LM": (2, -90.0), "axial": (0, -90.0)}

# A field may reach so far towards the anode's cut-off, as a part of the tangent of the anode's angle (assumed: beyond,
# the intensity is below two fifths of that on the central ray).
_MOST_OF_CUT_OFF = 0.95


@dataclass(frozen=True, kw_only=True)
class Posture:
    """How a leg stands; fields as in `Protocol`. By default it is straight, and seen from the front."""

    projection: str = "AP"
    flexion_deg: float = 0.0
    tibia_forward_deg: float = 0.0
    rotation_deg: float = 0.0
    tilt_deg: float = 0.0

    @property
    def mirror_y(self) -> float:
        """Factor of y: -1 where the knee is mirrored, since it is shown as seen from the other side of the detector."""
        return -1.0 if self.projection in ("PA", "LM", "axial") else 1.0

    @property
    def turn(self) -> tuple[int, float]:
        """The last turn of a leg that stands: about x, y or z (0, 1 or 2), and by how many degrees."""
        return _TURNS[self.projection]

    @property
    def is_frontal(self) -> bool:
        """Whether the tibiofemoral joint space, and the contours that its landmarks lie on, are seen from the front."""
        return self.turn == _TURNS["AP"]


@keywords()
@dataclass(frozen=True, kw_only=True)
class Protocol:
    """A technique. The central ray passes the origin of the knee frame, or where `centre_*` say; `geometry.view_of`.

    What each field is, its unit and what it may be is in `data/protocol_fields.toml`; `pssf protocols` prints it.
    A stage that is not asked for costs nothing: focal_spot_mm = 0 leaves out the focal-spot blur, mono_kev replaces the
    tube's spectrum by one energy, field_*_mm = 0 opens the collimator, and heel, marker, texture, scatter,
    detector_blur and noise take "none". Without texture, spongy bone has its material's own density throughout.
    raises InputError for a value out of range
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
    heel: str = "none"
    projection: str = "AP"
    flexion_deg: float = 0.0
    tibia_forward_deg: float = 0.0
    rotation_deg: float = 0.0
    tilt_deg: float = 0.0
    apart_mm: float = 0.0
    beam_along: str = "horizontal"
    centre_x_mm: float = 0.0
    centre_z_mm: float = 0.0
    field_width_mm: float = 0.0
    field_height_mm: float = 0.0
    marker: str = "none"
    texture: str = "trabecular"
    focal_spot: str = "blur"
    scatter: str = "kernel"
    scatter_photons: int = 20_000_000
    grid_ratio: float = 0.0
    grid_lines_per_cm: float = 40.0
    detector: str = "csi"
    detector_blur: str = "mtf"
    dead_pixels: float = 0.0
    noise: str = "quantum"

    def __post_init__(self) -> None:
        check_fields("protocol", self)
        if not self.sod_mm < self.sdd_mm:
            raise InputError(f"sod_mm = {self.sod_mm!r} mm; allowed: less than sdd_mm = {self.sdd_mm!r} mm")
        if not self.posture.is_frontal:
            self._check_turned()
        if self.heel != "none":
            self._check_heel()

    def _check_turned(self) -> None:
        """What is told of a leg that is seen from the front has no meaning from its side or along it."""
        if self.beam_along != "horizontal":
            raise InputError(
                f"beam_along = {self.beam_along!r} with projection = {self.projection!r}; allowed: AP or PA, where the "
                "margins of the plateau are seen edge on"
            )
        if self.apart_mm and self.projection != "axial":
            raise InputError(
                f"apart_mm = {self.apart_mm:g} mm with projection = {self.projection!r}; allowed: 0, since one knee "
                "would hide the other, or AP, PA or axial"
            )

    def _check_heel(self) -> None:
        """Refuse a field that reaches beyond what the anode emits: there the intensity falls to nothing."""
        least_deg = math.degrees(math.atan(self.heel_slope / _MOST_OF_CUT_OFF))
        if self.anode_angle_deg < least_deg:
            raise InputError(
                f"anode_angle_deg must be at least {math.ceil(10 * least_deg) / 10:g} deg with heel = {self.heel!r}, "
                f"got {self.anode_angle_deg:g}: the anode cuts off the field; give field_height_mm, or raise sdd_mm"
            )

    @property
    def heel_slope(self) -> float:
        """Tangent of the angle from the central ray to the upper and lower edge of the field."""
        whole_mm = self.rows * self.pixel_mm
        # Beside the collimated field lies half of its penumbra, less than 15 mm.
        lit_mm = min(whole_mm, 1.1 * self.field_height_mm + 30.0) if self.field_height_mm > 0 else whole_mm
        return lit_mm / 2 / self.sdd_mm

    def resampled(self, matrix: int) -> "Protocol":
        """Change the number of pixels and keep the field: the pixel size follows.

        Parameters
        ----------
        matrix : int
            Pixels along the longer side of the detector. The shorter side gets as many as keep its length to within
            half a pixel.

        Returns
        -------
        Protocol
            The same protocol with other `rows`, `cols` and `pixel_mm`.

        Raises
        ------
        InputError
            For a number of pixels that is out of range.

        Examples
        --------
        >>> small = load_protocol("reference").resampled(512)
        >>> small.rows, small.cols, small.pixel_mm
        (512, 512, 0.6)
        """
        require_whole("matrix", matrix, 1, 8192, "pixels")
        most = max(self.rows, self.cols)
        rows, cols = (max(1, round(side * matrix / most)) for side in (self.rows, self.cols))
        return replace(self, rows=rows, cols=cols, pixel_mm=round(self.pixel_mm * most / matrix, 9))

    @property
    def posture(self) -> Posture:
        """How a leg stands for it."""
        return Posture(**{field.name: getattr(self, field.name) for field in fields(Posture)})


def protocol_from(table: dict[str, Any], what: str) -> Protocol:
    """A protocol from a mapping of its fields; `what` names the origin in a refusal."""
    return from_table(Protocol, table, what)


def load_protocol(name_or_path: str | PathLike[str]) -> Protocol:
    """A protocol that comes with the package, by name, or any TOML file, by path.

    A file may name another as its `base`, by name or by a path from where it lies, and give only what differs.
    raises  InputError for an unknown name, an unreadable file, a misspelt, missing or refused field, a base of itself
    """
    table, what = read_protocol(name_or_path)
    return protocol_from(table, what)


def protocol_table(protocol: Protocol) -> dict[str, Any]:
    """Field name -> value of a protocol, as `protocol_from` takes it back (JSON-ready)."""
    return asdict(protocol)
