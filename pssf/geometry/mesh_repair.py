"""Repair of meshes that should bound a solid.

A fault is repaired if the mesh has only one plausible interpretation; otherwise, ray casting raises an error. A mesh
bounds a solid if every directed edge occurs as often as the edge in the opposite direction. A ray then enters and
leaves the solid equally often, even for touching bodies, cavities, very thin faces and overlaps.
"""

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ..core.checks import Array, InputError
from .mesh_nesting import find_inside_out_bodies, flip_bodies
from .mesh_topology import (
    Faces,
    body_volumes_mm3,
    convert_faces_to_int32,
    count_repeated_faces,
    drop_unused_vertices,
    find_degenerate_faces,
    find_distinct_rows,
    find_used_vertices,
    hash_edge_balance,
    label_bodies,
)

# Minimum volume of a solid, as a fraction of the bounding cube. A mesh with a smaller volume is classified as a sheet.
_MIN_VOLUME_FRACTION = 1e-12


@dataclass(frozen=True, kw_only=True)
class Fault:
    """Problem found in a surface mesh.

    Attributes
    ----------
    surface : str
        Name of the surface.
    problem : str
        Description of the problem.
    count : int
        Number of faces, edges, vertices or sample rays with the problem; 0 if the problem affects the entire surface.
    first_items : tuple
        First affected faces, edges or vertices, as indices in the user's mesh. An edge is a pair of vertex indices.
    outcome : str
        ``"error"`` if ray casting of the mesh raises an error, ``"repaired"`` if the mesh was repaired, ``"warning"``
        if the mesh is used unchanged.
    hint : str
        Requirement that the mesh must meet, or description of the repair.
    """

    surface: str
    problem: str
    count: int
    first_items: tuple[object, ...]
    outcome: str
    hint: str

    def __str__(self) -> str:
        shown = ", ".join(map(str, self.first_items)) + (", ..." if len(self.first_items) < self.count else "")
        number = f": {self.count}" if self.count else ""
        return (
            f"{self.surface}: {self.problem}{number}"
            + (f", first {shown}" if self.first_items else "")
            + f"; {self.hint}"
        )


@dataclass(frozen=True, kw_only=True)
class Solid:
    """Repaired mesh of a solid, as used by the ray-casting engines.

    Attributes
    ----------
    points : (n, 3) float64 array
        Vertices, in mm.
    faces : (m, 3) int32 array
        Vertex indices of the outward faces. The mesh is closed unless a fault has the outcome ``"error"``.
    source_vertices : (n,) int64 array
        Index of each vertex in the original mesh.
    faults : tuple of Fault
        Problems that were found in the original mesh.
    """

    points: Array
    faces: Faces
    source_vertices: NDArray[np.int64]
    faults: tuple[Fault, ...] = ()

    @property
    def fatal_faults(self) -> tuple[Fault, ...]:
        """Faults that cannot be repaired. Ray casting of a mesh with a fatal fault raises InputError."""
        return tuple(fault for fault in self.faults if fault.outcome == "error")

    def add_faults(self, *faults: Fault) -> "Solid":
        """Return a copy of the solid with additional faults.

        Parameters
        ----------
        *faults : Fault
            Faults to append.

        Returns
        -------
        Solid
            Solid with the existing and the additional faults.
        """
        return replace(self, faults=(*self.faults, *faults))


def repair_mesh(vertices: Array, faces: NDArray[np.integer], name: str) -> Solid:
    """Repair a mesh and list all faults, both repaired and fatal.

    Parameters
    ----------
    vertices : (n, 3) float array, mm
        Vertices.
    faces : (m, 3) integer array
        Vertex indices of each face.
    name : str
        Name of the surface, for error messages and warnings.

    Returns
    -------
    Solid
        Repaired mesh with its faults.
    """
    points = np.ascontiguousarray(vertices, dtype=np.float64)
    triangles, stray = convert_faces_to_int32(np.asarray(faces), len(points))
    if fault := _find_unusable_input(points, np.asarray(faces), stray, name):
        return Solid(points=points[:0], faces=triangles[:0], source_vertices=np.arange(0), faults=(fault,))
    numbers = np.flatnonzero(find_used_vertices(triangles, len(points)))
    points, triangles = drop_unused_vertices(points, triangles)
    solid = Solid(points=points, faces=triangles, source_vertices=numbers)
    closed = hash_edge_balance(triangles) == 0
    if not closed or count_repeated_faces(points + 0.0, triangles):
        single = _remove_duplicates(solid, name)
        if hash_edge_balance(single.faces) == 0:
            return _orient_outward(single, name)
        if not closed:
            return single.add_faults(*_find_open_edges(single, name))
        # Duplicate faces are retained if the mesh is closed only with them, as for two bodies with a common face.
    return _orient_outward(_drop_degenerate_faces(solid, np.arange(len(triangles)), name)[0], name)


def require_usable_solid(solid: Solid) -> None:
    """Raise an error if a solid has a fault that cannot be repaired.

    Parameters
    ----------
    solid : Solid
        Solid from `repair_mesh`.

    Raises
    ------
    InputError
        If the solid has a fatal fault. The message contains the surface name, and the number and the first indices of
        the faulty faces, edges or vertices.
    """
    if solid.fatal_faults:
        raise InputError("; ".join(map(str, solid.fatal_faults)))


def _find_unusable_input(points: Array, faces: NDArray[np.integer], stray: int, name: str) -> Fault | None:
    """Return a fault if faces or vertices are missing or if coordinates are not finite; otherwise, return None."""

    def refuse(what: str, bad: NDArray[np.integer], hint: str) -> Fault:
        first = tuple(map(int, bad[:3]))
        return Fault(surface=name, problem=what, count=len(bad), first_items=first, outcome="error", hint=hint)

    if len(faces) == 0:
        return refuse("mesh has 0 faces", faces, "a closed mesh must have 4 faces or more")
    if stray:
        outside = np.flatnonzero(((faces < 0) | (faces >= len(points))).any(axis=1))
        return refuse("faces with missing vertices", outside, f"indices must be 0 to {len(points) - 1}")
    if not np.isfinite(points).all():
        bad = np.flatnonzero(~np.isfinite(points).all(axis=1))
        concerned = bad[np.isin(bad, faces)]
        if len(concerned):
            return refuse("vertices that are not finite", concerned, "coordinates must be finite")
    return None


def _make_repair_fault(name: str, what: str, numbers: NDArray[np.integer], hint: str) -> Fault:
    """Create the fault record of a problem that was repaired."""
    first = tuple(map(int, numbers[:3]))
    return Fault(surface=name, problem=what, count=len(numbers), first_items=first, outcome="repaired", hint=hint)


def _remove_duplicates(solid: Solid, name: str) -> Solid:
    """Merge duplicate vertices, and remove duplicate faces and faces with a repeated vertex."""
    first, number = find_distinct_rows(solid.points + 0.0)  # Adding 0.0 converts -0.0 to 0.0.
    if len(first) < len(solid.points):
        again = solid.source_vertices[_unpicked_indices(first, len(solid.points))]
        welded = replace(
            solid, points=solid.points[first], faces=number[solid.faces], source_vertices=solid.source_vertices[first]
        )
        solid = welded.add_faults(_make_repair_fault(name, "duplicate vertices", again, "merged"))
    solid, kept = _drop_degenerate_faces(solid, np.arange(len(solid.faces)), name)
    start = solid.faces.argmin(axis=1)
    turned = np.take_along_axis(solid.faces, (start[:, None] + np.arange(3)) % 3, axis=1)
    once, _ = find_distinct_rows(turned.astype(np.float64))
    if len(once) == len(kept):
        return solid
    fault = _make_repair_fault(name, "duplicate faces", kept[_unpicked_indices(once, len(kept))], "duplicates removed")
    return replace(solid, faces=np.ascontiguousarray(solid.faces[once])).add_faults(fault)


def _drop_degenerate_faces(solid: Solid, numbers: NDArray[np.int64], name: str) -> tuple[Solid, NDArray[np.int64]]:
    """Remove faces with a repeated vertex, and return the solid and the indices (k,) of the remaining faces."""
    twice = find_degenerate_faces(solid.faces)
    if not twice.any():
        return solid, numbers
    fault = _make_repair_fault(name, "faces with a repeated vertex", numbers[twice], "removed")
    return replace(solid, faces=np.ascontiguousarray(solid.faces[~twice])).add_faults(fault), numbers[~twice]


def _unpicked_indices(picked: NDArray[np.int64], count: int) -> NDArray[np.int64]:
    """Return the indices from 0 to `count` - 1 that are not in `picked`."""
    left = np.ones(count, np.bool_)
    left[picked] = False
    return np.flatnonzero(left)


def _find_open_edges(solid: Solid, name: str) -> list[Fault]:
    """Return the faults of a mesh that is not closed, one for each type of faulty edge."""
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
        ("edges of a hole or an open sheet, with one face only", (excess != 0) & (degree == 1)),
        ("edges between two faces of opposite winding", (excess != 0) & (degree == 2)),
        ("edges with three or more faces that do not close", (excess != 0) & (degree > 2)),
    ):
        if bad.any():
            first = tuple(f"{a}-{b}" for a, b in solid.source_vertices[edges[bad][:3]])
            hint = "the mesh must be closed with consistent winding"
            faults.append(
                Fault(surface=name, problem=what, count=int(bad.sum()), first_items=first, outcome="error", hint=hint)
            )
    return faults


def _orient_outward(solid: Solid, name: str) -> Solid:
    """Flip the faces of a mesh that is inside out, or of individual inside-out bodies that are not cavities."""
    faces, faults = solid.faces, []
    half_mm = max(float(column.max() / 2 - column.min() / 2) for column in solid.points.T)
    # Coordinates are scaled by the mesh size to avoid overflow. The scale is a power of two, which causes no rounding
    # error.
    unit_mm = math.ldexp(1.0, math.frexp(half_mm)[1] - 1)
    points = solid.points / unit_mm
    body, count = label_bodies(faces, len(points))
    volumes = body_volumes_mm3(points, faces, body, count)
    least = _MIN_VOLUME_FRACTION * (2 * half_mm / unit_mm) ** 3

    def turned(what: str, number: int) -> Fault:
        hint = "flipped outward"
        return Fault(surface=name, problem=what, count=number, first_items=(), outcome="repaired", hint=hint)

    # If the body volumes cancel within rounding error, the bodies are tested individually instead of flipping the mesh.
    if volumes.sum() < -1e-9 * abs(volumes).sum():
        faces, volumes = np.ascontiguousarray(faces[:, ::-1]), -volumes
        faults.append(turned("mesh is inside out; faces", len(faces)))
    if abs(volumes).sum() > least:
        wrong = find_inside_out_bodies(points, faces, body, volumes)
        if len(wrong):
            who = (
                "a body that is not a cavity is"
                if len(wrong) == 1
                else f"{len(wrong)} bodies that are not cavities are"
            )
            faults.append(turned(f"{who} inside out; faces", int(np.isin(body[faces[:, 0]], wrong).sum())))
            faces, volumes[wrong] = np.ascontiguousarray(flip_bodies(faces, body, wrong)), -volumes[wrong]
    if not volumes.sum() > least:
        flat_mm3 = least * unit_mm * unit_mm * unit_mm
        what = f"mesh has no volume (less than {flat_mm3:.3g} mm3)"
        hint = "the mesh must bound a solid"
        return solid.add_faults(Fault(surface=name, problem=what, count=0, first_items=(), outcome="error", hint=hint))
    return replace(solid, faces=faces).add_faults(*faults)
