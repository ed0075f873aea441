"""Both engines on random knees, each from a random side: where they differ, and how the rays fared."""

import dataclasses

import numpy as np
import trimesh

from ..anatomy import build
from ..core.checks import Array
from ..geometry.scene import Scene
from ..geometry.view import view_of
from ..model.draw import draw_knee
from ..model.protocol import load_protocol
from ..raycast import trace
from .engines import Row


def agreement_rows(knees: int, workers: int, side: int = 2048) -> list[Row]:
    """One row a knee: how a random knee looks from a random side to both engines.

    side  of the detector, in pixels; the field stays that of the protocol `reference`
    """
    rows, rays = [], 0
    for number in range(knees):
        rng = np.random.default_rng(np.random.SeedSequence(2601, spawn_key=(number,)))
        knee = draw_knee(grade=number % 3, rng=rng, grade_table="paper")
        scene = _turned(build(knee).scene, trimesh.transformations.random_rotation_matrix(rng.uniform(size=3)))
        protocol = load_protocol("reference")
        sod_mm = rng.uniform(700.0, 1000.0)
        view = view_of(
            dataclasses.replace(
                protocol, rows=side, cols=side, pixel_mm=protocol.pixel_mm * protocol.rows / side,
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


def _turned(scene: Scene, transform: Array) -> Scene:
    """A scene turned about the origin."""
    surfaces = []
    for surface in scene.surfaces:
        mesh = trimesh.Trimesh(
            trimesh.transform_points(surface.mesh.vertices, transform), surface.mesh.faces, process=False
        )
        surfaces.append(dataclasses.replace(surface, mesh=mesh))
    return Scene(surfaces, scene.ambient)
