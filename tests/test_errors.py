"""Errors: one line made of their fields, and the wording of a few as a whole.

Everywhere else errors are compared by their fields (`refused` in conftest.py), so that
a change of wording shows here and nowhere else.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import calib_pin
from calib_pin.errors import InputError, OptionError, nearest, require_known
from calib_pin.estimation.formulation import nominal_problem
from calib_pin.observations import Measurements
from calib_pin.setup import PointSetup, Region, Setup
from calib_pin.solvers import DifferentialEvolution
from tests.shared import refused


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({}, "no good"),
        ({"file": "m.csv", "line": 7}, "m.csv:7: no good"),
        ({"line": 7, "column": "x"}, "line 7: no good (column 'x')"),
        ({"value": 0.5}, "no good (value 0.5)"),
        (
            {"file": "a.csv", "column": "x", "value": 2, "allowed": "3"},
            "a.csv: no good (column 'x', value 2); allowed: 3",
        ),
        # A text of several lines becomes one.
        ({"allowed": "b,\n  c"}, "no good; allowed: b, c"),
    ],
)
def test_a_message_is_one_line_of_all_fields(fields, message):
    error = InputError("no good", **fields)
    assert str(error) == message
    empty = dict.fromkeys(("file", "line", "column", "value", "allowed"))
    assert vars(error) == {"reason": "no good", **empty, **fields}


@pytest.mark.parametrize(
    ("reason", "fields", "message"),
    [
        (f"no '{'a' * 99}'", {}, f"no '{'a' * 55}...'"),
        ("no good", {"value": "b" * 99}, f"no good (value '{'b' * 55}...')"),
        ("no good", {"column": "c" * 99}, f"no good (column '{'c' * 55}...')"),
        ("no good", {"value": [1] * 99}, f"no good (value [{'1, ' * 18}1,...)"),
        ("no '\x1b[2J\u202e\ufeff\udcff'", {}, r"no '\x1b[2J\u202e\ufeff\udcff'"),
        ("a robot's own joint", {"file": f"{'d' * 99}/r.urdf"}, None),
        ("no good", {"file": f"{'d' * 199}/r.urdf"}, f"...{'d' * 110}/r.urdf: no good"),
        # Between two apostrophes stands no value.
        (f"the robot's {'word ' * 20}of others' sort", {}, None),
    ],
)
def test_values_in_messages_are_short_and_harmless(reason, fields, message):
    place = f"{fields['file']}: " if message is None and fields else ""
    assert str(InputError(reason, **fields)) == (message or f"{place}{reason}")


def test_no_message_is_long() -> None:
    names = ", ".join(f"joint{k}" for k in range(5000))
    error = InputError("there is no such joint", allowed=names)
    assert str(error).endswith(", joint26 and 4973 more")
    assert error.allowed == names
    for reason in ("no", "no " * 50, "no " * 500):
        for allowed in ("one", "one " * 20, "one " * 500, "one, " * 500):
            message = str(InputError(reason, file="m.csv", line=3, allowed=allowed))
            assert len(message) <= 280
            assert "; allowed: one" in message


def test_within_a_file() -> None:
    error = OptionError("no good", column="x", value=1, allowed="2")
    there = error.within("lab.yaml")
    assert type(there) is OptionError
    assert vars(there) == vars(error) | {"file": "lab.yaml"}
    assert vars(error.within("")) == vars(error)


def test_a_name_that_is_required() -> None:
    assert nearest("dhh", ["placement", "dh"]) == " (did you mean 'dh'?)"
    assert nearest("xyz", ["placement", "dh"]) == nearest("dh", []) == ""
    require_known("part", "b", "ab")
    with refused(OptionError, ["part 'c'"], allowed="a, b"):
        require_known("part", "c", "ab")
    with refused(OptionError, "part 'None'", allowed=""):
        require_known("part", None, [])
    # A chain that has no name is nothing to choose.
    with pytest.raises(OptionError, match=r"unknown part 'c'$"):
        require_known("part", "c", [""])


def space6(**setup: Any) -> Any:
    """A problem on `space6`; its setup stands in a file."""
    stated = Setup(file="lab.yaml", **setup)
    return nominal_problem(calib_pin.load_chain("space6"), "position", stated)


def plan(**options: Any) -> object:
    setup = options.pop("setup", Setup())
    chain = calib_pin.load_chain("space6")
    return calib_pin.plan(chain, "position", 20, setup, candidates=60, **options)


def calibrate(target: str) -> object:
    """Two rows of a file that name targets, of which there is but one."""
    chain = calib_pin.load_chain("space6")
    rows = Measurements(
        chain.joints,
        np.zeros((2, 6)),
        "position",
        np.zeros((2, 3)),
        target=("ball", target),
        lines=np.array([2, 3]),
        files=("m.csv", "m.csv"),
    )
    setup = Setup(targets={"ball": PointSetup((0.0, 0.0, 0.1))})
    return calib_pin.calibrate(chain, rows, setup)


FAR = Region(box=((5.0, 5.0, 5.0), (6.0, 6.0, 6.0)))

GOLDEN: dict[str, Callable[[], object]] = {
    "population_size cannot be used (value 3); allowed: a whole number, 4 to 100000": (
        lambda: DifferentialEvolution(population_size=3)
    ),
    "unknown mutation strategy 'rand1' (did you mean 'rand/1'?); allowed: rand/1, "
    "best/1, rand-to-best/1, midpoint, tradeoff": (
        lambda: DifferentialEvolution(strategy="rand1")
    ),
    "lab.yaml: 'compliance' needs something that gravity pulls at: there is no "
    "gravity, or the links of 'space6' have no mass that loads a joint and there is no "
    "payload; allowed: <inertial> in the URDF, or payloads in the setup file": (
        lambda: space6(parameters=("compliance",))
    ),
    "lab.yaml: no joint matches 'elbow' (column 'gear_ratios'); allowed: "
    "joint_1, joint_2, joint_3, joint_4, joint_5, joint_6": (
        lambda: space6(parameters=("transmission",), gear_ratios={"elbow": 2.0})
    ),
    "lab.yaml: no parameter matches 'joint_3.placment.x' (did you mean "
    "'joint_3.placement.x'?)": lambda: space6(fixed=("joint_3.placment.x",)).parameters,
    "m.csv:3: there is no target 'bal' (did you mean 'ball'?) (column 'target'); "
    "allowed: ball": lambda: calibrate("bal"),
    "none of 60000 configurations within the joint limits can be planned: 60000 "
    "outside the region; allowed: wider limits, a larger region, or fewer obstacles": (
        lambda: plan(setup=Setup(region=FAR))
    ),
    "the method 'gradient' needs derivatives by the configuration, which joint "
    "corrections and some measurement models do not have; allowed: exchange, greedy, "
    "pso, ga": (
        lambda: plan(setup=Setup(parameters=("transmission",)), method="gradient")
    ),
}
"""Whole messages, as a user reads them, with what leads to each."""


@pytest.mark.parametrize("message", GOLDEN)
def test_messages_as_a_whole(message: str) -> None:
    with pytest.raises(InputError) as caught:
        GOLDEN[message]()
    assert str(caught.value) == message
