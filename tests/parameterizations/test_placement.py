"""Placement errors against a URDF that has them; a joint offset is a shift of q."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

from calib_pin.io.urdf import load_chain
from calib_pin.kinematics.chain import Chain
from calib_pin.kinematics.spatial import Floats
from calib_pin.parameterizations import parameterization
from calib_pin.parameterizations.error_model import ErrorModel

UrdfOf = Callable[..., str]
ChainOf = Callable[..., Chain]

#  root -[fixed]- l0 -hip- l1 -knee- l2 -[fixed]- l3 -ankle- l4 -[fixed]- foot
#                 l1 -arm- hand
TREE = {
    "stand": ("root", "l0", "fixed"),
    "hip": ("l0", "l1", "revolute"),
    "knee": ("l1", "l2", "prismatic"),
    "shank": ("l2", "l3", "fixed"),
    "ankle": ("l3", "l4", "continuous"),
    "sole": ("l4", "foot", "fixed"),
    "arm": ("l1", "hand", "revolute"),
}
ENDS = [("root", "foot"), ("root", "l4"), ("foot", "root"), ("hand", "foot")]


def joints(seed: int) -> dict[str, dict[str, Any]]:
    rng = np.random.default_rng(seed)
    return {
        name: {
            "name": name,
            "parent": parent,
            "child": child,
            "type": kind,
            "placement": pin.exp6(rng.normal(size=6)),
            "axis": rng.normal(size=3),
        }
        for name, (parent, child, kind) in TREE.items()
    }


def product(amounts: Floats) -> pin.SE3:
    """Tx Ty Tz Rx Ry Rz."""
    result = pin.SE3.Identity()
    for k, amount in enumerate(amounts):
        result = result * pin.exp6(amount * np.eye(6)[k])
    return result


@pytest.mark.parametrize(("base", "tip"), ENDS)
def test_placement_is_exact(
    base: str, tip: str, urdf_of: UrdfOf, chain_of: ChainOf
) -> None:
    nominal = joints(1)
    chain = chain_of(urdf_of(*nominal.values()), base, tip)
    model = ErrorModel.create(chain, ["placement"])
    rng = np.random.default_rng(2)
    moved, values = dict(nominal), {}
    for name in chain.joints:
        amounts = rng.normal(size=6) * 0.2
        true = nominal[name]["placement"] * product(amounts)
        moved[name] = {**nominal[name], "placement": true}
        for component, amount in zip(
            ("x", "y", "z", "rx", "ry", "rz"), amounts, strict=True
        ):
            values[f"{name}.placement.{component}"] = amount
    q = rng.uniform(-2, 2, (4, len(chain.joints)))
    expected = chain_of(urdf_of(*moved.values()), base, tip).poses(q)
    found = model.poses(q, model.parameters.vector(values))
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-13)


# The joint before each one in the tree, whose frame the errors are expressed in.
@pytest.mark.parametrize(("base", "tip"), [*ENDS, ("l1", "foot"), ("hand", "l1")])
def test_link_transform_is_exact(
    base: str, tip: str, urdf_of: UrdfOf, chain_of: ChainOf
) -> None:
    nominal = joints(3)
    chain = chain_of(urdf_of(*nominal.values()), base, tip)
    model = ErrorModel.create(chain, ["link-transform"])
    rng = np.random.default_rng(4)
    moved, values = dict(nominal), {}
    owners = [*chain.joints, *([chain.tip_joint] if chain.tip_joint else [])]
    assert ("sole" in owners) == (tip == "foot")
    for name in owners:
        amounts = rng.normal(size=6) * 0.2
        # Behind a fixed joint, the first in the link frame of the joint before.
        first = {"ankle": "shank", "hip": "stand"}.get(name, name)
        true = product(amounts) * nominal[first]["placement"]
        moved[first] = {**nominal[first], "placement": true}
        for component, amount in zip(
            ("mx", "my", "mz", "dx", "dy", "dz"), amounts, strict=True
        ):
            values[f"{name}.link-transform.{component}"] = amount
    q = rng.uniform(-2, 2, (4, len(chain.joints)))
    expected = chain_of(urdf_of(*moved.values()), base, tip).poses(q)
    if base == "root":
        # The stand belongs to the transform from the root to the hip.
        assert "hip" in chain.joints
    found = model.poses(q, model.parameters.vector(values))
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-13)


def test_link_transform_of_the_paper(urdf_of: UrdfOf, chain_of: ChainOf) -> None:
    # T_i = (I + Delta) T_i0 to first order (Liu et al. 2022).
    nominal = joints(5)
    chain = chain_of(urdf_of(*nominal.values()), "root", "foot")
    model = ErrorModel.create(chain, ["link-transform"])
    m, d = np.random.default_rng(6).normal(size=(2, 3)) * 1e-6
    names = [f"knee.link-transform.{c}" for c in ("mx", "my", "mz", "dx", "dy", "dz")]
    values = dict(zip(names, [*m, *d], strict=True))
    correction = model.corrections(model.parameters.vector(values))[2]
    T = nominal["knee"]["placement"].homogeneous
    Delta = np.zeros((4, 4))
    Delta[:3, :3], Delta[:3, 3] = pin.skew(d), m
    found = T @ correction.homogeneous
    np.testing.assert_allclose(found, (np.eye(4) + Delta) @ T, rtol=0, atol=1e-11)


def test_link_transform_names_the_fixed_joint_of_the_tip(
    urdf_of: UrdfOf, chain_of: ChainOf
) -> None:
    urdf = urdf_of(*joints(1).values())
    member = parameterization("link-transform")
    assert [s.frame for s in member.screws(chain_of(urdf, "root", "foot"))[18:]] == (
        [4] * 6
    )
    assert len(member.screws(chain_of(urdf, "root", "l4"))) == 18
    # Its frame is that of the last joint: nothing of the sole is in a chain to it.
    assert len(member.screws(chain_of(urdf, "foot", "root"))) == 18


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
