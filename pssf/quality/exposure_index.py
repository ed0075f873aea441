"""Measure the exposure of a radiograph: exposure index, entrance air kerma, scatter, dynamic range and noise."""

from dataclasses import replace

import numpy as np

from ..anatomy import build
from ..core.checks import Array
from ..core.resample import downsample_by_blocks
from ..detector.panel_readout import linearise_pixels
from ..model.knee import Knee
from ..model.protocol import Protocol
from ..model.radiograph import Radiograph
from ..simulation import simulate
from ..xray.collimator import compute_transmission_factors
from ..xray.resolved_technique import Technique, resolve_technique
from ..xray.spectrum import compute_beam, tube_spectrum
from .beam_quality import air_kerma_ugy, entrance_kerma_ugy

# Half the edge length of the square regions in which signals are measured, in mm at the detector.
_ROI_HALF_MM = 3.0
# Fraction of the open-beam signal below which a pixel shows the limb, as in display processing (`data/looks.toml`).
_LIMB_SIGNAL_FRACTION = 0.5
# Quantile of the signal that is taken as the open-beam signal.
_GREATEST = 0.999
# Cell size of the scatter-to-primary-ratio map, in mm at the detector.
_SPR_CELL_MM = 2.4


def measure_exposure_quantities(technique: Technique) -> tuple[dict[str, float], Array]:
    """Measure the exposure index, scatter, dynamic range and noise of a radiograph of the default knee.

    Parameters
    ----------
    technique : Technique
        Resolved protocol.

    Returns
    -------
    quantities : dict of str to float
        Dimensionless quantities: ``exposure_index``; scatter-to-primary ratio at the joint (``spr_joint``), in the
        tibia (``spr_bone``) and over the limb (``spr_limb``); ``dynamic_range``, the greatest signal divided by the
        mean signal in bone; ``noise_bone``, the noise relative to the signal in bone.
    spr : (rows, cols) array
        Scatter-to-primary-ratio map, with the cell size of `spr_cell_px`.
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
    half, below = max(1, round(_ROI_HALF_MM / protocol.pixel_mm)), round(12.0 / protocol.pixel_mm)
    joint = (slice(row - half, row + half + 1), slice(col - half, col + half + 1))
    bone = (slice(row + below - half, row + below + half + 1), joint[1])
    offset = technique.detector.offset_dn
    noisy = simulate(built, replace(protocol, dead_pixels=0.0), engine="scanline", rng=1).pixels[bone]
    quiet = radiograph.pixels[bone].astype(np.float64)
    step = spr_cell_px(protocol)
    spr = downsample_by_blocks(scatter, step) / np.maximum(downsample_by_blocks(primary, step), 1e-30)
    return {
        "exposure_index": exposure_index(total[limb], technique),
        "spr_joint": float(scatter[joint].sum() / primary[joint].sum()),
        "spr_bone": float(scatter[bone].sum() / primary[bone].sum()),
        "spr_limb": float(scatter[limb].sum() / primary[limb].sum()),
        "dynamic_range": float(total.max() / total[bone].mean()),
        "noise_bone": float((noisy - quiet).std() / (quiet.mean() - offset)),
    }, spr


def compute_exposure_index(radiograph: Radiograph) -> float:
    """Compute the exposure index of a radiograph from its pixels (IEC 62494-1).

    The value of interest is the median signal of the limb. Limb pixels are the pixels in the collimated field that are
    not saturated and have less than half of the open-beam signal. Without limb pixels, the entire collimated field is
    used.

    Parameters
    ----------
    radiograph : Radiograph
        Simulated radiograph.

    Returns
    -------
    float
        Exposure index: 100 times the air kerma, in uGy, of an RQA5 beam that gives the same signal.
    """
    technique, protocol = resolve_technique(radiograph.protocol), radiograph.protocol
    detector = technique.detector
    rows, cols = compute_transmission_factors(technique, 1)
    field = radiograph.pixels[np.ix_(rows >= 1, cols >= 1)]
    kev = linearise_pixels(field, detector).astype(np.float64) * _kev_per_dn(technique)
    greatest = float(np.quantile(kev, _GREATEST))
    if field.max() == detector.saturation_dn:
        # If the open beam saturates the detector, the open-beam signal is computed from the spectrum, not from the
        # pixels.
        beam, nearer = compute_beam(technique), (1000.0 / protocol.sdd_mm) ** 2
        greatest = float((beam.photons_per_mm2 * beam.signal_kev).sum()) * nearer * protocol.pixel_mm**2
    limb = kev[(kev < _LIMB_SIGNAL_FRACTION * greatest) & (field < detector.saturation_dn)]
    return exposure_index(limb if limb.size else kev.ravel(), technique)


def _kev_per_dn(technique: Technique) -> float:
    """Return the energy absorbed in a pixel per DN, in keV."""
    detector = technique.detector
    return detector.electrons_per_dn_mm2 * technique.protocol.pixel_mm**2 / detector.electrons_per_kev


def compute_entrance_kerma_ugy(radiograph: Radiograph) -> float:
    """Compute the incident air kerma of a radiograph at the entrance surface of the limb, without backscatter.

    Parameters
    ----------
    radiograph : Radiograph
        Simulated radiograph.

    Returns
    -------
    float
        Air kerma, in uGy.
    """
    return entrance_kerma_ugy(resolve_technique(radiograph.protocol))


def spr_cell_px(protocol: Protocol) -> int:
    """Compute the cell size of the scatter-to-primary-ratio map for a pixel pitch.

    Parameters
    ----------
    protocol : Protocol
        Protocol that specifies the pixel pitch.

    Returns
    -------
    int
        Cell size in pixels, at least 1.
    """
    return max(1, round(_SPR_CELL_MM / protocol.pixel_mm))


def exposure_index(limb_kev: Array, technique: Technique) -> float:
    """Compute the exposure index from the signal behind the limb (IEC 62494-1).

    Parameters
    ----------
    limb_kev : (pixels,) array
        Signal of each pixel behind the limb, in keV.
    technique : Technique
        Resolved protocol.

    Returns
    -------
    float
        Exposure index: 100 times the air kerma, in uGy, of an RQA5 beam that gives the median signal behind the limb.
    """
    return 100 * float(np.median(limb_kev)) / _kev_per_ugy(technique)


def _kev_per_ugy(technique: Technique) -> float:
    """Compute the energy absorbed in a pixel per uGy of an RQA5 beam, in keV.

    An RQA5 beam is 70 kV, filtered by 23.5 mm of aluminium (IEC 61267).
    """
    rqa5 = technique.replace_protocol(
        tube_kv=70.0, filtration_mm_al=23.5, anode_angle_deg=12.0, mono_kev=None, filters=(), spectrum=None, mas=1.0
    )
    beam = compute_beam(rqa5)
    energies, photons = tube_spectrum(70.0, 12.0, 23.5)
    signal = float((beam.photons_per_mm2 * beam.signal_kev).sum())
    return signal * technique.protocol.pixel_mm**2 / air_kerma_ugy(technique.material("air"), energies, photons)
