"""Simulated robots counted: accuracy against number of configurations."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from calib_pin.estimation.statistics.distributions import share_interval
from calib_pin.monte_carlo.study import Trial
from calib_pin.setup import LimitSetup

LEVELS = (0.05, 0.5, 0.95)
"""Levels of the quantiles that are told."""

QUANTITIES = "nominal", "position", "position_share", "orientation", "orientation_share"
"""Errors of a trial whose quantiles are told."""

Quantiles = tuple[float, float, float]


@dataclass(frozen=True)
class Outlook:
    """Robots after a calibration with one number of configurations.

    Attributes:
        configurations: The number of configurations.
        robots: Number of robots.
        failed: Number of those that could not be calibrated.
        nominal: Quantiles of the position error before, of `LEVELS` [m].
        position: Those of the position error after, rms over the workspace [m].
        position_share: Those of what a robot keeps within in 95 % of its workspace [m].
        orientation: As position, of orientations [rad].
        orientation_share: As position_share, of orientations [rad].
        coverage: Part of the robots that are within the bound which their fit states
            with 95 % confidence, with its 95 % interval; NaN without a bound.
        honesty: Actual by expected position error, root mean square over the robots.
        met: Part of the robots that are within the limit in 95 % of their workspace,
            with its 95 % interval; NaN without a limit.
    """

    configurations: int
    robots: int
    failed: int
    nominal: Quantiles
    position: Quantiles
    position_share: Quantiles
    orientation: Quantiles
    orientation_share: Quantiles
    coverage: tuple[float, float, float]
    honesty: float
    met: tuple[float, float, float]


def outlooks(trials: Iterable[Trial], limit: LimitSetup) -> tuple[Outlook, ...]:
    """The outlook for every number of configurations, ascending.

    Args:
        trials: The trials of all robots.
        limit: What has to be reached, of position and orientation.
    """
    by_count: dict[int, list[Trial]] = {}
    for trial in trials:
        by_count.setdefault(trial.configurations, []).append(trial)
    return tuple(_outlook(by_count[count], limit) for count in sorted(by_count))


def _outlook(trials: Sequence[Trial], limit: LimitSetup) -> Outlook:
    done = [trial for trial in trials if not trial.reason]
    quantiles = {n: _quantiles([getattr(t, n) for t in done]) for n in QUANTITIES}
    known = [trial for trial in done if math.isfinite(trial.bound)]
    covered = sum(trial.position <= trial.bound for trial in known)
    ratios = [(trial.position / trial.expected) ** 2 for trial in known]
    within = sum(_within(trial, limit) for trial in done)
    limited = limit.position is not None or limit.orientation is not None
    return Outlook(
        configurations=trials[0].configurations,
        robots=len(trials),
        failed=len(trials) - len(done),
        **quantiles,
        coverage=share_interval(covered, len(known)),
        honesty=math.sqrt(float(np.mean(ratios))) if ratios else math.nan,
        # A robot that cannot be calibrated does not meet its limit.
        met=share_interval(within, len(trials) if limited else 0),
    )


def _within(trial: Trial, limit: LimitSetup) -> bool:
    sizes = trial.position_share, trial.orientation_share
    limits = limit.position, limit.orientation
    pairs = zip(sizes, limits, strict=True)
    return all(allowed is None or size <= allowed for size, allowed in pairs)


def _quantiles(values: Sequence[float]) -> Quantiles:
    low, middle, high = np.quantile(values or [math.nan], LEVELS).tolist()
    return low, middle, high
