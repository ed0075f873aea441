"""Spheres as polyhedra of any number of triangles, and exact chords to hold results against."""

import numpy as np
import trimesh
from numpy.typing import NDArray

from ..core.checks import Array
from ..core.compiled import kernel
from ..geometry.scene import Surface
from ..geometry.view import View


def globe(triangles: int, radius_mm: float) -> trimesh.Trimesh:
    """A convex polyhedron of about so many triangles, its vertices on a sphere, by latitude and longitude."""
    rings = max(3, round((triangles / 3) ** 0.5))
    around = max(3, round(triangles / (2 * (rings - 1))))
    latitude = np.linspace(0, np.pi, rings + 1)[1:-1, None]
    longitude = np.arange(around) * 2 * np.pi / around
    x, y = np.sin(latitude) * np.cos(longitude), np.sin(latitude) * np.sin(longitude)
    sides = np.stack((x, y, np.broadcast_to(np.cos(latitude), x.shape)), axis=-1)
    points = np.vstack((sides.reshape(-1, 3), [[0, 0, 1], [0, 0, -1]])) * radius_mm
    start = np.arange(rings - 2)[:, None] * around
    one, other = start + np.arange(around), start + (np.arange(around) + 1) % around
    top, bottom = np.full(around, len(points) - 2), np.full(around, len(points) - 1)
    last = (rings - 2) * around
    parts = (
        (one, one + around, other),
        (other, one + around, other + around),
        (top, np.arange(around), (np.arange(around) + 1) % around),
        (bottom, last + (np.arange(around) + 1) % around, last + np.arange(around)),
    )
    faces = np.vstack([np.stack(part, axis=-1).reshape(-1, 3) for part in parts])
    return trimesh.Trimesh(points, faces, process=False)


def nested_spheroids(triangles: int) -> list[Surface]:
    """Five nested spheroids of 30 to 75 mm as polyhedra of so many triangles in all: leg, cortex, trabeculae, marrow,
    water."""
    names = ("air", "muscle", "cortical_bone", "trabecular_bone", "marrow", "water")
    meshes = [globe(triangles // 5, radius).apply_scale([1.0, 0.9, 1.3]) for radius in (75.0, 65.0, 50.0, 40.0, 30.0)]
    layers = zip(meshes, names[1:], names, strict=False)
    return [Surface(mesh, inside, outside, inside) for mesh, inside, outside in layers]


def polyhedron_chords(mesh: trimesh.Trimesh, pixels: NDArray[np.int64], view: View) -> Array:
    """(n,)  exact chords of a convex polyhedron, by clipping each ray against the half-space of every face

    pixels  (n, 2)  rows and columns
    """
    source, directions = _rays(pixels, view)
    return np.asarray(_clipped(np.asarray(mesh.vertices), np.asarray(mesh.faces), source, directions))


def sphere_chords(radius_mm: float, pixels: NDArray[np.int64], view: View) -> Array:
    """(n,)  exact chords of a sphere about the origin

    pixels  (n, 2)  row, column
    """
    source, directions = _rays(pixels, view)
    closest = -directions @ source
    squared = radius_mm**2 - (source @ source - closest**2)
    return np.asarray(2 * np.sqrt(np.maximum(squared, 0.0)))


def _rays(pixels: NDArray[np.int64], view: View) -> tuple[Array, Array]:
    """Source (3,) and unit directions (n, 3) of the rays to pixels."""
    corner = np.asarray(view.corner_mm)
    rows, cols = np.asarray(pixels, np.float64).T
    depth = np.full(len(rows), corner[1])
    places = np.column_stack((corner[0] + cols * view.pixel_mm, depth, corner[2] - rows * view.pixel_mm))
    source = np.asarray(view.source_mm)
    offset = places - source
    return source, offset / np.linalg.norm(offset, axis=1, keepdims=True)


@kernel()
def _clipped(points: Array, faces: NDArray[np.int64], source: Array, directions: Array) -> Array:
    near, far = np.zeros(len(directions)), np.full(len(directions), np.inf)
    for k in range(len(faces)):
        a, b, c = points[faces[k, 0]], points[faces[k, 1]], points[faces[k, 2]]
        ux, uy, uz = b[0] - a[0], b[1] - a[1], b[2] - a[2]
        vx, vy, vz = c[0] - a[0], c[1] - a[1], c[2] - a[2]
        nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
        ahead = nx * (a[0] - source[0]) + ny * (a[1] - source[1]) + nz * (a[2] - source[2])
        for ray in range(len(directions)):
            along = nx * directions[ray, 0] + ny * directions[ray, 1] + nz * directions[ray, 2]
            if along > 0.0:
                far[ray] = min(far[ray], ahead / along)
            elif along < 0.0:
                near[ray] = max(near[ray], ahead / along)
            elif ahead < 0.0:
                far[ray] = -np.inf
    return np.maximum(far - near, 0.0)
