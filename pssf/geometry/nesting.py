"""Which bodies of a mesh lie within others: what tells a cavity from a body that is inside out.

Lines run through faces of the bodies in question, along a direction in which no drawn shape has its walls. They are met
in float64 with a half-open edge rule, so that every closed body is left as often as it is entered, and what a body is
within is read a little inside of its skin. So a wall that two bodies share decides nothing, nor does rounding on it.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..core.checks import Array
from ..core.compiled import callee, kernel
from .topology import Faces

# Along the lines, across and up.
_ALONG = np.array([0.327, 0.598, 0.7317]) / np.sqrt(0.327**2 + 0.598**2 + 0.7317**2)
_ACROSS = np.array([_ALONG[1], -_ALONG[0], 0.0]) / np.sqrt(_ALONG[0] ** 2 + _ALONG[1] ** 2)
_AXES = np.column_stack((_ACROSS, np.cross(_ALONG, _ACROSS), _ALONG))

# Faces of a body that lines run through, evenly over its skin; the depth of the reading, as a part of its own chord.
_LINES = 24
_UNDER = 1e-3

# A body is no cavity if less of its skin than this is within others. A clean one has all or nothing.
_FEW = 0.3


class _Lines(NamedTuple):
    """Lines through faces of bodies, slab by slab in u, and by v within one.

    places  (k, 2)  u, v
    slabs   (s + 1,)  where slabs start
    body    (k,)  whose face it is
    at      (k,)  t of the face on the line
    way     (k,)  +1 where the body lies behind the face as t grows, else -1
    weight  (k,)  how much of the body's skin it stands for
    """

    places: Array
    slabs: NDArray[np.int64]
    body: NDArray[np.int64]
    at: Array
    way: Array
    weight: NDArray[np.int64]


class _Hits(NamedTuple):
    """Faces that lines meet, line by line.

    at    (n,)  t
    face  (n,)  its number
    sign  (n,)  +1 where the line leaves by it, -1 where it enters
    """

    at: Array
    face: NDArray[np.int32]
    sign: NDArray[np.int8]


def inside_out(points: Array, faces: Faces, body: NDArray[np.int32], volumes: Array) -> NDArray[np.int64]:
    """Bodies that are inside out: of those wound inwards, the ones that no other surrounds; with their cavities.

    One that is surrounded is a cavity. One that is neither, because it crosses the wall of another, is left as wound:
    what sticks out of the wall then counts as less than nothing, which `trace` does not let pass.
    points   (n, 3)  of any unit in which sizes are not extreme
    faces    (m, 3)  vertex numbers
    body     (n,)    number of the body of each vertex
    volumes  (k,)    of the bodies, mm3; negative where one is wound inwards
    returns  (j,)    those to be turned; neither the order of the faces nor that of the vertices matters
    """
    seen, side = points @ _AXES, np.sign(volumes)
    turned, inverted = np.empty(0, np.int64), np.flatnonzero(side < 0)
    while len(inverted):
        surrounded, below = _shares(seen, faces, body, side, inverted)
        no_cavity = surrounded < _FEW
        # What is within a body that is itself to be turned is judged when that has been.
        now = inverted[no_cavity & (below < 0.5)]
        if not len(now):
            break
        outward = np.flatnonzero(side > 0)
        hollow = outward[_shares(seen, faces, body, side, outward)[1] >= 0.5]
        faces = flipped(faces, body, now)
        hollow = hollow[_shares(seen, faces, body, side, hollow)[0] >= 0.5]
        faces = flipped(faces, body, hollow)
        turned, inverted = np.concatenate((turned, now, hollow)), inverted[no_cavity & (below >= 0.5)]
        side[turned] = 0
    return turned


def flipped(faces: Faces, body: NDArray[np.int32], chosen: NDArray[np.int64]) -> Faces:
    """(m, 3)  faces, those of chosen bodies wound the other way

    faces   (m, 3)  vertex numbers
    body    (n,)    number of the body of each vertex
    chosen  (k,)    bodies
    """
    marks = np.zeros(body.max() + 1, np.bool_)
    marks[chosen] = True
    return np.where(marks[body[faces[:, 0]]][:, None], faces[:, ::-1], faces)


def _shares(
    seen: Array, faces: Faces, body: NDArray[np.int32], side: Array, chosen: NDArray[np.int64]
) -> tuple[Array, Array]:
    """(k,), (k,)  parts of each chosen body's skin just under which others are, and are less than not at all"""
    if not len(chosen):
        return np.empty(0), np.empty(0)
    lines = _lines_of(seen, faces, body, side, chosen)
    free = np.zeros(len(lines.body), np.int64)
    _stab(lines, seen, faces, free, _no_hits(0))
    starts = np.concatenate(([0], np.cumsum(free)))
    hits = _no_hits(starts[-1])
    _stab(lines, seen, faces, starts[:-1].copy(), hits)
    around = _around(lines, starts, hits, body[faces[hits.face, 0]])
    inner = np.isfinite(around)
    weight, slot = lines.weight[inner], np.searchsorted(chosen, lines.body[inner])
    # A body too thin to have an inside counts as surrounded: it is left as it is.
    whole = np.bincount(slot, weight, len(chosen))
    within = np.bincount(slot, weight * (around[inner] >= 1), len(chosen)) + (whole == 0)
    below = np.bincount(slot, weight * (around[inner] < 0), len(chosen))
    return within / np.maximum(whole, 1), below / np.maximum(whole, 1)


def _no_hits(count: int) -> _Hits:
    return _Hits(np.empty(count), np.empty(count, np.int32), np.empty(count, np.int8))


def _lines_of(seen: Array, faces: Faces, body: NDArray[np.int32], side: Array, chosen: NDArray[np.int64]) -> _Lines:
    """Lines through faces of chosen bodies, in the order of their numbers, evenly over what each turns to the lines."""
    own = np.flatnonzero(np.isin(body[faces[:, 0]], chosen))
    a, b, c = (seen[faces[own, corner]] for corner in range(3))
    area = (b[:, 0] - a[:, 0]) * (c[:, 1] - a[:, 1]) - (c[:, 0] - a[:, 0]) * (b[:, 1] - a[:, 1])
    middle, slot = (a + b + c) / 3, np.searchsorted(chosen, body[faces[own, 0]])
    order = np.lexsort((middle[:, 2], slot))  # by place, not by number: the faces' order must not matter
    total = np.cumsum(abs(area)[order])
    last = total[np.cumsum(np.bincount(slot, minlength=len(chosen))) - 1]
    first = np.concatenate(([0.0], last[:-1]))
    wanted = first[:, None] + (np.arange(_LINES) + 0.5) / _LINES * (last - first)[:, None]
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
    # Normals of bodies wound inwards point into them.
    return _Lines(middle[face, :2], slabs, whose, middle[face, 2], -np.sign(area[face]) * side[whose], weight)


@callee(inline="always")
def _met(seen: Array, face: NDArray[np.int32], u: float, v: float) -> int:
    """+1 where a line leaves by a face, -1 where it enters, 0 where it misses."""
    rise, fall = 0.0, 0.0
    for corner in range(3):
        one, other = face[corner], face[(corner + 1) % 3]
        low, high = min(one, other), max(one, other)
        if (seen[one, 1] <= v) == (seen[other, 1] <= v):
            continue
        # The same bits whichever way the edge is run along, so that neighbours leave no gap.
        across = seen[low, 0] + (v - seen[low, 1]) / (seen[high, 1] - seen[low, 1]) * (seen[high, 0] - seen[low, 0])
        if seen[one, 1] <= v:
            rise = across
        else:
            fall = across
    if fall <= u < rise:
        return 1
    return -1 if rise <= u < fall else 0


@callee(inline="always")
def _depth(seen: Array, face: NDArray[np.int32], u: float, v: float) -> float:
    """t at which a line meets a face."""
    a, b, c = seen[face[0]], seen[face[1]], seen[face[2]]
    ub, vb, tb, uc, vc, tc = b[0] - a[0], b[1] - a[1], b[2] - a[2], c[0] - a[0], c[1] - a[1], c[2] - a[2]
    at = a[2] + ((u - a[0]) * (vc * tb - vb * tc) + (v - a[1]) * (ub * tc - uc * tb)) / (ub * vc - uc * vb)
    low, high = min(a[2], b[2], c[2]), max(a[2], b[2], c[2])
    at = at if at > low else low  # this way round, so that 0/0 gives a bound too
    return at if at < high else high


@kernel()
def _stab(lines: _Lines, seen: Array, faces: Faces, free: NDArray[np.int64], hits: _Hits) -> None:
    """Write the faces that each line meets to where `free` says, and move it on; with no room for hits, only count."""
    places, slabs = lines.places, lines.slabs
    low, high = np.empty(len(slabs) - 1), np.empty(len(slabs) - 1)
    for slab in range(len(low)):
        low[slab] = places[slabs[slab] : slabs[slab + 1], 0].min()
        high[slab] = places[slabs[slab] : slabs[slab + 1], 0].max()
    for k in range(len(faces)):
        a, b, c = seen[faces[k, 0]], seen[faces[k, 1]], seen[faces[k, 2]]
        left, right = min(a[0], b[0], c[0]), max(a[0], b[0], c[0])
        bottom, top = min(a[1], b[1], c[1]), max(a[1], b[1], c[1])
        slab = np.searchsorted(high, left)
        while slab < len(low) and low[slab] <= right:
            line = slabs[slab] + np.searchsorted(places[slabs[slab] : slabs[slab + 1], 1], bottom)
            while line < slabs[slab + 1] and places[line, 1] <= top:
                u, v = places[line]
                met = _met(seen, faces[k], u, v)
                if met != 0:
                    if len(hits.at):
                        place = free[line]
                        hits.at[place], hits.face[place], hits.sign[place] = _depth(seen, faces[k], u, v), k, met
                    free[line] += 1
                line += 1
            slab += 1


@kernel()
def _around(lines: _Lines, starts: NDArray[np.int64], hits: _Hits, owner: NDArray[np.int32]) -> Array:
    """How often the other bodies go around the place just under each line's face; NaN where there is no inside."""
    around = np.full(len(lines.body), np.nan)
    for line in range(len(lines.body)):
        met, own, at, way = range(starts[line], starts[line + 1]), lines.body[line], lines.at[line], lines.way[line]
        reach, chord = abs(at), np.inf
        for k in met:
            reach = max(reach, abs(hits.at[k]))
        for k in met:
            ahead = (hits.at[k] - at) * way
            # The face itself is met too, within its rounding.
            if owner[k] == own and 1e-12 * reach < ahead < chord:
                chord = ahead
        if chord < np.inf:
            place, total = at + way * _UNDER * chord, 0
            for k in met:
                if owner[k] != own and hits.at[k] > place:
                    total += hits.sign[k]
            around[line] = total
    return around
