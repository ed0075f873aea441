"""The kernel of scatter beside the Monte Carlo in each view, and the gap that the kernel is given."""

from dataclasses import replace

import numpy as np

from ..anatomy import BuiltKnee, BuiltPair, build, build_pair
from ..core.blocks import block_mean
from ..geometry.view import view_of
from ..model.knee import Knee
from ..model.protocol import Protocol, load_protocol
from ..scatter.kernel import exit_gaps_mm, middle_gap_mm
from ..simulation import simulate
from .engines import Row

VIEWS = ("ap_standing", "fixed_flexion", "lyon_schuss", "rosenberg", "lateral", "skyline", "bilateral")
_PHOTONS = 4_000_000
_PIXEL_MM, _CELL = 1.2, 8
# Half height and half width of the region about the joint, mm on the detector.
_REGION_MM = (40.0, 30.0)
# A cell is of the limb where so much of muscle lies in it.
_LEAST_MM = 20.0


def view_scatter_rows(workers: int = 2, views: tuple[str, ...] = VIEWS, photons: int = _PHOTONS) -> list[Row]:
    """One row a view of the average knee: kernel less Monte Carlo about the joint and in the farthest cell of 10 mm.

    off_percent         in the region of 80 x 60 mm about the joint
    off_signal_percent  the same over the whole signal there, primary and scatter
    cell_percent        in any cell of the limb, at most
    """
    return [_row(name, photons, workers) for name in views]


def _row(name: str, photons: int, workers: int) -> Row:
    protocol = load_protocol(name)
    factor = _PIXEL_MM / protocol.pixel_mm
    protocol = replace(
        protocol, rows=round(protocol.rows / factor), cols=round(protocol.cols / factor), pixel_mm=_PIXEL_MM,
        noise="none", scatter_photons=photons, texture="none",
    )  # fmt: skip
    knee = Knee()
    built = build_pair(knee, replace(knee, side="left"), protocol) if protocol.apart_mm else build(knee, protocol)
    aimed = built.aimed(protocol) if isinstance(built, BuiltKnee) else protocol
    keep = ("scatter", "primary", "path_mm")
    kernel, photon = (
        simulate(built, replace(aimed, scatter=model), keep=keep, engine="scanline", workers=workers).kept
        for model in ("kernel", "monte_carlo")
    )
    maps = kernel["scatter"], photon["scatter"], kernel["path_mm"]["muscle"]
    one, other, muscle = (block_mean(image, _CELL) for image in maps)
    row, col = _joint(built, aimed)
    region = tuple(
        slice(max(0, round((at - half / _PIXEL_MM) / _CELL)), round((at + half / _PIXEL_MM) / _CELL))
        for at, half in zip((row, col), _REGION_MM, strict=True)
    )
    primary = block_mean(kernel["primary"], _CELL)
    limb = muscle > _LEAST_MM
    return {
        "view": name,
        "exit_gap_mm": round(middle_gap_mm(exit_gaps_mm(built.scene, view_of(aimed))), 1),
        "scatter_over_primary": round(float(other[region].sum() / primary[region].sum()), 2),
        "off_percent": round(100 * float(one[region].sum() / other[region].sum() - 1), 4),
        "off_signal_percent": round(100 * float((one - other)[region].sum() / (primary + other)[region].sum()), 4),
        "cell_percent": round(100 * float(np.abs(one[limb] / other[limb] - 1).max()), 1),
        "photons": photons,
    }


def _joint(built: BuiltKnee | BuiltPair, protocol: Protocol) -> tuple[float, float]:
    """Row and column of the joint that a view is taken for."""
    truth = built.truths(protocol)[0] if isinstance(built, BuiltPair) else built.truth(protocol)
    return truth.landmarks_px["sulcus" if "sulcus" in truth.landmarks_px else "joint_centre"]
