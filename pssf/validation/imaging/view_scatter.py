"""Comparison of the scatter kernel with the Monte Carlo simulation in each view."""

import warnings
from dataclasses import replace

import numpy as np

from ...anatomy import (
    BuiltKnee,
    BuiltPair,
    build,
    build_pair,
)
from ...core.resample import downsample_by_blocks
from ...geometry.view import resolve_view
from ...model.knee import Knee
from ...model.protocol import Protocol, load_protocol
from ...model.sampling.knee_sampling import sample_knee
from ...scatter.scatter_kernel import central_air_gap_mm, compute_air_gaps_mm
from ...simulation import KernelNotice, simulate
from ..raycasting.raycast_engines import Row

VIEWS = ("ap_standing", "fixed_flexion", "lyon_schuss", "rosenberg", "lateral", "skyline", "bilateral")
# Number of photons per view.
_PHOTONS = 4_000_000
# KL grades of the sampled knees, whose limbs differ in thickness.
_SAMPLED_GRADES = (0, 2, 4)
# Pixel size of the compared images, in mm.
_PIXEL_MM = 1.2
# Edge length of a cell over which scatter is averaged, in pixels.
_CELL = 8
# Half height and half width of the joint region at the detector, in mm.
_REGION_MM = (40.0, 30.0)
# Minimum mean path length in muscle of a cell that belongs to the limb, in mm.
_MIN_MUSCLE_MM = 20.0


def compare_scatter_by_view(
    workers: int = 2,
    views: tuple[str, ...] = VIEWS,
    photons: int = _PHOTONS,
    sampled_grades: tuple[int, ...] = _SAMPLED_GRADES,
) -> list[Row]:
    """Compare the scatter kernel with the Monte Carlo simulation for the average knee and sampled knees in each view.

    Parameters
    ----------
    workers : int, default 2
        Number of worker processes.
    views : tuple of str
        Names of the protocols to compare.
    photons : int, default 4_000_000
        Number of photons per knee and view.
    sampled_grades : tuple of int
        KL grades of the sampled knees; the seed of each knee is its grade.

    Returns
    -------
    list of dict
        One row per view. ``off_percent`` is the relative difference between kernel and Monte Carlo scatter in a region
        of 80 x 60 mm around the joint of the average knee. ``off_signal_percent`` is the same difference relative to
        the total signal (primary and scatter). ``sampled_low_percent`` and ``sampled_high_percent`` are the smallest
        and the largest relative difference in this region over the sampled knees. ``cell_percent`` is the largest
        relative difference in a cell of 10 mm within the limb of any knee. ``exit_gap_mm`` is the mean central air
        gap of the average knee, from which the kernel is computed.
    """
    return [_compare_view(name, photons, workers, sampled_grades) for name in views]


def _compare_view(name: str, photons: int, workers: int, sampled_grades: tuple[int, ...]) -> Row:
    """Compare the scatter of the average knee and of sampled knees in one view."""
    average = _compare_knee(Knee(), name, photons, workers)
    sampled = [_compare_knee(sample_knee(grade=grade, rng=grade), name, photons, workers) for grade in sampled_grades]
    biases = [row["off_percent"] for row in sampled]
    return {
        "view": name,
        **average,
        "sampled_low_percent": min(biases) if biases else None,
        "sampled_high_percent": max(biases) if biases else None,
        "cell_percent": max(row["cell_percent"] for row in (average, *sampled)),
        "photons": photons,
    }


def _compare_knee(knee: Knee, name: str, photons: int, workers: int) -> Row:
    """Simulate one knee with the scatter kernel and with the Monte Carlo code, and compare the scatter."""
    protocol = load_protocol(name)
    factor = _PIXEL_MM / protocol.pixel_mm
    protocol = replace(
        protocol, rows=round(protocol.rows / factor), cols=round(protocol.cols / factor), pixel_mm=_PIXEL_MM,
        noise="none", scatter_photons=photons, texture="none",
    )  # fmt: skip
    pair = replace(knee, side="right"), replace(knee, side="left")
    built = build_pair(*pair, protocol) if protocol.knee_distance_mm else build(knee, protocol)
    aimed = built.aim_beam(protocol) if isinstance(built, BuiltKnee) else protocol
    keep = ("scatter", "primary", "path_mm")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", KernelNotice)
        kernel, photon = (
            simulate(built, replace(aimed, scatter=model), keep=keep, engine="scanline", workers=workers).kept
            for model in ("kernel", "monte_carlo")
        )
    maps = kernel["scatter"], photon["scatter"], kernel["path_mm"]["muscle"]
    one, other, muscle = (downsample_by_blocks(image, _CELL) for image in maps)
    row, col = _locate_joint_px(built, aimed)
    region = tuple(
        slice(max(0, round((at - half / _PIXEL_MM) / _CELL)), round((at + half / _PIXEL_MM) / _CELL))
        for at, half in zip((row, col), _REGION_MM, strict=True)
    )
    primary = downsample_by_blocks(kernel["primary"], _CELL)
    limb = muscle > _MIN_MUSCLE_MM
    return {
        "exit_gap_mm": round(central_air_gap_mm(compute_air_gaps_mm(built.scene, resolve_view(aimed))), 1),
        "scatter_over_primary": round(float(other[region].sum() / primary[region].sum()), 2),
        "off_percent": round(100 * float(one[region].sum() / other[region].sum() - 1), 4),
        "off_signal_percent": round(100 * float((one - other)[region].sum() / (primary + other)[region].sum()), 4),
        "cell_percent": round(100 * float(np.abs(one[limb] / other[limb] - 1).max()), 1),
    }


def _locate_joint_px(built: BuiltKnee | BuiltPair, protocol: Protocol) -> tuple[float, float]:
    """Return row and column of the imaged joint (sulcus on a skyline view), in pixels."""
    truth = built.truths(protocol)[0] if isinstance(built, BuiltPair) else built.truth(protocol)
    return truth.landmarks_px["sulcus" if "sulcus" in truth.landmarks_px else "joint_centre"]
