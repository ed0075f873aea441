"""Where source, rays and pixels are, in the knee frame (mm; +x medial of a right knee, +y to detector, +z proximal)."""

from dataclasses import dataclass, replace

import numpy as np

from ..core.checks import Array
from ..model.protocol import Protocol


@dataclass(frozen=True, kw_only=True)
class View:
    """A point source and a flat detector parallel to the x-z plane; columns run towards +x, rows towards -z."""

    source_mm: tuple[float, float, float]
    centre_mm: tuple[float, float, float]
    rows: int
    cols: int
    pixel_mm: float

    @property
    def corner_mm(self) -> tuple[float, float, float]:
        """Centre of the pixel (row 0, column 0)."""
        x, y, z = self.centre_mm
        return (x - (self.cols - 1) / 2 * self.pixel_mm, y, z + (self.rows - 1) / 2 * self.pixel_mm)


def view_of(protocol: Protocol) -> View:
    """Source and detector of a protocol.

    The source at (0, -SOD, 0) is turned about the x axis through the origin by beam_angle_deg (positive: it moves
    proximally, the beam points caudally). The detector stays in the plane y = SDD - SOD, centred on the central ray.
    """
    angle = np.deg2rad(protocol.beam_angle_deg)
    beyond_mm = protocol.sdd_mm - protocol.sod_mm
    return View(
        source_mm=(0.0, float(-protocol.sod_mm * np.cos(angle)), float(protocol.sod_mm * np.sin(angle))),
        centre_mm=(0.0, beyond_mm, float(-beyond_mm * np.tan(angle))),
        rows=protocol.rows,
        cols=protocol.cols,
        pixel_mm=protocol.pixel_mm,
    )


def spot_views(protocol: Protocol, points: int = 3) -> list[tuple[View, float]]:
    """The detector as seen from points of a square focal spot, and the share of the spot that each stands for.

    points  a side: a Gauss-Legendre rule, exact where the signal is a polynomial of degree 2 points - 1 over the spot
    """
    middle, half = view_of(protocol), protocol.focal_spot_mm / 2
    places, weights = np.polynomial.legendre.leggauss(points)
    found = []
    for dx, wx in zip(places, weights, strict=True):
        for dz, wz in zip(places, weights, strict=True):
            x, y, z = middle.source_mm
            source = (float(x + half * dx), y, float(z + half * dz))
            found.append((replace(middle, source_mm=source), float(wx * wz / 4)))
    return found


def project(points_mm: Array, view: View) -> Array:
    """Where points are seen on the detector.

    points_mm  (n, 3)  knee frame; in front of the source
    returns    (n, 2)  row, column; pixel centres are whole numbers
    """
    return seen_at(points_mm, depth_of(points_mm, view), view)


def depth_of(points_mm: Array, view: View) -> Array:
    """(n,)  how far points (n, 3) are on the way from the source, 0, to the plane of the detector, 1"""
    near, far = view.source_mm[1], view.centre_mm[1]
    return np.asarray((np.asarray(points_mm, np.float64)[:, 1] - near) / (far - near))


def seen_at(points_mm: Array, depth: Array, view: View) -> Array:
    """(n, 2)  row and column at which points (n, 3) of a known depth (n,) are seen"""
    source, corner = view.source_mm, view.corner_mm
    x = source[0] + (points_mm[:, 0] - source[0]) / depth
    z = source[2] + (points_mm[:, 2] - source[2]) / depth
    return np.column_stack(((corner[2] - z) / view.pixel_mm, (x - corner[0]) / view.pixel_mm))


def magnification(view: View) -> float:
    """Size on the detector over size in the joint plane y = 0."""
    return (view.centre_mm[1] - view.source_mm[1]) / -view.source_mm[1]
