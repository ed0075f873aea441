"""Detectors: absorption, blur, noise and readout (``data/detector.toml``)."""

from functools import cache

from ..data_files import load_data_table
from ..table_records import Record, parse_record


class Detector(Record, frozen=True):
    """Parameters of a scintillator on a readout panel.

    The MTF and the noise transfer function are 1 / (1 + (f / f0)^power), with the spatial frequency f in 1/mm.

    Attributes
    ----------
    formula : str
        Chemical formula of the scintillator.
    density : float
        Density of the scintillator, in g/cm3.
    thickness_mm : float
        Thickness of the scintillator layer, in mm.
    packing : float
        Fraction of the volume of the layer that the scintillator fills.
    mtf_f0_per_mm : float
        Spatial frequency f0 of the MTF, in 1/mm.
    mtf_power : float
        Exponent `power` of the MTF.
    ntf_f0_per_mm : float
        Spatial frequency f0 of the noise transfer function, in 1/mm.
    ntf_power : float
        Exponent `power` of the noise transfer function.
    swank : float
        Swank factor (Swank 1973), 0 to 1.
    electrons_per_kev : float
        Gain, in electrons per keV absorbed.
    readout_electrons : float
        Readout noise, in electrons RMS per pixel.
    electrons_per_dn_mm2 : float
        Electrons per DN and per mm2 of pixel area.
    offset_dn : float
        Value of a pixel without signal, in DN.
    dead_seed : int
        Seed of the positions of dead pixels.
    escape : bool
        Whether K fluorescence and scattered photons may leave the scintillator. If False, each photon that interacts
        deposits its entire energy.
    """

    formula: str
    density: float
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
    dead_seed: int
    escape: bool

    @property
    def mg_per_cm2(self) -> float:
        """Mass of scintillator per area, in mg/cm2."""
        return self.density * self.packing * self.thickness_mm * 100.0


@cache
def load_detectors() -> dict[str, Detector]:
    """Load all detectors of the package.

    Returns
    -------
    dict of str to Detector
        Detectors, keyed by name.
    """
    return parse_record(dict[str, Detector], load_data_table("detector"), "detector")
