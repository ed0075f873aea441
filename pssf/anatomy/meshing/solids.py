"""Building blocks of manifold3d solids: lofts of sections, hulls and height fields. Each function checks its solid."""

from collections.abc import Callable

import manifold3d
import numpy as np
from manifold3d import Manifold
from numpy.typing import NDArray
from scipy.interpolate import PchipInterpolator

from ...core.checks import Array, InputError
from ...data.table_records import Rows
from ...geometry.mesh import Indices, Mesh

# Exponent of the superellipse that describes the cross-section of a shaft, dimensionless.
SHAFT_POWER = 2.3
# Replacements for a triangle with 1, 2 or 3 split edges. Vertices 0 to 2 are its corners, and vertices 3 to 5 are its
# edge midpoints.
_PIECES = {
    1: [[0, 3, 2], [3, 1, 2]],
    2: [[3, 1, 4], [0, 3, 4], [0, 4, 2]],
    3: [[0, 3, 5], [3, 1, 4], [5, 4, 2], [3, 4, 5]],
}


def require_valid_solid(solid: Manifold, name: str) -> Manifold:
    """Check that a solid is valid and not empty, and return it.

    Parameters
    ----------
    solid : Manifold
        Solid to check.
    name : str
        Name of the solid in the error message.

    Returns
    -------
    Manifold
        The same solid.

    Raises
    ------
    InputError
        If the status is not NoError, or if the volume is 0. manifold3d itself never raises an error; a failed operation
        only sets the status and returns an empty solid.
    """
    status = solid.status()
    if status != manifold3d.Error.NoError or not solid.volume() > 0:
        raise InputError(
            f"solid {name} must have status NoError and a volume above 0 mm3, "
            f"got status {status.name} and volume {solid.volume():.6g} mm3"
        )
    return solid


def build_solid(vertices_mm: Array, faces: Indices, name: str) -> Manifold:
    """Build a solid from vertices and faces, and check it.

    Parameters
    ----------
    vertices_mm : (n, 3) float64 array
        Vertices, in mm.
    faces : (m, 3) int array, vertex numbers
        Triangles whose vertex order makes them point outwards.
    name : str
        Name of the solid in the error message.

    Returns
    -------
    Manifold
        The solid.

    Raises
    ------
    InputError
        If the mesh is not a valid solid.
    """
    mesh = manifold3d.Mesh64(np.ascontiguousarray(vertices_mm, np.float64), np.ascontiguousarray(faces, np.uint64))
    return require_valid_solid(Manifold(mesh), name)


def extract_mesh(solid: Manifold) -> Mesh:
    """Extract the surface mesh of a solid in double precision.

    Parameters
    ----------
    solid : Manifold
        Solid, in mm.

    Returns
    -------
    Mesh
        Vertices (n, 3) float64, in mm, and faces (m, 3) int64.
    """
    mesh = solid.to_mesh64()
    return Mesh(np.array(mesh.vert_properties[:, :3]), mesh.tri_verts.astype(np.int64))


def build_bounding_box(solid: Manifold, margin_mm: float) -> Manifold:
    """Build an axis-aligned box around a solid, with a margin.

    Parameters
    ----------
    solid : Manifold
        Solid to enclose, in mm.
    margin_mm : float
        Margin on all sides, in mm.

    Returns
    -------
    Manifold
        Bounding box.
    """
    low, high = np.array(solid.bounding_box()).reshape(2, 3)
    return Manifold.cube(high - low + 2 * margin_mm).translate(low - margin_mm)


def find_edges(faces: Indices) -> Indices:
    """List every edge of a mesh once.

    Parameters
    ----------
    faces : (m, 3) int array, vertex numbers
        Triangles.

    Returns
    -------
    (k, 2) int array
        Vertex numbers of each edge, smaller number first; the edges are sorted.
    """
    number = int(faces.max(initial=0)) + 1
    ends = np.stack((faces, np.roll(faces, -1, axis=1)), axis=-1)
    # Sorting the keys is several times faster than np.unique, which uses a hash table.
    key = np.sort((ends.min(axis=-1) * number + ends.max(axis=-1)).reshape(-1))
    key = key[np.append(True, key[1:] != key[:-1])]
    return np.column_stack((key // number, key % number))


def find_closed_mesh_edges(faces: Indices) -> Indices:
    """List every edge of a closed mesh once, without sorting.

    Parameters
    ----------
    faces : (k, 3) int array, vertex numbers
        Triangles with consistent winding, so that each edge occurs once in each direction.

    Returns
    -------
    (m, 2) int array
        Vertex numbers of each edge, smaller number first; the order of the edges is arbitrary.
    """
    starts, ends = faces.T.ravel(), faces[:, [1, 2, 0]].T.ravel()
    upwards = starts < ends
    return np.column_stack((starts[upwards], ends[upwards]))


def find_crossing_sides(values: Array, faces: Indices, level: float) -> tuple[Indices, Indices, Array]:
    """Find the triangle edges along which vertex values cross a level.

    Parameters
    ----------
    values : (k,) float64 array, any unit
        Values at the vertices.
    faces : (m, 3) int array, vertex numbers
        Triangles.
    level : float
        Level, in the unit of the values.

    Returns
    -------
    starts : (n,) int array
        Vertex at which each crossing edge starts. The two crossing edges of a triangle are consecutive.
    ends : (n,) int array
        Vertex at which each crossing edge ends.
    fraction : (n,) float64 array
        Distance from the start of each edge to the crossing, as a fraction of the edge length.
    """
    beyond = values >= level
    cut = faces[np.ptp(beyond[faces].astype(np.int8), axis=1) > 0]
    starts, ends = cut, np.roll(cut, -1, axis=1)
    crossing = beyond[starts] != beyond[ends]
    starts, ends = starts[crossing], ends[crossing]
    return starts, ends, (level - values[starts]) / (values[ends] - values[starts])


def dilate_rings(selected: NDArray[np.bool_], faces: Indices, rings: int) -> NDArray[np.bool_]:
    """Extend a vertex selection by a number of rings of neighbours.

    Parameters
    ----------
    selected : (n,) bool array
        True at selected vertices.
    faces : (m, 3) int array, vertex numbers
        Triangles.
    rings : int
        Number of edges by which the selection grows.

    Returns
    -------
    (n,) bool array
        Extended selection.
    """
    wide = selected.copy()
    for _ in range(rings):
        wide[faces[wide[faces].any(axis=1)]] = True
    return wide


def split_edges(faces: Indices, edges: Indices, first: int) -> Indices:
    """Split edges of a closed mesh in half and divide the adjacent faces accordingly.

    Parameters
    ----------
    faces : (m, 3) int array, vertex numbers
        Triangles.
    edges : (n, 2) int array, vertex numbers
        Edges to split, smaller vertex number first. The midpoints become vertices `first`, `first` + 1, ...
    first : int
        Number of vertices before the split.

    Returns
    -------
    (k, 3) int array
        Faces after the split.
    """
    touched = np.zeros(first, np.bool_)
    touched[edges] = True
    number = np.flatnonzero(touched[faces].sum(axis=1) > 1)
    about, kept = faces[number], np.ones(len(faces), np.bool_)
    key = edges[:, 0] * first + edges[:, 1]
    order = np.argsort(key)
    ends = np.sort(np.stack((about, np.roll(about, -1, axis=1)), axis=-1), axis=-1)
    wanted = ends[..., 0] * first + ends[..., 1]
    place = np.minimum(np.searchsorted(key, wanted, sorter=order), len(key) - 1)
    middle = np.where(key[order[place]] == wanted, first + order[place], -1)
    count = (middle >= 0).sum(axis=1)
    kept[number[count > 0]] = False
    # The corners of each face are reordered to put split edges first: corners a, b, c, then the midpoints of ab, bc,
    # ca.
    start = np.where(count == 1, np.argmax(middle >= 0, axis=1), (np.argmax(middle < 0, axis=1) + 1) % 3)
    turn = (start[:, None] + np.arange(3)) % 3
    turned = np.hstack([np.take_along_axis(part, turn, axis=1) for part in (about, middle)])
    pieces = [faces[kept]]
    for halves, corners in _PIECES.items():
        pieces.append(turned[count == halves][:, corners].reshape(-1, 3))
    return np.vstack(pieces)


def split_selected_edges(
    places: Array,
    faces: Indices,
    rounds: int,
    choose: Callable[[Array, Indices], tuple[Indices, Array]],
    select_vertices: Callable[[Array], NDArray[np.bool_]] | None = None,
) -> tuple[Array, Indices]:
    """Split selected edges of a closed mesh in half, and repeat this step until no edge is selected.

    Parameters
    ----------
    places : (n, 3) float64 array, mm
        Vertices.
    faces : (m, 3) int array, vertex numbers
        Triangles.
    rounds : int
        Maximum number of repetitions.
    choose : callable
        Function that maps vertices (n, 3), in mm, and edges (k, 2) to the edges to split (l, 2) and their new midpoints
        (l, 3), in mm.
    select_vertices : callable or None
        Function that maps vertices (n, 3), in mm, to booleans (n,). `choose` receives only edges with both ends
        selected. None selects all vertices.

    Returns
    -------
    places : (n, 3) float64 array
        Vertices with the new midpoints at the end, in mm.
    faces : (m, 3) int array
        Faces after the splits.
    """
    for _ in range(rounds):
        if select_vertices is None:
            edges = find_edges(faces)
        else:
            close = select_vertices(places)
            edges = find_edges(faces[close[faces].sum(axis=1) > 1])
            edges = edges[close[edges].all(axis=1)]
        edges, middles = choose(places, edges)
        if not len(edges):
            break
        faces = split_edges(faces, edges, len(places))
        places = np.vstack((places, middles))
    return places, faces


def build_hull(points_mm: Array, name: str) -> Manifold:
    """Build the convex hull of points, and check it.

    Parameters
    ----------
    points_mm : (n, 3) float64 array
        Points, in mm.
    name : str
        Name of the solid in the error message.

    Returns
    -------
    Manifold
        Convex hull.

    Raises
    ------
    InputError
        If the hull is not a valid solid.
    """
    return require_valid_solid(Manifold.hull_points(np.ascontiguousarray(points_mm, np.float64)), name)


def make_ring(half_x: float, half_y: float, centre: tuple[float, float, float], power: float, count: int) -> Array:
    """Sample a superellipse ``|x/a|^p + |y/b|^p = 1`` at one height.

    Parameters
    ----------
    half_x : float
        Semi-axis a along x, in mm.
    half_y : float
        Semi-axis b along y, in mm.
    centre : (float, float, float)
        Centre (x, y, z), in mm.
    power : float
        Exponent p, dimensionless.
    count : int
        Number of points.

    Returns
    -------
    (count, 3) float64 array
        Points in mm, counter-clockwise when viewed from +z.
    """
    return make_rings(np.array([half_x]), np.array([half_y]), np.array([centre]), power, count)[0]


def make_rings(half_x: Array, half_y: Array, centres: Array, power: float, count: int) -> Array:
    """Sample several superellipses, each at one height.

    Parameters
    ----------
    half_x : (n,) float64 array, mm
        Semi-axes along x.
    half_y : (n,) float64 array, mm
        Semi-axes along y.
    centres : (n, 3) float64 array, mm
        Centres (x, y, z).
    power : float
        Exponent of the superellipses, dimensionless.
    count : int
        Number of points per ring.

    Returns
    -------
    (n, count, 3) float64 array
        Rings in mm, counter-clockwise when viewed from +z.

    See Also
    --------
    make_ring : Sample one superellipse.
    """
    angle = np.arange(count) * (2 * np.pi / count)
    cos, sin = np.cos(angle), np.sin(angle)
    radius = (np.abs(cos) ** power + np.abs(sin) ** power) ** (-1 / power)
    places = np.empty((len(centres), count, 3))
    places[..., 0] = centres[:, :1] + half_x[:, None] * radius * cos
    places[..., 1] = centres[:, 1:2] + half_y[:, None] * radius * sin
    places[..., 2] = centres[:, 2:]
    return places


def loft(rings_mm: Array, name: str, *, strip_caps: bool = False) -> Manifold:
    """Build a solid through a stack of rings, closed by flat caps.

    Parameters
    ----------
    rings_mm : (levels, count, 3) float64 array
        Rings in mm, counter-clockwise when viewed from +z, in the order of increasing z.
    name : str
        Name of the solid in the error message.
    strip_caps : bool
        If True, the caps are triangulated in strips from one side to the other. Strips remain valid if a narrow cap is
        later bent. If False, the caps are triangulated as fans around their centres.

    Returns
    -------
    Manifold
        The solid.

    Raises
    ------
    InputError
        If the mesh is not a valid solid.
    """
    levels, count, _ = rings_mm.shape
    lower = np.arange(levels - 1)[:, None] * count + np.arange(count)
    beside = np.arange(levels - 1)[:, None] * count + np.roll(np.arange(count), -1)
    quads = np.stack((lower, beside, beside + count, lower + count), axis=-1).reshape(-1, 4)
    sides, end = np.vstack((quads[:, [0, 1, 2]], quads[:, [0, 2, 3]])), (levels - 1) * count
    points = rings_mm.reshape(-1, 3)
    if strip_caps:
        cap = _list_strip_cap_faces(count)
        return build_solid(points, np.vstack((sides, cap[:, ::-1], cap + end)), name)
    bottom, top = levels * count, levels * count + 1
    first, last = np.arange(count), np.arange(count) + end
    fans = (
        np.column_stack((np.full(count, bottom), np.roll(first, -1), first)),
        np.column_stack((np.full(count, top), last, np.roll(last, -1))),
    )
    return build_solid(np.vstack((points, rings_mm[[0, -1]].mean(axis=1))), np.vstack((sides, *fans)), name)


def _list_strip_cap_faces(count: int) -> Indices:
    """List the faces (count - 2, 3) of a cap as strips across its ring, counter-clockwise.

    `count` must be even.
    """
    one = np.arange(1, count // 2 - 1)
    strips = np.vstack(
        (np.column_stack((one, one + 1, count - one)), np.column_stack((one + 1, count - one - 1, count - one)))
    )
    half = count // 2
    return np.vstack(([[0, 1, count - 1]], strips, [[half - 1, half, half + 1]])).astype(np.int64)


def loft_column(
    sections: Array,
    inset_mm: Callable[[Array], Array],
    heights_mm: Array,
    name: str,
    power: float = SHAFT_POWER,
    count: int = 96,
    *,
    strip_caps: bool = False,
) -> Manifold:
    """Build a column through superelliptic sections that are interpolated in height and reduced by a wall thickness.

    Parameters
    ----------
    sections : (n, 5) float64 array, mm
        One row per section, in any order: height z, half width ML, half width AP, centre y, centre x.
    inset_mm : callable
        Function that maps heights (k,), in mm, to the thickness (k,), in mm, that is subtracted from both semi-axes.
    heights_mm : (k,) float64 array
        Heights of the rings, in mm, in increasing order.
    name : str
        Name of the solid in the error message.
    power : float
        Exponent of the superellipses, dimensionless.
    count : int
        Number of points per ring.
    strip_caps : bool
        If True, the caps are triangulated in strips, as in `loft`.

    Returns
    -------
    Manifold
        The solid.

    Raises
    ------
    InputError
        If the mesh is not a valid solid.
    """
    return loft(
        make_column_rings(sections, heights_mm, power, count, inset_mm(heights_mm)), name, strip_caps=strip_caps
    )


def make_column_rings(
    sections: Array, heights_mm: Array, power: float = SHAFT_POWER, count: int = 96, inset_mm: Array | float = 0.0
) -> Array:
    """Sample the rings of a column whose superelliptic sections are interpolated in height.

    Parameters
    ----------
    sections : (n, 5) float64 array, mm
        One row per section, in any order: height z, half width ML, half width AP, centre y, centre x.
    heights_mm : (k,) float64 array
        Heights of the rings, in mm, in increasing order.
    power : float
        Exponent of the superellipses, dimensionless.
    count : int
        Number of points per ring.
    inset_mm : float or (k,) float64 array
        Thickness subtracted from both semi-axes, in mm. Semi-axes are at least 0.05 mm.

    Returns
    -------
    (k, count, 3) float64 array
        Rings in mm, counter-clockwise when viewed from +z.
    """
    table = np.asarray(sections, dtype=np.float64)
    table = table[np.argsort(table[:, 0])]
    half_x, half_y, centre_y, centre_x = PchipInterpolator(table[:, 0], table[:, 1:])(heights_mm).T
    a, b = np.maximum(half_x - inset_mm, 0.05), np.maximum(half_y - inset_mm, 0.05)
    return make_rings(a, b, np.column_stack((centre_x, centre_y, heights_mm)), power, count)


def make_thickness_profile(table: Rows | Array, factor: float = 1.0) -> Callable[[Array], Array]:
    """Make a function that interpolates cortical thickness between heights.

    Parameters
    ----------
    table : (n, 2) float64 array, mm
        Rows of height and thickness, in any order.
    factor : float
        Factor applied to all thicknesses, dimensionless.

    Returns
    -------
    callable
        Function that maps heights (k,), in mm, to thicknesses (k,), in mm.
    """
    rows = np.asarray(table, dtype=np.float64)
    rows = rows[np.argsort(rows[:, 0])]
    return lambda z_mm: np.interp(z_mm, rows[:, 0], rows[:, 1]) * factor


def build_height_field(x_mm: Array, y_mm: Array, top_mm: Array, bottom_mm: float, name: str) -> Manifold:
    """Build the solid between a height field on a grid and a flat bottom.

    Parameters
    ----------
    x_mm : (nx,) float64 array
        Grid coordinates along x, in mm, in increasing order.
    y_mm : (ny,) float64 array
        Grid coordinates along y, in mm, in increasing order.
    top_mm : (nx, ny) float64 array
        Height of the surface, in mm, above `bottom_mm` everywhere.
    bottom_mm : float
        Height of the flat bottom, in mm.
    name : str
        Name of the solid in the error message.

    Returns
    -------
    Manifold
        The solid.

    Raises
    ------
    InputError
        If the mesh is not a valid solid.
    """
    nx, ny = top_mm.shape
    gx, gy = np.meshgrid(x_mm, y_mm, indexing="ij")
    upper = np.column_stack((gx.ravel(), gy.ravel(), top_mm.ravel()))
    lower = np.column_stack((gx.ravel(), gy.ravel(), np.full(nx * ny, bottom_mm)))
    index = np.arange(nx * ny).reshape(nx, ny)
    a, b, c, d = (part.ravel() for part in (index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:]))
    sheet = np.vstack((np.column_stack((a, b, c)), np.column_stack((a, c, d))))
    border = np.concatenate((index[:, 0], index[-1, 1:], index[-2::-1, -1], index[0, -2:0:-1]))
    after, drop = np.roll(border, -1), nx * ny
    walls = np.vstack(
        (np.column_stack((border, border + drop, after + drop)), np.column_stack((border, after + drop, after)))
    )
    return build_solid(np.vstack((upper, lower)), np.vstack((sheet, sheet[:, ::-1] + drop, walls)), name)
