"""Show a calibration as an HTML page with the estimates and plots of measured and fitted values."""

import base64
import io
from collections.abc import Callable

import jinja2
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ..detector.detector_blur import compute_transfer
from .calibration_run import Calibration
from .estimate import make_estimate_rows
from .noise_spectrum import predict_power


def render_calibration_page(calibration: Calibration) -> str:
    """Render the estimates and plots of a calibration as an HTML page.

    Parameters
    ----------
    calibration : Calibration
        Result of a calibration.

    Returns
    -------
    str
        Complete HTML page.
    """
    plots = [
        (title, text, _encode_plot(draw, calibration))
        for title, text, draw, measured in (
            ("Signal", _SIGNAL_TEXT, _draw_signal, calibration.response),
            ("Noise power", _NOISE_TEXT, _draw_noise, calibration.spectra),
            ("MTF", _MTF_TEXT, _draw_mtf, calibration.edge),
            ("Wedge", _WEDGE_TEXT, _draw_wedge, calibration.beam),
        )
        if measured is not None
    ]
    environment = jinja2.Environment(loader=jinja2.PackageLoader(__package__, "."), autoescape=True, trim_blocks=True)
    return environment.get_template("calibration.html.j2").render(
        name=calibration.detector.name, rows=make_estimate_rows(calibration.estimates), plots=plots
    )


_SIGNAL_TEXT = (
    "Mean signal of each flat field divided by its mAs, relative to the mean. Deviations of up to 2 % are attributed "
    "to the generator; larger ones give a response curve."
)
_NOISE_TEXT = (
    "Noise power of each flat field, or of regions of radiographs with the same signal: measured, fitted, and their "
    "ratio. A ratio that differs from 1 at low frequencies shows structure that is not noise."
)
_MTF_TEXT = "Presampled MTF of the edge and of the detector file, and their difference."
_WEDGE_TEXT = (
    "Measured minus fitted signal behind each step, with the 95 % interval of the measurement. A trend with thickness "
    "shows scatter, another material, or another spectrum."
)


def _encode_plot(draw: Callable[[Calibration, list[Axes]], None], calibration: Calibration) -> str:
    """Draw two axes and encode them as PNG in base64."""
    figure = Figure(figsize=(9.5, 3.4), layout="constrained")
    draw(calibration, list(figure.subplots(1, 2)))
    stream = io.BytesIO()
    figure.savefig(stream, format="png", dpi=110)
    return base64.b64encode(stream.getvalue()).decode()


def _draw_signal(calibration: Calibration, axes: list[Axes]) -> None:
    """Draw the signal of the flat fields and its deviation from proportionality."""
    response = calibration.response
    assert response is not None
    used = np.array(response.used)
    axes[0].loglog(response.mas[used], response.signal_dn[used], "o")
    axes[0].set(xlabel="mAs", ylabel="signal (DN)")
    ratio = response.signal_dn[used] / response.mas[used]
    axes[1].semilogx(response.mas[used], 100 * (ratio / ratio.mean() - 1), "o")
    axes[1].axhline(0, linewidth=1, color="grey")
    axes[1].set(xlabel="mAs", ylabel="signal per mAs, deviation (%)")


def _draw_noise(calibration: Calibration, axes: list[Axes]) -> None:
    """Draw measured and fitted noise power."""
    spectra = calibration.spectra
    assert spectra is not None
    model = predict_power(calibration.detector, spectra, calibration.protocol.pixel_mm, calibration.noise_per_signal_dn)
    for measured, fitted, mean in zip(spectra.power_dn2, model, spectra.mean_dn, strict=True):
        (line,) = axes[0].semilogy(spectra.frequency_per_mm, measured, ".", markersize=3, label=f"{mean:.0f} DN")
        axes[0].semilogy(spectra.frequency_per_mm, fitted, "-", linewidth=1, color=line.get_color())
        axes[1].plot(spectra.frequency_per_mm, measured / fitted, "-", linewidth=1, color=line.get_color())
    axes[0].set(xlabel="cycles/mm", ylabel="noise power (DN²)")
    axes[0].legend(frameon=False, fontsize="small", ncols=2, loc="upper right")
    axes[0].set_ylim(top=30 * float(spectra.power_dn2.max()))
    axes[1].axhline(1, linewidth=1, color="grey")
    axes[1].set(xlabel="cycles/mm", ylabel="measured / fitted")


def _draw_mtf(calibration: Calibration, axes: list[Axes]) -> None:
    """Draw measured and fitted MTF and their difference."""
    edge = calibration.edge
    assert edge is not None
    fitted = compute_transfer(calibration.detector, edge.frequency_per_mm)
    axes[0].plot(edge.frequency_per_mm, edge.mtf, ".", markersize=3, label="measured")
    axes[0].plot(edge.frequency_per_mm, fitted, "-", linewidth=1, label="detector file")
    axes[0].set(xlabel="cycles/mm", ylabel="MTF")
    axes[0].legend(frameon=False)
    axes[1].plot(edge.frequency_per_mm, edge.mtf - fitted, ".", markersize=3)
    for sign in (-1.96, 1.96):
        axes[1].plot(edge.frequency_per_mm, sign * edge.standard_error, "-", linewidth=1, color="grey")
    axes[1].set(xlabel="cycles/mm", ylabel="measured minus detector file")


def _draw_wedge(calibration: Calibration, axes: list[Axes]) -> None:
    """Draw the signals behind the wedge and the residuals of the fit."""
    beam = calibration.beam
    assert beam is not None
    for number, wedge in enumerate(calibration.wedges):
        label = f"{wedge.tube_kv:g} kV"
        axes[0].plot(wedge.path_mm, wedge.log_signal - wedge.log_signal.max(), "o", label=label)
        axes[1].errorbar(
            wedge.path_mm, 100 * beam.residuals[number], yerr=196 * beam.errors[number], fmt="o", capsize=2, label=label
        )
    axes[0].set(xlabel="thickness (mm)", ylabel="logarithm of the signal")
    axes[0].legend(frameon=False)
    axes[1].axhline(0, linewidth=1, color="grey")
    axes[1].set(xlabel="thickness (mm)", ylabel="measured minus fitted (%)")
