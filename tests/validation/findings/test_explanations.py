"""Wrong joint columns are found by trial, and their lines do what was tried."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

import calib_pin
from calib_pin.errors import InputError, OptionError
from calib_pin.estimation.fit import fit_model
from calib_pin.kinematics.chains import Chains
from calib_pin.kinematics.spatial import Floats
from calib_pin.observations import Observations
from calib_pin.setup import AnchorSetup, FrameSetup, JointMap, Setup
from calib_pin.validation import findings
from calib_pin.validation.findings.alternatives import (
    Explanation,
    JointReading,
    explain,
    findings_of,
    read_with,
    setup_lines,
)
from calib_pin.validation.findings.case import Case
from calib_pin.validation.findings.readings import joint_columns
from tests.shared import chain_of, joint, simulated, urdf_of

KNOWN = FrameSetup((0.4, -0.2, 0.3), (0.1, 0.2, 0.3), estimate=False)
TOOL = FrameSetup((0.05, 0.08, 0.12))
SETUP = Setup(parameters=("joint-offset",), base_frame=KNOWN, tool_frame=TOOL)


@pytest.fixture(scope="module")
def arm() -> Chains:
    """Three joints that turn and one that slides."""
    twists = [(0, 0, 0.4, 0, 0, 0), (0.1, 0, 0, 0.4, 0, 0.2), (0.5, 0, 0, 0, 0.3, 0)]
    axes = "0 0 1", "0 1 0", "0 1 0"
    joints = [
        joint(f"j{k}", f"l{k} l{k + 1}", pin.exp6(np.array(twist)), axis, limits="-2 2")
        for k, (axis, twist) in enumerate(zip(axes, twists, strict=True))
    ]
    at = pin.exp6(np.array([0.3, 0, 0.1, 0, 0, 0.1]))
    joints.append(joint("j3", "l3 l4", at, "1 0 0", "prismatic", "-0.3 0.3"))
    return Chains.of(chain_of(urdf_of(*joints)))


@pytest.fixture(scope="module")
def rows(arm: Chains, erring: Callable[..., Observations]) -> Observations:
    """Positions of a robot with errors."""
    return erring(arm[""], SETUP, 7, count=30, noise=5e-5)


def misread(rows: Observations, change: Callable[[Floats], None]) -> Observations:
    q = rows.q.copy()
    change(q)
    return Observations.of(replace(rows.only, q=q))


def case_of(
    arm: Chains,
    rows: Observations,
    setup: Setup,
    progress: Callable[[float], None] | None = None,
) -> Case:
    return Case.of(fit_model(arm, rows, setup, 0), progress=progress)


def explained(case: Case) -> Explanation | None:
    return explain(case, (joint_columns,))


def said(found: Explanation | None) -> list[str]:
    return sorted(fault.code for fault in found.faults) if found else []


def couple_reverse_and_offset(q: Floats) -> None:
    q[:, 2] = -q[:, 2] + q[:, 1] + np.pi / 2.0


def times(factor: float, *columns: int) -> Callable[[Floats], None]:
    def change(q: Floats) -> None:
        q[:, columns] *= factor

    return change


@pytest.mark.parametrize(
    ("change", "codes"),
    [
        (
            couple_reverse_and_offset,
            {"joint-coupled", "joint-offset", "joint-reversed"},
        ),
        # Degrees and millimeters that were read as radians and meters, and back.
        *((times(180.0 / np.pi, *j), {"joint-degrees"}) for j in [(1,), (0, 1, 2)]),
        *((times(np.pi / 180.0, *j), {"joint-degrees"}) for j in [(1,), (0, 1, 2)]),
        *((times(factor, 3), {"joint-degrees"}) for factor in (1e3, 1e-3)),
    ],
)
def test_what_is_wrong_is_found(
    change: Callable[[Floats], None], codes: set[str], arm: Chains, rows: Observations
) -> None:
    wrong = misread(rows, change)
    found = explained(case_of(arm, wrong, SETUP))
    assert found is not None and {fault.code for fault in found.faults} == codes
    assert found.after < 0.05 * found.before
    # Products with pi and its inverse, and sums, of positions up to 300.
    np.testing.assert_allclose(read_with(wrong, found.faults).q, rows.q, atol=1e-12)


@pytest.mark.slow
def test_measurements_of_something_else(arm: Chains, rows: Observations) -> None:
    """Nothing helps decisively: better no advice than a wrong one."""
    rows = Observations.of(rows.only.rows(np.arange(20)))
    order = np.random.default_rng(0).permutation(len(rows))
    mixed = Observations.of(replace(rows.only, q=rows.q[order]))
    assert explained(case_of(arm, mixed, SETUP)) is None


def test_without_a_measurement_frame(arm: Chains) -> None:
    """Closed forms are poor there; the registration is fitted."""
    wire = {"w": AnchorSetup((1.5, 0.2, 0.4), estimate=False)}
    setup = Setup(anchors=wire, tool_frame=TOOL, parameters=("joint-offset",))
    job, _ = simulated("point-distance", setup, 40, seed=7, robot=arm, noise=5e-5)
    wrong = misread(job.data, times(-1.0, 1))
    case = case_of(arm, wrong, replace(setup, tool_frame=FrameSetup()))
    assert said(explained(case)) == ["joint-reversed"]


def reverse_and_couple(q: Floats) -> None:
    q[:, 2] = -(q[:, 2] + q[:, 1])


def test_lines_have_the_names_of_the_columns(arm: Chains, rows: Observations) -> None:
    """And what is mapped already is kept."""
    case = case_of(arm, misread(rows, reverse_and_couple), SETUP)
    found = explained(case)
    assert found is not None
    lines = {"joints": {"j2": {"joint": "j2", "sign": -1, "coupled": {"j1": 1.0}}}}
    for one in findings_of(case, found):
        assert one.severity == "error" and one.setup == lines
        assert "joints: {j2: {joint: j2, sign: -1, coupled: {j1: 1}}}" in one.remedy
    maps = {"A1": JointMap("j1"), "A2": JointMap("j2", sign=-1)}
    problem = replace(case.fit.problem, setup=replace(SETUP, joints=maps))
    mapped = replace(case, fit=replace(case.fit, problem=problem))
    found_lines = setup_lines(mapped, found.faults)["joints"]
    assert found_lines["A2"] == {"joint": "j2", "coupled": {"A1": -1.0}}


def test_refusals_say_what_explains_them(arm: Chains, rows: Observations) -> None:
    wrong = misread(rows, times(-1.0, 1))
    with (
        pytest.raises(InputError, match=r"'j1'.*sign: -1.*hidden"),
        findings.explained(arm, wrong, SETUP),
    ):
        raise InputError("hidden")
    # What explains itself stays.
    with (
        pytest.raises(OptionError, match=r"^no$"),
        findings.explained(arm, wrong, SETUP),
    ):
        raise OptionError("no")


ARM = calib_pin.load_chain("space6")
JOINTS = ARM.joints


def read_back(
    path: Path, columns: np.ndarray, names: list[str], joints: dict
) -> np.ndarray:
    header = [*names, "x", "y", "z"]
    rows = np.column_stack([columns, np.tile([0.5, 0.4, 0.3], (len(columns), 1))])
    text = "\n".join(",".join(map(repr, row)) for row in rows.tolist())
    path.write_text(f"{','.join(header)}\n{text}\n", encoding="utf-8")
    return calib_pin.read_measurements(path, ARM, joints=joints).q


def drawn(rng: np.random.Generator) -> JointReading:
    """Joints that are exchanged, reversed, geared, offset and coupled."""
    order = np.arange(6)
    if rng.uniform() < 0.7:
        some = rng.choice(6, rng.integers(2, 4), replace=False)
        order[some] = np.roll(some, 1)
    factors = np.eye(6)[order] * rng.choice([-1.0, 1.0, 1.01], 6)[:, None]
    for _ in range(rng.integers(3)):
        j, k = sorted(rng.choice(6, 2, replace=False))
        factors[k] += rng.choice([-1.0, 1.0, 0.01]) * factors[j]
    return JointReading(factors, rng.choice([0.0, np.pi / 2, -0.1], 6))


@pytest.mark.parametrize("seed", range(6))
def test_a_file_with_the_lines_is_what_was_tried(seed: int, tmp_path: Path) -> None:
    rng = np.random.default_rng(seed)
    names, stated = list(JOINTS), {}
    if seed % 2:
        # The user's own maps: other names, a sign and a coupling.
        names = [f"A{k}" for k in range(6)]
        stated = {name: JointMap(j) for name, j in zip(names, JOINTS, strict=True)}
        stated["A1"] = JointMap(JOINTS[1], sign=-1, gear=0.5, offset=0.2)
        stated["A2"] = JointMap(JOINTS[2], coupled={"A1": 1.0})
    columns = rng.uniform(-0.8, 0.8, (4, 6))
    before = read_back(tmp_path / "before.csv", columns, names, stated)
    reading = drawn(rng)
    lines = reading.maps(JOINTS, stated)
    maps = stated | {name: JointMap(**entry) for name, entry in lines.items()}
    after = read_back(tmp_path / "after.csv", columns, names, maps)
    np.testing.assert_allclose(after, reading.positions(before), atol=1e-12)


def test_what_a_joint_was_stated_to_be_is_stated_anew() -> None:
    """A map that is undone does not stay in the setup."""
    stated = {JOINTS[0]: JointMap(JOINTS[0], sign=-1)}
    factors = np.diag([-1.0, *[1.0] * 5])
    lines = JointReading(factors, np.zeros(6)).maps(JOINTS, stated)
    assert lines == {JOINTS[0]: {"joint": JOINTS[0]}}
