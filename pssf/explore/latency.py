"""Latency: seconds from a slider to the picture, in a real browser without a window."""

import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from importlib.util import find_spec
from statistics import median
from typing import Any

from ..core.checks import InputError
from ..core.child_processes import python_command
from .browser import FLAGS, chromium

Row = dict[str, str | float | int]
_WAIT_MS = 300_000.0
_TIMES = 3
# What is moved: name, selector, first value and step, and the seconds that are aimed at on two quiet cores.
_SLIDERS = (
    ("exposure: mAs", "#exposure [data-field=mas] input[type=range]", 1.0, 0.5, 0.15),
    ("exposure: kV", "#exposure [data-field=tube_kv] input[type=range]", 61.0, 2.0, 0.15),
    ("exposure: grid", "#exposure [data-field=grid_ratio] input[type=range]", 6.0, 1.0, 0.15),
    ("geometry: beam angle", "#exposure [data-field=beam_angle_deg] input[type=range]", 1.0, 1.0, 1.5),
    ("knee: medial joint space", "#knee [data-field=jsw_medial_mm] input[type=range]", 3.0, 0.2, 1.5),
    ("knee: flexion", "#knee [data-field=flexion_deg] input[type=range]", 2.0, 1.0, 1.5),
)
_WHOLE_S = 2.5
# From the event of a slider until the picture that follows is painted; with what the worker took of its processor.
_SCRIPT = """async ([selector, value, kind, wanted]) => {
  const root = document.documentElement, slider = document.querySelector(selector);
  const { film } = await import(new URL("page/app.js", document.baseURI).href);
  return new Promise((resolve) => {
    const began = performance.now(), before = +root.dataset.picture.split(" ")[0];
    const look = new MutationObserver(() => {
      const [count, what] = root.dataset.picture.split(" ");
      if (+count <= before || what !== wanted) return;
      look.disconnect();
      // A timer that is set before a frame runs after it.
      requestAnimationFrame(() => setTimeout(() =>
        resolve([(performance.now() - began) / 1000, film.present.header.cpu_s])));
    });
    look.observe(root, { attributes: true, attributeFilter: ["data-picture"] });
    slider.value = value;
    slider.dispatchEvent(new Event(kind));
  });
}"""


def latency_rows(times: int = _TIMES) -> list[Row]:
    """One row a slider and size: median wall time from the slider to the picture, and the worker's processor time.

    times   that each is moved
    raises  InputError where there is no browser or nothing that drives it
    """
    path = chromium()
    if path is None or find_spec("playwright") is None:
        raise InputError("browser = none; allowed: chromium and playwright (the group dev)")
    rows: list[Row] = []
    with _opened(path) as page:
        for name, selector, start, step, target_s in _SLIDERS:
            coarse, whole = [], []
            for number in range(times):
                value = start + number * step
                coarse.append(page.evaluate(_SCRIPT, [selector, value, "input", "coarse"]))
                whole.append(page.evaluate(_SCRIPT, [selector, value, "change", "whole"]))
                page.wait_for_timeout(500)
            rows += [_row(name, "512 x 512", coarse, target_s), _row(name, "2048 x 2048", whole, _WHOLE_S)]
    return rows


def _row(name: str, pixels: str, measured: list[list[float]], target_s: float) -> Row:
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
def _opened(path: str) -> Iterator[Any]:
    """The page of a server that is started for it, once its first whole picture is there."""
    from playwright.sync_api import sync_playwright

    command = python_command("from pssf.__main__ import main; main()", "explore", "--no-browser")
    server = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    assert server.stdout is not None
    try:
        with sync_playwright() as driver:
            browser = driver.chromium.launch(executable_path=path, args=FLAGS)
            page = browser.new_page(viewport={"width": 1500, "height": 900})
            page.set_default_timeout(_WAIT_MS)
            page.goto(server.stdout.readline().strip())
            # Solids are made after the picture, and would be measured with the next one.
            page.evaluate("document.querySelector('#solids-open').open = false")
            page.wait_for_selector("html[data-picture$=whole]")
            yield page
            browser.close()
    finally:
        server.terminate()
        server.wait()
