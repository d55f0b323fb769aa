"""Outliers, noise, and what no robot has are told of a fit."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import calib_pin
from benchmarks.verdict import defects
from calib_pin.estimation.evidence import Finding
from calib_pin.estimation.fit import fit, fit_model
from calib_pin.estimation.fitted import Fit
from calib_pin.estimation.formulation import make_problem
from calib_pin.estimation.nominal import growth, registered
from calib_pin.observations import Measurements
from calib_pin.setup import (
    AnchorSetup,
    DistanceSetup,
    FrameSetup,
    PlaneSetup,
    PointSetup,
    Setup,
)
from calib_pin.validation.findings import find
from calib_pin.validation.findings.case import Case
from calib_pin.validation.findings.plausibility import plausibility, population
from tests.shared import chain_of, joint, simulated, urdf_of

ARM = calib_pin.load_chain("space6")
BASE = FrameSetup((1.5, -0.4, 0.3), (0.3, 0.2, 2.0), estimate=True)
TOOL = FrameSetup((0.05, 0.08, 0.12), (0.2, -0.3, 0.1), estimate=True)
WIRE = Setup(
    tool_frame=TOOL,
    anchors={
        "w": AnchorSetup((1.5, 0.2, 0.4), 0.01, estimate=True, estimate_bias=True)
    },
)


def measured(
    model: str, setup: Setup, seed: int, size: float = 1.0, count: int = 60
) -> Measurements:
    return simulated(model, setup, count, size, seed, noise=1e-4)[0].data.only


def fitted(rows: Measurements, setup: Setup) -> Fit:
    return fit(make_problem(ARM, rows, setup), np.random.default_rng(0))


def found_in(fitted: Fit) -> tuple[Finding, ...]:
    return tuple(plausibility(Case.of(fitted)))


def found(rows: Measurements, setup: Setup) -> tuple[Finding, ...]:
    return found_in(fitted(rows, setup))


FRAMES = Setup(base_frame=BASE, tool_frame=TOOL)


@pytest.mark.parametrize(
    ("model", "setup"), [("position", FRAMES), ("point-distance", WIRE)]
)
def test_growth_is_that_of_all_origins(model: str, setup: Setup) -> None:
    """At nominal it is the derivative by the translations of all placements."""
    problem = make_problem(ARM, measured(model, setup, 0), setup)
    theta = np.zeros(len(problem.parameters))
    problem = registered(problem, theta)
    _, J = problem.linearize_rows(theta)
    places = {screw.parameter.name: screw.frame for screw in problem.only.error.screws}
    direction = np.zeros(len(theta))
    for k, name in enumerate(problem.parameters.names):
        if ".placement." in name and name[-2:] in (".x", ".y", ".z"):
            M = ARM.placements[places[name] - 1]
            direction[k] = (M.rotation.T @ M.translation)["xyz".index(name[-1])]
    # The fixed joint behind the last one grows as well, which the tool can express.
    last = np.eye(4)
    for M in ARM.placements:
        last = last @ M.homogeneous
    tip = np.linalg.inv(last) @ ARM.poses(np.zeros((1, 6)))[0]
    tool = problem.parameters.index("tool.frame.x")
    behind = tip[:3, :3] @ problem.only.error.tool.rotation
    direction[tool : tool + 3] = behind.T @ tip[:3, 3]
    expected = J[: len(problem.sigma)] @ direction
    np.testing.assert_allclose(growth(problem, theta), expected, rtol=1e-9, atol=1e-6)


@pytest.mark.parametrize("factor", [1.0, 1.05])
def test_gears_that_are_left_out_hide_no_wrong_lengths(factor: float) -> None:
    """A robot grows a little to explain them, but not by a twentieth."""
    sizes = np.random.default_rng(6).normal(0.0, 0.005, 6)
    gains = {f"joint_{k}.transmission.gain": x for k, x in enumerate(sizes, start=1)}
    setup = replace(FRAMES, parameters=("placement", "transmission"))
    job, _ = simulated("position", setup, 60, 1.0, 6, changes=gains, noise=1e-4)
    rows = job.data.only
    codes = [f.code for f in found(replace(rows, values=factor * rows.values), FRAMES)]
    assert ("scale" in codes) == (factor != 1.0)


def test_a_distance_that_gives_the_scale() -> None:
    """Sockets 60 mm apart that are 50: nothing else knows how large the robot is."""
    sockets = {"s/0": PointSetup((0.6, 0.3, 0.4)), "s/1": PointSetup((0.55, 0.3, 0.4))}
    setup = Setup(tool_frame=TOOL, sockets=sockets)
    rows = measured("fixed-point", setup, 2, count=120)
    clean, wrong = (
        replace(setup, distances=(DistanceSetup(("s/0", "s/1"), value, 1e-5),))
        for value in (0.05, 0.06)
    )
    assert not found(rows, clean)
    (finding,) = found(rows, replace(wrong, sockets={}))
    assert finding.code == "scale" and "s/0 - s/1" in finding.remedy
    assert finding.evidence["scale"] == pytest.approx(0.2, abs=0.02)


@pytest.mark.parametrize(("kind", "job"), [("board", 7012), ("socket distance", 7101)])
def test_a_robot_that_grows_with_its_frames_is_told(kind: str, job: int) -> None:
    """A board or sockets a fifth too large: the nominal robot errs by 3 and 14 mm.

    Its frames absorb the rest, and corrections of 100 mm fit to the noise.
    """
    case = defects.DEFECTS[kind](job)
    result = calib_pin.calibrate(case.job.chain, case.rows, case.setup)
    assert result.verdict == "untrusted"
    assert "longer" in result.reason and "implausible" in result.reason


@pytest.mark.parametrize(("part", "severity"), [(3e-3, "warning"), (6e-3, "error")])
def test_lengths_that_are_a_little_too_long(part: float, severity: str) -> None:
    """A robot that errs by tenths of a millimeter has not grown by as much."""
    job, _ = simulated("position", Setup(tool_frame=TOOL), 60, 0.2, noise=5e-5)
    rows = job.data.only
    rows = replace(rows, values=(1.0 + part) * rows.values)
    result = calib_pin.calibrate(job.chains, rows, validate=False)
    (one,) = (finding for finding in result.findings if finding.severity != "info")
    assert (one.code, one.severity) == ("scale", severity)
    assert one.evidence["scale"] == pytest.approx(part, rel=0.1)


@pytest.mark.parametrize(("seed", "count"), [(4, 96), (5, 60)])
def test_the_wrong_distance_is_named_among_others(seed: int, count: int) -> None:
    rng = np.random.default_rng(seed)
    places = rng.normal([0.5, 0.1, 0.5], 0.2, (6, 3))
    names = [f"p{k // 2}/{k % 2}" for k in range(6)]
    sockets = {n: PointSetup(tuple(xyz)) for n, xyz in zip(names, places, strict=True)}
    setup = Setup(tool_frame=TOOL, sockets=sockets)
    rows = measured("fixed-point", setup, seed, count=count)
    lengths = np.linalg.norm(places[1::2] - places[::2], axis=1)
    lengths[1] += 0.01
    distances = tuple(
        DistanceSetup((f"p{k}/0", f"p{k}/1"), float(length), 1e-5)
        for k, length in enumerate(lengths)
    )
    case = Case.of(fitted(rows, replace(setup, sockets={}, distances=distances)))
    findings = find(case, seek=False).others
    assert findings[0].code == "known-distance"
    assert findings[0].evidence["between"] == "p1/0 - p1/1"
    # A robust fit sets the measurements of an end aside, for one of both is wrong, and
    # further parameters come closer to what is wrong, too.
    assert "model-lacks" not in {f.code for f in findings}
    assert all(f.severity == "info" for f in findings if f.code == "outliers")


def test_errors_of_the_gears_move_no_joint_by_centimeters() -> None:
    """A draw wire near one configuration: joint 2 moves far, for a little less error.

    With other errors of the gears, the expected size of the robot's holds it back.
    """
    rng = np.random.default_rng(4)
    center = np.array([0.1, 0.3, -0.5, 0.2, 0.5, 0.1])
    q = center + rng.uniform(-0.2, 0.2, (60, 6))
    job, _ = simulated("point-distance", WIRE, 0, 0.3, 4, q=q, noise=1e-4)
    rows = job.data.only
    gears = 8e-3 * np.sin(4 * rows.q + rng.uniform(0, 6, 6))
    (finding,) = found(replace(rows, sigma=None, q=rows.q + gears), WIRE)
    assert (finding.code, finding.severity) == ("implausible-correction", "error")
    assert float(finding.evidence["move"]) > 0.02
    assert float(finding.evidence["errors_without"]) < 4.0


def test_no_gear_leaves_half_a_meter(unsought) -> None:
    """Waves of gears fit into errors of any cause, and leave 0.46 of 0.73 m here."""
    setup = Setup(parameters=("joint-offset",))
    problem, _ = simulated("position", setup, 30, 1.0, noise=1e-3)
    block = problem.data.only
    wrong = replace(block, q=0.65 * block.q + 0.3 * np.sin(3.0 * block.q))
    result = calib_pin.calibrate(ARM, wrong, setup)
    assert result.verdict == "untrusted"
    assert "model-lacks" not in [finding.code for finding in result.findings]


def test_zeros_of_servos_are_no_wonder() -> None:
    """Eight degrees are what is looked for, if the zeros are all that is."""
    setup = replace(FRAMES, parameters=("joint-offset",))
    zeros = {f"joint_{k}.joint-offset.q": np.radians(8.0) for k in range(1, 7)}
    rows = simulated("position", setup, 30, changes=zeros, noise=1e-3)[0].data.only
    assert not found(replace(rows, sigma=None), setup)
    # As a part of whole placements they are looked at as before.
    both = replace(setup, parameters=("joint-offset", "placement"))
    assert found(replace(rows, sigma=None), both)


def unlike(fleet, seed: int, count: int, spreads: float, prior: bool = True):
    """Findings about a robot of which one error is so many spreads off."""
    chain = fleet.problem.chains[""]
    joint = chain.joints[2]
    name = f"{joint}.placement.rx"
    change = {name: spreads * fleet.spread[fleet.problem.parameters.index(name)]}
    data, _ = fleet.measured(seed, count, change)
    setup = Setup(prior=fleet.prior if prior else {})
    own = fit_model(chain, data, setup, 0)
    return list(population(Case.of(own))), name


@pytest.mark.slow
def test_one_of_them_and_one_without_a_prior(fleet) -> None:
    assert unlike(fleet, 300, 12, 0.0)[0] == []
    assert unlike(fleet, 300, 12, 30.0, prior=False)[0] == []


def test_a_bent_one(fleet) -> None:
    (finding,), name = unlike(fleet, 310, 12, 30.0)
    assert finding.code == "unlike-fleet"
    assert finding.evidence["chi2"] > 3.0 * finding.evidence["dof"]
    joint = name.split(".")[0]
    assert str(finding.evidence["parameter"]).startswith(joint)
    assert np.isfinite(finding.evidence["deviations"])


def test_a_prior_that_spoils_the_fit(fleet) -> None:
    """Far off, a few measurements look like noise to the prior."""
    (finding,), _ = unlike(fleet, 311, 10, 300.0)
    assert finding.severity == "error"


REAL = {
    "ur10_tmac/train.csv": ("example:ur10_robot", "tool0"),
    "talos_left_arm/measurements.csv": (
        "example:talos_reduced",
        "gripper_left_base_link",
    ),
    "tiago/train.csv": ("example:tiago_no_hand", "wrist_ft_tool_link"),
}


@pytest.mark.slow
@pytest.mark.parametrize("file", REAL)
def test_real_robots_are_plausible(file: str, data_folder: Path) -> None:
    """They are accused of nothing; with lengths that are too large they are."""
    robot, tip = REAL[file]
    chain = calib_pin.load_chain(robot, tip=tip)
    rows = calib_pin.read_measurements(data_folder / file, chain, model="position").only
    result = calib_pin.calibrate(chain, rows, validate=False)
    assert [f.code for f in result.findings if f.severity == "error"] == []
    longer = replace(rows, values=1.05 * rows.values)
    result = calib_pin.calibrate(chain, longer, validate=False)
    assert "scale" in [f.code for f in result.findings if f.severity == "error"]


def test_pairs_that_are_exchanged_and_one_that_is_off(told) -> None:
    def change(block):
        values = block.values.copy()
        values[[10, 20, 30, 31]] = values[[20, 10, 31, 30]]
        values[50] += 1.0
        return {"values": values}

    found = told(change)
    lines = {"reading": {"exchanged": [[12, 22], [32, 33]]}}
    assert found["measurements-exchanged"].setup == lines
    assert found["outliers"].setup == {"reading": {"without": [52]}}


def test_many_outliers_are_counted(told) -> None:
    """Lines 7 to 20 are off; a message that names them all would not be read."""

    def change(block):
        values = block.values.copy()
        values[5:19] += np.random.default_rng(0).normal(0.0, 0.3, (14, 3))
        return {"values": values}

    found = told(change)["outlying-stretch"]
    assert found.message.startswith("lines 7, 8, 9 and 11 more: 14 of 55 ")
    assert len(found.message) < 300 and len(found.remedy) < 300


def test_a_stretch_of_lengths_in_feet(told) -> None:
    def change(block):
        values = block.values.copy()
        values[30:35, :3] /= 0.3048
        return {"values": values}

    found = told(change)["unit-of-some"]
    converted = [{"factor": 0.3048, "lines": [32, 36]}]
    assert found.setup == {"reading": {"converted": converted}}


def test_outliers_are_no_unit(told) -> None:
    def change(block):
        values = block.values.copy()
        values[[3, 20, 44]] += np.random.default_rng(1).normal(size=(3, 3))
        return {"values": values}

    assert set(told(change)) == {"outliers"}


@pytest.mark.parametrize(("repeats", "sure"), [(1, False), (2, True)])
def test_noise_that_is_stated_too_small(moved_job, repeats, sure) -> None:
    """Without repetitions nobody knows whether the robot has more errors."""
    job = moved_job((), ())
    block = job.plain.only.rows(np.repeat(np.arange(90), repeats))
    noise = 1e-4 * np.random.default_rng(0).normal(size=block.values.shape)
    sigma = np.full(noise.shape, 2e-5)
    rows = replace(block, values=block.values + noise, sigma=sigma)
    (finding,) = calib_pin.calibrate(job.chain, rows, validate=False).findings
    assert (finding.code, finding.severity) == ("noise", "warning")
    assert finding.evidence["factor"] == pytest.approx(5.5, rel=0.15)
    assert ("repeat" in finding.remedy) == (not sure)


def test_gains_that_draw_contacts_to_a_point_explain_nothing() -> None:
    """Those of a gantry free the scale: 0.03 mm of noise would drop to 0.0002 mm."""
    down = "0 0 -0.1"
    chain = chain_of(
        urdf_of(
            joint("x", "l0 l1", down, "1 0 0", "prismatic", "0 3"),
            joint("y", "l1 l2", down, "0 1 0", "prismatic", "0 2"),
            joint("z", "l2 l3", down, "0 0 1", "prismatic", "-0.8 0"),
            joint("c", "l3 l4", down),
            joint("a", "l4 l5", down, "1 0 0", limits="-1.7 1.7"),
        )
    )
    normals = (0, 0, 1), (1, 0, 0), (0, 1, 0), (1, 1, 0), (1, 0, 1)
    pairs = zip(normals, (-0.3, -1.0, -0.8, -2.2, -1.7), strict=True)
    planes = {f"p{k}": PlaneSetup(*plane) for k, plane in enumerate(pairs)}
    setup = Setup(tool_frame=FrameSetup((0.03, 0.02, -0.1)), planes=planes)
    job, _ = simulated("plane-contact", setup, 200, 1.0, robot=chain, noise=3e-5)
    rows = job.data.only
    result = calib_pin.calibrate(chain, rows, setup, validate=False)
    assert "model-lacks" not in {finding.code for finding in result.findings}
