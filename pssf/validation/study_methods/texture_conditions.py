"""Change of texture measures with the acquisition, and their correlation with properties of the bone.

Each knee is simulated under a reference acquisition and under conditions that differ in one respect. The medial
subchondral region is placed by true landmarks, so that localisation errors have no effect.
"""

from collections.abc import Mapping
from dataclasses import replace
from functools import lru_cache

import numpy as np
from scipy import stats

from ...anatomy import BuiltKnee, build
from ...core.checks import Array
from ...core.processes.parallel_map import map_in_parallel
from ...data.imaging.display_table import FlatPanelProcessing
from ...detector import render_for_display
from ...model.knee import Knee
from ...model.protocol import Protocol, load_protocol
from ...model.radiograph import Radiograph
from ...model.sampling.acquisition import sample_acquisition
from ...model.sampling.display_sampling import sample_display_processing
from ...model.sampling.knee_sampling import sample_knee
from ...simulation import simulate
from ...study.statistics.features.icc_by_subject import compute_icc_interval, compute_weighted_icc, sample_knee_weights
from ...study.statistics.features.reliability import icc
from ...texture import make_texture_region, measure_texture_features, mirror_texture_features
from ..raycasting.raycast_engines import Row

_PROTOCOL = "fixed_flexion"
_REGION = "medial_subchondral"
# Rows and columns of the detector, in pixels of 0.15 mm: 240 x 180 mm, the smallest field to which scatter is fitted.
_ROWS, _COLS = 1600, 1200
# Additional distance between leg and detector, in mm, so that a rotated leg has room (assumed).
_CLEARANCE_MM = 15.0
# Pixel size of the condition with larger pixels, in mm.
_COARSE_MM = 0.2
_GRADES = (0, 1, 2, 3, 4)
# Number of imaging systems, each of which has one display processing for all knees.
_SYSTEMS = 6
# Bootstrap samples of the knees.
RESAMPLES = 1000
# Displacement of the region along rows and columns, in mm (assumed error of its placement).
_TRANSLATION_MM = 1.0
# Quantities of the knee that are compared with the measures.
BONE_PROPERTIES = ("bone_density", "subchondral_plate", "age_years", "jsw_medial_mm", "grade")


def measure_texture_conditions(knees: int, workers: int = 1) -> list[Row]:
    """Measure how texture measures change between acquisitions and with display processing.

    Parameters
    ----------
    knees : int
        Number of sampled knees, with KL 0 to 4 in turn.
    workers : int, default 1
        Number of processes.

    Returns
    -------
    list of dict
        One row per condition and feature: Pearson correlation ``r`` and ICC(2,1) ``icc`` between the reference and the
        condition over the knees with the 95 % interval ``icc_low`` to ``icc_high``, mean change divided by the standard
        deviation between knees ``shift_sd``, and coefficient of variation of two measurements ``cv_percent``.
    """
    measured = measure_knees(knees, workers)
    weights = sample_knee_weights(np.arange(knees), replicates=RESAMPLES, seed=0)
    rows: list[Row] = []
    for condition in measured[0]:
        if condition == "reference":
            continue
        for feature in measured[0]["reference"]:
            pairs = np.array([[values[name][feature] for name in ("reference", condition)] for values in measured])
            rows.append({"condition": condition, "feature": feature, "knees": knees, **_compare_pairs(pairs, weights)})
    return rows


@lru_cache(maxsize=1)  # Tables `texture_conditions` and `texture_ranking` use the same measurements.
def measure_knees(knees: int, workers: int) -> tuple[dict[str, dict[str, float]], ...]:
    """Measure sampled knees under all conditions.

    Parameters
    ----------
    knees : int
        Number of sampled knees, with KL 0 to 4 in turn.
    workers : int
        Number of processes.

    Returns
    -------
    tuple of dict
        Features by condition of each knee.
    """
    return tuple(map_in_parallel(_measure_knee, range(knees), shared={}, workers=workers))


def measure_texture_meaning(knees: int, workers: int = 1) -> list[Row]:
    """Measure the correlation of texture measures with properties of the knee.

    Parameters
    ----------
    knees : int
        Number of sampled knees, with KL 0 to 4 in turn.
    workers : int, default 1
        Number of processes.

    Returns
    -------
    list of dict
        One row per feature: Spearman correlation with each property of `BONE_PROPERTIES`.
    """
    measured = map_in_parallel(_measure_reference, range(knees), shared={}, workers=workers)
    properties = {name: np.array([of_knee[name] for _, of_knee in measured]) for name in BONE_PROPERTIES}
    rows: list[Row] = []
    for feature in measured[0][0]:
        values = np.array([of_features[feature] for of_features, _ in measured])
        correlations = {name: float(stats.spearmanr(values, of_knee).statistic) for name, of_knee in properties.items()}
        rows.append({"feature": feature, "knees": knees, **correlations})
    return rows


def _measure_knee(index: int) -> dict[str, dict[str, float]]:
    """Measure one knee under all conditions; return its features by condition."""
    knee, reference = _sample_case(index)
    built = build(knee, reference)
    radiograph = simulate_one(built, reference, index)
    values = {
        "reference": measure_radiograph(radiograph),
        "translation": measure_radiograph(radiograph, shift_mm=_TRANSLATION_MM),
    }
    for name, protocol in _list_conditions(reference, index).items():
        # Another posture needs another build.
        posed = build(knee, protocol) if name in ("repeat", "rotation") else built
        seed = index if name not in ("repeat", "noise") else index + 10**6
        values[name] = measure_radiograph(simulate_one(posed, protocol, seed))
    for name, processing in _list_displays(index).items():
        shown = np.asarray(render_for_display(radiograph, bits=16, processing=processing), np.float64)
        values[name] = measure_radiograph(radiograph, shown)
    return values


def _measure_reference(index: int) -> tuple[dict[str, float], dict[str, float]]:
    """Measure one knee under the reference acquisition; return its features and its properties."""
    knee, reference = _sample_case(index)
    return measure_radiograph(simulate_one(build(knee, reference), reference, index)), _describe_knee(knee)


def _sample_case(index: int) -> tuple[Knee, Protocol]:
    """Sample a knee and its reference acquisition."""
    rng = np.random.default_rng([62, index])
    knee = sample_knee(grade=_GRADES[index % len(_GRADES)], rng=rng, grade_table="population")
    nominal = load_region_protocol()
    return knee, _sample_acquisition(nominal, np.random.default_rng([63, index]))


def load_region_protocol() -> Protocol:
    """Load the protocol with a field that is just large enough for the scatter.

    Returns
    -------
    Protocol
        Protocol of the fixed-flexion view.
    """
    return replace(load_protocol(_PROTOCOL), rows=_ROWS, cols=_COLS)


def _sample_acquisition(nominal: Protocol, rng: np.random.Generator) -> Protocol:
    """Sample an acquisition without collimation and side marker."""
    sampled = sample_acquisition(nominal, rng=rng)
    return replace(
        sampled,
        field_width_mm=0.0,
        field_height_mm=0.0,
        marker="none",
        sod_mm=sampled.sod_mm - _CLEARANCE_MM,
    )


def _list_conditions(reference: Protocol, index: int) -> dict[str, Protocol]:
    """List protocols that differ from the reference acquisition in one respect."""
    nominal = load_region_protocol()
    return {
        "repeat": _sample_acquisition(nominal, np.random.default_rng([64, index])),
        "noise": reference,
        "dose_quarter": replace(reference, mas=reference.mas / 4),
        "kv_plus_10": replace(reference, tube_kv=reference.tube_kv + 10),
        "focal_spot_double": replace(reference, focal_spot_mm=2 * reference.focal_spot_mm),
        "magnification": replace(reference, sod_mm=reference.sod_mm - 0.09 * reference.sod_mm),
        "beam_plus_5": replace(reference, beam_angle_deg=reference.beam_angle_deg + 5),
        "rotation": replace(reference, rotation_deg=reference.rotation_deg + 5),
        "pixel_0.2": replace(reference, pixel_mm=_COARSE_MM, rows=_scale(_ROWS), cols=_scale(_COLS)),
    }


def _scale(pixels: int) -> int:
    """Return the number of larger pixels that cover the detector."""
    return round(pixels * 0.15 / _COARSE_MM)


def _list_displays(index: int) -> dict[str, str | FlatPanelProcessing]:
    """List display processing by name.

    `display_sampled` differs between knees, as in images of many systems. Each `system` is the same for all knees.
    """
    sampled = sample_display_processing(rng=np.random.default_rng([66, index]))
    systems = {
        f"system_{number + 1}": sample_display_processing(rng=np.random.default_rng([67, number]))
        for number in range(_SYSTEMS)
    }
    fixed = {"display_log": "log", "display_processed": "processed", "display_film": "film"}
    return {**fixed, "display_sampled": sampled, **systems}


def simulate_one(built: BuiltKnee, protocol: Protocol, seed: int) -> Radiograph:
    """Simulate one radiograph with one thread.

    Parameters
    ----------
    built : BuiltKnee
        Knee.
    protocol : Protocol
        Acquisition protocol.
    seed : int
        Seed of the quantum noise.

    Returns
    -------
    Radiograph
        Radiograph with true landmarks.
    """
    return simulate(built, protocol, rng=np.random.default_rng([65, seed]), engine="scanline", workers=1)


def measure_radiograph(
    radiograph: Radiograph, image: Array | None = None, *, shift_mm: float = 0.0
) -> dict[str, float]:
    """Measure the texture of the medial subchondral region, which true landmarks place.

    Parameters
    ----------
    radiograph : Radiograph
        Simulated radiograph.
    image : (rows, cols) array, grey, optional
        Image for display that is measured instead of the linear pixels.
    shift_mm : float, default 0.0
        Displacement of the region along rows and along columns, in mm.

    Returns
    -------
    dict of str to float
        Features of a right knee; those of a left knee are mirrored.
    """
    assert radiograph.truth is not None
    assert radiograph.knee is not None
    pixel_mm = radiograph.protocol.pixel_mm
    pixels = radiograph.pixels if image is None else image
    landmarks = {
        name: (row + shift_mm / pixel_mm, col + shift_mm / pixel_mm)
        for name, (row, col) in radiograph.truth.landmarks_px.items()
    }
    mask = make_texture_region(_REGION, landmarks, pixels, side=radiograph.knee.side, pixel_mm=pixel_mm)
    values = measure_texture_features(pixels, pixel_mm=pixel_mm, mask=mask)
    return mirror_texture_features(values) if radiograph.knee.side == "left" else values


def _describe_knee(knee: Knee) -> dict[str, float]:
    """Return the properties of a knee as numbers."""
    return {name: float(getattr(knee, name)) for name in BONE_PROPERTIES}


def _compare_pairs(pairs: Array, weights: Array) -> Mapping[str, float]:
    """Compare two measurements of each knee, (knees, 2); `weights` (samples, knees) are those of a bootstrap."""
    change = pairs[:, 1] - pairs[:, 0]
    agreement = icc(pairs)[0]
    drawn = compute_weighted_icc(pairs, weights)[0]
    low, high = compute_icc_interval(agreement, drawn, conditions=2, subjects=len(pairs))
    return {
        "r": float(np.corrcoef(pairs[:, 0], pairs[:, 1])[0, 1]),
        "icc": agreement,
        "icc_low": low,
        "icc_high": high,
        "shift_sd": float(change.mean() / np.std(pairs[:, 0], ddof=1)),
        "cv_percent": float(100 * np.sqrt(np.square(change).mean() / 2) / abs(pairs.mean())),
    }
