"""Projection views: source and detector in the knee frame, in mm.

In the knee frame, +x points medially for a right knee, +y points to the detector and +z points proximally. A posture
rotates the knee within this frame. The side of the knee that faces the detector (+y) is anterior in PA projection,
lateral in ML projection and distal in axial projection.
"""

import reprlib
from dataclasses import dataclass, replace

import numpy as np

from ..core.checks import (
    Array,
    InputError,
    require_in_range,
    require_integer,
)
from ..model.protocol import Protocol

# Standard deviation of a Gaussian divided by its full width at half maximum.
SIGMA_PER_FWHM = 1 / np.sqrt(8 * np.log(2))
# Largest absolute coordinate of source and detector, in mm. All limits of a view are wide enough for every scene that
# ray casting accepts.
_FARTHEST_MM = 1e14
# Smallest and largest pixel size, in mm.
_PIXEL_MM = (1e-9, 1e12)
# Maximum number of detector rows or columns.
_MOST_PIXELS = 65536
# Smallest distance between source and detector along y, in mm.
_MIN_SOURCE_DETECTOR_MM = 1e-6


@dataclass(frozen=True, kw_only=True)
class View:
    """Point source and flat detector parallel to the x-z plane.

    The column index of the detector increases towards +x, and the row index increases towards -z.

    Parameters
    ----------
    source_mm : tuple of float
        Position (x, y, z) of the source, in mm.
    centre_mm : tuple of float
        Position (x, y, z) of the detector centre, in mm. The y coordinate must exceed that of the source.
    rows : int
        Number of detector rows.
    cols : int
        Number of detector columns.
    pixel_mm : float
        Edge length of a pixel, in mm.

    Raises
    ------
    InputError
        If the detector is not in front of the source, or if a value has the wrong type or is out of range.
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
                raise InputError(f"view: {field} must be three numbers in mm, got {reprlib.repr(place)}")
            for axis, part in zip("xyz", place, strict=True):
                require_in_range(f"view: {axis} of {field}", part, -_FARTHEST_MM, _FARTHEST_MM, "mm")
            object.__setattr__(self, field, tuple(map(float, place)))
        for field in ("rows", "cols"):
            require_integer(f"view: {field}", getattr(self, field), 1, _MOST_PIXELS, "pixels")
        require_in_range("view: pixel_mm", self.pixel_mm, *_PIXEL_MM, "mm")
        beyond_mm = self.centre_mm[1] - self.source_mm[1]
        require_in_range(
            "view: y of centre_mm minus y of source_mm", beyond_mm, _MIN_SOURCE_DETECTOR_MM, 2 * _FARTHEST_MM, "mm"
        )

    @property
    def first_pixel_mm(self) -> tuple[float, float, float]:
        """Position (x, y, z) of the centre of the pixel in row 0 and column 0, in mm."""
        x, y, z = self.centre_mm
        return (x - (self.cols - 1) / 2 * self.pixel_mm, y, z + (self.rows - 1) / 2 * self.pixel_mm)


def resolve_view(protocol: Protocol | View) -> View:
    """Compute the positions of source and detector for a protocol; a view is returned unchanged.

    The source at (0, -SOD, 0) is rotated about the x axis through the origin by ``beam_angle_deg``. A positive angle
    moves the source proximally, so that the beam points caudally. The detector remains in the plane y = SDD - SOD,
    centred on the central ray. ``centre_x_mm`` and ``centre_z_mm`` shift source and detector together, so that the
    central ray crosses the joint plane at x = ``centre_x_mm`` and z = ``centre_z_mm``. ``detector_offset_x_mm`` and
    ``detector_offset_z_mm`` shift the detector alone.

    Parameters
    ----------
    protocol : Protocol or View
        Acquisition protocol or view.

    Returns
    -------
    View
        View with source and detector.

    Raises
    ------
    InputError
        If `protocol` is neither a Protocol nor a View, or if `beam_along` requires alignment of the beam with a knee.
    """
    if isinstance(protocol, View):
        return protocol
    if not isinstance(protocol, Protocol):
        raise InputError(f"protocol must be a Protocol or a View, got {reprlib.repr(protocol)}: use load_protocol")
    if protocol.beam_along != "horizontal":
        raise InputError(
            f"beam_along must be 'horizontal' for a view, got {protocol.beam_along!r}: use BuiltKnee.aim_beam"
        )
    angle = np.deg2rad(protocol.beam_angle_deg)
    beyond_mm = protocol.sdd_mm - protocol.sod_mm
    x, z = float(protocol.centre_x_mm), float(protocol.centre_z_mm)
    return View(
        source_mm=(x, float(-protocol.sod_mm * np.cos(angle)), z + float(protocol.sod_mm * np.sin(angle))),
        centre_mm=(
            x + float(protocol.detector_offset_x_mm),
            beyond_mm,
            z + float(-beyond_mm * np.tan(angle)) + float(protocol.detector_offset_z_mm),
        ),
        rows=protocol.rows,
        cols=protocol.cols,
        pixel_mm=protocol.pixel_mm,
    )


def make_focal_spot_views(protocol: Protocol, points_per_side: int = 3) -> list[tuple[View, float]]:
    """Create views from source positions across a focal spot, with integration weights.

    Parameters
    ----------
    protocol : Protocol
        Acquisition protocol, which defines the size and shape of the focal spot.
    points_per_side : int, default 3
        Number of Gauss-Legendre points along each side of a square focal spot, or of Gauss-Hermite points across a
        Gaussian focal spot. The integral is exact if the signal varies over the focal spot as a polynomial of degree
        ``2 * points_per_side - 1``.

    Returns
    -------
    list of tuple of View and float
        View from each source position, with the integration weight. The weights add up to 1.
    """
    middle = resolve_view(protocol)
    if protocol.focal_spot_shape == "gaussian":
        scale, whole = protocol.focal_spot_mm * SIGMA_PER_FWHM, 2 * np.pi
        places, weights = np.polynomial.hermite_e.hermegauss(points_per_side)
    else:
        scale, whole = protocol.focal_spot_mm / 2, 4.0
        places, weights = np.polynomial.legendre.leggauss(points_per_side)
    views = []
    for dx, wx in zip(places, weights, strict=True):
        for dz, wz in zip(places, weights, strict=True):
            x, y, z = middle.source_mm
            source = (float(x + scale * dx), y, float(z + scale * dz))
            views.append((replace(middle, source_mm=source), float(wx * wz / whole)))
    return views


def make_corner_view(view: View, first_row: int, rows: int, subpixels: int) -> View:
    """Create a view whose pixel centres are the corners of squares that divide each pixel of some rows.

    Parameters
    ----------
    view : View
        Source and detector.
    first_row : int
        First row.
    rows : int
        Number of rows.
    subpixels : int
        Number of squares along each side of a pixel.

    Returns
    -------
    View
        View of the same source with ``rows * subpixels + 1`` rows and ``cols * subpixels + 1`` columns.
    """
    x, y, z = view.centre_mm
    z += ((view.rows - rows) / 2 - first_row) * view.pixel_mm
    return View(
        source_mm=view.source_mm,
        centre_mm=(x, y, z),
        rows=rows * subpixels + 1,
        cols=view.cols * subpixels + 1,
        pixel_mm=view.pixel_mm / subpixels,
    )


def project_points(points_mm: Array, view: View) -> Array:
    """Project points onto the detector.

    Parameters
    ----------
    points_mm : (n, 3) array
        Points in the knee frame, in front of the source, in mm.
    view : View
        Source and detector.

    Returns
    -------
    (n, 2) float64 array
        Row and column of each point, in pixels. Pixel centres have integer coordinates.
    """
    return project_at_depth(points_mm, depth_fraction(points_mm, view), view)


def depth_fraction(points_mm: Array, view: View) -> Array:
    """Compute the relative depth of points between the source and the detector plane.

    Parameters
    ----------
    points_mm : (n, 3) array
        Points in the knee frame, in mm.
    view : View
        Source and detector.

    Returns
    -------
    (n,) float64 array
        Depth of each point along y: 0 at the source, 1 at the detector.
    """
    near, far = view.source_mm[1], view.centre_mm[1]
    return np.asarray((np.asarray(points_mm, np.float64)[:, 1] - near) / (far - near))


def project_at_depth(points_mm: Array, depth: Array, view: View) -> Array:
    """Project points onto the detector, given their relative depths.

    Parameters
    ----------
    points_mm : (n, 3) array
        Points in the knee frame, in mm.
    depth : (n,) float64 array, dimensionless
        Relative depth of each point, as returned by `depth_fraction`.
    view : View
        Source and detector.

    Returns
    -------
    (n, 2) float64 array
        Row and column of each point, in pixels.
    """
    source, corner = view.source_mm, view.first_pixel_mm
    x = source[0] + (points_mm[:, 0] - source[0]) / depth
    z = source[2] + (points_mm[:, 2] - source[2]) / depth
    return np.column_stack(((corner[2] - z) / view.pixel_mm, (x - corner[0]) / view.pixel_mm))


def magnification(view: View) -> float:
    """Compute the magnification in the joint plane y = 0.

    Parameters
    ----------
    view : View
        Source and detector.

    Returns
    -------
    float
        Ratio of the size on the detector to the size in the joint plane, dimensionless.
    """
    return (view.centre_mm[1] - view.source_mm[1]) / -view.source_mm[1]
