"""explore.serve   port -> a page with sliders in the browser, on this machine alone   (extra "explore")

listing   what the page shows of fields, tables and protocols
asked     requests, checked at the door
warm      what stays: knees built, paths traced, stages run
answers   a request -> its answer
python    the lines that make an image again
worker    the process that answers
ahead     spectra that a kV slider will ask for
dispatch  one worker, many tabs; the latest request wins
guard     who may ask
server    the addresses
browser   Chromium, without a window
latency   seconds from a slider to the picture, in a real browser
"""

from importlib.util import find_spec

from ..core.checks import InputError


def require_extra() -> None:
    """Refuse to go on without the libraries of the extra "explore".

    raises  InputError
    """
    missing = [name for name in ("starlette", "uvicorn", "tomli_w") if find_spec(name) is None]
    if missing:
        raise InputError(f"missing = {', '.join(missing)}; allowed: the extra explore (pip install 'pssf[explore]')")
