"""`detect`: corners in rendered images, and images that cannot be used."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from calib_pin.io.setup import read_setup
from calib_pin.setup import BoardSetup

pytestmark = pytest.mark.needs("vision")

BOARDS = {
    "charuco:7x5:0.03:0.022": BoardSetup("charuco", 7, 5, 0.03, 0.022),
    "chessboard:8x5:0.03": BoardSetup("chessboard", 8, 5, 0.03),
    "apriltag:4x3:0.03:0.015": BoardSetup("apriltag", 4, 3, 0.03, gap=0.015),
    "circles:7x5:0.03": BoardSetup("circles", 7, 5, 0.03),
    "marker:1x1:0.06": BoardSetup("marker", 1, 1, 0.06),
}


@pytest.mark.parametrize("word", BOARDS)
def test_corners_and_their_sigma(word, run, tmp_path, monkeypatch):
    import cv2

    from tests.io.rendered import pixels, pose, rendered

    monkeypatch.chdir(tmp_path)
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


def test_what_cannot_be_used(fails, tmp_path, monkeypatch):
    import cv2

    monkeypatch.chdir(tmp_path)
    rng = np.random.default_rng(0)
    gray = rng.integers(0, 255, (120, 160)).astype(np.uint8)
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
        (f"empty.png --draw b.png {board}", "--draw"),
        (board, "images"),
        ("--draw c.png --board chessboard:7x5:0.03", "chessboard"),
    ):
        fails(f"detect {words}", named)


def test_a_board_to_print_has_its_size(run, tmp_path, monkeypatch):
    import cv2

    monkeypatch.chdir(tmp_path)
    result = run("detect --draw a.png --board charuco:7x5:0.03:0.022")
    assert result.status == 0 and "210 x 150 mm" in result.out
    with Image.open("a.png") as image:
        size = np.array(image.size) / image.info["dpi"] * 0.0254
    assert np.allclose(size, [0.21, 0.15], rtol=1e-4)
    sheet = np.pad(cv2.imread("a.png", cv2.IMREAD_GRAYSCALE), 99, constant_values=255)
    cv2.imwrite("sheet.png", sheet)
    board = "--board charuco:7x5:0.03:0.022"
    assert run(f"detect sheet.png {board} -o m.csv").status == 0
