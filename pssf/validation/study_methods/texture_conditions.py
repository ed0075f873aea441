"""Change of texture measures with the acquisition, and their correlation with properties of the bone.

Each knee is simulated under a reference acquisition and under conditions that differ in one respect. The medial
subchondral region is placed by true landmarks, so that localisation errors have no effect.
"""

from collections.abc import Mapping
from dataclasses import replace

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
        condition over the knees, mean change divided by the standard deviation between knees ``shift_sd``, and
        coefficient of variation of two measurements ``cv_percent``.
    """
    measured = map_in_parallel(_measure_knee, range(knees), shared={}, workers=workers)
    rows: list[Row] = []
    for condition in measured[0]:
        if condition == "reference":
            continue
        for feature in measured[0]["reference"]:
            pairs = np.array([[values[name][feature] for name in ("reference", condition)] for values in measured])
            rows.append({"condition": condition, "feature": feature, "knees": knees, **_compare_pairs(pairs)})
    return rows


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
    radiograph = _simulate(built, reference, index)
    values = {"reference": _measure_radiograph(radiograph)}
    for name, protocol in _list_conditions(reference, index).items():
        # Another posture needs another build.
        posed = build(knee, protocol) if name in ("repeat", "rotation") else built
        seed = index if name not in ("repeat", "noise") else index + 10**6
        values[name] = _measure_radiograph(_simulate(posed, protocol, seed))
    for name, processing in _list_displays(index).items():
        shown = np.asarray(render_for_display(radiograph, bits=16, processing=processing), np.float64)
        values[name] = _measure_radiograph(radiograph, shown)
    return values


def _measure_reference(index: int) -> tuple[dict[str, float], dict[str, float]]:
    """Measure one knee under the reference acquisition; return its features and its properties."""
    knee, reference = _sample_case(index)
    return _measure_radiograph(_simulate(build(knee, reference), reference, index)), _describe_knee(knee)


def _sample_case(index: int) -> tuple[Knee, Protocol]:
    """Sample a knee and its reference acquisition."""
    rng = np.random.default_rng([62, index])
    knee = sample_knee(grade=_GRADES[index % len(_GRADES)], rng=rng, grade_table="population")
    nominal = replace(load_protocol(_PROTOCOL), rows=_ROWS, cols=_COLS)
    return knee, _sample_acquisition(nominal, np.random.default_rng([63, index]))


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
    nominal = replace(load_protocol(_PROTOCOL), rows=_ROWS, cols=_COLS)
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
    """List display processing by name; `display_sampled` differs between knees, as on equipment of several vendors."""
    sampled = sample_display_processing(rng=np.random.default_rng([66, index]))
    return {"display_log": "log", "display_processed": "processed", "display_film": "film", "display_sampled": sampled}


def _simulate(built: BuiltKnee, protocol: Protocol, seed: int) -> Radiograph:
    """Simulate one radiograph with one thread."""
    return simulate(built, protocol, rng=np.random.default_rng([65, seed]), engine="scanline", workers=1)


def _measure_radiograph(radiograph: Radiograph, image: Array | None = None) -> dict[str, float]:
    """Measure the region of a radiograph, in its linear pixels or in an image (rows, cols) for display."""
    assert radiograph.truth is not None
    assert radiograph.knee is not None
    pixel_mm = radiograph.protocol.pixel_mm
    pixels = radiograph.pixels if image is None else image
    mask = make_texture_region(
        _REGION, radiograph.truth.landmarks_px, pixels, side=radiograph.knee.side, pixel_mm=pixel_mm
    )
    values = measure_texture_features(pixels, pixel_mm=pixel_mm, mask=mask)
    return mirror_texture_features(values) if radiograph.knee.side == "left" else values


def _describe_knee(knee: Knee) -> dict[str, float]:
    """Return the properties of a knee as numbers."""
    return {name: float(getattr(knee, name)) for name in BONE_PROPERTIES}


def _compare_pairs(pairs: Array) -> Mapping[str, float]:
    """Compare two measurements of each knee, (knees, 2)."""
    change = pairs[:, 1] - pairs[:, 0]
    return {
        "r": float(np.corrcoef(pairs[:, 0], pairs[:, 1])[0, 1]),
        "icc": icc(pairs)[0],
        "shift_sd": float(change.mean() / np.std(pairs[:, 0], ddof=1)),
        "cv_percent": float(100 * np.sqrt(np.square(change).mean() / 2) / abs(pairs.mean())),
    }
