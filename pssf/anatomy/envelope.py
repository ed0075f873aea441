"""Envelope: a coarse solid around bones that provably holds them."""

import numpy as np
from manifold3d import Manifold
from scipy import ndimage

from ..core.checks import Array
from ..core.compiled import kernel
from ..data.records import Rows
from ..geometry.mesh import Indices, Mesh
from .solids import loft

_DIRECTIONS, _STEP_MM = 16, 5.0
# Of the rings that round both ends off, beside those next to them.
_END_SHARE = 0.5


def envelope(meshes: list[Mesh], margin_mm: Rows, name: str, reach_mm: float) -> Manifold:
    """A loft of convex rings around closed meshes, at least a margin away from their walls.

    The ring at either end of a band of heights holds all of each face that meets the band, in so many directions; the
    walls between two rings are planes, so that what lies between them is held too, and hollows are filled.

    margin_mm  rows of height and margin, mm
    reach_mm   heights beyond this, up or down, are left out
    """
    low = max(-reach_mm, min(mesh.vertices[:, 2].min() for mesh in meshes))
    high = min(reach_mm, max(mesh.vertices[:, 2].max() for mesh in meshes))
    levels = np.linspace(low, high, max(2, int(np.ceil((high - low) / _STEP_MM))) + 1)
    angle = np.linspace(0.0, 2 * np.pi, _DIRECTIONS, endpoint=False)
    normals = np.column_stack((np.cos(angle), np.sin(angle)))
    supports = np.max([_supports(mesh, levels, normals) for mesh in meshes], axis=0)
    empty = ~np.isfinite(supports[:, 0])
    (nearest,) = ndimage.distance_transform_edt(empty, return_distances=False, return_indices=True)
    supports = supports[nearest]
    rows = np.array(sorted(margin_mm))
    margins = np.interp(levels, rows[:, 0], rows[:, 1])
    rings = np.maximum(np.vstack((supports[:1], supports)), np.vstack((supports, supports[-1:])))
    rings = rings + margins[:, None]
    return loft(_closed(_corners(rings, angle, levels), margins), name)


def _closed(rings: Array, margins: Array) -> Array:
    """Rings (levels, directions, 3) with a smaller one beyond either end, as far from it as the margin there."""
    ends = []
    for ring, up in ((rings[0], -margins[0]), (rings[-1], margins[-1])):
        middle = ring.mean(axis=0)
        ends.append(middle + _END_SHARE * (ring - middle) + [0.0, 0.0, up])
    return np.concatenate((ends[0][None], rings, ends[1][None]))


def _supports(mesh: Mesh, levels: Array, normals: Array) -> Array:
    """(bands, directions)  how far faces that meet a band reach in each direction, -inf where there is none"""
    heights = mesh.vertices[mesh.faces, 2]
    lowest, highest = heights.min(axis=1), heights.max(axis=1)
    # A face that ends on a level is of the bands on both sides of it.
    first = np.searchsorted(levels, lowest, side="left") - 1
    last = np.searchsorted(levels, highest, side="right") - 1
    reach = np.ascontiguousarray(mesh.vertices[:, :2] @ normals.T)
    supports = np.full((len(levels) - 1, len(normals)), -np.inf)
    _raise(supports, mesh.faces, reach, np.maximum(first, 0), np.minimum(last, len(supports) - 1))
    return supports


@kernel()
def _raise(supports: Array, faces: Indices, reach: Array, first: Indices, last: Indices) -> None:
    """Raise supports of bands (n, directions) to those of faces (m, 3), whose vertices reach so far, by their bands."""
    for k in range(len(faces)):
        if first[k] > last[k]:
            continue
        for way in range(supports.shape[1]):
            far = max(reach[faces[k, 0], way], reach[faces[k, 1], way], reach[faces[k, 2], way])
            for band in range(first[k], last[k] + 1):
                supports[band, way] = max(supports[band, way], far)


def _corners(supports: Array, angle: Array, levels: Array) -> Array:
    """(levels, directions, 3)  where each ring's line meets the next"""
    step = angle[1] - angle[0]
    after = np.roll(supports, -1, axis=1)
    along = (after - supports * np.cos(step)) / np.sin(step)
    x = supports * np.cos(angle) - along * np.sin(angle)
    y = supports * np.sin(angle) + along * np.cos(angle)
    return np.stack((x, y, np.broadcast_to(levels[:, None], x.shape)), axis=-1)
