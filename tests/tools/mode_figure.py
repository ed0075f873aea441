"""Figure of shape modes: the bones of a knee at -2, 0 and +2 standard deviations."""

import io
from collections.abc import Sequence

import numpy as np
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure

from pssf.core.checks import Array
from pssf.geometry.mesh import Mesh
from pssf.patient_comparison.bones.bone_distance_figure import make_visible_triangles

_FRONT = np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])
_MEDIAL = np.array([[0.0, 1, 0], [0, 0, 1], [1, 0, 0]])
_BELOW = np.array([[1.0, 0, 0], [0, -1, 0], [0, 0, -1]])
_ABOVE = np.array([[-1.0, 0, 0], [0, -1, 0], [0, 0, 1]])
# Bone, view and offset in the figure (mm) of each panel; the rows of a view are the right, up and viewer directions.
_PANELS = (
    ("femur", _FRONT, (0.0, 12.0)), ("tibia", _FRONT, (0.0, -8.0)),
    ("femur", _MEDIAL, (100.0, 12.0)), ("tibia", _MEDIAL, (100.0, -8.0)),
    ("femur", _BELOW, (200.0, 55.0)), ("tibia", _ABOVE, (200.0, -45.0)),
    ("patella", _FRONT, (285.0, 20.0)), ("patella", _BELOW, (285.0, -95.0)),
)  # fmt: skip
# Displacement at the ends of the colour scale, in mm.
_COLOUR_LIMIT_MM = 3.0


def plot_modes(modes: Sequence[tuple[str, Sequence[tuple[dict[str, Mesh], dict[str, Array]]]]]) -> bytes:
    """Plot one row per shape mode.

    Parameters
    ----------
    modes : sequence of tuple
        Title of each mode, and for each column the bones and the outward displacements (n,) of their vertices, in mm.

    Returns
    -------
    bytes
        PNG image.
    """
    figure = Figure(figsize=(20, 4.4 * len(modes)), layout="constrained")
    axes = figure.subplots(len(modes), len(modes[0][1]), squeeze=False)
    colours = ScalarMappable(Normalize(-_COLOUR_LIMIT_MM, _COLOUR_LIMIT_MM), "RdBu_r")
    for row, (title, columns) in zip(axes, modes, strict=True):
        for axis, (bones, off_mm) in zip(row, columns, strict=True):
            for name, view, shift in _PANELS:
                shown = make_visible_triangles(bones[name], off_mm[name], view, colours)
                shown.set_transform(_make_translation(shift) + axis.transData)
                axis.add_collection(shown, autolim=False)
            axis.set(xlim=(-50, 325), ylim=(-110, 120), aspect="equal", xticks=[], yticks=[])
            axis.set_frame_on(False)
        row[len(row) // 2].set_title(title)
    stream = io.BytesIO()
    figure.savefig(stream, format="png", dpi=70, metadata={"Software": None})
    return stream.getvalue()


def _make_translation(shift: tuple[float, float]):  # type: ignore[no-untyped-def]
    """Make a translation in view coordinates."""
    from matplotlib.transforms import Affine2D

    return Affine2D().translate(*shift)
