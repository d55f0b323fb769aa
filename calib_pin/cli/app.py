"""`calib-pin app`: `init`, `calibrate`, `view` and `watch` behind a page."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any
from urllib.parse import unquote

from calib_pin.cli.asked import App
from calib_pin.cli.view import require_viser, serve

TYPES, BYTES = {".html": "text/html; charset=utf-8"}, "application/octet-stream"


def app(asked: App) -> int:
    """Do what `App` asks for."""
    require_viser()
    from calib_pin.cli.page_job import Job
    from calib_pin.viewer.app import Page
    from calib_pin.viewer.server import Window

    jobs, start = dict[str, Job](), Path.cwd()

    def file(path: str) -> tuple[str, bytes] | None:
        tab, _, name = unquote(path[1:]).partition("/")
        content = jobs[tab].files.get(name) if tab in jobs else None
        return None if content is None else (TYPES.get(name[-5:], BYTES), content)

    def page(client: Any, tab: str) -> Callable[[], None]:
        if tab not in jobs:
            home, to = Path(folder, str(len(jobs))), f"/{tab}/{{}}?token={window.token}"
            home.mkdir()
            jobs[tab] = Job(home, start, to, worker.submit)
        return Page(client, client.camera, jobs[tab].sections).tick

    # One worker: jobs share remarks, the working folder and the processors.
    worker = ThreadPoolExecutor(1)
    with TemporaryDirectory(prefix="calib-pin-") as folder:
        window = Window("calib-pin", asked.port, file)
        window.welcome(page)
        serve(asked, window)
        for job in jobs.values():
            job.stopped.set()
        worker.shutdown(cancel_futures=True)
    return 0
