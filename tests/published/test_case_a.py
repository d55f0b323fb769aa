"""Liu, Ni, Liu, Xu 2012: a laser ranger on a plane, PUMA-like geometry.

doi 10.1007/s11771-012-1095-1. The nominal table of the publication is lost; `space6`
has the same structure with lengths of our own.
"""

from __future__ import annotations

import numpy as np
import pytest

import calib_pin
from calib_pin.estimation.solve import INVISIBLE
from calib_pin.setup import FrameSetup, PlaneSetup, Setup
from calib_pin.solvers.differential_evolution import TRADEOFF
from calib_pin.validation.result import Identification
from studies.liu2012_study import LEAST_SQUARES, Case, Settings, aligned, study

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


def test_poses_are_aligned_by_the_motions_that_no_ranger_sees() -> None:
    def about_z(angle: float, shift: float = 0.0) -> np.ndarray:
        T = np.eye(4)
        T[:2, :2] = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
        T[2, 3] = shift
        return T

    chain = calib_pin.load_chain("space6")
    q = chain.random_configurations(20, np.random.default_rng(0))
    true = chain.poses(q)
    moved = about_z(0.3, 0.1) @ true @ about_z(-0.2)
    np.testing.assert_allclose(aligned(moved, true), true, atol=1e-12)
    # Anything else stays: a shift aside, here.
    moved[:, 0, 3] += 0.01
    assert np.linalg.norm((aligned(moved, true) - true)[:, :3, 3], axis=1).max() > 5e-3


def rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2)))


@pytest.fixture(scope="module")
def solved() -> list[Case]:
    """The case of 100 configurations, for three seeds."""
    settings = Settings(counts=(100,), mutations=(TRADEOFF,))
    return [study(settings, seed).cases[100] for seed in range(3)]


@pytest.mark.slow
def test_evolution_finds_the_errors(solved: list[Case]) -> None:
    for case in solved:
        found, before = case[TRADEOFF], case.before
        assert np.abs(before.errors).max() > 30e-3
        assert np.abs(found.errors).max() < 0.25e-3
        assert found.squares < 1.01 * case[LEAST_SQUARES].squares
        # As much as the noise of 10 readings and 100 - 25 degrees of freedom.
        assert 0.6 < found.squares / (75 * (0.2e-3**2 / 10)) < 1.6
        assert found.history[-1] == pytest.approx(found.squares, rel=1e-9)
        assert found.history[0] > 1e4 * found.squares
        assert (np.diff(found.history) <= 0.0).all()
        for name, most in (("distance", 1e-4), ("position", 2e-4)):
            assert rms(getattr(found.validation, name)) < most
            assert rms(getattr(before.validation, name)) > 3e-3
        assert rms(found.validation.orientation) < 1e-4
        assert rms(before.validation.orientation) > 2e-3


@pytest.mark.slow
def test_hybrid_reaches_the_least_squares_optimum(solved: list[Case]) -> None:
    for case in solved:
        assert case.difference < INVISIBLE
        # Half a chi-square of 100 values: every error that is fitted comes with the
        # row of its expected size. Three standard deviations, 0.5 * 200^0.5 each.
        assert 29.0 < case.fits["hybrid"] < 71.0


@pytest.mark.slow
def test_tradeoff_is_faster_than_rand() -> None:
    settings = Settings(counts=(35,), generations=100, mutations=("rand/1", TRADEOFF))
    case = study(settings, 0).cases[35]
    assert case[TRADEOFF].squares < 0.1 * case["rand/1"].squares
