"""What was measured of a protocol as tables, and as a figure where matplotlib is there."""

from importlib.util import find_spec
from pathlib import Path

from ..io.atomic import write_bytes
from ..io.records import write_csv
from ..model.protocol import Protocol
from .measure import Quality


def write_quality(quality: Quality, protocol: Protocol, out: Path) -> list[Path]:
    """Write table, curves and the SPR map as CSV, and a figure where matplotlib is there; returns their paths."""
    paths = [out / f"quality_{protocol.name}.csv", out / f"curves_{protocol.name}.csv"]
    write_csv(paths[0], quality.rows)
    curves = {"mtf": quality.mtf, "nnps_mm2": quality.nnps, "dqe_rqa5": quality.dqe}
    write_csv(
        paths[1],
        [
            {"curve": name, "per_mm": round(float(f), 4), "measured": f"{measured:.5g}", "model": f"{model:.5g}"}
            for name, curve in curves.items()
            for f, measured, model in zip(curve.per_mm, curve.measured, curve.model, strict=True)
        ],
    )
    paths.append(out / f"spr_{protocol.name}.csv")
    write_csv(paths[-1], [{str(col): f"{spr:.4g}" for col, spr in enumerate(row)} for row in quality.spr])
    if find_spec("matplotlib"):
        from .figure import draw

        paths.append(out / f"quality_{protocol.name}.png")
        write_bytes(paths[-1], draw(quality, protocol.name))
    return paths
