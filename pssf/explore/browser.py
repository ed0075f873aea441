"""Headless Chromium of this machine, in which the page is tested and timed."""

from shutil import which

_BROWSER_NAMES = ("chromium", "chromium-browser", "google-chrome")
# The sandbox is off, because root has none in a container. WebGL runs on the CPU. Network features are off.
CHROMIUM_FLAGS = [
    "--no-sandbox",
    "--use-gl=angle",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
]


def find_chromium() -> str | None:
    """Find a Chromium or Chrome executable.

    Returns
    -------
    str or None
        Path of the executable; None if there is none.
    """
    return next((path for path in map(which, _BROWSER_NAMES) if path), None)
