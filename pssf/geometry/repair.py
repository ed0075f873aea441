"""What is wrong with a mesh that should bound a solid: mended where only one reading is possible, else refused.

A mesh bounds a solid if every directed edge stands in it as often as its reverse; then the signs of the crossings of
any ray add up to zero, whatever else is odd about it (bodies that touch, cavities, slivers, overlaps).
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..core.checks import Array, InputError
from .topology import Faces, bodies, distinct, edge_sum, narrowed, used, volumes_mm3, winding

# A mesh whose volume is less than this part of the cube around it is a sheet.
_FLAT = 1e-12


@dataclass(frozen=True, kw_only=True)
class Fault:
    """Something amiss with a surface.

    count    faces, edges or vertices concerned; 0 for the whole
    first    the first few of them: face numbers, vertex numbers, or pairs of vertex numbers for edges
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

    points  (n, 3)  mm
    faces   (m, 3)  int32, outward; closed unless a fault is "refused"
    faults  what was found on the way
    """

    points: Array
    faces: Faces
    faults: tuple[Fault, ...] = ()

    @property
    def refused(self) -> tuple[Fault, ...]:
        """Faults that have no right answer; tracing such a mesh raises InputError with them."""
        return tuple(fault for fault in self.faults if fault.outcome == "refused")


def mend(vertices: Array, faces: NDArray[np.integer], name: str) -> Solid:
    """The solid that a mesh bounds, with an account of what was mended or has to be refused.

    vertices  (n, 3)  mm
    faces     (m, 3)  vertex numbers
    """
    points = np.ascontiguousarray(vertices, dtype=np.float64)
    triangles = np.empty((len(faces), 3), np.int32)
    stray = narrowed(np.asarray(faces), len(points), triangles)
    if fault := _unusable(points, np.asarray(faces), stray, name):
        return Solid(points=points[:0], faces=triangles[:0], faults=(fault,))
    origin = np.arange(0)
    faults: list[Fault] = []
    if edge_sum(triangles):
        points, triangles, origin, faults = _joined(points, triangles, name)
        if edge_sum(triangles):
            return Solid(points=points, faces=triangles, faults=(*faults, *_open_edges(triangles, origin, name)))
    points, triangles = used(points, triangles)
    triangles, turned = _outward(points, triangles, name)
    return Solid(points=points, faces=triangles, faults=(*faults, *turned))


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
        used = np.isin(bad, faces)
        if used.any():
            return refuse("vertices that are not finite", bad[used], "allowed: finite coordinates")
    return None


def _joined(points: Array, faces: Faces, name: str) -> tuple[Array, Faces, NDArray[np.int64], list[Fault]]:
    """Equal corners made one, faces without area of their own and repeated ones left out; and each vertex's number."""
    faults = []

    def mended(what: str, count: int, first: NDArray[np.integer], hint: str) -> None:
        numbers = tuple(map(int, first[:3]))
        faults.append(Fault(surface=name, what=what, count=count, first=numbers, outcome="mended", hint=hint))

    first, number = distinct(points + 0.0)  # -0.0 is 0.0
    if len(first) < len(points):
        mended("corners equal to another", len(points) - len(first), _others(first, len(points)), "welded")
        points, faces = points[first], number[faces]
    pointed = (faces[:, [0, 1, 2]] == faces[:, [1, 2, 0]]).any(axis=1)
    kept = np.flatnonzero(~pointed)
    if pointed.any():
        mended("faces with two equal corners", int(pointed.sum()), np.flatnonzero(pointed), "left out")
    start = faces[kept].argmin(axis=1)
    turned = np.take_along_axis(faces[kept], (start[:, None] + np.arange(3)) % 3, axis=1)
    once, _ = distinct(turned.astype(np.float64))
    if len(once) < len(kept):
        again = kept[_others(once, len(kept))]
        mended("faces that stand twice", len(again), again, "left out once")
    return points, np.ascontiguousarray(faces[kept[once]]), first, faults


def _others(picked: NDArray[np.int64], count: int) -> NDArray[np.int64]:
    """Numbers below `count` that are not picked."""
    left = np.ones(count, np.bool_)
    left[picked] = False
    return np.flatnonzero(left)


def _open_edges(faces: Faces, origin: NDArray[np.int64], name: str) -> list[Fault]:
    """Faults for the edges at which a mesh is not closed; `origin` is the number of each vertex as the user has it."""
    start, end = (faces[:, order].ravel().astype(np.int64) for order in ([0, 1, 2], [1, 2, 0]))
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
            first = tuple(f"{a}-{b}" for a, b in origin[edges[bad][:3]])
            hint = "allowed: closed meshes with consistent winding"
            faults.append(
                Fault(surface=name, what=what, count=int(bad.sum()), first=first, outcome="refused", hint=hint)
            )
    return faults


def _outward(points: Array, faces: Faces, name: str) -> tuple[Faces, list[Fault]]:
    """Faces turned outward where the whole mesh, or a body of it that is no cavity, is inside out."""

    def turned(what: str, count: int) -> Fault:
        return Fault(surface=name, what=what, count=count, first=(), outcome="mended", hint="turned outward")

    body, count = bodies(faces, len(points))
    volumes = volumes_mm3(points, faces, body, count)
    size = max(float(np.ptp(points[:, axis])) for axis in range(3))
    if not abs(volumes).sum() > _FLAT * size**3:
        flat = f"mesh has no volume ({abs(volumes).sum():.3g} mm3)"
        hint = "allowed: meshes that bound a solid"
        return faces, [Fault(surface=name, what=flat, count=0, first=(), outcome="refused", hint=hint)]
    faults = []
    if volumes.sum() < 0:
        faces, volumes = np.ascontiguousarray(faces[:, ::-1]), -volumes
        faults.append(turned("mesh is inside out; faces", len(faces)))
    for inverted in np.flatnonzero(volumes < 0):
        own = body[faces[:, 0]] == inverted
        if round(winding(points, faces[~own], points[faces[own][0, 0]])) < 1:
            faces = np.where(own[:, None], faces[:, ::-1], faces)
            faults.append(turned("a body that is no cavity is inside out; faces", int(own.sum())))
    return np.ascontiguousarray(faces), faults
