"""What a radiograph of the average knee says about its exposure: exposure index, scatter, dynamic range, noise."""

from dataclasses import replace

import numpy as np

from ..anatomy import build
from ..core.blocks import block_mean
from ..core.checks import Array
from ..model.knee import Knee
from ..model.protocol import Protocol
from ..model.radiograph import Radiograph
from ..simulation import simulate
from ..xray.collimator import open_shares
from ..xray.spectrum import beam_of, tube_spectrum
from ..xray.technique import Technique, technique_of
from .beam import air_kerma_ugy, entrance_kerma_ugy

# Half the side of the squares in which signals are read, mm at the detector.
_HALF_MM = 3.0
# Share of the open beam's signal below which a pixel shows the limb, as displays take it (`data/looks.toml`).
_LIMB = 0.5
# Quantile of the signal that is taken for that of the open beam; the number of a saturated pixel.
_GREATEST, _FULL_DN = 0.999, 65535
_CELL_MM = 2.4


def exposure_quantities(technique: Technique) -> tuple[dict[str, float], Array]:
    """Figures of one radiograph of the average knee, and its map of scatter over primary.

    exposure_index  100 per uGy of air kerma that an RQA5 beam needs for the median signal behind the limb (IEC 62494-1)
    """
    protocol = technique.protocol
    built = build(Knee(), protocol)
    taken = replace(protocol, noise="none", dead_pixels=0.0)
    radiograph = simulate(built, taken, engine="scanline", keep=("primary", "scatter", "path_mm"))
    primary, kept = radiograph.kept["primary"], radiograph.kept
    scatter = kept.get("scatter", np.zeros_like(primary))
    total = primary + scatter
    limb = kept["path_mm"]["muscle"] > 0
    assert radiograph.truth is not None
    known = radiograph.truth.landmarks_px
    shown = next(name for name in ("medial_joint_line", "sulcus", "joint_centre") if name in known)
    row, col = (round(place) for place in known[shown])
    half, below = max(1, round(_HALF_MM / protocol.pixel_mm)), round(12.0 / protocol.pixel_mm)
    joint = (slice(row - half, row + half + 1), slice(col - half, col + half + 1))
    bone = (slice(row + below - half, row + below + half + 1), joint[1])
    offset = technique.detector.offset_dn
    noisy = simulate(built, replace(protocol, dead_pixels=0.0), engine="scanline", rng=1).pixels[bone]
    quiet = radiograph.pixels[bone].astype(np.float64)
    step = cell_px(protocol)
    spr = block_mean(scatter, step) / np.maximum(block_mean(primary, step), 1e-30)
    return {
        "exposure_index": exposure_index(total[limb], technique),
        "spr_joint": float(scatter[joint].sum() / primary[joint].sum()),
        "spr_bone": float(scatter[bone].sum() / primary[bone].sum()),
        "spr_limb": float(scatter[limb].sum() / primary[limb].sum()),
        "dynamic_range": float(total.max() / total[bone].mean()),
        "noise_bone": float((noisy - quiet).std() / (quiet.mean() - offset)),
    }, spr


def exposure_index_of(radiograph: Radiograph) -> float:
    """Give the exposure index of a radiograph by its pixels (IEC 62494-1).

    Value of interest is the median signal of the limb: of pixels within the collimated field that are not saturated and
    receive less than half of the open beam; of the whole field where there are none.
    """
    technique, protocol = technique_of(radiograph.protocol), radiograph.protocol
    detector = technique.detector
    rows, cols = open_shares(technique, 1)
    field = radiograph.pixels[np.ix_(rows >= 1, cols >= 1)]
    kev = (field.astype(np.float64) - detector.offset_dn) * _kev_per_dn(technique)
    greatest = float(np.quantile(kev, _GREATEST))
    if field.max() == _FULL_DN:
        # A saturated pixel does not say how bright the open beam is, so its expectation does.
        beam, nearer = beam_of(technique), (1000.0 / protocol.sdd_mm) ** 2
        greatest = float((beam.photons_per_mm2 * beam.signal_kev).sum()) * nearer * protocol.pixel_mm**2
    limb = kev[(kev < _LIMB * greatest) & (field < _FULL_DN)]
    return exposure_index(limb if limb.size else kev.ravel(), technique)


def _kev_per_dn(technique: Technique) -> float:
    detector = technique.detector
    return detector.electrons_per_dn_mm2 * technique.protocol.pixel_mm**2 / detector.electrons_per_kev


def entrance_kerma_of(radiograph: Radiograph) -> float:
    """Give the air kerma of a radiograph's open beam where it enters the limb, without backscatter, in uGy."""
    return entrance_kerma_ugy(technique_of(radiograph.protocol))


def cell_px(protocol: Protocol) -> int:
    """Side of a cell of the map of scatter over primary, in pixels."""
    return max(1, round(_CELL_MM / protocol.pixel_mm))


def exposure_index(limb_kev: Array, technique: Technique) -> float:
    """100 per uGy of air kerma that an RQA5 beam needs for the median signal behind the limb (IEC 62494-1).

    limb_kev  (pixels,)  signal of the pixels behind the limb, keV a pixel
    """
    return 100 * float(np.median(limb_kev)) / _kev_per_ugy(technique)


def _kev_per_ugy(technique: Technique) -> float:
    """Energy absorbed in a pixel per uGy of an RQA5 beam, 70 kV behind 23.5 mm of aluminium (IEC 61267)."""
    rqa5 = technique.taken(tube_kv=70.0, filtration_mm_al=23.5, anode_angle_deg=12.0, mono_kev=None, mas=1.0)
    beam = beam_of(rqa5)
    energies, photons = tube_spectrum(70.0, 12.0, 23.5)
    signal = float((beam.photons_per_mm2 * beam.signal_kev).sum())
    return signal * technique.protocol.pixel_mm**2 / air_kerma_ugy(technique.material("air"), energies, photons)
