"""Liu, Ni, Liu, Xu 2012: a laser ranger on a plane, PUMA-like geometry.

doi 10.1007/s11771-012-1095-1. The nominal table of the publication is lost; `space6`
has the same structure with lengths of our own.
"""

from __future__ import annotations

import pytest

import calib_pin
from calib_pin.result import Identification
from calib_pin.setup import FrameSetup, PlaneSetup, Setup

KNOWN = FrameSetup(estimate=False)
FREE = FrameSetup(estimate=True)
INCLINED = (0.0, 1.0, 4.6)


def found(
    parameters: str, normal: tuple[float, float, float], *, plane: bool, tool: bool
) -> Identification:
    setup = Setup(
        parameters=(parameters,),
        base_frame=KNOWN,
        tool_frame=FREE if tool else KNOWN,
        planes={"wall": PlaneSetup(normal, -0.69, estimate=plane)},
    )
    return calib_pin.identify(calib_pin.load_chain("space6"), "plane-distance", setup)


@pytest.mark.parametrize(
    ("parameters", "tool", "rank"),
    [("dh-full", False, 25), ("dh", False, 24), ("placement", True, 26)],
)
def test_ranks_with_the_plane_estimated(parameters: str, tool: bool, rank: int) -> None:
    ranks = found(parameters, INCLINED, plane=True, tool=tool).identifiability
    assert ranks.structural_rank == rank
    assert ranks.gap > 1e6


def test_freeing_the_plane_adds_nothing_to_placements() -> None:
    for plane in (True, False):
        result = found("placement", INCLINED, plane=plane, tool=True)
        assert result.identifiability.structural_rank == 26


def test_parallel_axes_have_beta_in_place_of_d() -> None:
    names = [p.name for p in found("dh", INCLINED, plane=True, tool=False).parameters]
    assert "joint_2.dh.beta" in names and "joint_2.dh.d" not in names
    assert sum(".dh.beta" in name for name in names) == 1
    assert sum(".dh." in name for name in names) == 24


def test_a_plane_across_z0_hides_four_parameters() -> None:
    """The source names theta_1, a_1, d_3; theta_6 turns the beam about itself."""
    result = found("dh", (0.0, 0.0, 1.0), plane=False, tool=False)
    hidden = {p.name for p in result.parameters if p.status == "unidentifiable"}
    assert hidden == {
        "joint_1.dh.theta",
        "joint_1.dh.a",
        "joint_3.dh.d",
        "joint_6.dh.theta",
    }
    assert not result.groups
    assert result.identifiability.structural_rank == 20
