"""Places that bend row by row: screws with basis functions at any frame."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pinocchio as pin
import pytest

from calib_pin.io.urdf import load_chain
from calib_pin.kinematics.spatial import Floats, se3_exp, se3_left_jacobian
from calib_pin.observations.conditions import UNSTATED, Conditions
from calib_pin.parameterizations import BasisFunction, Screw
from calib_pin.parameterizations.error_model import ErrorModel, flexures, varying
from calib_pin.parameters import Parameter
from calib_pin.setup import Setup

ROBOTS = {
    "space6": (None, None),
    "example:talos_reduced": ("gripper_right_base_link", "gripper_left_base_link"),
}
KINDS = ("placement", "transmission", "compliance")


@dataclass(frozen=True, eq=False)
class Swing:
    """Some smooth functions of all joints."""

    count: int

    def __call__(self, q: Floats, conditions: Conditions = UNSTATED) -> Floats:
        mixed = np.cos(np.arange(q.shape[1] * self.count)).reshape(q.shape[1], -1)
        return np.asarray(np.sin(q @ mixed + np.arange(self.count)))


def bent(model: ErrorModel, nuisance: bool = False) -> ErrorModel:
    """The model with two screws that bend every one of its frames."""
    rng = np.random.default_rng(4)
    frames = [frame for frame in range(len(model.chain.joints) + 3) for _ in range(2)]
    functions = Swing(len(frames))
    own = [
        Screw(
            Parameter(f"frame{frame}.bend.{k}", "rad", 1e-2, nuisance=nuisance),
            frame,
            rng.normal(size=6),
            BasisFunction(functions, k),
        )
        for k, frame in enumerate(frames)
    ]
    inner = sorted([*model.screws[6:-6], *own], key=lambda screw: screw.frame)
    return replace(model, screws=(*model.screws[:6], *inner, *model.screws[-6:]))


def model_of(name: str, framed: Setup) -> ErrorModel:
    base, tip = ROBOTS[name]
    chain = load_chain(name, base=base, tip=tip)
    rng = np.random.default_rng(2)
    model = bent(ErrorModel.create(chain, KINDS, setup=framed))
    return model.with_frames(*(pin.exp6(rng.normal(size=6)) for _ in range(2)))


def some(model: ErrorModel, count: int = 4) -> tuple[Floats, Floats]:
    rng = np.random.default_rng(5)
    q = model.chain.random_configurations(count, rng)
    sizes = 10.0 * np.minimum(model.parameters.scales, 1e-2)
    return q, sizes * rng.normal(size=len(sizes))


def by_definition(model: ErrorModel, q: Floats, theta: Floats) -> Floats:
    """The same poses, each configuration by a chain of its own."""
    basis, found = model.basis(q), []
    column = {k: c for c, k in enumerate(varying(model))}
    for row in range(len(q)):
        twists = np.zeros((len(model.chain.joints) + 3, 6))
        for k in flexures(model):
            screw = model.screws[k]
            twists[screw.frame] += basis[row, column[k]] * theta[k] * screw.twist
        moved = model.joint_positions(q[row : row + 1], theta)
        products = [
            product * pin.exp6(twist)
            for product, twist in zip(model.corrections(theta), twists, strict=True)
        ]
        placements = [
            nominal * product
            for nominal, product in zip(
                model.chain.placements, products[1:-2], strict=True
            )
        ]
        F = pin.SE3(model.chain.poses(moved, placements)[0])
        ends = model.base * products[0], products[-2] * model.tool * products[-1]
        found.append((ends[0] * F * ends[1]).homogeneous)
    return np.array(found)


@pytest.mark.parametrize("name", ROBOTS)
def test_every_place_bends_behind_its_geometry(name: str, framed: Setup) -> None:
    model = model_of(name, framed)
    q, theta = some(model)
    expected = by_definition(model, q, theta)
    # Whatever the way to the poses.
    found = model.poses(q, theta), model.linearize(q, theta).T
    for T in (*found, model.kinematics(q, theta)[0]):
        np.testing.assert_allclose(T, expected, rtol=0, atol=1e-12)
    still = np.where(np.isin(np.arange(len(theta)), flexures(model)), 0.0, theta)
    assert np.abs(model.poses(q, still) - expected).max() > 0.01
    # The ends of the chain are no part of the robot.
    base, tool = np.zeros(len(theta)), theta.copy()
    for k, screw in enumerate(model.screws):
        base[k] = theta[k] if screw.frame == 0 else 0.0
        tool[k] = 0.0 if screw.frame in (0, len(model.chain.joints) + 2) else theta[k]
    plain = replace(model, base=pin.SE3.Identity(), tool=pin.SE3.Identity())
    np.testing.assert_allclose(
        model.tip_poses(q, theta), plain.poses(q, tool), rtol=0, atol=1e-12
    )


def test_a_screw_along_the_own_motion_is_a_joint_correction(framed: Setup) -> None:
    chain = load_chain("space6")
    corrected = ErrorModel.create(chain, KINDS, setup=framed)
    assert not len(flexures(corrected))
    # Only errors of the robot are beyond geometry.
    plain = ErrorModel.create(chain, ["placement"])
    assert not bent(plain).geometric and bent(plain, nuisance=True).geometric
    model = bent(corrected)
    assert len(flexures(model)) == 2 * (6 + 3)
    names = model.parameters.names
    kinds = {names[k].split(".")[1] for k in model.joint_corrections}
    assert kinds == {"transmission", "compliance"}
    assert {names[k].split(".")[1] for k in flexures(model)} == {"bend"}
    assert sorted([*flexures(model), *model.joint_corrections]) == list(varying(model))


def test_the_left_jacobian_is_the_derivative_of_the_exponential() -> None:
    rng = np.random.default_rng(0)
    for size in (0.0, 1e-4, 0.3, 0.6):
        twist, change = size * rng.normal(size=(20, 6)), rng.normal(size=(20, 6))
        J, step = se3_left_jacobian(twist), 1e-5
        ahead, behind = (se3_exp(twist + s * change) for s in (step, -step))
        found = [
            pin.log6(pin.SE3(a) * pin.SE3(b).inverse()).vector / (2.0 * step)
            for a, b in zip(ahead, behind, strict=True)
        ]
        expected = (J @ change[:, :, None])[:, :, 0]
        np.testing.assert_allclose(found, expected, rtol=0, atol=1e-9)
