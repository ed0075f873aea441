"""Who may ask: the token of the link, this machine's own name, the page itself; and requests of a sensible size."""

import base64
import hashlib
import re
import secrets
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from starlette.requests import ClientDisconnect, Request
from starlette.responses import JSONResponse
from starlette.types import ASGIApp, Message, Receive, Scope, Send

MOST_BYTES = 65_536
_HOSTS = ("127.0.0.1", "localhost")
# Nothing but the page's own files is run, shown or asked; nothing may frame it.
POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self'; connect-src 'self'; frame-src 'self'; "
    "base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)
HEADERS = {
    "Content-Security-Policy": POLICY,
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cache-Control": "no-store",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
}


class RefusedError(Exception):
    """A request that is not answered: a status and why."""

    def __init__(self, status: int, why: str) -> None:
        super().__init__(why)
        self.status = status


def refusal(status: int, why: str) -> JSONResponse:
    """One line of JSON."""
    return JSONResponse({"error": why}, status)


def policy_of(page: str) -> str:
    """The policy of a page that has its scripts and styles inline: those alone, known by their hashes."""
    blocks = {
        kind: re.findall(rf"<{kind}>(.*?)</{kind}>", page, re.DOTALL | re.IGNORECASE) for kind in ("script", "style")
    }
    allowed = {kind: " ".join(map(_source_of, blocks_of_kind)) for kind, blocks_of_kind in blocks.items()}
    return (
        f"default-src 'none'; script-src {allowed['script']}; style-src {allowed['style']}; img-src data:; "
        "base-uri 'none'; form-action 'none'; frame-ancestors 'self'"
    )


def _source_of(text: str) -> str:
    return f"'sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()}'"


@dataclass(frozen=True)
class Guard:
    """Refuses what does not come from the page; passes on the rest, and gives every answer its headers.

    token  that every address begins with
    port   of this server
    """

    app: ASGIApp
    token: str
    port: int

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "http":
            await self.app(scope, receive, send)
            return
        why = self._fault(scope)
        if why is not None:
            await refusal(403, why)(scope, receive, _with_headers(send))
            return
        await self.app(scope, receive, _with_headers(send))

    def _fault(self, scope: Scope) -> str | None:
        headers = _single(scope)
        if headers is None:
            return "headers = Host or Origin given twice; allowed: once"
        names = [f"{host}:{self.port}" for host in _HOSTS]
        if headers.get("host") not in names:
            return f"host = {headers.get('host', '')[:80]!r}; allowed: {', '.join(names)}"
        origin = headers.get("origin")
        if origin is not None and origin != f"http://{headers['host']}":
            return f"origin = {origin[:80]!r}; allowed: the page itself"
        if scope["method"] != "GET" and headers.get("sec-fetch-site", "same-origin") != "same-origin":
            return f"sec-fetch-site = {headers['sec-fetch-site'][:80]!r}; allowed: same-origin"
        given = scope["path"].split("/")[1]
        if not secrets.compare_digest(given.encode("utf-8", "replace"), self.token.encode()):
            return "token = another than this server's; allowed: the one in the link that pssf explore prints"
        return None


def _single(scope: Scope) -> Mapping[str, str] | None:
    """Headers by name; None where one that is looked at comes twice."""
    headers: dict[str, str] = {}
    for name, value in scope["headers"]:
        key = name.decode("latin-1").lower()
        if key in headers and key in ("host", "origin", "sec-fetch-site"):
            return None
        headers[key] = value.decode("latin-1")
    return headers


def _with_headers(send: Send) -> Send:
    async def sent(message: Message) -> None:
        if message["type"] == "http.response.start":
            own = {name.lower() for name, _ in message["headers"]}
            more = [(k.lower().encode(), v.encode()) for k, v in HEADERS.items() if k.lower().encode() not in own]
            message = {**message, "headers": [*message["headers"], *more]}
        await send(message)

    return sent


async def body_of(request: Request) -> bytes:
    """The body of a request of JSON.

    raises  RefusedError for another type, or more than MOST_BYTES
    """
    kind = request.headers.get("content-type", "").split(";")[0].strip().lower()
    if kind != "application/json":
        raise RefusedError(400, f"content-type = {kind[:80]!r}; allowed: application/json")
    parts: list[Any] = []
    size = 0
    try:
        async for part in request.stream():
            size += len(part)
            if size > MOST_BYTES:
                raise RefusedError(413, f"request = more than {MOST_BYTES} bytes; allowed: up to {MOST_BYTES}")
            parts.append(part)
    except ClientDisconnect:
        raise RefusedError(400, "request = cut off; allowed: a whole one") from None
    return b"".join(parts)
