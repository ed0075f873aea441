"""Serve an interactive page for the browser, with controls for knee and protocol, to this machine only.

================  ======================================================================
page_server       addresses of the server, and `serve`, which starts it
page_listing      list of the fields, tables and protocols that the page shows
request_schema    parsing and checks of requests
request_guard     access checks: token, host, origin and size of requests
request_queue     queue of requests; the latest request of a tab supersedes older ones
page_worker       process that answers the requests
stage_cache       cached knees, path lengths and images
handlers          functions that answer the requests
prefetch          computation of spectra before the tube-voltage slider needs them
python_snippet    Python code that reproduces the image on the page
================  ======================================================================
"""

from importlib.util import find_spec

from ..core.checks import InputError


def require_extra() -> None:
    """Require that the libraries of the extra "explore" are installed.

    Raises
    ------
    InputError
        If a library is missing; the message names it.
    """
    missing = [name for name in ("starlette", "uvicorn", "tomli_w") if find_spec(name) is None]
    if missing:
        raise InputError(f"explore needs {', '.join(missing)}, not installed: run pip install 'pssf[explore]'")
