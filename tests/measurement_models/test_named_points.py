"""Positions of several named points on the tool (Wu et al., partial poses)."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

import calib_pin
from calib_pin.errors import InputError
from calib_pin.estimation.formulation import make_problem
from calib_pin.kinematics.spatial import Floats
from calib_pin.measurement_models import measurement_model
from calib_pin.measurement_models.position import Position
from calib_pin.observations import Measurements
from calib_pin.setup import PointSetup, Setup
from tests.shared import refused, rows_of

ARM = calib_pin.load_chain("space6")
BASE = pin.exp6(np.array([1.0, -2.0, 0.5, 0.3, 2.0, -1.0]))
TOOL = pin.exp6(np.array([0.02, -0.05, 0.12, 0.4, -0.3, 0.2]))
XYZ = {"a": (0.05, 0.08, 0.12), "b": (-0.06, 0.03, 0.1), "c": (0.02, -0.07, 0.15)}
STATED = {name: PointSetup(xyz) for name, xyz in XYZ.items()}


def position(setup: Setup, *targets: str) -> Position:
    model = measurement_model("position", setup, targets)
    assert isinstance(model, Position)
    return model


def seen(
    names: tuple[str, ...], count: int = 24, tool: pin.SE3 = TOOL
) -> tuple[Floats, Measurements]:
    """Tip poses and exact rows that look at points in turn; empty for the origin."""
    F = ARM.poses(ARM.random_configurations(count, np.random.default_rng(0)))
    target = tuple(names[k % len(names)] for k in range(count))
    points = np.array([XYZ.get(name, (0.0, 0.0, 0.0)) for name in target])
    T = BASE.homogeneous @ F @ tool.homogeneous
    values = np.einsum("nij,nj->ni", T[:, :3, :3], points) + T[:, :3, 3]
    return F, rows_of("position", values, *target)


def located(model: Position) -> Floats:
    return np.array([point.xyz for point in model.points])


# The rows.


def test_points_by_hand() -> None:
    model = position(Setup(targets=STATED))
    T = np.tile(
        pin.exp6(np.array([1.0, 2.0, 3.0, 0, 0, np.pi / 2])).homogeneous, (2, 1, 1)
    )
    origin = T[0, :3, 3]
    values = model.predict(T, np.zeros(9), ("a", "c"))
    # A quarter of a turn about z: x becomes y.
    expected = np.array([[-0.08, 0.05, 0.12], [0.07, 0.02, 0.15]]) + origin
    np.testing.assert_allclose(values, expected, atol=1e-13)
    instrument = np.array([0, 0, 0, 0, 0, 0, 0.1, 0.2, 0.3])
    moved = model.predict(T, instrument, ("a", "c")) - values
    np.testing.assert_allclose(moved, [[0, 0, 0], [-0.2, 0.1, 0.3]], atol=1e-13)
    names = [p.name for p in model.parameters]
    assert names[:4] == ["a.target.x", "a.target.y", "a.target.z", "b.target.x"]


def test_which_points_there_are() -> None:
    setup = Setup(targets=STATED)
    assert position(setup).targets == ("a", "b", "c")
    # Only those that rows name, and the origin where one names none.
    assert position(setup, "c", "a").targets == ("c", "a")
    assert position(setup, "b", "").targets == ("", "b")
    assert position(setup, "").targets == () and position(Setup()).targets == ()
    # Nobody has stated these.
    free = position(Setup(), "left", "right")
    assert [point.name for point in free.points] == ["left", "right"]
    assert free.missing
    some = position(Setup(targets={**STATED, "b": PointSetup()}))
    assert "'b'" in some.missing and "'a'" not in some.missing


@pytest.mark.parametrize("known", ["", "a"])
def test_unknown_points_hide_the_tool(known: str) -> None:
    """Where the tool frame is means nothing where no point is known in it."""
    assert position(Setup()).sees_tool
    targets = {
        name: replace(STATED[name], estimate=False if name == known else None)
        for name in "ab"
    }
    setup = Setup(targets=targets)
    assert position(setup).sees_tool == bool(known)
    _, data = seen(tuple(targets), 3)
    data = replace(data, joints=ARM.joints, q=np.zeros((3, 6)))
    parameters = make_problem(ARM, data, setup).parameters
    tool = [name.startswith("tool.frame.") for name in parameters.names]
    assert set(parameters.free[tool]) == {bool(known)}


def test_rows_of_an_unknown_point() -> None:
    _, data = seen(("a", "b"), 4)
    model = position(Setup(targets=STATED), *data.target)
    for name in ("bb", ""):
        with refused(InputError, file="m.csv", line=4, column="target"):
            model.names(("a", "b", name, "a"), data)


# Registration.


@pytest.mark.parametrize("base", [None, BASE])
def test_unknown_points_are_registered_in_the_tip(base: pin.SE3 | None) -> None:
    F, data = seen(("a", "b", "c"))
    model = position(Setup(), *data.target)
    found, found_base, tool = model.register(F, data, base, None)
    np.testing.assert_allclose(found_base.homogeneous, BASE.homogeneous, atol=1e-11)
    assert tool == pin.SE3.Identity()
    expected = [TOOL.act(np.array(xyz)) for xyz in XYZ.values()]
    np.testing.assert_allclose(located(found), expected, atol=1e-11)


@pytest.mark.parametrize("names", [("a", "b", "c"), ("", "a", "b")])
@pytest.mark.parametrize("base", [None, BASE])
def test_known_points_show_the_tool(
    base: pin.SE3 | None, names: tuple[str, ...]
) -> None:
    F, data = seen(names)
    known = {name: PointSetup(XYZ[name], estimate=False) for name in names if name}
    model = position(Setup(targets=known), *data.target)
    found, found_base, tool = model.register(F, data, base, None)
    np.testing.assert_allclose(found_base.homogeneous, BASE.homogeneous, atol=1e-11)
    np.testing.assert_allclose(tool.homogeneous, TOOL.homogeneous, atol=1e-8)
    np.testing.assert_array_equal(located(found), located(model))
