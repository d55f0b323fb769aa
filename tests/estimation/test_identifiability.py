"""Ranks of REFERENCE geometry, coupled groups, observability."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

import calib_pin
from calib_pin.estimation.identifiability import (
    Combination,
    combinations,
    everett_count,
    observability,
    structure,
)
from calib_pin.io.urdf_tree import parse_robot
from calib_pin.kinematics.chain import Chain
from calib_pin.parameters import Parameter, ParameterSet
from calib_pin.setup import FrameSetup, PlaneSetup, Setup

KNOWN = FrameSetup(estimate=False)
FREE = FrameSetup(estimate=True)
INCLINED = {"wall": PlaneSetup((0.3, 1.0, 4.6), -0.69, estimate=False)}
LEVEL = {"wall": PlaneSetup((0.0, 0.0, 1.0), -0.69, estimate=False)}
OFF_AXIS = FrameSetup((0.1, 0.05, 0.2), (0.3, 0.2, 0.1), estimate=True)


def generic_arm(joints: str = "rrrrrr", seed: int = 1) -> Chain:
    """A serial arm with random placements, axis 1 along z of the base."""
    rng = np.random.default_rng(seed)
    parts = ["<robot name='generic'><link name='l0'/>"]
    for k, kind in enumerate(joints, start=1):
        kinds = {"r": "revolute", "p": "prismatic"}
        xyz = np.zeros(3) if k == 1 else rng.uniform(-0.5, 0.5, 3)
        rpy = np.zeros(3) if k == 1 else rng.uniform(-np.pi, np.pi, 3)
        parts.append(
            f"<link name='l{k}'/><joint name='j{k}' type='{kinds[kind]}'>"
            f"<parent link='l{k - 1}'/><child link='l{k}'/>"
            f"<origin xyz='{_text(xyz)}' rpy='{_text(rpy)}'/><axis xyz='0 0 1'/>"
            "<limit lower='-3' upper='3' effort='1' velocity='1'/></joint>"
        )
    return Chain(parse_robot(("".join(parts) + "</robot>").encode(), "generic"))


def _text(vector: np.ndarray) -> str:
    return " ".join(map(repr, vector.tolist()))


# The three ways of REFERENCE.md to treat the base, and what is held for each.
BASE_FREE = (FREE, ())
JOINT_1_FREE = (KNOWN, ())
BOTH_FIXED = (KNOWN, ("j1.placement.*",))


@pytest.mark.parametrize(
    ("model", "planes", "tool", "free_rank", "fixed_rank"),
    [
        ("pose", {}, OFF_AXIS, 30, 26),
        ("position", {}, OFF_AXIS, 27, 23),
        ("position", {}, FrameSetup((0, 0, 0.2), estimate=True), 25, None),
        ("plane-distance", INCLINED, OFF_AXIS, 26, 25),
        ("plane-distance", LEVEL, OFF_AXIS, 24, 22),
    ],
    ids=["pose", "point", "point on last axis", "ranger", "ranger, plane across z0"],
)
def test_ranks_of_a_generic_6r(
    model: str,
    planes: dict[str, PlaneSetup],
    tool: FrameSetup,
    free_rank: int,
    fixed_rank: int | None,
) -> None:
    cases = [(*BASE_FREE, free_rank), (*JOINT_1_FREE, free_rank)]
    if fixed_rank is not None:
        cases.append((*BOTH_FIXED, fixed_rank))
    for base, fixed, rank in cases:
        setup = Setup(base_frame=base, tool_frame=tool, planes=planes, fixed=fixed)
        for seed in (1, 2):
            found = calib_pin.identify(generic_arm(seed=seed), model, setup)
            assert found.identifiability.structural_rank == rank
            assert found.identifiability.gap > 1e6


@pytest.mark.parametrize("joints", ["rrrrrr", "rrprrr", "prrrrr", "rrrrrrr", "pprrr"])
def test_everetts_count_is_the_rank_of_full_poses(joints: str) -> None:
    # A generic prismatic joint leaves two of its four parameters unseen.
    found = calib_pin.identify(generic_arm(joints), "pose")
    ranks = found.identifiability
    revolute, prismatic = joints.count("r"), joints.count("p")
    assert ranks.everett == 4 * revolute + 2 * prismatic + 6 == ranks.rank


def test_rank_does_not_count_rounding() -> None:
    """A column of 1e-15 is nothing, however the others are scaled."""
    rng = np.random.default_rng(0)
    J = np.column_stack([rng.normal(size=(50, 2)), 1e-15 * rng.normal(size=50)])
    parameters = ParameterSet(tuple(Parameter(f"a.b.{k}", "m", 1e-3) for k in "xyz"))
    found = structure(J, parameters)
    assert found.rank == 2
    assert found.unidentifiable == (2,)


def test_a_parameter_may_stand_in_two_groups() -> None:
    # c = a + 2 b is seen only through the columns of a and b.
    rng = np.random.default_rng(0)
    a, b = rng.normal(size=(2, 40))
    parameters = ParameterSet(tuple(Parameter(f"r.k.{n}", "m", 1e-3) for n in "abc"))
    found = structure(np.column_stack([a, b, a - 2.0 * b]), parameters)
    names = parameters.names
    assert [c.expression(names) for c in found.combinations] == [
        "r.k.a + r.k.c",
        "r.k.b - 2 r.k.c",
    ]


def test_sums_of_different_units_carry_the_ratio_of_scales() -> None:
    rng = np.random.default_rng(0)
    a = rng.normal(size=40)
    parameters = ParameterSet(
        (Parameter("r.k.x", "m", 1e-3), Parameter("r.k.rz", "rad", 3e-3))
    )
    found = structure(np.column_stack([a, 0.76 * a]), parameters)
    (combination,) = found.combinations
    assert combination.terms == (
        (0, 1.0),
        (1, pytest.approx(0.76, rel=1e-12)),
    )


def test_a_dwarfed_first_term_does_not_set_the_unit() -> None:
    rng = np.random.default_rng(0)
    a = rng.normal(size=40)
    parameters = ParameterSet(
        (
            Parameter("j.placement.ry", "rad", 3e-3),
            Parameter("tool.frame.y", "m", 1.0, nuisance=True),
        )
    )
    (combination,) = structure(np.column_stack([1e-4 * a, a]), parameters).combinations
    assert combination.unit == "m"
    assert combination.row(2) == pytest.approx([1e-4, 1.0])


def test_elimination_takes_columns_in_their_order() -> None:
    A = np.array([[1.0, 2.0, 0.0, 1.0], [0.0, 0.0, 1.0, 1.0]])
    pivots, C = combinations(A, 2)
    assert pivots == [0, 2]
    assert pytest.approx(np.array([[1, 2, 0, 1], [0, 0, 1, 1]])) == C


def test_expression_writes_signs_and_leaves_out_ones() -> None:
    combination = Combination(((0, 1.0), (1, -1.0), (2, 0.76), (3, -2.5)), "m")
    assert combination.expression(("a", "b", "c", "d")) == "a - b + 0.76 c - 2.5 d"


def test_observability_indices() -> None:
    s = np.array([4.0, 2.0, 1.0])
    found = observability(s, 9)
    assert found["O1"] == pytest.approx(8.0 ** (1 / 3) / 3)
    assert found["O2"] == pytest.approx(0.25)
    assert found["O3"] == pytest.approx(1.0)
    assert found["O4"] == pytest.approx(0.25)
    assert found["O5"] == pytest.approx(1 / (0.25 + 0.5 + 1))
    assert set(observability(np.zeros(0), 5).values()) == {0.0}


def test_everett_count_of_a_scara() -> None:
    assert everett_count(np.array([True, True, False, True])) == 20


def test_frames_absorb_what_they_can() -> None:
    """What base or tool can explain never moves the robot."""
    chain = generic_arm()
    rng = np.random.default_rng(0)
    base = pin.SE3(pin.exp3(np.array([0.5, 0.2, 2.0])), np.array([1.0, -2.0, 0.5]))
    tool = pin.SE3(pin.exp3(np.array([0.1, 0.2, 0.3])), np.array([0.1, 0.0, 0.2]))
    q = chain.random_configurations(40, rng)
    T = base.homogeneous @ chain.poses(q) @ tool.homogeneous
    rows = calib_pin.Measurements(chain.joints, q, "position", T[:, :3, 3].copy())
    result = calib_pin.calibrate(chain, rows)
    moved = [p.value for p in result.parameters if ".placement." in p.name]
    assert np.abs(moved).max() < 1e-10
    assert np.allclose(
        result.model.of().error.base.homogeneous, base.homogeneous, atol=1e-9
    )
