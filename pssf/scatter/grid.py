"""An anti-scatter grid: lead strips along the leg that let pass what comes from the focus and stop most of the rest."""

from dataclasses import dataclass, replace

import numpy as np

from ..core.checks import Array, InputError, require
from ..model.protocol import Protocol
from ..xray.materials import Material, attenuation_per_mm, compound_of
from ..xray.spectrum import Beam

# What a pixel sees of a limb's irradiated exit face, mm to either side across the strips and along them, and how deep
# below it the scatter comes from (judgement; Sorenson and Floch 1985 find 150 to 200 mm for a trunk).
_HALF_MM = (80.0, 150.0)
_BELOW_MM = 40.0
# So much of a limb hardens the beam before the grid.
_TYPICAL_MM = 100.0


@dataclass(frozen=True, kw_only=True)
class Grid:
    """A focused grid of lead strips with aluminium between them; covers are neglected.

    ratio         height of the strips over the distance between them
    lines_per_cm  strips a centimetre
    lead_mm       thickness of a strip
    raises        InputError for a number out of range, or strips that leave no room between them
    """

    ratio: float = 10.0
    lines_per_cm: float = 40.0
    lead_mm: float = 0.05

    def __post_init__(self) -> None:
        require("grid ratio", self.ratio, 2, 20, "")
        require("lines_per_cm", self.lines_per_cm, 20, 120, "lines/cm")
        require("lead_mm", self.lead_mm, 0.005, 0.2, "mm")
        if not self.lead_mm < 9.0 / self.lines_per_cm:
            most = f"less than {9.0 / self.lines_per_cm:.3g} mm at {self.lines_per_cm:g} lines/cm"
            raise InputError(f"lead_mm = {self.lead_mm!r} mm; allowed: {most}")


def grid_of(protocol: Protocol) -> Grid:
    """The grid of a protocol.

    raises  InputError for strips that leave no room between them
    """
    return Grid(ratio=protocol.grid_ratio, lines_per_cm=protocol.grid_lines_per_cm)


def transmit_through_grid(kind: Grid, beam: Beam) -> Beam:
    """What of the primary passes a moving grid, whose lines are blurred away: it runs along the strips."""
    mu = _attenuation(beam)
    return replace(beam, photons_per_mm2=beam.photons_per_mm2 * _passed(kind, mu, 0.0, np.ones(1))[0])


def scatter_passing(kind: Grid, beam: Beam, gap_mm: float, limb: Material) -> float:
    """Share of the scatter that a grid lets pass.

    The average of exp(-path in lead and aluminium) over places across a strip (geometry of Day and Dance 1983), over
    directions, as of even radiance on the exit face, and over the energies of the beam behind a limb; what the grid
    itself scatters, and fluorescence of the lead, are left out.
    gap_mm  from the object's exit to the detector: scatter comes in straighter from further away
    limb    what hardens the beam before the grid
    """
    weights = beam.photons_per_mm2 * beam.signal_kev
    weights = weights * np.exp(-attenuation_per_mm(limb, beam.energies_kev) * _TYPICAL_MM)
    weights = weights / weights.sum() if weights.any() else np.full(len(weights), 1 / len(weights))
    across, along = (np.linspace(-half, half, 81) for half in _HALF_MM)
    far2 = across[:, None] ** 2 + along**2 + (gap_mm + _BELOW_MM) ** 2
    # Energy through the detector's plane from an even radiance: the fourth power of the cosine.
    seen = far2**-2
    slopes = across / (gap_mm + _BELOW_MM)
    lengths = np.sqrt(far2) / (gap_mm + _BELOW_MM)
    mu = _attenuation(beam)
    # Both sides of the strip are alike.
    right = len(slopes) // 2
    passed = [_passed(kind, mu, slope, line) for slope, line in zip(slopes[right:], lengths[right:], strict=True)]
    passed = [*passed[:0:-1], *passed]
    return float((np.array(passed) * seen[:, :, None] / seen.sum()).sum(axis=(0, 1)) @ weights)


def _attenuation(beam: Beam) -> Array:
    """(2, nodes)  of lead and aluminium, 1/mm"""
    return np.array([attenuation_per_mm(compound_of(name), beam.energies_kev) for name in ("Pb@11.35", "Al@2.70")])


def _passed(kind: Grid, mu: Array, slope: float, lengths: Array) -> Array:
    """(directions, energies)  for photons that move by `slope` across the strips for each mm down

    lengths  (directions,)  path for each mm down, by how much they move along the strips
    """
    period = 10.0 / kind.lines_per_cm
    height = kind.ratio * (period - kind.lead_mm)
    start = (np.arange(40) + 0.5) / 40 * period
    if slope * height < 1e-9:
        lead = np.where(start < kind.lead_mm, height, 0.0)
    else:
        ends = start + slope * height
        lead = (_lead(ends, period, kind.lead_mm) - _lead(start, period, kind.lead_mm)) / slope
    depth = lead[:, None] * mu[0] + (height - lead[:, None]) * mu[1]
    return np.asarray(np.exp(-depth[None] * lengths[:, None, None]).mean(axis=1))


def _lead(place: Array, period: float, lead_mm: float) -> Array:
    """Lead between 0 and a place across the strips, mm."""
    whole = np.floor(place / period)
    return np.asarray(whole * lead_mm + np.minimum(place - whole * period, lead_mm))
