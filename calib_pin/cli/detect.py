"""`calib-pin detect`: a measurement file of images of a board."""

from __future__ import annotations

import re
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path, PureWindowsPath
from typing import Any

import numpy as np

import calib_pin.io.logs as logs
from calib_pin.cli import files, printing
from calib_pin.cli.asked import Detect, Join
from calib_pin.errors import InputError, OptionError, enumerated
from calib_pin.io import boards
from calib_pin.io.boards import Detector, View
from calib_pin.io.measurements import encode_table
from calib_pin.io.setup import setup_document, yaml_text
from calib_pin.io.table import Table, read_table
from calib_pin.setup import Setup

OURS = ("u", "v", "target", "sigma_u", "sigma_v")
"""Columns of the measurement file, beside `image` and those of the joints."""

BLURRED = 3.0
"""Standard deviation of an image's corners, in that of all images, above which it is
named as blurred."""

SHEET = 200
"""Pixels of a square or tag on a sheet."""

ASSUMED = "the focal lengths are assumed: the images do not determine them"


def detect(asked: Detect, words: Sequence[str]) -> int:
    """Do what `Detect` asks for."""
    given = files.open_setup(asked.setup)
    board = boards.board_of(asked.board) if asked.board else given.board
    if board is None:
        raise OptionError("give --board, or a setup file with 'board' (--setup)")
    detector = boards.Detector(board)
    if asked.draw is not None:
        return _draw_board(asked, asked.draw, detector)
    output, extra = asked.output, asked.setup_output
    images = [i for path in asked.images or [] for i in (images_in(path) or [path])]
    if not images or output is None:
        raise OptionError("give the images, and -o, the measurement file to write")
    files.require_distinct(images)
    inputs = (*images, asked.setup, asked.joints, asked.times)
    files.check_outputs((output, extra), inputs, asked.force)
    images, rows = unmeasured(asked, sorted(images, key=numbers_in))
    with printing.progress_bar(quiet=asked.quiet) as bar:
        size, views = boards.find_board(detector, images, printing.stage(bar, "images"))
    if not boards.require_stated(board, views, images):
        asked.tell("no image shows enough of the board to check how it is stated")
    by_name = {path.name: view for path, view in zip(images, views, strict=True)}
    start = boards.start_camera(asked.mount, detector, size, by_name)
    fit = "not checked: too few corners"
    fit = fit if start.rms is None else f"rms {start.rms:.3f} px"
    if (stated := given.camera) is not None:
        if stated.size not in (None, size):
            value, allowed = (f"{a:g} x {b:g}" for a, b in (size, stated.size or size))
            reason = "these images are not of the size of the camera that is stated"
            raise InputError(reason, file=images[0], value=value, allowed=allowed)
        start, fit = boards.Start(replace(stated, size=size), False, None), "as stated"
    comment = f"found by: {printing.command_line(words)}"
    table = encode_table(corner_columns(images, views, rows), [comment])
    contents = {output: table}
    if extra is not None:
        setup = setup_document(Setup(model="camera", board=board, camera=start.camera))
        text = yaml_text({key: setup[key] for key in ("model", "board", "camera")})
        remarks = [comment, *[ASSUMED] * start.assumed]
        head = "".join(f"# {remark}\n" for remark in remarks)
        contents[extra] = f"{head}{text}\n".encode()
    medians = {n: np.median(view.sigma) for n, view in by_name.items() if view.names}
    median = float(np.median(np.concatenate([view.sigma for view in views])))
    most, shown = BLURRED * np.median([*medians.values()]), len(medians)
    for remark, names in (
        (f"no board in {len(images) - shown} images", by_name.keys() - medians),
        ("blurred or noisy", {n for n, sigma in medians.items() if sigma > most}),
    ):
        if names:
            asked.tell(f"{remark}: {enumerated(n for n in by_name if n in names)}")
    if start.assumed:
        asked.tell(ASSUMED)
    if boards.ambiguous(board):
        asked.tell(
            "the board looks the same when it is turned: corner 0 is the one nearest "
            "to the upper left of each image, so the camera must not roll"
        )
    corners = sum(len(view.names) for view in views)
    focal, center = start.camera.focal, start.camera.center
    asked.give(
        contents,
        f"{shown} of {len(images)} images show the board, {size[0]} x {size[1]} px\n"
        f"{corners} of {shown * len(detector.points)} corners in them, sigma "
        f"{median:.3f} px (median)\n"
        f"camera: {'assumed ' * start.assumed}focal ({focal[0]:.1f}, {focal[1]:.1f}), "
        f"center ({center[0]:.1f}, {center[1]:.1f}) px\n  ({fit})\n",
    )
    return 0


def _draw_board(asked: Detect, file: Path, detector: Detector) -> int:
    """Write the board to print."""
    files.check_outputs([file], [asked.setup], asked.force)
    picture = boards.encode_png(detector.drawn(SHEET), SHEET / detector.board.square)
    width, height = 1e3 * detector.extent
    note = f"print it at 100 %: {width:g} x {height:g} mm\n"
    asked.give({file: picture}, note)
    return 0


def corner_columns(
    images: Sequence[Path], views: Sequence[View], cells: Mapping[str, Sequence[Any]]
) -> dict[str, Any]:
    """The columns of corners found in images, with the cells of each image."""
    image_of = [k for k, view in enumerate(views) for _ in view.names]
    columns: dict[str, Any] = {"image": [images[k].name for k in image_of]}
    columns |= {name: [values[k] for k in image_of] for name, values in cells.items()}
    columns["target"] = [name for view in views for name in view.names]
    for k, axis in enumerate("uv"):
        for name, of in ((axis, "pixels"), (f"sigma_{axis}", "sigma")):
            parts = [getattr(view, of)[:, k] for view in views]
            columns[name] = np.concatenate(parts).round(4)
    return columns


ENDINGS = (".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff", ".pgm", ".ppm")


def images_in(folder: Path) -> list[Path]:
    """The images in a folder; none in what is no folder."""
    paths = folder.iterdir() if folder.is_dir() else ()
    return [path for path in paths if path.suffix.lower() in ENDINGS]


def images_of(
    folder: Path, board: str, joints: Path | None, pause: float
) -> tuple[Path, Callable[[], None]]:
    """A file of corners beside a folder, and what adds those of new images to it.

    Args:
        folder: The folder.
        board: The board, as `detect` takes it.
        joints: The configurations of the images, with a column 'image'.
        pause: Time to wait before looking [s].

    Raises:
        OptionError: If the folder is none, or the configurations are missing.
    """
    if not folder.is_dir() or joints is None:
        raise OptionError("--board needs a folder of images, and --joints", file=folder)
    detector, file = boards.Detector(boards.board_of(board)), folder.with_suffix(".csv")
    seen = set[str]()
    if file.exists():
        seen |= {*read_table(file).texts(["image"])["image"]}

    def add() -> None:
        time.sleep(pause)
        new = [path for path in images_in(folder) if path.name not in seen]
        for image in sorted(new, key=numbers_in):
            try:
                asked = Detect(images=[image], joints=joints)
                _, cells = unmeasured(asked, [image])
                _, views = boards.find_board(detector, [image], None)
            except InputError:
                continue  # Its configuration, or a part of it, is not there yet.
            seen.add(image.name)
            if not views[0].names:
                continue
            table = encode_table(corner_columns([image], views, cells), ())
            with file.open("ab") as stream:
                stream.write(table.partition(b"\n")[2] if stream.tell() else table)

    add()
    return file, add


def numbers_in(image: Path) -> list[int]:
    """The numbers in a name: img_2 comes before img_10."""
    return [int(word or 0) for word in re.split(r"\D+", str(image))]


def unmeasured(
    asked: Detect, images: list[Path]
) -> tuple[list[Path], dict[str, list[Any]]]:
    """Images of known joints, and for each the cells of the columns of their file.

    Raises:
        InputError: If it has not one row for each image, or columns of ours.
    """
    if (file := asked.joints) is None:
        return images, {}
    table = read_table(file, names=None)
    if clash := [name for name in OURS if name in table]:
        raise table.error("is a column that detect writes itself", clash[0])
    if asked.times is not None:
        # Where the joints stood at the time of each image, by its name.
        times = logs.with_images(read_table(asked.times))
        times = times.rows(np.array(_rows(times, images)))
        stand = Join.settle, Join.tolerance
        summary, data = logs.join_logs(table, times, (), *stand, asked.tell, True)
        if summary.clock is None:
            raise times.error("no column 'time' here, or in the log of the joints")
        table = read_table(data, names=None)
        stood, names = _names(table, images)
        images = [p for p, name in zip(images, names, strict=True) if name in stood]
    if "image" in table:
        order: Sequence[int] = _rows(table, images)
    else:
        order = range(len(table.lines))
        if len(order) != len(images):
            reason = (
                f"has {len(order)} rows for {len(images)} images; a column 'image' "
            )
            reason += "or, for a log, --times tells which belong together"
            raise InputError(reason, file=file)
        ends = (f"{images[k].name} with line {table.lines[k]}" for k in (0, -1))
        pairs = " to ".join(ends)
        asked.tell(f"images and rows of {file} are paired in order: {pairs}")
    cells = {n: c.texts() for n, c in table.columns.items() if n != "image"}
    headers = {name: table.columns[name].header for name in cells}
    return images, {headers[n]: [c[row] for row in order] for n, c in cells.items()}


def _rows(table: Table, images: list[Path]) -> list[int]:
    """The row of each image in a table with a column `image`.

    Raises:
        InputError: If there is no such column, or an image has no row or several.
    """
    if "image" not in table:
        raise table.error("there is no column 'image'")
    cells, names = _names(table, images)
    rows = dict[str, int]()
    for row, cell in enumerate(cells):
        if rows.setdefault(cell, row) != row:
            raise table.error("this image has a row already", "image", row=row)
    if lost := [p for p, name in zip(images, names, strict=True) if name not in rows]:
        raise InputError(f"has no row for the image {lost[0].name}", file=table.file)
    return [rows[name] for name in names]


def _names(table: Table, images: list[Path]) -> tuple[list[str], list[str]]:
    """How the column `image` names images, row by row, and how it would name these.

    By their names, as paths of any system, by names without their ending, or by the
    last number in them.
    """
    cells = [PureWindowsPath(cell) for cell in table.texts(["image"])["image"]]
    if all(cell.name.isdecimal() for cell in cells):
        numbers = [re.findall(r"\d+", path.stem)[-1:] for path in images]
        names = [str(int(digits[0])) if digits else "" for digits in numbers]
        return [str(int(cell.name)) for cell in cells], names
    plain, names = [cell.name for cell in cells], [path.name for path in images]
    if {*plain} & {*names}:
        return plain, names
    return [cell.stem for cell in cells], [path.stem for path in images]
