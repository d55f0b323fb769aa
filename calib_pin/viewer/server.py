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
from collections.abc import Iterator
from http import HTTPStatus
from typing import Any
from urllib.parse import parse_qs, urlencode

import viser
import websockets.asyncio.server
from websockets.asyncio.server import ServerConnection
from websockets.http11 import Request, Response

from calib_pin.viewer.panel import Controls, add_panel
from calib_pin.viewer.scene import Scene
from calib_pin.viewer.stage import Stage

HOST = "127.0.0.1"

PERIOD = 0.04
"""Time between two frames of a motion [s]."""

GRACE = 2.0
"""Time in which a window may come back: pages are loaded again [s]."""


class _LocalServer(viser.ViserServer):
    """A server that shows nothing to anyone elsewhere."""

    def request_share_url(self, verbose: bool = True) -> str | None:
        """Refuse what any page could ask for: a tunnel into the network."""
        return None


class Window:
    """A scene that browsers can open.

    Args:
        scene: The scene to show.
        port: Port that is wanted; a free one above if it cannot be used, any for 0.

    Attributes:
        port: Port that it is.
        url: Address of the page, with the token that opens it.
    """

    def __init__(self, scene: Scene, port: int) -> None:
        """Start the server and draw the scene."""
        token = secrets.token_urlsafe(16)
        with _unheard(), _guarded(token):
            self._server = _LocalServer(HOST, port, verbose=False)
        self.port = self._server.get_port()
        self.url = f"http://localhost:{self.port}/?token={token}"
        self._server.gui.set_panel_label(scene.title)
        self._server.gui.configure_theme(show_logo=False, show_share_button=False)
        self._server.gui.main_panel.dock_right()
        controls = Controls(self._server.gui)
        self._player = add_panel(controls, scene, Stage(self._server, scene))

    def run(self, once: bool) -> None:
        """Serve until interrupted or, with `once`, until the last browser has gone."""
        seen, left = False, time.monotonic()
        last = left
        while not (once and seen and last - left > GRACE):
            time.sleep(PERIOD)
            before, last = last, time.monotonic()
            if self._player is not None:
                self._player.tick(last - before)
            if self._server.get_clients():
                seen, left = True, last

    def close(self) -> None:
        """Stop the server."""
        with _unheard():
            self._server.stop()


@contextlib.contextmanager
def _guarded(token: str) -> Iterator[None]:
    """Make the server that starts inside answer only those who know the token.

    viser has no way to ask for that, but for the library that serves it.
    """
    served = websockets.asyncio.server.serve
    started: list[bool] = []

    def serve(*words: Any, process_request: Any, **options: Any) -> Any:
        def answer(connection: ServerConnection, request: Request) -> Response | None:
            first = _answer(connection, request, token)
            return first or process_request(connection, request)

        started.append(True)
        return served(*words, process_request=answer, **options)

    websockets.asyncio.server.serve = serve
    try:
        yield
    finally:
        websockets.asyncio.server.serve = served
    if not started:
        raise RuntimeError("this version of viser does not start its server as known")


def _answer(
    connection: ServerConnection, request: Request, token: str
) -> Response | None:
    """The answer that needs no look at the content; None for a good request."""
    port = connection.local_address[1]
    own = [f"{name}:{port}" for name in ("localhost", HOST)]
    host, origin = map(request.headers.get_all, ("Host", "Origin"))
    query = parse_qs(request.path.partition("?")[2])
    given = query.get("token", [""])[0]
    socket_wanted = "Upgrade" in request.headers
    if (
        len(host) != 1
        or host[0] not in own
        or ((origin or socket_wanted) and origin != [f"http://{host[0]}"])
        or not hmac.compare_digest(given.encode(), token.encode())
    ):
        reason = "open the address that calib-pin has printed, with its token\n"
        return connection.respond(HTTPStatus.FORBIDDEN, reason)
    if socket_wanted or "websocket" in query:
        return None
    # The page opens its socket without the token unless its address says where.
    known = {"token": token}
    known["websocket"] = f"ws://{host[0]}/?{urlencode(known)}"
    found = connection.respond(HTTPStatus.FOUND, "")
    found.headers["Location"] = f"/?{urlencode(known)}"
    return found


def _unheard() -> contextlib.AbstractContextManager[object]:
    """Suppresses what viser prints at its start and end."""
    return contextlib.redirect_stdout(io.StringIO())
