"""Access checks of the explore server: token, host, origin and size of requests."""

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

# Maximum size of a request body, in bytes.
MAX_BODY_BYTES = 65_536
_ALLOWED_HOSTS = ("127.0.0.1", "localhost")
# Content security policy: the browser loads only files of the page, and no other site can embed the page.
CONTENT_SECURITY_POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self'; connect-src 'self'; frame-src 'self'; "
    "base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)
SECURITY_HEADERS = {
    "Content-Security-Policy": CONTENT_SECURITY_POLICY,
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cache-Control": "no-store",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
}


class RefusedError(Exception):
    """Error raised when the server rejects a request.

    Parameters
    ----------
    status : int
        HTTP status code.
    why : str
        Reason for the rejection, which is shown to the user.
    """

    def __init__(self, status: int, why: str) -> None:
        super().__init__(why)
        self.status = status


def make_error_response(status: int, reason: str) -> JSONResponse:
    """Create a JSON error response.

    Parameters
    ----------
    status : int
        HTTP status code.
    reason : str
        Error message for the user.

    Returns
    -------
    JSONResponse
        Response with the message under the JSON key ``error``.
    """
    return JSONResponse({"error": reason}, status)


def build_page_policy(page: str) -> str:
    """Build the Content-Security-Policy header for a page with inline scripts and styles.

    Parameters
    ----------
    page : str
        Content of the HTML page.

    Returns
    -------
    str
        Policy that allows only the inline scripts and styles of the page, identified by their hashes.
    """
    blocks = {
        kind: re.findall(rf"<{kind}>(.*?)</{kind}>", page, re.DOTALL | re.IGNORECASE) for kind in ("script", "style")
    }
    allowed = {kind: " ".join(map(_hash_source, blocks_of_kind)) for kind, blocks_of_kind in blocks.items()}
    return (
        f"default-src 'none'; script-src {allowed['script']}; style-src {allowed['style']}; img-src data:; "
        "base-uri 'none'; form-action 'none'; frame-ancestors 'self'"
    )


def _hash_source(text: str) -> str:
    """Return the hash with which a content security policy identifies an inline script or style."""
    return f"'sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()}'"


@dataclass(frozen=True)
class RequestGuard:
    """ASGI application that rejects requests from other sites, and adds security headers to every response.

    Parameters
    ----------
    app : ASGIApp
        Application that receives the accepted requests.
    token : str
        Secret token, which is the first part of the path in every URL.
    port : int
        Port of the server.
    """

    app: ASGIApp
    token: str
    port: int

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "http":
            await self.app(scope, receive, send)
            return
        why = self._find_fault(scope)
        if why is not None:
            await make_error_response(403, why)(scope, receive, _add_security_headers(send))
            return
        await self.app(scope, receive, _add_security_headers(send))

    def _find_fault(self, scope: Scope) -> str | None:
        """Return the reason for rejecting a request, or None if the request is accepted."""
        headers = _read_headers(scope)
        if headers is None:
            return "Host, Origin and Sec-Fetch-Site must each occur at most once, got a repeated header"
        names = [f"{host}:{self.port}" for host in _ALLOWED_HOSTS]
        if headers.get("host") not in names:
            return f"host must be {' or '.join(names)}, got {headers.get('host', '')[:80]!r}"
        origin = headers.get("origin")
        if origin is not None and origin != f"http://{headers['host']}":
            return f"origin must be the address of the explore page, got {origin[:80]!r}"
        if scope["method"] != "GET" and headers.get("sec-fetch-site", "same-origin") != "same-origin":
            return f"sec-fetch-site must be same-origin, got {headers['sec-fetch-site'][:80]!r}"
        given = scope["path"].split("/")[1]
        if not secrets.compare_digest(given.encode("utf-8", "replace"), self.token.encode()):
            return "token must be the token of the running server, got another token: use the link from pssf explore"
        return None


def _read_headers(scope: Scope) -> Mapping[str, str] | None:
    """Return the request headers, keyed by name, or None if a header used for access checks is repeated."""
    headers: dict[str, str] = {}
    for name, value in scope["headers"]:
        key = name.decode("latin-1").lower()
        if key in headers and key in ("host", "origin", "sec-fetch-site"):
            return None
        headers[key] = value.decode("latin-1")
    return headers


def _add_security_headers(send: Send) -> Send:
    """Wrap a send function so that every response contains the security headers."""

    async def sent(message: Message) -> None:
        if message["type"] == "http.response.start":
            own = {name.lower() for name, _ in message["headers"]}
            more = [
                (k.lower().encode(), v.encode()) for k, v in SECURITY_HEADERS.items() if k.lower().encode() not in own
            ]
            message = {**message, "headers": [*message["headers"], *more]}
        await send(message)

    return sent


async def read_json_body(request: Request) -> bytes:
    """Read the body of an HTTP request with JSON content.

    Parameters
    ----------
    request : Request
        HTTP request.

    Returns
    -------
    bytes
        Body of the request.

    Raises
    ------
    RefusedError
        If the content type is not JSON, or the body is incomplete or larger than `MAX_BODY_BYTES`.
    """
    kind = request.headers.get("content-type", "").split(";")[0].strip().lower()
    if kind != "application/json":
        raise RefusedError(400, f"content-type must be application/json, got {kind[:80]!r}")
    parts: list[Any] = []
    size = 0
    try:
        async for part in request.stream():
            size += len(part)
            if size > MAX_BODY_BYTES:
                raise RefusedError(413, f"request must be at most {MAX_BODY_BYTES} bytes, got a longer one")
            parts.append(part)
    except ClientDisconnect:
        message = "request must have a complete body, got an incomplete body: repeat the request"
        raise RefusedError(400, message) from None
    return b"".join(parts)
