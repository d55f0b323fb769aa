"""The pictures of `calib-pin app` in the documents, taken in Chromium.

`python -m documentation.page_pictures` writes them; it needs the groups `view` and
`browser` and Chromium itself, and no two browsers draw the same bytes, so that they are
no part of what is generated and compared.
"""

from __future__ import annotations

import io
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

from PIL import Image
from playwright.sync_api import Page, sync_playwright

from calib_pin.io.urdf import bundled_robots

ROOT = Path(__file__).parents[2]

SIZE = {"width": 1100, "height": 660}

SOFTWARE = ["--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
"""WebGL without a graphics card."""

WAIT = 3000.0
"""Time to draw a scene [ms]."""


def picture(page: Page, name: str) -> None:
    """Write what a page shows, without its notifications, in few colors."""
    page.wait_for_timeout(WAIT)
    page.add_style_tag(content="[class*=Notification] {display: none}")
    shown = Image.open(io.BytesIO(page.screenshot()))
    shown.convert("RGB").quantize(64).save(ROOT / "docs/pictures" / name, optimize=True)


def main() -> None:
    """Go the whole way of the how-to, with a bundled robot under other names."""
    source = bundled_robots()["pa10"]
    words = [sys.executable, "-u", "-m", "calib_pin", "app", "--port", "0"]
    with (
        tempfile.TemporaryDirectory() as folder,
        subprocess.Popen(words, cwd=folder, text=True, stdout=-1) as process,
        sync_playwright() as playwright,
    ):
        robot, rows = (Path(folder, name) for name in ("robot.urdf", "tracker.csv"))
        shutil.copy(source, robot)
        shutil.copy(source.with_name("measurements.csv"), rows)
        assert process.stdout is not None
        browser = playwright.chromium.launch(
            executable_path=shutil.which("chromium"), args=["--no-sandbox", *SOFTWARE]
        )
        page = browser.new_page(viewport=SIZE)
        page.goto(process.stdout.readline().split()[2], wait_until="commit")
        page.get_by_text("Begin with the robot").wait_for()
        upload = page.locator("input[type=file]")
        upload.set_input_files(robot)
        page.get_by_text("Now the measurements").wait_for()
        upload.set_input_files(rows)
        page.get_by_role("button", name="Calibrate").wait_for(timeout=120_000)
        picture(page, "page-found.png")
        page.get_by_role("button", name="Calibrate").click()
        page.get_by_text("GOOD: ").wait_for(timeout=120_000)
        picture(page, "page-result.png")
        browser.close()
        process.terminate()


if __name__ == "__main__":
    main()
