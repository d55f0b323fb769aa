"""Acceptance tests of simulated robots: verdicts at limits about the truth, coverage.

    scripts/benchmark acceptance                  # a tenth of the robots
    scripts/benchmark acceptance --full           # 300 of each way to know the frames
    scripts/benchmark acceptance --job 4 --tell   # one robot, told in full

A robot has errors at every joint and goes to five poses in 8 to 40 cycles; limits are
at 0.8 and at 1.25 of what endless visits would give for AP, RP and AD. Base and tool
are stated to an uncertainty, or registered on 60 other poses. In a third of the tests
something is wrong: the tracker is moved, two lines are exchanged, a reading is bad or a
visit is missing. Kinematics of its own, from the URDF, say what is true.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache, partial

import numpy as np
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from benchmarks.criteria import run_criteria
from benchmarks.criterion import Criterion, Line, at_most, between
from calib_pin.control.acceptance_poses import acceptance_poses
from calib_pin.io.urdf import load_chains
from calib_pin.kinematics.chains import Chains
from calib_pin.kinematics.spatial import Floats
from calib_pin.observations import Measurements, Observations
from calib_pin.setup import FrameSetup, LimitSetup, Setup
from calib_pin.validation.acceptance import Acceptance, Interval, judged, tested, worst

SEED = 20261126

TESTS, POSES, OTHERS = 300, 5, 60

MANY, MOST = 400_000, 2000
"""Visits, and other poses, that stand for endless ones."""

FAULTS = ("moved", "exchanged", "bad", "missing")

BELOW, ABOVE = 0.8, 1.25
"""Limits by the truth."""

QUANTITIES = {"position": "AP", "repeatability": "RP", "distance": "AD"}


@cache
def robot() -> tuple[Chains, tuple[tuple[Floats, Floats], ...], Floats]:
    """The robot, joints as origin and axis, and configurations of a planned cube."""
    chains = load_chains("space6", tip="tool")
    joints = []
    for joint in ET.fromstring(chains.robot.source).iter("joint"):
        origin, axis = joint.find("origin"), joint.find("axis")
        T = np.eye(4)
        if origin is not None:
            T[:3, 3] = [float(x) for x in origin.get("xyz", "0 0 0").split()]
            turns = [float(x) for x in origin.get("rpy", "0 0 0").split()]
            T[:3, :3] = Rotation.from_euler("xyz", turns).as_matrix()
        moves = joint.get("type") != "fixed" and axis is not None
        along = axis.get("xyz").split() if moves else [0, 0, 0]
        joints.append((T, np.array(along, float)))
    found = acceptance_poses(chains[""], np.eye(4))
    return chains, tuple(joints), found.q


def forward(q: Floats, errors: Floats | None = None) -> Floats:
    """Poses of the tip, (N, 4, 4), with a twist behind every origin, (joints, 6)."""
    T, k = np.tile(np.eye(4), (len(q), 1, 1)), 0
    for j, (origin, axis) in enumerate(robot()[1]):
        T = T @ origin
        if errors is not None:
            T = T @ pose(errors[j])
        if axis.any():
            turn = np.tile(np.eye(4), (len(q), 1, 1))
            turn[:, :3, :3] = Rotation.from_rotvec(q[:, k, None] * axis).as_matrix()
            T, k = T @ turn, k + 1
    return T


def pose(twist: Floats) -> Floats:
    """A pose from a position and a rotation vector, (6,)."""
    T = np.eye(4)
    T[:3, 3], T[:3, :3] = twist[:3], Rotation.from_rotvec(twist[3:]).as_matrix()
    return T


@dataclass(frozen=True)
class Outcome:
    """The outcome of a test.

    Attributes:
        number: Its number.
        fault: Its fault; empty for none.
        wrong: Quantities that wrongly passed or failed, as `PASS AP`.
        decided: Number of limits that were decided.
        told: Whether something is in doubt.
        held: Whether intervals hold the truth, by quantity, of poses and of the worst.
    """

    number: int
    fault: str
    wrong: tuple[str, ...]
    decided: int
    told: bool
    held: dict[str, tuple[bool, ...]]


def run(number: int, *, stated: bool) -> Outcome:
    """The test of a number."""
    rng = np.random.default_rng([SEED, number, stated])
    chains, joints, planned = robot()
    chain, cycles = chains[""], int(rng.choice([8, 15, 30, 30, 40]))
    q = planned if number % 2 else 0.7 * chain.random_configurations(POSES, rng)
    size = rng.uniform(0.2, 1.0) * np.array([3e-4] * 3 + [5e-4] * 3)
    errors = size * rng.standard_normal((len(joints), 6))
    place = np.array([*rng.uniform(-2, 2, 3), *rng.uniform(-1, 1, 3)])
    base, tool = pose(place), pose(np.array([0.02, -0.03, 0.12, 0, 0, 0]))
    to_point = tool[:3, 3]

    def points(at: Floats, wrong: Floats | None = None) -> Floats:
        T = base @ forward(at, wrong)
        return T[:, :3, :3] @ to_point + T[:, :3, 3]

    scatter = rng.uniform(5e-6, 3e-5) * rng.standard_normal((POSES, 3, 3))
    goal, mean = points(q), points(q, errors)
    names = np.tile(np.arange(POSES)[::-1], cycles)
    noise = rng.standard_normal((len(names), 3))
    x = mean[names] + np.einsum("nij,nj->ni", scatter[names], noise)
    cycle = np.repeat(np.arange(1, cycles + 1), POSES)
    fault = "" if number % 3 else str(rng.choice(FAULTS))
    kept = np.ones(len(x), bool)
    spread = np.sqrt((scatter**2).sum(axis=(1, 2)).mean())
    at = int(rng.integers(len(x) // 4, 3 * len(x) // 4))
    away = rng.standard_normal(3)
    away *= rng.uniform(8.0, 30.0) * spread / np.linalg.norm(away)
    if fault == "moved":
        x[at:] += away
    elif fault == "bad":
        x[at] += away
    elif fault == "exchanged":
        x[[at, at + 1]] = x[[at + 1, at]]
    elif fault == "missing":
        kept[at] = False
    sigma = rng.uniform(0.3, 1.0) * np.array([1e-4, 1e-4])
    setup, lines = Setup(base=chain.base, tip=chain.tip), np.arange(2, 2 + len(x))[kept]
    rows = Measurements(
        chain.joints,
        q[names[kept]],
        "position",
        x[kept],
        lines=lines,
        validate=kept[kept],
    )
    if stated:
        setup = replace(setup, **known(base, tool, sigma, rng))
    else:
        others = chain.random_configurations(OTHERS, rng)
        seen = points(others, errors) + 2e-5 * rng.standard_normal((OTHERS, 3))
        located = Measurements(chain.joints, others, "position", seen)
        rows = Measurements.concatenate([located, rows])
    columns = {"pose": names + 1, "cycle": cycle}
    named = {
        column: {("", int(line)): int(of[line - 2]) for line in lines}
        for column, of in columns.items()
    }
    tests, _ = tested(chains, Observations.of(rows), setup, named=named)
    if not stated:
        # The frames that endless other poses tell: those of a robot's own first and
        # last errors are no errors of it.
        guess = np.array([*place, *to_point])
        goal = registered(
            chain.random_configurations(MOST, rng), points, errors, guess
        )(q)
    return outcome(number, fault, tests["robot"], truth(goal, mean, scatter))


def known(
    base: Floats, tool: Floats, sigma: Floats, rng: np.random.Generator
) -> dict[str, object]:
    """Frames that are off by their stated uncertainty, (m, rad)."""
    size = np.repeat(sigma, 3)
    # Deviations are on the side of the robot, where parameters have theirs.
    near = base @ pose(size * rng.standard_normal(6))
    turns = Rotation.from_matrix(near[:3, :3]).as_euler("xyz")
    point = tool[:3, 3] + sigma[0] * rng.standard_normal(3)
    prior = {f"base.frame.{a}": float(sigma[0]) for a in "xyz"}
    prior |= {f"base.frame.r{a}": float(sigma[1]) for a in "xyz"}
    prior |= {f"tool.frame.{a}": float(sigma[0]) for a in "xyz"}
    return {
        "base_frame": FrameSetup(tuple(near[:3, 3]), tuple(turns)),
        "tool_frame": FrameSetup(tuple(point), (0.0, 0.0, 0.0)),
        "fixed": ("tool.frame.r?",),
        "prior": prior,
    }


def registered(
    q: Floats, points: Callable[..., Floats], errors: Floats, guess: Floats
) -> Callable[[Floats], Floats]:
    """Commanded points by the nominal robot with frames fitted to a robot's points."""
    seen, at = points(q, errors), forward(q)

    def goal(frames: Floats, at: Floats) -> Floats:
        T = pose(frames[:6]) @ at
        return T[:, :3, :3] @ frames[6:] + T[:, :3, 3]

    found = least_squares(
        lambda x: (goal(x, at) - seen).reshape(-1), guess, x_scale="jac"
    )
    return lambda q: goal(found.x, forward(q))


def truth(goal: Floats, mean: Floats, scatter: Floats) -> dict[str, Floats]:
    """AP and RP of poses and AD of pairs, for endless visits."""
    rng = np.random.default_rng(0)
    noise = rng.standard_normal((MANY, 3))
    lengths = [np.linalg.norm(noise @ L.T, axis=1) for L in scatter]
    pairs = [(i, j) for i in range(POSES) for j in range(i + 1, POSES)]
    D = [np.linalg.norm(mean[i] - mean[j]) for i, j in pairs]
    D_c = [np.linalg.norm(goal[i] - goal[j]) for i, j in pairs]
    return {
        "AP": np.linalg.norm(mean - goal, axis=1),
        "RP": np.array([n.mean() + 3.0 * n.std() for n in lengths]),
        "AD": np.array(D) - np.array(D_c),
    }


def outcome(
    number: int, fault: str, test: Acceptance, true: dict[str, Floats]
) -> Outcome:
    """The outcome of a test beside the truth."""
    intervals: dict[str, list[Interval]] = {
        "AP": [p.accuracy for p in test.poses if p.accuracy is not None],
        "RP": [p.repeatability for p in test.poses],
        "AD": [d.accuracy for d in test.distances],
    }
    wrong, decided = [], 0
    for by, status in ((BELOW, "pass"), (ABOVE, "fail")):
        limits = {k: by * float(np.abs(true[n]).max()) for k, n in QUANTITIES.items()}
        for name, said, *_ in judged(test, LimitSetup(**limits)):
            wrong += [f"{status.upper()} {name}"] * (said == status)
            decided += said in ("pass", "fail")
    held = {}
    if fault != "moved":  # There is no truth of a pose that is seen from two places.
        for name, own in intervals.items():
            every = zip(own, true[name], strict=True)
            held[name] = tuple(i.low <= t <= i.high for i, t in every)
        for name in ("AP", "RP"):
            whole, most = worst(intervals[name]), float(true[name].max())
            held[f"worst {name}"] = (whole.low <= most <= whole.high,)
    told = bool(test.doubts) or test.moved
    return Outcome(number, fault, tuple(wrong), decided, told, held)


def judge(found: Sequence[Outcome]) -> Iterator[Line]:
    """The lines of all tests."""
    count = len(found)
    for status, limit in (("PASS", 1.0), ("FAIL", 5.0)):
        numbers = [o.number for o in found if any(status in w for w in o.wrong)]
        yield at_most(f"robots with a wrong {status}", numbers, count, limit)
    for name in dict.fromkeys(name for o in found for name in o.held):
        held = [h for o in found for h in o.held.get(name, ())]
        chance = (0.05 * 0.95 / len(found)) ** 0.5
        figure = float(np.mean(held))
        yield between(f"intervals of {name} that hold", figure, 0.93, 0.97, chance)
    decided = sum(o.decided for o in found) / (6 * count)
    yield Line("limits that are decided", f"{100 * decided:.0f} %")
    for fault in ("", *FAULTS):
        own = [o.told for o in found if o.fault == fault]
        yield Line(f"told of {fault or 'nothing wrong'}", f"{sum(own)} of {len(own)}")


CRITERIA = {
    "stated": Criterion(
        1, "frames to a stated uncertainty", TESTS, partial(run, stated=True), judge
    ),
    "registered": Criterion(
        2, "frames registered on other poses", TESTS, partial(run, stated=False), judge
    ),
}


def main() -> None:
    """Run the criteria."""
    run_criteria("acceptance", CRITERIA, SEED)
