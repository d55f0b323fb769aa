"""The window: a server on this machine, for a browser on this machine.

Other users of the machine, and any page that the browser shows, can reach its port.
So it answers nothing but requests that hold its token, are meant for it, and come,
where a page sends them, from its own.
"""

from __future__ import annotations

import contextlib
import hmac
import io
import secrets
import time
from collections.abc import Callable, Iterator
from contextvars import ContextVar
from http import HTTPStatus
from typing import Any
from urllib.parse import parse_qs, urlencode

import viser
import websockets.asyncio.server
from websockets.asyncio.server import ServerConnection
from websockets.datastructures import Headers
from websockets.http11 import Request, Response

from calib_pin.viewer.panel import draw_scene
from calib_pin.viewer.scene import Scene

HOST = "127.0.0.1"

PAUSE = 0.2
"""Time between two looks at what pages say [s]."""

TAB: ContextVar[str] = ContextVar("TAB", default="")
"""Name of the tab whose connection is served: loaded again, it is the same."""

HARMLESS = {
    "Content-Security-Policy": "sandbox allow-scripts allow-popups",
    "X-Content-Type-Options": "nosniff",
}
"""Headers with which a file in a page of its own can do nothing to ours."""

Tick = Callable[[], None]
"""Shows what has changed."""

Serve = Callable[[str], tuple[str, bytes] | None]
"""The type and the content of a file, by the path of its address; None for none."""


class _LocalServer(viser.ViserServer):
    """A server that shows nothing to anyone elsewhere."""

    def request_share_url(self, verbose: bool = True) -> str | None:
        """Refuse what any page could ask for: a tunnel into the network."""
        return None


class Window:
    """Pages that browsers can open.

    Args:
        title: What stands above the controls.
        port: Port that is wanted; a free one above if it cannot be used, any for 0.
        serve: Files that the pages lead to.

    Attributes:
        port: Port that it is.
        token: What opens it.
        url: Address of the page, with the token.
    """

    def __init__(self, title: str, port: int, serve: Serve = lambda _: None) -> None:
        """Start the server; nothing is shown yet."""
        self.token = secrets.token_urlsafe(16)
        with _unheard(), _guarded(self.token, serve):
            self._server = _LocalServer(HOST, port, verbose=False)
        self.port = self._server.get_port()
        self.url = f"http://localhost:{self.port}/?token={self.token}"
        self._server.gui.set_panel_label(title)
        self._server.gui.configure_theme(show_logo=False, show_share_button=False)
        self._server.gui.main_panel.dock_right()
        self._ticks = dict[int, Tick]()

    def show(self, scene: Scene) -> None:
        """Show one scene in all tabs."""
        draw_scene(self._server, scene).see(self._server.initial_camera)

    def welcome(self, page: Callable[[viser.ClientHandle, str], Tick]) -> None:
        """Give every tab, which has a name, a page of its own."""

        # Neither waits, so that both run where the connection is served.
        async def come(client: viser.ClientHandle) -> None:
            self._ticks[client.client_id] = page(client, TAB.get())

        async def go(client: viser.ClientHandle) -> None:
            self._ticks.pop(client.client_id, None)

        self._server.on_client_connect(come)
        self._server.on_client_disconnect(go)

    def run(self) -> None:
        """Serve until interrupted."""
        while True:
            time.sleep(PAUSE)
            for tick in [*self._ticks.values()]:
                tick()

    def close(self) -> None:
        """Stop the server."""
        with _unheard():
            self._server.stop()


@contextlib.contextmanager
def _guarded(token: str, files: Serve) -> Iterator[None]:
    """Make the server that starts inside answer only those who know the token.

    viser has no way to ask for that, but for the library that serves it.
    """
    served = websockets.asyncio.server.serve
    started: list[bool] = []

    def serve(handle: Any, *words: Any, process_request: Any, **options: Any) -> Any:
        def answer(connection: ServerConnection, request: Request) -> Response | None:
            first = _early_answer(connection, request, token, files)
            return first or process_request(connection, request)

        async def named(connection: ServerConnection) -> None:
            assert connection.request is not None
            TAB.set(_given(connection.request)[1])
            await handle(connection)

        started.append(True)
        return served(named, *words, process_request=answer, **options)

    websockets.asyncio.server.serve = serve
    try:
        yield
    finally:
        websockets.asyncio.server.serve = served
    if not started:
        raise RuntimeError("this version of viser does not start its server as known")


def _given(request: Request) -> tuple[str, str]:
    """The token that a request holds, and the name of its tab behind a point.

    Both are one entry of the address: browsers show, and load again, another address
    in it with one entry only.
    """
    query = parse_qs(request.path.partition("?")[2])
    token, _, tab = query.get("token", [""])[0].partition(".")
    return token, tab


def _early_answer(
    connection: ServerConnection, request: Request, token: str, files: Serve
) -> Response | None:
    """The answer that needs no look at the content; None for a good request."""
    port = connection.local_address[1]
    hosts = [f"{name}:{port}" for name in ("localhost", HOST)]
    host, origin = map(request.headers.get_all, ("Host", "Origin"))
    given, tab = _given(request)
    socket_wanted = "Upgrade" in request.headers
    if (
        len(host) != 1
        or host[0] not in hosts
        or ((origin or socket_wanted) and origin != [f"http://{host[0]}"])
        or not hmac.compare_digest(given.encode(), token.encode())
    ):
        reason = "open the address that calib-pin has printed, with its token\n"
        return connection.respond(HTTPStatus.FORBIDDEN, reason)
    path, _, query = request.path.partition("?")
    if socket_wanted or "websocket" in parse_qs(query):
        return None
    if (file := files(path)) is not None:
        headers = Headers(HARMLESS)
        headers["Content-Type"], headers["Content-Length"] = file[0], str(len(file[1]))
        return Response(200, "OK", headers, file[1])
    # The page opens its socket without the token unless its address says where.
    known = {"token": f"{token}.{tab or secrets.token_urlsafe(8)}"}
    known["websocket"] = f"ws://{host[0]}/?{urlencode(known)}"
    redirect = connection.respond(HTTPStatus.FOUND, "")
    redirect.headers["Location"] = f"/?{urlencode(known)}"
    return redirect


def _unheard() -> contextlib.AbstractContextManager[object]:
    """Suppresses what viser prints at its start and end."""
    return contextlib.redirect_stdout(io.StringIO())
