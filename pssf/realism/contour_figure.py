"""Mean contours of drawn knees and of people with ellipses of one standard deviation, as PNG."""

import io

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Ellipse

from ..core.checks import Array

# Okabe & Ito 2008: told apart with any colour vision.
_PEOPLE, _DRAWN = "#D55E00", "#0072B2"
_TIBIAL = 9


def draw(panels: list[tuple[int, tuple[Array, Array], tuple[Array, Array]]]) -> bytes:
    """PNG of one panel a grade.

    panels  the grade, then means and SDs (16, 2) of drawn knees and of people, shares of the plateau's width
    """
    figure = Figure(figsize=(6.2 * len(panels), 3.2), layout="constrained")
    for axis, (grade, drawn, people) in zip(np.atleast_1d(figure.subplots(1, len(panels))), panels, strict=True):
        for name, colour, (mean, sd) in (("people", _PEOPLE, people), ("drawn knees", _DRAWN, drawn)):
            _contour(axis, mean, sd, name, colour)
        axis.set(
            title=f"Grade {grade}",
            ylim=(-0.06, 0.36),
            xlabel="lateral to medial (share of plateau width)",
            aspect="equal",
        )
        axis.legend(frameon=False, loc="upper right", fontsize=8)
    stream = io.BytesIO()
    figure.savefig(stream, format="png", dpi=110, metadata={"Software": None})
    return stream.getvalue()


def _contour(axis: Axes, mean: Array, sd: Array, name: str, colour: str) -> None:
    """Lines through the mean landmarks of tibia and femur, and their ellipses."""
    for part, label in ((slice(None, _TIBIAL), name), (slice(_TIBIAL, None), None)):
        axis.plot(*mean[part].T, "-o", color=colour, markersize=3, linewidth=1.2, label=label)
    for place, spread in zip(mean, sd, strict=True):
        axis.add_patch(Ellipse(tuple(place), *(2 * spread), color=colour, alpha=0.25, linewidth=0))
