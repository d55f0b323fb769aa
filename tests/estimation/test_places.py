"""Where the errors of joints are expected: at places that the axes alone tell."""

from __future__ import annotations

import numpy as np
import pytest

import calib_pin
from calib_pin.estimation.formulation import nominal_problem
from calib_pin.estimation.row_blocks import expected_places, feet
from calib_pin.kinematics.spatial import adjoint
from calib_pin.setup import Setup

ARM = calib_pin.load_chain("heavy6")


def test_places_of_an_arm() -> None:
    """The wrist, the elbow and the shoulder, each on its own axis."""
    found = feet(ARM)
    frames = ARM.joint_frames()
    places = frames[:, :3, 3] + np.einsum("nij,nj->ni", frames[:, :3, :3], found)
    tip = ARM.poses(np.zeros((1, 6)))[0, :3, 3]
    wrist = frames[4, :3, 3]
    np.testing.assert_allclose(places[5], tip, rtol=0, atol=1e-12)
    np.testing.assert_allclose(places[3:5], [wrist, wrist], rtol=0, atol=1e-12)
    np.testing.assert_allclose(found[1:3], 0.0, rtol=0, atol=1e-12)
    np.testing.assert_allclose(places[0], [0.0, 0.0, 0.675], rtol=0, atol=1e-12)


@pytest.mark.parametrize("family", ["placement", "link-transform"])
def test_independent_errors_at_a_place(family: str) -> None:
    """Seen from there translations and rotations are as large in every direction."""
    problem = nominal_problem(ARM, "position", Setup(parameters=(family,)))
    parameters, term = problem.parameters, problem.only
    C = expected_places(problem, parameters)
    for joint, place in zip(ARM.joints, feet(ARM), strict=True):
        own = [k for k, name in enumerate(parameters.names) if name.startswith(joint)]
        screws = [term.error.screws[term.index.tolist().index(k)] for k in own]
        twists = np.array([screw.twist for screw in screws]).T * parameters.scales[own]
        back = np.eye(4)
        back[:3, 3] = -place
        half = adjoint(back) @ twists @ C[np.ix_(own, own)] / parameters.scales[own]
        np.testing.assert_allclose(half @ half.T, np.eye(6), rtol=0, atol=1e-9)


def test_a_joint_with_a_fixed_error_has_its_frame() -> None:
    setup = Setup(fixed=("joint_1.placement.x",))
    problem = nominal_problem(ARM, "position", setup)
    own = [name.startswith("joint_1.") for name in problem.parameters.names]
    C = expected_places(problem, problem.parameters)
    np.testing.assert_array_equal(C[own], np.eye(len(own))[own])
    assert not np.array_equal(C, np.eye(len(own)))
