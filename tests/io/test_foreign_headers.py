"""The meaning of columns with foreign names."""

from __future__ import annotations

import numpy as np
import pytest

import calib_pin.io.foreign_headers as headers
from calib_pin.io.columns import Column, split_header


def columns(header: str) -> tuple[headers.Foreign, ...]:
    """Columns of numbers that move, below such a header."""
    rows = np.random.default_rng(0).normal(size=(9, header.count(",") + 1)).T
    named = {
        split_header(cell)[0]: Column(cell, split_header(cell)[1], numbers)
        for cell, numbers in zip(header.split(","), rows, strict=True)
    }
    return headers.foreign(named)


@pytest.mark.parametrize(
    ("header", "ours"),
    [
        ("X,Y,Z", {"x": "X"}),
        ("px,py,pz", {"y": "py"}),
        ("X_cmd,Y_cmd,Z_cmd,X_meas,Y_meas,Z_meas", {"x": "X_meas"}),
        ("x Ist (mm),y Ist (mm),z Ist (mm)", {"z": "z Ist (mm) [mm]"}),
        ("tcp_x,tcp_y,tcp_z,laser_x[mm],laser_y[mm],laser_z[mm]", {"x": "laser_x"}),
        ("p_1,p_2,p_3", {"x": "p_1", "z": "p_3"}),
        ("tvec[0],tvec[1],tvec[2]", {"y": "tvec[1]"}),
        ("rvec_x,rvec_y,rvec_z,tvec_x,tvec_y,tvec_z", {"x": "tvec_x", "rx": "rvec_x"}),
        ("q_RS_w,q_RS_x,q_RS_y,q_RS_z", {"qw": "q_RS_w"}),
        ("X1,X2,Y1,Y2,Z1,Z2", {"x": "X1", "y": "Y1", "z": "Z1"}),
        ("NomX,NomY,NomZ,ActX,ActY,ActZ", {"x": "ActX"}),
        ("rx,ry,rz,rw", {"qx": "rx", "qw": "rw"}),
        ("sigma_x,vel_y,x_std", {}),
        ("Messuhr (um)", {"dial": "Messuhr (um) [um]"}),
        ("Abstand [mm],Zeit", {"distance": "Abstand", "time": "Zeit"}),
        ("Seil (cm)", {"distance": "Seil (cm) [cm]"}),
        ("x,y", {"x": "x", "y": "y"}),
        ("u,x", {}),
    ],
)
def test_what_is_measured(header, ours):
    found = headers.measured(columns(header))
    told = {name: one.setup_name(one.unit) for name, (one, *_) in found.items()}
    assert told.items() >= ours.items() and (ours or not told)


@pytest.mark.parametrize(
    ("header", "names"),
    [
        ("qd1,qd2,A1,A2", "A1 A2"),
        ("q[0],q[1],q_d[0],q_d[1]", "q[0] q[1]"),
        ("q1_cmd,q2_cmd,q1_actual,q2_actual", "q1_actual q2_actual"),
        ("analog1,analog2,J1 (deg),J2 (deg)", "J1 (deg) J2 (deg)"),
        ("q1,q3", ""),
    ],
)
def test_numbers_of_joints(header, names):
    found = headers.families(columns(header))
    assert " ".join(one.name for one in (found or [[]])[0]) == names


def test_joints_by_name():
    found = columns("Elbow.pos [deg],elbow.goal,left_elbow_angle,elbow_vel,S,x,y,z")
    joints = headers.joints_by_name(found, ["elbow", "left_elbow", "wrist"])
    named = {joint: one.setup_name(one.unit) for joint, one in joints.items()}
    assert named == {"elbow": "Elbow.pos", "left_elbow": "left_elbow_angle"}
    meant = [one for choices in headers.measured(found).values() for one in choices]
    assert [one.name for one in found if one not in meant][-1] == "S"
