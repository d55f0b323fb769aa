"""Ranks of blocks, alone and beside others."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from calib_pin.estimation.directions import WEAK, projected
from calib_pin.estimation.fit import fit_model
from calib_pin.estimation.fitted import Fit
from calib_pin.observations import Observations
from calib_pin.setup import Setup
from calib_pin.validation.shared import block_ranks


def rank(fitted: Fit, kept: Observations) -> int:
    """The rank of some blocks from all of their rows at once."""
    problem = replace(fitted.problem, data=kept)
    _, J = problem.linearize_rows(fitted.theta)
    parameters = problem.parameters
    A = J[: len(problem.sigma)] * parameters.scales
    robot = np.column_stack([fitted.directions.robot, fitted.directions.weak])
    s = np.linalg.svd(projected(A @ robot, A, parameters), compute_uv=False)
    return int((s * WEAK > fitted.sigma0).sum())


def test_ranks_are_those_of_all_rows_at_once(moved_job) -> None:
    seed = 0
    job = moved_job((30, 60), (45,), seed=seed)
    rng = np.random.default_rng(seed)
    blocks = []
    for k, block in enumerate(job.named.blocks):
        # Each block moves some joints only.
        still = [joint for joint in range(6) if joint not in (k, k + 1, k + 2)]
        q = block.q.copy()
        q[:, still] = q[0, still]
        at = replace(job.problem, data=Observations.of(replace(block, q=q)))
        values = at.predict(job.theta, at.data.only)
        values += 5e-5 * rng.normal(size=values.shape)
        blocks.append(replace(block, q=q, values=values))
    data = Observations.of(*blocks)
    fitted = fit_model(job.chain, data, Setup(), 0).fit
    found = block_ranks(fitted)
    whole = rank(fitted, data)
    for k, block in enumerate(blocks):
        others = Observations.of(*blocks[:k], *blocks[k + 1 :])
        assert found[k][0] == rank(fitted, Observations.of(block))
        assert found[k][1] == whole - rank(fitted, others)
    assert max(alone for alone, _ in found) < whole
    assert max(added for _, added in found) > 0
