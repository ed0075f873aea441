"""Path lengths by brute force: every triangle of the meshes as they were given, and the last surgical step wins."""

from itertools import pairwise

import numpy as np

from pssf.geometry.view import resolve_view

BONES = ("femur", "tibia", "fibula", "patella", "fabella")


def rays_of(protocol):
    """The source (3,), and ends (rows x cols, 3) of the rays at the pixel centres, mm."""
    view = resolve_view(protocol)
    source, corner = np.array(view.source_mm), np.array(view.first_pixel_mm)
    row, col = np.mgrid[: view.rows, : view.cols]
    step = np.stack((col * view.pixel_mm, np.zeros(row.shape), -row * view.pixel_mm), axis=-1)
    return source, (corner + step).reshape(-1, 3)


def crossings(mesh, source, end):
    """Distances at which a ray crosses a mesh, mm, by Moller and Trumbore (1997) in float64."""
    vertices, faces = np.asarray(mesh.vertices, np.float64), np.asarray(mesh.faces)
    a, b, c = vertices[faces[:, 0]], vertices[faces[:, 1]], vertices[faces[:, 2]]
    way = (end - source) / np.linalg.norm(end - source)
    one, two = b - a, c - a
    p = np.cross(way, two)
    with np.errstate(divide="ignore", invalid="ignore"):
        inverse = 1 / np.einsum("ij,ij->i", one, p)
        from_a = source - a
        u = np.einsum("ij,ij->i", from_a, p) * inverse
        q = np.cross(from_a, one)
        v = q @ way * inverse
        t = np.einsum("ij,ij->i", two, q) * inverse
        hit = (u >= 0) & (v >= 0) & (u + v <= 1) & (t > 0)
    return np.sort(t[hit])


def inside(at, places):
    """(n,) whether places along a ray lie inside a mesh that is crossed at these distances."""
    return np.searchsorted(at, places) % 2 == 1


class BruteRays:
    """Rays of a protocol through a scene, crossed once, and then asked for with any surgical steps."""

    def __init__(self, scene, protocol, pixels):
        self.scene, self.pixels = scene, pixels
        self.source, ends = rays_of(protocol)
        self.ends = ends[pixels]
        self.crossed = [[crossings(s.mesh_arrays, self.source, end) for s in scene.surfaces] for end in self.ends]

    def paths(self, steps, *, texture):
        """Material -> (rays,) path lengths, mm; and which rays met every mesh an even number of times.

        steps  (mesh, material) for each body put in, (mesh, None) for each volume in which bone is taken away
        """
        out, even = {}, np.ones(len(self.ends), bool)
        for ray, (end, crossed) in enumerate(zip(self.ends, self.crossed, strict=True)):
            own = [crossings(mesh, self.source, end) for mesh, _ in steps]
            even[ray] = all(len(at) % 2 == 0 for at in [*crossed, *own])
            far = np.linalg.norm(end - self.source)
            at = np.unique(np.minimum(np.concatenate([[0.0, far], *crossed, *own]), far))
            for start, stop in pairwise(at):
                if stop - start < 1e-9:  # a wall that two surfaces share, but for rounding
                    continue
                material, density = self._there((start + stop) / 2, crossed, own, steps)
                length = stop - start
                if texture and density is not None:
                    way = (end - self.source) / np.linalg.norm(end - self.source)
                    places = [(self.source + mm * way)[None] for mm in (start, stop)]
                    length = density.integrate(*places)[0]
                out.setdefault(material, np.zeros(len(self.ends)))[ray] += length
        return out, even

    def _there(self, place, crossed, own, steps):
        """Material, and density if it has one, at a place of a ray."""
        around = [s for s, at in zip(self.scene.surfaces, crossed, strict=True) if inside(at, place)]
        body = None
        for (_, material), at in zip(steps, own, strict=True):
            if not inside(at, place):
                continue
            if material is not None:
                body = material
            elif body is None:
                around = [s for s in around if not (s.name.split("_")[0] in BONES or s.name.endswith("meniscus"))]
        if body is not None:
            return body, None
        there = {self.scene.ambient: 1}
        for surface in around:
            there[surface.inside] = there.get(surface.inside, 0) + 1
            there[surface.outside] = there.get(surface.outside, 0) - 1
        (material,) = [name for name, count in there.items() if count]
        densities = [s.inside_density for s in around if s.inside == material and s.inside_density is not None]
        return material, densities[0] if densities else None
