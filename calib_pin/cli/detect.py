"""`calib-pin detect`: a measurement file of images of a board."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

import calib_pin.cli.options as options
from calib_pin.cli.files import check_outputs, open_setup, require_distinct
from calib_pin.cli.printing import (
    notice,
    progress_bar,
    say,
    say_json,
    say_written,
    stage,
    told_command,
)
from calib_pin.errors import InputError, OptionError, enumerated, require_known

if TYPE_CHECKING:
    from calib_pin.io.boards import Found
    from calib_pin.io.logs import Notice
    from calib_pin.io.table import Table
    from calib_pin.setup import BoardSetup

OURS = ("image", "u", "v", "target", "sigma_u", "sigma_v")
"""Columns of the measurement file, beside those of the joints."""

BLURRED = 3.0
"""Standard deviation of an image's corners, in that of all images, above which it is
named as blurred."""

NOISE, MOST = 30.0, (1.0, 3.0)
"""Rms of corners about a camera that is an error: in standard deviations of a corner,
as paper bends and lenses are no polynomials, but between these [px]."""

SAMPLE = 4
"""Images of which a better statement of the board is taken."""

MOUNTS = ("hand", "world")

SHEET = 200
"""Pixels of a square or tag on a sheet."""


def detect(
    context: typer.Context,
    images: Annotated[
        list[Path] | None,
        typer.Argument(
            metavar="IMAGES...", help="Images of one camera: PNG, JPEG, TIFF, BMP, PGM."
        ),
    ] = None,
    output: Annotated[
        Path | None, options.output("-o --output CSV", "Measurement file to write.")
    ] = None,
    board: Annotated[
        str | None,
        options.option(
            "Images",
            "--board SPEC",
            "The board, lengths in m: charuco:7x5:SQUARE:MARKER:DICT_4X4_50 (':legacy' "
            "at the end for boards of OpenCV before 4.6), chessboard:9x6:SQUARE, "
            "circles:9x6:DISTANCE, apriltag:6x6:EDGE:GAP, "
            "marker:1x1:EDGE:DICT_4X4_50:first=7; columns x rows of squares (not of "
            "inner corners), circles or tags. Default is 'board' of the setup file.",
        ),
    ] = None,
    setup: Annotated[
        Path | None,
        options.option("Images", "--setup FILE", "Setup file with the 'board'."),
    ] = None,
    joints: Annotated[
        Path | None,
        options.option(
            "Images",
            "--joints CSV",
            "Configurations: those of a column 'image' (file name); a log with times, "
            "see --times; or in the order of the images, img_2 before img_10. All its "
            "columns are passed on, as 'time'. Without it the output has no joints; "
            "its column 'image' tells which to add.",
        ),
    ] = None,
    times: Annotated[
        Path | None,
        options.option(
            "Images",
            "--times CSV",
            "When the images were taken, columns 'image' and 'time': each gets the "
            "joints of its standstill in the log of --joints.",
        ),
    ] = None,
    mount: Annotated[
        str,
        options.option(
            "Images",
            "--mount WHERE",
            "Where the camera is: hand (default) or world (board on the robot).",
        ),
    ] = "hand",
    setup_output: Annotated[
        Path | None,
        options.output(
            "--setup-output FILE",
            "Write a setup file for calibrate: the board, and the camera with "
            "intrinsics to start from.",
        ),
    ] = None,
    draw: Annotated[
        Path | None,
        options.output(
            "--draw PNG",
            "Write the board to print (charuco and tags) at its size; no images then.",
        ),
    ] = None,
    force: options.Force = False,
    quiet: options.Quiet = False,
    json: options.Json = False,
) -> int:
    """Find the corners of a board in images, as measurements of the model 'camera'.

    Corners are numbered row by row from 0, those of tag 7 are 7/0 to 7/3, clockwise.
    Pixel centers are whole numbers, the first is (0, 0). Standard deviations follow
    from the noise of the image and the edges at each corner. Needs OpenCV: pip install
    'calib-pin[vision]'.
    """
    import numpy as np

    from calib_pin.io.boards import (
        Detector,
        ambiguous,
        board_of,
        checked,
        encode_png,
        fitting,
        read_image,
        restated,
        start_camera,
    )
    from calib_pin.io.files import write_files
    from calib_pin.io.measurements import encode_table
    from calib_pin.io.setup import setup_document, yaml_text
    from calib_pin.setup import Setup

    require_known("mount", mount, MOUNTS)
    stated = open_setup(setup)
    if board is not None and stated.board is not None:
        raise OptionError("give either --board or 'board' in the setup file")
    wanted = stated.board if board is None else board_of(board)
    if wanted is None:
        raise OptionError("give --board, or a setup file with 'board' (--setup)")
    detector = Detector(wanted)
    if draw is not None:
        if images or output or joints or setup_output:
            raise OptionError("--draw takes --board or --setup, and nothing else")
        check_outputs([draw], [setup], force)
        picture = encode_png(detector.drawn(SHEET), SHEET / wanted.square)
        with write_files({draw: picture}, force=force):
            pass
        if not quiet:
            width, height = 1e3 * detector.extent
            say(f"print it at 100 %: {width:g} x {height:g} mm\n")
            say_written([f"wrote {draw}"])
        return 0
    if not images or output is None:
        raise OptionError("give the images, and -o, the measurement file to write")
    require_distinct(images)
    check_outputs((output, setup_output), (*images, setup, joints, times), force)
    if times is not None and joints is None:
        raise OptionError("--times needs --joints: a log of the joints, with times")
    images = sorted(images, key=_natural)
    tell_user = (lambda remark: None) if quiet else notice
    images, rows = _configurations(joints, times, images, tell_user)
    every: list[Found] = []
    size, first = (0, 0), images[0]
    with progress_bar(quiet=quiet) as bar:
        tell = stage(bar, "images")
        for k, path in enumerate(images):
            image = read_image(path)
            height, width = image.shape
            if k == 0:
                size = (width, height)
            if (width, height) != size:
                raise InputError(
                    f"is not of the size of {first}: one camera has one",
                    file=path,
                    value=f"{width} x {height}",
                    allowed=f"{size[0]} x {size[1]}",
                )
            every.append(detector.find(image))
            if tell is not None:
                tell((k + 1) / len(images))
    seen = [(k, found) for k, found in enumerate(every) if found.names]
    told = checked(wanted, every)
    better = restated(wanted, every)
    if better != wanted or not (seen and told):
        fit, markers = fitting(
            wanted, [read_image(path) for path in images[:: len(images) // SAMPLE + 1]]
        )
        if not seen or not wanted == better == fit:
            raise _misstated(wanted, fit, markers, stated.board is not None)
    image_of = [k for k, found in seen for _ in found.names]
    pixels = np.concatenate([found.pixels for _, found in seen])
    sigma = np.concatenate([found.sigma for _, found in seen])
    columns: dict[str, Any] = {"image": [images[k].name for k in image_of]}
    columns |= {name: [cells[k] for k in image_of] for name, cells in rows.items()}
    columns |= {"target": [name for _, found in seen for name in found.names]}
    for k, name in enumerate("uv"):
        columns |= {name: pixels[:, k].round(4), f"sigma_{name}": sigma[:, k].round(4)}
    comment = f"found by: {told_command(context)}"
    start = start_camera(
        "world" if mount == "world" else "hand",
        detector,
        size,
        [found for _, found in seen],
    )
    camera, rms = start.camera, _require_camera(start.rms, images, seen)
    assumed = "the focal lengths are assumed: the images do not determine them"
    contents = {output: encode_table(columns, [comment])}
    document = setup_document(Setup(model="camera", board=wanted, camera=camera))
    lines = {key: document[key] for key in ("model", "board", "camera")}
    if setup_output is not None:
        remark = f"# {assumed}\n" if start.assumed else ""
        contents[setup_output] = f"# {comment}\n{remark}{yaml_text(lines)}\n".encode()
    if not quiet:
        _remarks(images, seen)
        if not told:
            notice("no image shows enough of the board to check how it is stated")
        if start.assumed:
            notice(assumed)
        if ambiguous(wanted):
            notice(
                "the board looks the same when it is turned: corner 0 is the one "
                "nearest to the upper left of each image, so the camera must not roll"
            )
    with write_files(contents, force=force):
        pass
    if json:
        document = {
            "images": len(images),
            "shown": len(seen),
            "corners": len(pixels),
            "sigma": float(np.median(sigma)),
            "camera": lines["camera"],
            "assumed": start.assumed,
            "rms": rms,
        }
        say_json(document, contents)
    elif not quiet:
        focal, center = (
            f"({a:.1f}, {b:.1f})" for a, b in (camera.focal, camera.center)
        )
        rest = "not checked: too few corners" if rms is None else f"rms {rms:.3f} px"
        word = "assumed focal" if start.assumed else "focal"
        say(
            f"{len(seen)} of {len(images)} images show the board, {size[0]} x "
            f"{size[1]} px\n"
            f"{len(pixels)} of {len(seen) * len(detector.points)} corners in them, "
            f"sigma {np.median(sigma):.3f} px (median)\n"
            f"start of the camera: {word} {focal}, center {center} px\n"
            f"  ({rest})\n"
        )
        say_written([f"wrote {path}" for path in contents])
    return 0


def _misstated(
    board: BoardSetup, fit: BoardSetup | None, markers: str, in_setup: bool
) -> InputError:
    """That images do not show a board, and which one they do.

    Args:
        board: The board as stated.
        fit: The board that they show, None if none is found.
        markers: Markers that they show.
        in_setup: Whether the board was stated in a setup file.
    """
    from calib_pin.io.boards import word_of
    from calib_pin.io.setup import yaml_text

    if fit is None or fit == board:
        seen = f"; seen: {markers}" if markers else ""
        return InputError(
            f"no image shows the board as stated ({board.type}, {board.columns} x "
            f"{board.rows}); are its type, numbers and dictionary right?{seen}"
        )
    line = f"--board {word_of(fit)}"
    if in_setup:
        line = yaml_text({"board": {k: v for k, v in vars(fit).items() if v}})
    reason = f"the images do not show {word_of(board)}"
    size = "marker" if board.type == "charuco" else "gap"
    if fit == replace(board, **{size: getattr(fit, size)}):
        reason = (
            f"the {size} is not {getattr(board, size):g} m beside {board.square:g} m"
        )
    if fit == replace(board, legacy=True):
        reason = (
            "its markers are found, its corners are not: a board of OpenCV before 4.6? "
            "add ':legacy'"
        )
    return InputError(f"{reason}; this fits: {line}")


def _require_camera(
    rms: Any, images: list[Path], seen: list[tuple[int, Found]]
) -> float | None:
    """Rms of the corners of all images about their camera [px]; None where unknown.

    Raises:
        InputError: If they are not those of one flat board before a camera.
    """
    import numpy as np

    known = [k for k, value in enumerate(rms) if np.isfinite(value)]
    if not known:
        return None
    counts = [len(seen[k][1].names) for k in known]
    total = float(np.sqrt(np.average(rms[known] ** 2, weights=counts)))
    sigma = float(np.median(np.concatenate([found.sigma for _, found in seen])))
    most = float(np.clip(NOISE * sigma, *MOST))
    worst = known[int(np.argmax(rms[known]))]
    if total > most or rms[worst] > MOST[1]:
        raise InputError(
            f"corners do not fit the board: rms {total:.3g} px with a noise of "
            f"{sigma:.2g} px, {rms[worst]:.3g} px in {images[seen[worst][0]].name}; is "
            "the board flat, and as stated?"
        )
    return total


def _natural(path: Path) -> list[str | int]:
    """A key by which img_2 stands before img_10."""
    parts = re.split(r"(\d+)", str(path))
    return [int(part) if k % 2 else part for k, part in enumerate(parts)]


def _configurations(
    file: Path | None, times: Path | None, images: list[Path], tell: Notice
) -> tuple[list[Path], dict[str, list[Any]]]:
    """Images of known joints, and for each the cells of the columns of their file.

    Raises:
        InputError: If it has not one row for each image, or columns of ours.
    """
    from calib_pin.io.table import read_table

    if file is None:
        return images, {}
    table = read_table(file)
    for name in OURS[1:]:
        if name in table:
            raise table.error("is a column that detect writes itself", name)
    if times is not None:
        table = _at_times(table, read_table(times), images, tell)
        stood = table.texts(["image"])["image"].distinct
        images = [path for path in images if path.name in stood]
    order = list(range(len(table.lines)))
    if "image" in table:
        order = _rows(table, images)
    elif len(order) != len(images):
        raise InputError(
            f"has {len(order)} rows for {len(images)} images; a column 'image' or, for "
            "a log, --times tells which belong together",
            file=file,
        )
    else:
        ends = (f"{images[k].name} with line {table.lines[k]}" for k in (0, -1))
        tell(f"images and rows of {file} are paired in order: {' to '.join(ends)}")
    cells = table.cells([name for name in table.columns if name != "image"])
    headers = {name: table.columns[name].header for name in cells}
    return images, {headers[n]: [c[row] for row in order] for n, c in cells.items()}


def _rows(table: Table, images: list[Path]) -> list[int]:
    """The row of each image in a table with a column `image`.

    Raises:
        InputError: If there is no such column, or an image has no row or several.
    """
    if "image" not in table:
        raise table.error("there is no column 'image'")
    stated = [Path(cell).name for cell in table.texts(["image"])["image"]]
    for row, name in enumerate(stated):
        if name in stated[:row]:
            raise table.cell_error("this image has a row already", "image", row)
    for path in images:
        if path.name not in stated:
            raise InputError(f"has no row for the image {path.name}", file=table.file)
    return [stated.index(path.name) for path in images]


def _at_times(joints: Table, taken: Table, images: list[Path], tell: Notice) -> Table:
    """The joints of a log where they stood at the time of an image, by its name.

    Raises:
        InputError: If the tables are no logs, or have no time in common.
    """
    import numpy as np

    import calib_pin.io.logs as logs
    from calib_pin.cli.join import STAND
    from calib_pin.io.table import read_table

    taken = logs.with_images(taken)
    positions = logs.read_joint_log(joints, {}, tell)
    readings = logs.read_reading_log(
        taken.rows(np.array(_rows(taken, images)), taken.columns), tell
    )
    readings, found = logs.join_logs(positions, readings, STAND, STAND, tell)
    return read_table(logs.encode_joined(found, positions, readings, keep=True))


def _remarks(images: list[Path], seen: list[tuple[int, Found]]) -> None:
    """Name the images without a board, and the blurred ones."""
    import numpy as np

    shown = {k for k, _ in seen}
    without = [path.name for k, path in enumerate(images) if k not in shown]
    if without:
        notice(f"no board in {len(without)} images: {enumerated(without)}")
    medians = np.array([np.median(found.sigma) for _, found in seen])
    blurred = medians > BLURRED * np.median(medians)
    if blurred.any():
        names = [
            images[k].name for (k, _), bad in zip(seen, blurred, strict=True) if bad
        ]
        notice(f"blurred or noisy: {enumerated(names)}")
