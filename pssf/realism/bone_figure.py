"""Built mean bones with their distance from the given mean as colour, as PNG."""

import io
from collections.abc import Mapping

import numpy as np
from matplotlib.cm import ScalarMappable
from matplotlib.collections import PolyCollection
from matplotlib.colors import Normalize
from matplotlib.figure import Figure

from ..core.checks import Array
from ..geometry.mesh import Mesh

# Title -> which way is up, and from where the eye looks; x medial, y posterior, z proximal.
_VIEWS = {
    "from the front": ((0, 0, 1), (0, -1, 0)),
    "from behind": ((0, 0, 1), (0, 1, 0)),
    "medial side": ((0, 0, 1), (1, 0, 0)),
}
_END = {"femur": ((0, -1, 0), (0, 0, -1))}
_UPPER_END = ((0, -1, 0), (0, 0, 1))


def draw(bones: Mapping[str, tuple[Mesh, Array]], most_mm: float) -> bytes:
    """PNG of bones from four sides.

    bones    name -> mesh, mm, and the distance of its vertices (n,), mm; positive stands out
    most_mm  where the colours end
    """
    figure = Figure(figsize=(14, 3.7 * len(bones)), layout="constrained")
    axes = figure.subplots(len(bones), 4, squeeze=False)
    colours = ScalarMappable(Normalize(-most_mm, most_mm), "RdBu_r")
    for row, (name, (mesh, off_mm)) in zip(axes, bones.items(), strict=True):
        views = _VIEWS | {"from below" if name in _END else "from above": _END.get(name, _UPPER_END)}
        for axis, (title, (up, eye)) in zip(row, views.items(), strict=True):
            axis.add_collection(seen(mesh, off_mm, np.array([np.cross(up, eye), up, eye], np.float64), colours))
            axis.autoscale()
            axis.set(aspect="equal", xticks=[], yticks=[], title=f"{name}, {title}")
            axis.set_frame_on(False)
    figure.colorbar(colours, ax=axes, shrink=0.6, label="built bone beyond the given mean (mm)")
    stream = io.BytesIO()
    figure.savefig(stream, format="png", dpi=90, metadata={"Software": None})
    return stream.getvalue()


def seen(mesh: Mesh, off_mm: Array, axes: Array, colours: ScalarMappable) -> PolyCollection:
    """The triangles of a mesh that face the eye, far ones first, a little darker where they turn away.

    off_mm  (n,)    of its vertices, shown as colour
    axes    (3, 3)  unit vectors to the right, up, and towards the eye
    """
    corners = (mesh.vertices @ axes.T)[mesh.faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    facing = normals[:, 2] / np.maximum(np.linalg.norm(normals, axis=1), 1e-30)
    order = np.argsort(corners[:, :, 2].mean(axis=1), kind="stable")
    order = order[facing[order] > 0]
    shown = colours.to_rgba(off_mm[mesh.faces[order]].mean(axis=1))
    shown[:, :3] *= (0.55 + 0.45 * facing[order])[:, None]
    return PolyCollection(corners[order][:, :, :2], facecolors=shown, edgecolors=shown, linewidths=0.2)
