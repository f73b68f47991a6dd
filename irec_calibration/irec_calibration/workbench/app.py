# SPDX-License-Identifier: Apache-2.0
"""The server of the workbench: loopback unless told otherwise, a token in the URL when bound wider, nothing from the network."""

from __future__ import annotations

import ipaddress
import secrets
import sys
from dataclasses import dataclass
from http.cookies import SimpleCookie
from pathlib import Path
from typing import Any
from urllib.parse import parse_qs, urlsplit

from ..errors import IrecError

COOKIE = "irec_token"


@dataclass(frozen=True)
class Settings:
    """What the command line asked for. `out`: where models, plans and reports go; `root`: where unsaved versions are kept;
    `calibrations`: folder of calibration_node, for the page `/cell`."""

    session: str
    model: str
    cell: str
    out: Path
    root: Path
    effect_files: tuple[str, ...] = ()
    host: str = "127.0.0.1"
    port: int = 8080
    show: bool = True
    follow: bool = False
    calibrations: Path = Path("calibrations")

    @property
    def local(self) -> bool:
        """Whether only this machine can reach it."""
        return is_loopback(self.host)


def is_loopback(host: str) -> bool:
    """Whether an address to bind to is reachable from this machine only."""
    if host == "localhost":
        return True
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


class Guard:
    """Lets nobody in who has no business here.

    On loopback: only requests that name this machine as their host, so that a page from elsewhere can't reach it through a name
    that it points at 127.0.0.1; and no websocket from another origin. Bound wider: only with the token.
    """

    def __init__(self, app: Any, token: str = "") -> None:
        self.app = app
        self.token = token

    async def __call__(self, scope: Any, receive: Any, send: Any) -> None:
        if scope["type"] not in ("http", "websocket"):
            await self.app(scope, receive, send)
            return
        headers = {k.decode().lower(): v.decode("latin-1") for k, v in scope["headers"]}
        why = self.refusal(headers, scope.get("query_string", b"").decode("latin-1"))
        if why:
            await _refuse(scope, send, why)
            return
        given = parse_qs(scope.get("query_string", b"").decode("latin-1")).get("token", [""])[0]
        if not (self.token and given and scope["type"] == "http"):
            await self.app(scope, receive, send)
            return

        async def with_cookie(message: Any) -> None:
            if message["type"] == "http.response.start":
                value = f"{COOKIE}={self.token}; Path=/; HttpOnly; SameSite=Strict".encode()
                message = {**message, "headers": [*message.get("headers", []), (b"set-cookie", value)]}
            await send(message)

        await self.app(scope, receive, with_cookie)

    def refusal(self, headers: dict[str, str], query: str) -> str:
        """Why a request is refused, or an empty string."""
        host = headers.get("host", "")
        origin = headers.get("origin", "")
        if origin and urlsplit(origin).netloc != host:
            return "a page from elsewhere asked for this"
        if self.token:
            cookie = SimpleCookie(headers.get("cookie", ""))
            given = parse_qs(query).get("token", [""])[0] or (cookie[COOKIE].value if COOKIE in cookie else "")
            return (
                "" if secrets.compare_digest(given, self.token) else "open the address with its token, as the terminal shows it"
            )
        name = urlsplit(f"//{host}").hostname or ""
        return "" if is_loopback(name) else f"the request names {name!r} as its host; this page is for this machine only"


async def _refuse(scope: Any, send: Any, why: str) -> None:
    if scope["type"] == "websocket":
        await send({"type": "websocket.close", "code": 1008, "reason": why})
        return
    body = f"irec workbench: refused: {why}\n".encode()
    head = [(b"content-type", b"text/plain; charset=utf-8"), (b"content-length", str(len(body)).encode())]
    await send({"type": "http.response.start", "status": 403, "headers": head})
    await send({"type": "http.response.body", "body": body})


def serve(settings: Settings) -> None:
    """Run the server until it is ended. Raises IrecError where NiceGUI is not installed or the port is taken."""
    try:
        from nicegui import app, ui
    except ImportError as error:
        raise IrecError("the workbench needs NiceGUI: pip install 'irec_calibration[workbench]'") from error
    from .pages import Pages

    _check_port(settings.host, settings.port)
    token = "" if settings.local else secrets.token_urlsafe(16)
    app.add_middleware(Guard, token=token)
    pages = Pages(settings)
    pages.register()
    if settings.session:
        app.on_startup(pages.warm)
    app.on_shutdown(pages.close)
    shown = settings.host if settings.host not in ("0.0.0.0", "::") else "THIS-MACHINE"
    url = f"http://{f'[{shown}]' if ':' in shown else shown}:{settings.port}/" + (f"?token={token}" if token else "")
    print(f"irec workbench: open {url}  (Ctrl-C ends it)", flush=True)
    if not settings.local:
        print("irec workbench: reachable from other machines: whoever has this address can use it", file=sys.stderr, flush=True)
    ui.run(
        host=settings.host,
        port=settings.port,
        title="irec workbench",
        reload=False,
        show=settings.show and settings.local,
        show_welcome_message=False,
        dark=None,
        favicon=FAVICON,
        reconnect_timeout=30.0,
    )


FAVICON = (
    "data:image/svg+xml;utf8,<svg xmlns='http://www.w3.org/2000/svg' viewBox='0 0 16 16'><path d='M2 13 L6 7 L11 9 L14 3' "
    "stroke='%230072B2' stroke-width='2.5' fill='none'/></svg>"
)


def _check_port(host: str, port: int) -> None:
    import socket

    try:
        found = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
    except OSError as error:
        raise IrecError(f"--host {host}: no address of this machine: {error}") from error
    with socket.socket(found[0], socket.SOCK_STREAM) as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind(found[4])
        except OSError as error:
            raise IrecError(f"port {port} of {host} can't be used ({error.strerror}); choose another one with --port") from error
