"""Interactive browser page with controls for knee and protocol, served to the local machine only.

================  ======================================================================
page_server       HTTP endpoints, and the function `serve`, which starts the server
page_listing      list of the fields, tables and protocols that the page shows
request_schema    parsing and validation of requests
request_guard     access checks: token, host, origin and size of requests
request_queue     request queue; a new request of a tab supersedes older requests
page_worker       process that answers the requests
stage_cache       cached knees, path lengths and images
handlers          functions that answer the requests
prefetch          advance computation of the spectra for the tube-voltage slider
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
        If a library is missing. The message contains the name of the library.
    """
    missing = [name for name in ("starlette", "uvicorn") if find_spec(name) is None]
    if missing:
        raise InputError(f"pssf explore requires {', '.join(missing)}, not installed: run pip install 'pssf[explore]'")
