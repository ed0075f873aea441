"""Projection of surfaces onto the detector, with the plane of each triangle, sorted into bands of rows."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...core.checks import Array
from ...geometry.mesh_repair import Solid
from ...geometry.view import View, depth_fraction, project_at_depth
from .triangle_clipping import MIN_DEPTH_FRACTION, clip_mesh_at_source

# Number of image rows per band. The number is fixed, so that results do not depend on the number of workers.
BAND_ROWS = 32


class Point(NamedTuple):
    """Point or vector in the knee frame, in mm.

    Attributes
    ----------
    x, y, z : float
        Components: +x medial for a right knee, +y to the detector, +z proximal.
    """

    x: float
    y: float
    z: float


class RayFrame(NamedTuple):
    """Source, first pixel and pixel size, which together define the ray to every pixel.

    Attributes
    ----------
    source : Point
        Position of the source, in mm.
    corner_vector : Point
        Vector from the source to the centre of pixel (0, 0), in mm.
    pixel_mm : float
        Pixel size, in mm.
    """

    source: Point
    corner_vector: Point
    pixel_mm: float


class Triangles(NamedTuple):
    """Triangles of a surface as arrays for compiled code.

    A depth is a fraction of the source-to-detector distance.

    Attributes
    ----------
    faces : (m, 3) int32 array
        Vertex numbers, with outward orientation.
    projected : (n, 2) float64 array
        Row and column of each projected vertex, in pixels.
    planes : (m, 4) float64 array
        Components 0 to 2 are the normal, which has no unit length. Component 3 is the dot product of the normal with
        (vertex - source). The depth at a pixel is component 3 divided by the dot product of the normal with (pixel -
        source).
    near, far : (m,) float64 array
        Depths of the nearest and the farthest vertex of each triangle.
    rows : (m, 2) int32 array
        Half-open range of the rows that each triangle may cover.
    """

    faces: NDArray[np.int32]
    projected: Array
    planes: Array
    near: Array
    far: Array
    rows: NDArray[np.int32]


@dataclass(frozen=True, kw_only=True)
class ProjectedSurface:
    """Closed surface with its projection onto the detector.

    The part behind the source is cut off, which leaves the surface open at the source. The sum of the crossing signs of
    every ray is then the winding number of the surface around the source.

    Attributes
    ----------
    frame : RayFrame
        Source and pixels that define the rays.
    points : (n, 3) float64 array
        Vertices, in mm.
    triangles : Triangles
        Triangles of the surface.
    rows, cols : tuple of int
        Half-open ranges of the rows and columns that the surface can cover.
    order : (k,) int32 array
        Triangle numbers of band 0, then of band 1, and so on; triangles that cover no pixel are omitted.
    starts : (bands + 1,) int64 array
        Index in `order` at which each band starts.
    is_clipped : bool
        True if part of the surface is behind the source.
    """

    frame: RayFrame
    points: Array
    triangles: Triangles
    rows: tuple[int, int]
    cols: tuple[int, int]
    order: NDArray[np.int32]
    starts: NDArray[np.int64]
    is_clipped: bool

    def triangles_in_band(self, row: int) -> NDArray[np.int32]:
        """Return the triangles that may cover pixels in a band of rows.

        Parameters
        ----------
        row : int
            Any row of the band.

        Returns
        -------
        (n,) int32 array
            Numbers of the triangles.
        """
        band = row // BAND_ROWS
        return self.order[self.starts[band] : self.starts[band + 1]]


def make_ray_frame(view: View) -> RayFrame:
    """Make the ray frame of a view, which defines the ray to every pixel.

    Parameters
    ----------
    view : View
        Source and detector.

    Returns
    -------
    RayFrame
        Source, first pixel and pixel size.
    """
    (x, y, z), source = view.first_pixel_mm, Point(*map(float, view.source_mm))
    return RayFrame(source, Point(float(x - source.x), float(y - source.y), float(z - source.z)), float(view.pixel_mm))


def project_surface(solid: Solid, view: View) -> ProjectedSurface:
    """Project a solid onto the detector of a view.

    Parameters
    ----------
    solid : Solid
        Closed surface.
    view : View
        Source and detector.

    Returns
    -------
    ProjectedSurface
        Projected triangles, sorted into bands of rows.
    """
    points, faces, depth, frame = solid.points, solid.faces, depth_fraction(solid.points, view), make_ray_frame(view)
    planes = _face_planes(points, faces, frame.source)
    cut = bool(depth.min() < MIN_DEPTH_FRACTION)
    if cut:
        points, faces, depth, origin = clip_mesh_at_source(points, faces, depth)
        planes = planes[origin]
    projected = project_at_depth(points, depth, view)
    low, high = np.zeros(2, int), np.zeros(2, int)
    for axis, size in enumerate((view.rows, view.cols) if len(faces) else ()):
        low[axis] = np.clip(np.ceil(projected[:, axis].min()), 0, size)
        high[axis] = np.clip(np.floor(projected[:, axis].max()) + 1, low[axis], size)
    rows, order, starts = _sort_into_bands(projected, faces, view)
    near, far = _face_extremes(depth, faces)
    return ProjectedSurface(
        frame=frame,
        points=points,
        triangles=Triangles(faces, projected, planes, near, far, rows),
        rows=(int(low[0]), int(high[0])),
        cols=(int(low[1]), int(high[1])),
        order=order,
        starts=starts,
        is_clipped=cut,
    )


def _face_extremes(values: Array, faces: NDArray[np.int32]) -> tuple[Array, Array]:
    """Return the minimum and the maximum (m,) over the vertices of each face, for values (n,) per vertex."""
    a, b, c = (values[faces[:, corner]] for corner in range(3))
    return np.minimum(np.minimum(a, b), c), np.maximum(np.maximum(a, b), c)


def _face_planes(points: Array, faces: NDArray[np.int32], source: Point) -> Array:
    """Compute the planes (m, 4) of faces: the normal, and its dot product with (vertex - source)."""
    a, b, c = (points[faces[:, corner]] for corner in range(3))
    (ux, uy, uz), (vx, vy, vz) = (b - a).T, (c - a).T
    x, y, z = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
    scaled = x * (a[:, 0] - source.x) + y * (a[:, 1] - source.y) + z * (a[:, 2] - source.z)
    return np.column_stack((x, y, z, scaled))


def _sort_into_bands(
    projected: Array, faces: NDArray[np.int32], view: View
) -> tuple[NDArray[np.int32], NDArray[np.int32], NDArray[np.int64]]:
    """Compute the row ranges (m, 2) of faces, and the `order` and `starts` of `ProjectedSurface`."""
    # Row ranges are half-open, so that an edge exactly on a pixel row belongs to only one of the two adjacent
    # triangles.
    (top, bottom), (left, right) = (
        np.clip(np.ceil(_face_extremes(projected[:, axis], faces)), 0, size).astype(np.int32)
        for axis, size in enumerate((view.rows, view.cols))
    )
    bands = -(-view.rows // BAND_ROWS)
    first, last = top // BAND_ROWS, (bottom - 1) // BAND_ROWS
    number = np.where((top < bottom) & (left < right), last - first + 1, 0)
    triangle = np.repeat(np.arange(len(faces), dtype=np.int32), number)
    band = np.arange(len(triangle)) - np.repeat(np.cumsum(number) - number - first, number)
    starts = np.zeros(bands + 1, np.int64)
    np.cumsum(np.bincount(band, minlength=bands), out=starts[1:])
    return np.column_stack((top, bottom)), triangle[np.argsort(band, kind="stable")], starts
