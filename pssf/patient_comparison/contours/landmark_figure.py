"""Figure of mean contours of simulated knees and of patients, with ellipses of one standard deviation."""

import io

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Ellipse

from ...core.checks import Array

# Colours of patients and of simulated knees, distinguishable with any colour vision (Okabe and Ito 2008).
_PEOPLE = "#D55E00"
_DRAWN = "#0072B2"
# Number of tibial landmarks, which come first.
_TIBIA_LANDMARKS = 9


def plot_contours(panels: list[tuple[int, tuple[Array, Array], tuple[Array, Array]]]) -> bytes:
    """Plot one panel per grade with mean contours of simulated knees and of patients.

    Parameters
    ----------
    panels : list of tuple
        Grade, and means and standard deviations, (16, 2) each, of simulated knees and of patients, as fractions of the
        plateau width.

    Returns
    -------
    bytes
        PNG image.
    """
    figure = Figure(figsize=(6.2 * len(panels), 3.2), layout="constrained")
    for axis, (grade, drawn, people) in zip(np.atleast_1d(figure.subplots(1, len(panels))), panels, strict=True):
        for name, colour, (mean, sd) in (("patients", _PEOPLE, people), ("simulated knees", _DRAWN, drawn)):
            _plot_contour(axis, mean, sd, name, colour)
        axis.set(
            title=f"Grade {grade}",
            ylim=(-0.06, 0.36),
            xlabel="lateral to medial (fraction of plateau width)",
            aspect="equal",
        )
        axis.legend(frameon=False, loc="upper right", fontsize=8)
    stream = io.BytesIO()
    figure.savefig(stream, format="png", dpi=110, metadata={"Software": None})
    return stream.getvalue()


def _plot_contour(axis: Axes, mean: Array, sd: Array, name: str, colour: str) -> None:
    """Plot lines through the mean landmarks of tibia and femur, and an ellipse at each landmark."""
    for part, label in ((slice(None, _TIBIA_LANDMARKS), name), (slice(_TIBIA_LANDMARKS, None), None)):
        axis.plot(*mean[part].T, "-o", color=colour, markersize=3, linewidth=1.2, label=label)
    for place, spread in zip(mean, sd, strict=True):
        axis.add_patch(Ellipse(tuple(place), *(2 * spread), color=colour, alpha=0.25, linewidth=0))
