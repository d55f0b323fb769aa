"""`calib-pin detect`: a measurement file of images of a board."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path, PureWindowsPath
from typing import Any

import numpy as np

from calib_pin.cli import files, printing
from calib_pin.cli.asked import Detect
from calib_pin.errors import InputError, OptionError, enumerated
from calib_pin.io import boards, measurements
from calib_pin.io.boards import Detector, Found, Start, encode_png
from calib_pin.io.setup import setup_document, yaml_text
from calib_pin.io.table import Notice, Table, read_table
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
        return _drawn(asked, asked.draw, detector)
    output, extra = asked.output, asked.setup_output
    every_path = asked.images or []
    images = [image for path in every_path for image in (images_in(path) or [path])]
    if not images or output is None:
        raise OptionError("give the images, and -o, the measurement file to write")
    files.require_distinct(images)
    inputs = (*images, asked.setup, asked.joints)
    files.check_outputs((output, extra), inputs, asked.force)
    images.sort(key=numbers_in)
    rows = configurations_of(asked, images)
    with printing.progress_bar(quiet=asked.quiet) as bar:
        size, every = boards.find_board(detector, images, printing.stage(bar, "images"))
    if not boards.require_stated(board, every, images):
        asked.tell("no image shows enough of the board to check how it is stated")
    found = {path.name: one for path, one in zip(images, every, strict=True)}
    start = boards.start_camera(asked.mount, detector, size, found)
    if (camera := given.camera) is not None:
        if camera.size not in (None, size):
            value, allowed = (f"{a:g} x {b:g}" for a, b in (size, camera.size or size))
            reason = "these images are not of the size of the camera that is stated"
            raise InputError(reason, file=images[0], value=value, allowed=allowed)
        start = replace(start, camera=replace(camera, size=size), assumed=False)
    columns = corner_columns(images, every, rows)
    comment = f"found by: {printing.told_command(words)}"
    contents = {output: measurements.encode_table(columns, [comment])}
    setup = setup_document(Setup(model="camera", board=board, camera=start.camera))
    if extra is not None:
        remark = f"# {ASSUMED}\n" if start.assumed else ""
        text = yaml_text({key: setup[key] for key in ("model", "board", "camera")})
        contents[extra] = f"# {comment}\n{remark}{text}\n".encode()
    _remarks(found, start, asked.tell)
    if boards.ambiguous(board):
        asked.tell(
            "the board looks the same when it is turned: corner 0 is the one nearest "
            "to the upper left of each image, so the camera must not roll"
        )
    median = float(np.median(np.concatenate([one.sigma for one in every])))
    shown, corners = sum(bool(k.names) for k in every), sum(len(k.names) for k in every)
    ends = start.camera.focal, start.camera.center
    focal, center = (f"({a:.1f}, {b:.1f})" for a, b in ends)
    checked = start.rms is not None
    rms = f"rms {start.rms:.3f} px" if checked else "not checked: too few corners"
    rms += ", with a camera of their own" * (checked and given.camera is not None)
    told = (
        f"{shown} of {len(images)} images show the board, {size[0]} x {size[1]} px\n"
        f"{corners} of {shown * len(detector.points)} corners in them, sigma "
        f"{median:.3f} px (median)\n"
        f"{'start of the camera' if given.camera is None else 'camera as stated'}: "
        f"{'assumed ' * start.assumed}focal {focal}, center {center} px\n  ({rms})\n"
    )
    asked.give(contents, told)
    return 0


def _drawn(asked: Detect, file: Path, detector: Detector) -> int:
    """Write the board to print."""
    files.check_outputs([file], [asked.setup], asked.force)
    picture = encode_png(detector.drawn(SHEET), SHEET / detector.board.square)
    width, height = 1e3 * detector.extent
    told = f"print it at 100 %: {width:g} x {height:g} mm\n"
    asked.give({file: picture}, told)
    return 0


def corner_columns(
    images: Sequence[Path], every: Sequence[Found], cells: Mapping[str, Sequence[Any]]
) -> dict[str, Any]:
    """The columns of corners found in images, with the cells of each image."""
    image_of = [k for k, one in enumerate(every) for _ in one.names]
    columns: dict[str, Any] = {"image": [images[k].name for k in image_of]}
    columns |= {name: [own[k] for k in image_of] for name, own in cells.items()}
    columns["target"] = [name for one in every for name in one.names]
    for k, axis in enumerate("uv"):
        for name, of in ((axis, "pixels"), (f"sigma_{axis}", "sigma")):
            found = [getattr(one, of)[:, k] for one in every]
            columns[name] = np.concatenate(found).round(4)
    return columns


ENDINGS = (".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff", ".pgm", ".ppm")


def images_in(folder: Path) -> list[Path]:
    """The images in a folder; none in what is no folder."""
    there = folder.iterdir() if folder.is_dir() else ()
    return [path for path in there if path.suffix.lower() in ENDINGS]


def numbers_in(image: Path) -> list[int]:
    """The numbers in a name: img_2 comes before img_10."""
    return [int(word or 0) for word in re.split(r"\D+", str(image))]


def _remarks(found: dict[str, Found], start: Start, tell: Notice) -> None:
    """Name the images without a board, and the blurred ones."""
    if without := [name for name, one in found.items() if not one.names]:
        tell(f"no board in {len(without)} images: {enumerated(without)}")
    medians = {name: np.median(one.sigma) for name, one in found.items() if one.names}
    most = BLURRED * np.median([*medians.values()])
    if blurred := [name for name, median in medians.items() if median > most]:
        tell(f"blurred or noisy: {enumerated(blurred)}")
    if start.assumed:
        tell(ASSUMED)


def configurations_of(asked: Detect, images: list[Path]) -> dict[str, list[Any]]:
    """For each image the cells of the columns of the file of joints.

    Raises:
        InputError: If it has not one row for each image, or columns of ours.
    """
    if (file := asked.joints) is None:
        return {}
    table = read_table(file)
    if clash := [name for name in OURS if name in table]:
        raise table.error("is a column that detect writes itself", clash[0])
    count = len(table.lines)
    if "image" not in table and count == len(images):
        ends = (f"{images[k].name} with line {table.lines[k]}" for k in (0, -1))
        pairs = " to ".join(ends)
        asked.tell(f"images and rows of {file} are paired in order: {pairs}")
    elif "image" not in table:
        reason = f"has {count} rows for {len(images)} images; a column 'image' tells "
        reason += "which belong together"
        raise InputError(reason, file=file)
    order = _rows(table, images) if "image" in table else range(count)
    cells = {n: c.texts() for n, c in table.columns.items() if n != "image"}
    headers = {name: table.columns[name].header for name in cells}
    return {headers[n]: [c[row] for row in order] for n, c in cells.items()}


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
    for path, name in zip(images, names, strict=True):
        if name not in rows:
            raise InputError(f"has no row for the image {path.name}", file=table.file)
    return [rows[name] for name in names]


def _names(table: Table, images: list[Path]) -> tuple[list[str], list[str]]:
    """How the column `image` names images, row by row, and how it would name these.

    By their names, as paths of any system, by names without their ending, or by the
    last number in them.
    """
    cells = [PureWindowsPath(cell) for cell in table.texts(["image"])["image"]]
    if all(cell.name.isdecimal() for cell in cells):
        numbers = [re.findall(r"\d+", path.stem)[-1:] for path in images]
        names = [str(int(own[0])) if own else "" for own in numbers]
        return [str(int(cell.name)) for cell in cells], names
    plain, names = [cell.name for cell in cells], [path.name for path in images]
    if {*plain} & {*names}:
        return plain, names
    return [cell.stem for cell in cells], [path.stem for path in images]
