"""What is wrong with a mesh that should bound a solid: mended where only one reading is possible, else refused.

A mesh bounds a solid if every directed edge stands in it as often as its reverse; then the signs of the crossings of
any ray add up to zero, whatever else is odd about it (bodies that touch, cavities, slivers, overlaps).
"""

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ..core.checks import Array, InputError
from .nesting import flipped, inside_out
from .topology import Faces, bodies, distinct, edge_sum, named, narrowed, pointed, repeats, used, volumes_mm3

# A mesh whose volume is less than this part of the cube around it is a sheet.
_FLAT = 1e-12


@dataclass(frozen=True, kw_only=True)
class Fault:
    """Something amiss with a surface.

    count    faces, edges, vertices or sample rays concerned; 0 for the whole
    first    the first few of them, by the user's numbers: faces, vertices, or pairs of vertices for edges
    outcome  "refused", "mended", or "noted" for what is traced as it is
    """

    surface: str
    what: str
    count: int
    first: tuple[object, ...]
    outcome: str
    hint: str

    def __str__(self) -> str:
        shown = ", ".join(map(str, self.first)) + (", ..." if len(self.first) < self.count else "")
        number = f": {self.count}" if self.count else ""
        return f"{self.surface}: {self.what}{number}" + (f", first {shown}" if self.first else "") + f"; {self.hint}"


@dataclass(frozen=True, kw_only=True)
class Solid:
    """What a mesh bounds, as the engines take it.

    points    (n, 3)  mm
    faces     (m, 3)  int32, outward; closed unless a fault is "refused"
    vertices  (n,)    number of each point in the mesh that it comes from
    faults    what was found on the way
    """

    points: Array
    faces: Faces
    vertices: NDArray[np.int64]
    faults: tuple[Fault, ...] = ()

    @property
    def refused(self) -> tuple[Fault, ...]:
        """Faults that have no right answer; tracing such a mesh raises InputError with them."""
        return tuple(fault for fault in self.faults if fault.outcome == "refused")

    def and_also(self, *faults: Fault) -> "Solid":
        """The same with more faults."""
        return replace(self, faults=(*self.faults, *faults))


def repair(vertices: Array, faces: NDArray[np.integer], name: str) -> Solid:
    """The solid that a mesh bounds, with an account of what was mended or has to be refused.

    vertices  (n, 3)  mm
    faces     (m, 3)  vertex numbers
    name      of the surface, for the account
    """
    points = np.ascontiguousarray(vertices, dtype=np.float64)
    triangles, stray = narrowed(np.asarray(faces), len(points))
    if fault := _unusable(points, np.asarray(faces), stray, name):
        return Solid(points=points[:0], faces=triangles[:0], vertices=np.arange(0), faults=(fault,))
    numbers = np.flatnonzero(named(triangles, len(points)))
    points, triangles = used(points, triangles)
    solid = Solid(points=points, faces=triangles, vertices=numbers)
    closed = edge_sum(triangles) == 0
    if not closed or repeats(points + 0.0, triangles):
        single = _single(solid, name)
        if edge_sum(single.faces) == 0:
            return _outward(single, name)
        if not closed:
            return single.and_also(*_open_edges(single, name))
        # Two bodies share a part of their walls, and each needs its own.
    return _outward(_without_pointed(solid, np.arange(len(triangles)), name)[0], name)


def require_sound(solid: Solid) -> None:
    """Refuse a solid with a fault that has no right answer.

    raises  InputError naming the surface, the count of bad faces, edges or vertices and the first of them
    """
    if solid.refused:
        raise InputError("; ".join(map(str, solid.refused)))


def _unusable(points: Array, faces: NDArray[np.integer], stray: int, name: str) -> Fault | None:
    def refuse(what: str, bad: NDArray[np.integer], hint: str) -> Fault:
        first = tuple(map(int, bad[:3]))
        return Fault(surface=name, what=what, count=len(bad), first=first, outcome="refused", hint=hint)

    if len(faces) == 0:
        return refuse("mesh has 0 faces", faces, "allowed: a closed mesh of 4 or more")
    if stray:
        outside = np.flatnonzero(((faces < 0) | (faces >= len(points))).any(axis=1))
        return refuse("faces with vertices that are not there", outside, f"allowed: vertices 0 to {len(points) - 1}")
    if not np.isfinite(points).all():
        bad = np.flatnonzero(~np.isfinite(points).all(axis=1))
        concerned = bad[np.isin(bad, faces)]
        if len(concerned):
            return refuse("vertices that are not finite", concerned, "allowed: finite coordinates")
    return None


def _mended(name: str, what: str, numbers: NDArray[np.integer], hint: str) -> Fault:
    first = tuple(map(int, numbers[:3]))
    return Fault(surface=name, what=what, count=len(numbers), first=first, outcome="mended", hint=hint)


def _single(solid: Solid, name: str) -> Solid:
    """Equal corners made one, then faces without area of their own and repeated ones left out."""
    first, number = distinct(solid.points + 0.0)  # -0.0 is 0.0
    if len(first) < len(solid.points):
        again = solid.vertices[_others(first, len(solid.points))]
        welded = replace(solid, points=solid.points[first], faces=number[solid.faces], vertices=solid.vertices[first])
        solid = welded.and_also(_mended(name, "corners equal to another", again, "welded"))
    solid, kept = _without_pointed(solid, np.arange(len(solid.faces)), name)
    start = solid.faces.argmin(axis=1)
    turned = np.take_along_axis(solid.faces, (start[:, None] + np.arange(3)) % 3, axis=1)
    once, _ = distinct(turned.astype(np.float64))
    if len(once) == len(kept):
        return solid
    fault = _mended(name, "faces that stand twice", kept[_others(once, len(kept))], "left out once")
    return replace(solid, faces=np.ascontiguousarray(solid.faces[once])).and_also(fault)


def _without_pointed(solid: Solid, numbers: NDArray[np.int64], name: str) -> tuple[Solid, NDArray[np.int64]]:
    """Without the faces that name a vertex twice; `numbers` are the faces' (m,), and come back for those that stay."""
    twice = pointed(solid.faces)
    if not twice.any():
        return solid, numbers
    fault = _mended(name, "faces with two equal corners", numbers[twice], "left out")
    return replace(solid, faces=np.ascontiguousarray(solid.faces[~twice])).and_also(fault), numbers[~twice]


def _others(picked: NDArray[np.int64], count: int) -> NDArray[np.int64]:
    """Numbers below `count` that are not picked."""
    left = np.ones(count, np.bool_)
    left[picked] = False
    return np.flatnonzero(left)


def _open_edges(solid: Solid, name: str) -> list[Fault]:
    """Faults for the edges at which a mesh is not closed."""
    start, end = (solid.faces[:, order].ravel().astype(np.int64) for order in ([0, 1, 2], [1, 2, 0]))
    edges, inverse, degree = np.unique(
        np.column_stack((np.minimum(start, end), np.maximum(start, end))),
        axis=0,
        return_inverse=True,
        return_counts=True,
    )
    excess = np.bincount(inverse.ravel(), weights=np.sign(end - start), minlength=len(edges))
    faults = []
    for what, bad in (
        ("edges of a hole or an open sheet, on one face only", (excess != 0) & (degree == 1)),
        ("edges wound both ways, at which two faces disagree what is outside", (excess != 0) & (degree == 2)),
        ("edges of three or more faces that do not close", (excess != 0) & (degree > 2)),
    ):
        if bad.any():
            first = tuple(f"{a}-{b}" for a, b in solid.vertices[edges[bad][:3]])
            hint = "allowed: closed meshes with consistent winding"
            faults.append(
                Fault(surface=name, what=what, count=int(bad.sum()), first=first, outcome="refused", hint=hint)
            )
    return faults


def _outward(solid: Solid, name: str) -> Solid:
    """Faces turned outward where the whole mesh, or a body of it that is no cavity, is inside out."""
    faces, faults = solid.faces, []
    half_mm = max(float(column.max() / 2 - column.min() / 2) for column in solid.points.T)
    # In a unit near the mesh's size, a power of two: the same bits, and no size overflows.
    unit_mm = math.ldexp(1.0, math.frexp(half_mm)[1] - 1)
    points = solid.points / unit_mm
    body, count = bodies(faces, len(points))
    volumes = volumes_mm3(points, faces, body, count)
    least = _FLAT * (2 * half_mm / unit_mm) ** 3

    def turned(what: str, number: int) -> Fault:
        return Fault(surface=name, what=what, count=number, first=(), outcome="mended", hint="turned outward")

    # Two bodies that cancel, but for rounding, are judged one by one.
    if volumes.sum() < -1e-9 * abs(volumes).sum():
        faces, volumes = np.ascontiguousarray(faces[:, ::-1]), -volumes
        faults.append(turned("mesh is inside out; faces", len(faces)))
    if abs(volumes).sum() > least:
        wrong = inside_out(points, faces, body, volumes)
        if len(wrong):
            who = "a body that is no cavity is" if len(wrong) == 1 else f"{len(wrong)} bodies that are no cavities are"
            faults.append(turned(f"{who} inside out; faces", int(np.isin(body[faces[:, 0]], wrong).sum())))
            faces, volumes[wrong] = np.ascontiguousarray(flipped(faces, body, wrong)), -volumes[wrong]
    if not volumes.sum() > least:
        flat_mm3 = least * unit_mm * unit_mm * unit_mm
        what = f"mesh has no volume (less than {flat_mm3:.3g} mm3)"
        hint = "allowed: meshes that bound a solid"
        return solid.and_also(Fault(surface=name, what=what, count=0, first=(), outcome="refused", hint=hint))
    return replace(solid, faces=faces).and_also(*faults)
