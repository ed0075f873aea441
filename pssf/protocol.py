"""Protocol: how a radiograph is taken. Technique, geometry, detector, and which stages of the chain are wanted."""

import re
from dataclasses import asdict, dataclass
from os import PathLike
from typing import Any

from .checks import InputError, from_table, require, require_choice, require_whole
from .files import tables


@dataclass(frozen=True, kw_only=True)
class Protocol:
    """A technique. The central ray passes the origin of the knee frame; see `geometry.view_of`.

    A stage that is not asked for costs nothing: focal_spot_mm = 0 leaves out the focal-spot blur, mono_kev replaces the
    tube's spectrum by one energy, and texture, scatter, detector_blur and noise take "none". Without texture,
    spongy bone has its material's own density throughout.
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
    texture: str = "trabecular"
    scatter: str = "kernel"
    detector_blur: str = "csi"
    noise: str = "quantum"

    def __post_init__(self) -> None:
        if not isinstance(self.name, str) or not re.fullmatch(r"[\w-]{1,64}", self.name):
            raise InputError(f"name = {self.name!r}; allowed: 1 to 64 letters, digits, _ and - (it names files)")
        require("tube_kv", self.tube_kv, 40, 120, "kV")
        require("mas", self.mas, 0, 500, "mAs")
        require("filtration_mm_al", self.filtration_mm_al, 0.5, 40, "mm Al")
        require("anode_angle_deg", self.anode_angle_deg, 6, 22, "deg")
        require("focal_spot_mm", self.focal_spot_mm, 0, 3, "mm")
        require("sdd_mm", self.sdd_mm, 500, 3000, "mm")
        require("sod_mm", self.sod_mm, 300, 2900, "mm")
        if not self.sod_mm < self.sdd_mm:
            raise InputError(f"sod_mm = {self.sod_mm!r} mm; allowed: less than sdd_mm = {self.sdd_mm!r} mm")
        require("beam_angle_deg", self.beam_angle_deg, -30, 30, "deg")
        require_whole("rows", self.rows, 1, 8192, "pixels")
        require_whole("cols", self.cols, 1, 8192, "pixels")
        require("pixel_mm", self.pixel_mm, 0.001, 50, "mm")
        if self.mono_kev is not None:
            require("mono_kev", self.mono_kev, 5, 150, "keV")
        require_choice("texture", self.texture, ("trabecular", "none"))
        require_choice("scatter", self.scatter, ("kernel", "none"))
        require_choice("detector_blur", self.detector_blur, ("csi", "none"))
        require_choice("noise", self.noise, ("quantum", "none"))


def protocol_from(table: dict[str, Any], what: str) -> Protocol:
    """A protocol from a mapping of its fields; `what` names the origin in a refusal."""
    return from_table(Protocol, table, what)


def load_protocol(name_or_path: str | PathLike[str]) -> Protocol:
    """A protocol that comes with the package, by name, or any TOML file, by path.

    raises  InputError for an unknown name, an unreadable file, a misspelt, missing or refused field
    """
    table, what = tables.read_protocol(name_or_path)
    return protocol_from(table, what)


def protocol_table(protocol: Protocol) -> dict[str, Any]:
    """Field name -> value of a protocol, as `protocol_from` takes it back (JSON-ready)."""
    return asdict(protocol)
