"""Ranks of REFERENCE geometry, coupled groups, observability."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pinocchio as pin
import pytest

import calib_pin
from calib_pin.estimation.identifiability import (
    Combination,
    observability,
    structure,
)
from calib_pin.kinematics.chain import Chain
from calib_pin.kinematics.spatial import Floats
from calib_pin.parameters import Parameter, ParameterSet
from calib_pin.setup import FrameSetup, PlaneSetup, Setup
from tests.shared import chain_of, urdf_of

KNOWN = FrameSetup(estimate=False)
FREE = FrameSetup(estimate=True)
INCLINED = {"wall": PlaneSetup((0.3, 1.0, 4.6), -0.69, estimate=False)}
LEVEL = {"wall": PlaneSetup((0.0, 0.0, 1.0), -0.69, estimate=False)}
OFF_AXIS = FrameSetup((0.1, 0.05, 0.2), (0.3, 0.2, 0.1), estimate=True)


Arm = Callable[..., Chain]


@pytest.fixture(scope="module")
def generic_arm() -> Arm:
    """A serial arm with random placements, axis 1 along z of the base."""

    def make(joints: str = "rrrrrr", seed: int = 1) -> Chain:
        rng, kinds = np.random.default_rng(seed), {"r": "revolute", "p": "prismatic"}
        told = []
        for k, kind in enumerate(joints, start=1):
            xyz, rpy = rng.uniform(-0.5, 0.5, 3), rng.uniform(-np.pi, np.pi, 3)
            pose = pin.SE3(pin.rpy.rpyToMatrix(rpy), xyz)
            joint = {"name": f"j{k}", "parent": f"l{k - 1}", "child": f"l{k}"}
            joint |= {"placement": pose if k > 1 else pin.SE3.Identity()}
            told.append(joint | {"type": kinds[kind], "limits": (-3, 3)})
        return chain_of(urdf_of(*told))

    return make


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
    generic_arm: Arm,
) -> None:
    cases = [(*BASE_FREE, free_rank), (*JOINT_1_FREE, free_rank)]
    if fixed_rank is not None:
        cases.append((*BOTH_FIXED, fixed_rank))
    for base, fixed, rank in cases:
        setup = Setup(base_frame=base, tool_frame=tool, planes=planes, fixed=fixed)
        found = calib_pin.identify(generic_arm(), model, setup)
        assert found.identifiability.structural_rank == rank
        assert found.identifiability.gap > 1e6


@pytest.mark.parametrize("joints", ["rrprrr", "rrrrrrr", "pprrr"])
def test_everetts_count_is_the_rank_of_full_poses(
    joints: str, generic_arm: Arm
) -> None:
    # A generic prismatic joint leaves two of its four parameters unseen.
    found = calib_pin.identify(generic_arm(joints), "pose")
    ranks = found.identifiability
    revolute, prismatic = joints.count("r"), joints.count("p")
    assert ranks.everett == 4 * revolute + 2 * prismatic + 6 == ranks.rank


LENGTHS = tuple(Parameter(f"r.k.{name}", "m", 1e-3) for name in "abc")
OF_TWO_UNITS = (Parameter("r.k.x", "m", 1e-3), Parameter("r.k.rz", "rad", 3e-3))
A, B, C = np.random.default_rng(0).normal(size=(3, 40))


@pytest.mark.parametrize(
    ("parameters", "columns", "sums", "unit"),
    [
        # A column of 1e-15 is nothing, however the others are scaled.
        (LENGTHS, (A, B, 1e-15 * C), [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]], "m"),
        # c = a + 2 b is seen only through the columns of a and b: it is in two sums.
        (LENGTHS, (A, B, A - 2.0 * B), [[1.0, 0.0, 1.0], [0.0, 1.0, -2.0]], "m"),
        # Sums of different units carry the ratio of their scales.
        (OF_TWO_UNITS, (A, 0.76 * A), [[1.0, 0.76]], "m"),
    ],
)
def test_what_columns_show(
    parameters: tuple[Parameter, ...],
    columns: tuple[Floats, ...],
    sums: list[list[float]],
    unit: str,
) -> None:
    found = structure(np.column_stack(columns), ParameterSet(parameters))
    assert found.rank == len(sums)
    rows = [c.row(len(parameters)) for c in found.combinations]
    np.testing.assert_allclose(rows, sums, rtol=1e-9, atol=1e-12)
    assert found.combinations[-1].unit == unit
    hidden = ~np.any(sums, axis=0)
    assert found.unidentifiable == tuple(np.flatnonzero(hidden))


def test_expression_writes_signs_and_leaves_out_ones() -> None:
    combination = Combination(((0, 1.0), (1, -1.0), (2, 0.76), (3, -2.5)), "m")
    assert combination.expression(("a", "b", "c", "d")) == "a - b + 0.76 c - 2.5 d"


def test_observability_indices() -> None:
    s = np.array([4.0, 2.0, 1.0])
    found = observability(s, 9)
    first, last = 8.0 ** (1 / 3) / 3, 1 / (0.25 + 0.5 + 1)
    expected = {"O1": first, "O2": 0.25, "O3": 1.0, "O4": 0.25, "O5": last}
    assert found == pytest.approx(expected)
    assert set(observability(np.zeros(0), 5).values()) == {0.0}


def test_frames_absorb_what_they_can(generic_arm: Arm) -> None:
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
