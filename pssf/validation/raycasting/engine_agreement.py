"""Agreement of the two ray-casting engines for random knees and random beam directions."""

import dataclasses

import numpy as np
import trimesh

from ...anatomy import build
from ...core.checks import Array
from ...geometry.scene import Scene
from ...geometry.view import resolve_view
from ...model.protocol import load_protocol
from ...model.sampling.knee_sampling import sample_knee
from ...raycast import trace
from .raycast_engines import Row


def compare_engines(knees: int, workers: int, side_px: int = 2048) -> list[Row]:
    """Compare path lengths of the two ray-casting engines for random knees and random beam directions.

    Parameters
    ----------
    knees : int
        Number of knees.
    workers : int
        Number of worker threads.
    side_px : int, default 2048
        Number of detector pixels per side; the field size is that of the protocol ``reference``.

    Returns
    -------
    list of dict
        One row per knee: largest difference between path lengths in mm (``differs_mm``), counts of the ray audit, and
        cumulative number of rays.
    """
    rows, rays = [], 0
    for number in range(knees):
        rng = np.random.default_rng(np.random.SeedSequence(2601, spawn_key=(number,)))
        knee = sample_knee(grade=number % 3, rng=rng, grade_table="paper")
        scene = _rotate_scene(build(knee).scene, trimesh.transformations.random_rotation_matrix(rng.uniform(size=3)))
        protocol = load_protocol("reference")
        sod_mm = rng.uniform(700.0, 1000.0)
        view = resolve_view(
            dataclasses.replace(
                protocol, rows=side_px, cols=side_px, pixel_mm=protocol.pixel_mm * protocol.rows / side_px,
                sod_mm=sod_mm, sdd_mm=sod_mm + rng.uniform(250.0, 400.0), beam_angle_deg=rng.uniform(-10.0, 10.0),
            )
        )  # fmt: skip
        first = trace(scene, view, engine="embree", precision="float64", workers=workers)
        other = trace(scene, view, engine="scanline", precision="float64", workers=workers)
        differs = max(float(abs(path - other.path_mm[name]).max()) for name, path in first.path_mm.items())
        rays += first.audit.rays
        rows.append(
            {"knee": number, "differs_mm": float(f"{differs:.2g}"), **first.audit.counts(), "rays_so_far": rays}
        )
    return rows


def _rotate_scene(scene: Scene, transform: Array) -> Scene:
    """Rotate a scene about the origin by a (4, 4) transform."""
    surfaces = []
    for surface in scene.surfaces:
        mesh = trimesh.Trimesh(
            trimesh.transform_points(surface.mesh.vertices, transform), surface.mesh.faces, process=False
        )
        surfaces.append(dataclasses.replace(surface, mesh=mesh))
    return Scene(surfaces, scene.ambient)
