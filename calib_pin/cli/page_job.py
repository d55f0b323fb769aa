"""The job of one tab of a page: what was chosen, what it leads to, and what is shown.

Whatever is done is what `init`, `calibrate`, `view` and `watch` do, by the same
functions; here stands only when.
"""

from __future__ import annotations

import io
import threading
import zipfile
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import chdir
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path, PurePath
from typing import Any
from urllib.parse import quote, unquote

import yaml

from calib_pin.cli.files import open_chains, open_setup
from calib_pin.cli.init import Draft, looked_at
from calib_pin.cli.printing import complaint, notice, stage, taken_notices
from calib_pin.cli.request import Request
from calib_pin.cli.requests import Opened, calibrated, opened
from calib_pin.cli.watch import watched
from calib_pin.errors import CalibPinError, OptionError
from calib_pin.guidance import Event, Watch
from calib_pin.io.columns import ANGLE, LENGTH, split_header
from calib_pin.io.first_look import Look, draft
from calib_pin.io.foreign_headers import foreign
from calib_pin.io.json_text import merged
from calib_pin.io.measured_columns import measured
from calib_pin.io.results import REPORT, urdf_name
from calib_pin.io.setup import yaml_text
from calib_pin.io.table import read_table
from calib_pin.io.urdf import bundled_robots, split_arguments
from calib_pin.io.yaml_tree import read_tree
from calib_pin.kinematics.chains import Chains
from calib_pin.kinematics.robot import Robot
from calib_pin.kinematics.tree import turns
from calib_pin.measurement_models import MEASUREMENT_MODELS
from calib_pin.observations import Observations
from calib_pin.report.blocks import Code, Line
from calib_pin.report.tiles import tiles
from calib_pin.report.trust import findings, next_step, verdict
from calib_pin.setup import Setup
from calib_pin.validation.calibrated_model import CalibratedModel
from calib_pin.validation.result import CalibrationResult
from calib_pin.viewer.app import Section, Widget
from calib_pin.viewer.scene import Scene, make_scene

ROBOTS, SETUPS = (".urdf", ".xacro", ".xml", ".mjcf"), (".yaml", ".yml")
"""Endings of files that are no measurements."""

PAUSE = 1.0
"""Time between two looks at files that are followed [s]."""

OUT, SETUP, ALL = Path("calibrated"), Path("setup.yaml"), "calibrated.zip"

LAST = 6
"""Lines on the latest rows of a file that is followed."""


@dataclass(frozen=True)
class Chosen:
    """What a person has chosen.

    Attributes:
        robot: The robot as `calibrate` takes it; empty for none yet.
        measurements: The measurement files.
        packages: Folders of the packages of the robot.
        setup: The text of a setup file; empty to have one drafted.
        changes: Lines that were changed or added since.
        distance: That of the two sockets of a place, where `init` asks for it.
    """

    robot: str = ""
    measurements: tuple[Path, ...] = ()
    packages: tuple[Path, ...] = ()
    setup: str = ""
    changes: Mapping[str, Any] = field(default_factory=dict)
    distance: str | None = None


class Job:
    """The job of one tab.

    Args:
        folder: Folder of its own, for what is dropped.
        start: Folder from which paths are named.
        address: Address of a file of it, with {} for the name.
        submit: Has work done in another thread.

    Attributes:
        chosen: What a person has chosen.
        scene: The robot, with its measurements as soon as they are read.
        nominal: The robot, read; None for none yet.
        look: What `init` has found; None without a look, as with a setup file.
        text: The setup file.
        keys: Its keys.
        columns: Columns with units that may be meant, by our names.
        opened: The input, read by it; None as long as it cannot be.
        question: What only a person knows; empty for nothing.
        stage: What is being done, and which part of it; None while nothing is.
        problem: Why something could not be done, on one line; empty if it could.
        remarks: What may be otherwise than one thinks.
        result: The result, if it is calibrated.
        files: Files to download, by name.
        events: What is told of files that are followed; None where none is.
    """

    def __init__(
        self, folder: Path, start: Path, address: str, submit: Callable[..., object]
    ) -> None:
        """Nothing is chosen yet."""
        self._folder, self._start, self._submit = folder, start, submit
        self._address, self._stopped = address, threading.Event()
        self.chosen, self.text, self.question, self.problem = Chosen(), "", "", ""
        self.scene: Scene | None = None
        self.nominal: Robot | None = None
        self.look: Look | None = None
        self.opened: Opened | None = None
        self.stage: tuple[str, float | None] | None = None
        self.remarks, self.files = list[str](), dict[str, bytes]()
        self.keys, self.columns = dict[str, Any](), dict[str, list[str]]()
        self.result: CalibrationResult | None = None
        self.events: list[Event] | None = None
        self._watch: Watch | None = None
        self._waited = 0.0

    # --- what a person does --------------------------------------------------------

    def give(self, name: str, content: bytes) -> None:
        """Take in a file that was dropped or chosen; one of the same name goes."""
        name = PurePath(name.replace("\\", "/")).name
        if name not in ("", "..") and name.isprintable():
            Path(self._folder, name).write_bytes(content)
            self.add(name)

    def add(self, word: str) -> None:
        """Take a robot by its name, or a file or folder of this machine by its path."""
        name = split_arguments(word.strip())[0]
        path, there = Path(name), self._folder / name
        if not there.is_file() and (self._start / path.expanduser()).exists():
            path = there = self._start / path.expanduser()
        ending, robot = path.suffix.lower(), word.strip().replace(name, str(path), 1)
        if there.is_dir():
            self.choose(packages=(path,))
        elif ending in SETUPS and there.is_file():
            self.choose(setup=there.read_text("utf-8", "replace"), changes={})
        elif ending in ROBOTS or not there.exists():
            self.scene = None
            self.choose(robot=robot, changes={})
        else:
            others = (p for p in self.chosen.measurements if p != path)
            self.choose(measurements=(*others, path))

    def choose(self, **chosen: Any) -> None:
        """Change what was chosen, and read it."""
        self.chosen, self.events = replace(self.chosen, **chosen), None
        self._do(self._read)

    def change(self, lines: Mapping[str, Any]) -> None:
        """Put lines into the setup file."""
        self.choose(changes=merged(self.chosen.changes, lines))

    def calibrate(self) -> None:
        """Calibrate."""
        self._do(self._calibrate)

    def follow(self) -> None:
        """Follow the measurements while they are written."""
        assert self.opened is not None
        self.events, self._watch = [], watched(self.opened.request)

    def stop(self) -> None:
        """End what is being done."""
        self._stopped.set()

    # --- what is done then ---------------------------------------------------------

    def _do(self, work: Callable[[], None], name: str = "waiting") -> None:
        self._stopped.clear()
        self.stage = name, None
        self._submit(self._done, work)

    def _done(self, work: Callable[[], None]) -> None:
        """Work in the folder of the job, with what goes wrong as a line."""
        problem = ""
        try:
            with chdir(self._folder):
                work()
        except KeyboardInterrupt:
            problem = "stopped"
        except Exception as error:
            problem = complaint(error)
        remarks = [*dict.fromkeys(taken_notices())]
        if work != self._look:
            self.problem, self.remarks = problem, remarks
        self.stage = None

    def _bar(self, name: str, part: float | None) -> None:
        self.stage = name, part
        if self._stopped.is_set():
            raise KeyboardInterrupt

    def _read(self) -> None:
        """Read what is there, by the setup file that it leads to, and draw it."""
        self.result = self.opened = self.look = None
        chosen, self.files, self.keys, self.columns = self.chosen, {}, {}, {}
        self.text, self.question = chosen.setup, ""
        if chosen.robot and (self.scene is None or not chosen.measurements):
            self._bar("robot", None)
            setup = open_setup(None)
            chains = open_chains(chosen.robot, setup, package_dirs=chosen.packages)
            self.nominal, self.scene = chains.robot, self._drawn(chains, setup)
        if not chosen.robot or not chosen.measurements:
            return
        self._bar("read", None)
        fault: CalibPinError | None = None
        try:
            self.text = chosen.setup or self._draft()
        except CalibPinError as error:
            fault = error  # As `calibrate` reads it, it may show what is wrong.
        self.text = with_lines(self.text, chosen.changes)
        SETUP.write_text(self.text, "utf-8")
        self.files = {SETUP.name: self.text.encode()}
        files, folders = [*chosen.measurements], [*chosen.packages]
        self.keys = read_tree(SETUP).data or {}
        joints = list(self.nominal.model.names)[1:] if fault else self.look.joints
        stated = self.keys.get("columns") or {}
        self.columns = readable(self.nominal, files[0], joints, stated)
        asked = Request(chosen.robot, files, folders, setup=SETUP)
        try:
            self.opened = opened(asked, OUT, force=True, bar=self._bar)
        except CalibPinError as error:
            raise (fault or error) from None
        if fault is not None:
            notice(f"no setup file could be drafted: {fault}")
        self.scene = self._drawn(self.opened.chains, self.opened.setup)

    def _draft(self) -> str:
        """The setup file that `init` drafts."""

        def choose(question: str, choices: Sequence[str], _: str) -> str:
            if len(choices) > 1:
                notice(f"{question}? {choices[0]} is taken; change it below if need be")
            return choices[0]

        def ask(question: str) -> str:
            self.question = question
            raise OptionError(question)

        chosen = self.chosen
        asked = Draft(
            robot=chosen.robot,
            measurements=[*chosen.measurements],
            package_dir=[*chosen.packages],
            base=chosen.changes.get("base"),
            tip=chosen.changes.get("tip"),
            model=chosen.changes.get("model"),
            distance=chosen.distance,
        )
        robot, self.look = looked_at(asked, choose, ask)
        return draft(robot, self.look, "calib-pin app")

    def _calibrate(self) -> None:
        given = self.opened
        assert given is not None
        found = calibrated(given, given.request.words(OUT), bar=self._bar)
        files = {path.name: data for path, data in found.contents.items()}
        files[SETUP.name], stream = self.text.encode(), io.BytesIO()
        with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as archive:
            for name, data in files.items():
                archive.writestr(f"{OUT}/{name}", data)
        self.files = {ALL: stream.getvalue(), **files}
        self.result, model = found.result, found.result.model
        self.scene = self._drawn(model.chains, given.setup, model)

    def _look(self) -> None:
        assert self._watch is not None and self.opened is not None
        if found := [*self._watch.look()]:
            self.events = [*(self.events or ()), *found]
            self.opened = opened(self.opened.request, OUT, force=True)
            self.scene = self._drawn(self.opened.chains, self.opened.setup)

    def _drawn(
        self, chains: Chains, setup: Setup, model: CalibratedModel | None = None
    ) -> Scene:
        given, folders = self.opened, self.chosen.packages

        def read(*_: object, **options: object) -> tuple[Chains, Observations]:
            assert given is not None
            return given.chains, given.measurements

        tells, rows = partial(stage, self._bar), None if given is None else read
        return make_scene(
            chains, model, setup, rows, None, folders, tell=notice, stage=tells
        )

    # --- what is shown -------------------------------------------------------------

    def sections(self, seconds: float) -> Iterator[Section]:
        """What the page says and asks, some seconds after the last time."""
        self._waited += seconds
        if self.events is not None and self.stage is None and self._waited > PAUSE:
            self._waited = 0.0
            self._do(self._look, "")
        yield Section("Result", [*self._result()])
        yield Section("Now", [*self._now()])
        yield Section("While it is measured", [*self._followed()])
        yield Section("Chosen", [*self._chosen()])
        yield Section("What was found", [*self._found()])
        yield Section("Robot and measurements", [*self._asked()])
        columns = [self._choice(k, of, "columns", k) for k, of in self.columns.items()]
        yield Section("Columns and units", columns, expanded=False)
        yield Section("Setup file", [*self._lines()], expanded=False)

    def _now(self) -> Iterator[Widget]:
        if self.stage is not None and self.stage[0]:
            yield Widget("progress", *self.stage)
            yield Widget("button", "stop", do=self.stop)
            return
        if self.problem:
            yield Widget("words", value=self.problem, tone="error")
        if self.question:
            label = (self.question,)
            yield Widget("entry", "take this length", choices=label, do=self._answer)
        for remark in self.remarks:
            yield Widget("words", value=remark, tone="note")
        if not self.chosen.robot:
            yield Widget(
                "words", value="Begin with the robot: its file, or a bundled one."
            )
        elif not self.chosen.measurements:
            yield Widget(
                "words", value="Now the measurements: a table, a row for each."
            )
        elif self.opened is not None:
            if self.result is None:
                said = "Robot and measurements are read: check what was found."
                yield Widget("words", value=said)
            yield Widget("button", "Calibrate", tone="good", do=self.calibrate)

    def _followed(self) -> Iterator[Widget]:
        """The latest rows of files that another program writes, and where to go."""
        if self.events is None:
            if self.opened is not None and all(
                path.is_absolute() for path in self.chosen.measurements
            ):
                said = "follow the measurements while they are written"
                yield Widget("button", said, do=self.follow)
            return
        latest = {event.kind: event for event in self.events}
        rows = [e for e in self.events if e.kind not in ("state", "next", "waiting")]
        shown = [latest.get("waiting"), latest.get("state"), latest.get("next")]
        for event in [*filter(None, shown), *rows[-LAST:]]:
            wrong = event.kind in ("problem", "finding") or event.numbers.get("wrong")
            tone = "error" if wrong else "plain"
            yield Widget("words", value=event.text, tone=tone)

    def _chosen(self) -> Iterator[Widget]:
        robot, files, known = (
            self.chosen.robot,
            self.chosen.measurements,
            bundled_robots(),
        )
        if robot:
            yield Widget("words", value=f"Robot: {robot}", tone="head")
        for path in files:
            others = tuple(other for other in files if other != path)
            do = partial(self.choose, measurements=others)
            yield Widget("words", value=f"Measurements: {path}", tone="head")
            yield Widget("button", f"remove {path.name}", do=do)
        if robot in known and not files:
            do = partial(self.add, str(known[robot].with_name("measurements.csv")))
            yield Widget("button", "take its example measurements", do=do)

    def _asked(self) -> Iterator[Widget]:
        """Where files come from; always the same, so that uploads are not disturbed."""
        said = "Drop files here: the robot (URDF, xacro), measurements (CSV, ...), and "
        said += "a setup file if there is one"
        names = ("(choose)", *bundled_robots())
        yield Widget("upload", "or choose a file", said, do=self.give)
        yield Widget("choice", "or bundled robot", names[0], names, do=self.add)
        yield Widget(
            "entry", "take this path", choices=("or a path here",), do=self.add
        )

    def _found(self) -> Iterator[Widget]:
        if self.nominal is None or not self.chosen.measurements:
            return
        if self.look is not None:
            # The draft begins with how well the nominal robot fits.
            head = self.text.partition("\n\n")[0].replace("\n#   ", " ").split("\n# ")
            yield Widget("words", value="\n".join(head[1:]))
        if self.chosen.changes:
            said = f"Changed lines:\n{yaml_text(self.chosen.changes)}"
            yield Widget("words", value=said, tone="code")
        links, tips = self.nominal.links, [] if self.look is None else self.look.tips
        chains = self.keys.get("chains") or {}
        for name in chains:
            yield self._choice(f"tip of {name}", links, "chains", name, "tip")
        if not chains:
            yield self._choice("tip", [*tips, *links], "tip")
            yield self._choice("base", links, "base")
        yield self._choice("measured", MEASUREMENT_MODELS, "model")

    def _choice(self, label: str, choices: Iterable[str], *keys: str) -> Widget:
        """The choice of a value of the setup file."""
        found: Any = self.keys
        for key in keys:
            found = found.get(key) if isinstance(found, dict) else None

        def change(word: str) -> None:
            lines: Any = word
            for key in reversed(keys):
                lines = {key: lines}
            self.change(lines)

        shown = str(found or (keys[-1] if keys[0] == "columns" else "(automatic)"))
        names = tuple(dict.fromkeys([shown, *choices]))
        return Widget("choice", label, shown, names, do=change)

    def _lines(self) -> Iterator[Widget]:
        if self.chosen.measurements:
            yield Widget("lines", "use these lines", self.text, do=self._write)
            yield self._links([SETUP.name])

    def _answer(self, distance: str) -> None:
        self.choose(distance=distance)

    def _write(self, text: str) -> None:
        self.choose(setup=text.strip() and text, changes={})

    def _links(self, names: Iterable[str], tone: str = "plain") -> Widget:
        """Links to those of the files that are there."""
        there = {name: self._address.format(quote(name)) for name in names}
        known = {name: to for name, to in there.items() if name in self.files}
        return Widget("links", value=known, tone=tone)

    def _result(self) -> Iterator[Widget]:
        """The verdict first, then findings with their lines, accuracy, and the files."""
        if (result := self.result) is None:
            return
        lines = {yaml_text(f.setup): f.setup for f in result.findings if f.setup}
        first, urdf = verdict(result), urdf_name(result.model.chains.robot.name)
        yield Widget("words", value=first.text, tone=first.tone)
        for block in [*findings(result.findings, result.reason), *next_step(result)]:
            if isinstance(block, Code):
                do = partial(self.change, lines[block.text])
                yield Widget("words", value=block.text, tone="code")
                yield Widget("button", "apply these lines", do=do)
            elif isinstance(block, Line) and not block.figure:
                tone = "error" if block.tone == "bad" else block.tone
                yield Widget("words", value=block.text, tone=tone)
        for tile in tiles(result):
            for step in tile.steps:
                sizes = f"{step.before.text} \N{RIGHTWARDS ARROW} {step.after.text}"
                said = f"{tile.label} {step.name}: {sizes} {tile.unit} {step.change}"
                yield Widget("words", value=said.replace(" :", ":"), tone="head")
            yield Widget("words", value=tile.remark, tone="note")
        if urdf not in self.files:
            said = "There is no corrected robot: this result must not be trusted."
            yield Widget("words", value=said, tone="error")
        yield self._links([urdf, REPORT], "good")
        yield self._links(name for name in self.files if name not in (urdf, REPORT))


class Jobs:
    """The jobs of all tabs.

    Args:
        folder: Where each has a folder of its own.
        submit: Has work done in another thread, one after another.
    """

    def __init__(self, folder: Path, submit: Callable[..., object]) -> None:
        """There is no job yet."""
        self._folder, self._start, self._submit = folder, Path.cwd(), submit
        self._jobs = dict[str, Job]()

    def of(self, tab: str, address: str) -> Job:
        """The job of a tab.

        Args:
            tab: Name of the tab.
            address: Address of a file of it, with {} for the name.
        """
        if tab not in self._jobs:
            folder = self._folder / str(len(self._jobs))
            folder.mkdir()
            self._jobs[tab] = Job(folder, self._start, address, self._submit)
        return self._jobs[tab]

    def file(self, path: str) -> tuple[str, bytes] | None:
        """The type and the content of a file of a job, by the path of its address."""
        tab, _, name = path[1:].partition("/")
        name = unquote(name)
        if tab not in self._jobs or name not in (files := self._jobs[tab].files):
            return None
        kind = "text/html; charset=utf-8" if name == REPORT else "application/zip"
        return kind, files[name]

    def stop(self) -> None:
        """End what is being done."""
        for job in self._jobs.values():
            job.stop()


def with_lines(text: str, lines: Mapping[str, Any]) -> str:
    """A setup file with further lines; of its comments the first ones stay."""
    if not lines:
        return text
    head = text.partition("\n\n")[0] if text.startswith("#") else ""
    return (
        f"{head}\n\n{yaml_text(merged(yaml.safe_load(text) or {}, lines))}\n".lstrip()
    )


def readable(
    robot: Robot, file: Path, joints: Iterable[str], stated: Mapping[str, Any]
) -> dict[str, list[str]]:
    """Columns of a file with their units, by what they may stand for."""
    table = read_table(file).whole(robot.model.names)
    columns = {one.name: one for one in foreign(table.columns)}
    kinds = {n: kind for n, kind in measured().items() if n in {*columns, *stated}}
    kinds |= {j: ANGLE if turns(robot.model, j) else LENGTH for j in joints}
    found = dict[str, list[str]]()
    for ours, kind in kinds.items():
        name, unit = split_header(str(stated.get(ours, ours)))
        own = [columns[name].stated(unit) for unit in kind.units if name in columns]
        found[ours] = own + [
            one.stated(unit) for one in columns.values() if one.numeric
        ]
    return found
