"""What several tests need; functions that make something stand in `tests.shared`.

A test that asks for `example_robot` runs once for every URDF of example-robot-data (in
the quick tier for those in `QUICK`), one that asks for `special_chain` once for every
chain in `SPECIAL`.
"""

from __future__ import annotations

import importlib.metadata
import importlib.util
import io
import logging
import os
import shutil
import signal
import subprocess
import sys
import time
import warnings
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

import hypothesis
import numpy as np
import pytest

from calib_pin.errors import OptionError
from calib_pin.estimation.formulation import nominal_problem
from calib_pin.estimation.problem import Problem
from calib_pin.io.urdf import load_chain
from calib_pin.kinematics.chain import Chain
from calib_pin.kinematics.spatial import Floats
from calib_pin.observations import Observations
from calib_pin.plugins import Members, every_entry_point, extensions
from calib_pin.setup import FrameSetup, Setup
from calib_pin.simulation import draw_errors, simulate
from calib_pin.workers.cluster import Cluster
from tests import shared


def example_robots() -> list[Path]:
    """Every URDF of example-robot-data, sorted."""
    data = importlib.metadata.distribution("example-robot-data").locate_file(
        "cmeel.prefix/share/example-robot-data"
    )
    # ur3.urdf is what xacro made of a file of macros: no name, no links.
    found = sorted(Path(str(data)).rglob("*.urdf"))
    return [path for path in found if path.name != "ur3.urdf"]


QUICK = {
    "ur10_robot": "an industrial arm with fixed joints before and behind it",
    "panda": "prismatic fingers, one of which mimics the other",
    "tiago_no_hand": "a lift, continuous wheels, a tip without a fixed joint",
    "talos_reduced": "limbs: a chain of 14 joints from one hand to the other",
    "so101": "frames out of a CAD program, none of them square; the worst conditioned",
    "quadrotor_base": "no joint at all",
}
"""Robots of the quick tier: together they have all that the 68 differ in."""

# How long an example takes says more about the machine than about the code.
hypothesis.settings.register_profile(
    "any machine",
    deadline=None,
    suppress_health_check=[hypothesis.HealthCheck.too_slow],
)
hypothesis.settings.load_profile("any machine")

SPECIAL = {
    "space6": (None, None),
    # A prismatic joint, skewed frames, and a tip without a fixed joint.
    "example:tiago_no_hand": (None, "arm_7_link"),
    # Two branches: from one hand to the other.
    "example:talos_reduced": ("gripper_right_base_link", "gripper_left_base_link"),
}
"""Chains, by base and tip, that together have all that makes derivatives hard."""


SOFTWARE = ["--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
"""WebGL without a graphics card."""


GROUPS = {
    "browser": ("playwright",),
    "cluster": ("distributed",),
    "docs": ("mkdocs", "latex2mathml"),
    "mujoco": ("mujoco",),
    "parquet": ("pyarrow",),
    "pdf": ("typst", "pypdf"),
    "view": ("viser",),
    "vision": ("cv2",),
}
"""What only `scripts/test --all` installs, by what it serves."""


def absent(group: str) -> list[str]:
    """Modules of a group that are not installed."""
    return [name for name in GROUPS[group] if importlib.util.find_spec(name) is None]


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    missing = {group: ", ".join(absent(group)) for group in GROUPS}
    for item in items:
        for mark in item.iter_markers("needs"):
            for group in filter(missing.get, mark.args):
                reason = f"needs {missing[group]} ({group}), scripts/test --all has it"
                item.add_marker(pytest.mark.skip(reason))


def pytest_terminal_summary(terminalreporter: Any) -> None:
    """How many tests were skipped, and why."""
    reasons = [report.longrepr[2] for report in terminalreporter.getreports("skipped")]
    for reason, count in sorted(Counter(reasons).items()):
        terminalreporter.line(f"{count} skipped: {reason.removeprefix('Skipped: ')}")


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    if "special_chain" in metafunc.fixturenames:
        metafunc.parametrize("special_chain", SPECIAL, indirect=True)
    if "example_robot" in metafunc.fixturenames:
        robots = [
            pytest.param(
                path, id=path.stem, marks=() if path.stem in QUICK else pytest.mark.slow
            )
            for path in example_robots()
        ]
        metafunc.parametrize("example_robot", robots)


@pytest.fixture(scope="session", autouse=True)
def interruptible() -> Iterator[None]:
    """Ctrl-C reaches the tests and what they start, also in the background of a shell.

    There it would be ignored, and all children would inherit that.
    """
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.fixture(autouse=True)
def unregistered(monkeypatch: pytest.MonkeyPatch) -> None:
    """What a test or a page registers, the next one of the process does not know."""
    for members in Members.known.values():
        monkeypatch.setattr(members, "registered", {})


@pytest.fixture
def unsought(monkeypatch: pytest.MonkeyPatch) -> None:
    """No explanation is looked for, which takes the longest: none would be found."""
    monkeypatch.setattr("calib_pin.validation.findings._explanation", lambda *_: None)


@pytest.fixture
def installed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> Iterator[Callable[[str, str, str], Path]]:
    """A package with entry points: `installed("poe", "calib_pin.x", "a = poe:A")`.

    It is as pip would leave it, in the folder that comes back; its code may be there.
    """
    site = tmp_path / "site"
    site.mkdir()
    monkeypatch.syspath_prepend(site)

    def install(package: str, group: str, entries: str) -> Path:
        info = site / f"{package}-1.0.dist-info"
        info.mkdir()
        (info / "METADATA").write_text(f"Name: {package}\nVersion: 1.0\n")
        (info / "entry_points.txt").write_text(f"[{group}]\n{entries}\n")
        return site

    extensions.cache_clear()
    every_entry_point.cache_clear()
    yield install
    extensions.cache_clear()
    every_entry_point.cache_clear()


@pytest.fixture(scope="session")
def special_chain(request: pytest.FixtureRequest) -> Chain:
    """Each of the chains in `SPECIAL`."""
    base, tip = SPECIAL[request.param]
    return load_chain(request.param, base=base, tip=tip)


@pytest.fixture(scope="session")
def data_folder() -> Path:
    """Folder of the real measurements, which are not in the repository."""
    beside = Path(__file__).parents[2] / "shared" / "data"
    folder = Path(os.environ.get("CALIB_PIN_DATA", beside))
    if not folder.is_dir():
        pytest.skip(f"no real measurements in {folder}: set CALIB_PIN_DATA to them")
    return folder


@pytest.fixture(scope="session")
def scara() -> Chain:
    """Four joints along one direction: a shift along it is that of base and of tool.

    The tip link is called `tool`.
    """
    turn = partial(shared.joint, limits="-2.2 2.2")
    return shared.chain_of(
        shared.urdf_of(
            turn("j1", "l0 l1", "0 0 0.3"),
            turn("j2", "l1 l2", "0.3 0 0.05"),
            turn("j3", "l2 l3", "0.25 0 0", kind="prismatic", limits="-0.2 0"),
            turn("j4", "l3 l4", "0 0 -0.1"),
            turn("j5", "l4 tool", "0.06 0 -0.05", kind="fixed"),
        )
    )


@pytest.fixture(scope="session")
def calibrated_robot() -> Callable[..., Any]:
    """Calibration of a simulated robot: `calibrated_robot(model, setup, count, ...)`.

    Arguments are those of `simulated`, further ones go to `calibrate`. Equal arguments
    give the same result, which is made once in a process.
    """
    made: dict[str, Any] = {}

    def make(
        model: str = "position",
        setup: Setup | None = None,
        count: int = 60,
        size: float = 1.0,
        seed: int = 0,
        *,
        robot: str | Chain = "space6",
        noise: float = 1e-4,
        changes: Mapping[str, float] | None = None,
        **options: Any,
    ) -> Any:
        from calib_pin.calibration import calibrate

        job = (model, setup or Setup(), count, size, seed)
        more = {"robot": robot, "noise": noise, "changes": changes}
        key = repr((job, more, options))
        if key not in made:
            problem, _ = shared.simulated(*job, **more)
            chain = problem.chains[""]
            made[key] = calibrate(chain, problem.data, job[1], **options)
        return made[key]

    return make


@pytest.fixture(scope="session")
def recorded() -> Callable[..., Any]:
    """Calibration of a simulated robot: `recorded(chain, model, seed, changes, ...)`.

    The robot is always the same, but for changes of its parameters by name. A true
    setup, where given, says where the instrument and the tool really are.
    """

    def make(
        chain: Chain,
        model: str,
        seed: int,
        changes: Mapping[str, float] | None = None,
        *,
        setup: Setup | None = None,
        truth: Setup | None = None,
        count: int = 60,
        noise: float = 1e-4,
    ) -> Any:
        from calib_pin.calibration import calibrate
        from calib_pin.validation.result import Provenance

        problem = nominal_problem(chain, model, truth or setup or Setup())
        drawn = draw_errors(problem.parameters, np.random.default_rng(0))
        theta = np.where(problem.parameters.nuisance, 0.0, drawn)
        for name, change in (changes or {}).items():
            theta[problem.parameters.names.index(name)] += change
        rng = np.random.default_rng(1000 + seed)
        rows = simulate(problem, theta, rng, count=count, noise=noise)
        result = calibrate(chain, rows, setup or Setup(), validate=False)
        return replace(
            result,
            files=("rows.csv",),
            provenance=Provenance(
                created="2026-03-01T10:00:00+00:00",
                file=f"{seed}.json",
                hashes=(f"rows {seed}",),
            ),
        )

    return make


@pytest.fixture(scope="session")
def independent_poses() -> Callable[..., Any]:
    """Forward kinematics that share no code with ours or with Pinocchio.

    Call with the bytes of a URDF, joint positions by name, and pairs (base, tip);
    returns `T_base_tip` of each pair, from yourdfpy.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        import yourdfpy
    logging.getLogger("yourdfpy").setLevel(logging.ERROR)

    @lru_cache(maxsize=8)
    def parsed(urdf: bytes) -> Any:
        return yourdfpy.URDF.load(
            io.BytesIO(urdf), load_meshes=False, build_collision_scene_graph=False
        )

    def poses(
        urdf: bytes, q: Mapping[str, float], frames: Sequence[tuple[str, str]]
    ) -> list[Any]:
        robot = parsed(urdf)
        # An earlier call may have moved other joints.
        robot.update_cfg(dict.fromkeys(robot.actuated_joint_names, 0.0) | dict(q))
        return [robot.get_transform(tip, base) for base, tip in frames]

    return poses


@pytest.fixture
def browser(chromium: Any) -> Iterator[Any]:
    """Chromium without a window; pages that were opened draw no longer than a test."""
    yield chromium
    for context in chromium.contexts:
        context.close()


@pytest.fixture(scope="session")
def chromium() -> Iterator[Any]:
    """Chromium, started once."""
    names = ("chromium", "chromium-browser", "google-chrome")
    path = next(filter(None, map(shutil.which, names)), None)
    if path is None:
        pytest.skip("needs Chromium: apt-get install chromium")
    sync_api = pytest.importorskip("playwright.sync_api")
    with sync_api.sync_playwright() as playwright:
        launched = playwright.chromium.launch(
            executable_path=path, args=["--no-sandbox", *SOFTWARE]
        )
        yield launched
        launched.close()


class Dask:
    """A scheduler and its workers, each a process."""

    def __init__(self, folder: Path, workers: int = 2) -> None:
        self.file = folder / "scheduler.json"
        self.log = (folder / "dask.log").open("wb")
        self.scheduler = self.start("scheduler", "--port", "0", "--host", "127.0.0.1")
        self.workers = [self.worker() for _ in range(workers)]

    def met(self) -> Dask:
        """The cluster, once all its workers are there."""
        deadline = time.monotonic() + 60
        while True:
            try:
                with Cluster(str(self.file)) as cluster:
                    if cluster.count == len(self.workers):
                        return self
            except OptionError:
                assert time.monotonic() < deadline
                time.sleep(0.2)

    def start(self, program: str, *words: str) -> subprocess.Popen[bytes]:
        command = [sys.executable, "-m", f"distributed.cli.dask_{program}"]
        options = ["--scheduler-file", str(self.file), "--no-dashboard", *words]
        return subprocess.Popen([*command, *options], stdout=self.log, stderr=self.log)

    def worker(self) -> subprocess.Popen[bytes]:
        return self.start("worker", "--nthreads", "1", "--no-nanny")

    def stop(self) -> None:
        for process in (*self.workers, self.scheduler):
            process.kill()
            process.wait()
        self.log.close()


@pytest.fixture
def dask(tmp_path: Path) -> Iterator[Dask]:
    """A cluster of two workers on the loopback."""
    cluster = Dask(tmp_path)
    yield cluster.met()
    cluster.stop()


@dataclass(frozen=True)
class Fleet:
    """Robots of one type, space6 with a tracker, and their next one.

    Attributes:
        problem: The nominal robot before the tracker.
        mean: Errors that all have, shape (P,).
        spread: How far each deviates, shape (P,).
        results: Calibrations of the robots.
        prior: Of the next one.
    """

    problem: Problem
    mean: Floats
    spread: Floats
    results: tuple[Any, ...]
    prior: Any

    def measured(
        self, seed: int, count: int, changes: Mapping[str, float] | None = None
    ) -> tuple[Observations, Floats]:
        """Measurements of one more robot, and its errors."""
        rng = np.random.default_rng([1, seed])
        theta = self.mean + self.spread * rng.normal(size=len(self.mean))
        for name, change in (changes or {}).items():
            theta[self.problem.parameters.index(name)] += change
        data = simulate(self.problem, theta, rng, count=count).only
        return Observations.of(replace(data, sigma=None)), theta


@pytest.fixture(scope="session")
def fleet() -> Fleet:
    """Sixteen calibrated robots of one type."""
    from calib_pin.calibration import calibrate
    from calib_pin.estimation.statistics.population_prior import prior_of_type
    from calib_pin.validation.robot_state import robot_evidence

    setup = Setup(tool_frame=FrameSetup((0.05, 0.08, 0.12)))
    problem = nominal_problem(load_chain("space6"), "position", setup)
    parameters, rng = problem.parameters, np.random.default_rng(0)
    robot = np.where(parameters.nuisance, 0.0, parameters.scales)
    mean = robot * rng.normal(size=len(parameters))
    bare = Fleet(problem, mean, 0.1 * robot, (), None)
    chain = problem.chains[""]
    results = tuple(
        calibrate(chain, bare.measured(seed, 24)[0], validate=False)
        for seed in range(16)
    )
    prior = prior_of_type([robot_evidence(result) for result in results])
    return replace(bare, results=results, prior=prior)
