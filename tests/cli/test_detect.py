"""`detect`: corners in rendered images, and images that cannot be used."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from calib_pin.io.boards import board_of
from calib_pin.io.setup import read_setup
from calib_pin.setup import BoardSetup

pytestmark = [pytest.mark.needs("vision"), pytest.mark.usefixtures("alone")]


BOARDS = {
    "charuco:7x5:0.03:0.022": BoardSetup("charuco", 7, 5, 0.03, 0.022),
    "chessboard:8x5:0.03": BoardSetup("chessboard", 8, 5, 0.03),
    "apriltag:4x3:0.03:0.015": BoardSetup("apriltag", 4, 3, 0.03, gap=0.015),
    "circles:7x5:0.03": BoardSetup("circles", 7, 5, 0.03),
    "marker:1x1:0.06": BoardSetup("marker", 1, 1, 0.06),
}


@pytest.mark.parametrize("word", BOARDS)
def test_corners_and_their_sigma(word, run):
    import cv2

    from tests.io.rendered import pixels, pose, rendered

    board = BOARDS[word]
    rng = np.random.default_rng(3)
    T = pose(rng, board, 0.4)
    cv2.imwrite("a.png", rendered(board, T, rng, noise=3.0, blur=0.8))
    Path("joints.csv").write_text("image,joint1 [deg],time\nb.png,1,2\na.png,30,7\n")
    result = run(
        f"detect a.png --board {word} --joints joints.csv -o m.csv "
        "--setup-output s.yaml"
    )
    assert result.status == 0
    with Path("m.csv").open() as file:
        rows = list(csv.DictReader(line for line in file if line[0] != "#"))
    assert len(rows) > 0.9 * len(board.points)
    assert {(r["joint1 [deg]"], r["time"]) for r in rows} == {("30", "7")}
    true = pixels(board, T)
    error = [
        [float(r[c]) - true[r["target"]][k] for k, c in enumerate("uv")] for r in rows
    ]
    sigma = [[float(r[f"sigma_{c}"]) for c in "uv"] for r in rows]
    assert np.sqrt(np.mean(np.square(error))) < 0.1
    ratio = np.sqrt(np.mean(np.square(np.array(error) / np.array(sigma))))
    assert 1 / 1.5 < ratio < 1.5
    assert read_setup("s.yaml").board == board


def test_what_cannot_be_used(fails):
    import cv2

    rng = np.random.default_rng(0)
    gray = rng.integers(120, 126, (120, 160)).astype(np.uint8)
    cv2.imwrite("empty.png", gray)
    cv2.imwrite("other.png", gray[:100])
    Path("text.png").write_text("no image")
    Path("cut.png").write_bytes(Path("empty.png").read_bytes()[:40])
    Path("joints.csv").write_text("joint1\n1\n2\n")
    board = "--board charuco:7x5:0.03:0.022 -o m.csv"
    for words, named in (
        (f"empty.png {board}", "no image shows"),
        (f"text.png {board}", "text.png"),
        (f"cut.png {board}", "cut.png"),
        (f"empty.png other.png {board}", "other.png"),
        (f"empty.png {board} --joints joints.csv", "2 rows"),
        ("empty.png -o m.csv", "--board"),
        ("empty.png -o m.csv --board charuco:7", "'charuco:7'"),
        (f"empty.png --draw b.png {board}", "--draw and IMAGES... exclude"),
        (f"--draw b.png --mount world {board[:-9]}", "--draw and --mount exclude"),
        (board, "images"),
        ("empty.png -o m.csv --board charuco:7x5:0.022:0.03", "smaller than"),
        ("empty.png -o m.csv --board charuco:7x5:0.03:0.02:0.01", "TYPE:COLUMNS"),
        ("--draw c.png --board chessboard:7x5:0.03", "chessboard"),
    ):
        fails(f"detect {words}", named)


def seen_from(board, count=3, bend=0.0):
    """Write images of a board, by numbers; a bent one is no plane."""
    import cv2

    from tests.io.rendered import sheet_of

    rng = np.random.default_rng(4)
    sheet = np.pad(sheet_of(board), 96, constant_values=255).astype(np.float32)
    v, u = np.mgrid[:480, :640].astype(float)
    scale = max(sheet.shape[0] / 400.0, sheet.shape[1] / 560.0)
    for k in range(count):
        x, y = u - 319.5, v - 239.5 + bend * np.sin(u / 60.0)
        turn = rng.uniform(-0.3, 0.3)
        a, b = rng.uniform(-6e-4, 6e-4, 2)
        w = scale / (1.0 + a * x + b * y)
        at = np.stack(
            [
                w * (np.cos(turn) * x - np.sin(turn) * y) + 0.5 * sheet.shape[1],
                w * (np.sin(turn) * x + np.cos(turn) * y) + 0.5 * sheet.shape[0],
            ]
        ).astype(np.float32)
        image = cv2.remap(sheet, *at, cv2.INTER_AREA, borderValue=255)
        image = cv2.GaussianBlur(image, (0, 0), 0.8) + 2.0 * rng.normal(size=v.shape)
        cv2.imwrite(f"{k}.png", image.clip(0, 255).astype(np.uint8))


def test_images_and_joints_are_paired(run, fails):
    """By the order of their numbers, which is said, or by the times of a log."""
    word = "marker:1x1:0.06"
    seen_from(board_of(word), 1)
    for k in (2, 10, 9):
        Path(f"{k}.png").write_bytes(Path("0.png").read_bytes())
    Path("joints.csv").write_text("joint1\n0.2\n0.9\n1.0\n")
    words = f"detect 10.png 2.png 9.png --board {word} -o m.csv --joints"
    result = run(f"{words} joints.csv")
    assert "2.png with line 2 to 10.png with line 4" in result.err

    def pairs():
        lines = Path("m.csv").read_text().splitlines()[2:]
        return {tuple(line.split(",")[:2]) for line in lines}

    assert pairs() == {("2.png", "0.2"), ("9.png", "0.9"), ("10.png", "1.0")}
    still = [f"{t},{min(int(t / 2), 2)}" for t in np.arange(0.0, 6.0, 0.1).round(1)]
    Path("log.csv").write_text("\n".join(["time,joint1", *still]))
    Path("times.csv").write_text("image,time\n10.png,5.2\n2.png,1.2\n9.png,2.1\n")
    result = run(f"{words} log.csv --times times.csv --force")
    assert "stand at the time of 9.png" in result.err
    assert pairs() == {("2.png", "0.0"), ("10.png", "2.0")}
    assert "sigma" not in Path("m.csv").read_text().splitlines()[0]
    fails(f"{words[:-9]} --times times.csv --force", "--times needs --joints")
    fails(f"{words} log.csv --times log.csv --force", "log.csv", "'image'")
    Path("times.csv").write_text("image\n10.png\n2.png\n9.png\n")
    fails(f"{words} log.csv --times times.csv --force", "times.csv", "'time'")


@pytest.mark.parametrize("cell", ["shots/{}.png", "C:\\a\\s_{}.jpg", "{}", "000{}"])
def test_images_are_named_as_people_do(run, cell):
    """By paths of other systems, without an ending, or by a number; from a folder."""
    word = "marker:1x1:0.06"
    seen_from(board_of(word), 1)
    Path("shots").mkdir()
    name = "s_{}.png" if "s_" in cell or "0" in cell else "{}.png"
    for k in (2, 10):
        Path("shots", name.format(k)).write_bytes(Path("0.png").read_bytes())
    rows = [f"{cell.format(k)},{k / 10}" for k in (10, 7, 2)]
    Path("joints.csv").write_text("\n".join(["image,joint1", *rows]))
    assert run(f"detect shots --board {word} -o m.csv --joints joints.csv").status == 0
    lines = Path("m.csv").read_text().splitlines()[2:]
    pairs = {tuple(line.split(",")[:2]) for line in lines}
    assert pairs == {(name.format(2), "0.2"), (name.format(10), "1.0")}


def test_a_camera_that_is_stated_stays(run, fails):
    """The one of the file of another software, unless images are of another size."""
    word = "charuco:7x5:0.03:0.022"
    seen_from(board_of(word), 1)
    with Image.open("0.png") as image:
        width, height = image.size
    for size, known in ((width, True), (width // 2, False)):
        info = f"image_width: {size}\nimage_height: {height}\n"
        info += "camera_matrix: {data: [700, 0, 300, 0, 701, 200, 0, 0, 1]}\n"
        info += "distortion_coefficients: {data: [0, 0, 0, 0, 0]}\n"
        Path("info.yaml").write_text(info)
        board = "{type: charuco, columns: 7, rows: 5, square: 0.03, marker: 0.022}"
        camera = "{mount: world, file: info.yaml}"
        Path("c.yaml").write_text(f"camera: {camera}\nboard: {board}\n")
        words = "detect 0.png --setup c.yaml -o m.csv --force"
        if known:
            assert "as stated" in run(f"{words} --setup-output s.yaml").out
            camera = read_setup("s.yaml").camera
            assert camera.mount == "world" and not camera.estimate
            assert camera.focal == (700.0, 701.0)
        else:
            fails(words, "0.png", f"{width} x {height}", "not of the size")


def test_mirrored_images_and_millimeters_are_said(fails):
    import cv2

    seen_from(board_of("charuco:7x5:0.03:0.022"), 1)
    words = "detect 0.png -o m.csv --board charuco:7x5:"
    fails(f"{words}30:22", "at most 2")
    cv2.imwrite("0.png", cv2.imread("0.png", cv2.IMREAD_GRAYSCALE)[:, ::-1])
    fails(f"{words}0.03:0.022", "not mirrored")


@pytest.mark.parametrize(
    ("true", "wrong"),
    [
        (
            "apriltag:6x4:0.03:0.01",
            ["4x6:0.03:0.01", "6x4:0.03:0.333"],
        ),
        ("charuco:6x4:0.03:0.02:legacy", ["6x4:0.03:0.02", "5x3:0.03:0.02:legacy"]),
        ("charuco:7x5:0.03:0.02:DICT_5X5_50", ["7x5:0.03:0.015:DICT_5X5_50"]),
        ("marker:3x2:0.03:0.01:DICT_4X4_50:first=9", ["3x2:0.03:0.01:DICT_4X4_50"]),
        ("chessboard:8x5:0.03", ["7x4:0.03"]),
        ("circles:6x4:0.03", ["5x4:0.03", "4x6:0.03", "7x4:0.03"]),
    ],
)
def test_another_board_than_stated_is_named(true, wrong, run, fails):
    board = board_of(true)
    seen_from(board, 1)
    for stated in wrong:
        words = f"detect 0.png -o m.csv --board {board.type}:{stated}"
        fails(words, f"--board {true}")
    result = run(f"detect 0.png -o m.csv --board {true}")
    assert result.status == 0 and "how it is stated" not in result.err


def test_what_is_seen_of_no_board_is_said(fails):
    """Neighbors of a narrow part have a single column, which OpenCV finds."""
    import cv2

    seen_from(board_of("marker:3x2:0.03:0.01:DICT_6X6_50"), 1)
    fails("detect 0.png --board circles:7x5:0.03 -o m.csv", "6 markers", "0 to 5")
    seen_from(board_of("circles:4x5:0.03"), 1)
    cv2.imwrite("0.png", cv2.imread("0.png", cv2.IMREAD_GRAYSCALE)[:, :400])
    fails("detect 0.png --board circles:2x5:0.03 -o m.csv", "no image shows the board")


def test_corners_of_no_plane_and_assumed_focal_lengths(run, fails):
    word = "charuco:7x5:0.03:0.02"
    words = f"detect 0.png 1.png --board {word} -o m.csv --setup-output s.yaml"
    more = words.replace("1.png", "1.png 2.png")
    seen_from(board_of(word), 3, bend=8.0)
    fails(more, "rms", "px", ".png")
    seen_from(board_of(word), 3)
    result = run(words)
    assert "assumed focal (768.0, 768.0)" in result.out and "assumed" in result.err
    assert "assumed" in Path("s.yaml").read_text()
    assert run(f"{more} --force").status == 0


def test_a_board_to_print_has_its_size(run):
    import cv2

    result = run("detect --draw a.png --board charuco:7x5:0.03:0.022")
    assert result.status == 0 and "210 x 150 mm" in result.out
    with Image.open("a.png") as image:
        size = np.array(image.size) / image.info["dpi"] * 0.0254
    assert np.allclose(size, [0.21, 0.15], rtol=1e-4)
    sheet = np.pad(cv2.imread("a.png", cv2.IMREAD_GRAYSCALE), 99, constant_values=255)
    cv2.imwrite("sheet.png", sheet)
    board = "--board charuco:7x5:0.03:0.022"
    assert run(f"detect sheet.png {board} -o m.csv").status == 0
