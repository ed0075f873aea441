"""Polyhedral spheres with any number of triangles, and their exact chord lengths as reference for ray casting."""

import numpy as np
import trimesh
from numpy.typing import NDArray

from ...core.checks import Array
from ...core.numba_kernel import kernel
from ...geometry.scene import Surface
from ...geometry.view import View


def make_sphere_polyhedron(triangles: int, radius_mm: float) -> trimesh.Trimesh:
    """Make a convex polyhedron whose vertices are on a sphere, on a grid of latitude and longitude.

    Parameters
    ----------
    triangles : int
        Approximate number of triangles.
    radius_mm : float
        Radius of the sphere, in mm.

    Returns
    -------
    trimesh.Trimesh
        Polyhedron centred on the origin.
    """
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


def make_nested_spheroids(triangles: int) -> list[Surface]:
    """Make five nested polyhedral spheroids: leg, cortex, trabecular bone, marrow and water.

    Parameters
    ----------
    triangles : int
        Approximate number of triangles of all spheroids together.

    Returns
    -------
    list of Surface
        Surfaces from the outermost (radius 75 mm before scaling) to the innermost (30 mm).
    """
    names = ("air", "muscle", "cortical_bone", "trabecular_bone", "marrow", "water")
    meshes = [
        make_sphere_polyhedron(triangles // 5, radius).apply_scale([1.0, 0.9, 1.3])
        for radius in (75.0, 65.0, 50.0, 40.0, 30.0)
    ]
    layers = zip(meshes, names[1:], names, strict=False)
    return [Surface(mesh, inside, outside, inside) for mesh, inside, outside in layers]


def polyhedron_chords_mm(mesh: trimesh.Trimesh, pixels: NDArray[np.int64], view: View) -> Array:
    """Compute exact chord lengths of a convex polyhedron by clipping each ray against the half-space of every face.

    Parameters
    ----------
    mesh : trimesh.Trimesh
        Convex polyhedron.
    pixels : (n, 2) int array
        Row and column of each pixel.
    view : View
        Projection geometry.

    Returns
    -------
    (n,) array
        Chord lengths in mm.
    """
    source, directions = _compute_pixel_rays(pixels, view)
    return np.asarray(_clip_rays(np.asarray(mesh.vertices), np.asarray(mesh.faces), source, directions))


def sphere_chords_mm(radius_mm: float, pixels: NDArray[np.int64], view: View) -> Array:
    """Compute exact chord lengths of a sphere centred on the origin.

    Parameters
    ----------
    radius_mm : float
        Radius of the sphere, in mm.
    pixels : (n, 2) int array
        Row and column of each pixel.
    view : View
        Projection geometry.

    Returns
    -------
    (n,) array
        Chord lengths in mm.
    """
    source, directions = _compute_pixel_rays(pixels, view)
    closest = -directions @ source
    squared = radius_mm**2 - (source @ source - closest**2)
    return np.asarray(2 * np.sqrt(np.maximum(squared, 0.0)))


def _compute_pixel_rays(pixels: NDArray[np.int64], view: View) -> tuple[Array, Array]:
    """Compute the source position (3,) in mm and the unit vectors (n, 3) from the source to pixels."""
    corner = np.asarray(view.first_pixel_mm)
    rows, cols = np.asarray(pixels, np.float64).T
    depth = np.full(len(rows), corner[1])
    places = np.column_stack((corner[0] + cols * view.pixel_mm, depth, corner[2] - rows * view.pixel_mm))
    source = np.asarray(view.source_mm)
    offset = places - source
    return source, offset / np.linalg.norm(offset, axis=1, keepdims=True)


@kernel()
def _clip_rays(points: Array, faces: NDArray[np.int64], source: Array, directions: Array) -> Array:
    """Clip rays against the half-space of every face; return (n,) chord lengths in mm."""
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
