"""Parameter sets: names found exactly or by glob, and never by substring."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np
import pytest

from calib_pin.errors import OptionError
from calib_pin.parameters import Parameter, ParameterSet, matching

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


def reason(call: Callable[[], object]) -> str:
    with pytest.raises(OptionError) as caught:
        call()
    return caught.value.reason


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


def test_empty_set() -> None:
    found = ParameterSet(())
    assert len(found) == 0 and found.names == ()
    assert found.free.dtype == bool and found.scales.shape == (0,)
    assert found.vector({}).shape == (0,)


def test_vector() -> None:
    values = {"joint11.placement.x": 2.0, "wall.plane.u": -1.0}
    assert parameters().vector(values).tolist() == [0, 0, 0, 2.0, 0, -1.0]
    text = reason(lambda: parameters().vector({"joint1.placement.y": 1.0}))
    assert "no parameter 'joint1.placement.y'" in text
    assert "did you mean 'joint1.placement.x'?" in text


def test_index_is_exact() -> None:
    assert parameters().index("joint1.placement.x") == 1
    for name in ("joint1", "joint1.placement", "placement.x", "joint1.placement.*"):
        assert f"no parameter '{name}'" in reason(lambda n=name: parameters().index(n))


def test_names_are_unique() -> None:
    first, second = Parameter("a.b.c", "m", 1.0), Parameter("a.b.c", "m", 2.0)
    text = reason(lambda: ParameterSet((first, Parameter("x.y.z", "m", 1.0), second)))
    assert "'a.b.c' is defined twice" in text


def test_one_parameter_in_two_places() -> None:
    shared, other = Parameter("a.b.c", "m", 1.0), Parameter("x.y.z", "m", 1.0)
    both = ParameterSet((shared, other, shared))
    assert both.index("a.b.c") == 0
    assert both.vector({"a.b.c": 2.0}).tolist() == [2.0, 0.0, 2.0]
    assert both.with_fixed(["a.b.c"]).free.tolist() == [False, True, False]
    assert both.with_priors({"a.*": 3.0}).priors.tolist() == [3.0, np.inf, 3.0]


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


def test_names_are_compared_once(monkeypatch: pytest.MonkeyPatch) -> None:
    # Calibrations ask hundreds of times, of sets that are equal but not the same.
    asked: list[str] = []

    def compared(pattern: str, names: Sequence[str]) -> list[int]:
        asked.append(pattern)
        return matching(pattern, names)

    monkeypatch.setattr("calib_pin.parameters.matching", compared)
    for _ in range(3):
        parameters().with_fixed(["*.x", "joint1?.*"])
    assert asked == ["*.x", "joint1?.*"]


def test_patterns_that_match_nothing() -> None:
    for pattern in ("joint2.*", "JOINT1.*", "placement.x", "joint1", ""):
        for call in (
            lambda p=pattern: parameters().with_fixed([p]),
            lambda p=pattern: parameters().with_bounds({p: 1.0}),
            lambda p=pattern: parameters().with_priors({p: 1.0}),
        ):
            assert f"no parameter matches '{pattern}'" in reason(call)
    text = reason(lambda: parameters().with_fixed(["joint1.placment.x"]))
    assert "did you mean 'joint1.placement.x'?" in text


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


@pytest.mark.parametrize("limit", [-0.01, (0.1, 0.2), (-2.0, -1.0), np.nan])
def test_bounds_that_exclude_the_nominal_robot(limit: float) -> None:
    text = reason(lambda: parameters().with_bounds({"joint1.*": limit}))
    assert "bounds of 'joint1.*' exclude zero" in text


def test_priors_and_later_entries_win() -> None:
    priors: Mapping[str, float] = {"*.placement.*": 0.002, "joint11.*": 0.5}
    found = parameters().with_priors(priors).priors
    assert found.tolist() == [np.inf, 0.002, 0.002, 0.5, 0.002, np.inf]
    free = parameters().with_priors(priors).with_priors({"joint11.*": np.inf})
    assert np.isinf(free.priors[3])


@pytest.mark.parametrize("sigma", [0.0, -1e-3, np.nan])
def test_priors_are_positive(sigma: float) -> None:
    text = reason(lambda: parameters().with_priors({"joint1.*": sigma}))
    assert "prior of 'joint1.*' is a standard deviation" in text


def test_changes_add_up() -> None:
    found = (
        parameters()
        .with_bounds({"joint1.*": 0.01})
        .with_priors({"joint1.*": 0.1})
        .with_fixed(["joint1.placement.x"])
    )
    changed = found[1]
    assert (changed.free, changed.upper, changed.prior) == (False, 0.01, 0.1)
    assert found[0] == parameters()[0]
