"""`calib-pin app`: `init`, `calibrate` and `view` behind the widgets of a page."""

from __future__ import annotations

import io
import re
import threading
import zipfile
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import chdir
from dataclasses import dataclass
from functools import partial
from pathlib import Path, PurePath
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Annotated, Any
from urllib.parse import quote, unquote

import calib_pin.cli.options as options
from calib_pin.cli.files import open_chains, open_setup
from calib_pin.cli.init import Draft, looked_at
from calib_pin.cli.printing import complaint, notice, stage, taken_notices
from calib_pin.cli.request import Request, Told
from calib_pin.cli.requests import Opened, calibrated, opened
from calib_pin.cli.view import PORT, require_viser, serve
from calib_pin.errors import OptionError

if TYPE_CHECKING:
    from calib_pin.io.first_look import Look
    from calib_pin.kinematics.chains import Chains
    from calib_pin.kinematics.robot import Robot
    from calib_pin.observations import Observations
    from calib_pin.setup import Setup
    from calib_pin.validation.calibrated_model import CalibratedModel
    from calib_pin.validation.result import CalibrationResult
    from calib_pin.viewer.app import Section, Widget
    from calib_pin.viewer.scene import Scene

ROBOTS = (".urdf", ".xacro", ".xml", ".mjcf")
SETUPS = (".yaml", ".yml")
"""Endings of files that are no measurements."""

OUT, SETUP = Path("calibrated"), Path("setup.yaml")

TYPES = {".html": "text/html; charset=utf-8", ".zip": "application/zip"}


@dataclass(frozen=True, kw_only=True)
class App:
    """A page as it is asked for.

    Attributes:
        port: Port on this machine; 0 for any free port.
        once: Stop when the last tab is closed.
    """

    port: Annotated[int, Told("N", "Window", PORT)] = 8080
    once: Annotated[bool, Told("", "Window")] = False


@options.spread
def app(asked: App) -> int:
    """Calibrate in a page of the browser, from two files to a corrected URDF.

    A robot and measurements are dropped or chosen there; the page shows what was found,
    calibrates, and has the results to download. It is open to this machine only, at the
    address that is printed. Every tab is a job of its own. What is dropped goes to a
    temporary folder, which is removed at the end.
    """
    require_viser()
    from calib_pin.viewer.app import Page
    from calib_pin.viewer.server import Window

    jobs, start = dict[str, Job](), Path.cwd()
    # One after another: they share the remarks, the working folder and the processors.
    with TemporaryDirectory(prefix="calib-pin-") as folder:
        executor = ThreadPoolExecutor(1)
        window = Window("calib-pin", asked.port, partial(file_of, jobs))

        def page(client: Any, tab: str) -> Callable[[float], None]:
            if tab not in jobs:
                own = Path(folder, str(len(jobs) + 1))
                jobs[tab] = Job(
                    own, start, executor, f"/{tab}/{{}}?token={window.token}"
                )
            return Page(client, client.camera, jobs[tab]).tick

        window.welcome(page)
        try:
            serve(window, asked.port, asked.once)
        finally:
            for job in jobs.values():
                job.stop()
            executor.shutdown(cancel_futures=True)
    return 0


def file_of(jobs: Mapping[str, Job], path: str) -> tuple[str, bytes] | None:
    """The type and the content of a file of a job, by the path of its address."""
    _, tab, *names = [*path.split("/"), ""][:3]
    job, name = jobs.get(tab), unquote("".join(names))
    if job is None or name not in job.files:
        return None
    kind = TYPES.get(PurePath(name).suffix, "application/octet-stream")
    return kind, job.files[name]


class Job:
    """The job of one tab.

    Args:
        folder: Folder of its own, for what is dropped.
        start: Folder from which paths are named.
        executor: Does its work.
        address: Address of a file, with {} for its name.

    Attributes:
        robot: The robot as `calibrate` takes it; empty for none yet.
        links: Its links.
        measurements: The measurement files.
        scene: The robot, with its measurements as soon as they are read.
        look: What `init` has found; None without a look, as with a setup file.
        columns: Columns with units that may be meant, by our names.
        text: The setup file.
        setup: Its keys, as far as measurements have been read by it.
        question: What only a person knows; empty for nothing.
        problem: Why something could not be done, on one line; empty if it could.
        remarks: What may be otherwise than one thinks.
        stage: What is being done, and which part of it; None while nothing is.
        result: The result, if it is calibrated.
        files: Files to download, by name.
    """

    def __init__(
        self, folder: Path, start: Path, executor: ThreadPoolExecutor, address: str
    ) -> None:
        """Nothing is chosen yet."""
        folder.mkdir()
        self._folder, self._start, self._executor = folder, start, executor
        self._address, self._stopped = address, threading.Event()
        self.robot, self.links = "", tuple[str, ...]()
        self.measurements, self._packages = list[Path](), list[Path]()
        self._own, self._changes = "", dict[str, Any]()
        self._distance: str | None = None
        self._opened: Opened | None = None
        self.scene: Scene | None = None
        self.look: Look | None = None
        self.columns = dict[str, list[str]]()
        self.text, self.setup = "", dict[str, Any]()
        self.question, self.problem, self.remarks = "", "", list[str]()
        self.stage: tuple[str, float | None] | None = None
        self.result: CalibrationResult | None = None
        self.files = dict[str, bytes]()

    @property
    def ready(self) -> bool:
        """Whether there is what can be calibrated."""
        return self._opened is not None and self.stage is None

    def address(self, name: str) -> str:
        """Where a file can be downloaded."""
        return self._address.format(quote(name))

    # --- what a person does --------------------------------------------------------

    def give(self, name: str, content: bytes) -> None:
        """Take in a file that was dropped or chosen; one of the same name goes."""
        name = PurePath(name.replace("\\", "/")).name
        if name not in ("", "..") and name.isprintable():
            Path(self._folder, name).write_bytes(content)
            self.add(name)

    def add(self, word: str) -> None:
        """Take a robot by its name, or a file or folder of this machine by its path."""
        from calib_pin.io.urdf import split_arguments

        name = split_arguments(word.strip())[0]
        path, there = Path(name), self._folder / name
        if not there.is_file() and (self._start / path.expanduser()).exists():
            path = there = self._start / path.expanduser()
        ending = path.suffix.lower()
        if there.is_dir() and name:
            self._packages = [path]
        elif ending in SETUPS:
            self._own, self._changes = there.read_text("utf-8", "replace"), {}
        elif ending in ROBOTS or not there.exists():
            self.robot = word.strip().replace(name, str(path), 1)
            self._changes, self.scene = {}, None
        else:
            self.measurements = [p for p in self.measurements if p != path] + [path]
        self._do(self._read)

    def remove(self, path: Path) -> None:
        """Leave a file of measurements out."""
        self.measurements.remove(path)
        self._do(self._read)

    def change(self, lines: Mapping[str, Any]) -> None:
        """Put lines into the setup file."""
        from calib_pin.io.json_text import merged

        self._changes = merged(self._changes, lines)
        self._do(self._read)

    def write(self, text: str) -> None:
        """Replace the setup file; an empty one is drafted again."""
        self._own, self._changes = text.strip() and text, {}
        self._do(self._read)

    def answer(self, distance: str) -> None:
        """Take the distance of the two sockets of a place."""
        self._distance = distance
        self._do(self._read)

    def calibrate(self) -> None:
        """Calibrate."""
        self._do(self._calibrate)

    def stop(self) -> None:
        """End what is being done."""
        self._stopped.set()

    # --- what is done then ---------------------------------------------------------

    def _do(self, work: Callable[[], None]) -> None:
        self._stopped.clear()
        self.stage = "waiting", None
        self._executor.submit(self._done, work)

    def _done(self, work: Callable[[], None]) -> None:
        """Work in the folder of the job, with what goes wrong as a line."""
        self.problem = ""
        try:
            with chdir(self._folder):
                work()
        except KeyboardInterrupt:
            self.problem = "stopped"
        except Exception as error:
            self.problem = complaint(error)
        self.remarks, self.stage = [*dict.fromkeys(taken_notices())], None

    def _bar(self, name: str, part: float | None) -> None:
        self.stage = name, part
        if self._stopped.is_set():
            raise KeyboardInterrupt

    def _read(self) -> None:
        """Read what is there, by the setup file that it leads to, and draw it."""
        from calib_pin.io.yaml_tree import read_tree

        self.result, self.files, self._opened, self.look = None, {}, None, None
        self.question, self.text, self.setup = "", self._own, {}
        if self.robot and (self.scene is None or not self.measurements):
            self._bar("robot", None)
            setup = open_setup(None)
            chains = open_chains(self.robot, setup, package_dirs=self._packages)
            self.links = tuple(chains.robot.links)
            self.scene = self._drawn(chains, setup)
        if not self.robot or not self.measurements:
            return
        self._bar("read", None)
        self.text = with_lines(self._own or self._draft(), self._changes)
        SETUP.write_text(self.text, "utf-8")
        self.files = {SETUP.name: self.text.encode()}
        self.setup = read_tree(SETUP).data or {}
        folders = self._packages
        asked = Request(self.robot, self.measurements, folders, setup=SETUP)
        self._opened = opened(asked, OUT, force=True, bar=self._bar)
        self.scene = self._drawn(self._opened.chains, self._opened.setup)

    def _draft(self) -> str:
        """The setup file that `init` drafts."""
        from calib_pin.io.first_look import draft

        def choose(question: str, choices: Sequence[str], _: str) -> str:
            if len(choices) > 1:
                notice(f"{question}? {choices[0]} is taken; change it below if need be")
            return choices[0]

        def ask(question: str) -> str:
            self.question = question
            raise OptionError(question)

        asked = Draft(
            robot=self.robot,
            measurements=self.measurements,
            package_dir=self._packages,
            distance=self._distance,
            base=self._changes.get("base"),
            tip=self._changes.get("tip"),
            model=self._changes.get("model"),
        )
        robot, self.look = looked_at(asked, choose, ask)
        self.columns = readable(robot, self.look, self.measurements[0])
        return draft(robot, self.look, "calib-pin app")

    def _calibrate(self) -> None:
        given = self._opened
        assert given is not None
        found = calibrated(given, given.request.words(OUT), bar=self._bar)
        named = {path.name: data for path, data in found.contents.items()}
        named[SETUP.name] = self.files[SETUP.name]
        stream = io.BytesIO()
        with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as archive:
            for name, data in named.items():
                archive.writestr(f"{OUT}/{name}", data)
        self.files = {**named, f"{OUT}.zip": stream.getvalue()}
        self.result = found.result
        model = found.result.model
        self.scene = self._drawn(model.chains, given.setup, model)

    def _drawn(
        self, chains: Chains, setup: Setup, model: CalibratedModel | None = None
    ) -> Scene:
        from calib_pin.viewer.scene import make_scene

        def read(*_: object, **options: object) -> tuple[Chains, Observations]:
            assert given is not None
            return given.chains, given.measurements

        given, folders = self._opened, self._packages
        rows = read if given else None
        tells = partial(stage, self._bar)
        return make_scene(
            chains, model, setup, rows, None, folders, tell=notice, stage=tells
        )

    # --- what is shown -------------------------------------------------------------

    def sections(self) -> Iterator[Section]:
        """What the page says and asks."""
        from calib_pin.viewer.app import Section

        yield Section("Result", [*_result(self)])
        yield Section("Now", [*_now(self)])
        yield Section("Chosen", [*_chosen(self)])
        yield Section("What was found", [*_found(self)])
        yield Section("Robot and measurements", [*_asked(self)])
        yield Section("Columns and units", [*_columns(self)], expanded=False)
        yield Section("Setup file", [*_lines(self)], expanded=False)


def with_lines(text: str, lines: Mapping[str, Any]) -> str:
    """A setup file with further lines; comments stay, but for those within a key."""
    import yaml

    from calib_pin.io.json_text import merged
    from calib_pin.io.setup import yaml_text

    if not lines:
        return text
    there = yaml.safe_load(text) or {}
    whole = merged(there, lines)
    for key in lines:
        new = yaml_text({key: whole[key]}) + "\n"
        old = re.compile(rf"^{re.escape(key)}:.*\n?(?:[ \t-].*\n?)*", re.MULTILINE)
        found = old.search(text)
        start, end = found.span() if found else (len(text), len(text))
        gap = "" if found or text.endswith("\n") or not text else "\n"
        text = text[:start] + gap + new + text[end:]
    return text if yaml.safe_load(text) == whole else yaml_text(whole) + "\n"


def readable(robot: Robot, look: Look, file: Path) -> dict[str, list[str]]:
    """Columns of a file, with the units they may have, by what they may stand for."""
    from calib_pin.io.columns import ANGLE, LENGTH, split_header
    from calib_pin.io.foreign_headers import foreign
    from calib_pin.io.measured_columns import measured
    from calib_pin.io.table import read_table
    from calib_pin.kinematics.tree import turns

    table = read_table(file).whole(robot.model.names)
    columns = {one.name: one for one in foreign(table.columns)}
    stated, kinds = look.setup.columns, measured()
    kinds = {name: kinds[name] for name in kinds if name in {*columns, *stated}}
    kinds |= {j: ANGLE if turns(robot.model, j) else LENGTH for j in look.joints}
    found = dict[str, list[str]]()
    for ours, kind in kinds.items():
        name, unit = split_header(stated.get(ours, ours))
        own = [columns[name].stated(unit) for unit in kind.units if name in columns]
        others = [k.stated(unit) for k in columns.values() if k.numeric]
        found[ours] = [*own, *others]
    return found


def _now(job: Job) -> Iterator[Widget]:
    from calib_pin.viewer.app import Widget

    if job.stage is not None:
        yield Widget("progress", *job.stage)
        yield Widget("button", "stop", do=job.stop)
        return
    if job.problem:
        yield Widget("words", value=job.problem, tone="error")
    if job.question:
        label = "take this length"
        yield Widget("entry", label, choices=(job.question,), do=job.answer)
    for remark in job.remarks:
        yield Widget("words", value=remark, tone="note")
    if not job.robot:
        yield Widget("words", value="Begin with the robot: its file, or a bundled one.")
    elif not job.measurements:
        yield Widget("words", value="Now the measurements: a table, a row for each.")
    elif job.ready and job.result is None:
        said = "Robot and measurements are read: check what was found, and calibrate."
        yield Widget("words", value=said)
        yield Widget("button", "Calibrate", tone="good", do=job.calibrate)


def _asked(job: Job) -> Iterator[Widget]:
    """Where files come from; always the same, so that nothing interrupts an upload."""
    from calib_pin.io.urdf import bundled_robots
    from calib_pin.viewer.app import Widget

    said = "Drop files here: the robot (URDF, xacro), measurements (CSV, ...), and a "
    said += "setup file if there is one"
    yield Widget("upload", "or choose a file", said, do=job.give)
    names = ("(choose)", *bundled_robots())
    yield Widget("choice", "or bundled robot", names[0], names, do=job.add)
    yield Widget("entry", "take this path", choices=("or a path here",), do=job.add)


def _chosen(job: Job) -> Iterator[Widget]:
    from calib_pin.io.urdf import bundled_robots
    from calib_pin.viewer.app import Widget

    if job.robot:
        yield Widget("words", value=f"Robot: {job.robot}", tone="head")
    for path in job.measurements:
        yield Widget("words", value=f"Measurements: {path}", tone="head")
        yield Widget("button", f"remove {path.name}", do=partial(job.remove, path))
    if job.robot in (known := bundled_robots()) and not job.measurements:
        example = known[job.robot].with_name("measurements.csv")
        do = partial(job.add, str(example))
        yield Widget("button", "take its example measurements", do=do)


def _found(job: Job) -> Iterator[Widget]:
    from calib_pin.measurement_models import MEASUREMENT_MODELS
    from calib_pin.viewer.app import Widget

    if (not job.text and not job.problem) or not job.measurements:
        return
    setup, look, links = job.setup, job.look, job.links
    if look is not None:
        # The draft begins with how well the nominal robot fits.
        head = job.text.partition("\n\n")[0].replace("\n#   ", " ").split("\n# ")
        yield Widget("words", value="\n".join(head[1:]))
    tips = links if look is None else dict.fromkeys([*look.tips, *links])

    def choice(label: str, keys: Sequence[str], choices: Iterable[str]) -> Widget:
        value = setup
        for key in keys:
            value = value.get(key) or {} if isinstance(value, dict) else {}
        shown = value if isinstance(value, str) else "(by itself)"

        def change(word: str) -> None:
            lines: Any = word
            for key in reversed(keys):
                lines = {key: lines}
            job.change(lines)

        names = tuple(dict.fromkeys([shown, *choices]))
        return Widget("choice", label, shown, names, do=change)

    if not (chains := setup.get("chains") or {}):
        yield choice("tip", ["tip"], tips)
        yield choice("base", ["base"], links)
    for name in chains:
        yield choice(f"tip of {name}", ["chains", name, "tip"], links)
    yield choice("measured", ["model"], MEASUREMENT_MODELS)


def _columns(job: Job) -> Iterator[Widget]:
    from calib_pin.viewer.app import Widget

    if job.look is None:
        return
    stated = job.setup.get("columns") or {}
    for ours, choices in job.columns.items():
        shown = str(stated.get(ours, ours))
        names = tuple(dict.fromkeys([shown, *choices]))

        def change(word: str, ours: str = ours) -> None:
            job.change({"columns": {ours: word}})

        yield Widget("choice", ours, shown, names, do=change)


def _lines(job: Job) -> Iterator[Widget]:
    from calib_pin.viewer.app import Widget

    if not job.measurements:
        return
    yield Widget("lines", "use these lines", job.text, do=job.write)
    if SETUP.name in job.files:
        yield Widget("links", value={SETUP.name: job.address(SETUP.name)})


def _result(job: Job) -> Iterator[Widget]:
    """The verdict first, then findings with their lines, accuracy, and the files."""
    from calib_pin.io.results import urdf_name
    from calib_pin.io.setup import yaml_text
    from calib_pin.report.blocks import Code, Line
    from calib_pin.report.tiles import tiles
    from calib_pin.report.trust import findings, next_step, verdict
    from calib_pin.viewer.app import Widget

    if (result := job.result) is None:
        return
    lines = {yaml_text(f.setup): f.setup for f in result.findings if f.setup}
    first = verdict(result)
    yield Widget("words", value=first.text, tone=first.tone)
    found = findings(result.findings, result.reason)
    for block in [*found, *next_step(result)]:
        if isinstance(block, Code):
            yield Widget("words", value=block.text, tone="code")
            do = partial(job.change, lines[block.text])
            yield Widget("button", "apply these lines", do=do)
        elif isinstance(block, Line) and not block.figure:
            tone = "error" if block.tone == "bad" else block.tone
            yield Widget("words", value=block.text, tone=tone)
    for tile in tiles(result):
        for step in tile.steps:
            sizes = f"{step.before.text} \N{RIGHTWARDS ARROW} {step.after.text}"
            change = f" ({step.change})" if step.change else ""
            said = f"{tile.label}: {sizes} {tile.unit}{change} {step.name}"
            yield Widget("words", value=said, tone="head")
        yield Widget("words", value=tile.remark, tone="note")
    urdf = urdf_name(result.model.chains.robot.name)
    main = {f"corrected robot: {urdf}": urdf, "report": "report.html"}
    rest = {"all files": f"{OUT}.zip", **{name: name for name in job.files}}
    for tone, names in (("good", main), ("plain", rest)):
        known = {k: job.address(name) for k, name in names.items() if name in job.files}
        yield Widget("links", value=known, tone=tone)
    if urdf not in job.files:
        said = "There is no corrected robot: this result must not be trusted."
        yield Widget("words", value=said, tone="error")
