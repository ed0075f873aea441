"""Anti-scatter grid: lead strips parallel to the leg axis that transmit primary radiation and absorb most scatter."""

from dataclasses import dataclass, replace

import numpy as np

from ..core.checks import Array, InputError, require_in_range
from ..model.protocol import Protocol
from ..xray.materials import Material, attenuation_per_mm, parse_compound
from ..xray.spectrum import Beam

# Half-sizes of the irradiated exit surface of a limb, across the strips and along the strips, in mm; assumed.
_EXIT_FACE_HALF_SIZE_MM = (80.0, 150.0)
# Depth below the exit surface at which scatter originates, in mm; assumed (Sorenson and Floch 1985: 150 to 200 mm for a
# trunk).
_SCATTER_DEPTH_MM = 40.0
# Thickness of the limb that hardens the beam in front of the grid, in mm; assumed.
_LIMB_THICKNESS_MM = 100.0


@dataclass(frozen=True, kw_only=True)
class Grid:
    """Focused grid of lead strips with aluminium interspaces; grid covers are neglected.

    Parameters
    ----------
    ratio : float, default 10
        Grid ratio: height of the strips divided by the distance between them, from 2 to 20.
    lines_per_cm : float, default 40
        Number of strips per cm, from 20 to 120.
    lead_mm : float, default 0.05
        Thickness of a strip, from 0.005 to 0.2 mm.

    Raises
    ------
    InputError
        If a number is out of range, or the strips are so thick that no gap remains between strips.
    """

    ratio: float = 10.0
    lines_per_cm: float = 40.0
    lead_mm: float = 0.05

    def __post_init__(self) -> None:
        require_in_range("grid ratio", self.ratio, 2, 20, "")
        require_in_range("lines_per_cm", self.lines_per_cm, 20, 120, "lines/cm")
        require_in_range("lead_mm", self.lead_mm, 0.005, 0.2, "mm")
        if not self.lead_mm < 9.0 / self.lines_per_cm:
            most = f"less than {9.0 / self.lines_per_cm:.3g} mm at {self.lines_per_cm:g} lines/cm"
            raise InputError(f"lead_mm must be {most}, got {self.lead_mm!r} mm")


def make_grid(protocol: Protocol) -> Grid:
    """Make the anti-scatter grid of a protocol.

    Parameters
    ----------
    protocol : Protocol
        Protocol with `grid_ratio` and `grid_lines_per_cm`.

    Returns
    -------
    Grid
        Grid with strips of the default thickness.

    Raises
    ------
    InputError
        If the strips are so thick that no gap remains between strips.
    """
    return Grid(ratio=protocol.grid_ratio, lines_per_cm=protocol.grid_lines_per_cm)


def compute_primary_transmission(grid: Grid, energies_kev: Array) -> Array:
    """Compute the transmission of a moving anti-scatter grid for photons that travel parallel to the strips.

    Parameters
    ----------
    grid : Grid
        Anti-scatter grid.
    energies_kev : (nodes,) array, keV
        Photon energies.

    Returns
    -------
    (nodes,) float64 array
        Transmission from 0 to 1.
    """
    return np.asarray(_compute_transmission(grid, _strip_attenuation_per_mm(energies_kev), 0.0, np.ones(1))[0])


def transmit_through_grid(grid: Grid, beam: Beam) -> Beam:
    """Attenuate the primary beam by a moving anti-scatter grid.

    The motion removes grid lines from the image. Primary photons travel parallel to the strips.

    Parameters
    ----------
    grid : Grid
        Anti-scatter grid.
    beam : Beam
        Beam in front of the grid.

    Returns
    -------
    Beam
        Beam behind the grid.
    """
    transmission = compute_primary_transmission(grid, beam.energies_kev)
    return replace(beam, photons_per_mm2=beam.photons_per_mm2 * transmission)


def compute_scatter_transmission(grid: Grid, beam: Beam, gap_mm: float, limb: Material) -> float:
    """Compute the fraction of the scatter that an anti-scatter grid transmits.

    Parameters
    ----------
    grid : Grid
        Anti-scatter grid.
    beam : Beam
        Beam without an object.
    gap_mm : float
        Distance from the exit surface of the object to the detector, in mm. A larger gap decreases the incidence angles
        of the scatter.
    limb : Material
        Material of the limb, which hardens the beam in front of the grid.

    Returns
    -------
    float
        Transmitted fraction of the scatter signal, from 0 to 1.

    Notes
    -----
    The transmission of a photon is exp(-attenuation in lead and aluminium), with the geometry of Day and Dance 1983.
    The transmission is averaged over positions across the strips, over directions with uniform radiance from the exit
    surface, and over the photon energies behind the limb. Scatter in the grid and fluorescence of the lead are
    neglected.
    """
    weights = beam.photons_per_mm2 * beam.signal_kev
    weights = weights * np.exp(-attenuation_per_mm(limb, beam.energies_kev) * _LIMB_THICKNESS_MM)
    weights = weights / weights.sum() if weights.any() else np.full(len(weights), 1 / len(weights))
    across, along = (np.linspace(-half, half, 81) for half in _EXIT_FACE_HALF_SIZE_MM)
    far2 = across[:, None] ** 2 + along**2 + (gap_mm + _SCATTER_DEPTH_MM) ** 2
    # For uniform radiance, the energy per area in the detector plane is proportional to the fourth power of the cosine.
    seen = far2**-2
    slopes = across / (gap_mm + _SCATTER_DEPTH_MM)
    lengths = np.sqrt(far2) / (gap_mm + _SCATTER_DEPTH_MM)
    mu = _strip_attenuation_per_mm(beam.energies_kev)
    # The transmission is symmetric in both directions, so only one quarter of the surface is computed.
    right, ahead = len(slopes) // 2, len(along) // 2
    quarter = [
        _compute_transmission(grid, mu, slope, line[ahead:])
        for slope, line in zip(slopes[right:], lengths[right:], strict=True)
    ]
    passed = np.pad(quarter, ((right, 0), (ahead, 0), (0, 0)), mode="reflect")
    return float((passed * seen[:, :, None] / seen.sum()).sum(axis=(0, 1)) @ weights)


def _strip_attenuation_per_mm(energies_kev: Array) -> Array:
    """Compute the linear attenuation coefficients of lead and aluminium, (2, nodes), in 1/mm."""
    return np.array([attenuation_per_mm(parse_compound(name), energies_kev) for name in ("Pb@11.35", "Al@2.70")])


def _compute_transmission(grid: Grid, mu: Array, slope: float, lengths: Array) -> Array:
    """Compute the transmission (directions, energies) of photons, for one slope across the strips.

    `slope` is the displacement across the strips in mm per mm of depth.

    `lengths` (directions,) are path lengths in mm per mm of depth. They also depend on the displacement along the
    strips.
    """
    period = 10.0 / grid.lines_per_cm
    height = grid.ratio * (period - grid.lead_mm)
    start = (np.arange(40) + 0.5) / 40 * period
    if slope * height < 1e-9:
        lead = np.where(start < grid.lead_mm, height, 0.0)
    else:
        ends = start + slope * height
        lead = (
            _cumulative_lead_mm(ends, period, grid.lead_mm) - _cumulative_lead_mm(start, period, grid.lead_mm)
        ) / slope
    depth = lead[:, None] * mu[0] + (height - lead[:, None]) * mu[1]
    return np.asarray(np.exp(-depth[None] * lengths[:, None, None]).mean(axis=1))


def _cumulative_lead_mm(place: Array, period: float, lead_mm: float) -> Array:
    """Compute the total thickness of lead strips between 0 and a position across the strips, in mm."""
    whole = np.floor(place / period)
    return np.asarray(whole * lead_mm + np.minimum(place - whole * period, lead_mm))
