"""A joint offset is a shift of q, exactly."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pinocchio as pin
import pytest

from calib_pin.io.urdf import load_chain
from calib_pin.kinematics.chain import Chain
from calib_pin.parameterizations.error_model import ErrorModel

CHAINS = [
    ("example:tiago_no_hand", None, "arm_7_link"),
    ("example:talos_reduced", "gripper_right_base_link", "gripper_left_base_link"),
    ("example:xarm7", "link7", "link_base"),
]


def assert_shift(chain: Chain) -> None:
    model = ErrorModel.create(chain, ["joint-offset"])
    rng = np.random.default_rng(1)
    q, shift = chain.random_configurations(5, rng), rng.normal(size=len(chain.joints))
    names = [f"{joint}.joint-offset.q" for joint in chain.joints]
    assert model.parameters.names[6:-6] == tuple(names)
    theta = model.parameters.vector(dict(zip(names, shift, strict=True)))
    expected = chain.poses(q + shift)
    np.testing.assert_allclose(model.poses(q, theta), expected, rtol=0, atol=1e-12)


@pytest.mark.parametrize(("robot", "base", "tip"), CHAINS)
def test_robots(robot: str, base: str | None, tip: str) -> None:
    assert_shift(load_chain(robot, base=base, tip=tip))


@pytest.mark.parametrize("ends", [("l0", "l4"), ("l4", "l0"), ("l4", "m1")])
def test_skew_axes_of_all_kinds(
    ends: tuple[str, str],
    urdf_of: Callable[..., str],
    chain_of: Callable[..., Chain],
) -> None:
    rng = np.random.default_rng(2)
    kinds = ["revolute", "prismatic", "continuous", "prismatic"]
    axes = [(1, 2, 3), (-3, 0.5, 1), (0, 0, -1), (0, -1, 0)]
    arm = [
        {
            "name": f"j{k}",
            "parent": f"l{k}",
            "child": f"l{k + 1}",
            "type": kind,
            "axis": axis,
            "placement": pin.exp6(rng.normal(size=6)),
        }
        for k, (kind, axis) in enumerate(zip(kinds, axes, strict=True))
    ]
    other = {"name": "k", "parent": "l0", "child": "m1", "axis": (2, 0, -1)}
    chain = chain_of(urdf_of(*arm, other), *ends)
    units = [p.unit for p in ErrorModel.create(chain, ["joint-offset"]).parameters]
    assert units[6:-6] == ["rad" if turns else "m" for turns in chain.revolute]
    assert_shift(chain)
