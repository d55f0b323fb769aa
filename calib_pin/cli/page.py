"""`calib-pin app`: `init`, `calibrate`, `view` and `watch` behind a page."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated, Any

import calib_pin.cli.options as options
from calib_pin.cli.request import Told
from calib_pin.cli.view import PORT, require_viser, serve


@dataclass(frozen=True, kw_only=True)
class App:
    """A page as it is asked for.

    Attributes:
        port: Port on this machine; 0 for any free port.
        once: Stop when the last tab is closed.
    """

    port: Annotated[int, Told("N", "Window", PORT)] = 8080
    once: Annotated[bool, Told("", "Window")] = False


@options.spread
def app(asked: App) -> int:
    """Calibrate in a page of the browser, from two files to a corrected URDF.

    A robot and measurements are dropped or chosen there; the page shows what was found,
    calibrates, and has the results to download. It is open to this machine only, at the
    address that is printed. Every tab is a job of its own. What is dropped goes to a
    temporary folder, which is removed at the end.
    """
    require_viser()
    from calib_pin.cli.page_job import Jobs
    from calib_pin.viewer.app import Page
    from calib_pin.viewer.server import Window

    def page(client: Any, tab: str) -> Callable[[float], None]:
        job = jobs.of(tab, f"/{tab}/{{}}?token={window.token}")
        return Page(client, client.camera, job).tick

    # One worker: jobs share remarks, the working folder and the processors.
    with (
        TemporaryDirectory(prefix="calib-pin-") as folder,
        ThreadPoolExecutor(1) as one,
    ):
        jobs = Jobs(Path(folder), one.submit)
        window = Window("calib-pin", asked.port, jobs.file)
        window.welcome(page)
        serve(window, asked.port, asked.once)
        jobs.stop()
    return 0
