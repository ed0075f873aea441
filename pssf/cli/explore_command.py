"""Command `explore`."""

from typing import Annotated

import typer


def explore(
    *,
    port: Annotated[int, typer.Option(help="Port on this machine; 0 selects a free one.")] = 0,
    browser: Annotated[bool, typer.Option("--browser/--no-browser", help="Open the page in the browser.")] = True,
) -> None:
    """Open a page with sliders in the browser: a knee, its radiograph and its solids, on this machine only.

    Prints the link of this run. Ctrl-C ends the run. Needs the extra explore.
    """
    from ..explore import require_extra

    require_extra()
    from ..explore.page_server import serve

    serve(port, browser=browser)
