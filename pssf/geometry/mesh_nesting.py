"""Nesting of the connected components (bodies) of a mesh, to distinguish cavities from bodies that are inside out.

Sample lines are traced through faces of the tested bodies. The oblique direction of the sample lines avoids faces that
are parallel to the lines. Intersections are computed in float64 with a half-open edge rule, so every line enters and
leaves a closed body equally often. The surrounding bodies are determined slightly below the surface of each body.
Therefore, faces shared by two bodies and rounding errors at such faces do not affect the result.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..core.checks import Array
from ..core.numba_kernel import kernel, kernel_helper
from .mesh_topology import Faces

# Unit vector along the sample lines. The irregular components avoid mesh faces that are parallel to the lines.
_LINE_DIRECTION = np.array([0.327, 0.598, 0.7317]) / np.sqrt(0.327**2 + 0.598**2 + 0.7317**2)
# Horizontal unit vector perpendicular to the sample lines.
_LINE_NORMAL = np.array([_LINE_DIRECTION[1], -_LINE_DIRECTION[0], 0.0]) / np.sqrt(
    _LINE_DIRECTION[0] ** 2 + _LINE_DIRECTION[1] ** 2
)
# Matrix whose columns are the unit vectors of the axes u, v and t, where t is along the sample lines.
_LINE_AXES = np.column_stack((_LINE_NORMAL, np.cross(_LINE_DIRECTION, _LINE_NORMAL), _LINE_DIRECTION))

# Number of sample lines per body. The lines are evenly distributed over the projected area of the body.
_LINES_PER_BODY = 24
# Depth below the surface at which the surrounding bodies are determined, as a fraction of the chord through the body.
_PROBE_DEPTH_FRACTION = 1e-3

# Minimum fraction of the surface of a cavity that is inside other bodies. In an ideal mesh, the fraction is 1 for a
# cavity and 0 for any other body.
_MIN_CAVITY_FRACTION = 0.3


class _Lines(NamedTuple):
    """Sample lines through body faces, sorted into slabs along u, and sorted by v within each slab.

    `positions_uv` (k, 2) are the coordinates u and v of each line. `slabs` (s + 1,) are the indices of the first line
    in each slab. `body` (k,) is the body of the sampled face. `line_t` (k,) is the coordinate t of the sampled face.
    `inward_sign` (k,) is +1 if the interior of the body is towards increasing t, and otherwise -1. `weight` (k,) is the
    relative projected area that the line represents.
    """

    positions_uv: Array
    slabs: NDArray[np.int64]
    body: NDArray[np.int64]
    line_t: Array
    inward_sign: Array
    weight: NDArray[np.int64]


class _Hits(NamedTuple):
    """Intersections of sample lines with faces, sorted by line.

    `line_t` (n,) is the coordinate t of the intersection, and `face` (n,) is the index of the face. `sign` (n,) is +1
    if the line leaves a body through the face, and -1 if the line enters a body.
    """

    line_t: Array
    face: NDArray[np.int32]
    sign: NDArray[np.int8]


def find_inside_out_bodies(points: Array, faces: Faces, body: NDArray[np.int32], volumes: Array) -> NDArray[np.int64]:
    """Find the bodies of a mesh that are inside out, together with their cavities.

    A body with inward faces is a cavity if another body surrounds it; otherwise, the body is inside out. A body that
    intersects the surface of another body is ambiguous and is not flipped. Rays through the region outside the other
    body then have negative path lengths, which `trace` reports as an error.

    Parameters
    ----------
    points : (n, 3) float64 array, any unit
        Vertices, scaled so that the extent of the mesh is close to 1.
    faces : (m, 3) int32 array
        Vertex indices of each face.
    body : (n,) int32 array
        Index of the body of each vertex.
    volumes : (k,) float64 array, mm3
        Signed volume of each body, which is negative if the faces point inward. Only the sign is used.

    Returns
    -------
    (j,) int64 array
        Indices of the bodies to flip. The result does not depend on the order of faces or vertices.
    """
    seen, side = points @ _LINE_AXES, np.sign(volumes)
    turned, inverted = np.empty(0, np.int64), np.flatnonzero(side < 0)
    while len(inverted):
        surrounded, below = _surrounded_fractions(seen, faces, body, side, inverted)
        no_cavity = surrounded < _MIN_CAVITY_FRACTION
        # If a body must be flipped, all bodies inside this body are tested again after the flip.
        now = inverted[no_cavity & (below < 0.5)]
        if not len(now):
            break
        outward = np.flatnonzero(side > 0)
        hollow = outward[_surrounded_fractions(seen, faces, body, side, outward)[1] >= 0.5]
        faces = flip_bodies(faces, body, now)
        hollow = hollow[_surrounded_fractions(seen, faces, body, side, hollow)[0] >= 0.5]
        faces = flip_bodies(faces, body, hollow)
        turned, inverted = np.concatenate((turned, now, hollow)), inverted[no_cavity & (below >= 0.5)]
        side[turned] = 0
    return turned


def flip_bodies(faces: Faces, body: NDArray[np.int32], chosen: NDArray[np.int64]) -> Faces:
    """Reverse the winding of the faces of selected bodies.

    Parameters
    ----------
    faces : (m, 3) int32 array
        Vertex indices of each face.
    body : (n,) int32 array
        Index of the body of each vertex.
    chosen : (k,) int64 array
        Indices of the bodies to flip.

    Returns
    -------
    (m, 3) int32 array
        Faces, with reversed winding in the selected bodies.
    """
    marks = np.zeros(body.max() + 1, np.bool_)
    marks[chosen] = True
    return np.where(marks[body[faces[:, 0]]][:, None], faces[:, ::-1], faces)


def _surrounded_fractions(
    rotated: Array, faces: Faces, body: NDArray[np.int32], orientation: Array, chosen: NDArray[np.int64]
) -> tuple[Array, Array]:
    """Estimate which fraction of the surface of each chosen body is surrounded by other bodies.

    The winding number of the other bodies is computed slightly below the surface. The return values are two arrays
    (k,): the surface fraction with a winding number of at least 1, and the surface fraction with a negative winding
    number.
    """
    if not len(chosen):
        return np.empty(0), np.empty(0)
    lines = _sample_lines(rotated, faces, body, orientation, chosen)
    free = np.zeros(len(lines.body), np.int64)
    _intersect_lines(lines, rotated, faces, free, _allocate_hits(0))
    starts = np.concatenate(([0], np.cumsum(free)))
    hits = _allocate_hits(starts[-1])
    _intersect_lines(lines, rotated, faces, starts[:-1].copy(), hits)
    around = _winding_of_other_bodies(lines, starts, hits, body[faces[hits.face, 0]])
    inner = np.isfinite(around)
    weight, slot = lines.weight[inner], np.searchsorted(chosen, lines.body[inner])
    # A body that is too thin to have an interior is classified as surrounded, so that it is not flipped.
    whole = np.bincount(slot, weight, len(chosen))
    within = np.bincount(slot, weight * (around[inner] >= 1), len(chosen)) + (whole == 0)
    below = np.bincount(slot, weight * (around[inner] < 0), len(chosen))
    return within / np.maximum(whole, 1), below / np.maximum(whole, 1)


def _allocate_hits(count: int) -> _Hits:
    """Allocate arrays for `count` intersections."""
    return _Hits(np.empty(count), np.empty(count, np.int32), np.empty(count, np.int8))


def _sample_lines(
    rotated: Array, faces: Faces, body: NDArray[np.int32], orientation: Array, chosen: NDArray[np.int64]
) -> _Lines:
    """Generate sample lines that are evenly distributed over the projected area of each chosen body."""
    own = np.flatnonzero(np.isin(body[faces[:, 0]], chosen))
    a, b, c = (rotated[faces[own, corner]] for corner in range(3))
    area = (b[:, 0] - a[:, 0]) * (c[:, 1] - a[:, 1]) - (c[:, 0] - a[:, 0]) * (b[:, 1] - a[:, 1])
    middle, slot = (a + b + c) / 3, np.searchsorted(chosen, body[faces[own, 0]])
    # Faces are sorted by position instead of index, so that the result is independent of the face order in the mesh.
    order = np.lexsort((middle[:, 2], slot))
    total = np.cumsum(abs(area)[order])
    last = total[np.cumsum(np.bincount(slot, minlength=len(chosen))) - 1]
    first = np.concatenate(([0.0], last[:-1]))
    wanted = first[:, None] + (np.arange(_LINES_PER_BODY) + 0.5) / _LINES_PER_BODY * (last - first)[:, None]
    picked, weight = np.unique(np.searchsorted(total, wanted.ravel()), return_counts=True)
    face = order[np.minimum(picked, len(order) - 1)]
    by_u = np.argsort(middle[face, 0], kind="stable")
    across = int(np.ceil(np.sqrt(len(face))))
    slab = np.empty(len(face), np.int64)
    slab[by_u] = np.arange(len(face)) // across
    line = np.lexsort((middle[face, 1], slab))
    slabs = np.append(np.arange(0, len(face), across), len(face))
    face, weight = face[line], weight[line]
    whose = chosen[slot[face]]
    # The factor `orientation` reverses the sign for bodies with inward faces.
    return _Lines(middle[face, :2], slabs, whose, middle[face, 2], -np.sign(area[face]) * orientation[whose], weight)


@kernel_helper(inline="always")
def _crossing_sign(rotated: Array, face: NDArray[np.int32], u: float, v: float) -> int:
    """Return +1 if a line leaves the body through a face, -1 if the line enters, and 0 without an intersection."""
    rise, fall = 0.0, 0.0
    for corner in range(3):
        one, other = face[corner], face[(corner + 1) % 3]
        low, high = min(one, other), max(one, other)
        if (rotated[one, 1] <= v) == (rotated[other, 1] <= v):
            continue
        # The interpolation starts at the vertex with the lower index. Both faces at an edge therefore yield bitwise
        # identical results, so that no line passes between the faces.
        across = rotated[low, 0] + (v - rotated[low, 1]) / (rotated[high, 1] - rotated[low, 1]) * (
            rotated[high, 0] - rotated[low, 0]
        )
        if rotated[one, 1] <= v:
            rise = across
        else:
            fall = across
    if fall <= u < rise:
        return 1
    return -1 if rise <= u < fall else 0


@kernel_helper(inline="always")
def _hit_depth(rotated: Array, face: NDArray[np.int32], u: float, v: float) -> float:
    """Compute the coordinate t at which a line intersects a face."""
    a, b, c = rotated[face[0]], rotated[face[1]], rotated[face[2]]
    ub, vb, tb, uc, vc, tc = b[0] - a[0], b[1] - a[1], b[2] - a[2], c[0] - a[0], c[1] - a[1], c[2] - a[2]
    at = a[2] + ((u - a[0]) * (vc * tb - vb * tc) + (v - a[1]) * (ub * tc - uc * tb)) / (ub * vc - uc * vb)
    low, high = min(a[2], b[2], c[2]), max(a[2], b[2], c[2])
    at = at if at > low else low  # This comparison also replaces NaN, which results from 0/0, with the lower limit.
    return at if at < high else high


@kernel()
def _intersect_lines(lines: _Lines, rotated: Array, faces: Faces, next_slot: NDArray[np.int64], hits: _Hits) -> None:
    """Write the intersections of each line to `hits`, and advance `next_slot` by the number of intersections.

    If `hits` is empty, the intersections are only counted.
    """
    places, slabs = lines.positions_uv, lines.slabs
    low, high = np.empty(len(slabs) - 1), np.empty(len(slabs) - 1)
    for slab in range(len(low)):
        low[slab] = places[slabs[slab] : slabs[slab + 1], 0].min()
        high[slab] = places[slabs[slab] : slabs[slab + 1], 0].max()
    for k in range(len(faces)):
        a, b, c = rotated[faces[k, 0]], rotated[faces[k, 1]], rotated[faces[k, 2]]
        left, right = min(a[0], b[0], c[0]), max(a[0], b[0], c[0])
        bottom, top = min(a[1], b[1], c[1]), max(a[1], b[1], c[1])
        slab = np.searchsorted(high, left)
        while slab < len(low) and low[slab] <= right:
            line = slabs[slab] + np.searchsorted(places[slabs[slab] : slabs[slab + 1], 1], bottom)
            while line < slabs[slab + 1] and places[line, 1] <= top:
                u, v = places[line]
                met = _crossing_sign(rotated, faces[k], u, v)
                if met != 0:
                    if len(hits.line_t):
                        place = next_slot[line]
                        hits.line_t[place], hits.face[place], hits.sign[place] = (
                            _hit_depth(rotated, faces[k], u, v),
                            k,
                            met,
                        )
                    next_slot[line] += 1
                line += 1
            slab += 1


@kernel()
def _winding_of_other_bodies(lines: _Lines, starts: NDArray[np.int64], hits: _Hits, owner: NDArray[np.int32]) -> Array:
    """Compute the winding number of all other bodies slightly below each sampled face.

    The value is NaN if the body has no interior on the sample line.
    """
    around = np.full(len(lines.body), np.nan)
    for line in range(len(lines.body)):
        met, own, at, way = (
            range(starts[line], starts[line + 1]),
            lines.body[line],
            lines.line_t[line],
            lines.inward_sign[line],
        )
        reach, chord = abs(at), np.inf
        for k in met:
            reach = max(reach, abs(hits.line_t[k]))
        for k in met:
            ahead = (hits.line_t[k] - at) * way
            # The sampled face is skipped, because its distance is zero within the rounding error.
            if owner[k] == own and 1e-12 * reach < ahead < chord:
                chord = ahead
        if chord < np.inf:
            place, total = at + way * _PROBE_DEPTH_FRACTION * chord, 0
            for k in met:
                if owner[k] != own and hits.line_t[k] > place:
                    total += hits.sign[k]
            around[line] = total
    return around
