"""Building blocks of manifold3d: lofts of sections, hulls, height fields; each checked where it is made."""

from collections.abc import Callable

import manifold3d
import numpy as np
from manifold3d import Manifold
from numpy.typing import NDArray
from scipy.interpolate import PchipInterpolator

from ..core.checks import Array, InputError
from ..data.records import Rows
from ..geometry.mesh import Indices, Mesh

# Of the superellipse that a shaft's section is.
SHAFT_POWER = 2.3
# Of a triangle with 1, 2 or 3 edges halved: its pieces, by corner (0 to 2) and middle (3 to 5).
_PIECES = {
    1: [[0, 3, 2], [3, 1, 2]],
    2: [[3, 1, 4], [0, 3, 4], [0, 4, 2]],
    3: [[0, 3, 5], [3, 1, 4], [5, 4, 2], [3, 4, 5]],
}


def checked(solid: Manifold, name: str) -> Manifold:
    """The solid itself, or a refusal: manifold3d reports a failure by status and an empty result, never by raising.

    raises  InputError naming the solid, its status and volume
    """
    status = solid.status()
    if status != manifold3d.Error.NoError or not solid.volume() > 0:
        raise InputError(
            f"solid {name}: status {status.name}, volume {solid.volume():.6g} mm3; allowed: NoError, above 0 mm3"
        )
    return solid


def solid_of(vertices_mm: Array, faces: Indices, name: str) -> Manifold:
    """A checked solid from vertices (n, 3) and faces (m, 3) with outward winding."""
    mesh = manifold3d.Mesh64(np.ascontiguousarray(vertices_mm, np.float64), np.ascontiguousarray(faces, np.uint64))
    return checked(Manifold(mesh), name)


def mesh_of(solid: Manifold) -> Mesh:
    """The boundary of a solid, in float64."""
    mesh = solid.to_mesh64()
    return Mesh(np.array(mesh.vert_properties[:, :3]), mesh.tri_verts.astype(np.int64))


def box_about(solid: Manifold, margin_mm: float) -> Manifold:
    """The box that holds a solid and a margin on all sides of it."""
    low, high = np.array(solid.bounding_box()).reshape(2, 3)
    return Manifold.cube(high - low + 2 * margin_mm).translate(low - margin_mm)


def edges_of(faces: Indices) -> Indices:
    """(m, 2)  every edge of a mesh once, the smaller vertex first

    faces  (m, 3)  vertex numbers
    """
    number = int(faces.max(initial=0)) + 1
    ends = np.stack((faces, np.roll(faces, -1, axis=1)), axis=-1)
    # Sorted here: numpy finds what is unique by a hash, which takes several times as long.
    key = np.sort((ends.min(axis=-1) * number + ends.max(axis=-1)).reshape(-1))
    key = key[np.append(True, key[1:] != key[:-1])]
    return np.column_stack((key // number, key % number))


def closed_edges(faces: Indices) -> Indices:
    """(m, 2)  every edge of a closed mesh once, the smaller vertex first, in no order of their own

    faces  (k, 3)  vertex numbers, wound alike, so that each edge is run along once in either direction
    """
    starts, ends = faces.T.ravel(), faces[:, [1, 2, 0]].T.ravel()
    upwards = starts < ends
    return np.column_stack((starts[upwards], ends[upwards]))


def crossing_sides(values: Array, faces: Indices, at: float) -> tuple[Indices, Indices, Array]:
    """Sides of triangles that cross a level: vertices (n,) at which they start and end, and the share (n,) of the way.

    values  (k,)    of vertices, any unit
    faces   (m, 3)  vertex numbers; the two sides of a triangle that cross come one after the other
    """
    beyond = values >= at
    cut = faces[np.ptp(beyond[faces].astype(np.int8), axis=1) > 0]
    starts, ends = cut, np.roll(cut, -1, axis=1)
    crossing = beyond[starts] != beyond[ends]
    starts, ends = starts[crossing], ends[crossing]
    return starts, ends, (at - values[starts]) / (values[ends] - values[starts])


def dilate_rings(chosen: NDArray[np.bool_], faces: Indices, rings: int) -> NDArray[np.bool_]:
    """(n,)  which vertices are chosen, or within so many edges of one that is

    faces  (m, 3)  vertex numbers
    chosen  (n,)
    """
    wide = chosen.copy()
    for _ in range(rings):
        wide[faces[wide[faces].any(axis=1)]] = True
    return wide


def split_edges(faces: Indices, edges: Indices, first: int) -> Indices:
    """(k, 3)  faces of a closed mesh with some of its edges split in half, each neighbour cut to fit

    faces  (m, 3)
    edges  (n, 2)  those to halve, the smaller vertex first; their middles are vertices first, first + 1, ...
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
    # Turned so that the edges to halve come first: corners a, b, c, and the middles of ab, bc, ca.
    start = np.where(count == 1, np.argmax(middle >= 0, axis=1), (np.argmax(middle < 0, axis=1) + 1) % 3)
    turn = (start[:, None] + np.arange(3)) % 3
    turned = np.hstack([np.take_along_axis(part, turn, axis=1) for part in (about, middle)])
    pieces = [faces[kept]]
    for halves, corners in _PIECES.items():
        pieces.append(turned[count == halves][:, corners].reshape(-1, 3))
    return np.vstack(pieces)


def split_where(
    places: Array,
    faces: Indices,
    rounds: int,
    choose: Callable[[Array, Indices], tuple[Indices, Array]],
    near: Callable[[Array], NDArray[np.bool_]] | None = None,
) -> tuple[Array, Indices]:
    """Places (n, 3) and faces (m, 3) of a closed mesh with edges split in half, so often as any is chosen.

    rounds  at most
    choose  places (n, 3), mm, and edges (k, 2) -> those to split (l, 2), and where their middles go (l, 3)
    near    which vertices both ends of an edge must be among: (n, 3) -> (n,) bool; all of them if None
    """
    for _ in range(rounds):
        if near is None:
            edges = edges_of(faces)
        else:
            close = near(places)
            edges = edges_of(faces[close[faces].sum(axis=1) > 1])
            edges = edges[close[edges].all(axis=1)]
        edges, middles = choose(places, edges)
        if not len(edges):
            break
        faces = split_edges(faces, edges, len(places))
        places = np.vstack((places, middles))
    return places, faces


def hull(points_mm: Array, name: str) -> Manifold:
    """Convex hull of points (n, 3)."""
    return checked(Manifold.hull_points(np.ascontiguousarray(points_mm, np.float64)), name)


def ring(half_x: float, half_y: float, centre: tuple[float, float, float], power: float, count: int) -> Array:
    """(count, 3)  a superellipse |x/a|^p + |y/b|^p = 1 at one height, counter-clockwise seen from +z"""
    return rings(np.array([half_x]), np.array([half_y]), np.array([centre]), power, count)[0]


def rings(half_x: Array, half_y: Array, centres: Array, power: float, count: int) -> Array:
    """(n, count, 3)  a `ring` each

    half_x, half_y  (n,)    mm
    centres         (n, 3)  mm
    """
    angle = np.arange(count) * (2 * np.pi / count)
    cos, sin = np.cos(angle), np.sin(angle)
    radius = (np.abs(cos) ** power + np.abs(sin) ** power) ** (-1 / power)
    places = np.empty((len(centres), count, 3))
    places[..., 0] = centres[:, :1] + half_x[:, None] * radius * cos
    places[..., 1] = centres[:, 1:2] + half_y[:, None] * radius * sin
    places[..., 2] = centres[:, 2:]
    return places


def loft(rings_mm: Array, name: str, *, across: bool = False) -> Manifold:
    """A solid through rings (rings, count, 3), counter-clockwise from +z and rising in z, closed by flat caps.

    across  caps are strips from side to side, which stay whole where a narrow one is bent; else fans about the middle
    """
    levels, count, _ = rings_mm.shape
    lower = np.arange(levels - 1)[:, None] * count + np.arange(count)
    beside = np.arange(levels - 1)[:, None] * count + np.roll(np.arange(count), -1)
    quads = np.stack((lower, beside, beside + count, lower + count), axis=-1).reshape(-1, 4)
    sides, end = np.vstack((quads[:, [0, 1, 2]], quads[:, [0, 2, 3]])), (levels - 1) * count
    points = rings_mm.reshape(-1, 3)
    if across:
        cap = _across(count)
        return solid_of(points, np.vstack((sides, cap[:, ::-1], cap + end)), name)
    bottom, top = levels * count, levels * count + 1
    first, last = np.arange(count), np.arange(count) + end
    fans = (
        np.column_stack((np.full(count, bottom), np.roll(first, -1), first)),
        np.column_stack((np.full(count, top), last, np.roll(last, -1))),
    )
    return solid_of(np.vstack((points, rings_mm[[0, -1]].mean(axis=1))), np.vstack((sides, *fans)), name)


def _across(count: int) -> Indices:
    """(count - 2, 3)  faces of a ring of an even count, counter-clockwise, by strips between its two sides"""
    one = np.arange(1, count // 2 - 1)
    strips = np.vstack(
        (np.column_stack((one, one + 1, count - one)), np.column_stack((one + 1, count - one - 1, count - one)))
    )
    half = count // 2
    return np.vstack(([[0, 1, count - 1]], strips, [[half - 1, half, half + 1]])).astype(np.int64)


def column(
    sections: Array,
    inset_mm: Callable[[Array], Array],
    heights_mm: Array,
    name: str,
    power: float = SHAFT_POWER,
    count: int = 96,
    *,
    across: bool = False,
) -> Manifold:
    """A loft through superelliptic sections that are interpolated in height and drawn in by a thickness.

    sections    (n, 5)  z, half ML, half AP, centre y, centre x, mm; any order in z
    inset_mm    height (k,) -> thickness (k,) taken off both half axes
    heights_mm  (k,)    levels of the rings, rising
    """
    return loft(column_rings(sections, heights_mm, power, count, inset_mm(heights_mm)), name, across=across)


def column_rings(
    sections: Array, heights_mm: Array, power: float = SHAFT_POWER, count: int = 96, inset_mm: Array | float = 0.0
) -> Array:
    """(k, count, 3)  the rings of a `column`

    sections    (n, 5)  z, half ML, half AP, centre y, centre x, mm; any order in z
    heights_mm  (k,)    levels of the rings, rising
    inset_mm    (k,) or a number, taken off both half axes
    """
    table = np.asarray(sections, dtype=np.float64)
    table = table[np.argsort(table[:, 0])]
    half_x, half_y, centre_y, centre_x = PchipInterpolator(table[:, 0], table[:, 1:])(heights_mm).T
    a, b = np.maximum(half_x - inset_mm, 0.05), np.maximum(half_y - inset_mm, 0.05)
    return rings(a, b, np.column_stack((centre_x, centre_y, heights_mm)), power, count)


def thickness(table: Rows | Array, factor: float = 1.0) -> Callable[[Array], Array]:
    """Cortical thickness (mm) as a function of height (mm).

    table  (n, 2)  height and thickness there, mm
    """
    rows = np.asarray(table, dtype=np.float64)
    rows = rows[np.argsort(rows[:, 0])]
    return lambda z_mm: np.interp(z_mm, rows[:, 0], rows[:, 1]) * factor


def height_field(x_mm: Array, y_mm: Array, top_mm: Array, bottom_mm: float, name: str) -> Manifold:
    """Everything between a relief and a flat bottom.

    x_mm, y_mm  (nx,), (ny,)  grid, rising
    top_mm      (nx, ny)      height of the relief, above bottom_mm everywhere
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
    return solid_of(np.vstack((upper, lower)), np.vstack((sheet, sheet[:, ::-1] + drop, walls)), name)
