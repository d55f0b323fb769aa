"""The window: a server on this machine, for a browser on this machine."""

from __future__ import annotations

import contextlib
import io
import socket
import time
from collections.abc import Callable

import viser

from calib_pin.viewer.controls import Controls
from calib_pin.viewer.panel import add_panel
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
        port: Port that is wanted; a free one if it cannot be used, or for 0.

    Attributes:
        port: Port that it is.
    """

    def __init__(self, scene: Scene, port: int) -> None:
        """Start the server and draw the scene."""
        with _unheard():
            self._server = _LocalServer(HOST, _usable(port), verbose=False)
        self.port = self._server.get_port()
        self._server.gui.set_panel_label(scene.title)
        self._server.gui.configure_theme(show_logo=False, show_share_button=False)
        self._server.gui.main_panel.dock_right()
        controls = Controls(self._server.gui)
        self._player = add_panel(controls, scene, Stage(self._server, scene))

    def run(self, once: bool, now: Callable[[], float] = time.monotonic) -> None:
        """Serve until interrupted or, with `once`, until the last browser has gone.

        The clock `now` is in seconds.
        """
        seen, last = False, now()
        left = last
        while not (once and seen and last - left > GRACE):
            time.sleep(PERIOD)
            before, last = last, now()
            if self._player is not None:
                self._player.tick(last - before)
            if self._server.get_clients():
                seen, left = True, last

    def close(self) -> None:
        """Stop the server."""
        with _unheard():
            self._server.stop()


def _unheard() -> contextlib.AbstractContextManager[object]:
    """Suppresses what viser prints at its start and end."""
    return contextlib.redirect_stdout(io.StringIO())


def _usable(port: int) -> int:
    """The port if a server can have it, or else a free one."""
    for wanted in (port, 0):
        with (
            contextlib.suppress(OSError),
            socket.create_server((HOST, wanted)) as probe,
        ):
            return int(probe.getsockname()[1])
    return port
