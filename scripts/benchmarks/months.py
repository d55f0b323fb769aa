"""One month after a calibration: what moved is named, and the error does not grow.

A robot with errors of its own is measured before a tracker, calibrated, changed, and
measured again with 10 to 20 positions. Kinematics are written here, from the text of
the URDF, and share no code with the package.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

import calib_pin
from benchmarks.criterion import Line, at_most
from benchmarks.verdict.jobs import stream
from calib_pin.setup import FrameSetup, Setup
from calib_pin.validation.tip_drift import absorbed

Floats = NDArray[np.float64]

ROBOTS = {
    "example:ur5_robot": ("base_link", "tool0"),
    "space6": ("base_link", "tool"),
    "space7": ("base_link", "tool"),
    "pa10": ("base_link", "tool"),
}
"""Robots by base and tip."""

KINDS = ("nothing", "joint", "tool", "tracker", "two", "other robot")
"""Changes of a month."""

FIRST = (60, 100)
"""Positions of the first calibration."""

LATER = (10, 20)
"""Those of the month."""

NOISE = (2e-5, 5e-5)
"""Of a coordinate [m]."""

HIT = np.deg2rad([0.1, 1.0])
"""Smallest and largest turn of a joint that was hit."""

ERRORS = 1e-3
"""Standard deviation of true errors [m, rad]."""

WORKSPACE = 300
"""Configurations at which errors are evaluated."""


def displacement(values: Floats) -> Floats:
    """A shift and then a turn as one pose, shape (6,) -> (4, 4)."""
    T = np.eye(4)
    T[:3, 3] = values[:3]
    T[:3, :3] = Rotation.from_rotvec(values[3:]).as_matrix()
    return T


@dataclass
class Truth:
    """A true robot before a tracker.

    Attributes:
        origins: Frame of each element of the chain in the one before, (4, 4).
        axes: Axis of each, shape (3,); None for a fixed one.
        slides: Whether each slides.
        offsets: Offset of each moving joint, shape (n,).
        base: The base in the frame of the tracker, shape (4, 4).
        tool: The reflector in the tip, shape (3,).
    """

    origins: list[Floats]
    axes: list[Floats | None]
    slides: list[bool]
    offsets: Floats
    base: Floats
    tool: Floats

    def poses(self, q: Floats) -> Floats:
        """Of the reflector in the frame of the tracker, shape (N, n) -> (N, 4, 4)."""
        T, column = np.tile(self.base, (len(q), 1, 1)), 0
        for origin, axis, slides in zip(
            self.origins, self.axes, self.slides, strict=True
        ):
            T = T @ origin
            if axis is None:
                continue
            moved = np.tile(np.eye(4), (len(q), 1, 1))
            along = np.outer(q[:, column] + self.offsets[column], axis)
            if slides:
                moved[:, :3, 3] = along
            else:
                moved[:, :3, :3] = Rotation.from_rotvec(along).as_matrix()
            T, column = T @ moved, column + 1
        tool = np.eye(4)
        tool[:3, 3] = self.tool
        return np.asarray(T @ tool)


def drawn(chain: calib_pin.Chain, rng: np.random.Generator) -> Truth:
    """A robot with random errors, before a tracker somewhere."""
    tree = ElementTree.fromstring(chain.robot.source)
    by_child = {j.find("child").get("link"): j for j in tree.findall("joint")}
    elements, link = [], chain.tip
    while link != chain.base:
        elements.append(by_child[link])
        link = by_child[link].find("parent").get("link")
    origins, axes, slides = [], list[Floats | None](), []
    for joint in reversed(elements):
        about = joint.find("origin")
        about = {} if about is None else about.attrib
        T = np.eye(4)
        T[:3, 3] = np.array(about.get("xyz", "0 0 0").split(), float)
        turn = np.array(about.get("rpy", "0 0 0").split(), float)
        T[:3, :3] = Rotation.from_euler("xyz", turn).as_matrix()
        fixed = joint.get("type") == "fixed"
        if not fixed:
            T = T @ displacement(ERRORS * rng.normal(size=6))
        origins.append(T)
        axis = joint.find("axis")
        text = "1 0 0" if axis is None else axis.get("xyz")
        axes.append(None if fixed else np.array(text.split(), float))
        slides.append(joint.get("type") == "prismatic")
    place = np.append(rng.uniform(-2.0, 2.0, 3), rng.normal(size=3))
    tool = rng.uniform(0.04, 0.1, 3) * rng.choice([-1.0, 1.0], 3)
    return Truth(
        origins, axes, slides, np.zeros(len(chain.joints)), displacement(place), tool
    )


@dataclass(frozen=True)
class Month:
    """The outcome of a month.

    Attributes:
        number: Its number.
        kind: What happened.
        stated: Whether base and tool were stated as known, first and in the month.
        changed: Names of what changed.
        told: What was told: for each change its name and those it may be instead.
        code: Code of the finding.
        promised: Error of the tool that the older calibration promised [m].
        older: That error now [m].
        newer: That of the new calibration [m].
        expected: What it expects [m].
        status: Its verdict.
    """

    number: int
    kind: str
    stated: tuple[bool, ...]
    changed: tuple[str, ...]
    told: tuple[tuple[str, ...], ...]
    code: str
    promised: float
    older: float
    newer: float
    expected: float
    status: str

    @property
    def named(self) -> bool:
        """Whether all that changed was named, and nothing else."""
        covered = all(any(name in one for one in self.told) for name in self.changed)
        if self.kind == "other robot":  # How tracker and tool are, is beside the point.
            return covered
        return covered and all(set(one) & set(self.changed) for one in self.told)

    @property
    def false(self) -> bool:
        """Whether it holds by the finding, and is twice as far off as promised."""
        holds = self.code == "old-calibration-holds"
        return holds and self.older > 2.0 * self.promised

    def __str__(self) -> str:
        """The outcome in one line."""
        mark = "" if self.named else " NOT NAMED"
        return (
            f"month {self.number}: {self.kind} {self.stated} {list(self.changed)}: "
            f"{list(self.told)}{mark} {self.code}{' FALSE' if self.false else ''}, "
            f"promised {1e3 * self.promised:.4f}, older {1e3 * self.older:.4f}, new "
            f"{1e3 * self.newer:.4f}, expected {1e3 * self.expected:.4f} mm, "
            f"{self.status}"
        )


def run(number: int) -> Month:
    """The month of a number."""
    rng, names = stream(number, 21), tuple(ROBOTS)
    kind = KINDS[number % len(KINDS)]
    robot = names[number // len(KINDS) % len(names)]
    base, tip = ROBOTS[robot]
    chain = calib_pin.load_chain(robot, base=base, tip=tip)
    truth, noise = drawn(chain, rng), float(rng.uniform(*NOISE))
    known = tuple(bool(one) for one in rng.random(2) < 0.25)
    # Some have learned by the month where base and tool are.
    now = tuple(one or bool(rng.random() < 0.2) for one in known)
    first = _measured(chain, truth, rng, int(rng.integers(*FIRST)), noise)
    older = calib_pin.calibrate(chain, first, _setup(truth, known), validate=False)
    changed = _change(chain, truth, rng, kind, known)
    rows = _measured(chain, truth, rng, int(rng.integers(*LATER)), noise)
    newer = calib_pin.calibrate(
        chain, rows, _setup(truth, now), start=older, validate=False
    )
    q = chain.random_configurations(WORKSPACE, stream(number, 22))
    step = newer.recalibration.last
    codes = [f.code for f in newer.findings if f.code.startswith("old-calibration")]
    return Month(
        number=number,
        kind=kind,
        stated=known + now,
        changed=changed,
        told=tuple((_name(jump), *jump.instead, *jump.beside) for jump in step.jumps),
        code=codes[0],
        promised=older.accuracy.workspace.calibrated[0],
        older=_error(truth, older, q),
        newer=_error(truth, newer, q),
        expected=newer.accuracy.workspace.calibrated[0],
        status=newer.verdict,
    )


def _name(jump: calib_pin.validation.result.Jump) -> str:
    if jump.kind == "offset":
        return f"joint '{jump.name}'"
    return jump.kind if jump.kind in ("base", "tool", "robot") else str(jump)


def _change(
    chain: calib_pin.Chain,
    truth: Truth,
    rng: np.random.Generator,
    kind: str,
    known: tuple[bool, ...],
) -> tuple[str, ...]:
    """Change a robot, or what is around it, and name that."""
    names = [f"joint '{joint}'" for joint in chain.joints]
    kinds = {"two": ["joint", ["joint", "tool", "tracker"][rng.integers(3)]]}
    hit = list(rng.permutation(len(names)))
    changed = []
    for one in kinds.get(kind, [kind]):
        far = 10.0 ** rng.uniform(-3.5, -1.5)
        if one == "joint":
            k = hit.pop()
            truth.offsets[k] += rng.choice([-1.0, 1.0]) * rng.uniform(*HIT)
            changed.append(names[k])
        elif one == "tool":
            truth.tool = truth.tool + far * _unit(rng)
            changed += [] if known[1] else ["tool"]
        elif one == "tracker":
            moved = np.append(far * _unit(rng), 10.0 * far * _unit(rng))
            truth.base = displacement(moved) @ truth.base
            changed += [] if known[0] else ["base"]
        elif one == "other robot":
            other = drawn(chain, rng)
            truth.origins = other.origins
            changed.append("robot")
    return tuple(changed)


def _unit(rng: np.random.Generator) -> Floats:
    vector = rng.normal(size=3)
    return np.asarray(vector / np.linalg.norm(vector))


def _setup(truth: Truth, known: tuple[bool, ...]) -> Setup:
    """What a user states: frames that he knows, and nothing else."""
    turn = Rotation.from_matrix(truth.base[:3, :3]).as_euler("xyz")
    base = FrameSetup(tuple(truth.base[:3, 3]), tuple(turn), estimate=False)
    tool = FrameSetup(tuple(truth.tool), (0.0, 0.0, 0.0), estimate=False)
    return Setup(
        base_frame=base if known[0] else FrameSetup(),
        tool_frame=tool if known[1] else FrameSetup(),
    )


def _measured(
    chain: calib_pin.Chain,
    truth: Truth,
    rng: np.random.Generator,
    count: int,
    noise: float,
) -> calib_pin.Measurements:
    q = chain.random_configurations(count, rng)
    points = truth.poses(q)[:, :3, 3]
    return calib_pin.Measurements(
        joints=chain.joints,
        q=q,
        values=points + noise * rng.normal(size=points.shape),
        model="position",
    )


def _error(truth: Truth, result: calib_pin.CalibrationResult, q: Floats) -> float:
    """True error of the tool over the workspace, rms, base and tool fitted [m]."""
    A = truth.poses(q)
    B = absorbed(A, result.model.of().poses(q))
    return float(np.sqrt(np.mean(np.sum((A - B)[:, :3, 3] ** 2, axis=1))))


def judge(found: Sequence[Month]) -> Iterator[Line]:
    """What was named, by kind; false promises; errors where nothing changed."""
    for kind in KINDS:
        some = [month for month in found if month.kind == kind]
        if some:
            named = [m.number for m in some if m.named]
            older, newer = (
                1e3 * np.mean([getattr(m, name) for m in some])
                for name in ("older", "newer")
            )
            yield Line(
                kind,
                f"{len(named)} of {len(some)} named; tool error {older:.4f} mm by the "
                f"older calibration, {newer:.4f} mm by the new one",
            )
    named = [month.number for month in found if month.named]
    yield at_most("what moved is named", named, len(found), 97.0, least=True)
    lost = [month.number for month in found if not month.named]
    yield Line("not named, or too much", str(lost))
    false = [month.number for month in found if month.false]
    holds = [month for month in found if month.code == "old-calibration-holds"]
    yield Line("holds", f"{len(holds)} of {len(found)}")
    yield at_most("'holds' above twice the promise", false, len(found), 1.0)
    calm = [month for month in found if month.kind == "nothing"]
    if calm:
        older, newer, promised, expected = 1e3 * np.mean(
            [(m.older, m.newer, m.promised, m.expected) for m in calm], axis=0
        )
        yield Line(
            "true error where nothing changed",
            f"{newer:.4f} mm",
            f"at most {older:.4f} mm, that of the older calibration",
            bool(newer <= older),
        )
        # A result that expects more than the older one says that this is to be used.
        told = f"{expected:.4f} mm, by the older calibration {promised:.4f} mm"
        yield Line("expected error where nothing changed", told)
