"""Write the image quality of a protocol to files: tables, and a figure if matplotlib is installed."""

from importlib.util import find_spec
from pathlib import Path

from ..io.atomic_write import write_bytes
from ..io.cohort_records import write_csv
from ..model.protocol import Protocol
from .quality_measurement import QualityResult


def write_quality(quality: QualityResult, protocol: Protocol, out: Path) -> list[Path]:
    """Write the quantities, curves and scatter map as CSV files, and a figure if matplotlib is installed.

    Parameters
    ----------
    quality : QualityResult
        Measured image quality of the protocol.
    protocol : Protocol
        Measured protocol, whose name is the end of every file name.
    out : Path
        Output folder.

    Returns
    -------
    list of Path
        Paths of the written files.
    """
    paths = [out / f"quality_{protocol.name}.csv", out / f"curves_{protocol.name}.csv"]
    write_csv(paths[0], quality.rows)
    curves = {"mtf": quality.mtf, "nnps_mm2": quality.nnps, "dqe_rqa5": quality.dqe}
    write_csv(
        paths[1],
        [
            {"curve": name, "per_mm": round(float(f), 4), "measured": f"{measured:.5g}", "model": f"{model:.5g}"}
            for name, curve in curves.items()
            for f, measured, model in zip(curve.frequency_per_mm, curve.measured, curve.model, strict=True)
        ],
    )
    paths.append(out / f"spr_{protocol.name}.csv")
    write_csv(paths[-1], [{str(col): f"{spr:.4g}" for col, spr in enumerate(row)} for row in quality.spr])
    if find_spec("matplotlib"):
        from .quality_figure import render_quality_png

        paths.append(out / f"quality_{protocol.name}.png")
        write_bytes(paths[-1], render_quality_png(quality, protocol.name))
    return paths
