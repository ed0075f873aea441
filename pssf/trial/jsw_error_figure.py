"""Figure of the error of the joint space against beam angle and positioning."""

import io

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from .jsw_error import ISO_LINE_MM

# Label of the second axis.
_LABELS = {
    "rotation": "rotation of the leg, degrees",
    "flexion": "flexion, degrees",
    "distance": "distance from source to joint, mm",
    "centre_x": "lateral shift, mm",
    "centre_z": "vertical shift, mm",
}


def draw_jsw_errors(errors: pd.DataFrame, summary: pd.DataFrame) -> bytes:
    """Draw the root mean square error over the knees as a map, with the line of a small error.

    Parameters
    ----------
    errors : DataFrame
        Errors from `measure_jsw_errors`.
    summary : DataFrame
        Summary from `measure_jsw_errors`.

    Returns
    -------
    bytes
        Content of a PNG file.
    """
    squares = errors.assign(square=errors["error_mm"] ** 2)
    wide = np.sqrt(squares.pivot_table(index="value", columns="beam_angle_deg", values="square", aggfunc="mean"))
    figure = Figure(figsize=(7.5, 5), layout="constrained")
    panel = figure.subplots()
    colours = panel.pcolormesh(wide.columns, wide.index, wide.to_numpy(), cmap="viridis", shading="nearest", vmin=0)
    figure.colorbar(colours, label="error of the minimum medial JSW, RMS, mm")
    if min(wide.shape) > 1 and wide.to_numpy().min() < ISO_LINE_MM < wide.to_numpy().max():
        lines = panel.contour(wide.columns, wide.index, wide.to_numpy(), levels=[ISO_LINE_MM], colors="white")
        panel.clabel(lines, fmt=f"{ISO_LINE_MM:g} mm")
    for angle in summary["best_angle_deg"]:
        panel.axvline(angle, color="#D55E00", linewidth=0.8, alpha=max(0.15, 1 / len(summary)))
    title = "one knee" if len(summary) == 1 else f"{len(summary)} knees"
    axis = str(errors["axis"].iloc[0])
    panel.set(xlabel="beam angle, degrees (orange: along the medial plateau)", ylabel=_LABELS[axis], title=title)
    stream = io.BytesIO()
    figure.savefig(stream, format="png", dpi=110, metadata={"Software": None})
    return stream.getvalue()
