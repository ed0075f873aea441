"""Plot the measured and model image quality curves of a protocol."""

import io

import numpy as np
from matplotlib.figure import Figure

from .quality_measurement import QualityResult


def render_quality_png(quality: QualityResult, protocol_name: str) -> bytes:
    """Render MTF, NNPS, DQE, photon transfer and the scatter-to-primary ratio as one figure.

    Parameters
    ----------
    quality : QualityResult
        Measured image quality of the protocol.
    protocol_name : str
        Protocol name for the figure title.

    Returns
    -------
    bytes
        Content of a PNG file.
    """
    figure = Figure(figsize=(13, 7), layout="constrained")
    axes = figure.subplots(2, 3)
    curves = (("MTF", quality.mtf), ("NNPS (mm²)", quality.nnps), ("DQE, RQA5 beam", quality.dqe))
    for axis, (label, curve) in zip((axes[0, 0], axes[0, 1], axes[1, 0]), curves, strict=True):
        axis.plot(curve.frequency_per_mm, curve.measured, ".", markersize=3, label="measured")
        axis.plot(curve.frequency_per_mm, curve.model, "-", linewidth=1, label="model")
        axis.set(xlabel="cycles/mm", ylabel=label)
        axis.legend(frameon=False)
    axes[0, 1].set_yscale("log")
    for axis in (axes[0, 0], axes[1, 0]):
        axis.set_ylim(bottom=0)
    mean, measured, meant = zip(*quality.photon_transfer, strict=True)
    axes[1, 1].loglog(mean, measured, "o", label="measured")
    axes[1, 1].loglog(mean, meant, "-", linewidth=1, label="model")
    axes[1, 1].set(xlabel="mean signal (DN)", ylabel="variance (DN²)", title="photon transfer, without detector blur")
    axes[1, 1].legend(frameon=False)
    shown = axes[0, 2].imshow(quality.spr, cmap="magma", vmin=0)
    axes[0, 2].set(title="scatter-to-primary ratio", xticks=[], yticks=[])
    figure.colorbar(shown, ax=axes[0, 2])
    middle = quality.spr[quality.spr.shape[0] * 5 // 9]
    across_mm = (np.arange(len(middle)) - (len(middle) - 1) / 2) * quality.spr_cell_mm
    axes[1, 2].plot(across_mm, middle, linewidth=1)
    axes[1, 2].set(xlabel="distance from the detector centre (mm)", ylabel="scatter-to-primary ratio", ylim=(0, None))
    axes[1, 2].set_title("across the tibia")
    figure.suptitle(f"Protocol {protocol_name}")
    stream = io.BytesIO()
    figure.savefig(stream, format="png", dpi=120)
    return stream.getvalue()
