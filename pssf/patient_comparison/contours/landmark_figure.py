"""Plot the mean contours of simulated knees and patients, with one-SD ellipses."""

import io

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Ellipse

from ...core.checks import Array

# Colours for patients and simulated knees, which colour-blind readers can distinguish (Okabe and Ito 2008).
_PEOPLE = "#D55E00"
_DRAWN = "#0072B2"
# Number of panels per row, figure width in inches, and panel height in inches. The width of 8 inches gives the nominal
# text size on a page that is 800 pixels wide.
_COLUMNS, _WIDTH_IN, _PANEL_HEIGHT_IN = 2, 8.0, 1.85
# Size of all text, in points.
_FONT_PT = 10
# Number of tibial landmarks, which precede the femoral landmarks.
_TIBIA_LANDMARKS = 9


def plot_contours(panels: list[tuple[int, tuple[Array, Array], tuple[Array, Array]]]) -> bytes:
    """Plot the mean contours of simulated knees and patients, with one panel per grade.

    Parameters
    ----------
    panels : list of tuple
        Tuples of grade, simulated landmark mean and SD, and patient landmark mean and SD. Arrays have shape (16, 2), in
        fractions of the plateau width.

    Returns
    -------
    bytes
        PNG image.
    """
    rows = -(-len(panels) // _COLUMNS)
    figure = Figure(figsize=(_WIDTH_IN, _PANEL_HEIGHT_IN * rows + 0.6), layout="constrained")
    axes = figure.subplots(rows, _COLUMNS, squeeze=False, sharex=True, sharey=True).ravel()
    for axis, (grade, drawn, people) in zip(axes, panels, strict=False):
        for name, colour, (mean, sd) in (("patients", _PEOPLE, people), ("simulated knees", _DRAWN, drawn)):
            _plot_contour(axis, mean, sd, name, colour)
        axis.set(ylim=(-0.06, 0.36), aspect="equal")
        axis.set_title(f"KL {grade}", fontsize=_FONT_PT)
        axis.tick_params(labelsize=_FONT_PT, labelbottom=True)
    for axis in axes[len(panels) :]:
        axis.axis("off")
    figure.supxlabel("lateral to medial (fraction of plateau width)", fontsize=_FONT_PT)
    figure.supylabel("distal to proximal (fraction of plateau width)", fontsize=_FONT_PT)
    figure.legend(
        *axes[0].get_legend_handles_labels(), loc="outside upper center", ncols=2, frameon=False, fontsize=_FONT_PT
    )
    stream = io.BytesIO()
    figure.savefig(stream, format="png", dpi=200, metadata={"Software": None})
    return stream.getvalue()


def _plot_contour(axis: Axes, mean: Array, sd: Array, name: str, colour: str) -> None:
    """Plot lines through the mean landmarks of tibia and femur, and a one-SD ellipse at each landmark."""
    for part, label in ((slice(None, _TIBIA_LANDMARKS), name), (slice(_TIBIA_LANDMARKS, None), None)):
        axis.plot(*mean[part].T, "-o", color=colour, markersize=3, linewidth=1.2, label=label)
    for place, spread in zip(mean, sd, strict=True):
        axis.add_patch(Ellipse(tuple(place), *(2 * spread), color=colour, alpha=0.25, linewidth=0))
