"""Command `explore`."""

from typing import Annotated

import typer


def explore(
    *,
    port: Annotated[int, typer.Option(help="Port on this machine; 0 selects a free port.")] = 0,
    browser: Annotated[
        bool, typer.Option("--browser/--no-browser", help="Open the page in the default browser.")
    ] = True,
) -> None:
    """Open an interactive page in the browser that shows a knee, its radiograph and its solids, on this machine only.

    The command prints the link to the page and runs until Ctrl-C. It requires the optional dependencies of the extra
    explore.
    """
    from ..explore import require_extra

    require_extra()
    from ..explore.page_server import serve

    serve(port, browser=browser)
