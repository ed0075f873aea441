"""Calibrate simulated detectors with random properties, and compare the results with these properties."""

import warnings
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
import trimesh

from ...calibration import Calibration, CalibrationImages, Step, Wedge, calibrate_detector
from ...core.checks import Array
from ...detector.detector_blur import compute_transfer
from ...geometry.scene import Scene, Surface
from ...image_faults import ImageNotice
from ...model.detector import Detector, load_detectors
from ...model.protocol import Protocol, load_protocol
from ...quality.detector_quality import model_nnps
from ...simulation import simulate
from ...xray.primary_beam import transmit
from ...xray.resolved_technique import Technique, resolve_technique
from ...xray.response_of_mass import set_mass_per_area
from ...xray.spectrum import compute_beam

Row = dict[str, Any]
# Number of detectors.
DETECTORS = 24
# Seed of the random properties.
_SEED = 24
# Pixel pitch, in mm, and number of rows and columns of flat fields and edge, and of wedge images.
_PIXEL_MM, _FLAT_PX, _EDGE_PX, _WEDGE_PX = 0.15, 1024, 512, 1024
# Nominal tube voltages of the wedge images, in kV, and that of the flat fields.
_WEDGE_KV, _FLAT_KV = (50.0, 70.0, 100.0), 70.0
# Thicknesses of the steps, in mm aluminium, and width of a step, in mm.
_STEPS_MM, _STEP_SIDE_MM = (0.0, 1.0, 2.0, 4.0, 8.0, 12.0, 18.0, 25.0), 36.0
# Half the side length of the region of a step, in mm.
_REGION_MM = 9.0
# Exposures of the flat fields, relative to the greatest.
_FLAT_LEVELS = (0.02, 0.06, 0.15, 0.35, 0.7, 1.0)
# Signal of the greatest exposure, in DN.
_BRIGHT_DN = 40000.0
# Thickness of muscle and of the bone step behind which the contrast is compared, in mm.
_MUSCLE_MM, _BONE_MM = 110.0, 10.0


class BlindDetector(NamedTuple):
    """Detector and beam that a calibration has to recover.

    Attributes
    ----------
    protocol : Protocol
        True beam and detector.
    nominal : Protocol
        Protocol with nominal tube voltage and filtration, and a detector of the package with the same scintillator
        material.
    kv_scale : float
        True tube voltage divided by its nominal value.
    """

    protocol: Protocol
    nominal: Protocol
    kv_scale: float


def draw_blind_detector(number: int) -> BlindDetector:
    """Draw a detector and a beam with random properties.

    Parameters
    ----------
    number : int
        Number of the detector, which is the seed.

    Returns
    -------
    BlindDetector
        True and nominal properties.
    """
    rng = np.random.default_rng([_SEED, number])
    base = load_detectors()["csi" if number % 3 else "gos"]
    masses = (100.0, 350.0) if base.formula == "CsI" else (60.0, 200.0)
    f0, power = float(rng.uniform(0.8, 1.9)), float(rng.uniform(1.7, 2.3))
    detector = replace(
        set_mass_per_area(base, float(rng.uniform(*masses))),
        name=f"blind_{number}",
        mtf_f0_per_mm=f0,
        mtf_power=power,
        ntf_f0_per_mm=f0 * float(rng.uniform(1.2, 1.5)),
        ntf_power=power * float(rng.uniform(0.85, 0.95)),
        swank=float(rng.uniform(0.75, 0.95)),
        readout_electrons=float(rng.uniform(800.0, 4000.0)),
        electrons_per_dn_mm2=float(rng.uniform(15000.0, 60000.0)),
        offset_dn=float(rng.uniform(20.0, 400.0)),
    )
    nominal = replace(
        load_protocol("reference"),
        name="calibration",
        rows=_FLAT_PX,
        cols=_FLAT_PX,
        pixel_mm=_PIXEL_MM,
        tube_kv=_FLAT_KV,
        detector=base,
        scatter="none",
        focal_spot_mm=0.0,
        marker="none",
    )
    kv_scale = float(rng.uniform(0.97, 1.03))
    true = replace(
        nominal,
        tube_kv=_FLAT_KV * kv_scale,
        filtration_mm_al=nominal.filtration_mm_al + float(rng.uniform(-0.5, 1.0)),
        detector=detector,
    )
    return BlindDetector(true, nominal, kv_scale)


def simulate_calibration_images(blind: BlindDetector, seed: int) -> CalibrationImages:
    """Simulate the images of a calibration.

    Parameters
    ----------
    blind : BlindDetector
        True properties.
    seed : int
        Seed of the noise.

    Returns
    -------
    CalibrationImages
        Two dark images, six flat fields, an edge, and a wedge at 50, 70 and 100 kV.
    """
    protocol, plate = blind.protocol, _make_plate("Air, Dry (near sea level)", 300.0)
    mas = _bright_mas(protocol)
    seeds = iter(range(1000 * seed, 1000 * seed + 100))
    darks = tuple(_expose(plate, replace(protocol, mas=0.0), next(seeds)) for _ in range(2))
    levels = tuple(float(f"{mas * level:.4g}") for level in _FLAT_LEVELS)
    flats = tuple(_expose(plate, replace(protocol, mas=level), next(seeds)) for level in levels)
    small = replace(protocol, rows=_EDGE_PX, cols=_EDGE_PX, mas=mas, subpixels=4)
    edge = _expose(_make_edge(protocol), small, next(seeds))
    wedges = []
    for kv in _WEDGE_KV:
        at = replace(protocol, rows=_WEDGE_PX, cols=_WEDGE_PX, tube_kv=kv * blind.kv_scale)
        image = _expose(_make_wedge(protocol), replace(at, mas=_bright_mas(at)), next(seeds))
        wedges.append(Wedge(image=image, tube_kv=kv))
    return CalibrationImages(
        pixel_mm=_PIXEL_MM,
        darks=darks,
        flats=flats,
        flat_mas=levels,
        edge=edge,
        wedges=tuple(wedges),
        steps=make_steps(),
    )


def _expose(scene: Scene, protocol: Protocol, seed: int) -> Any:
    """Simulate an image of a phantom and return its pixels (rows, cols)."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ImageNotice)
        return simulate(scene, protocol, rng=seed, engine="scanline").pixels


def _bright_mas(protocol: Protocol) -> float:
    """Compute the mAs at which the open beam gives the greatest signal."""
    technique = resolve_technique(replace(protocol, rows=1, cols=1, mas=1.0))
    kev = float(transmit({}, compute_beam(technique), technique).kev[0, 0])
    detector = technique.detector
    return _BRIGHT_DN * detector.electrons_per_dn_mm2 * _PIXEL_MM**2 / detector.electrons_per_kev / kev


def _make_plate(material: str, side_mm: float) -> Scene:
    """Make a plate of 1 mm."""
    return Scene([Surface(trimesh.creation.box((side_mm, 1.0, side_mm)), material, "air", "plate")])


def _make_edge(protocol: Protocol) -> Scene:
    """Make a tungsten plate on the detector, whose edge is turned by 2.4 degrees."""
    mesh = trimesh.creation.box((100.0, 1.0, 200.0)).apply_translation(
        (50.0, protocol.sdd_mm - protocol.sod_mm - 2, 0.0)
    )
    mesh.apply_transform(trimesh.transformations.rotation_matrix(np.deg2rad(2.4), (0, 1, 0)))
    return Scene([Surface(mesh, "W@19.3", "air", "edge")])


def _step_centres_mm() -> Array:
    """Compute the centres (steps, 2) of the steps across and along the leg axis, in mm."""
    row, col = np.divmod(np.arange(len(_STEPS_MM)), 4)
    return np.column_stack(((col - 1.5) * _STEP_SIDE_MM, (0.5 - row) * _STEP_SIDE_MM))


def _make_wedge(protocol: Protocol) -> Scene:
    """Make the steps of an aluminium wedge on the detector, with gaps of 0.02 mm."""
    back = protocol.sdd_mm - protocol.sod_mm - 2.0
    surfaces = []
    for number, (mm, (x, z)) in enumerate(zip(_STEPS_MM, _step_centres_mm(), strict=True)):
        if mm > 0:
            side = _STEP_SIDE_MM - 0.02
            mesh = trimesh.creation.box((side, mm, side)).apply_translation((x, back - mm / 2, z))
            surfaces.append(Surface(mesh, "Al@2.70", "air", f"step_{number}"))
    return Scene(surfaces)


def make_steps() -> tuple[Step, ...]:
    """Make the regions of the steps in the wedge images.

    Returns
    -------
    tuple of Step
        Steps from 0 to 25 mm aluminium.
    """
    steps, half = [], _REGION_MM / _PIXEL_MM
    for mm, (x, z) in zip(_STEPS_MM, _step_centres_mm(), strict=True):
        row, col = _WEDGE_PX / 2 - z / _PIXEL_MM, _WEDGE_PX / 2 + x / _PIXEL_MM
        steps.append(
            Step(
                thickness_mm=mm,
                top=round(row - half),
                bottom=round(row + half),
                left=round(col - half),
                right=round(col + half),
            )
        )
    return tuple(steps)


def measure_calibration_recovery(count: int = DETECTORS) -> list[Row]:
    """Calibrate detectors with random properties, and compare the results with the truth.

    Parameters
    ----------
    count : int, default 24
        Number of detectors.

    Returns
    -------
    list of dict
        One row per detector, see `compare_calibration`.
    """
    rows = []
    for number in range(count):
        blind = draw_blind_detector(number)
        result = calibrate_detector(simulate_calibration_images(blind, number), blind.nominal)
        rows.append({"detector": number, **compare_calibration(result, blind)})
    return rows


def compare_calibration(result: Calibration, blind: BlindDetector) -> Row:
    """Compare a calibration with the true properties.

    Parameters
    ----------
    result : Calibration
        Result of the calibration.
    blind : BlindDetector
        True properties.

    Returns
    -------
    dict
        ``mtf_percent`` and ``nnps_percent`` are the largest relative differences, the MTF up to 0.8 of the Nyquist
        frequency and the NNPS at the brightest flat field up to the Nyquist frequency. ``contrast_percent`` is that of
        the contrast of 10 mm of bone in 110 mm of muscle. ``intervals`` and ``intervals_hold`` count the 95 % intervals
        and those that contain the truth.
    """
    true, calibrated = resolve_technique(blind.protocol), resolve_technique(result.protocol)
    nyquist = 0.5 / _PIXEL_MM
    frequency = np.linspace(0.02, 0.8, 40) * nyquist
    mtfs = [compute_transfer(one.detector, frequency) for one in (calibrated, true)]
    all_frequencies = np.linspace(0.05, 1.0, 40) * nyquist
    noise = [model_nnps(one, all_frequencies, _BRIGHT_DN) for one in (calibrated, true)]
    row: Row = {
        "formula": true.detector.formula,
        "mtf_percent": round(float(100 * np.abs(mtfs[0] / mtfs[1] - 1).max()), 2),
        "nnps_percent": round(float(100 * np.abs(noise[0] / noise[1] - 1).max()), 2),
    }
    truths = _true_values(blind)
    held = 0
    for name, truth in truths.items():
        estimate = result.estimates[name]
        row[f"{name}_percent"] = round(100 * (estimate.value / truth - 1), 3)
        held += estimate.low <= truth <= estimate.high
    contrasts = [_bone_contrast(one) for one in (calibrated, true)]
    row["contrast_percent"] = round(100 * (contrasts[0] / contrasts[1] - 1), 2)
    row["intervals"], row["intervals_hold"] = len(truths), int(held)
    row["outside"] = " ".join(
        name for name, t in truths.items() if not result.estimates[name].low <= t <= result.estimates[name].high
    )
    return row


def _true_values(blind: BlindDetector) -> dict[str, float]:
    """List the true values of the properties that a calibration estimates."""
    detector = blind.protocol.detector
    assert isinstance(detector, Detector)
    names = (
        "offset_dn", "readout_electrons", "electrons_per_dn_mm2", "mtf_f0_per_mm", "mtf_power", "ntf_f0_per_mm",
        "ntf_power", "swank", "thickness_mm",
    )  # fmt: skip
    return {
        **{name: float(getattr(detector, name)) for name in names},
        "tube_kv": blind.protocol.tube_kv,
        "filtration_mm_al": blind.protocol.filtration_mm_al,
    }


def _bone_contrast(technique: Technique) -> float:
    """Compute the contrast of a bone step in muscle, as a difference of logarithms."""
    one = replace(technique, protocol=replace(technique.protocol, rows=1, cols=1))
    beam = compute_beam(one)
    signals = [
        float(transmit({name: np.full((1, 1), mm, np.float32) for name, mm in paths.items()}, beam, one).kev[0, 0])
        for paths in (
            {"muscle": _MUSCLE_MM},
            {"muscle": _MUSCLE_MM - _BONE_MM, "cortical_bone": _BONE_MM},
        )
    ]
    return float(np.log(signals[0] / signals[1]))
