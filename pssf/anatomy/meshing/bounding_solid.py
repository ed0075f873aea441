"""Bounding solids: coarse convex lofts that enclose bones with a margin."""

import numpy as np
from manifold3d import Manifold
from scipy import ndimage

from ...core.checks import Array
from ...core.numba_kernel import kernel
from ...data.table_records import Rows
from ...geometry.mesh import Indices, Mesh
from .solids import loft

# Number of directions in which the extent of a bone is measured. Each ring has the same number of corners.
_DIRECTIONS = 16
# Largest height of a band between two rings, mm.
_STEP_MM = 5.0
# Size of the ring that closes either end, as a fraction of the neighbouring ring.
_END_FRACTION = 0.5


def build_envelope(meshes: list[Mesh], margin_mm: Rows, name: str, max_height_mm: float) -> Manifold:
    """Build a loft of convex rings that encloses closed meshes with a margin.

    Parameters
    ----------
    meshes : list of Mesh
        Closed surfaces to enclose, with vertices in mm and z along the shafts.
    margin_mm : rows of (height, margin)
        Smallest distance between the envelope and the meshes, in mm, at heights in mm. Values between two heights are
        interpolated.
    name : str
        Name of the solid in error messages.
    max_height_mm : float
        Largest distance from z = 0 along z, in mm; parts of the meshes beyond this distance are ignored.

    Returns
    -------
    Manifold
        Closed solid around the meshes.

    Raises
    ------
    InputError
        If the loft is not a valid solid.

    Notes
    -----
    The heights are divided into bands of at most 5 mm. Every face that intersects a band is inside the rings at both
    ends of this band. The walls between two rings are planar, so the envelope also encloses the face between the rings.
    Concavities are filled.
    """
    low = max(-max_height_mm, min(mesh.vertices[:, 2].min() for mesh in meshes))
    high = min(max_height_mm, max(mesh.vertices[:, 2].max() for mesh in meshes))
    levels = np.linspace(low, high, max(2, int(np.ceil((high - low) / _STEP_MM))) + 1)
    angle = np.linspace(0.0, 2 * np.pi, _DIRECTIONS, endpoint=False)
    normals = np.column_stack((np.cos(angle), np.sin(angle)))
    supports = np.max([_compute_supports(mesh, levels, normals) for mesh in meshes], axis=0)
    empty = ~np.isfinite(supports[:, 0])
    (nearest,) = ndimage.distance_transform_edt(empty, return_distances=False, return_indices=True)
    supports = supports[nearest]
    rows = np.array(sorted(margin_mm))
    margins = np.interp(levels, rows[:, 0], rows[:, 1])
    rings = np.maximum(np.vstack((supports[:1], supports)), np.vstack((supports, supports[-1:])))
    rings = rings + margins[:, None]
    return loft(_close_ends(_compute_corners(rings, angle, levels), margins), name)


def _close_ends(rings: Array, margins: Array) -> Array:
    """Add a smaller ring beyond the first and the last ring of (levels, directions, 3), at a distance of one margin."""
    ends = []
    for ring, up in ((rings[0], -margins[0]), (rings[-1], margins[-1])):
        middle = ring.mean(axis=0)
        ends.append(middle + _END_FRACTION * (ring - middle) + [0.0, 0.0, up])
    return np.concatenate((ends[0][None], rings, ends[1][None]))


def _compute_supports(mesh: Mesh, levels: Array, normals: Array) -> Array:
    """Compute the extent of the faces of each band in each direction, in mm.

    The result (bands, directions) is -inf where a band contains no face.
    """
    heights = mesh.vertices[mesh.faces, 2]
    lowest, highest = heights.min(axis=1), heights.max(axis=1)
    # A face that ends exactly at a level belongs to the bands above and below this level.
    first = np.searchsorted(levels, lowest, side="left") - 1
    last = np.searchsorted(levels, highest, side="right") - 1
    reach = np.ascontiguousarray(mesh.vertices[:, :2] @ normals.T)
    supports = np.full((len(levels) - 1, len(normals)), -np.inf)
    _raise_supports(supports, mesh.faces, reach, np.maximum(first, 0), np.minimum(last, len(supports) - 1))
    return supports


@kernel()
def _raise_supports(supports: Array, faces: Indices, reach: Array, first: Indices, last: Indices) -> None:
    """Increase the extents (bands, directions) to include each face in all bands that it intersects.

    `faces` (m, 3) are vertex numbers. `reach` (vertices, directions) is the extent of each vertex, in mm. `first` and
    `last` (m,) are the lowest and the highest band of each face.
    """
    for k in range(len(faces)):
        if first[k] > last[k]:
            continue
        for way in range(supports.shape[1]):
            far = max(reach[faces[k, 0], way], reach[faces[k, 1], way], reach[faces[k, 2], way])
            for band in range(first[k], last[k] + 1):
                supports[band, way] = max(supports[band, way], far)


def _compute_corners(supports: Array, angle: Array, levels: Array) -> Array:
    """Compute the ring corners (levels, directions, 3), where neighbouring support lines intersect, mm."""
    step = angle[1] - angle[0]
    after = np.roll(supports, -1, axis=1)
    along = (after - supports * np.cos(step)) / np.sin(step)
    x = supports * np.cos(angle) - along * np.sin(angle)
    y = supports * np.sin(angle) + along * np.cos(angle)
    return np.stack((x, y, np.broadcast_to(levels[:, None], x.shape)), axis=-1)
