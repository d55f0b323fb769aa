"""Plan which configurations to measure, and in which order to visit them.

The order is an open traveling-salesman path by nearest neighbors and 2-opt (Croes
1958), where the way between two configurations is the largest joint movement, which
sets the time. A move that is blocked counts as very long; whether one is blocked is
asked only for moves of the path that stands, because asking is expensive.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from calib_pin.compiled.threads import serial_blas
from calib_pin.errors import OptionError, require_known
from calib_pin.estimation.formulation import Stated, setup_of
from calib_pin.estimation.identifiability import Structure
from calib_pin.estimation.problem import Problem
from calib_pin.kinematics.chains import Robots
from calib_pin.kinematics.collision import Collisions
from calib_pin.kinematics.spatial import Floats
from calib_pin.kinematics.turns import TURN
from calib_pin.observations import BlockKey, Indices, Measurements, Observations
from calib_pin.parameterizations import frame_pose
from calib_pin.planning.criteria import CRITERIA, Prediction
from calib_pin.planning.planned_problem import (
    Predicted,
    TipTests,
    assumed_tools,
    identification,
    planned_keys,
    planned_problem,
    predict,
)
from calib_pin.planning.rows import IdentificationRows
from calib_pin.planning.search import METHODS, Design, Progress, Search
from calib_pin.planning.workspace import (
    TIDY,
    Aim,
    Aims,
    Candidates,
    Workspace,
    require_plannable,
)
from calib_pin.solvers import Status
from calib_pin.validation.assessment import estimates, robot_errors
from calib_pin.validation.result import CoupledGroup, ParameterEstimate, Printed
from calib_pin.validation.tool_accuracy import SAMPLES

ROUNDS = 30
"""Times that a path with blocked moves is improved anew."""

SAME = 1e-9
"""Relative change of the information of a configuration, and gain in length of a path
[rad, m], up to which it is the same."""


def visits(
    workspace: Workspace,
    rows: IdentificationRows,
    q: Floats,
    aim: Indices,
    start: Floats | None,
) -> tuple[Floats, Indices, tuple[int, ...]]:
    """Configurations in an order of short travel, joints in their middle turn.

    Joints are turned only where nothing that is estimated depends on it: a gear's gain
    does.

    Args:
        workspace: The configurations that may be measured.
        rows: What is measured at a configuration.
        q: The configurations, shape (K, n) [rad, m].
        aim: What is measured at each, shape (K,).
        start: Where the robot stands before the first, shape (n,).

    Returns:
        Configurations and aims in the order of visits, and the places in it to which
        the straight move is blocked.
    """
    chains, collisions = workspace.problem.chains, workspace.collisions
    is_free = None if collisions is None else collisions.move_is_free
    # Joints that others do not follow, and that follow none.
    tied = {*chains.mimics, *(mimic.leader for mimic in chains.mimics.values())}
    free = chains.revolute & [name not in tied for name in chains.joints]
    middle = 0.5 * (workspace.lower + workspace.upper)
    turned = q - np.where(free, np.round((q - middle) / TURN), 0.0) * TURN
    if _duplicates(rows, turned, q, aim) and workspace.inside(turned, aim).all():
        q = turned
    # A tool is mounted and an instrument placed only once.
    places: dict[tuple[str, ...], list[int]] = {}
    for k, index in enumerate(aim):
        places.setdefault(workspace.aims.each[index].key[1:], []).append(k)
    order, closed, ahead = np.empty(0, np.intp), tuple[int, ...](), start
    for members in map(np.array, places.values()):
        path, shut = shortest_order(q[members], ahead, is_free)
        closed += tuple(len(order) + place for place in shut)
        order = np.concatenate([order, members[path]])
        ahead = q[order[-1]]
    return q[order], aim[order], closed


def _duplicates(rows: IdentificationRows, a: Floats, b: Floats, aim: Indices) -> bool:
    """Whether configurations tell the same, each (K, n)."""
    first, second = rows.rows(a, aim), rows.rows(b, aim)
    # Rows of the same information may differ by a rotation.
    G, H = (np.swapaxes(R, 1, 2) @ R for R in (first, second))
    return bool(np.abs(G - H).max(initial=0.0) <= SAME * np.abs(G).max(initial=1.0))


def shortest_order(
    q: Floats,
    start: Floats | None = None,
    is_free: Callable[[Floats, Floats], bool] | None = None,
) -> tuple[NDArray[np.intp], tuple[int, ...]]:
    """Order configurations for short travel.

    Args:
        q: Configurations, shape (K, n) [rad, m].
        start: Where the robot stands before the first, shape (n,).
        is_free: Whether the straight move between two configurations is free.

    Returns:
        The order, shape (K,), and the places in it to which the move is blocked, the
        one from `start` included.

    Examples:
        >>> order, _ = shortest_order(np.array([[0.0], [2.0], [1.0], [3.0]]))
        >>> order.tolist() in ([0, 2, 1, 3], [3, 1, 2, 0])
        True
    """
    places = q if start is None else np.concatenate([start[None], q])
    distances = np.abs(places[:, None] - places[None]).max(axis=2)
    fixed = 0 if start is None else 1
    path = _improved(_nearest_neighbors(distances), distances, fixed)
    closed: list[int] = []
    if is_free is not None:
        known: dict[tuple[int, int], bool] = {}
        long = len(path) * float(distances.max())  # Than any way of free moves.
        latest, closed = path, list(range(len(path)))
        for _ in range(ROUNDS):
            moves = [(min(move), max(move)) for move in pairwise(latest)]
            fresh = [move for move in moves if move not in known]
            known |= {(a, b): not is_free(places[a], places[b]) for a, b in fresh}
            blocked = [k for k, move in enumerate(moves, 1) if known[move]]
            if len(blocked) < len(closed):
                path, closed = latest, blocked
            longer = [move for move in fresh if known[move]]
            if not longer:
                break
            for a, b in longer:
                distances[a, b] = distances[b, a] = long
            latest = _improved(latest, distances, fixed)
    order = np.array([place - fixed for place in path[fixed:]], np.intp)
    return order, tuple(k - fixed for k in closed)


def _nearest_neighbors(distances: Floats) -> list[int]:
    """A path from the first place that goes on to the nearest one."""
    path, unvisited = [0], np.arange(len(distances)) > 0
    while unvisited.any():
        path.append(int(np.where(unvisited, distances[path[-1]], np.inf).argmin()))
        unvisited[path[-1]] = False
    return path


def _improved(path: list[int], distances: Floats, fixed: int) -> list[int]:
    """Reverse parts of a path as long as that makes it shorter (2-opt)."""
    count = len(path)
    # A place without distance, at both ends, stands for the open ends.
    closed = np.zeros((len(distances) + 1, len(distances) + 1))
    closed[:-1, :-1] = distances
    tour = np.array([len(distances), *path, len(distances)])
    improved = True
    while improved:
        improved = False
        for i in range(1 + fixed, count):
            # Reverse tour[i .. j].
            j = np.arange(i + 1, count + 1)
            before, first = tour[i - 1], tour[i]
            change = closed[before, tour[j]] + closed[first, tour[j + 1]]
            change -= closed[before, first] + closed[tour[j], tour[j + 1]]
            k = int(change.argmin())
            if change[k] < -SAME:
                tour[i : j[k] + 1] = tour[i : j[k] + 1][::-1].copy()
                improved = True
    return [int(place) for place in tour[1:-1]]


CRITERION_NAMES = (*CRITERIA, "prediction")
"""Names of all criteria."""

RANDOM_SETS = 25
"""Random sets that a plan is compared with."""


@dataclass(frozen=True)
class Step:
    """The value that a number of configurations reaches.

    Attributes:
        count: Number of planned configurations.
        value: Value of the criterion.
        position: Predicted root-mean-square error of the tip [m].
    """

    count: int
    value: float
    position: float


@dataclass(frozen=True, repr=False)
class Plan(Printed):
    """Configurations to measure, and what they will tell.

    Attributes:
        problem: The problem at nominal geometry, without measurements.
        q: Configurations in the order in which to visit them, shape (K, n) [rad, m];
            those of one chain, station and tool after one another.
        aims: What is measured at each.
        criterion: Name of the criterion.
        value: Its value for the set, with the measurements made before.
        random: Its median over random sets of the same size.
        method: The method that found the set.
        status: How the search ended.
        steps: The criterion against the number of configurations: below K the best
            part of the set, above it with candidates added.
        measured: Number of measurements made before.
        candidates: Number of candidates.
        tried: Number of configurations that were tried for them.
        blocked: Places of the configurations, from 0, to which a straight line in the
            joints does not lead from the one before without a collision; None where
            collisions are not checked.
        unmeasurable: Targets that no configuration can measure.
        assumed_tool: Whether the target's place on the tool is assumed.
        predicted: The expected calibration result.
        parameters: Predicted standard deviations of the parameters.
        groups: Those of the coupled groups.
    """

    problem: Problem = field(metadata={"key": None})
    q: Floats = field(metadata={"key": "configurations"})
    aims: tuple[Aim, ...] = field(metadata={"key": None})
    criterion: str = field(metadata={"key": "criterion.name"})
    value: float = field(metadata={"key": "criterion.value"})
    random: float
    method: str
    status: Status
    steps: tuple[Step, ...]
    measured: int
    candidates: int
    tried: int
    blocked: tuple[int, ...] | None = field(metadata={"key": None})
    unmeasurable: tuple[str, ...]
    assumed_tool: bool
    predicted: Predicted
    parameters: tuple[ParameterEstimate, ...] = field(
        metadata={"key": "predicted.parameters"}
    )
    groups: tuple[CoupledGroup, ...] = field(metadata={"key": "predicted.coupled"})

    @property
    def target(self) -> tuple[str, ...]:
        """Target of each configuration; empty where all that are seen count."""
        return tuple(aim.target for aim in self.aims)

    @property
    def places(self) -> Mapping[str, tuple[str, ...]]:
        """Chain, station and tool of each configuration, those that have a name."""
        keys = [aim.key for aim in self.aims]
        columns = {
            "chain": tuple(key.chain for key in keys),
            "station": tuple(key.station for key in keys),
            "tool": tuple(key.tool for key in keys),
        }
        return {name: column for name, column in columns.items() if any(column)}


@serial_blas
def plan(
    chain: Robots,
    model: str | Sequence[BlockKey],
    count: int,
    setup: Stated = None,
    *,
    criterion: str = "prediction",
    method: str = "auto",
    measured: Measurements | Observations | None = None,
    collisions: Collisions | None = None,
    candidates: int = 1000,
    tests: Floats | None = None,
    seed: int = 0,
    progress: Progress | None = None,
) -> Plan:
    """Plan which configurations to measure.

    Args:
        chain: The nominal chain, or several.
        model: Name of the measurement model, or the blocks that are measured, each by
            an instrument at a station that looks at a tool on a chain. Those of one
            chain, station and tool measure together.
        count: Number K of configurations, of all chains together.
        setup: Estimated and known quantities, limits, region, noise.
        criterion: `condition`, `O1` to `O5`, or `prediction`.
        method: One of `search.METHODS`.
        measured: Measurements that are there already; the plan adds to them, about
            the frames that they show.
        collisions: Collisions to avoid.
        candidates: Number of quasi-random configurations to choose from.
        tests: Configurations at which the tip is to be accurate, shape (N, n)
            [rad, m]; default candidates from all of the workspace. Of several chains
            the mean counts.
        seed: Random seed.
        progress: Told the stage and the part of it that is done, 0 to 1; returns True
            to stop with the best set so far.

    Raises:
        OptionError: If a name does not exist, or the request cannot be met: limits
            that cross, or too few configurations.
        InputError: If no configuration may be measured.

    Examples:
        >>> import calib_pin
        >>> chain = calib_pin.load_chain("space6")
        >>> plan = calib_pin.plan(chain, "position", 12, method="exchange")
        >>> plan.q.shape, plan.value < plan.random
        ((12, 6), True)
    """
    setup = setup_of(setup)
    require_known("criterion", criterion, CRITERION_NAMES)
    require_known("method", method, METHODS)
    for name, number in (("count", count), ("candidates", candidates)):
        if number < 1:
            raise OptionError(f"{name} is too small", value=number, allowed="1 or more")
    rng = np.random.default_rng(seed)
    data = None if measured is None else Observations.of(measured)
    keys = planned_keys(model, data)
    require_plannable(keys)
    problem = planned_problem(chain, keys, setup, data)
    assumed = assumed_tools(problem) if data is None else set()
    # The region is that of the tip, until somebody says where the target sits.
    points = {
        key: frame_pose(term.frames.end) * term.frames.offset
        for key, term in problem.terms.items()
        if term.frames.tool in assumed
    }
    aims = Aims.of(problem, keys)
    workspace = Workspace.create(problem, collisions, aims, points)
    # However few are to choose from, all that may be measured shows the structure.
    wanted = max(candidates, count, SAMPLES)
    spread = workspace.candidates(wanted, rng, progress, count)
    if len(spread.q) < count:
        raise OptionError(
            f"{len(spread.q)} of the tried configurations may be measured, fewer than "
            f"the {count} wanted",
            allowed="fewer configurations, or wider limits",
        )
    # A part of an even spread is one too.
    first = slice(max(candidates, count))
    pool = Candidates(spread.q[first], spread.aim[first], spread.drawn[first])
    structure, rows, known = identification(problem, workspace.aims, spread, data)
    at = TipTests.of(rows, spread, tests)
    search = Search(
        rows,
        workspace,
        Prediction(at.position) if criterion == "prediction" else CRITERIA[criterion],
        known,
        pool,
        count,
        rng,
        progress,
        measured=0 if data is None else len(data),
    )
    best = search.run(method)
    return _finished(search, best, structure, at, data)


def sides_of(plan: Plan) -> Mapping[str, tuple[int, ...]]:
    """Side from which each joint shall come to each configuration, by joint.

    Nothing where that makes no difference.
    """
    columns = zip(*(aim.side for aim in plan.aims), strict=True)
    return dict(zip(plan.problem.chains.joints, columns, strict=False))


def _finished(
    search: Search,
    best: Design,
    structure: Structure,
    tests: TipTests,
    measured: Observations | None,
) -> Plan:
    """Order a set and say what it will tell."""
    workspace, rows = search.workspace, search.rows
    problem = rows.problem
    start = None if measured is None else measured.q[measured.in_order[-1]]
    q, aim, closed = visits(workspace, rows, best.q, best.aim, start)
    q = _rounded(workspace, q, aim)

    assert workspace.inside(q, aim).all(), "methods only end in allowed sets"
    information = search.information(rows.rows(q, aim))
    assert information is not None, "the search only ends in sets that determine all"
    rng = np.random.default_rng(0)  # A generator that nothing shares.
    size, count = len(search.candidates.q), search.count
    draws = (rng.choice(size, count, replace=False) for _ in range(RANDOM_SETS))
    predicted = predict(information, rows.basis, tests, problem.parameters)
    errors = robot_errors(problem, structure, predicted)
    predicted = replace(predicted, robot_errors=errors)
    parameters, groups = estimates(problem.parameters, structure, predicted)
    return Plan(
        problem=problem,
        q=q,
        aims=tuple(workspace.aims.each[k] for k in aim),
        criterion=search.criterion.name,
        value=search.criterion.value(information, search.measured + len(q)),
        random=float(np.median([search.selection(subset).value for subset in draws])),
        method=best.method,
        status=best.status,
        steps=_steps(search, best, tests),
        measured=search.measured,
        candidates=len(search.candidates.q),
        tried=search.candidates.tried,
        blocked=None if workspace.collisions is None else closed,
        unmeasurable=workspace.unmeasurable(search.candidates),
        assumed_tool=measured is None and bool(assumed_tools(problem)),
        predicted=predicted,
        parameters=parameters,
        groups=groups,
    )


def _rounded(workspace: Workspace, q: Floats, aim: Indices) -> Floats:
    """Positions as people write them, where these are allowed."""
    tidy = np.clip(np.round(q * TIDY) / TIDY, workspace.lower, workspace.upper)
    tidy = workspace.settled(tidy, aim)
    return np.where(workspace.inside(tidy, aim)[:, None], tidy, q)


def _steps(search: Search, best: Design, tests: TipTests) -> tuple[Step, ...]:
    """The criterion against the number of configurations.

    Members leave the set one by one, each time the one whose loss costs least; then
    the best candidates join it until it has doubled.
    """
    rows = search.rows.rows(best.q, best.aim)
    table = np.concatenate([rows, search.table])
    members = tuple(range(len(rows)))
    tip = Prediction(tests.position)
    subset = search.selection(members, table)

    def step() -> Step:
        information, size = search.information(table[subset.chosen]), len(subset.chosen)
        position = np.inf if information is None else tip.value(information, size)
        return Step(size, subset.value, position)

    steps = [step()]
    while subset.chosen:
        subset.remove(subset.best_to_remove()[0])
        if not np.isfinite(subset.cost):
            break
        steps.insert(0, step())
    subset.reset(list(members))
    more = min(len(rows), len(search.table))
    for k in range(more):
        # Who stops the search does not want to wait for what more would bring.
        if search.report("table", k / more):
            break
        subset.add(subset.best_to_add()[0])
        steps.append(step())
    return tuple(steps)
