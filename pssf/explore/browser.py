"""The browser that the page is tested and timed in: Chromium of this machine, without a window."""

from shutil import which

_NAMES = ("chromium", "chromium-browser", "google-chrome")
# No sandbox, as root has none in a container; WebGL by the processor; nothing asked of a network.
FLAGS = [
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


def chromium() -> str | None:
    """Path of the browser; None where there is none."""
    return next((path for path in map(which, _NAMES) if path), None)
