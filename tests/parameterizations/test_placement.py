"""Placement errors against a URDF that has them; a joint offset is a shift of q."""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin
import pytest

from calib_pin.kinematics.spatial import Floats
from calib_pin.parameterizations.error_model import ErrorModel
from tests.shared import chain_of, joint, urdf_of

#  root -[fixed]- l0 -hip- l1 -knee- l2 -[fixed]- l3 -ankle- l4 -[fixed]- foot
#                 l1 -arm- hand
TREE = {
    "stand": ("root l0", "fixed"),
    "hip": ("l0 l1", "revolute"),
    "knee": ("l1 l2", "prismatic"),
    "shank": ("l2 l3", "fixed"),
    "ankle": ("l3 l4", "continuous"),
    "sole": ("l4 foot", "fixed"),
    "arm": ("l1 hand", "revolute"),
}
ENDS = [("root", "foot"), ("root", "l4"), ("foot", "root"), ("hand", "foot")]


def joints(seed: int) -> dict[str, dict[str, Any]]:
    rng = np.random.default_rng(seed)
    return {
        name: joint(name, ends, pin.exp6(rng.normal(size=6)), rng.normal(size=3), kind)
        for name, (ends, kind) in TREE.items()
    }


def product(amounts: Floats) -> pin.SE3:
    """Tx Ty Tz Rx Ry Rz."""
    result = pin.SE3.Identity()
    for k, amount in enumerate(amounts):
        result = result * pin.exp6(amount * np.eye(6)[k])
    return result


PLACEMENT = ("x", "y", "z", "rx", "ry", "rz")
LINK_TRANSFORM = ("mx", "my", "mz", "dx", "dy", "dz")


@pytest.mark.parametrize(
    ("kind", "base", "tip"),
    [
        *(("placement", *ends) for ends in ENDS),
        # Errors in the frame of the joint before each one in the tree.
        *(
            ("link-transform", *ends)
            for ends in (*ENDS, ("l1", "foot"), ("hand", "l1"))
        ),
    ],
)
def test_errors_of_the_geometry_are_exact(kind: str, base: str, tip: str) -> None:
    """Against a URDF that has them."""
    nominal, rng = joints(3), np.random.default_rng(4)
    chain = chain_of(urdf_of(*nominal.values()), base, tip)
    model = ErrorModel.create(chain, [kind])
    moved, values, owners = dict(nominal), {}, [*chain.joints]
    if kind == "link-transform" and chain.tip_joint:
        owners.append(chain.tip_joint)
        assert chain.tip_joint == "sole" and tip == "foot"
    for name in owners:
        amounts = rng.normal(size=6) * 0.2
        if kind == "placement":
            first, components = name, PLACEMENT
            true = nominal[name]["placement"] * product(amounts)
        else:
            # Behind a fixed joint, the first in the link frame of the joint before;
            # the stand belongs to the transform from the root to the hip.
            first = {"ankle": "shank", "hip": "stand"}.get(name, name)
            true, components = product(amounts), LINK_TRANSFORM
            true = true * nominal[first]["placement"]
        moved[first] = {**nominal[first], "placement": true}
        values |= {
            f"{name}.{kind}.{component}": amount
            for component, amount in zip(components, amounts, strict=True)
        }
    q = rng.uniform(-2, 2, (4, len(chain.joints)))
    expected = chain_of(urdf_of(*moved.values()), base, tip).poses(q)
    found = model.poses(q, model.parameters.vector(values))
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-13)


@pytest.mark.parametrize(("base", "tip"), ENDS)
def test_an_offset_is_a_shift_of_the_joint(base: str, tip: str) -> None:
    chain = chain_of(urdf_of(*joints(2).values()), base, tip)
    model = ErrorModel.create(chain, ["joint-offset"])
    rng = np.random.default_rng(1)
    q, shift = rng.uniform(-2, 2, (6, len(chain.joints))), rng.normal(size=6)
    shift = shift[: len(chain.joints)]
    names = [f"{joint}.joint-offset.q" for joint in chain.joints]
    assert model.parameters.names[6:-6] == tuple(names)
    units = [p.unit for p in model.parameters][6:-6]
    assert units == ["rad" if turns else "m" for turns in chain.revolute]
    theta = model.parameters.vector(dict(zip(names, shift, strict=True)))
    expected = chain.poses(q + shift)
    np.testing.assert_allclose(model.poses(q, theta), expected, rtol=0, atol=1e-12)
