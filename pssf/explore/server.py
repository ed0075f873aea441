"""The server: its addresses, and how it is started. Bound to this machine alone."""

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

from ..core.checks import InputError, require_whole
from ..core.workers import WorkersLostError
from ..data.explore import page_files
from ..model.knee import Knee
from ..model.protocol import load_protocol
from .ahead import start_spectra
from .asked import Wanted, coarser, drawn, read_state, resolve
from .dispatch import Dispatch
from .guard import Guard, RefusedError, body_of, policy_of, refusal
from .listing import listing
from .worker import SupersededError, Worker

HOST = "127.0.0.1"
# Pages of solids that are kept for the frames that show them.
_PAGES = 8
# Of the first picture, which is made before anybody asks.
_FIRST_SIDE = 512
_BINARY = ("radiograph", "masks", "probe")
Handler = Callable[[Request], Awaitable[Response]]


class Desk:
    """Answers of the addresses."""

    def __init__(self, worker: Worker) -> None:
        self._dispatch = Dispatch(worker)
        self._pages: OrderedDict[str, str] = OrderedDict()

    async def page(self, request: Request) -> Response:
        """A file of the page."""
        name = request.path_params.get("name", "index.html")
        if name not in page_files():
            raise HTTPException(404)
        kind, content = page_files()[name]
        return Response(content, media_type=kind)

    async def fields(self, request: Request) -> Response:
        """What the page is built from."""
        return JSONResponse(await asyncio.to_thread(listing))

    async def draw(self, request: Request) -> Response:
        """A knee by grade and seed."""
        body = await body_of(request)
        return JSONResponse(await asyncio.to_thread(drawn, body))

    async def answer(self, request: Request) -> Response:
        """Radiograph, masks or probe: length of a header of JSON as uint32, the header, and bytes."""
        kind = request.path_params["kind"]
        if kind not in _BINARY:
            raise HTTPException(404)
        header, content = await self._asked(kind, request)
        text = json.dumps(header).encode()
        text += b" " * (-len(text) % 4)
        packed = len(text).to_bytes(4, "little") + text + content
        return Response(packed, media_type="application/octet-stream")

    async def file(self, request: Request) -> Response:
        """A file to keep."""
        header, content = await self._asked("file", request)
        named = {"Content-Disposition": f'attachment; filename="{header["name"]}"'}
        return Response(content, media_type="application/octet-stream", headers=named)

    async def solids(self, request: Request) -> Response:
        """The address of a page with the solids."""
        _, content = await self._asked("solids", request)
        name = secrets.token_urlsafe(8)
        self._pages[name] = content.decode()
        while len(self._pages) > _PAGES:
            self._pages.popitem(last=False)
        return JSONResponse({"page": f"solids/{name}"})

    async def solids_page(self, request: Request) -> Response:
        """That page."""
        page = self._pages.get(request.path_params["name"])
        if page is None:
            raise HTTPException(404)
        headers = {"Content-Security-Policy": policy_of(page)}
        return Response(page, media_type="text/html; charset=utf-8", headers=headers)

    async def _asked(self, kind: str, request: Request) -> tuple[dict[str, object], bytes]:
        state = read_state(await body_of(request))
        return await self._dispatch.ask(kind, state.tab, resolve(state))

    async def warm_up(self) -> None:
        """The first picture, so that the mean solids stand when the page asks."""
        protocol = load_protocol("reference")
        coarse = coarser(protocol, _FIRST_SIDE)
        first = Wanted(knee=Knee(), protocol=coarse, whole=protocol, seed=0, look="linear", kind="", place=(0, 0))
        with suppress(SupersededError, RuntimeError, InputError):
            await self._dispatch.ask("radiograph", "", first)


def application(token: str, port: int, worker: Worker) -> Guard:
    """The server's answers behind their guard."""
    desk = Desk(worker)
    routes = [
        *((path, desk.page, "GET") for path in ("", "page/{name}")),
        ("fields", desk.fields, "GET"),
        ("draw", desk.draw, "POST"),
        ("answer/{kind}", desk.answer, "POST"),
        ("file", desk.file, "POST"),
        ("solids", desk.solids, "POST"),
        ("solids/{name}", desk.solids_page, "GET"),
    ]

    @asynccontextmanager
    async def lifespan(app: Starlette) -> AsyncIterator[None]:
        warming = asyncio.create_task(desk.warm_up())
        spectra = start_spectra()
        yield
        warming.cancel()
        spectra.kill()
        worker.close()

    app = Starlette(
        routes=[Route(f"/{token}/{path}", _answered(handler), methods=[way]) for path, handler, way in routes],
        exception_handlers={404: _unknown, 405: _unknown},
        lifespan=lifespan,
    )
    return Guard(app, token, port)


def _answered(handler: Handler) -> Handler:
    """What cannot be answered is told in one line of JSON."""

    async def answered(request: Request) -> Response:
        try:
            return await handler(request)
        except RefusedError as error:
            return refusal(error.status, str(error))
        except InputError as error:
            return refusal(400, str(error))
        except SupersededError:
            return refusal(409, "superseded = by a newer request of this tab; allowed: the latest")
        except WorkersLostError as error:
            return refusal(503, f"worker = lost; {error}")
        except RuntimeError as error:
            return refusal(500, f"worker = failed; {error}")

    return answered


async def _unknown(request: Request, error: Exception) -> Response:
    status = getattr(error, "status_code", 404)
    what = "method" if status == 405 else "address"
    return refusal(status, f"{what} = {request.method} of that name; allowed: those that the page uses")


def serve(port: int = 0, *, browser: bool = True, say: Callable[[str], None] = print) -> None:
    """Serve the page until Ctrl-C.

    port     0 takes a free one
    browser  opens the link
    say      is given the link
    raises   InputError for a port that is out of range or taken
    """
    require_whole("port", port, 0, 65535, "")
    held = _bound(port)
    port, token = held.getsockname()[1], secrets.token_urlsafe(24)
    link = f"http://{HOST}:{port}/{token}/"
    app = application(token, port, Worker())
    config = uvicorn.Config(app, log_level="warning", server_header=False, date_header=False, ws="none")
    say(link)
    sys.stdout.flush()
    if browser and not open_new_tab(link):
        print("pssf: no browser found; open the link above", file=sys.stderr)
    # The server ends at Ctrl-C and then raises it once more, which would be told as work that was stopped.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    uvicorn.Server(config).run(sockets=[held])


def _bound(port: int) -> socket.socket:
    held = socket.socket()
    held.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        held.bind((HOST, port))
        # From here on a browser that has the link waits, and is not refused.
        held.listen()
    except OSError as error:
        held.close()
        raise InputError(f"port = {port} ({error.strerror}); allowed: a free one, or 0 for any") from None
    return held
