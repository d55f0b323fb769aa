"""A folder of images of a board, whose corners become rows as images come."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from calib_pin.cli.detect import Detection, configurations_of, numbers_in
from calib_pin.errors import InputError, OptionError

ENDINGS = (".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff", ".pgm", ".ppm")


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
    import calib_pin.io.boards as boards
    from calib_pin.io.measurements import encode_table
    from calib_pin.io.table import read_table

    if not folder.is_dir() or joints is None:
        raise OptionError("--board needs a folder of images, and --joints", file=folder)
    detector, file = boards.Detector(boards.board_of(board)), folder.with_suffix(".csv")
    seen = set[str]()
    if file.exists():
        seen |= {*read_table(file).texts(["image"])["image"]}

    def add() -> None:
        time.sleep(pause)
        there = (p for p in folder.iterdir() if p.suffix.lower() in ENDINGS)
        new = [path for path in there if path.name not in seen]
        for image in sorted(new, key=numbers_in):
            try:
                asked = Detection(images=[image], joints=joints)
                _, cells = configurations_of(asked, [image])
                _, (found,) = boards.find_board(detector, [image], None)
            except InputError:
                continue  # Its configuration, or a part of it, is not there yet.
            seen.add(image.name)
            if not (count := len(found.names)):
                continue
            columns: dict[str, Any] = {"image": [image.name] * count}
            columns |= {name: cell * count for name, cell in cells.items()}
            columns["target"] = list(found.names)
            for k, name in enumerate("uv"):
                columns[name] = found.pixels[:, k].round(4)
                columns[f"sigma_{name}"] = found.sigma[:, k].round(4)
            header, _, rows = encode_table(columns, ()).partition(b"\n")
            with file.open("ab") as stream:
                stream.write(rows if stream.tell() else header + b"\n" + rows)

    add()
    return file, add
