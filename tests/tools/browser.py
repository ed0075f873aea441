"""Headless Chromium browser for tests and timing of the interactive page."""

from shutil import which

_BROWSER_NAMES = ("chromium", "chromium-browser", "google-chrome")
# The sandbox is disabled, because the root user of a container cannot use it. WebGL is rendered on the CPU; the page is
# composed without it, which takes a tenth of the time. Background network features are disabled.
CHROMIUM_FLAGS = [
    "--no-sandbox",
    "--use-gl=angle",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--disable-gpu-compositing",
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
        Path of the executable; None if no browser is installed.
    """
    return next((path for path in map(which, _BROWSER_NAMES) if path), None)
