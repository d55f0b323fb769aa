"""Files of configurations: what a controller needs, and back."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import calib_pin
from calib_pin.errors import OutputError
from calib_pin.io.measurements import (
    encode_configurations,
    read_configurations,
    read_names,
)
from calib_pin.kinematics.joint_columns import JointColumns
from calib_pin.setup import JointMap

CHAIN = calib_pin.load_chain("space6")
Q = CHAIN.random_configurations(7, np.random.default_rng(0))


def write_configurations(path: Path, *about: Any, **more: Any) -> list[str]:
    path.write_bytes(encode_configurations(*about, **more))
    return path.read_text().splitlines()


def test_files_read_back_bit_by_bit(tmp_path: Path) -> None:
    file, names = tmp_path / "plan.csv", ("wall", 'floor, "left"', "ä", *[""] * 4)
    lines = write_configurations(file, CHAIN, Q, comments=["one\ntwo", ""])
    assert lines[:4] == ["# one", "# two", "#", ",".join(CHAIN.joints)]
    assert read_configurations(file, CHAIN).tobytes() == Q.tobytes()
    assert read_names(file, "target") == ()
    assert lines[3:] == write_configurations(file, CHAIN, Q, [""] * 7)
    write_configurations(file, CHAIN, Q, names)
    assert read_names(file, "target") == names
    assert read_configurations(file, CHAIN).tobytes() == Q.tobytes()


@pytest.mark.parametrize("name", [" wall", "wall\n", "a\0b"])
def test_targets_that_would_not_read_back(name: str) -> None:
    with pytest.raises(OutputError):
        encode_configurations(CHAIN, Q, ("wall",) * 6 + (name,))


factor = st.floats(0.01, 100.0) | st.floats(-100.0, -0.01)


@settings(max_examples=40, deadline=None)
@given(
    signs=st.lists(st.sampled_from([-1, 1]), min_size=6, max_size=6),
    gears=st.lists(factor, min_size=6, max_size=6),
    offsets=st.lists(st.floats(-3.0, 3.0), min_size=6, max_size=6),
    couplings=st.lists(st.floats(-2.0, 2.0), min_size=15, max_size=15),
)
def test_joint_maps_are_undone(
    signs: list[int], gears: list[float], offsets: list[float], couplings: list[float]
) -> None:
    """By the formula of the setup file; couplings to axes before can be undone."""
    values = iter(couplings)
    joints = {
        f"A{k}": JointMap(
            joint,
            signs[k],
            gears[k],
            offsets[k],
            {f"A{m}": next(values) for m in range(k)},
        )
        for k, joint in enumerate(CHAIN.joints)
    }
    columns = JointColumns.of(CHAIN, joints)
    assert columns.names == tuple(joints)
    np.testing.assert_allclose(columns.positions(columns.values(Q)), Q, atol=1e-9)
    found = dict(zip(columns.names, columns.values(Q).T, strict=True))
    for k, (name, given_map) in enumerate(joints.items()):
        inner = found[name] + sum(
            c * found[other] for other, c in given_map.coupled.items()
        )
        position = given_map.sign * given_map.gear * inner + given_map.offset
        size = 1.0 + np.abs(gears[k]) * max(np.abs(v).max() for v in found.values())
        np.testing.assert_allclose(position, Q[:, k], atol=1e-12 * size)


def test_mutual_couplings_are_undone(tmp_path: Path) -> None:
    first, second, *others = CHAIN.joints
    joints = {
        "A": JointMap(first, coupled={"B": 0.5, "track": 2.0}),
        "B": JointMap(second, sign=-1, coupled={"A": 0.25}),
    }
    header, *_ = write_configurations(tmp_path / "plan.csv", CHAIN, Q, joints=joints)
    assert header.split(",") == ["A", "B", *others, "track"]
    found = read_configurations(tmp_path / "plan.csv", CHAIN, joints)
    np.testing.assert_allclose(found, Q, rtol=0.0, atol=1e-12)


def test_positions_are_not_changed_by_a_map_of_other_joints() -> None:
    joints = {"A": JointMap(CHAIN.joints[2], gear=0.1)}
    before = Q.copy()
    found = JointColumns.of(CHAIN, joints).values(Q)
    assert Q.tobytes() == before.tobytes()
    others = [0, 1, 3, 4, 5]
    assert found[:, others].tobytes() == Q[:, others].tobytes()


def test_a_mimic_joint_that_stands_still_needs_no_leader(
    urdf_of: Callable[..., str], chain_of: Callable[..., Any]
) -> None:
    still = '<mimic joint="side" multiplier="0" offset="0.2"/>'
    joints = (
        {"name": "side", "parent": "base", "child": "beside"},
        {"name": "still", "parent": "base", "child": "link", "more": still},
        {"name": "moves", "parent": "link", "child": "tip"},
    )
    columns = JointColumns.of(chain_of(urdf_of(*joints), "base", "tip"))
    assert columns.names == ("moves",)
    values = np.array([[0.3], [-0.4]])
    assert columns.positions(values).tolist() == [[0.2, 0.3], [0.2, -0.4]]
    assert columns.values(columns.positions(values)).tolist() == values.tolist()
