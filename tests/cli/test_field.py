"""Files as people have them: read rightly as they are, or one line says what to change.

A UR5 with true errors is measured; what controllers, trackers and spreadsheets make of
its numbers is written, and `init` and `calibrate` have nothing else.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

import calib_pin
from calib_pin.cli import main
from calib_pin.cli.files import open_chains, open_rows
from calib_pin.cli.options import OfRobot
from calib_pin.kinematics.spatial import Floats, so3_log
from calib_pin.setup import FrameSetup, Setup
from tests.shared import simulated

ROBOT = "example:ur5_robot"
NOISE = 3e-5
JOINTS = calib_pin.load_chain(ROBOT, tip="tool0").joints


pytestmark = pytest.mark.usefixtures("alone")


@dataclass(frozen=True)
class Job:
    """Joint positions, what the controller takes the flange for, and measured points.

    Attributes:
        q: Joint positions, shape (N, 6) [rad].
        T: Poses of the nominal robot, shape (N, 4, 4).
        points: Measured points, shape (N, 3) [m].
    """

    q: Floats
    T: Floats
    points: Floats


@pytest.fixture(scope="module")
def job() -> Job:
    chain = calib_pin.load_chain(ROBOT, tip="tool0")
    tool = FrameSetup((0.03, 0.02, 0.11))
    base = FrameSetup((1.9, -0.6, 0.35), (0.1, -0.2, 0.9))
    setup = Setup(tool_frame=tool, base_frame=base)
    problem, _ = simulated("position", setup, 40, 1.0, 7, robot=chain, noise=NOISE)
    rows = problem.data.only
    return Job(rows.q, chain.poses(rows.q), rows.values)


def text(columns: Mapping[str, Floats], separator: str = ",", digits: int = 6) -> str:
    """A file of columns; those with several numbers have them side by side."""
    names = [name for many in columns for name in many.split()]
    rows = np.column_stack(list(columns.values()))
    lines = [separator.join(f"{v:.{digits}f}" for v in row) for row in rows]
    return "\n".join([separator.join(names), *lines]) + "\n"


def named(pattern: str, count: int = 6) -> str:
    return " ".join(pattern.format(k) for k in range(count))


XYZ = "x y z"
OWN = " ".join(JOINTS)


def a_lost_joint(job: Job) -> str:
    """A file that has no position of a joint in every seventh row."""
    q = job.q.copy()
    q[2::7, 2] = np.nan
    return text({named("j{}"): q, XYZ: job.points})


def computed(job: Job) -> Mapping[str, Floats]:
    """Columns that a controller writes beside its joints."""
    poses = np.hstack([job.T[:, :3, 3], so3_log(job.T[:, :3, :3])])
    return {OWN: job.q, "tcp_x tcp_y tcp_z tcp_rx tcp_ry tcp_rz": poses}


READ: Mapping[str, Callable[[Job], str | bytes]] = {
    "elements of a list": lambda job: text(
        {
            named("q[{}]"): job.q,
            named("q_d[{}]"): job.q + 1e-3 * np.sin(9.0 * job.q),
            XYZ: job.points,
        }
    ),
    "computed by the controller, tcp": lambda job: text(
        {**computed(job), "laser_x[mm] laser_y[mm] laser_z[mm]": 1e3 * job.points}
    ),
    "computed by the controller, xyz": lambda job: text(
        {OWN: job.q, XYZ: job.T[:, :3, 3], "X[mm] Y[mm] Z[mm]": 1e3 * job.points}
    ),
    "computed by the controller, steps": lambda job: text(
        {
            "j1 j2 j3 j4 j5 j6": np.degrees(job.q).round(3),
            "X Y Z": 1e3 * job.T[:, :3, 3].round(5),
            "LT_X LT_Y LT_Z": 1e3 * job.points,
        }
    ),
    "a joint that is missing": a_lost_joint,
    "sorted by name": lambda job: text(
        {named("position_{}"): job.q[:, np.argsort(JOINTS)], XYZ: job.points}
    ),
    "letters, among speeds and commands": lambda job: text(
        {named("qd{}"): 0.1 * job.q[::-1], "S L U R B T": np.degrees(job.q)}
        | {"X_meas Y_meas Z_meas": 1e3 * job.points}
        | {"X_cmd Y_cmd Z_cmd": 1e3 * job.points + 20.0 * job.q[:, :3]}
    ),
    "a unit for each column": lambda job: text(
        {OWN: job.q * [*[1.0] * 5, 180.0 / np.pi], XYZ: job.points}
    ),
    "scatter in the unit of numbers": lambda job: text(
        {OWN: job.q, XYZ: 1e3 * job.points}
        | {"sigma_x sigma_y sigma_z": np.full((40, 3), 1e3 * NOISE)}
    ),
    "another language": lambda job: text(
        {" ".join(f"Achse_{k}[Grad]" for k in range(6)): np.degrees(job.q)}
        | {"Ist_X(mm) Ist_Y(mm) Ist_Z(mm)": 1e3 * job.points}
        | {"Punkt": np.arange(40.0)}
    ),
}


def written(content: str | bytes) -> None:
    data = content if isinstance(content, bytes) else content.encode()
    Path("rows.csv").write_bytes(data)


@pytest.mark.parametrize("name", READ)
def test_a_file_is_read_as_it_is(name, job):
    """Every number is where it belongs, in its unit."""
    written(READ[name](job))
    assert main(["init", ROBOT, "rows.csv", "-o", "s.yaml"]) == 0
    setup = calib_pin.read_setup("s.yaml")
    asked = OfRobot(robot=ROBOT)
    chains = open_chains(asked, setup)
    _, found = open_rows(asked, [Path("rows.csv")], chains, setup, quiet=True)
    rows = found.only
    measured = rows.lines - rows.lines[0]
    assert len(rows) == (34 if "missing" in name else 40)
    # To the digits that were written.
    np.testing.assert_allclose(rows.q, job.q[measured], rtol=0, atol=1e-5)
    np.testing.assert_allclose(rows.values, job.points[measured], rtol=0, atol=1e-6)
    if "scatter" in name:
        np.testing.assert_allclose(rows.sigma, NOISE, rtol=1e-6)


def test_a_line_says_what_to_change(job, fails):
    """Where the controller's own position is all that is measured, or no joint is."""
    init, flange = f"init {ROBOT} rows.csv -o s.yaml", {XYZ: job.T[:, :3, 3]}
    written(text({OWN: job.q, **flange}))
    fails(init, "computed from the joints by the controller")
    written(text({**flange, "X[mm] Y[mm] Z[mm]": 1e3 * job.points}))
    fails(init, "joint positions are needed", "controller")


@pytest.mark.parametrize(
    ("rows", "fits"), [([3], True), ([3, 9, 20], True), (..., False)]
)
def test_a_few_lost_targets_hide_no_fit(rows, fits, job, capsys):
    """What stands there for them is a number once, and no sign of anything."""
    points = job.points.copy()
    points[rows] = -1.0 + 0.3 * np.sin(np.arange(120.0).reshape(40, 3)[rows])
    written(text({OWN: job.q, XYZ: points}))
    assert main(["init", ROBOT, "rows.csv", "-o", "s.yaml"]) == 0
    assert ("NO fit" not in Path("s.yaml").read_text()) == fits
    said = f"far off all others: {len(rows)} of 40" if fits else "no reading"
    assert said in capsys.readouterr().err
