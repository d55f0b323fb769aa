"""The window in a browser: what it shows, what it asks for, and how it ends."""

from __future__ import annotations

import re
import signal
import socket
import subprocess
import sys
from collections.abc import Callable, Iterator, Mapping
from http.client import HTTPConnection
from pathlib import Path
from typing import Any
from urllib.parse import parse_qs, urlsplit
from urllib.request import urlopen

import numpy as np
import pytest

from calib_pin.cli import main
from calib_pin.io.robot_shapes import robot_shapes
from calib_pin.io.urdf import load_robot
from calib_pin.kinematics.chains import Chains
from calib_pin.viewer.panel import MAGNIFICATIONS, Controls, Stage, draw_scene, lines
from calib_pin.viewer.scene import Scene, bodies_of

pytestmark = pytest.mark.needs("view")

SETUP = """base: panda_link0
tip: panda_hand
frames:
  base: {xyz: [2.5, 0.6, 0.2], rpy: [0.1, -0.05, 2.0], estimate: true}
  tool: {xyz: [0.0, 0.05, 0.12], estimate: true}
"""


class Viewing:
    """`calib-pin view` in a process of its own."""

    def __init__(self, folder: Path, words: list[str]) -> None:
        program = [sys.executable, "-m", "calib_pin", "view", *words]
        self.process = subprocess.Popen(
            program, cwd=folder, text=True, stdout=-1, stderr=-1
        )
        assert self.process.stdout is not None
        first = self.process.stdout.readline()
        found = re.search(r"http://localhost:\d+/\?token=\S+", first)
        assert found, first + self.process.communicate()[1]
        self.url = found[0]

    def end(self) -> tuple[int, str, str]:
        """Status, and the rest of both outputs."""
        out, err = self.process.communicate(timeout=120)
        return self.process.returncode, out, err


@pytest.fixture
def viewing(tmp_path: Path) -> Iterator[Callable[..., Viewing]]:
    started: list[Viewing] = []

    def start(*words: str) -> Viewing:
        started.append(Viewing(tmp_path, [*words, "--port", "0"]))
        return started[-1]

    yield start
    for one in started:
        one.process.kill()
        one.process.communicate()


@pytest.fixture
def study(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A calibration of the panda, its measurements and a plan, in the folder."""
    monkeypatch.chdir(tmp_path)
    # Its page is not looked at here.
    draw = "calib_pin.cli.calibrate.draw_calibration"
    monkeypatch.setattr(draw, lambda *about: [])
    (tmp_path / "setup.yaml").write_text(SETUP)
    simulate = "simulate example:panda --model position --setup setup.yaml"
    for words in (
        f"{simulate} --count 40 -o rows.csv",
        f"{simulate} --count 5 --seed 1 -o plan.csv",
        "calibrate example:panda rows.csv --setup setup.yaml --holdout 0.2 -o done "
        "--quiet",
    ):
        assert main(words.split()) == 0, words


def looked_at(browser: Any, url: str, last: str) -> str:
    """The text of a page with a canvas, after a look at all that it did.

    Args:
        browser: The browser.
        url: Address of the page.
        last: Text that comes last.
    """
    # Few pixels, few questions: without a graphics card each picture takes its time.
    small = {"width": 600, "height": 200}
    page = browser.new_page(viewport=small, device_scale_factor=0.5)
    complaints: list[str] = []
    hosts: set[str | None] = set()
    page.on("pageerror", lambda error: complaints.append(str(error)))
    page.on("console", lambda m: m.type == "error" and complaints.append(m.text))
    page.on("request", lambda request: hosts.add(host_of(request.url)))
    page.on("websocket", lambda channel: hosts.add(host_of(channel.url)))
    page.goto(url, wait_until="commit")
    page.get_by_text(last, exact=True).first.wait_for(state="attached")
    text, widths = page.evaluate(
        "[document.body.innerText, [...document.querySelectorAll('canvas')]"
        ".map(canvas => canvas.width)]"
    )
    page.close()
    assert complaints == []
    assert hosts == {"localhost"}
    assert max(widths) > 100
    return str(text)


def host_of(url: str) -> str | None:
    return urlsplit(url.removeprefix("blob:")).hostname


@pytest.mark.slow
@pytest.mark.needs("browser")
def test_a_calibration_in_the_browser(browser, viewing, study):
    view = viewing("done/calibration.json", "rows.csv", "--plan", "plan.csv")
    text = looked_at(browser, view.url, "panda_joint1")
    for label in ("panda", "nominal", "corrected", "measurement", "before", "after"):
        assert f"{label}\n" in text
    for label in ("magnified", "Residual map", "Plan"):
        assert f"{label}\n" in text
    assert "\nrows.csv:3\nposition: before" in text
    view.process.send_signal(signal.SIGINT)
    assert view.end() == (0, "\n", "")


@pytest.mark.slow
def test_ctrl_c_ends_it(viewing):
    view = viewing("space6")
    view.process.send_signal(signal.SIGINT)
    assert view.end() == (0, "\n", "")


# --- who is answered ---------------------------------------------------------------


def bare() -> Scene:
    """A robot and nothing else."""
    robot = load_robot("space6")
    shapes = robot_shapes(robot).parts
    bodies = tuple(bodies_of(robot, robot.root, None))
    return Scene("arm", shapes, bodies, Chains(robot, names=()))


@pytest.fixture(scope="module")
def window() -> Iterator[Any]:
    from calib_pin.viewer.server import Window

    files = {"/tab/report.html": ("text/html", b"<p>"), "/tab/a": ("b/c", b"d")}
    window = Window("arm", 0, files.get)
    window.show(bare())
    yield window
    window.close()


def test_a_port_that_is_taken_and_a_token_of_its_own(window, capsys):
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        other = type(window)("arm", port)
        other.close()
    again = type(window)("arm", port)
    again.close()
    assert other.port != port and again.port == port
    tokens = {one.url.partition("=")[2] for one in (window, other, again)}
    assert len(tokens) == 3 and min(map(len, tokens)) >= 22
    assert capsys.readouterr() == ("", "")


GOOD = {"Host": "localhost:{port}"}


@pytest.fixture(scope="module")
def upgrade() -> dict[str, str | None]:
    """What asks for the socket of the page."""
    import viser

    return {
        "Connection": "Upgrade",
        "Upgrade": "websocket",
        "Origin": "http://localhost:{port}",
        "Sec-WebSocket-Version": "13",
        "Sec-WebSocket-Key": "AAAAAAAAAAAAAAAAAAAAAA==",
        "Sec-WebSocket-Protocol": f"viser-v{viser.__version__}",
    }


def asked(
    window: Any, path: str, *headers: Mapping[str, str | None]
) -> tuple[int, str]:
    """Status of a request and where it points.

    In path and headers `{port}` and `{token}` stand for those of the window.
    """
    known = {"port": window.port, "token": window.url.partition("=")[2]}
    given: dict[str, str | None] = {}
    for some in headers:
        given |= some
    connection = HTTPConnection("127.0.0.1", window.port, timeout=20)
    connection.putrequest("GET", path.format(**known), skip_host=True)
    for name, value in given.items():
        if value is not None:
            connection.putheader(name, value.format(**known))
    connection.endheaders()
    response = connection.getresponse()
    connection.close()
    return response.status, response.headers.get("Location", "")


@pytest.mark.parametrize("host", ["localhost:{port}", "127.0.0.1:{port}"])
def test_the_address_opens_the_page_and_its_socket(window, upgrade, host):
    status, place = asked(window, "/?token={token}", {"Host": host})
    assert status == 302
    assert asked(window, place, {"Host": host}) == (200, "")
    (target,) = parse_qs(urlsplit(place).query)["websocket"]
    path = target.removeprefix("ws://")
    path = path[path.index("/") :]
    origin = {"Host": host, "Origin": f"http://{host}"}
    assert asked(window, path, upgrade, origin) == (101, "")


def test_files_are_served_and_can_do_nothing_to_the_page(window):
    for path, kind, content in (
        ("/tab/report.html", "text/html", b"<p>"),
        ("/tab/a", "b/c", b"d"),
    ):
        with urlopen(f"http://localhost:{window.port}{path}?token={window.token}") as a:
            assert a.read() == content and a.headers["Content-Type"] == kind
            assert a.headers["Content-Security-Policy"].startswith("sandbox")


def test_a_tab_that_is_loaded_again_has_its_name(window):
    places = [asked(window, "/?token={token}", GOOD)[1] for _ in range(2)]
    first, second = (parse_qs(urlsplit(place).query)["token"][0] for place in places)
    assert first != second
    assert {t.partition(".")[0] for t in (first, second)} == {window.token}
    again = asked(window, f"/?token={first}", GOOD)[1]
    assert parse_qs(urlsplit(again).query)["token"] == [first]


STRANGE: list[tuple[str, dict[str, str | None]]] = [
    ("/", {}),
    ("/index.html", {}),
    ("/?token=", {}),
    ("/?token=\N{LATIN SMALL LETTER A}{token}", {}),
    ("/?token=%ff{token}", {}),
    ("/?other={token}", {}),
    ("//[?token=", {}),
    ("/tab/report.html", {}),
    ("/tab/report.html?token=other", {}),
    ("/tab/a?token={token}", {"Origin": "http://evil.example"}),
    ("/tab/a?token={token}", {"Host": "evil.example:{port}"}),
    ("/?token={token}", {"Host": None}),
    ("/?token={token}", {"Host": "localhost"}),
    ("/?token={token}", {"Host": "localhost:1"}),
    ("/?token={token}", {"Host": "evil.example:{port}"}),
    ("/?token={token}", {"Origin": "http://evil.example"}),
    ("/?token={token}", {"Origin": "null"}),
]
"""What a page of somebody else, or another program, may ask."""


def test_nobody_else_is_answered(window, upgrade, capfd):
    for path, changes in STRANGE:
        assert asked(window, path, GOOD, changes) == (403, ""), (path, changes)
    assert asked(window, "/", GOOD, upgrade) == (403, "")
    for origin in (
        *(None, "http://evil.example"),
        *("https://localhost:{port}", "http://localhost:1"),
    ):
        changes = {**upgrade, "Origin": origin}
        assert asked(window, "/?token={token}", GOOD, changes) == (403, ""), origin
    other = {**upgrade, "Host": "evil.example:{port}"}
    assert asked(window, "/?token={token}", other) == (403, "")
    assert capfd.readouterr() == ("", "")


def test_a_server_that_cannot_be_guarded_does_not_start(monkeypatch):
    from calib_pin.viewer import server

    monkeypatch.setattr(server, "_LocalServer", lambda *words, **options: None)
    with pytest.raises(RuntimeError, match="viser"):
        server.Window("arm", 0)


# --- in this process ---------------------------------------------------------------


def test_controls_do_what_they_say(scene, viser_server, monkeypatch):
    """All of a scene with measurements, a plan and corrections."""
    known: dict[str, tuple[Any, Callable[[Any], None]]] = {}
    listen = Controls.on

    def on(self: Controls, control: Any, do: Callable[[Any], None]) -> None:
        known[control.label] = control, do
        listen(self, control, do)

    monkeypatch.setattr(Controls, "on", on)
    drawn, draw = dict[str, Any](), viser_server.scene.add_line_segments
    monkeypatch.setattr(
        viser_server.scene,
        "add_line_segments",
        lambda name, *of, **more: drawn.setdefault(name, draw(name, *of, **more)),
    )
    stage = draw_scene(viser_server, scene)
    assert {"measurement", "magnified", "nominal", "after"} <= known.keys()
    assert scene.rows is not None and scene.plan is not None
    known["measurement"][1](4)
    moved = known["panda_joint3"][0].value
    column = scene.rows.data.joints.index("panda_joint3")
    assert moved == pytest.approx(np.rad2deg(scene.rows.data.q[3, column]), abs=0.01)
    known["configuration"][1](3)
    planned = known["panda_joint3"][0].value
    assert planned == pytest.approx(np.rad2deg(scene.plan[2, column]), abs=0.01)
    known["nominal"][1](False)
    assert not stage.robots["nominal"].root.visible
    known["panda_joint3"][1](moved + 0.1)
    errors, factor = scene.rows.stages["after"], MAGNIFICATIONS[5]
    known["magnified"][1](str(factor))
    vectors = lines(errors, float(factor))
    np.testing.assert_array_equal(drawn["/after"].points, vectors)
    length = factor * errors.vectors
    np.testing.assert_allclose(vectors[:, 1] - vectors[:, 0], length, atol=1e-6)


def test_links_are_magnified(scene, viser_server):
    stage = Stage(viser_server, scene)
    stage.pose(scene.start + 0.1, "")
    corrected, ghost = stage.robots["corrected"], stage.robots["nominal"]
    links = scene.bodies[0].skeleton.links
    tip, base = links.index(scene.shapes[-1].link), links.index("panda_link0")
    placed = {1.0: corrected.frames[tip].position.copy()}
    for factor in (0.0, 1.0, 5.0):
        stage.magnify(factor)
        placed[factor] = corrected.frames[tip].position.copy()
    move = placed[1.0] - placed[0.0]
    size = np.linalg.norm(move)
    assert size > 1e-4
    np.testing.assert_allclose(placed[5.0] - placed[0.0], 5.0 * move, atol=0.25 * size)
    # What is in one place is drawn once.
    assert not ghost.frames[base].visible and ghost.frames[tip].visible
    stage.magnify(0.0)
    assert not any(frame.visible for frame in ghost.frames.values())
