"""Write a calibration to files: detector, protocol, estimates, and a page if matplotlib and jinja2 are installed."""

from dataclasses import asdict
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import tomli_w

from ..io.atomic_write import write_bytes
from ..io.cohort_records import write_csv
from .calibration_run import Calibration
from .estimate import make_estimate_rows


def write_calibration(calibration: Calibration, path: Path) -> list[Path]:
    """Write the detector, the protocol, a table of estimates and a page.

    Parameters
    ----------
    calibration : Calibration
        Result of a calibration.
    path : Path
        Path of the detector file, which ends with ``.toml``. The other files have the same name with the ends
        ``_protocol.toml``, ``_estimates.csv`` and ``_page.html``.

    Returns
    -------
    list of Path
        Written files. The page is not written if matplotlib or jinja2 is not installed (extra ``study``).
    """
    stem = path.with_suffix("")
    paths = [path, *(stem.with_name(stem.name + end) for end in ("_protocol.toml", "_estimates.csv"))]
    write_bytes(paths[0], _format_toml(asdict(calibration.detector)))
    protocol = {**asdict(calibration.protocol), "detector": path.name, "name": stem.name}
    write_bytes(paths[1], _format_toml(protocol))
    write_csv(paths[2], make_estimate_rows(calibration.estimates))
    if find_spec("matplotlib") and find_spec("jinja2"):
        from .calibration_page import render_calibration_page

        paths.append(stem.with_name(stem.name + "_page.html"))
        write_bytes(paths[-1], render_calibration_page(calibration).encode())
    return paths


def _format_toml(table: dict[str, Any]) -> bytes:
    """Format fields as TOML with 7 digits, without those that are None."""
    return tomli_w.dumps({name: _round(value) for name, value in table.items() if value is not None}).encode()


def _round(value: Any) -> Any:
    """Round the numbers of a value or of a table to 7 digits."""
    if isinstance(value, float):
        return float(f"{value:.7g}")
    return [_round(each) for each in value] if isinstance(value, list | tuple) else value
