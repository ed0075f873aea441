"""Plot the bones of the default knee, coloured by the distance from the mean patient bone."""

import io
from collections.abc import Mapping

import numpy as np
from matplotlib.cm import ScalarMappable
from matplotlib.collections import PolyCollection
from matplotlib.colors import Normalize
from matplotlib.figure import Figure

from ...core.checks import Array
from ...geometry.mesh import Mesh

# Upward direction and direction towards the viewer for each view; axes are x medial, y posterior, z proximal.
_VIEWS = {
    "anterior view": ((0, 0, 1), (0, -1, 0)),
    "posterior view": ((0, 0, 1), (0, 1, 0)),
    "medial view": ((0, 0, 1), (1, 0, 0)),
}
_END_VIEWS = {"femur": ((0, -1, 0), (0, 0, -1))}
_UPPER_END_VIEW = ((0, -1, 0), (0, 0, 1))


def plot_bone_distances(bones: Mapping[str, tuple[Mesh, Array]], limit_mm: float) -> bytes:
    """Plot every bone in four views, coloured by the distance from the mean patient bone.

    Parameters
    ----------
    bones : mapping of str to tuple of (Mesh, (n,) array)
        Mesh in mm and signed vertex distances from the mean patient bone in mm (positive outside), keyed by bone name.
    limit_mm : float
        Distance at both ends of the colour scale, in mm.

    Returns
    -------
    bytes
        PNG image.
    """
    figure = Figure(figsize=(14, 3.7 * len(bones)), layout="constrained")
    axes = figure.subplots(len(bones), 4, squeeze=False)
    colours = ScalarMappable(Normalize(-limit_mm, limit_mm), "RdBu_r")
    for row, (name, (mesh, off_mm)) in zip(axes, bones.items(), strict=True):
        views = _VIEWS | {
            "distal view" if name in _END_VIEWS else "proximal view": _END_VIEWS.get(name, _UPPER_END_VIEW)
        }
        for axis, (title, (up, eye)) in zip(row, views.items(), strict=True):
            axis.add_collection(
                make_visible_triangles(mesh, off_mm, np.array([np.cross(up, eye), up, eye], np.float64), colours)
            )
            axis.autoscale()
            axis.set(aspect="equal", xticks=[], yticks=[], title=f"{name}, {title}")
            axis.set_frame_on(False)
    figure.colorbar(colours, ax=axes, shrink=0.6, label="distance from the mean patient bone (mm)")
    stream = io.BytesIO()
    figure.savefig(stream, format="png", dpi=90, metadata={"Software": None})
    return stream.getvalue()


def make_visible_triangles(mesh: Mesh, off_mm: Array, view_axes: Array, colours: ScalarMappable) -> PolyCollection:
    """Collect the triangles that face the viewer, sorted from far to near and shaded by orientation.

    Parameters
    ----------
    mesh : Mesh
        Mesh to plot, in mm.
    off_mm : (n,) array
        Distance of each vertex in mm, displayed as colour.
    view_axes : (3, 3) array, unit vectors
        Directions to the right, upwards and towards the viewer, as rows.
    colours : matplotlib.cm.ScalarMappable
        Colour scale for the distances.

    Returns
    -------
    matplotlib.collections.PolyCollection
        Triangles in view coordinates, in mm.
    """
    corners = (mesh.vertices @ view_axes.T)[mesh.faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    facing = normals[:, 2] / np.maximum(np.linalg.norm(normals, axis=1), 1e-30)
    order = np.argsort(corners[:, :, 2].mean(axis=1), kind="stable")
    order = order[facing[order] > 0]
    shown = colours.to_rgba(off_mm[mesh.faces[order]].mean(axis=1))
    shown[:, :3] *= (0.55 + 0.45 * facing[order])[:, None]
    return PolyCollection(corners[order][:, :, :2], facecolors=shown, edgecolors=shown, linewidths=0.2)
