"""The error model in the form that the kernels take.

    T(q, theta) = L_0(theta) Z_1(q_1) L_1(theta) ... Z_n(q_n) L_n(theta)

Z turns about z or shifts along it. Whatever stands between two joint motions becomes
one segment: constants multiplied together and moved to the left, and behind them the
screws of the parameters in their order, each transformed by the adjoint. Joints that a
chain traverses from child to parent have their sign in the motion and inverted screws.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TypeAlias

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from calib_pin.kinematics.spatial import Floats
from calib_pin.parameterizations import Screw
from calib_pin.parameterizations.error_model import ErrorModel, flexures
from calib_pin.parameterizations.linearization import ordered_screws

Factor: TypeAlias = "pin.SE3 | tuple[int, float]"
"""A constant, or a screw by its position with the sign it is applied with."""


@dataclass(frozen=True)
class Segments:
    """The segments of an error model with n joints and P parameters of its geometry.

    Joint corrections belong to the motions between them, not to a segment.

    Attributes:
        constants: Nominal links as rows of (R | p), shape (n + 1, 12).
        screws: Screws in the order they apply; `place` is the segment, 0..n, and the
            twist acts at its end.
        parameter: Parameter of each screw, shape (P,).
        signs: -1 for joints traversed from child to parent, else 1, shape (n,).
        revolute: True for joints that turn, shape (n,).
    """

    constants: Floats
    screws: tuple[Screw, ...]
    parameter: NDArray[np.int64]
    signs: Floats
    revolute: NDArray[np.bool_]

    @staticmethod
    def of(model: ErrorModel) -> Segments:
        """The segments of an error model without bends, see `compilable`."""
        if len(flexures(model)):
            raise ValueError("a segment cannot bend row by row")
        constants: list[pin.SE3] = []
        screws: list[Screw] = []
        order: list[int] = []
        for segment, factors in enumerate(_split(model)):
            # From the right: what stands behind a screw carries its twist along.
            behind = pin.SE3.Identity()
            found: list[tuple[int, Screw]] = []
            for factor in reversed(factors):
                if isinstance(factor, pin.SE3):
                    behind = factor * behind
                    continue
                k, sign = factor
                twist = behind.toActionMatrixInverse() @ model.screws[k].twist
                screw = replace(model.screws[k], frame=segment, twist=sign * twist)
                found.append((k, screw))
            constants.append(behind)
            order += [k for k, _ in reversed(found)]
            screws += [screw for _, screw in reversed(found)]
        chain = model.chain
        return Segments(
            constants=np.array([c.homogeneous[:3].reshape(-1) for c in constants]),
            screws=tuple(screws),
            parameter=np.array(order, np.int64),
            signs=np.where(chain.reversed, -1.0, 1.0),
            revolute=chain.revolute,
        )

    @cached_property
    def places(self) -> NDArray[np.int64]:
        """Segment of each screw, shape (P,)."""
        return np.array([screw.frame for screw in self.screws], np.int64)

    @cached_property
    def twists(self) -> Floats:
        """Twist of each screw, shape (P, 6)."""
        return np.array([screw.twist for screw in self.screws]).reshape(-1, 6)

    def links(self, theta: Floats) -> Floats:
        """Links of a population of parameter values, (S, P) -> (S, n + 1, 12)."""
        from calib_pin.compiled import link_kernels

        result = np.empty((len(theta), *self.constants.shape))
        link_kernels.links(
            self.constants, self.places, self.parameter, self.twists, theta, result
        )
        return result

    def columns(self, theta: Floats) -> Floats:
        """Body twists at the ends of all segments by parameter, shape (6 n + 6, P)."""
        count = len(self.constants)
        twists, _ = ordered_screws(self.screws, theta[self.parameter], count)
        result = np.zeros((6 * count, len(theta)))
        for k, (screw, column) in enumerate(zip(self.screws, twists.T, strict=True)):
            rows = slice(6 * screw.frame, 6 * screw.frame + 6)
            result[rows, self.parameter[k]] = column
        return result


def compilable(model: ErrorModel) -> bool:
    """Whether nothing but the joints' own motions changes row by row.

    Compiled kernels know corrections of these alone.
    """
    return model.learned is None and len(flexures(model)) == 0


def _split(model: ErrorModel) -> Iterator[list[Factor]]:
    """Factors of `T(q, theta)` from base to tool, split at the joint motions."""
    chain = model.chain
    at: list[list[int]] = [[] for _ in range(len(model.chain.joints) + 3)]
    for k, screw in enumerate(model.screws):
        if screw.basis is None:
            at[screw.frame].append(k)
    base, tip = chain.ends
    factors: list[Factor] = [model.base, *_applied(at[0]), base.inverse()]
    for i in range(len(chain.joints)):
        placement, screws = chain.placements[i], at[i + 1]
        align = _to_axis(chain.axes[i])
        if chain.reversed[i]:
            yield [*factors, align]
            inverted: list[Factor] = [(k, -1.0) for k in reversed(screws)]
            factors = [align.inverse(), *inverted, placement.inverse()]
        else:
            yield [*factors, placement, *_applied(screws), align]
            factors = [align.inverse()]
    yield [*factors, tip, *_applied(at[-2]), model.tool, *_applied(at[-1])]


def _applied(screws: list[int]) -> list[Factor]:
    return [(k, 1.0) for k in screws]


def _to_axis(axis: Floats) -> pin.SE3:
    """A rotation that takes z to a unit axis."""
    turn = np.cross([0.0, 0.0, 1.0], axis)
    sine = float(np.linalg.norm(turn))
    direction = turn / sine if sine > 1e-12 else np.array([1.0, 0.0, 0.0])
    return pin.SE3(pin.exp3(direction * np.arctan2(sine, axis[2])), np.zeros(3))
