"""DH errors read off a URDF are exact: compared with products of matrices A_i.

A robot is written as a URDF from a random table, with joint frames that do not follow
the convention, and with its root at either end or in the middle of the chain.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

from calib_pin.kinematics.spatial import Floats
from calib_pin.parameterizations import parameterization
from calib_pin.parameterizations.error_model import ErrorModel
from tests.shared import chain_of, joint, urdf_of

COMPONENTS = ("theta", "d", "a", "alpha", "beta")
H = np.pi / 2.0
X, Y, Z = np.eye(3)


def turn(axis: Floats, angle: float) -> pin.SE3:
    return pin.SE3(pin.exp3(angle * axis), np.zeros(3))


def shift(axis: Floats, length: float) -> pin.SE3:
    return pin.SE3(np.eye(3), length * axis)


@dataclass(frozen=True)
class Link:
    """One row of the table, and the kind of its joint."""

    theta: float
    d: float
    a: float
    alpha: float
    beta: float = 0.0
    kind: str = "revolute"

    def matrix(self, errors: Sequence[float] = (0.0,) * 5) -> pin.SE3:
        theta, d, a, alpha, beta = errors
        return (
            turn(Z, self.theta + theta)
            * shift(Z, self.d + d)
            * shift(X, self.a + a)
            * turn(X, self.alpha + alpha)
            * turn(Y, self.beta + beta)
        )

    def motion(self, q: float) -> pin.SE3:
        return shift(Z, q) if self.kind == "prismatic" else turn(Z, q)

    @property
    def sign(self) -> float:
        """Whether x is ours, towards the next axis, or along z_i x z_i+1 if they meet.

        A table may have it either way; a, alpha and beta change sign with it.
        """
        return float(np.sign(self.a if self.a != 0.0 else np.sin(self.alpha)))

    @property
    def parallel(self) -> bool:
        return abs(np.sin(self.alpha)) < 0.05 and abs(self.beta) < 0.05


TABLES = {
    # A PUMA: parallel, intersecting and skew axes.
    "puma": [
        Link(0.3, 0.8, 0.1, -H),
        Link(-0.7, 0.0, 0.85, 0.0),
        Link(1.1, 0.15, 0.05, H),
        Link(0.2, 0.75, 0.0, -H),
        Link(0.5, 0.0, 0.0, H),
        Link(-0.4, 0.2, 0.03, 0.9),
    ],
    "skew": [
        Link(0.1, 0.3, -0.2, 0.7),
        Link(2.0, -0.1, 0.4, -1.9),
        Link(-1.0, 0.2, -0.3, 2.5),
        Link(0.6, 0.4, 0.1, -0.3),
    ],
    # Antiparallel, nearly parallel with a tilt about either axis, and sliding.
    "special": [
        Link(0.4, 0.0, 0.5, np.pi),
        Link(-0.3, 0.0, -0.4, 0.02, 0.01),
        Link(0.9, 0.3, 0.2, 1.2, kind="prismatic"),
        Link(0.2, 0.1, 0.3, -1.0),
        Link(-0.8, 0.0, 0.6, 0.0, kind="prismatic"),
        Link(0.0, 0.2, 0.1, 1.5),
    ],
    # The z axis of the tip is parallel to the last joint, as it is on most robots.
    "tip": [
        Link(0.4, 0.3, 0.5, 1.0),
        Link(-0.3, 0.4, 0.2, -1.0),
        Link(0.7, 0.25, 0.1, 0.0),
    ],
}


def tool_of(table: Sequence[Link]) -> pin.SE3:
    """From the last frame of the table to the tip, whose z axis stays the line."""
    return shift(Z, 0.0 if table[-1].parallel else 0.3) * turn(Z, 0.4)


def robot_of(table: Sequence[Link], backwards: int, rng: np.random.Generator) -> str:
    """URDF whose chain from `base` to `tip` passes the first joints backwards."""
    count = len(table)
    ends = [pin.SE3.Identity()]
    for link in table:
        ends.append(ends[-1] * link.matrix())
    # In base coordinates at zero; z of the table stays the axis, wherever it points
    # in the joint frame. Along it the origin may slide, but not before a parallel
    # link: there the origin of the joint says where Hayati's normal begins.
    links: dict[str, pin.SE3] = {"base": pin.SE3.Identity()}
    turned = [pin.SE3(pin.exp3(rng.normal(size=3)), np.zeros(3)) for _ in table]
    for k, link in enumerate(table):
        fixed = link.parallel and k < count - 1
        slide = 0.0 if fixed else rng.uniform(-0.5, 0.5)
        links[f"l{k}"] = ends[k] * shift(Z, slide) * turned[k]
    links["tip"] = ends[-1] * tool_of(table)
    links["middle"] = pin.exp6(rng.normal(size=6)) if backwards else links["base"]

    def between(name: str, parent: str, child: str, **more: Any) -> dict[str, Any]:
        placement = links[parent].actInv(links[child])
        return joint(name, f"{parent} {child}", placement, **more)

    up = [f"l{k}" for k in reversed(range(backwards))]
    down = [f"l{k}" for k in range(backwards, count)]
    joints = []
    for branch, end in ((up, "base"), (down, "tip")):
        for parent, child in zip(["middle", *branch], branch, strict=False):
            k = int(child[1:])
            axis = turned[k].rotation.T @ Z
            kind = {"kind": table[k].kind, "axis": axis}
            joints.append(between(f"j{k}", parent, child, **kind))
        last = branch[-1] if branch else "middle"
        joints.append(between(f"to_{end}", last, end, kind="fixed"))
    return urdf_of(*joints)


@pytest.mark.parametrize("name", TABLES)
@pytest.mark.parametrize(
    ("member", "backwards"), [("dh", 0), ("dh", 2), ("dh-full", 2), ("dh", 3)]
)
def test_errors_are_those_of_the_matrices(
    member: str, backwards: int, name: str
) -> None:
    table = TABLES[name]
    count = len(table)
    rng = np.random.default_rng(count)
    chain = chain_of(robot_of(table, backwards, rng), "base", "tip")
    assert chain.joints == tuple(f"j{k}" for k in range(count))
    assert chain.reversed.sum() == backwards
    model = ErrorModel.create(chain, [member])

    errors, values = rng.normal(size=(count, 5)) * 0.1, {}
    for k, link in enumerate(table):
        beta = link.parallel and k < count - 1
        if member == "dh":
            errors[k, 1 if beta else 4] = 0.0
        signs = np.array([1.0, 1.0, *3 * [link.sign]])
        for component, value in zip(COMPONENTS, signs * errors[k], strict=True):
            if value != 0.0:
                values[f"j{k}.dh.{component}"] = value
    assert len(model.parameters) == 12 + count * (4 if member == "dh" else 5)
    theta = model.parameters.vector(values)

    q = rng.uniform(-2.0, 2.0, (4, count))
    for row, found in zip(q, model.poses(q, theta), strict=True):
        expected = pin.SE3.Identity()
        for k, link in enumerate(table):
            sense = -1.0 if k < backwards else 1.0
            expected *= link.motion(sense * row[k]) * link.matrix(errors[k])
        expected *= tool_of(table)
        np.testing.assert_allclose(found, expected.homogeneous, rtol=0, atol=1e-12)


@pytest.mark.parametrize("backwards", [0, 2, 6])
def test_beta_takes_the_place_of_d_before_a_parallel_axis(backwards: int) -> None:
    table = [
        Link(0.0, 0.0, 0.3, np.radians(2.8)),
        Link(0.0, 0.0, 0.3, np.radians(2.9)),
        Link(0.0, 0.0, 0.3, np.radians(178.0)),
        Link(0.0, 0.0, 0.3, 0.0, np.radians(-2.0)),
        Link(0.0, 0.2, 0.0, H),
        # The line behind the last joint is the z axis of the tip.
        Link(0.0, 0.0, 0.1, 0.0),
    ]
    urdf = robot_of(table, backwards, np.random.default_rng(0))
    screws = parameterization("dh").screws(chain_of(urdf, "base", "tip"))
    names = {screw.parameter.name for screw in screws}
    for k, beta in enumerate([True, False, True, True, False, False]):
        owned = {c for c in COMPONENTS if f"j{k}.dh.{c}" in names}
        assert owned == set(COMPONENTS) - {"d" if beta else "beta"}


@pytest.mark.parametrize("x", [(1, 0, 0), (0, 0, 1), (1, 1, 1), (1, 1, -1)])
@pytest.mark.parametrize("axis", [(0, 0, 1), (1, 1, 1)])
def test_coinciding_axes(axis: tuple[float, ...], x: Any) -> None:
    # Nothing says where x is where two axes coincide. The x axis of the tip settles
    # it, unless it is that axis itself.
    tip = pin.SE3(pin.Quaternion.FromTwoVectors(X, np.array(x, float)), np.zeros(3))
    one = joint("one", "a b", axis=axis)
    two = joint("two", "b c", shift(np.array(axis), 0.2), axis)
    urdf = urdf_of(one, two, joint("end", "c d", tip, kind="fixed"))
    for member in ("dh", "dh-full"):
        screws = parameterization(member).screws(chain_of(urdf))
        assert np.isfinite([screw.twist for screw in screws]).all()
        # theta, d, a, alpha and beta are independent motions.
        first = np.array([s.twist for s in screws if s.parameter.name[:3] == "one"])
        assert np.linalg.matrix_rank(first, tol=1e-6) == len(first)
