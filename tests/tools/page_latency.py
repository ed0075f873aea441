"""Latency of the interactive page: time from a slider event to the new image in a headless browser.

Run ``python -m tools.page_latency OUT`` in the folder ``tests``; the command writes OUT/latency.csv.
"""

import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from importlib.util import find_spec
from pathlib import Path
from statistics import median
from typing import Any

from tools.browser import CHROMIUM_FLAGS, find_chromium

from pssf.core.checks import InputError
from pssf.core.processes.child_processes import build_python_command
from pssf.io.cohort_records import write_csv

Row = dict[str, str | float | int]
# Timeout of every browser operation, in ms.
_TIMEOUT_MS = 300_000.0
# Number of times that each slider is moved.
_REPEATS = 3
# Measured sliders: name, selector, first value, step, and target latency on two idle cores in s.
_SLIDERS = (
    ("exposure: mAs", "#exposure [data-field=mas] input[type=range]", 1.0, 0.5, 0.15),
    ("exposure: kV", "#exposure [data-field=tube_kv] input[type=range]", 61.0, 2.0, 0.15),
    ("exposure: grid", "#exposure [data-field=grid_ratio] input[type=range]", 6.0, 1.0, 0.15),
    ("geometry: beam angle", "#exposure [data-field=beam_angle_deg] input[type=range]", 1.0, 1.0, 1.5),
    ("knee: medial joint space", "#knee [data-field=jsw_medial_mm] input[type=range]", 3.0, 0.2, 1.5),
    ("knee: flexion", "#knee [data-field=flexion_deg] input[type=range]", 2.0, 1.0, 1.5),
)
# Target latency of an image at full resolution, in s.
_FULL_RESOLUTION_TARGET_S = 2.5
# JavaScript that measures the time from a slider event until the next image is painted, and CPU time of the worker.
_TIMING_SCRIPT = """async ([selector, value, kind, wanted]) => {
  const root = document.documentElement, slider = document.querySelector(selector);
  const { film } = await import(new URL("page/app.js", document.baseURI).href);
  return new Promise((resolve) => {
    const began = performance.now(), before = +root.dataset.picture.split(" ")[0];
    const look = new MutationObserver(() => {
      const [count, what] = root.dataset.picture.split(" ");
      if (+count <= before || what !== wanted) return;
      look.disconnect();
      // A timer that is set in an animation frame runs after the frame is painted.
      requestAnimationFrame(() => setTimeout(() =>
        resolve([(performance.now() - began) / 1000, film.present.header.cpu_s])));
    });
    look.observe(root, { attributes: true, attributeFilter: ["data-picture"] });
    slider.value = value;
    slider.dispatchEvent(new Event(kind));
  });
}"""


def measure_latency(repeats: int = _REPEATS) -> list[Row]:
    """Measure the latency of every slider at preview and full resolution.

    Parameters
    ----------
    repeats : int, default 3
        Number of times that each slider is moved.

    Returns
    -------
    list of dict
        One row per slider and image size: median and longest wall time and median CPU time of the worker, in s.

    Raises
    ------
    InputError
        Chromium or playwright is not installed.
    """
    path = find_chromium()
    if path is None or find_spec("playwright") is None:
        raise InputError("Chromium or playwright is not installed: install Chromium and the dependency group dev")
    rows: list[Row] = []
    with _open_page(path) as page:
        for name, selector, start, step, target_s in _SLIDERS:
            coarse, whole = [], []
            for number in range(repeats):
                value = start + number * step
                coarse.append(page.evaluate(_TIMING_SCRIPT, [selector, value, "input", "coarse"]))
                whole.append(page.evaluate(_TIMING_SCRIPT, [selector, value, "change", "whole"]))
                page.wait_for_timeout(500)
            rows += [
                _make_row(name, "512 x 512", coarse, target_s),
                _make_row(name, "2048 x 2048", whole, _FULL_RESOLUTION_TARGET_S),
            ]
    return rows


def _make_row(name: str, pixels: str, measured: list[list[float]], target_s: float) -> Row:
    """Make the table row of a slider from pairs of wall time and CPU time, in s."""
    walls, cpus = zip(*measured, strict=True)
    return {
        "slider": name,
        "pixels": pixels,
        "wall_s": round(median(walls), 3),
        "worst_s": round(max(walls), 3),
        "cpu_s": round(median(cpus), 3),
        "target_s": target_s,
        "times": len(measured),
    }


@contextmanager
def _open_page(path: str) -> Iterator[Any]:
    """Start a server and yield its page after the first full-resolution image is displayed."""
    from playwright.sync_api import sync_playwright

    command = build_python_command("from pssf.__main__ import main; main()", "explore", "--no-browser")
    server = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    assert server.stdout is not None
    try:
        with sync_playwright() as driver:
            browser = driver.chromium.launch(executable_path=path, args=CHROMIUM_FLAGS)
            page = browser.new_page(viewport={"width": 1500, "height": 900})
            page.set_default_timeout(_TIMEOUT_MS)
            page.goto(server.stdout.readline().strip())
            # The 3D view is closed, because updating the view after each image would delay the next image.
            page.evaluate("document.querySelector('#solids-open').open = false")
            page.wait_for_selector("html[data-picture$=whole]")
            yield page
            browser.close()
    finally:
        server.terminate()
        server.wait()


if __name__ == "__main__":
    write_csv(Path(sys.argv[1]) / "latency.csv", measure_latency())
