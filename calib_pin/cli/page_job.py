"""The job of one tab of a page: choices, the result they lead to, and what is shown.

All work is that of `init`, `calibrate`, `view` and `watch`, by the same functions; here
stands only when.
"""

from __future__ import annotations

import io
import threading
import zipfile
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import chdir
from dataclasses import dataclass, field, replace
from functools import partial, reduce
from pathlib import Path, PurePath
from typing import Any
from urllib.parse import quote

import calib_pin.guidance as guidance
from calib_pin.cli.asked import Init, Watch
from calib_pin.cli.calibrate import Inputs, calibrated, open_inputs
from calib_pin.cli.files import open_chains, open_setup
from calib_pin.cli.init import looked_at
from calib_pin.cli.options import Request, same
from calib_pin.cli.printing import complaint, notice, pop_notices, stage
from calib_pin.cli.watch import watched
from calib_pin.errors import CalibPinError
from calib_pin.io.columns import ANGLE, LENGTH, Column
from calib_pin.io.first_look import draft
from calib_pin.io.json_text import merged
from calib_pin.io.measured_columns import POSITION, measured
from calib_pin.io.results import REPORT, urdf_name
from calib_pin.io.setup import setup_document, yaml_text
from calib_pin.io.table import read_table
from calib_pin.io.urdf import bundled_robots, split_arguments
from calib_pin.io.yaml_tree import read_tree
from calib_pin.kinematics.chains import Chains
from calib_pin.kinematics.robot import Robot
from calib_pin.measurement_models import MEASUREMENT_MODELS
from calib_pin.report.blocks import Code, Line
from calib_pin.report.tiles import tiles
from calib_pin.report.trust import findings, next_step, verdict
from calib_pin.setup import Setup
from calib_pin.validation.calibrated_model import CalibratedModel
from calib_pin.validation.result import CalibrationResult
from calib_pin.viewer.app import Section, Widget, words
from calib_pin.viewer.scene import Scene, make_scene

ROBOTS, SETUPS = (".urdf", ".xacro", ".xml", ".mjcf"), (".yaml", ".yml")
"""Endings of files that are no measurements."""

NOTHING = "(choose)"

OUT, SETUP, ALL = Path("calibrated"), Path("setup.yaml"), "calibrated.zip"

LAST, STANDING = 6, ("waiting", "state", "next")
"""Lines on the latest rows of a file that is followed, and what stands above them."""


class Chosen(Init):
    """The choices of a person: the robot is empty as long as there is none.

    Attributes:
        text: The text of a setup file; empty to have one drafted.
        changes: Lines that were changed or added since.
    """

    robot: str = ""
    measurements: list[Path] = field(default_factory=list)
    text: str = ""
    changes: Mapping[str, Any] = field(default_factory=dict)


@dataclass
class Read:
    """The input, as far as it was read.

    Attributes:
        nominal: The robot; None for none yet.
        tips: Links that may be the tip, the likeliest first.
        fit: How well the nominal robot fits as drafted; empty without a draft.
        text: The setup file.
        keys: Its keys.
        columns: Columns of the first file.
        inputs: The input of `calibrate`; None as long as it cannot be used.
    """

    nominal: Robot | None = None
    tips: Sequence[str] = ()
    fit: str = ""
    text: str = ""
    keys: Mapping[str, Any] = field(default_factory=dict)
    columns: Mapping[str, Column] = field(default_factory=dict)
    inputs: Inputs | None = None


class Job:
    """The job of one tab.

    Args:
        folder: Folder of its own, for what is dropped.
        start: Folder from which paths are named.
        address: Address of a file of it, with {} for the name.
        submit: Has work done in another thread.

    Attributes:
        chosen: The choices of the person.
        read: The input that they name.
        scene: The robot, with its measurements as soon as they are read.
        result: The result, if it is calibrated.
        files: Files to download, by name.
        problem: Why something could not be done, on one line; empty if it could.
        stopped: Set to end what is being done.
    """

    def __init__(
        self, folder: Path, start: Path, address: str, submit: Callable[..., object]
    ) -> None:
        """Nothing is chosen yet."""
        self._folder, self._start, self._submit = folder, start, submit
        self._address, self.stopped = address, threading.Event()
        self.chosen, self.read, self.problem = Chosen(), Read(), ""
        self.scene: Scene | None = None
        self.result: CalibrationResult | None = None
        self.files = dict[str, bytes]()
        self._remarks, self._events = list[str](), list[guidance.Event]()
        self._stage: tuple[str, float | None] | None = None
        self._watch: guidance.Watch | None = None

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
        if name in ("", NOTHING):
            return
        path, source = Path(name), self._folder / name
        if not source.is_file() and (self._start / path.expanduser()).exists():
            path = source = self._start / path.expanduser()
        ending = path.suffix.lower()
        if source.is_dir():
            self.choose(package_dir=[path])
        elif ending in SETUPS and source.is_file():
            self.choose(text=source.read_text("utf-8", "replace"), changes={})
        elif ending in ROBOTS or not (ending or source.exists()):
            self.scene, robot = None, word.strip().replace(name, str(path), 1)
            self.choose(robot=robot, changes={})
        else:
            others = [p for p in self.chosen.measurements if p != path]
            self.choose(measurements=[*others, path])

    def choose(self, **chosen: Any) -> None:
        """Change what was chosen, and read it."""
        self.chosen, self._watch = replace(self.chosen, **chosen), None
        self._do(self._read)

    def change(self, lines: Mapping[str, Any]) -> None:
        """Put lines into the setup file."""
        self.choose(changes=merged(self.chosen.changes, lines))

    def calibrate(self) -> None:
        """Calibrate."""
        self._do(self._calibrate)

    def follow(self) -> None:
        """Follow the measurements while they are written."""
        assert self.read.inputs is not None
        self._events = []
        self._watch = watched(Watch(**same(self.read.inputs.request, Watch)))

    # --- what is done then ---------------------------------------------------------

    def _do(self, work: Callable[[], None], name: str = "waiting") -> None:
        self.stopped.clear()
        self._stage = name, None
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
        remarks = [*dict.fromkeys(pop_notices())]
        if work != self._look:
            self.problem, self._remarks = problem, remarks
        self._stage = None

    def _bar(self, name: str, part: float | None) -> None:
        self._stage = name, part
        if self.stopped.is_set():
            raise KeyboardInterrupt

    def _read(self) -> None:
        """Read what is there, by the setup file that it leads to, and draw it."""
        chosen, self.result, self.files = self.chosen, None, {}
        files, self.read = chosen.measurements, Read()
        if not chosen.robot:
            return
        self._bar("robot", None)
        chains = open_chains(chosen, setup := Setup())
        self.read = read = Read(chains.robot, text=chosen.text)
        if self.scene is None or not files:
            self.scene = self._make_scene(chains, setup)
        if not files:
            return
        self._bar("read", None)
        read.columns = read_table(files[0]).whole(chains.robot.model.names).columns
        fault: CalibPinError | None = None
        try:
            if not chosen.text:
                self._draft()
        except CalibPinError as error:
            fault = error  # As `calibrate` reads it, it may show what is wrong.
        self._state(read.text)
        if chosen.changes:
            head = read.text.partition("\n")[0] * bool(read.fit)
            lines = merged(read_tree(SETUP).data or {}, chosen.changes)
            self._state(f"{head}\n\n{yaml_text(lines)}\n".lstrip())
        asked = Request(**same(chosen, Request) | {"setup": SETUP})
        try:
            inputs = open_inputs(asked, OUT, force=True, bar=self._bar)
        except CalibPinError as error:
            raise (fault or error) from None
        if fault is not None and not chosen.changes:
            notice(f"no setup file could be drafted: {fault}")
        read.inputs = inputs
        self.scene = self._make_scene(inputs.chains, inputs.setup)

    def _state(self, text: str) -> None:
        """Write the setup file, and read it."""
        SETUP.write_text(text, "utf-8")
        self.files, self.read.text = {SETUP.name: text.encode()}, text
        self.read.keys = setup_document(open_setup(SETUP))

    def _draft(self) -> None:
        """Draft a setup file as `init` does."""

        def choose(question: str, choices: Sequence[str], _: str) -> str:
            if len(choices) > 1:
                notice(f"{question}? {choices[0]} is taken; change it below if need be")
            return choices[0]

        changes, read = self.chosen.changes, self.read
        known: Any = {key: changes.get(key) for key in ("base", "tip", "model")}
        robot, look = looked_at(replace(self.chosen, **known), choose)
        read.tips, read.text = look.tips, draft(robot, look, "calib-pin app")
        # It begins with comments on the whole.
        comments = read.text.partition("\n\n")[0].replace("\n#   ", " ")
        read.fit = "\n".join(comments.split("\n# ")[1:])

    def _calibrate(self) -> None:
        inputs = self.read.inputs
        assert inputs is not None
        result, contents = calibrated(inputs, bar=self._bar)
        files = {path.name: data for path, data in contents.items()}
        files[SETUP.name], stream = self.read.text.encode(), io.BytesIO()
        with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as archive:
            for name, data in files.items():
                archive.writestr(f"{OUT}/{name}", data)
        self.files = {ALL: stream.getvalue(), **files}
        self.result, model = result, result.model
        self.scene = self._make_scene(model.chains, inputs.setup, model)

    def _look(self) -> None:
        """Look whether there is more in the files, and read it."""
        if self._watch is None or (before := self.read.inputs) is None:
            return
        if events := [*self._watch.look()]:
            self._events += events
            self.read.inputs = inputs = open_inputs(before.request, OUT, force=True)
            self.scene = self._make_scene(inputs.chains, inputs.setup)

    def _make_scene(
        self, chains: Chains, setup: Setup, model: CalibratedModel | None = None
    ) -> Scene:
        inputs, folders = self.read.inputs, self.chosen.package_dir or ()
        data, tells = inputs.measurements if inputs else None, partial(stage, self._bar)
        return make_scene(
            chains, model, setup, data, None, folders, tell=notice, stage=tells
        )

    # --- what is shown -------------------------------------------------------------

    def sections(self) -> Iterator[Section]:
        """All sections of the page; files that are followed are looked at."""
        if self._watch is not None and self._stage is None:
            self._do(self._look, "")
        yield Section("Result", [*self._result()])
        yield Section("Now", [*self._status_widgets()])
        yield Section("While it is measured", [*self._follow_widgets()])
        yield Section("Chosen", [*self._listed()])
        yield Section("Found in the files", [*self._setup_choices()])
        yield Section("Robot and measurements", [*self._source_widgets()])
        yield Section(
            "Columns and units", [*self._columns()], "columns" in self.chosen.changes
        )
        yield Section("Setup file", [*self._lines()], expanded=False)
        view = [] if self.scene is None else [Widget("scene", value=self.scene)]
        yield Section("View", view, expanded=False)

    def _status_widgets(self) -> Iterator[Widget]:
        read, working = self.read, self._stage
        if working is not None and working[0]:
            yield Widget("progress", *working)
            yield Widget("button", "stop", do=self.stopped.set)
            return
        if self.problem:
            yield words(self.problem, "error")
        for remark in self._remarks:
            yield words(remark, "note")
        if self.problem and read.columns and read.inputs is None:
            hint = "Correct the file, or choose below what is known: tip, measured, "
            yield words(hint + "columns. A few rows need tip and measured.", "note")
        if not self.chosen.robot:
            yield words("Begin with the robot: its file, or a bundled one.")
        elif not self.chosen.measurements:
            yield words("Now the measurements: a table with a row for each.")
        elif read.inputs is not None and self.result is None:
            yield words("Robot and measurements are read: check what was found.")
            yield Widget("button", "Calibrate", tone="good", do=self.calibrate)
        elif read.inputs is not None:
            yield Widget("button", "Calibrate again", do=self.calibrate)

    def _follow_widgets(self) -> Iterator[Widget]:
        """The latest rows of files that another program writes, and where to go."""
        paths = self.chosen.measurements if self.read.inputs else ()
        if self._watch is None and paths and all(path.is_absolute() for path in paths):
            label = "follow the measurements while they are written"
            yield Widget("button", label, do=self.follow)
        if self._watch is None:
            return
        last = {e.kind: e for e in self._events if e.kind in STANDING}
        rows = [event for event in self._events if event.kind not in STANDING]
        for event in [*last.values(), *rows[-LAST:]]:
            wrong = event.kind in ("problem", "finding") or event.numbers.get("wrong")
            yield words(event.text, "error" if wrong else "plain")

    def _listed(self) -> Iterator[Widget]:
        robot, files = self.chosen.robot, self.chosen.measurements
        if robot:
            yield words(f"Robot: {robot}", "head")
        for path in files:
            others = [other for other in files if other != path]
            do = partial(self.choose, measurements=others)
            yield words(f"Measurements: {path}", "head")
            yield Widget("button", f"remove {path.name}", do=do)
        if robot in (known := bundled_robots()) and not files:
            do = partial(self.add, str(known[robot].with_name("measurements.csv")))
            yield Widget("button", "take its example measurements", do=do)

    def _source_widgets(self) -> Iterator[Widget]:
        """Where files come from; always the same, so that uploads are not disturbed."""
        prompt = "Drop files here: robot (URDF, xacro), measurements (CSV), setup file"
        names, path = (NOTHING, *bundled_robots()), ("or a path here",)
        yield Widget("upload", "or choose a file", prompt, do=self.give)
        yield Widget("choice", "or bundled robot", names[0], names, do=self.add)
        yield Widget("entry", "take this path", choices=path, do=self.add)

    def _setup_choices(self) -> Iterator[Widget]:
        read = self.read
        if read.nominal is None or not read.columns:
            return
        if read.fit:
            yield words(f"As drafted: {read.fit}" if self.chosen.changes else read.fit)
        if self.chosen.changes:
            yield words(f"Changed lines:\n{yaml_text(self.chosen.changes)}", "code")
        links = read.nominal.links
        for name in (chains := read.keys.get("chains", {})):
            yield self._choice(f"tip of {name}", links, "chains", name, "tip")
        if not chains:
            yield self._choice("tip", [*read.tips, *links], "tip")
            yield self._choice("base", links, "base")
        yield self._choice("measured", MEASUREMENT_MODELS, "model")

    def _columns(self) -> Iterator[Widget]:
        read = self.read
        if read.nominal is None or not read.columns:
            return
        joints, columns = [*read.nominal.model.names][1:], read.keys.get("columns", {})
        kinds, headers = (LENGTH.units, ANGLE.units), list[str]()
        for name, column in read.columns.items():
            # Another unit than that of the header is refused.
            free = column.numeric and not any(column.unit in kind for kind in kinds)
            every = (unit for kind in kinds if free for unit in kind)
            headers += [*(f"{name} [{unit}]" for unit in every), column.header]
        known = [name for name in read.columns if name in {*joints, *measured()}]
        missing = [] if read.fit else [*joints, *POSITION]
        for ours in dict.fromkeys([*columns, *known, *missing]):
            # The units of the column that is taken come first.
            source = str(columns.get(ours, ours)).partition(" [")[0]
            choices = sorted(headers, key=lambda one: one.partition(" [")[0] != source)
            yield self._choice(ours, choices, "columns", ours)

    def _choice(self, label: str, choices: Iterable[str], *keys: str) -> Widget:
        """The choice of a value of the setup file."""
        column = self.read.columns.get(label) if keys[0] == "columns" else None
        default = label if "columns" in keys else "(automatic)"
        value = reduce(lambda of, key: of.get(key) or {}, keys, self.read.keys)
        shown = str(value or (column.header if column else default))

        def change(word: Any) -> None:
            self.change(reduce(lambda of, key: {key: of}, reversed(keys), word))

        names = tuple(dict.fromkeys([shown, *choices]))
        return Widget("choice", label, shown, names, do=change)

    def _lines(self) -> Iterator[Widget]:
        if self.chosen.measurements:
            yield Widget("lines", "use these lines", self.read.text, do=self._take)
            yield self._links({SETUP.name: SETUP.name})

    def _take(self, text: str) -> None:
        """Take the lines of a person; where they are empty they are drafted."""
        self.choose(text=text.strip() and text, changes={})

    def _links(self, names: Mapping[str, str], tone: str = "plain") -> Widget:
        """Links to those of the files that are there, by what stands on them."""
        links = {k: self._address.format(quote(name)) for k, name in names.items()}
        known = {k: to for k, to in links.items() if names[k] in self.files}
        return Widget("links", value=known, tone=tone)

    def _result(self) -> Iterator[Widget]:
        """The verdict first, then findings with their lines, sizes, and the files."""
        if (result := self.result) is None:
            return
        lines = {yaml_text(f.setup): f.setup for f in result.findings if f.setup}
        first, urdf = verdict(result), urdf_name(result.model.chains.robot.name)
        yield words(first.text, first.tone)
        for block in [*findings(result.findings, result.reason), *next_step(result)]:
            if isinstance(block, Code):
                do = partial(self.change, lines[block.text])
                yield words(block.text, "code")
                yield Widget("button", "apply these lines", do=do)
            elif isinstance(block, Line) and not block.figure:
                yield words(block.text, "error" if block.tone == "bad" else block.tone)
        for tile in tiles(result):
            for step in tile.steps:
                sizes = f"{step.before.text} \N{RIGHTWARDS ARROW} {step.after.text}"
                change = f" ({step.change})" if step.change else ""
                label = f"{tile.label} {step.name}".strip()
                yield words(f"{label}: {sizes} {tile.unit}{change}", "head")
            yield words(tile.remark, "note")
        if urdf not in self.files:
            text = "There is no corrected robot: this result must not be trusted."
            yield words(text, "error")
        main = {f"corrected robot: {urdf}": urdf, "report": REPORT, "all files": ALL}
        yield self._links(main, "good")
        yield self._links({k: k for k in self.files if k not in main.values()})
