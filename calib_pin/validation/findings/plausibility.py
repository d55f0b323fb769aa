"""Whether a robot can be what a fit says it is.

A fit explains measurements by whatever its parameters can do: a known distance that is
misread makes every link longer, and errors that no parameter describes move a joint by
centimeters. Neither shows in the residuals, so the corrections themselves are judged.

All of it is read off one linearization at the solution. With what base, tool and
instrument can absorb projected out, the whitened measurements y depend on the scaled
errors x of the robot, and on the growth s of all of its lengths, by

    y = A x + g s + e,    e ~ N(0, sigma0^2 I)
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
import pinocchio as pin

from calib_pin.estimation.evidence import Finding
from calib_pin.estimation.fitted import Fit
from calib_pin.estimation.identifiability import projected
from calib_pin.estimation.nominal import growth
from calib_pin.estimation.problem import tool_points
from calib_pin.estimation.statistics.variance_components import sampled
from calib_pin.kinematics.spatial import Floats
from calib_pin.measurement_models import declared
from calib_pin.measurement_models.declaration import INSTRUMENT
from calib_pin.parameterizations import PARAMETERIZATIONS
from calib_pin.parameterizations.base import ANGLE_SCALE, LENGTH_SCALE
from calib_pin.setup import FrameSetup, Setup
from calib_pin.validation.findings.case import Case
from calib_pin.validation.findings.known_distances import (
    ROUNDING,
    SIGNIFICANT,
    contradicted,
)


@dataclass(frozen=True)
class PlausibilityOptions:
    """Limits of what a robot can be, and of what is looked at.

    Attributes:
        largest_growth: Part by which all lengths may be wrong before the trust
            goes. Real robots are right to 0.001. Errors that no parameter
            describes, 3 mrad of the gears seen by a draw-wire encoder within half
            a radian of one configuration, have passed for 0.009 in one of four cases,
            for up to 0.006 else.
        doubtful_growth: Part from which there is a warning.
        significant: Standard deviations from which a common scale, or a distance
            missed, is no chance. By chance one in 150 000 is. Of 20 robots with
            errors of 0.3 to 3 mm it finds 13 to 19 that are measured 1 % too large,
            and all that are 2 % too large. A real TIAGo comes out 0.8 % shorter, by
            3.5 deviations.
        large: Expected sizes of an error from which the correction of a joint is
            looked at.
        implausible: Expected sizes from which one that buys little takes the trust.
            A small set of a real TIAGo turns a joint by 15 for nothing, and does no
            harm.
        bought: By what factor the errors must grow when such a correction is made
            small again. A joint that is mounted askew grows them at least tenfold;
            where unmodeled errors of 3 to 10 mrad, seen by a draw-wire encoder from
            few configurations, had moved joints by 22 to 46 expected sizes, they grew
            1.6 to 3.3 times.
        measurements: Measurements that are looked at; more do not make it clearer.
        hidden: By what factor the movement of tool points by another scale may exceed
            the errors of the nominal robot, whose frames absorb a part of it.
    """

    largest_growth: float = 0.0075
    doubtful_growth: float = 0.004
    significant: float = SIGNIFICANT
    large: float = 10.0
    implausible: float = 25.0
    bought: float = 4.0
    measurements: int = 600
    hidden: float = 10.0


OPTIONS = PlausibilityOptions()

SIZES = np.geomspace(1.0, 100.0, 41)
"""Sizes of the robot's errors among which the likeliest is taken, in expected ones."""


def plausibility(case: Case) -> tuple[Finding, ...]:
    """Findings of what no real robot has; none without a whole fit.

    They are `scale`, `known-distance`, `implausible-correction`, `large-correction`.
    """
    fitted = case.fitted
    if fitted is None:
        return ()
    robot = fitted.problem.parameters.free & ~fitted.problem.parameters.nuisance
    if not robot.any() or fitted.dof <= 0 or not np.isfinite(fitted.theta).all():
        return ()
    linear = _Linear.of(fitted)
    grown = tuple(_scale(case, fitted, linear))
    return (
        # One wrong distance among several stretches the robot, too.
        *contradicted(fitted, case.fit.errors),
        *grown,
        # A robot that has grown has large corrections everywhere.
        *(() if grown else _corrections(case, fitted, linear)),
    )


@dataclass(frozen=True)
class _Linear:
    """The linearization at a solution, in principal axes of A.

    Attributes:
        s: Singular values of A, shape (k,).
        V: Right singular vectors of A, by all scaled parameters, shape (P, k).
        y: Measurements along the left ones, shape (k,).
        g: Growth along them, shape (k,).
        beside: Sums of squares and products that A cannot explain: of y, of g with y,
            and of g.
        sigma: Standard deviation of unit weight.
    """

    s: Floats
    V: Floats
    y: Floats
    g: Floats
    beside: tuple[float, float, float]
    sigma: float

    @staticmethod
    def of(fitted: Fit) -> _Linear:
        """That of a fit, without what expected sizes add to the measurements."""
        whole = fitted.problem
        some = sampled(whole, OPTIONS.measurements)
        problem = replace(whole, data=some, expected=None)
        parameters = problem.parameters
        robot = parameters.free & ~parameters.nuisance
        r, J = problem.linearize_rows(fitted.theta)
        g = np.zeros(len(r))
        g[: len(problem.sigma)] = growth(problem, fitted.theta)
        scaled = J * parameters.scales
        columns = np.column_stack([scaled[:, robot], g, r])
        columns = projected(columns, scaled, parameters)
        A, g, r = columns[:, :-2], columns[:, -2], columns[:, -1]
        y = A @ (fitted.theta / parameters.scales)[robot] - r
        U, s, Vt = np.linalg.svd(A, full_matrices=False)
        kept = s > 1e-9 * s.max(initial=0.0)
        U, s = U[:, kept], s[kept]
        V = np.zeros((len(parameters), len(s)))
        V[robot] = Vt[kept].T
        rest = np.column_stack([y, g])
        rest = rest - U @ (U.T @ rest)
        squares = rest.T @ rest
        return _Linear(
            s,
            V,
            U.T @ y,
            U.T @ g,
            (squares[0, 0], squares[0, 1], squares[1, 1]),
            # Exact measurements tell all, but for rounding.
            max(fitted.sigma0, 1e-6),
        )

    def growth(self) -> tuple[float, float, float]:
        """Estimated growth, its standard deviation, and size of the other errors.

        The errors x of a real robot are themselves scattered, by the size t that is
        likeliest; what grows must stand out from that: generalized least squares with
        the covariance sigma0^2 I + t^2 A A'.
        """
        best = (-np.inf, 0.0, np.inf, 1.0)
        for size in SIZES:
            variance = self.sigma**2 + (size * self.s) ** 2
            yy, gy, gg = np.array(self.beside) / self.sigma**2 + [
                np.sum(self.y**2 / variance),
                np.sum(self.g * self.y / variance),
                np.sum(self.g**2 / variance),
            ]
            if gg <= 0.0:
                break
            score = -0.5 * (np.log(variance).sum() + np.log(gg) + yy - gy**2 / gg)
            best = max(best, (score, gy / gg, gg**-0.5, size))
        return best[1:]

    def smaller(self, x: Floats, held: float) -> Floats:
        """Scaled errors near x of which a normal prior keeps what it can small.

        Ridge regression, by the standard deviation 1 / held of every error; along what
        the measurements do not tell there are none. x has the shape (P,).
        """
        shrunk = self.s * self.y / (self.s**2 + (held * self.sigma) ** 2)
        return np.asarray(x + self.V @ (shrunk - self.V.T @ x))

    def misfit(self, x: Floats) -> float:
        """Sum of squares that scaled parameters leave, shape (P,)."""
        return self.beside[0] + float(np.sum((self.y - self.s * (self.V.T @ x)) ** 2))


def _scale(case: Case, fitted: Fit, linear: _Linear) -> Iterator[Finding]:
    """All lengths longer or shorter by one factor, which no robot is."""
    if not fitted.structure.scaled:
        return  # Nothing tells the scale, which is worse and said elsewhere.
    s, deviation, size = linear.growth()
    # The derivative is that of the lengths found, which have grown already.
    part = s / (1.0 - s)
    if abs(s) < max(OPTIONS.doubtful_growth, OPTIONS.significant * deviation):
        return
    # Lengths that are so wrong would show in the errors of the nominal robot.
    spread = max(float(np.linalg.norm(np.std(p, axis=0))) for p in _points(fitted))
    if abs(s) * spread > OPTIONS.hidden * case.errors_nominal * LENGTH_SCALE:
        return
    longer = "longer" if part > 0.0 else "shorter"
    yield Finding(
        "scale",
        "error" if abs(s) > OPTIONS.largest_growth else "warning",
        f"all lengths of the robot came out {100 * abs(part):.2g} % {longer} "
        f"({abs(s) / deviation:.0f} standard deviations), which is implausible",
        {"scale": part, "sigma": deviation, "size": size},
        f"check {_yardstick(fitted)}",
    )


def _points(fitted: Fit) -> list[Floats]:
    """Tool points of every block of measurements, shape (N, 3)."""
    problem = replace(
        fitted.problem, data=sampled(fitted.problem, OPTIONS.measurements)
    )
    return tool_points(problem, fitted.theta)


def _yardstick(fitted: Fit) -> str:
    """The lengths on which the scale of these measurements rests."""
    problem = fitted.problem
    lengths = []
    if known := [d for d in problem.further.distances.stated if d.unit == "m"]:
        ends = " - ".join(known[0].between)
        more = ", ..." if len(known) > 1 else ""
        lengths.append(f"the known distance {ends}{more}")
    stated = dict.fromkeys(declared(model).yardstick for model in problem.data.models)
    # The setup states the others, and can be checked first.
    lengths += sorted(filter(None, stated), key=lambda words: words == INSTRUMENT)
    return ", ".join([*lengths, "the unit of the lengths in the URDF"])


def _corrections(case: Case, fitted: Fit, linear: _Linear) -> Iterator[Finding]:
    """The largest correction of a joint, where it is far larger than robots have.

    A wrong origin in the URDF, or a joint mounted askew, is as large; then the
    measurements insist on it. They do not where the errors hardly grow as all
    corrections are made smaller (ridge regression) until this one is of usual size.
    """
    parameters = fitted.problem.parameters
    x = fitted.theta / parameters.scales
    sizes = _sizes(fitted, x)
    if sizes.max() < OPTIONS.large:
        return
    factor = np.inf
    for held in 1.0 / SIZES[::-1]:
        smaller = linear.smaller(x, held)
        if _sizes(fitted, smaller).max() < OPTIONS.large:
            least = max(linear.misfit(x), ROUNDING)
            factor = float(np.sqrt(linear.misfit(smaller) / least))
            break
    place = int(np.argmax(sizes.max(axis=1)))
    expected = _expected_turn(case.setup)
    move, turn = sizes[place] * (LENGTH_SCALE, expected)
    chains = [term.error.chain for term in fitted.problem.by_chain.values()]
    names = [(*c.joints, c.tip_joint or c.tip) for c in chains]
    name = [name for of_chain in names for name in of_chain][place]
    said = (
        f"the origin of {name} came out moved by {1e3 * move:.1f} mm and "
        f"{np.degrees(turn):.2f} deg"
    )
    evidence: dict[str, float | str] = {"joint": name, "move": move, "turn": turn}
    if factor < OPTIONS.bought:
        yield Finding(
            "implausible-correction",
            "error" if sizes.max() > OPTIONS.implausible else "warning",
            f"{said}, although with no more than "
            f"{1e3 * OPTIONS.large * LENGTH_SCALE:.0f} mm and "
            f"{np.degrees(OPTIONS.large * expected):.1f} deg the remaining errors "
            f"are only {max(factor, 1.0):.2f} times as large",
            {**evidence, "errors_without": factor},
            "measure more configurations, or estimate fewer parameters",
        )
        return
    check = "check this origin in the URDF, and how the joint is mounted"
    left, joint, offset = _offset_within(
        case, x, lambda x: float(_sizes(fitted, x).max())
    )
    if left < OPTIONS.large:
        name = case.data.joints[joint]
        prismatic = not case.chains.revolute[case.chains.joints.index(name)]
        amount = (
            f"{1e3 * offset:.1f} mm" if prismatic else f"{np.degrees(offset):.2f} deg"
        )
        said = f"the zero of joint '{name}' came out moved by {amount}"
        evidence = {"joint": name, "move" if prismatic else "turn": offset}
        check = "check the mastering of this joint, and its origin in the URDF"
    elif any(frame.estimate is False for frame in _frames(case.setup, name, names)):
        check += ", and the frame that the setup states there"
    yield Finding(
        "large-correction",
        "warning",
        f"{said}, and the measurements confirm it",
        evidence,
        check,
    )


def _offset_within(
    case: Case, x: Floats, size: Callable[[Floats], float]
) -> tuple[float, int, float]:
    """The joint offset without which some errors of the robot are the smallest.

    What an offset turns, origins around it share, so that each looks smaller.

    Args:
        case: The case.
        x: Errors of the fit in their scales, shape (P,).
        size: The size of such errors.

    Returns:
        The size without it, the joint, and the offset [rad, m].
    """
    fit, parameters = case.fit, case.fit.problem.parameters
    free, robot = parameters.free, parameters.free & ~parameters.nuisance
    moves = fit.by_joints + fit.by_starts
    found = []
    spread = np.linalg.lstsq(fit.linear[1][:, free], moves, rcond=1e-9)[0]
    for joint, column in enumerate(spread.T):
        along = np.zeros(len(parameters))
        along[free] = column
        along[~robot] = 0.0
        offset = float(along @ x) / max(float(along @ along), 1e-300)
        found.append((size(x - offset * along), joint, offset))
    return min(found)


def _frames(
    setup: Setup, name: str, chains: Sequence[Sequence[str]]
) -> Sequence[FrameSetup]:
    """Frames that are stated at an origin, or one away, which shares its errors."""
    if any(name in origins[:2] for origins in chains):
        return (setup.base_frame, *setup.stations.values())
    if any(name in origins[-2:] for origins in chains):
        return (setup.tool_frame, *setup.tools.values())
    return ()


def _expected_turn(setup: Setup) -> float:
    """Expected turn of an origin [rad], that of the strictest of the families."""
    families = [PARAMETERIZATIONS[name] for name in setup.parameters]
    return min((f.turn for f in families if f.geometric), default=ANGLE_SCALE)


def _sizes(fitted: Fit, x: Floats) -> Floats:
    """Moves and turns of every joint's origin and the tip's, shape (n + 1, 2).

    In expected sizes, for scaled parameters x of shape (P,); chain by chain.
    """
    problem = fitted.problem
    theta, turn = x * problem.parameters.scales, _expected_turn(problem.setup)
    return np.array(
        [
            (
                np.linalg.norm(M.translation) / LENGTH_SCALE,
                np.linalg.norm(pin.log3(M.rotation)) / turn,
            )
            for term in problem.by_chain.values()
            for M in term.error.corrections(term.values(theta)[0])[1:-1]
        ]
    )
