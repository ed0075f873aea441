"""Interactive page with sliders in the browser, served to this machine only (extra "explore").

================  ======================================================================
page_server       addresses of the server, and `serve`, which starts it
page_listing      fields, tables and protocols that the page shows
request_schema    checked requests
request_guard     access checks: token, host, origin and size of requests
request_queue     queue of requests; the latest request of a tab supersedes older ones
page_worker       process that answers the requests
stage_cache       cached knees, path lengths and images
handlers          answers to requests
prefetch          spectra computed ahead for the tube-voltage slider
python_snippet    Python code that reproduces an image
browser           headless Chromium for tests and timing
page_latency      time from a slider to the image in a real browser
================  ======================================================================
"""

from importlib.util import find_spec

from ..core.checks import InputError


def require_extra() -> None:
    """Raise an error if libraries of the extra "explore" are not installed.

    Raises
    ------
    InputError
        If a library is missing; the message names it.
    """
    missing = [name for name in ("starlette", "uvicorn", "tomli_w") if find_spec(name) is None]
    if missing:
        raise InputError(
            f"explore needs {', '.join(missing)}, not installed: install the extra with pip install 'pssf[explore]'"
        )
