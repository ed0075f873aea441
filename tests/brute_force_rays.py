"""Brute-force ray tracing: every ray is tested against every triangle; the last surgical step has priority."""

from itertools import pairwise

import numpy as np

from pssf.geometry.view import resolve_view

BONES = ("femur", "tibia", "fibula", "patella", "fabella")


def compute_rays(protocol):
    """Return the source (3,) and the ray ends (rows x cols, 3) at the pixel centres, in mm."""
    view = resolve_view(protocol)
    source, corner = np.array(view.source_mm), np.array(view.first_pixel_mm)
    row, col = np.mgrid[: view.rows, : view.cols]
    step = np.stack((col * view.pixel_mm, np.zeros(row.shape), -row * view.pixel_mm), axis=-1)
    return source, (corner + step).reshape(-1, 3)


def find_crossings(mesh, source, end):
    """Find the distances in mm at which a ray crosses a mesh, by Moller and Trumbore (1997) in float64."""
    vertices, faces = np.asarray(mesh.vertices, np.float64), np.asarray(mesh.faces)
    a, b, c = vertices[faces[:, 0]], vertices[faces[:, 1]], vertices[faces[:, 2]]
    direction = (end - source) / np.linalg.norm(end - source)
    edge_ab, edge_ac = b - a, c - a
    p = np.cross(direction, edge_ac)
    with np.errstate(divide="ignore", invalid="ignore"):
        inverse = 1 / np.einsum("ij,ij->i", edge_ab, p)
        from_a = source - a
        u = np.einsum("ij,ij->i", from_a, p) * inverse
        q = np.cross(from_a, edge_ab)
        v = q @ direction * inverse
        t = np.einsum("ij,ij->i", edge_ac, q) * inverse
        hit = (u >= 0) & (v >= 0) & (u + v <= 1) & (t > 0)
    return np.sort(t[hit])


def are_inside(at, positions):
    """Report which positions along a ray are inside a mesh, from the distances at which the ray crosses the mesh."""
    return np.searchsorted(at, positions) % 2 == 1


class BruteForceRays:
    """Rays of a protocol through a scene; crossings are computed once and reused for all surgical steps."""

    def __init__(self, scene, protocol, pixels):
        self.scene, self.pixels = scene, pixels
        self.source, ends = compute_rays(protocol)
        self.ends = ends[pixels]
        self.crossed = [[find_crossings(s.mesh_arrays, self.source, end) for s in scene.surfaces] for end in self.ends]

    def trace_paths(self, steps, *, texture):
        """Compute path lengths in mm, material -> (rays,), and which rays cross every mesh an even number of times.

        steps  (mesh, material) for each inserted body, (mesh, None) for each volume from which bone is removed
        """
        out, even = {}, np.ones(len(self.ends), bool)
        for ray, (end, crossed) in enumerate(zip(self.ends, self.crossed, strict=True)):
            own = [find_crossings(mesh, self.source, end) for mesh, _ in steps]
            even[ray] = all(len(at) % 2 == 0 for at in [*crossed, *own])
            far = np.linalg.norm(end - self.source)
            at = np.unique(np.minimum(np.concatenate([[0.0, far], *crossed, *own]), far))
            for start, stop in pairwise(at):
                if stop - start < 1e-9:  # rounding error between coincident surfaces
                    continue
                material, density = self._find_material((start + stop) / 2, crossed, own, steps)
                length = stop - start
                if texture and density is not None:
                    direction = (end - self.source) / np.linalg.norm(end - self.source)
                    ends = [(self.source + mm * direction)[None] for mm in (start, stop)]
                    length = density.integrate(*ends)[0]
                out.setdefault(material, np.zeros(len(self.ends)))[ray] += length
        return out, even

    def _find_material(self, position, crossed, own, steps):
        """Return the material, and its density field if it has one, at a position along a ray."""
        around = [s for s, at in zip(self.scene.surfaces, crossed, strict=True) if are_inside(at, position)]
        body = None
        for (_, material), at in zip(steps, own, strict=True):
            if not are_inside(at, position):
                continue
            if material is not None:
                body = material
            elif body is None:
                around = [s for s in around if not (s.name.split("_")[0] in BONES or s.name.endswith("meniscus"))]
        if body is not None:
            return body, None
        counts = {self.scene.ambient: 1}
        for surface in around:
            counts[surface.inside] = counts.get(surface.inside, 0) + 1
            counts[surface.outside] = counts.get(surface.outside, 0) - 1
        (material,) = [name for name, count in counts.items() if count]
        densities = [s.inside_density for s in around if s.inside == material and s.inside_density is not None]
        return material, densities[0] if densities else None
