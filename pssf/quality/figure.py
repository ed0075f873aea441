"""The curves of a protocol's quality, measured beside model, in one figure."""

import io

import numpy as np
from matplotlib.figure import Figure

from .measure import Quality


def draw(quality: Quality, name: str) -> bytes:
    """PNG of MTF, NNPS, DQE, photon transfer and scatter over primary."""
    figure = Figure(figsize=(13, 7), layout="constrained")
    axes = figure.subplots(2, 3)
    curves = (("MTF", quality.mtf), ("NNPS (mm²)", quality.nnps), ("DQE, RQA5 beam", quality.dqe))
    for axis, (label, curve) in zip((axes[0, 0], axes[0, 1], axes[1, 0]), curves, strict=True):
        axis.plot(curve.per_mm, curve.measured, ".", markersize=3, label="measured")
        axis.plot(curve.per_mm, curve.model, "-", linewidth=1, label="model")
        axis.set(xlabel="cycles/mm", ylabel=label)
        axis.legend(frameon=False)
    axes[0, 1].set_yscale("log")
    for axis in (axes[0, 0], axes[1, 0]):
        axis.set_ylim(bottom=0)
    mean, measured, meant = zip(*quality.transfer, strict=True)
    axes[1, 1].loglog(mean, measured, "o", label="measured")
    axes[1, 1].loglog(mean, meant, "-", linewidth=1, label="model")
    axes[1, 1].set(xlabel="mean signal (DN)", ylabel="variance (DN²)", title="photon transfer, no blur")
    axes[1, 1].legend(frameon=False)
    shown = axes[0, 2].imshow(quality.spr, cmap="magma", vmin=0)
    axes[0, 2].set(title="scatter over primary", xticks=[], yticks=[])
    figure.colorbar(shown, ax=axes[0, 2])
    middle = quality.spr[quality.spr.shape[0] * 5 // 9]
    across_mm = (np.arange(len(middle)) - (len(middle) - 1) / 2) * quality.cell_mm
    axes[1, 2].plot(across_mm, middle, linewidth=1)
    axes[1, 2].set(xlabel="mm from the middle of the detector", ylabel="scatter over primary", ylim=(0, None))
    axes[1, 2].set_title("across the tibia")
    figure.suptitle(f"Protocol {name}")
    stream = io.BytesIO()
    figure.savefig(stream, format="png", dpi=120)
    return stream.getvalue()
