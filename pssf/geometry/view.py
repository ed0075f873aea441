"""Where source, rays and pixels are, in the knee frame (mm; +x medial of a right knee, +y to detector, +z proximal).

A posture turns the knee within it: in PA its front is at +y, in ML its lateral side, in axial its foot.
"""

import reprlib
from dataclasses import dataclass, replace

import numpy as np

from ..core.checks import Array, InputError, require, require_whole
from ..model.protocol import Protocol

# Wide enough for any scene that is traced, and for a view of the whole of it.
_FARTHEST_MM, _PIXEL_MM, _MOST_PIXELS = 1e14, (1e-9, 1e12), 65536
# Of the detector from the source, along y.
_NEAREST_MM = 1e-6


@dataclass(frozen=True, kw_only=True)
class View:
    """A point source and a flat detector parallel to the x-z plane; columns run towards +x, rows towards -z.

    source_mm, centre_mm  (x, y, z) of the source and of the detector's centre, which has the greater y
    rows, cols            pixels
    pixel_mm              side of a pixel
    raises                InputError for a detector at or behind the source, and for what is no place, count or size
    """

    source_mm: tuple[float, float, float]
    centre_mm: tuple[float, float, float]
    rows: int
    cols: int
    pixel_mm: float

    def __post_init__(self) -> None:
        for field in ("source_mm", "centre_mm"):
            place = getattr(self, field)
            if not isinstance(place, tuple | list | np.ndarray) or len(place) != 3:
                raise InputError(f"view: {field} = {reprlib.repr(place)}; allowed: three numbers, mm")
            for axis, part in zip("xyz", place, strict=True):
                require(f"view: {axis} of {field}", part, -_FARTHEST_MM, _FARTHEST_MM, "mm")
            object.__setattr__(self, field, tuple(map(float, place)))
        for field in ("rows", "cols"):
            require_whole(f"view: {field}", getattr(self, field), 1, _MOST_PIXELS, "pixels")
        require("view: pixel_mm", self.pixel_mm, *_PIXEL_MM, "mm")
        beyond_mm = self.centre_mm[1] - self.source_mm[1]
        require("view: y of centre_mm less y of source_mm", beyond_mm, _NEAREST_MM, 2 * _FARTHEST_MM, "mm")

    @property
    def corner_mm(self) -> tuple[float, float, float]:
        """Centre of the pixel (row 0, column 0)."""
        x, y, z = self.centre_mm
        return (x - (self.cols - 1) / 2 * self.pixel_mm, y, z + (self.rows - 1) / 2 * self.pixel_mm)


def view_of(protocol: Protocol | View) -> View:
    """Source and detector of a protocol; a view is its own.

    The source at (0, -SOD, 0) is turned about the x axis through the origin by beam_angle_deg (positive: it moves
    proximally, the beam points caudally). The detector stays in the plane y = SDD - SOD, centred on the central ray.
    All moves with the place where that ray passes the joint plane (centre_x_mm, centre_z_mm).
    raises  InputError for anything else, and for a beam that is not yet fitted to a knee
    """
    if isinstance(protocol, View):
        return protocol
    if not isinstance(protocol, Protocol):
        raise InputError(
            f"protocol = {reprlib.repr(protocol)}; allowed: a Protocol, as load_protocol gives it, or a View"
        )
    if protocol.beam_along != "horizontal":
        raise InputError(
            f"beam_along = {protocol.beam_along!r}; allowed: 'horizontal', as BuiltKnee.aimed gives it for a knee"
        )
    angle = np.deg2rad(protocol.beam_angle_deg)
    beyond_mm = protocol.sdd_mm - protocol.sod_mm
    x, z = float(protocol.centre_x_mm), float(protocol.centre_z_mm)
    return View(
        source_mm=(x, float(-protocol.sod_mm * np.cos(angle)), z + float(protocol.sod_mm * np.sin(angle))),
        centre_mm=(x, beyond_mm, z + float(-beyond_mm * np.tan(angle))),
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
    views = []
    for dx, wx in zip(places, weights, strict=True):
        for dz, wz in zip(places, weights, strict=True):
            x, y, z = middle.source_mm
            source = (float(x + half * dx), y, float(z + half * dz))
            views.append((replace(middle, source_mm=source), float(wx * wz / 4)))
    return views


def project(points_mm: Array, view: View) -> Array:
    """Where points are seen on the detector.

    points_mm  (n, 3)  knee frame; in front of the source
    returns    (n, 2)  row, column; pixel centres are whole numbers
    """
    return seen_at(points_mm, depth_of(points_mm, view), view)


def depth_of(points_mm: Array, view: View) -> Array:
    """(n,)  how far points (n, 3), mm, are on the way from the source, 0, to the plane of the detector, 1"""
    near, far = view.source_mm[1], view.centre_mm[1]
    return np.asarray((np.asarray(points_mm, np.float64)[:, 1] - near) / (far - near))


def seen_at(points_mm: Array, depth: Array, view: View) -> Array:
    """(n, 2)  row and column at which points (n, 3), mm, are seen whose depth (n,) is as `depth_of` gives it"""
    source, corner = view.source_mm, view.corner_mm
    x = source[0] + (points_mm[:, 0] - source[0]) / depth
    z = source[2] + (points_mm[:, 2] - source[2]) / depth
    return np.column_stack(((corner[2] - z) / view.pixel_mm, (x - corner[0]) / view.pixel_mm))


def magnification(view: View) -> float:
    """Size on the detector over size in the joint plane y = 0."""
    return (view.centre_mm[1] - view.source_mm[1]) / -view.source_mm[1]
