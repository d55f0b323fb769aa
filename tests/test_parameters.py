"""Parameter sets: names found exactly or by glob, and never by substring."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np
import pytest

from calib_pin.errors import OptionError
from calib_pin.parameters import Parameter, ParameterSet

NAMES = (
    "base.frame.x",
    "joint1.placement.x",
    "joint1.placement.rx",
    "joint11.placement.x",
    "wrist[1].placement.x",
    "wall.plane.u",
)


def parameters() -> ParameterSet:
    return ParameterSet(
        tuple(
            Parameter(
                name,
                "m" if name.endswith("x") and not name.endswith("rx") else "rad",
                1.0 if ".placement." not in name else 1e-3,
                nuisance=".placement." not in name,
            )
            for name in NAMES
        )
    )


def test_arrays_stand_in_the_order_of_the_names() -> None:
    found = parameters()
    assert len(found) == len(NAMES)
    assert found.names == NAMES == tuple(p.name for p in found)
    assert found[3].name == NAMES[3]
    assert [found.index(name) for name in NAMES] == list(range(6))
    assert found.scales.tolist() == [1.0, 1e-3, 1e-3, 1e-3, 1e-3, 1.0]
    assert found.nuisance.tolist() == [True, False, False, False, False, True]
    assert found.free.all() and found.free.dtype == bool
    assert np.isinf(found.priors).all()
    lower, upper = found.bounds
    assert (lower == -np.inf).all() and (upper == np.inf).all()


def test_vector() -> None:
    values = {"joint11.placement.x": 2.0, "wall.plane.u": -1.0}
    assert parameters().vector(values).tolist() == [0, 0, 0, 2.0, 0, -1.0]
    empty = ParameterSet(())
    assert len(empty) == 0 and empty.names == ()
    assert empty.free.dtype == bool and empty.scales.shape == (0,)
    assert empty.vector({}).shape == (0,)


@pytest.mark.parametrize(
    "refused",
    [
        lambda p: p.vector({"joint1.placement.y": 1.0}),
        # No part of a name, and no glob.
        *(
            lambda p, n=name: p.index(n)
            for name in ("joint1", "placement.x", "joint1.placement.*")
        ),
        *(
            lambda p, n=name: p.with_fixed([n])
            for name in ("joint2.*", "JOINT1.*", "placement.x", "joint1", "")
        ),
        lambda p: p.with_bounds({"joint2.*": 1.0}),
        lambda p: p.with_priors({"joint2.*": 1.0}),
        # Bounds that exclude the nominal robot.
        *(
            lambda p, b=bound: p.with_bounds({"joint1.*": b})
            for bound in (-0.01, (0.1, 0.2), (-2.0, -1.0), np.nan)
        ),
        lambda p: ParameterSet((p[0], p[1], Parameter(p[0].name, "m", 2.0))),
    ],
)
def test_refusals(refused: Callable[[ParameterSet], object]) -> None:
    with pytest.raises(OptionError):
        refused(parameters())


@pytest.mark.parametrize(
    ("patterns", "held"),
    [
        ([], []),
        (["joint1.placement.x"], [1]),
        (["joint1.*"], [1, 2]),
        (["joint1*"], [1, 2, 3]),
        (["*.placement.x"], [1, 3, 4]),
        (["*.rx", "base.*"], [0, 2]),
        (["joint?.placement.x"], [1]),
        (["joint1[01].placement.x"], [3]),
        (["*"], [0, 1, 2, 3, 4, 5]),
        # A name is a name, whatever it would mean as a glob.
        (["wrist[1].placement.x"], [4]),
    ],
)
def test_fixed(patterns: list[str], held: list[int]) -> None:
    before = parameters()
    after = before.with_fixed(patterns)
    assert np.flatnonzero(~after.free).tolist() == held
    assert before.free.all()
    assert after.names == before.names
    # It adds to what was fixed before.
    assert not after.with_fixed(["wall.*"]).free[[*held, 5]].any()


def test_bounds_and_later_entries_win() -> None:
    found = parameters().with_bounds(
        {"*.placement.*": 0.01, "joint1.*": (-0.001, 0.002), "wall.plane.u": 0.0}
    )
    lower, upper = found.bounds
    assert lower.tolist() == [-np.inf, -0.001, -0.001, -0.01, -0.01, 0.0]
    assert upper.tolist() == [np.inf, 0.002, 0.002, 0.01, 0.01, 0.0]
    # Bounds can be taken back.
    again = found.with_bounds({"*": np.inf})
    assert (again.bounds[1] == np.inf).all()


def test_priors_and_later_entries_win() -> None:
    priors: Mapping[str, float] = {"*.placement.*": 0.002, "joint11.*": 0.5}
    found = parameters().with_priors(priors).priors
    assert found.tolist() == [np.inf, 0.002, 0.002, 0.5, 0.002, np.inf]
    free = parameters().with_priors(priors).with_priors({"joint11.*": np.inf})
    assert np.isinf(free.priors[3])
