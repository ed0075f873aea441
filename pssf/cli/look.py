"""The command that opens a page: explore."""

from typing import Annotated

import typer


def explore(
    *,
    port: Annotated[int, typer.Option(help="Port of this machine; 0 takes a free one.")] = 0,
    browser: Annotated[bool, typer.Option("--browser/--no-browser", help="Open the link in the browser.")] = True,
) -> None:
    """A page with sliders: a knee, its radiograph and its solids, in the browser and on this machine alone.

    Prints the link, which is this run's own; ends with Ctrl-C. Needs the extra explore.
    """
    from ..explore import require_extra

    require_extra()
    from ..explore.server import serve

    serve(port, browser=browser)
