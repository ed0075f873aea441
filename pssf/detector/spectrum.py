"""The beam: photons a square millimetre and mAs, at one metre, by energy (SpekPy), and their weight in the detector."""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from ..checks import Array
from ..files import tables
from ..protocol import Protocol
from .materials import absorbed_fraction

# Fewer nodes than these change no pixel by more than 1e-3; see `pssf accuracy`.
_NODES = 24
_MONO_PHOTONS_PER_MM2_MAS = 1e6


@dataclass(frozen=True)
class Beam:
    """Energies and photons of a beam at 1 m without an object, and what the detector makes of a photon.

    energies_kev     (nodes,)
    photons_per_mm2  (nodes,)  for the protocol's mAs
    signal_kev       (nodes,)  energy absorbed a photon: interaction probability times energy
    square_kev2      (nodes,)  its second moment: interaction probability times energy squared
    """

    energies_kev: Array
    photons_per_mm2: Array
    signal_kev: Array
    square_kev2: Array


def beam_of(protocol: Protocol, nodes: int = _NODES) -> Beam:
    """The beam of a protocol, its spectrum folded to at most so many nodes; one node when monochromatic."""
    if protocol.mono_kev is not None:
        energies, photons = np.array([protocol.mono_kev]), np.array([_MONO_PHOTONS_PER_MM2_MAS])
    else:
        energies, photons = tube_spectrum(protocol.tube_kv, protocol.anode_angle_deg, protocol.filtration_mm_al)
    signal, square = _response(energies)
    if len(energies) > nodes:
        energies, photons, signal, square = _fold(energies, photons, signal, square, nodes)
    return Beam(energies, photons * protocol.mas, signal, square)


@lru_cache(maxsize=64)
def tube_spectrum(tube_kv: float, anode_angle_deg: float, filtration_mm_al: float) -> tuple[Array, Array]:
    """(bins,) keV and (bins,) photons/mm2/mAs at 1 m: tungsten behind aluminium, no air (SpekPy 2, "casim")."""
    from spekpy import Spek  # slow to import, and a monochromatic protocol does without

    source = Spek(kvp=tube_kv, th=anode_angle_deg, dk=0.5, mas=1.0, z=100.0)
    source.filter("Al", filtration_mm_al)
    energies, per_kev_cm2 = source.get_spectrum(edges=False)
    keep = per_kev_cm2 > per_kev_cm2.max() * 1e-9
    return energies[keep], per_kev_cm2[keep] * 0.5 / 100.0


def _response(energies_kev: Array) -> tuple[Array, Array]:
    table = tables.data("detector")["csi"]
    mg_per_cm2 = table["density"] * table["packing"] * table["thickness_mm"] * 100.0
    fraction = absorbed_fraction(table["formula"], mg_per_cm2, energies_kev)
    return fraction * energies_kev, fraction * energies_kev**2


def _fold(
    energies: Array, photons: Array, signal: Array, square: Array, nodes: int
) -> tuple[Array, Array, Array, Array]:
    """Neighbouring bins merged into nodes; each keeps its photons and signal, at the mean energy of that signal."""
    # Behind a limb the hard end carries the image, so nodes share out the root of the signal, not the signal.
    share = np.cumsum(np.sqrt(photons * signal))
    group = np.minimum((share / share[-1] * nodes).astype(int), nodes - 1)
    total = np.bincount(group, photons, nodes).astype(np.float64)
    used = total > 0
    first, second = (np.bincount(group, photons * value, nodes)[used] for value in (signal, square))
    centre = np.bincount(group, photons * signal * energies, nodes)[used] / first
    return centre, total[used], first / total[used], second / total[used]
