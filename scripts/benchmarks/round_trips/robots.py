"""Robots at random, as URDFs and controllers have them, and the true robot behind each.

The kinematics are written here and share no code with the package: a tree of joints,
mimic joints among them, and the columns of a controller that shows its drives with
signs, gears, offsets, couplings and units of its own.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import pairwise
from pathlib import Path
from xml.sax.saxutils import quoteattr

import numpy as np
import yaml
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

Floats = NDArray[np.float64]
Positions = dict[str, Floats]
"""Values by joint or column, each of shape (N,) [rad, m]."""

NOISE, TURN_NOISE = 2e-5, 1e-4
"""Of measured positions [m] and orientations [rad]."""

TURN = 2.0 * np.pi

WAYS = 10
"""Ways of which a motion is chosen."""

LEVER = 0.3
"""Length at which a turn counts as a move [m]."""

UNLIMITED = {"prismatic": 1.0, "revolute": np.pi, "continuous": np.pi}
"""Positions that joints without limits are brought to, either way [m, rad]: those of
the workspace over which the package states errors."""


def pose(xyz: Sequence[float] | Floats, rotation: Rotation) -> Floats:
    """A pose, shape (4, 4)."""
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = rotation.as_matrix(), xyz
    return T


def rpy_of(T: Floats) -> list[float]:
    """Roll, pitch and yaw of a pose [rad]."""
    with warnings.catch_warnings():  # Quarter turns have many; any is right.
        warnings.simplefilter("ignore")
        return Rotation.from_matrix(T[:3, :3]).as_euler("xyz").tolist()


@dataclass(frozen=True)
class Joint:
    """A joint of a tree.

    Attributes:
        name: Its name.
        kind: `fixed`, `revolute`, `continuous` or `prismatic`.
        parent: Link that carries it.
        child: Link that it carries.
        origin: Its frame in that of the parent, shape (4, 4).
        axis: Unit vector in its frame, shape (3,).
        limits: Lower and upper limit [rad, m]; None where none is stated.
        speed: Fastest speed [rad/s, m/s]; zero where none is stated.
        mimic: Leader, multiplier and offset; None where it has a drive.
    """

    name: str
    kind: str
    parent: str
    child: str
    origin: Floats
    axis: Floats = field(default_factory=lambda: np.array([0.0, 0.0, 1.0]))
    limits: tuple[float, float] | None = None
    speed: float = 0.0
    mimic: tuple[str, float, float] | None = None

    @property
    def turns(self) -> bool:
        """Whether its positions are angles."""
        return self.kind != "prismatic"

    @property
    def drive(self) -> bool:
        """Whether a motor moves it."""
        return self.kind != "fixed" and self.mimic is None

    @property
    def span(self) -> tuple[float, float]:
        """Positions that it is brought to [rad, m]."""
        far = UNLIMITED.get(self.kind, 0.0)
        return self.limits or (-far, far)

    def moved(self, q: Floats) -> Floats:
        """Its child in its parent, shape (N, 4, 4)."""
        T = np.tile(np.eye(4), (len(q), 1, 1))
        if self.kind == "prismatic":
            T[:, :3, 3] = np.outer(q, self.axis)
        elif self.kind != "fixed":
            T[:, :3, :3] = Rotation.from_rotvec(np.outer(q, self.axis)).as_matrix()
        return np.asarray(self.origin @ T)

    def xml(self) -> Iterator[str]:
        """Its lines of the URDF."""
        x = " ".join(repr(float(number)) for number in self.origin[:3, 3])
        turn = " ".join(repr(number) for number in rpy_of(self.origin))
        yield f'  <joint name={quoteattr(self.name)} type="{self.kind}">'
        yield f'    <origin xyz="{x}" rpy="{turn}"/>'
        yield f"    <parent link={quoteattr(self.parent)}/>"
        yield f"    <child link={quoteattr(self.child)}/>"
        if self.kind != "fixed":
            axis = " ".join(repr(float(number)) for number in self.axis)
            yield f'    <axis xyz="{axis}"/>'
            ends = () if self.kind == "continuous" else self.limits or ()
            numbers = dict(zip(("lower", "upper"), ends, strict=False))
            numbers["velocity"] = self.speed
            if self.kind != "continuous" or self.speed:
                stated = "".join(f' {key}="{x!r}"' for key, x in numbers.items())
                yield f'    <limit effort="100"{stated}/>'
        if self.mimic is not None:
            leader, factor, offset = self.mimic
            stated = f'multiplier="{factor!r}" offset="{offset!r}"'
            yield f"    <mimic joint={quoteattr(leader)} {stated}/>"
        yield "  </joint>"


@dataclass(frozen=True)
class Tree:
    """A tree of joints, and a chain in it.

    Attributes:
        joints: Its joints.
        base: First link of the chain.
        tip: Last link of the chain.
    """

    joints: tuple[Joint, ...]
    base: str
    tip: str

    @cached_property
    def named(self) -> dict[str, Joint]:
        """Joints by name."""
        return {joint.name: joint for joint in self.joints}

    @cached_property
    def path(self) -> list[Joint]:
        """Joints from the base to the tip."""
        above = {joint.child: joint for joint in self.joints}
        found, link = list[Joint](), self.tip
        while link != self.base:
            found.append(above[link])
            link = above[link].parent
        return found[::-1]

    @cached_property
    def chain(self) -> list[Joint]:
        """Moving joints from the base to the tip."""
        return [joint for joint in self.path if joint.kind != "fixed"]

    @cached_property
    def drives(self) -> list[Joint]:
        """Joints with a motor that move the chain."""
        leaders = dict.fromkeys(j.mimic[0] if j.mimic else j.name for j in self.chain)
        return [self.named[name] for name in leaders]

    def followed(self, drives: Mapping[str, Floats]) -> Positions:
        """Positions of the joints of the chain, by those of the drives."""
        q = dict(drives)
        for joint in self.chain:
            if joint.mimic is not None:
                leader, factor, offset = joint.mimic
                q[joint.name] = factor * q[leader] + offset
        return q

    def poses(self, q: Mapping[str, Floats]) -> Floats:
        """Poses of the tip in the base, shape (N, 4, 4), by positions of the chain."""
        count = len(next(iter(q.values())))
        T = np.tile(np.eye(4), (count, 1, 1))
        for joint in self.path:
            T = T @ joint.moved(q.get(joint.name, np.zeros(count)))
        return T

    def xml(self, name: str, inertias: bool) -> str:
        """The URDF."""
        lines = ['<?xml version="1.0"?>', f"<robot name={quoteattr(name)}>"]
        links = [j.parent for j in self.joints] + [j.child for j in self.joints]
        heavy = (
            '<inertial><mass value="2"/><inertia ixx="0.02" iyy="0.02" izz="0.02" '
            'ixy="0" ixz="0" iyz="0"/></inertial>'
        )
        for link in dict.fromkeys(links):
            lines.append(f"  <link name={quoteattr(link)}>{heavy * inertias}</link>")
        for joint in self.joints:
            lines += joint.xml()
        return "\n".join([*lines, "</robot>", ""])


@dataclass(frozen=True)
class Drive:
    """What a controller shows of a joint.

    Attributes:
        joint: The joint.
        column: Name of the column.
        header: Its header in files.
        unit: Unit of the header [rad, m].
        sign: Sign, as in a setup file.
        gear: Gear.
        offset: Offset of the joint [rad, m].
        coupled: Factors by other columns.
        least: Where the column begins again after a turn [rad]; None where it does not.
        span: Positions of the joint that it is brought to [rad, m].
    """

    joint: str
    column: str
    header: str
    unit: float
    sign: int = 1
    gear: float = 1.0
    offset: float = 0.0
    coupled: Mapping[str, float] = field(default_factory=dict)
    least: float | None = None
    span: tuple[float, float] = (0.0, 0.0)

    @property
    def map(self) -> dict[str, object]:
        """Its entry in the setup; empty where the column is the joint."""
        entry: dict[str, object] = {"joint": self.joint}
        entry |= {"sign": -1} if self.sign < 0 else {}
        entry |= {"gear": self.gear} if self.gear != 1.0 else {}
        entry |= {"offset": self.offset} if self.offset else {}
        entry |= {"coupled": dict(self.coupled)} if self.coupled else {}
        return entry if len(entry) > 1 or self.joint != self.column else {}


@dataclass(frozen=True)
class Robot:
    """A robot, its controller, and an instrument that sees its tool.

    Attributes:
        seed: Its number.
        nominal: As its URDF has it.
        true: As it is.
        controller: Columns of the drives.
        slips: Offset of each column, which the true robot has beside [rad, m].
        base: The base link in the frame of the instrument, shape (4, 4).
        tool: The tool in the tip link, shape (4, 4).
        pose: Whether orientations are measured.
        known: Whether the setup states base and tool.
        offsets: Whether the errors are slips alone.
        stated_base: Whether the setup states the base link.
        beside: Whether files have columns of mimic joints as well.
        millimeters: Whether points are in millimeters.
        inertias: Whether the URDF states masses.
        count: Number of measurements.
        properties: What is special, for messages.
    """

    seed: int
    nominal: Tree
    true: Tree
    controller: tuple[Drive, ...]
    slips: Mapping[str, float]
    base: Floats
    tool: Floats
    pose: bool
    known: bool
    offsets: bool
    stated_base: bool
    beside: bool
    millimeters: bool
    inertias: bool
    count: int
    properties: tuple[str, ...]

    def drives(self, columns: Mapping[str, Floats]) -> Positions:
        """Positions of the drives, by those of columns."""
        q = {}
        for one in self.controller:
            shown = columns[one.column] + sum(
                factor * columns[other] for other, factor in one.coupled.items()
            )
            q[one.joint] = one.sign * one.gear * shown + one.offset
        return q

    def positions(self, columns: Mapping[str, Floats]) -> Positions:
        """Positions of the joints of the chain, by those of columns."""
        return self.nominal.followed(self.drives(columns))

    def columns(self, drives: Mapping[str, Floats]) -> Positions:
        """Positions of columns, by those of the drives; none is wrapped."""
        names = [one.column for one in self.controller]
        A = np.eye(len(names))
        for i, one in enumerate(self.controller):
            for other, factor in one.coupled.items():
                A[i, names.index(other)] += factor
        moved = [
            (drives[one.joint] - one.offset) / (one.sign * one.gear)
            for one in self.controller
        ]
        return dict(zip(names, np.linalg.solve(A, np.array(moved)), strict=True))

    def wrapped(self, columns: Mapping[str, Floats]) -> Positions:
        """Columns as the controller shows them."""
        shown = dict(columns)
        for one in self.controller:
            if one.least is not None:
                shown[one.column] = (shown[one.column] - one.least) % TURN + one.least
        return shown

    def seen(self, columns: Mapping[str, Floats]) -> Floats:
        """The true tool in the frame of the instrument, shape (N, 4, 4)."""
        slipped = {name: x + self.slips[name] for name, x in columns.items()}
        return self.base @ self.true.poses(self.positions(slipped)) @ self.tool

    def flange(self, columns: Mapping[str, Floats]) -> Floats:
        """The true tip in the base link, shape (N, 4, 4)."""
        return np.linalg.inv(self.base) @ self.seen(columns) @ np.linalg.inv(self.tool)

    def random(
        self, count: int, rng: np.random.Generator, part: float = 0.95
    ) -> Positions:
        """Columns at random, within a part of what the joints reach; none wrapped."""
        drives = {}
        for one in self.controller:
            lower, upper = one.span
            way = 0.5 * part * (upper - lower) * rng.uniform(-1.0, 1.0, count)
            drives[one.joint] = 0.5 * (lower + upper) + way
        return self.columns(drives)

    def motion(self, count: int, rng: np.random.Generator) -> Positions:
        """Columns on a smooth way, of some the one farthest from where joints lock."""
        ways = [self._way(count, rng) for _ in range(WAYS)]
        return max(ways, key=self._freedom)

    def _freedom(self, columns: Mapping[str, Floats]) -> float:
        """Least motion of the tip that drives can make, by theirs [m]."""
        q, step = self.drives(columns), 1e-6
        q = {name: x[:: len(x) // 8] for name, x in q.items()}
        tree = self.nominal
        T = tree.poses(tree.followed(q))
        J = []
        for name in q:
            moved = tree.poses(tree.followed(q | {name: q[name] + step}))
            twist = [(moved - T)[:, :3, 3]]
            if len(q) >= 6:
                turn = T[:, :3, :3] @ np.swapaxes(moved[:, :3, :3], 1, 2)
                twist.append(LEVER * Rotation.from_matrix(turn).as_rotvec())
            J.append(np.hstack(twist) / step)
        values = np.linalg.svd(np.moveaxis(J, 0, 2), compute_uv=False)
        return float(values[:, -1].min())

    def _way(self, count: int, rng: np.random.Generator) -> Positions:
        """Columns on a way; those that turn without end pass their seam."""
        start = self.random(1, rng, 0.4)
        # Those that begin again do so in the middle.
        for one in self.controller:
            if one.least is not None:
                start[one.column][:] = one.least + TURN * rng.integers(0, 2)
        t = np.linspace(-1.0, 1.0, count)
        drives = {}
        for one in self.controller:
            lower, upper = one.span
            way = min(0.15 * (upper - lower), 0.4) * rng.uniform(0.4, 1.0)
            drives[one.joint] = way * rng.choice([-1, 1]) * np.sin(t * np.pi / 2.0)
        middle = self.drives(start)
        return self.columns({name: middle[name] + x for name, x in drives.items()})

    def cells(self, columns: Mapping[str, Floats]) -> dict[str, Floats]:
        """Columns by their headers, as the controller writes them."""
        shown = self.wrapped(columns)
        found = {one.header: shown[one.column] / one.unit for one in self.controller}
        if self.beside:
            q = self.positions(columns)
            found |= {j.name: q[j.name] for j in self.nominal.chain if j.mimic}
        return found

    def points(self, T: Floats, pose: bool) -> dict[str, Floats]:
        """Columns of points, with orientations where they are wanted."""
        end, unit = (" [mm]", 1e-3) if self.millimeters else ("", 1.0)
        names = [f"{axis}{end}" for axis in "xyz"]
        found = dict(zip(names, T[:, :3, 3].T / unit, strict=True))
        if pose:
            turns = Rotation.from_matrix(T[:, :3, :3]).as_quat()
            found |= dict(zip(("qx", "qy", "qz", "qw"), turns.T, strict=True))
        return found

    @property
    def setup(self) -> dict[str, object]:
        """The setup file."""
        found: dict[str, object] = {"tip": self.nominal.tip}
        found |= {"base": self.nominal.base} if self.stated_base else {}
        joints = {one.column: one.map for one in self.controller if one.map}
        found |= {"joints": joints} if joints else {}
        found |= {"parameters": ["joint-offset"]} if self.offsets else {}
        if self.known:
            found["frames"] = {
                name: {"xyz": T[:3, 3].tolist(), "rpy": rpy_of(T), "estimate": False}
                for name, T in (("base", self.base), ("tool", self.tool))
            }
        return found

    def write(self, folder: Path) -> None:
        """Write `robot.urdf`, `s.yaml` and `m.csv`."""
        rng = np.random.default_rng([self.seed, 1])
        text = self.nominal.xml(f"robot_{self.seed}", self.inertias)
        folder.joinpath("robot.urdf").write_text(text)
        folder.joinpath("s.yaml").write_text(yaml.safe_dump(self.setup))
        columns = self.random(self.count, rng)
        T = self.seen(columns)
        T[:, :3, 3] += rng.normal(scale=NOISE, size=(self.count, 3))
        turned = Rotation.from_rotvec(rng.normal(scale=TURN_NOISE, size=(len(T), 3)))
        T[:, :3, :3] = T[:, :3, :3] @ turned.as_matrix()
        points = self.points(T, self.pose)
        folder.joinpath("m.csv").write_text(table(self.cells(columns) | points))


def table(columns: Mapping[str, Floats]) -> str:
    """Text of columns of numbers below their headers."""
    rows = np.column_stack([*columns.values()])
    lines = (",".join(repr(float(x)) for x in row) for row in rows)
    return "\n".join([",".join(columns), *lines, ""])


NAMES = ("joint_{}", "J{}", "Joint {}", "Rev {} [wrist]", "axis ({})", "arm joint{}")
COLUMNS = ("A{}", "Axis {}", "q{}", "Motor {} (cmd)")
TIPS = ("tool", "tool0", "{joint}", "wrist tip", "measurement", "{parent} tip")
SIMPLE = np.pi / 2.0 * np.arange(-1, 3)


@dataclass
class _Maker:
    """Makes a robot, bit by bit.

    Attributes:
        rng: Generator of all that is random.
        joints: Joints so far.
        said: Properties so far.
        unpaced: Whether the URDF states no speeds.
    """

    rng: np.random.Generator
    joints: list[Joint] = field(default_factory=list)
    said: list[str] = field(default_factory=list)
    unpaced: bool = False

    def likely(self, chance: float, property: str = "") -> bool:
        """Whether something is so; the property is noted."""
        found = bool(self.rng.random() < chance)
        if found and property and property not in self.said:
            self.said.append(property)
        return found

    def origin(self, least: float = 0.1, most: float = 0.35) -> Floats:
        """A pose at some distance."""
        x = self.rng.normal(size=3)
        x *= self.rng.uniform(least, most) / np.linalg.norm(x)
        turn = Rotation.from_euler("xyz", self.rng.choice(SIMPLE, 3))
        if self.likely(0.5):
            turn = Rotation.identity()
        elif self.likely(0.25):
            turn = Rotation.random(rng=self.rng)
        return pose(np.round(x, 4), turn)

    def axis(self, before: Floats) -> Floats:
        """An axis, seldom that of the joint before."""
        if self.likely(0.15):
            axis = self.rng.normal(size=3)
            return np.asarray(axis / np.linalg.norm(axis))
        axes = np.eye(3)
        across = [k for k in range(3) if abs(axes[k] @ before) < 0.9]
        k = int(self.rng.choice(across if self.likely(0.75) else [0, 1, 2]))
        return np.asarray(axes[k] * self.rng.choice([-1.0, 1.0]))

    def joint(self, name: str, parent: str, child: str, axis: Floats) -> Joint:
        """A joint with a drive."""
        kind = "revolute"
        if self.likely(0.15, "prismatic"):
            kind = "prismatic"
        elif self.likely(0.25, "continuous"):
            kind = "continuous"
        half = 0.4 if kind == "prismatic" else self.rng.uniform(1.4, 2.8)
        middle, limits = 0.0, None
        if self.likely(0.12, "narrow limits"):
            half *= 0.3
            middle = half * self.rng.uniform(-2.0, 2.0)
        if kind != "continuous" and not self.likely(0.1, "no limits"):
            limits = (round(middle - half, 3), round(middle + half, 3))
        speed = 0.0
        if not self.unpaced:
            speed = round(self.rng.uniform(0.5, 3.0), 3)
        return Joint(name, kind, parent, child, self.origin(), axis, limits, speed)

    def follower(self, joint: Joint, leader: Joint) -> Joint:
        """A joint as one that follows another."""
        factor = float(self.rng.choice([1.0, -1.0, 0.5, -0.5, 2.0]))
        offset = float(round(self.rng.uniform(-0.2, 0.2), 3)) if self.likely(0.6) else 0
        if not leader.turns:
            factor, offset = float(np.clip(factor, -1.0, 1.0)), 0.3 * offset
        ends = sorted(factor * x + offset for x in leader.span)
        kind, limits = leader.kind, (ends[0] - 0.05, ends[1] + 0.05)
        return replace(
            joint,
            kind=kind,
            limits=None if kind == "continuous" else limits,
            mimic=(leader.name, factor, float(offset)),
        )


def robot(seed: int) -> Robot:
    """The robot of a number."""
    rng = np.random.default_rng(seed)
    make = _Maker(rng)
    nominal = _tree(make)
    controller = _controller(make, nominal)
    offsets = make.likely(0.2, "slips alone")
    errors = {j.name: _error(rng) for j in nominal.joints if j.kind != "fixed"}
    slips = {
        one.column: float(rng.normal(scale=5e-3 if turns else 1e-3))
        for one in controller
        for turns in [nominal.named[one.joint].turns]
    }
    true = nominal
    if not offsets:
        slips = dict.fromkeys(slips, 0.0)
        true = replace(
            nominal,
            joints=tuple(
                replace(joint, origin=joint.origin @ errors.get(joint.name, np.eye(4)))
                for joint in nominal.joints
            ),
        )
    base = pose(rng.uniform(-2.0, 2.0, 3), Rotation.random(rng=rng))
    tool = pose(rng.uniform(-0.1, 0.1, 3), Rotation.random(rng=rng))
    measures = make.likely(0.4, "pose")
    return Robot(
        seed,
        nominal,
        true,
        controller,
        slips,
        base,
        tool,
        measures,
        make.likely(0.4, "known frames"),
        offsets,
        nominal.base != nominal.joints[0].parent,
        make.likely(0.3) and any(j.mimic for j in nominal.chain),
        make.likely(0.5, "mm"),
        make.likely(0.5),
        60 + 5 * len(nominal.chain),
        tuple(make.said),
    )


def _error(rng: np.random.Generator) -> Floats:
    """An error of a placement."""
    turn = Rotation.from_rotvec(rng.normal(scale=1.5e-3, size=3))
    return pose(rng.normal(scale=8e-4, size=3), turn)


def _tree(make: _Maker) -> Tree:
    """The tree of a robot."""
    rng = make.rng
    make.unpaced = make.likely(0.15, "no speeds")
    root = base = str(rng.choice(["base", "base_link", "world"]))
    joints = list[Joint]()
    if make.likely(0.4, "displaced base"):
        base = "foot"
        joints.append(Joint("mount", "fixed", root, base, make.origin(0.2, 0.8)))
    count, way = int(rng.integers(4, 9)), str(rng.choice(NAMES))
    make.said += [f"{count} joints", f"named '{way}'"]
    parent, axis, moving = base, np.array([1.0, 0.0, 0.0]), list[Joint]()
    for k in range(count):
        axis = make.axis(axis)
        moving.append(make.joint(way.format(k + 1), parent, f"link_{k + 1}", axis))
        parent = f"link_{k + 1}"
    beside = _followers(make, moving, base)
    tip, joint = parent, moving[-1].name
    for k in range(int(rng.integers(0, 3))):
        make.likely(1.0, "fixed joints before the tip")
        tip = f"adapter {k + 1}"
        joints.append(Joint(f"fixed_{k + 1}", "fixed", parent, tip, make.origin(0.02)))
        parent = tip
    name = str(rng.choice(TIPS)).format(joint=joint, parent=parent)
    joints.append(Joint("tip_joint", "fixed", parent, name, make.origin(0.02, 0.1)))
    make.said.append(f"tip '{name}'")
    if make.likely(0.35, "another arm"):
        parent = str(rng.choice([base, "link_2"]))
        for k in range(3):
            child = f"other_link_{k + 1}"
            joint = f"other_{k + 1}"
            moving.append(make.joint(joint, parent, child, make.axis(axis)))
            parent = child
    # The first joint carries the root.
    stated = base if base != root and make.likely(0.3, "stated base") else root
    ordered = [*joints[:1], *moving, *beside, *joints[1:]]
    if joints[0].parent != root:
        ordered = [*moving, *beside, *joints]
    return Tree(tuple(ordered), stated, name)


def _followers(make: _Maker, moving: list[Joint], base: str) -> list[Joint]:
    """Make some joints of the chain follow others; leaders outside the chain."""
    rng, beside, count = make.rng, list[Joint](), len(moving)
    if count > 4 and make.likely(0.4, "mimic inside"):
        i, k = rng.permutation(count)[:2]
        moving[k] = make.follower(moving[k], moving[i])
    drives = [k for k in range(count) if moving[k].mimic is None]
    leaders = {joint.mimic[0] for joint in moving if joint.mimic}
    free = [k for k in drives if moving[k].name not in leaders]
    if len(drives) > 4 and make.likely(0.35, "leader outside"):
        leader = make.joint("lift drive", base, "dummy", np.array([0.0, 0.0, 1.0]))
        beside.append(leader)
        wanted = int(rng.integers(1, min(len(drives) - 3, 3)))
        for k in rng.choice(free, min(wanted, len(free)), replace=False):
            moving[k] = make.follower(moving[k], leader)
    return beside


def _controller(make: _Maker, tree: Tree) -> tuple[Drive, ...]:
    """What the controller shows."""
    rng = make.rng
    mapped, way = make.likely(0.6, "mapped"), str(rng.choice(COLUMNS))
    degrees, millimeters = make.likely(0.5, "deg"), make.likely(0.5)
    reversed, geared = make.likely(0.6), make.likely(0.5)
    found = list[Drive]()
    for k, joint in enumerate(tree.drives):
        column, sign, gear, offset = joint.name, 1, 1.0, 0.0
        if mapped and make.likely(0.75):
            column = way.format(k + 1)
            sign = -1 if reversed and make.likely(0.5, "reversed") else 1
            if geared and joint.kind != "continuous" and make.likely(0.4, "gear"):
                gear = float(rng.choice([0.5, 1.25, 2.0]))
            if make.likely(0.3, "offset"):
                offset = float(rng.choice([-np.pi / 2, np.pi / 2, 0.3, -0.7]))
                offset *= 1.0 if joint.turns else 0.1
        header, unit = column, 1.0
        if joint.turns and degrees:
            header, unit = f"{column} [deg]", np.pi / 180.0
        elif not joint.turns and millimeters:
            header, unit = f"{column} [mm]", 1e-3
        drive = Drive(joint.name, column, header, unit, sign, gear, offset)
        found.append(replace(drive, span=joint.span))
    if mapped and make.likely(0.5):
        _couple(make, tree, found)
    return tuple(_wrap(make, tree, one, found) for one in found)


def _couple(make: _Maker, tree: Tree, found: list[Drive]) -> None:
    """Couple one or two columns with others before or behind."""
    order = make.rng.permutation(len(found))
    turning = [k for k in order if tree.named[found[k].joint].turns]
    for i, k in list(pairwise(turning))[: 1 + make.likely(0.4)]:
        factor = float(make.rng.choice([1.0, -1.0, 0.5]))
        found[k] = replace(found[k], coupled={found[i].column: factor})
        make.likely(1.0, "coupled")


def _wrap(make: _Maker, tree: Tree, one: Drive, found: Sequence[Drive]) -> Drive:
    """A column that begins again after a turn, where that moves nothing."""
    followers = [j for j in tree.chain if j.mimic and j.mimic[0] == one.joint]
    others = [other for other in found if one.column in other.coupled]
    whole = all(float(j.mimic[1]).is_integer() for j in followers if j.mimic)
    if tree.named[one.joint].kind != "continuous" or others or not whole:
        return one
    if one.coupled or not make.likely(0.6, "0..360"):
        return one
    return replace(one, least=0.0 if make.likely(0.7) else -np.pi)
