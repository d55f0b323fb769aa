"""What several tests need. Test modules cannot import each other, so all are fixtures.

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
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import hypothesis
import numpy as np
import pinocchio as pin
import pytest

from calib_pin.errors import InputError, OptionError
from calib_pin.estimation.formulation import nominal_problem
from calib_pin.estimation.nominal import (
    named_targets,
    observable_configurations,
)
from calib_pin.estimation.problem import Problem
from calib_pin.io.urdf import load_chain
from calib_pin.io.urdf_tree import parse_robot
from calib_pin.kinematics.chain import Chain
from calib_pin.kinematics.spatial import Floats
from calib_pin.observations import BlockKey, Observations, Targets
from calib_pin.parameterizations import frame_pose
from calib_pin.setup import (
    AnchorSetup,
    CameraSetup,
    DistanceSetup,
    DriftSetup,
    FrameSetup,
    Payload,
    PlaneSetup,
    PointSetup,
    Setup,
    SphereSetup,
    ToolSetup,
)
from calib_pin.simulation import draw_errors, exact_problem, simulate
from calib_pin.workers.cluster import Cluster


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
                path,
                id=path.stem,
                marks=() if path.stem in QUICK else pytest.mark.slow,
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
    monkeypatch.setattr("calib_pin.plugins._registered", {})


@pytest.fixture(scope="session")
def special_chain(request: pytest.FixtureRequest) -> Chain:
    """Each of the chains in `SPECIAL`."""
    base, tip = SPECIAL[request.param]
    return load_chain(request.param, base=base, tip=tip)


@pytest.fixture(scope="session")
def framed() -> Setup:
    """Frames that are estimated, two planes, a payload, and motors behind gears.

    Gravity does not run along any axis, what has no mass carries something, and the
    instrument drifts for an hour.
    """
    return Setup(
        base_frame=FrameSetup((0.1, -0.2, 0.05), (0.3, -0.2, 0.4), estimate=True),
        tool_frame=FrameSetup((0.02, 0.03, 0.1), (-0.1, 0.2, 0.3), estimate=True),
        planes={
            "floor": PlaneSetup((0.1, 0.2, 1.0), 1.5),
            "wall": PlaneSetup((1.0, 0.3, 0.2), -3.0),
        },
        gravity=(1.0, -2.0, -9.5),
        payloads={"load": Payload(2.0, (0.05, -0.1, 0.2))},
        gear_ratios={"*": -31.5},
        drift=DriftSetup({"base": (0.0, 3600.0)}, 1e-3, 1e-3),
    )


@pytest.fixture(scope="session")
def equipped(framed: Setup) -> Setup:
    """The same with everything that rows of any instrument can name."""
    return replace(
        framed,
        targets={
            "probe": PointSetup((0.03, -0.02, 0.05), estimate=True),
            "nest": PointSetup((-0.04, 0.06, -0.01), estimate=True),
        },
        sockets={
            "left/0": PointSetup((0.6, 0.2, 0.3)),
            "left/1": PointSetup((0.3, 0.4, 0.5)),
        },
        spheres={"ball": SphereSetup((0.5, -0.3, 0.4), 0.15, estimate_radius=True)},
        anchors={"wire": AnchorSetup((1.4, 0.9, 0.2), 0.01, estimate_bias=True)},
        camera=CameraSetup(
            "world",
            (900.0, 910.0),
            (640.0, 500.0),
            (-0.02, 0.01, 1e-3, -2e-3, 1e-3),
            estimate=True,
        ),
        distances=(DistanceSetup(("left/0", "left/1"), 0.4, 1e-4),),
    )


FAR = FrameSetup((0.1, -0.2, 3.0), (0.3, -0.2, 0.4), estimate=True)
"""Base in the frame of a camera that stands still and sees all of a robot."""

NEAR = ToolSetup((0.02, 0.05, -0.03), (0.1, 0.3, -0.2))
"""What a camera among other instruments looks at."""


@pytest.fixture(scope="session")
def equipped_problem(equipped: Setup) -> Callable[..., Problem]:
    """Problem with all that measurements name: `equipped_problem(chain, model, ...)`.

    Several blocks may stand for the model. A camera stands far enough away. Settings of
    the setup may follow by name.
    """

    def make(chain: Chain, model: str | Sequence[BlockKey], **settings: Any) -> Problem:
        frames = {"stations": {"camera": FAR}, "tools": {"camera": NEAR}}
        setup = replace(equipped, **frames | settings)
        if model == "camera":
            setup = replace(setup, base_frame=FAR)
        return nominal_problem(chain, model, setup)

    return make


@pytest.fixture(scope="session")
def visited() -> Callable[..., tuple[Floats, Targets]]:
    """Configurations and targets of a block: `visited(problem, theta, count, rng)`.

    The instrument of the only block can measure there. Where it must touch something,
    or is one of several, whose key follows, they are random: away from contact there is
    a residual, as in any fit that begins.
    """

    def draw(
        problem: Problem,
        theta: Floats,
        count: int,
        rng: np.random.Generator,
        key: BlockKey | None = None,
    ) -> tuple[Floats, Targets]:
        key = key or problem.only.key
        contact = problem.terms[key].measurement.declaration.contact
        if not contact and len(problem.terms) == 1:
            at = observable_configurations(problem, key, theta, count, rng)
            return at.q, at.target
        names = named_targets(problem, key)
        q = problem.chains.random_configurations(count, rng)
        return q, tuple(names[k % len(names)] for k in range(count))

    return draw


@pytest.fixture(scope="session")
def refused() -> Callable[..., AbstractContextManager[None]]:
    """An error that a block must raise, by its fields: `with refused(kind, line=3):`.

    Fields that are not named may be anything. Of `reason` and `allowed` a part is
    enough, or several, so that wording may change; the others must be equal. Whole
    messages are tested in `test_errors.py`.
    """

    @contextmanager
    def block(
        kind: type[InputError], reason: str | Sequence[str] = (), **fields: Any
    ) -> Iterator[None]:
        with pytest.raises(kind) as caught:
            yield
        assert "\n" not in str(caught.value)
        for name, expected in {"reason": reason, **fields}.items():
            found = getattr(caught.value, name)
            if name in ("reason", "allowed") and expected is not None:
                parts = (expected,) if isinstance(expected, str) else expected
                equal = all(part in found for part in parts)
            else:
                equal = found is expected or found == expected  # NaN is itself.
            assert equal, (name, found, expected)

    return block


@pytest.fixture(scope="session")
def data_folder() -> Path:
    """Folder of the real measurements, which are not in the repository."""
    beside = Path(__file__).parents[2] / "shared" / "data"
    folder = Path(os.environ.get("CALIB_PIN_DATA", beside))
    if not folder.is_dir():
        pytest.skip(f"no real measurements in {folder}: set CALIB_PIN_DATA to them")
    return folder


@pytest.fixture(scope="session")
def urdf_of() -> Callable[..., str]:
    """Text of a URDF: `urdf_of({"name": "j", "parent": "a", "child": "b", ...}, ...)`.

    Further keys of a joint: `type` (revolute), `placement` (SE3), `axis` (0 0 1),
    `limits` (lower, upper), `more` (XML inside the joint), `mass` (kg and center of
    the child). Joints to come later in the tree may come first.
    """

    def text(*joints: Mapping[str, Any]) -> str:
        links = dict.fromkeys(
            link for joint in joints for link in (joint["parent"], joint["child"])
        )
        masses = {j["child"]: _inertial(*j["mass"]) for j in joints if "mass" in j}
        lines = [f'<link name="{link}">{masses.get(link, "")}</link>' for link in links]
        for joint in joints:
            kind = joint.get("type", "revolute")
            placement = joint.get("placement", pin.SE3.Identity())
            angles = pin.rpy.matrixToRpy(placement.rotation)
            axis = joint.get("axis", (0, 0, 1))
            lines += [
                f'<joint name="{joint["name"]}" type="{kind}">',
                f'  <origin xyz="{_numbers(placement.translation)}" '
                f'rpy="{_numbers(angles)}"/>',
                f'  <parent link="{joint["parent"]}"/>',
                f'  <child link="{joint["child"]}"/>',
            ]
            if kind != "fixed":
                lines.append(f'  <axis xyz="{_numbers(axis)}"/>')
            if kind in ("revolute", "prismatic"):
                lower, upper = joint.get("limits", (-2.0, 2.0))
                bounds = f'lower="{lower}" upper="{upper}"'
                lines.append(f'  <limit {bounds} effort="1" velocity="1"/>')
            lines += [joint.get("more", ""), "</joint>"]
        return "\n".join(['<robot name="test">', *lines, "</robot>"])

    return text


@pytest.fixture(scope="session")
def chain_of() -> Callable[..., Chain]:
    """Chain of a URDF given as text: `chain_of(text, base, tip)`."""

    def make(urdf: str, base: str | None = None, tip: str | None = None) -> Chain:
        return Chain(parse_robot(urdf.encode(), "test.urdf"), base, tip)

    return make


@pytest.fixture(scope="session")
def scara(urdf_of: Callable[..., str], chain_of: Callable[..., Chain]) -> Chain:
    """Four joints along one direction: a shift along it is that of base and of tool.

    The tip link is called `tool`.
    """

    def joint(k: int, x: float, z: float, **more: Any) -> dict[str, Any]:
        placement = pin.SE3(np.eye(3), np.array([x, 0.0, z]))
        names = {"name": f"j{k}", "parent": f"l{k - 1}", "child": f"l{k}"}
        return {**names, "placement": placement, "limits": (-2.2, 2.2), **more}

    lift = {"type": "prismatic", "limits": (-0.2, 0.0)}
    mount = {"type": "fixed", "child": "tool"}
    return chain_of(
        urdf_of(
            joint(1, 0.0, 0.3),
            joint(2, 0.3, 0.05),
            joint(3, 0.25, 0.0, **lift),
            joint(4, 0.0, -0.1),
            joint(5, 0.06, -0.05, **mount),
        )
    )


@pytest.fixture(scope="session")
def measured(
    visited: Callable[..., tuple[Floats, Targets]],
) -> Callable[..., Problem]:
    """Problem of a chain: `measured(chain, model, parameterizations, rows, seed)`.

    Base and tool are estimated. Rows stand away from what the nominal robot predicts,
    each with its own sigma; a ranger looks at two planes in turn, in an order that
    what it cannot see mixes. Further settings of the setup may follow by name.
    """
    base = FrameSetup((0.1, -0.2, 0.05), (0.3, -0.2, 0.4), estimate=True)
    tool = FrameSetup((0.02, 0.03, 0.1), (-0.1, 0.2, 0.3), estimate=True)

    def make(
        chain: Chain,
        model: str,
        parameterizations: Sequence[str],
        rows: int,
        seed: int = 0,
        **settings: Any,
    ) -> Problem:
        rng = np.random.default_rng(seed)
        # Each plane is hit at a right angle, 2 m in front, from one configuration.
        F = chain.poses(chain.random_configurations(2, rng))
        T = frame_pose(base).homogeneous @ F @ frame_pose(tool).homogeneous
        planes = {
            name: PlaneSetup(tuple(beam), -float(beam @ point) - 2.0)
            for name, beam, point in zip(
                ("floor", "wall"), T[:, :3, 2], T[:, :3, 3], strict=True
            )
        }
        setup = Setup(
            parameters=tuple(parameterizations),
            base_frame=FAR if model == "camera" else base,
            tool_frame=tool,
            planes=planes,
            **_instrument(model, T[:, :3, 3]),
            **settings,
        )
        problem = nominal_problem(chain, model, setup)
        zero = np.zeros(len(problem.parameters))
        q, target = visited(problem, zero, rows, rng)
        start = None
        measurement = problem.only.measurement
        if measurement.declaration.relative:
            start = chain.random_configurations(rows, rng)
        exact = exact_problem(problem, zero, q, target, start)
        noise = 0.05 * rng.normal(size=(rows, exact.only.components))
        data = replace(
            exact.data.only,
            values=measurement.disturb(exact.data.only.values, noise),
            sigma=rng.uniform(0.005, 0.02, noise.shape),
        )
        return replace(problem, data=Observations.of(data))

    return make


@pytest.fixture(scope="session")
def simulated() -> Callable[..., tuple[Problem, Floats]]:
    """Measurements of a robot: `simulated(model, setup, count, size, seed, ...)`.

    Returns the problem with the rows, and the true errors: those of the robot have so
    many times their expected size, and changes by name come on top. The robot, space6
    by default, is a name or a chain; without `noise` there is none.
    """

    def make(
        model: str,
        setup: Setup | None = None,
        count: int = 40,
        size: float = 0.0,
        seed: int = 0,
        *,
        robot: str | Chain = "space6",
        noise: float = 0.0,
        changes: Mapping[str, float] | None = None,
    ) -> tuple[Problem, Floats]:
        rng = np.random.default_rng(seed)
        chain = load_chain(robot) if isinstance(robot, str) else robot
        problem = nominal_problem(chain, model, setup or Setup())
        theta = size * draw_errors(problem.parameters, rng)
        for name, change in (changes or {}).items():
            theta[problem.parameters.index(name)] += change
        rows = simulate(problem, theta, rng, count=count, noise=noise)
        return replace(problem, data=rows), theta

    return make


@pytest.fixture(scope="session")
def calibrated_robot(
    simulated: Callable[..., tuple[Problem, Floats]],
) -> Callable[..., Any]:
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
            problem, _ = simulated(*job, **more)
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


def _instrument(model: str, points: Floats) -> dict[str, Any]:
    """What a model needs besides planes, by two points that the tool reaches."""
    if model in ("position", "pose", "plane-distance"):
        return {}
    here, there = map(tuple, points)
    return {
        "targets": {
            "probe": PointSetup((0.03, -0.02, 0.05), estimate=True),
            "nest": PointSetup((-0.04, 0.06, -0.01), estimate=True),
        },
        "sockets": {"left/0": PointSetup(here), "left/1": PointSetup(there)},
        "spheres": {
            "ball": SphereSetup(here, 0.15, estimate_radius=True),
            "dome": SphereSetup(there, 0.3),
        },
        "anchors": {
            "wire": AnchorSetup(tuple(points[0] + 1.0), 0.01, estimate_bias=True),
            "bar": AnchorSetup(tuple(points[1] - 1.0)),
        },
        "camera": CameraSetup(
            "world",
            (900.0, 910.0),
            (640.0, 500.0),
            (-0.02, 0.01, 1e-3, -2e-3, 1e-3),
            estimate=True,
        ),
    }


def _inertial(mass: float, center: Sequence[float]) -> str:
    inertia = 'ixx="1" ixy="0.1" ixz="0" iyy="2" iyz="0" izz="3"'
    return (
        f'<inertial><origin xyz="{_numbers(center)}"/><mass value="{mass}"/>'
        f"<inertia {inertia}/></inertial>"
    )


def _numbers(values: Any) -> str:
    return " ".join(repr(float(value)) for value in values)


@pytest.fixture(scope="session")
def browser() -> Iterator[Any]:
    """Chromium without a window."""
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
def start_dask(tmp_path: Path) -> Iterator[Callable[[], Dask]]:
    """Starts a cluster of two workers on the loopback, again and again."""
    started: list[Dask] = []

    def start() -> Dask:
        folder = tmp_path / f"dask{len(started)}"
        folder.mkdir()
        started.append(Dask(folder))
        return started[-1].met()

    yield start
    for cluster in started:
        cluster.stop()


@pytest.fixture
def dask(start_dask: Callable[[], Dask]) -> Dask:
    """A cluster of two workers on the loopback."""
    return start_dask()


@dataclass(frozen=True)
class Fleet:
    """Robots of one type, space6 with a tracker, and their next one.

    Attributes:
        problem: The nominal robot before the tracker.
        mean: Errors that all have, shape (P,).
        spread: How far each deviates, shape (P,).
        results: Calibrations of the robots.
        population: What they have in common.
    """

    problem: Problem
    mean: Floats
    spread: Floats
    results: tuple[Any, ...]
    population: Any

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
    from calib_pin.estimation.statistics.population_prior import population_of
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
    population = population_of([robot_evidence(result) for result in results])
    return replace(bare, results=results, population=population)
