"""Files as people have them: relatives of the layouts that are read, damaged at random.

A simulated job with a known truth is written in one of the layouts, and one to three
things are done to a file: columns are added, sorted otherwise or called otherwise,
units and decimal marks change, readings are lost, the controller's pose stands beside,
a header is behind a sign. `join`, `init` and `calibrate` have nothing else.

An outcome is right where the corrected robot is as good as that of the files before the
damage; told where one line refuses the file and names what was done, or the verdict is
untrusted and says so; silent where a trusted verdict goes with a robot more than twice
as far off.

    scripts/benchmark relatives [--count 300] [--first 0] [--show]
"""

from __future__ import annotations

import argparse
import contextlib
import io
import re
import sys
import tempfile
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path

import numpy as np

import calib_pin
from benchmarks.layouts import WRITERS, Files, Job, job, table
from calib_pin.cli import main as command
from calib_pin.cli.files import open_chains, open_rows
from calib_pin.cli.options import OfRobot
from calib_pin.errors import CalibPinError
from calib_pin.estimation.evidence import TRUSTED
from calib_pin.workers.local import LocalProcesses

JOBS = 3
"""Jobs that are written."""

FAR = 2.0
"""Errors of the tool, by those of the files before the damage, that are wrong."""

LEAST = 2e-5
"""Errors of the tool below which there is nothing to tell apart [m]."""

RIGHT = 0.95
"""Part of the files that must be read rightly, or refused by what was done."""


@dataclass
class Sheet:
    """A file of cells below one line of names.

    Attributes:
        job: The job that it is of.
        names: Names of the columns.
        rows: Cells of each row.
        separator: Separator of two cells.
        comma: Whether decimal marks are commas.
        above: Lines above the names.
        sign: Sign before the names.
        end: Ends of lines.
        encoding: Encoding.
        behind: Lines behind the rows.
        quoted: Whether all cells stand in quotes.
        words: Words of which a line that refuses the file must have one.
    """

    job: Job
    names: list[str]
    rows: list[list[str]]
    separator: str
    comma: bool = False
    above: list[str] = field(default_factory=list)
    sign: str = ""
    end: str = "\n"
    encoding: str = "utf-8"
    behind: str = ""
    quoted: bool = False
    words: list[str] = field(default_factory=list)

    @staticmethod
    def of(job: Job, text: str) -> Sheet | None:
        """The cells of a file; None where names are not one line above the rows."""
        lines = text.splitlines()
        separator = max(",;\t ", key=lines[0].count)
        cells = [line.split(separator) for line in lines]
        if len({*map(len, cells)}) > 1 or not re.search("[a-z]", cells[0][-1]):
            return None
        numbers = [cell for cell in cells[1] if re.fullmatch(r"-?\d+\.\d+", cell)]
        if not numbers:
            return None
        return Sheet(job, cells[0], cells[1:], separator)

    def text(self) -> bytes:
        """The file."""
        rows = self.rows
        if self.comma:
            rows = [[cell.replace(".", ",") for cell in row] for row in rows]
        mark = '"' * self.quoted
        cells = ([f"{mark}{cell}{mark}" for cell in row] for row in [self.names, *rows])
        lines = [self.separator.join(row) for row in cells]
        lines = [*self.above, self.sign + lines[0], *lines[1:]]
        return (self.end.join(lines) + self.end + self.behind).encode(self.encoding)

    def change(self, name: str, change: Callable[[float], str]) -> None:
        """Write the numbers of a column otherwise."""
        k = self.names.index(name)
        for row in self.rows:
            if re.fullmatch(r"-?\d+\.\d+", row[k]):
                row[k] = change(float(row[k]))

    def insert(self, place: int, name: str, values: Sequence[object]) -> None:
        """Add a column."""
        self.names.insert(place, name)
        for row, value in zip(self.rows, values, strict=True):
            cell = f"{value:.6f}" if isinstance(value, float) else str(value)
            row.insert(place, cell)

    def rename(self, change: Callable[[str], str], names: Sequence[str]) -> None:
        """Call columns otherwise."""
        self.names = [change(name) if name in names else name for name in self.names]

    @property
    def joints(self) -> list[str]:
        """Columns that are called like joints."""
        return [name for name in self.names if name in self.job.joints]

    @property
    def points(self) -> list[str]:
        """Columns of measured points."""
        return [name for name in "xyz" if name in self.names]

    @property
    def numeric(self) -> list[str]:
        """Columns of numbers with decimals, but for times."""
        return [
            name
            for k, name in enumerate(self.names)
            if "time" not in name.lower() and "." in self.rows[0][k]
        ]


def plain(job: Job, rng: np.random.Generator) -> Files:
    """Joints and points in a file, with our names."""
    columns = [job.q[job.measured], job.point("Ball")[job.measured]]
    return {"measurements.csv": table([*job.joints, *"xyz"], columns)}


def numbered(job: Job, rng: np.random.Generator) -> Files:
    """Joints by their number in degrees, and points in millimeters."""
    name = str(rng.choice(["J{}", "A{}", "joint{}", "Axis {}"]))
    axes = str(rng.choice(["XYZ", "xyz"]))
    joints = [name.format(k + 1) for k in range(len(job.joints))]
    columns = [np.degrees(job.q[job.measured]), 1e3 * job.point("Ball")[job.measured]]
    return {"measurements.csv": table([*joints, *axes], columns)}


LAYOUTS = {**WRITERS, "plain": plain, "numbered": numbered}
"""All layouts, and two of spreadsheets."""

Damage = Callable[[np.random.Generator, Sheet], bool]
"""What is done to a file; false where it cannot be done to it."""


def added(rng: np.random.Generator, sheet: Sheet) -> bool:
    """Columns of other things."""
    count = len(sheet.rows)
    others: Mapping[str, Sequence[object]] = {
        "board_temperature": (30.0 + rng.normal(size=count)).tolist(),
        "Battery [V]": [24.1] * count,
        "index": range(count),
        "comment": ["ok"] * count,
        "load_cell_N": rng.normal(0.0, 5.0, count).tolist(),
        "robot_mode": [7] * count,
        "velocity_scale": [0.5] * count,
        "": [""] * count,
    }
    for name in rng.choice([*others], rng.integers(1, 4), replace=False):
        if name not in sheet.names:
            place = int(rng.integers(0, len(sheet.names) + 1))
            sheet.insert(place, str(name), others[str(name)])
    return True


def sorted_otherwise(rng: np.random.Generator, sheet: Sheet) -> bool:
    """Columns in another order."""
    if not (sheet.joints or sheet.points):
        return False  # Numbered columns that are not in order are another robot's.
    order = rng.permutation(len(sheet.names))
    sheet.names = [sheet.names[k] for k in order]
    sheet.rows = [[row[k] for k in order] for row in sheet.rows]
    return True


def degrees(rng: np.random.Generator, sheet: Sheet) -> bool:
    """Joints in degrees, and the header says so or not."""
    joints = sheet.joints
    for name in joints:
        sheet.change(name, lambda angle: f"{np.degrees(angle):.6f}")
    end = rng.choice([" [deg]", " (deg)", "_deg", ""])
    sheet.rename(lambda name: name + str(end), joints)
    sheet.words.append("unit")
    return bool(joints)


def millimeters(rng: np.random.Generator, sheet: Sheet) -> bool:
    """Points in millimeters, and the header says so or not."""
    points = sheet.points
    for name in points:
        sheet.change(name, lambda length: f"{1e3 * length:.3f}")
    end = str(rng.choice([" [mm]", " (mm)", "_mm", ""]))
    way = str(rng.choice(["{}", "pos_{}", "{}_meas", "Tracker {}"]))
    sheet.rename(lambda name: way.format(name) + end, points)
    sheet.words.append("unit")
    return bool(points)


def commas(rng: np.random.Generator, sheet: Sheet) -> bool:
    """Decimal commas."""
    sheet.separator, sheet.comma = str(rng.choice([";", "\t"])), True
    return True


def prefixed(rng: np.random.Generator, sheet: Sheet) -> bool:
    """Words before all names, as a logger has them."""
    word = str(rng.choice(["robot.", "log/", "msg_", "data."]))
    if not (sheet.joints or sheet.points):
        return False
    sheet.rename(lambda name: f"{word}{name}" if name else name, [*sheet.names])
    sheet.words += ["time", word]
    return True


def lost(rng: np.random.Generator, sheet: Sheet) -> bool:
    """Readings that are missing."""
    name = str(rng.choice(sheet.numeric))
    k = sheet.names.index(name)
    rows = rng.choice(len(sheet.rows), max(len(sheet.rows) // 40, 3), replace=False)
    cell = str(rng.choice(["", "nan", "N/A", "*", "MISSING", "-9999", "9E9"]))
    for row in rows:
        sheet.rows[row][k] = cell
    sheet.words += [
        "sign that there is no reading",
        "is missing",
        "cell is empty",
        cell,
    ]
    return True


def computed(rng: np.random.Generator, sheet: Sheet) -> bool:
    """The pose that the controller computes, beside."""
    time = next((n for n in sheet.names if n.lower() in ("time", "timestamp")), None)
    found = sheet.job.computed[:, :3, 3]
    if len(sheet.rows) != len(found):
        found = found[sheet.job.measured]
    if len(sheet.rows) != len(found) or (time is None and not sheet.joints):
        return False
    way = str(rng.choice(["tcp_{}", "robot_{}", "{}_ctrl", "ee_pos_{}"]))
    place = int(rng.integers(0, len(sheet.names) + 1))
    for axis, column in zip("zyx", found.T[::-1], strict=True):
        sheet.insert(place, way.format(axis), column.tolist())
    sheet.words.append("computed")
    return True


def zeros(rng: np.random.Generator, sheet: Sheet) -> bool:
    """An orientation that is none."""
    if len(sheet.points) < 3:
        return False
    ways = [("rx", "ry", "rz"), ("roll", "pitch", "yaw"), ("qx", "qy", "qz", "qw")]
    names = ways[int(rng.integers(3))]
    for name in names:
        value = 1.0 if name == "qw" else 0.0
        sheet.insert(len(sheet.names), name, [value] * len(sheet.rows))
    sheet.words.append("orientation")
    return True


def signed(rng: np.random.Generator, sheet: Sheet) -> bool:
    """A header behind the sign of a comment."""
    sheet.sign = str(rng.choice(["# ", "#", "% ", "// "]))
    return True


def preamble(rng: np.random.Generator, sheet: Sheet) -> bool:
    """Lines about the instrument above the header."""
    lines = ["Instrument: AT960", "Operator: me", "Date 2026-03-01", "# a comment", ""]
    sheet.above = lines[: int(rng.integers(1, 6))]
    return True


def encoded(rng: np.random.Generator, sheet: Sheet) -> bool:
    """Another encoding, ends of lines and blank lines."""
    sheet.encoding = str(rng.choice(["utf-16", "utf-8-sig", "latin-1"]))
    if sheet.encoding == "latin-1":
        sheet.insert(len(sheet.names), "Prüfer", ["Jörg"] * len(sheet.rows))
    sheet.end = str(rng.choice(["\n", "\r\n"]))
    sheet.behind = sheet.end * int(rng.integers(0, 3))
    return True


def quoted(rng: np.random.Generator, sheet: Sheet) -> bool:
    """Quotes around all cells."""
    sheet.quoted = True
    return True


def thousands(rng: np.random.Generator, sheet: Sheet) -> bool:
    """Millimeters with signs between thousands."""
    points = sheet.points
    for name in points:
        sheet.change(name, lambda length: f"{1e3 * length:,.3f}")
    sheet.separator = ";"
    sheet.words += ["thousands", "decimal", "unit"]
    return bool(points)


def counted(rng: np.random.Generator, sheet: Sheet) -> bool:
    """Times in another unit, from the start or from 1970."""
    time = next((n for n in sheet.names if n.lower() in ("time", "timestamp")), None)
    if time is None or not (sheet.joints or sheet.points):
        return False  # Others say in which unit their times are.
    factor = float(rng.choice([1e3, 1e6, 1e9]))
    sheet.change(time, lambda value: str(round(factor * (value + 1.7e9))))
    sheet.words += ["time", "standstill"]
    return True


DAMAGES: Sequence[Damage] = (
    added,
    sorted_otherwise,
    degrees,
    millimeters,
    commas,
    prefixed,
    lost,
    computed,
    zeros,
    signed,
    preamble,
    encoded,
    quoted,
    thousands,
    counted,
)


@dataclass(frozen=True)
class Outcome:
    """The outcome of a file.

    Attributes:
        seed: Its number.
        layout: Its layout.
        damages: What was done to it.
        kind: `right`, `told`, `silent` or `unclear`.
        ratio: Errors of the tool by those before the damage; nan where none is found.
        line: The last line that was said.
    """

    seed: int
    layout: str
    damages: tuple[str, ...]
    kind: str
    ratio: float
    line: str


@cache
def made(seed: int) -> Job:
    """A job."""
    return job(seed=seed)


def calibrated(files: Mapping[str, bytes], of: Job) -> tuple[str, str, float]:
    """Verdict, its reason, and errors of the tool of the corrected robot [m].

    Raises:
        CalibPinError: If a file is refused.
    """
    with tempfile.TemporaryDirectory() as folder, contextlib.chdir(folder):
        for name, data in files.items():
            Path(name).write_bytes(data)
        tables = sorted(name for name in files if not name.endswith(".json"))
        rows = Path("m.csv")
        if len(tables) > 1:
            tables.sort(key=lambda name: name != "joints.csv")
            _said(["join", *tables, "-o", "m.csv"])
        else:
            rows = Path(tables[0])
        _said(["init", of.robot, str(rows), "-o", "s.yaml"])
        setup = calib_pin.read_setup("s.yaml")
        asked = OfRobot(robot=of.robot)
        chains = open_chains(asked, setup)
        chains, data = open_rows(asked, [rows], chains, setup, quiet=True)
        result = calib_pin.calibrate(chains, data, setup)
        if result.verdict not in TRUSTED:
            return result.verdict, result.reason, np.nan
        calib_pin.write_urdf(result.model, "corrected.urdf")
        chain = calib_pin.load_chain("corrected.urdf", tip=of.tip)
    q, poses = of.truth
    truth = calib_pin.Measurements(chain.joints, q, "position", poses[:, :3, 3])
    ((_, _, errors),) = calib_pin.evaluate(chain, truth).errors
    return result.verdict, result.reason, errors.rms


def _said(words: Sequence[str]) -> None:
    """Run a command.

    Raises:
        CalibPinError: With what it said, if it fails.
    """
    said = io.StringIO()
    with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(said):
        status = command([*words])
    if status:
        lines = said.getvalue().strip().splitlines()
        raise CalibPinError(lines[-1] if lines else f"status {status}")


@cache
def undamaged(layout: str, seed: int) -> float:
    """Errors of the tool of the files before the damage [m]."""
    files = LAYOUTS[layout](made(seed), np.random.default_rng(seed))
    return calibrated({n: text.encode() for n, text in files.items()}, made(seed))[2]


def damaged(
    files: Files, of: Job, rng: np.random.Generator
) -> tuple[dict[str, bytes], list[str], list[str]]:
    """The files, one of them changed; what was done, and words that name it."""
    found = {name: text.encode() for name, text in files.items()}
    sheets = {
        name: sheet
        for name, text in files.items()
        if not name.endswith(".json") and (sheet := Sheet.of(of, text)) is not None
    }
    if not sheets:
        return found, [], []
    name = str(rng.choice([*sheets]))
    sheet, done = sheets[name], list[str]()
    for damage in rng.choice(len(DAMAGES), 6, replace=False):
        change = DAMAGES[int(damage)]
        if len(done) < int(rng.integers(1, 4)) and change(rng, sheet):
            done.append(change.__name__)
    # Quotes are around the cells that other changes have made.
    found[name] = sheet.text()
    return found, [f"{name}: {', '.join(done)}"], sheet.words


def run(seed: int) -> Outcome:
    """The outcome of a number."""
    rng = np.random.default_rng(seed)
    number, layout = int(rng.integers(JOBS)), str(rng.choice([*LAYOUTS]))
    of = made(number)
    files = LAYOUTS[layout](of, np.random.default_rng(number))
    found, done, words = damaged(files, of, rng)
    ratio, line = np.nan, ""
    try:
        verdict, line, error = calibrated(found, of)
        line = f"{verdict.upper()}: {line}"
        ratio = error / max(undamaged(layout, number), LEAST)
        kind = "unclear"
        if verdict in TRUSTED:
            kind = "right" if error <= LEAST or ratio <= FAR else "silent"
    except CalibPinError as error:
        line, kind = str(error), "unclear"
    if kind == "unclear" and any(word and word in line for word in words):
        kind = "told"
    return Outcome(seed, layout, tuple(done), kind, ratio, line)


def _run(shared: None, number: int) -> Outcome:
    return run(number)


def main() -> None:
    """Print how many files are read rightly, and those that are not."""
    parser = argparse.ArgumentParser(prog="benchmark relatives")
    parser.add_argument("name", nargs="*")
    parser.add_argument("--count", type=int, default=300)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--show", action="store_true")
    asked = parser.parse_args()
    numbers = range(asked.first, asked.first + asked.count)
    with LocalProcesses(patience=0.0) as workers:
        found = list(workers.map(_run, None, numbers))
    for one in found:
        if asked.show or one.kind in ("silent", "unclear"):
            done = "; ".join(one.damages) or "as it is"
            print(f"{one.seed:4d} {one.kind:8}{one.layout:22}{done}: {one.line}")
    kinds = Counter(one.kind for one in found)
    told = (kinds["right"] + kinds["told"]) / len(found)
    passed = not kinds["silent"] and told >= RIGHT
    print(f"{len(found)} files: {dict(kinds)}; right or told {100 * told:.1f} %")
    if not passed:
        sys.exit(1)


if __name__ == "__main__":
    main()
