"""A ball in sockets: where it is, what it shows, and what random poses would hide."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

from calib_pin.errors import InputError
from calib_pin.kinematics.spatial import Floats
from calib_pin.measurement_models import measurement_model
from calib_pin.measurement_models.fixed_point import FixedPoint
from calib_pin.measurement_models.references import Point
from calib_pin.observations import Measurements
from calib_pin.setup import PointSetup, Setup
from tests.shared import rows_of

CENTERS = {"s/0": (0.6, 0.3, 0.4), "s/1": (0.5, -0.2, 0.6), "t/0": (0.3, 0.5, 0.5)}
BALL = np.array([0.05, 0.08, 0.12])


def sockets(count: int, estimate: bool = True) -> dict[str, PointSetup]:
    names = list(CENTERS)[:count]
    return {name: PointSetup(CENTERS[name], estimate=estimate) for name in names}


def fixed_point(setup: Setup, *targets: str) -> FixedPoint:
    model = measurement_model("fixed-point", setup, targets)
    assert isinstance(model, FixedPoint)
    return model


def at_rest(
    tool: Floats, names: tuple[str, ...], base: pin.SE3 | None = None
) -> tuple[Floats, Measurements]:
    """Poses of a tip whose point rests in sockets, each from many sides."""
    rng = np.random.default_rng(0)
    base = base or pin.SE3.Identity()
    F = []
    for name in names:
        R = pin.exp3(rng.normal(size=3))
        center = base.actInv(np.array(CENTERS[name]))
        F.append(pin.SE3(R, center - R @ tool).homogeneous)
    return np.array(F), rows_of("fixed-point", np.zeros((len(names), 0)), *names)


# The rows.


def test_the_gap_by_hand() -> None:
    model = fixed_point(Setup(sockets=sockets(2)))
    stated = model.declaration
    assert stated.contact and model.width == 0 and not stated.external
    T = np.tile(np.eye(4), (2, 1, 1))
    T[:, :3, 3] = [[0.7, 0.3, 0.4], [0.5, -0.2, 0.4]]
    instrument, target = np.zeros(6), ("s/0", "s/1")
    data = rows_of("fixed-point", np.zeros((2, 0)), *target)
    # From the socket to the ball.
    gap = model.residual(T, instrument, data)
    np.testing.assert_allclose(gap, [[0.1, 0, 0], [0, 0, -0.2]], atol=1e-13)
    instrument[3:] = [0.0, 0.0, -0.2]
    gap = model.residual(T, instrument, data)
    np.testing.assert_allclose(gap, [[0.1, 0, 0], [0, 0, 0]], atol=1e-13)
    # Nothing is measured, so that there is nothing to predict or disturb.
    assert model.predict(T, instrument, target).shape == (2, 0)
    assert model.disturb(data.values, np.ones((2, 3))).shape == (2, 0)


def test_what_rows_can_name() -> None:
    two = {"red": PointSetup((0, 0, 0.1)), "blue": PointSetup((0, 0.1, 0))}
    setup = Setup(sockets=sockets(2), targets=two)
    assert fixed_point(setup).targets == (
        *("red@s/0", "blue@s/0"),
        *("red@s/1", "blue@s/1"),
    )
    assert fixed_point(setup, "s/0").targets == ("s/0", "s/1")
    model = fixed_point(Setup(), "red@s/0", "blue@s/9")
    assert [(p.name, p.kind) for p in (*model.points, *model.sites)] == [
        ("red", "target"),
        ("blue", "target"),
        ("s/0", "socket"),
        ("s/9", "socket"),
    ]
    _, data = at_rest(BALL, ("s/0", "s/1"))
    stated = fixed_point(setup, *data.target)
    with pytest.raises(InputError, match=r"m.csv:3: .*'s/11'"):
        stated.names(("s/0", "s/11"), data)
    with pytest.raises(InputError, match=r"m.csv:2: "):
        stated.names(("", "s/1"), data)


# Registration.


@pytest.mark.parametrize("base", [None, pin.exp6(np.full(6, 0.3))])
@pytest.mark.parametrize(
    ("ball", "known"), [(False, ()), (True, ("s/0",)), (False, ("s/0", "s/1"))]
)
def test_registration(ball: bool, known: tuple[str, ...], base: pin.SE3 | None) -> None:
    F, data = at_rest(BALL, ("s/0", "s/1") * 5, base)
    setup = Setup(
        sockets={
            name: PointSetup(CENTERS[name] if name in known else None)
            for name in ("s/0", "s/1")
        }
    )
    tool = pin.SE3(np.eye(3), BALL) if ball else None
    unregistered = fixed_point(setup, *data.target)
    model, found_base, found_tool = unregistered.register(F, data, base, tool)
    np.testing.assert_allclose(found_tool.translation, BALL, atol=1e-11)
    assert found_base == (base or pin.SE3.Identity())
    centers = [s.xyz for s in model.sites if isinstance(s, Point)]
    np.testing.assert_allclose(centers, list(CENTERS.values())[:2], atol=1e-11)
