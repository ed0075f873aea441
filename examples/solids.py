"""The solids of a knee, from the front and from the side: bones in a half-transparent limb, and cut open."""

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

# Directions in which a picture runs right and up, and in which the eye looks; all lines of sight are parallel.
FRONT = np.array([[1.0, 0, 0], [0, 0, 1.0], [0, 1.0, 0]])
SIDE = np.array([[0, 1.0, 0], [0, 0, 1.0], [-1.0, 0, 0]])
PAPER = np.float32([252, 252, 253])
SOFT = ("skin", "adipose", "muscle")
FINE = 2


def run(out: Path, pixels: int = 2048) -> list[Path]:
    """Write the picture; it is 3/8 of `pixels` high."""
    scene = pssf.build(pssf.Knee(osteophytes=(pssf.Osteophyte(site="medial_tibia", size_mm=2.0),))).scene
    panels = []
    for axes, depth_mm in ((FRONT, 3.0), (SIDE, 7.0)):
        window = Window(scene, axes, rows=max(8, pixels * 3 // 8))
        panels += [in_limb(scene, window), cut_open(scene, window, depth_mm)]
    height = window.rows // FINE
    gap = np.tile(PAPER.astype(np.uint8), (height, height // 24, 1))
    return [write_image_row([np.hstack([part for panel in panels for part in (gap, panel)][1:])], out / "solids.png")]


class Window:
    """The pixels of one view: rows x cols places in planes across it, FINE of them a side to a pixel."""

    def __init__(self, scene: pssf.Scene, axes: np.ndarray, rows: int) -> None:
        corners = scene.bounds_mm @ axes.T
        (left, low, near), (right, high, _) = np.sort(corners, axis=0)
        self.axes, self.rows, self.near_mm = axes, rows * FINE, near - 1.0
        self.step_mm = 1.02 * (high - low) / self.rows
        self.cols = int(1.04 * (right - left) / self.step_mm) // FINE * FINE
        self.left, self.top = (left + right - self.cols * self.step_mm) / 2, (low + high + self.rows * self.step_mm) / 2

    def places_mm(self, depth_mm: float) -> np.ndarray:
        """(rows * cols, 3)  the pixels, so far behind the origin"""
        across = self.left + self.step_mm * (np.arange(self.cols) + 0.5)
        up = self.top - self.step_mm * (np.arange(self.rows) + 0.5)
        right, above, ahead = self.axes.astype(np.float32)
        rows = up[:, None].astype(np.float32) * above + np.float32(depth_mm) * ahead
        return (rows[:, None] + across[:, None].astype(np.float32) * right).reshape(-1, 3)

    def px(self, points: np.ndarray) -> list[tuple[float, float]]:
        """Where points (n, 2), in mm along the axes, are in the picture."""
        return [(x, y) for x, y in (points - [self.left, self.top]) / [self.step_mm, -self.step_mm] - 0.5]

    def filled(self, hit: np.ndarray, values: np.ndarray) -> np.ndarray:
        """(rows, cols, ...)  values where something was hit, and 0 elsewhere"""
        whole = np.zeros((self.rows * self.cols, *values.shape[1:]), np.float32)
        whole[hit] = values
        return whole.reshape(self.rows, self.cols, *values.shape[1:])


def in_limb(scene: pssf.Scene, window: Window) -> np.ndarray:
    """Bones, cartilage and tendon inside a half-transparent limb."""
    picture = bones(scene, window, window.near_mm)
    for name, strength in (("muscle", 0.13), ("adipose", 0.06), ("skin", 0.08)):
        shell = [surface for surface in scene.surfaces if surface.name == name]
        hit, normal, _, _ = cast(shell, window, window.near_mm)
        # A shell is looked through at a slant near its rim, where it lets less through.
        opacity = 1 - (1 - strength) ** (1 / np.maximum(-normal[:, 2], 0.1))
        picture = over(picture, np.float32(material_colour(name)[:3]), window.filled(hit, opacity))
    return reduced(picture)


def cut_open(scene: pssf.Scene, window: Window, depth_mm: float) -> np.ndarray:
    """The limb cut through at a depth: soft tissue as a tint, bones solid, and what stands behind the cut."""
    picture = bones(scene, window, depth_mm)
    for surface in scene.surfaces:
        mask, colour = section(surface, window, depth_mm), np.float32(material_colour(surface.inside)[:3])
        soft = surface.inside in SOFT
        for box in ndimage.find_objects(mask.astype(np.uint8)):
            cut = mask[box]
            tinted = over(picture[box], 0.4 * PAPER + 0.6 * colour if soft else colour, 0.7 * cut if soft else cut)
            picture[box] = over(tinted, 0.55 * colour, 0.45 * (cut - ndimage.grey_erosion(cut, (3, 3))))
    return reduced(picture)


def bones(scene: pssf.Scene, window: Window, depth_mm: float) -> np.ndarray:
    """(rows, cols, 3)  on paper, from a depth on: what stands out against muscle, lit from the upper left"""
    surfaces = [surface for surface in scene.surfaces if surface.outside == "muscle" and surface.inside not in SOFT]
    hit, normal, colour, far_mm = cast(surfaces, window, depth_mm)
    light, gloss = np.float32([-0.48, 0.62, -0.62]), np.float32([-0.26, 0.34, -0.90])
    level = 0.42 + 0.72 * np.clip(0.3 + 0.7 * normal @ light, 0, None) * (0.6 - 0.4 * normal[:, 2])
    level *= 1 - shadow(window.filled(hit, far_mm)).ravel()[hit]
    shine = 34 * np.clip(normal @ gloss, 0, 1) ** 30
    lit = np.clip(colour * level[:, None] + shine[:, None], 0, 255)
    paper = np.broadcast_to(PAPER, (window.rows, window.cols, 3))
    return over(paper, window.filled(hit, lit), window.filled(hit, np.ones(len(lit), np.float32)))


def cast(
    surfaces: list[pssf.Surface], window: Window, depth_mm: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """What is met first from a depth on: at which pixels, normals along the axes of the window, colours, how far on."""
    parts = [
        split_creases(trimesh.Trimesh(surface.solid.points, surface.solid.faces, process=False)) for surface in surfaces
    ]
    starts = np.cumsum([0] + [len(points) for points, _, _ in parts])
    points, normals = (np.vstack([part[k] for part in parts]).astype(np.float32) for k in (0, 1))
    faces = np.vstack([part[2] + start for part, start in zip(parts, starts[:-1], strict=True)])
    colours = np.repeat([material_colour(s.inside)[:3] for s in surfaces], [len(part[2]) for part in parts], axis=0)
    tree = EmbreeScene()
    TriangleMesh(tree, points, faces.astype(np.int32))
    origins = window.places_mm(depth_mm)
    met = tree.run(origins, np.broadcast_to(np.float32(window.axes[2]), origins.shape).copy(), output=1)
    hit = np.flatnonzero(met["primID"] >= 0)
    face, u, v = met["primID"][hit], met["u"][hit, None], met["v"][hit, None]
    a, b, c = ((normals @ np.float32(window.axes.T))[faces[face, k]] for k in range(3))
    normal = a * (1 - u - v) + b * u + c * v
    return hit, normal / np.linalg.norm(normal, axis=1, keepdims=True), np.float32(colours)[face], met["tfar"][hit]


def shadow(far_mm: np.ndarray) -> np.ndarray:
    """(rows, cols)  where the surroundings of a pixel are nearer to the eye than it is, less light comes in"""
    coarse = far_mm[::4, ::4]
    known = (coarse > 0).astype(np.float32)
    dark = np.zeros_like(coarse)
    for size in (coarse.shape[0] / 160, coarse.shape[0] / 50):
        weight = np.maximum(ndimage.gaussian_filter(known, size), 1e-6)
        dark += np.clip((coarse - ndimage.gaussian_filter(coarse, size) / weight) / 16.0, 0, 0.24) * known
    rows, cols = far_mm.shape
    return ndimage.gaussian_filter(np.repeat(np.repeat(dark, 4, axis=0), 4, axis=1)[:rows, :cols], 2.0)


def section(surface: pssf.Surface, window: Window, depth_mm: float) -> np.ndarray:
    """(rows, cols)  1 where the cut passes through what a surface encloses"""
    turned = np.ascontiguousarray(surface.solid.points @ window.axes.T)
    # The axes are left-handed: faces would be seen from within.
    faces = surface.solid.faces[:, ::-1].astype(np.uint64)
    mask = Image.new("1", (window.cols, window.rows))
    for outline in manifold3d.Manifold(manifold3d.Mesh64(turned, faces)).slice(depth_mm).to_polygons():
        one = Image.new("1", mask.size)
        ImageDraw.Draw(one).polygon(window.px(np.asarray(outline)), fill=1)
        mask = ImageChops.logical_xor(mask, one)
    return np.asarray(mask, np.float32)


def over(below: np.ndarray, colour: np.ndarray, opacity: np.ndarray) -> np.ndarray:
    """A colour laid over a picture."""
    return below + opacity[..., None] * (colour - below)


def reduced(picture: np.ndarray) -> np.ndarray:
    """8 bits, each pixel the mean of FINE x FINE."""
    rows, cols, _ = picture.shape
    blocks = picture.reshape(rows // FINE, FINE, cols // FINE, FINE, 3)
    return np.clip(np.rint(blocks.mean(axis=(1, 3))), 0, 255).astype(np.uint8)


if __name__ == "__main__":
    run(Path(__file__).parent)
