"""`calib-pin watch` with files that another process writes, and typed readings."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from calib_pin.cli.init import reading
from calib_pin.cli.watch import _rewrite, display
from calib_pin.errors import InputError
from calib_pin.guidance import Event
from calib_pin.io.columns import LENGTH
from tests.cli.files import document

MAIN = "import sys; from calib_pin.cli import main; sys.exit(main())"
COMMAND = (sys.executable, "-c", MAIN, "watch", "arm.urdf", "watched.csv")
PLACES = dict.fromkeys("xyz", LENGTH)
LENGTHS = {"distance": LENGTH}


@contextmanager
def watching(*words: str) -> Iterator[subprocess.Popen[str]]:
    """The command in a process of its own, ended whatever happens."""
    environment = {**os.environ, "OMP_NUM_THREADS": "1"}
    with subprocess.Popen(
        [*COMMAND, *words],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env=environment,
    ) as process:
        try:
            yield process
        finally:
            process.kill()


def until(process: subprocess.Popen[str], text: str) -> str:
    """The first line that a process prints with some text in it."""
    assert process.stdout is not None
    return next(line for line in process.stdout if text in line)


@pytest.mark.slow
def test_rows_that_another_process_appends(here: Path):
    lines = Path("rows.csv").read_text().splitlines(keepends=True)
    with (
        Path("watched.csv").open("w") as file,
        watching("--setup", "setup.yaml", "-o", "out", "--json") as process,
    ):
        file.write("".join(lines[:18]))
        file.flush()
        first = json.loads(until(process, '"state"'))
        assert first["rows"] == 16 and first["verdict"] == "good"
        cells = lines[18].split(",")
        cells[4] = str(float(cells[4]) + 0.01)
        start = time.monotonic()
        file.write(",".join(cells))
        file.flush()
        row = json.loads(until(process, '"row"'))
        assert row["place"] == "watched.csv:19" and row["wrong"]
        assert time.monotonic() - start < 30.0
        process.send_signal(signal.SIGINT)
        assert process.stdout is not None
        rest = process.stdout.read()
        assert process.wait() == 0
    result = document("out")
    assert result["verdict"]["status"] == "good" and '"format"' in rest
    assert Path("out/arm.urdf").exists()
    assert result["provenance"]["command"][1:4] == [
        "calibrate",
        "arm.urdf",
        "watched.csv",
    ]


@pytest.mark.slow
def test_typed_readings_survive_a_kill(here: Path, run):
    run("plan arm.urdf --model position --count 12 --method greedy -o plan.csv")
    words = ("--plan", "plan.csv", "--type", "--model", "position")
    words += ("--parameters", "joint-offset")
    with watching(*words) as process:
        assert process.stdin is not None
        for text in ("700,5 -20 1250 mm", "skip", "690 15 1240.5"):
            process.stdin.write(f"{text}\n")
            process.stdin.flush()
        while (
            Path("watched.csv").read_text().count("\n") < 3
            if Path("watched.csv").exists()
            else True
        ):
            time.sleep(0.05)
        process.send_signal(signal.SIGKILL)
    header, first, second = Path("watched.csv").read_text().splitlines()
    planned = Path("plan.csv").read_text().splitlines()
    assert header == f"{planned[1]},x,y,z"
    assert first == f"{planned[2]},0.7005,-0.02,1.25"
    assert second == f"{planned[4]},0.69,0.015,1.2405"
    with watching(*words) as process:
        said, _ = process.communicate("back\n0.69 0.015 1.24 m\n")
    assert "10 left" in said and "11 left" in said and "next: " not in said
    assert Path("watched.csv").read_text().splitlines()[2] != second
    assert len(Path("watched.csv").read_text().splitlines()) == 3


def test_rows_of_others_stay_byte_by_byte(tmp_path: Path):
    file = tmp_path / "watched.csv"
    file.write_bytes(b"a,x\r\n1,2\r\n# 20 \xb0C\x85\r\n3,4")
    (link := tmp_path / "link.csv").symlink_to(file)
    _rewrite(link, ("5", "6"))
    assert file.read_bytes() == b"a,x\r\n1,2\r\n# 20 \xb0C\x85\r\n3,4\n5,6\n"
    for left in (b"3,4\n", b"# 20 \xb0C\x85\r\n", b"1,2\r\n", b"a,x\r\n", b"a,x\r\n"):
        _rewrite(file)
        assert file.read_bytes().endswith(left)


@pytest.mark.parametrize(
    ("text", "kinds", "unit", "numbers"),
    [
        ("523,5 mm", LENGTHS, "", [0.5235]),
        ("523.5", LENGTHS, "mm", [0.5235]),
        ("0,5m", LENGTHS, "mm", [0.5]),
        ("1,5;-2 3 in", PLACES, "", [0.0381, -0.0508, 0.0762]),
        ("0.05", LENGTHS, "m", [0.05]),
        ("2[in]", LENGTHS, "m", [0.0508]),
        ("5e-1 m", LENGTHS, "", [0.5]),
        ("0 mm", LENGTHS, "", [0.0]),
    ],
)
def test_readings(text: str, kinds, unit: str, numbers: list[float]):
    assert reading(text, kinds, unit)[0] == pytest.approx(numbers)


@pytest.mark.parametrize(
    "text", ["12.5", "12.5 parsec", "1 2 mm", "mm", "x mm", "nan mm", "1e9 m", "fifty"]
)
def test_readings_that_are_none(text: str):
    with pytest.raises(InputError):
        reading(text, LENGTHS, "")


def test_a_file_that_cannot_be_read_gives_no_other_reason(here: Path, run):
    text = Path("rows.csv").read_text()
    Path("wrong.csv").write_text(text.replace("x,y", "x [parsec],y", 1))
    found = run("watch arm.urdf wrong.csv --setup setup.yaml --once")
    assert found.status == 1 and "unit 'parsec'" in found.out
    assert found.err == "calib-pin: note: no result: nothing could be fitted yet\n"


def test_the_status_is_that_of_the_verdict(here: Path, run):
    header, *rows = Path("rows.csv").read_text().splitlines()
    words = "watch arm.urdf some.csv --setup setup.yaml --once"
    for count, status in ((0, 1), (2, 2), (len(rows), 0)):
        Path("some.csv").write_text("\n".join([header, *rows[:count], ""]))
        assert run(words).status == status


@pytest.mark.needs("vision")
def test_only_new_images_are_detected(tmp_path: Path, monkeypatch):
    import calib_pin.io.boards as boards
    from calib_pin.cli.detect import images_of

    folder, word = tmp_path / "images", "charuco:7x5:0.03:0.022"
    folder.mkdir()
    board = boards.drawn_board(boards.board_of(word))
    png = boards.encode_png(board.generateImage((700, 500), None, 30), 1e4)
    looked = list[str]()
    find = boards.find_board

    def counted(detector, paths, tell):
        looked.extend(path.name for path in paths)
        return find(detector, paths, tell)

    monkeypatch.setattr(boards, "find_board", counted)
    joints = tmp_path / "joints.csv"
    joints.write_text("image,joint1\na.png,0.1\n")
    (folder / "a.png").write_bytes(png)
    file, add = images_of(folder, word, joints, 0.0)
    first = file.read_text()
    assert first.startswith("image,joint1,target,u,sigma_u,v,sigma_v\na.png,0.1,")
    (folder / "b.png").write_bytes(png)
    add()
    assert file.read_text() == first
    joints.write_text("image,joint1\na.png,0.1\nb.png,0.2\n")
    add()
    assert file.read_text().startswith(first)
    assert file.read_text().count("b.png,0.2,") == first.count("a.png")
    images_of(folder, word, joints, 0.0)
    assert looked == ["a.png", "b.png"]


def test_a_terminal_shows_the_state_below_the_rows():
    from rich.console import Console

    console = Console(record=True, width=100, force_terminal=True)
    with display(live=console) as tell:
        tell(Event("state", "12 rows; GOOD"))
        tell(
            Event(
                "row", "rows.csv:14: 3.1 mm from where it is expected", {"wrong": True}
            )
        )
        tell(Event("next", "next: joint1 0.5"))
    text = console.export_text()
    assert text.index("3.1 mm") < text.rindex("12 rows") < text.rindex("next:")
