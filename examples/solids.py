"""Render the solids of a knee from the front and from the side: in a semi-transparent limb, and cut open."""

from pathlib import Path

import manifold3d
import numpy as np
import trimesh
from embreex.mesh_construction import TriangleMesh
from embreex.rtcore_scene import EmbreeScene
from PIL import Image, ImageChops, ImageDraw
from scipy import ndimage

import pssf
from pssf.io.meshes.knee_viewer import split_creases
from pssf.io.meshes.mesh_export import material_colour
from pssf.io.pictures import write_image_row

# Axes of a picture in the knee frame: right, up, and viewing direction. The projection is parallel.
FRONT = np.array([[1.0, 0, 0], [0, 0, 1.0], [0, 1.0, 0]])
SIDE = np.array([[0, 1.0, 0], [0, 0, 1.0], [-1.0, 0, 0]])
BACKGROUND = np.float32([252, 252, 253])
SOFT_TISSUES = ("skin", "adipose", "muscle")
# Number of rays per pixel along each axis of the image.
SUPERSAMPLING = 2


def run(out: Path, pixels: int = 2048) -> list[Path]:
    """Write the picture as PNG; its height is 3/8 of `pixels`."""
    scene = pssf.build(pssf.Knee(osteophytes=(pssf.Osteophyte(site="medial_tibia", size_mm=2.0),))).scene
    panels = []
    for axes, depth_mm in ((FRONT, 3.0), (SIDE, 7.0)):
        window = Window(scene, axes, rows=max(8, pixels * 3 // 8))
        panels += [render_in_limb(scene, window), render_cut(scene, window, depth_mm)]
    height = window.rows // SUPERSAMPLING
    gap = np.tile(BACKGROUND.astype(np.uint8), (height, height // 24, 1))
    return [write_image_row([np.hstack([part for panel in panels for part in (gap, panel)][1:])], out / "solids.png")]


class Window:
    """Grid of rays of one view, with SUPERSAMPLING x SUPERSAMPLING rays per pixel."""

    def __init__(self, scene: pssf.Scene, axes: np.ndarray, rows: int) -> None:
        corners = scene.bounds_mm @ axes.T
        (left, low, near), (right, high, _) = np.sort(corners, axis=0)
        self.axes, self.rows, self.near_mm = axes, rows * SUPERSAMPLING, near - 1.0
        self.step_mm = 1.02 * (high - low) / self.rows
        self.cols = int(1.04 * (right - left) / self.step_mm) // SUPERSAMPLING * SUPERSAMPLING
        self.left, self.top = (left + right - self.cols * self.step_mm) / 2, (low + high + self.rows * self.step_mm) / 2

    def make_origins_mm(self, depth_mm: float) -> np.ndarray:
        """Make the origins (rows * cols, 3) of the rays, at a depth along the viewing direction."""
        across = self.left + self.step_mm * (np.arange(self.cols) + 0.5)
        up = self.top - self.step_mm * (np.arange(self.rows) + 0.5)
        right, above, ahead = self.axes.astype(np.float32)
        rows = up[:, None].astype(np.float32) * above + np.float32(depth_mm) * ahead
        return (rows[:, None] + across[:, None].astype(np.float32) * right).reshape(-1, 3)

    def to_pixels(self, points: np.ndarray) -> list[tuple[float, float]]:
        """Convert points (n, 2), in mm along the axes, to pixels."""
        return [(x, y) for x, y in (points - [self.left, self.top]) / [self.step_mm, -self.step_mm] - 0.5]

    def fill(self, hit: np.ndarray, values: np.ndarray) -> np.ndarray:
        """Make an image (rows, cols, ...) with `values` at the rays that hit a surface, and 0 elsewhere."""
        whole = np.zeros((self.rows * self.cols, *values.shape[1:]), np.float32)
        whole[hit] = values
        return whole.reshape(self.rows, self.cols, *values.shape[1:])


def render_in_limb(scene: pssf.Scene, window: Window) -> np.ndarray:
    """Render bones, cartilage and tendons inside a semi-transparent limb."""
    picture = render_bones(scene, window, window.near_mm)
    for name, strength in (("muscle", 0.13), ("adipose", 0.06), ("skin", 0.08)):
        shell = [surface for surface in scene.surfaces if surface.name == name]
        hit, normal, _, _ = cast_rays(shell, window, window.near_mm)
        # A shell is more opaque near its rim, where rays cross the shell obliquely.
        opacity = 1 - (1 - strength) ** (1 / np.maximum(-normal[:, 2], 0.1))
        picture = blend(picture, np.float32(material_colour(name)[:3]), window.fill(hit, opacity))
    return downsample(picture)


def render_cut(scene: pssf.Scene, window: Window, depth_mm: float) -> np.ndarray:
    """Render the limb cut at a depth: transparent soft tissue, opaque bones, and the bones behind the cut."""
    picture = render_bones(scene, window, depth_mm)
    for surface in scene.surfaces:
        mask, colour = cut_surface(surface, window, depth_mm), np.float32(material_colour(surface.inside)[:3])
        soft = surface.inside in SOFT_TISSUES
        for box in ndimage.find_objects(mask.astype(np.uint8)):
            cut = mask[box]
            tinted = blend(
                picture[box], 0.4 * BACKGROUND + 0.6 * colour if soft else colour, 0.7 * cut if soft else cut
            )
            picture[box] = blend(tinted, 0.55 * colour, 0.45 * (cut - ndimage.grey_erosion(cut, (3, 3))))
    return downsample(picture)


def render_bones(scene: pssf.Scene, window: Window, depth_mm: float) -> np.ndarray:
    """Render the solids inside the muscle (rows, cols, 3) beyond a depth, lit from the upper left."""
    surfaces = [
        surface for surface in scene.surfaces if surface.outside == "muscle" and surface.inside not in SOFT_TISSUES
    ]
    hit, normal, colour, distance_mm = cast_rays(surfaces, window, depth_mm)
    light, gloss = np.float32([-0.48, 0.62, -0.62]), np.float32([-0.26, 0.34, -0.90])
    level = 0.42 + 0.72 * np.clip(0.3 + 0.7 * normal @ light, 0, None) * (0.6 - 0.4 * normal[:, 2])
    level *= 1 - shade_cavities(window.fill(hit, distance_mm)).ravel()[hit]
    shine = 34 * np.clip(normal @ gloss, 0, 1) ** 30
    lit = np.clip(colour * level[:, None] + shine[:, None], 0, 255)
    background = np.broadcast_to(BACKGROUND, (window.rows, window.cols, 3))
    return blend(background, window.fill(hit, lit), window.fill(hit, np.ones(len(lit), np.float32)))


def cast_rays(
    surfaces: list[pssf.Surface], window: Window, depth_mm: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Find the first hit of each ray: indices of the rays that hit, normals in the window, colours, distances."""
    parts = [
        split_creases(trimesh.Trimesh(surface.solid.points, surface.solid.faces, process=False)) for surface in surfaces
    ]
    starts = np.cumsum([0] + [len(points) for points, _, _ in parts])
    points, normals = (np.vstack([part[k] for part in parts]).astype(np.float32) for k in (0, 1))
    faces = np.vstack([part[2] + start for part, start in zip(parts, starts[:-1], strict=True)])
    colours = np.repeat([material_colour(s.inside)[:3] for s in surfaces], [len(part[2]) for part in parts], axis=0)
    tree = EmbreeScene()
    TriangleMesh(tree, points, faces.astype(np.int32))
    origins = window.make_origins_mm(depth_mm)
    hits = tree.run(origins, np.broadcast_to(np.float32(window.axes[2]), origins.shape).copy(), output=1)
    hit = np.flatnonzero(hits["primID"] >= 0)
    face, u, v = hits["primID"][hit], hits["u"][hit, None], hits["v"][hit, None]
    a, b, c = ((normals @ np.float32(window.axes.T))[faces[face, k]] for k in range(3))
    normal = a * (1 - u - v) + b * u + c * v
    return (
        hit,
        normal / np.linalg.norm(normal, axis=1, keepdims=True),
        np.asarray(colours, np.float32)[face],
        hits["tfar"][hit],
    )


def shade_cavities(distance_mm: np.ndarray) -> np.ndarray:
    """Compute the loss of light (rows, cols) of pixels whose neighbours are closer to the viewer."""
    coarse = distance_mm[::4, ::4]
    is_hit = (coarse > 0).astype(np.float32)
    dark = np.zeros_like(coarse)
    for size in (coarse.shape[0] / 160, coarse.shape[0] / 50):
        weight = np.maximum(ndimage.gaussian_filter(is_hit, size), 1e-6)
        dark += np.clip((coarse - ndimage.gaussian_filter(coarse, size) / weight) / 16.0, 0, 0.24) * is_hit
    rows, cols = distance_mm.shape
    return ndimage.gaussian_filter(np.repeat(np.repeat(dark, 4, axis=0), 4, axis=1)[:rows, :cols], 2.0)


def cut_surface(surface: pssf.Surface, window: Window, depth_mm: float) -> np.ndarray:
    """Compute the cross-section of a surface (rows, cols): 1 inside, 0 outside."""
    rotated = np.ascontiguousarray(surface.solid.points @ window.axes.T)
    # The axes are left-handed, so the vertex order of the faces is reversed to keep their normals outward.
    faces = surface.solid.faces[:, ::-1].astype(np.uint64)
    mask = Image.new("1", (window.cols, window.rows))
    for outline in manifold3d.Manifold(manifold3d.Mesh64(rotated, faces)).slice(depth_mm).to_polygons():
        one = Image.new("1", mask.size)
        ImageDraw.Draw(one).polygon(window.to_pixels(np.asarray(outline)), fill=1)
        mask = ImageChops.logical_xor(mask, one)
    return np.asarray(mask, np.float32)


def blend(below: np.ndarray, colour: np.ndarray, opacity: np.ndarray) -> np.ndarray:
    """Blend a colour over a picture."""
    return below + opacity[..., None] * (colour - below)


def downsample(picture: np.ndarray) -> np.ndarray:
    """Average the rays of each pixel, and convert to 8 bits."""
    rows, cols, _ = picture.shape
    blocks = picture.reshape(rows // SUPERSAMPLING, SUPERSAMPLING, cols // SUPERSAMPLING, SUPERSAMPLING, 3)
    return np.clip(np.rint(blocks.mean(axis=(1, 3))), 0, 255).astype(np.uint8)


if __name__ == "__main__":
    run(Path(__file__).parent)
