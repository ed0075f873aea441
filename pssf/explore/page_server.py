"""Web server of the explore page, which accepts connections only from the local machine."""

import asyncio
import json
import secrets
import signal
import socket
import sys
from collections import OrderedDict
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager, suppress
from webbrowser import open_new_tab

import uvicorn
from starlette.applications import Starlette
from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.responses import JSONResponse, Response
from starlette.routing import Route

from ..core.checks import InputError, require_integer
from ..core.processes.worker_processes import WorkersLostError
from ..data.imaging.explore_table import load_page_files
from ..model.knee import Knee
from ..model.protocol import load_protocol
from .page_listing import build_listing
from .page_worker import SupersededError, Worker
from .prefetch import start_spectrum_prefetch
from .request_guard import (
    RefusedError,
    RequestGuard,
    build_page_policy,
    make_error_response,
    read_json_body,
)
from .request_queue import Dispatcher
from .request_schema import (
    ResolvedRequest,
    coarsen_protocol,
    parse_state,
    resolve_state,
    sample_page_knee,
)

HOST = "127.0.0.1"
# Maximum number of 3D pages that the server stores until a browser frame loads them.
_MAX_SOLIDS_PAGES = 8
# Size of the warm-up image along its longer side, in pixels. The image is simulated before the first request.
_FIRST_SIDE_PX = 512
_BINARY_KINDS = ("radiograph", "masks", "probe")
Handler = Callable[[Request], Awaitable[Response]]


class Endpoints:
    """HTTP endpoints of the explore server.

    Parameters
    ----------
    worker : Worker
        Worker process that answers the requests.
    """

    def __init__(self, worker: Worker) -> None:
        self._dispatch = Dispatcher(worker)
        self._pages: OrderedDict[str, str] = OrderedDict()

    async def serve_page(self, request: Request) -> Response:
        """Return one of the static files of the explore page.

        Parameters
        ----------
        request : Request
            HTTP request with a file name in the path.

        Returns
        -------
        Response
            Content of the file.
        """
        name = request.path_params.get("name", "index.html")
        if name not in load_page_files():
            raise HTTPException(404)
        kind, content = load_page_files()[name]
        return Response(content, media_type=kind)

    async def serve_listing(self, request: Request) -> Response:
        """Return the listing of fields, tables and protocols that the explore page shows.

        Parameters
        ----------
        request : Request
            HTTP request.

        Returns
        -------
        Response
            Listing as JSON.
        """
        return JSONResponse(await asyncio.to_thread(build_listing))

    async def sample_knee(self, request: Request) -> Response:
        """Sample a knee with a KL grade and a random seed.

        Parameters
        ----------
        request : Request
            HTTP request with a `SampleKneeRequest` as JSON.

        Returns
        -------
        Response
            Fields of the knee as JSON.
        """
        body = await read_json_body(request)
        return JSONResponse(await asyncio.to_thread(sample_page_knee, body))

    async def serve_binary(self, request: Request) -> Response:
        """Return a radiograph, its masks, or the path lengths at one pixel.

        Parameters
        ----------
        request : Request
            HTTP request with a `PageState` as JSON.

        Returns
        -------
        Response
            Binary response: length of the JSON header as uint32, followed by the header and the content.
        """
        kind = request.path_params["kind"]
        if kind not in _BINARY_KINDS:
            raise HTTPException(404)
        header, content = await self._dispatch_request(kind, request)
        text = json.dumps(header).encode()
        text += b" " * (-len(text) % 4)
        packed = len(text).to_bytes(4, "little") + text + content
        return Response(packed, media_type="application/octet-stream")

    async def serve_file(self, request: Request) -> Response:
        """Return an exported file for download.

        Parameters
        ----------
        request : Request
            HTTP request with a `PageState` as JSON.

        Returns
        -------
        Response
            Content of the file, with the file name in the response header.
        """
        header, content = await self._dispatch_request("file", request)
        named = {"Content-Disposition": f'attachment; filename="{header["name"]}"'}
        return Response(content, media_type="application/octet-stream", headers=named)

    async def make_solids_page(self, request: Request) -> Response:
        """Build a page with a 3D view and return its address.

        Parameters
        ----------
        request : Request
            HTTP request with a `PageState` as JSON.

        Returns
        -------
        Response
            Address of the 3D page as JSON.
        """
        _, content = await self._dispatch_request("solids", request)
        name = secrets.token_urlsafe(8)
        self._pages[name] = content.decode()
        while len(self._pages) > _MAX_SOLIDS_PAGES:
            self._pages.popitem(last=False)
        return JSONResponse({"page": f"solids/{name}"})

    async def serve_solids_page(self, request: Request) -> Response:
        """Return a page with a 3D view.

        Parameters
        ----------
        request : Request
            HTTP request with the name of the 3D page in the path.

        Returns
        -------
        Response
            HTML page.
        """
        page = self._pages.get(request.path_params["name"])
        if page is None:
            raise HTTPException(404)
        headers = {"Content-Security-Policy": build_page_policy(page)}
        return Response(page, media_type="text/html; charset=utf-8", headers=headers)

    async def _dispatch_request(self, kind: str, request: Request) -> tuple[dict[str, object], bytes]:
        """Parse and validate a request, and send the request to the worker process."""
        state = parse_state(await read_json_body(request))
        return await self._dispatch.ask(kind, state.tab, resolve_state(state))

    async def warm_up(self) -> None:
        """Simulate an image at server start, so that the template bones are loaded before the first request."""
        protocol = load_protocol("reference")
        coarse = coarsen_protocol(protocol, _FIRST_SIDE_PX)
        first = ResolvedRequest(
            knee=Knee(), protocol=coarse, full_protocol=protocol, seed=0, processing="processed", kind="", pixel=(0, 0)
        )
        with suppress(SupersededError, RuntimeError, InputError):
            await self._dispatch.ask("radiograph", "", first)


def make_application(token: str, port: int, worker: Worker) -> RequestGuard:
    """Create the web application of the explore server, with access checks.

    Parameters
    ----------
    token : str
        Secret token, which is the first part of the path in every URL.
    port : int
        Port of the server.
    worker : Worker
        Worker process that answers the requests.

    Returns
    -------
    RequestGuard
        ASGI application.
    """
    desk = Endpoints(worker)
    routes = [
        *((path, desk.serve_page, "GET") for path in ("", "page/{name}")),
        ("fields", desk.serve_listing, "GET"),
        ("draw", desk.sample_knee, "POST"),
        ("answer/{kind}", desk.serve_binary, "POST"),
        ("file", desk.serve_file, "POST"),
        ("solids", desk.make_solids_page, "POST"),
        ("solids/{name}", desk.serve_solids_page, "GET"),
    ]

    @asynccontextmanager
    async def lifespan(app: Starlette) -> AsyncIterator[None]:
        warming = asyncio.create_task(desk.warm_up())
        spectra = start_spectrum_prefetch()
        yield
        warming.cancel()
        spectra.kill()
        worker.close()

    app = Starlette(
        routes=[Route(f"/{token}/{path}", _catch_errors(handler), methods=[way]) for path, handler, way in routes],
        exception_handlers={404: _handle_unknown, 405: _handle_unknown},
        lifespan=lifespan,
    )
    return RequestGuard(app, token, port)


def _catch_errors(handler: Handler) -> Handler:
    """Wrap a handler so that exceptions become JSON error responses with an HTTP status."""

    async def answered(request: Request) -> Response:
        try:
            return await handler(request)
        except RefusedError as error:
            return make_error_response(error.status, str(error))
        except InputError as error:
            return make_error_response(400, str(error))
        except SupersededError:
            return make_error_response(409, "request was superseded by a newer request from the same tab")
        except WorkersLostError as error:
            return make_error_response(503, f"worker process ended unexpectedly: {error}; repeat the request")
        except RuntimeError as error:
            return make_error_response(500, f"worker process failed: {error}; change the settings")

    return answered


async def _handle_unknown(request: Request, error: Exception) -> Response:
    """Return the error response for an unknown address or HTTP method."""
    status = getattr(error, "status_code", 404)
    what = "method" if status == 405 else "address"
    return make_error_response(status, f"{what} must be one that the explore page uses, got a {request.method} request")


def serve(port: int = 0, *, browser: bool = True, report_link: Callable[[str], None] = print) -> None:
    """Serve the explore page until the user presses Ctrl-C.

    Parameters
    ----------
    port : int, default 0
        Port from 0 to 65535; 0 selects a free port.
    browser : bool, default True
        Whether to open the link in the default browser.
    report_link : callable, optional
        Function that is called with the link. By default, the link is printed.

    Raises
    ------
    InputError
        If the port is out of range or in use.
    """
    require_integer("port", port, 0, 65535, "")
    held = _bind_socket(port)
    port, token = held.getsockname()[1], secrets.token_urlsafe(24)
    link = f"http://{HOST}:{port}/{token}/"
    app = make_application(token, port, Worker())
    config = uvicorn.Config(app, log_level="warning", server_header=False, date_header=False, ws="none")
    report_link(link)
    sys.stdout.flush()
    if browser and not open_new_tab(link):
        print("pssf: no browser was found; open the link above in a browser", file=sys.stderr)
    # After Ctrl-C, the server ends and raises the signal again. The second signal is ignored to avoid a traceback.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    uvicorn.Server(config).run(sockets=[held])


def _bind_socket(port: int) -> socket.socket:
    """Open a listening socket at a port of the local machine."""
    held = socket.socket()
    held.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        held.bind((HOST, port))
        # The socket listens before the server starts, so that an early browser request waits instead of failing.
        held.listen()
    except OSError as error:
        held.close()
        raise InputError(
            f"port must be free, got {port} ({error.strerror}): use another port, or 0 for any free port"
        ) from None
    return held
