"""Check a calibration on measurements that were held out, and say what that is worth.

Only what the fit has not seen counts: rows that repeat a fitted configuration are left
out, an instrument that was moved is registered anew, and measurements that were set
aside count neither before nor after. Where too little is left there is no check.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from calib_pin.errors import InputError, OptionError
from calib_pin.estimation.evidence import Finding, Gain
from calib_pin.estimation.fitted import Fit
from calib_pin.kinematics.chain import Chain
from calib_pin.observations import Measurements
from calib_pin.progress import Stages
from calib_pin.setup import Setup
from calib_pin.validation.gains import PRESS, gains, press_check
from calib_pin.validation.moved_instrument import FEWEST, as_it_stands
from calib_pin.validation.splits import (
    clusters,
    folds,
    groups,
    shuffled_groups,
    validation_name,
)
from calib_pin.validation.training import Trained, cross_validate
from calib_pin.validation.unseen import Unseen

__all__ = ["Checked", "check", "counting", "split"]


@dataclass(frozen=True)
class Checked:
    """What held-out measurements say of a calibration.

    Attributes:
        rows: The rows that the positions of the parts belong to.
        parts: Errors of held-out rows; empty without a check.
        method: `set`, `file`, `holdout`, `5-fold`, ..., or `none`.
        gains: Paired tests of these, then those by the hat matrix.
        findings: What is wrong with the held-out rows.
        skipped: Why parts of a cross-validation were left out.
    """

    rows: Measurements
    parts: tuple[Unseen, ...] = ()
    method: str = "none"
    gains: tuple[Gain, ...] = ()
    findings: tuple[Finding, ...] = ()
    skipped: tuple[str, ...] = ()

    @property
    def counted(self) -> tuple[Unseen, ...]:
        """The parts without rows that are set aside."""
        return tuple(part.counted(self.rows.weight) for part in self.parts)


def check(
    chain: Chain,
    training: Measurements,
    setup: Setup,
    trained: Trained,
    seed: int,
    *,
    unseen: Measurements | None = None,
    method: str = "set",
    validate: bool = True,
    parts: Sequence[Unseen] | None = None,
    progress: Stages | None = None,
) -> Checked:
    """Look at rows that were not fitted, by cross-validation where there are none.

    Args:
        chain: The nominal chain.
        training: The rows that were fitted.
        setup: What was estimated, what is known.
        trained: What was fitted to all of them.
        seed: Seed of the split and of further fits.
        unseen: Rows that were held out; None for a cross-validation.
        method: How these were held out.
        validate: Whether to check at all; if not there is the hat matrix alone.
        parts: A cross-validation that was made before.
        progress: Told the stage and how much is done.
    """
    fitted = trained.fit
    rows = counting(training, fitted)
    if not validate:
        return Checked(rows, gains=_pressed(fitted, rows))
    if unseen is not None:
        return _checked_on(trained, rows, unseen, method)
    masks = folds(rows, fitted, seed)
    if parts is None:
        parts = tuple(cross_validate(chain, rows, setup, masks, seed, fitted, progress))
    # A part without which nothing fits tells nothing of the robot.
    kept = tuple(part for part in parts if not part.reason)
    labels = clusters(rows, setup)
    if not _enough(rows, kept):
        kept = ()
    name = validation_name(rows, setup, masks[: len(kept)])
    return Checked(
        rows,
        kept,
        name,
        gains(name, fitted.problem, rows, kept, labels) + _pressed(fitted, rows),
        skipped=tuple(part.reason for part in parts if part.reason),
    )


def counting(rows: Measurements, fitted: Fit) -> Measurements:
    """Rows with those that their fit has set aside, which keep their place."""
    aside = fitted.problem.data.weight == 0.0
    return replace(rows, weight=np.where(aside, 0.0, rows.weight))


def split(
    measurements: Measurements,
    setup: Setup,
    validation: Measurements | None,
    holdout: float | None,
    seed: int,
) -> tuple[Measurements, Measurements | None, str]:
    """Training rows, unseen rows if there are any, and how they were chosen.

    Raises:
        InputError: If no row is left to fit, or none of one model.
        OptionError: If the holdout is out of range, or not the only wish.
    """
    if validation is not None and holdout is not None:
        raise OptionError("give validation rows or a holdout, not both")
    training, unseen = measurements.split()
    if len(training) == 0:
        raise InputError("no row is left to fit: all are marked for validation")
    _require_parts(training, unseen, "all are marked for validation")
    if validation is not None:
        if len(validation) == 0:
            raise InputError("there are no rows to validate with")
        if validation.model != measurements.model:
            raise InputError(
                f"cannot check '{measurements.model}' measurements with "
                f"'{validation.model}' ones"
            )
        return training, validation, "file"
    if holdout is not None:
        mask = _held_out(training, setup, holdout, seed)
        kept, unseen = training.rows(~mask), training.rows(mask)
        _require_parts(kept, unseen, "the holdout took all")
        return kept, unseen, "holdout"
    return training, unseen if len(unseen) else None, "set"


def _held_out(
    rows: Measurements, setup: Setup, holdout: float, seed: int
) -> NDArray[np.bool_]:
    """The rows that a holdout takes, in whole groups.

    Raises:
        OptionError: If it is out of range or leaves nothing.
    """
    if not 0.0 < holdout < 1.0:
        raise OptionError(
            "holdout is out of range", value=holdout, allowed="between 0 and 1"
        )
    labels, order = shuffled_groups(rows, setup, seed)
    count = max(1, round(holdout * len(rows)))
    size = np.cumsum(np.bincount(labels)[order])
    chosen = np.zeros(len(order), bool)
    chosen[order[: int(np.searchsorted(size, count)) + 1]] = True
    mask = np.asarray(chosen[labels])
    if mask.all():
        raise OptionError("holdout leaves no row to fit", value=holdout)
    return mask


def _require_parts(training: Measurements, unseen: Measurements, why: str) -> None:
    """Refuse mixed measurements of which one model has no row to fit.

    Raises:
        InputError: If there is such a model.
    """
    for model, (_, rows) in unseen.by_part.items():
        if model not in training.by_part:
            raise rows.error(
                0, f"no '{model}' measurement is left to fit: {why}", column="set"
            )


def _checked_on(
    trained: Trained, training: Measurements, unseen: Measurements, method: str
) -> Checked:
    """The check on given rows."""
    fitted = trained.fit
    findings = []
    new = ~_repeated(training, unseen)
    if not new.all():
        some = f"{len(new) - int(new.sum())} of {len(new)}"
        findings.append(
            Finding(
                "repeated-validation",
                "warning",
                f"{some} validation measurements repeat configurations that were "
                "fitted and do not count",
                {"repeated": float(len(new) - new.sum()), "all": float(len(new))},
                "validate with configurations that were not fitted",
            )
        )
    pressed = _pressed(fitted, training)
    if unseen.rows(new).configurations < FEWEST:
        return Checked(unseen, (), "none", pressed, tuple(findings))
    rows = unseen.rows(new)
    part = trained.unseen(rows, np.flatnonzero(new))
    stand = as_it_stands(trained, part, replace(fitted.problem, data=rows))
    if stand.finding is not None:
        findings.append(stand.finding)
    if stand.unseen is None:
        return Checked(unseen, (), "none", pressed, tuple(findings))
    parts = (stand.unseen,)
    labels = clusters(unseen, fitted.problem.setup)
    found = gains(method, fitted.problem, unseen, parts, labels)
    return Checked(unseen, parts, method, found + pressed, tuple(findings))


def _repeated(training: Measurements, unseen: Measurements) -> NDArray[np.bool_]:
    """Rows at configurations that were fitted, shape (N,)."""
    q = np.concatenate([training.q[training.weight > 0.0], unseen.q])
    values = np.zeros((len(q), unseen.values.shape[1]))
    labels = Measurements(unseen.joints, q, unseen.model, values).groups()
    fitted = labels[: len(q) - len(unseen)]
    return np.isin(labels[len(fitted) :], fitted)


def _enough(rows: Measurements, parts: Sequence[Unseen]) -> bool:
    """Whether enough distinct configurations are held out to check anything."""
    if not parts:
        return False
    positions = np.concatenate([part.positions for part in parts])
    held_out = rows.rows(positions[rows.weight[positions] > 0.0])
    return held_out.configurations >= FEWEST


def _pressed(fitted: Fit, rows: Measurements) -> tuple[Gain, ...]:
    """Tests by the hat matrix; none without redundancy."""
    if not fitted.dof > 0:
        return ()
    setup = fitted.problem.setup
    part = press_check(fitted, rows, groups(rows, setup))
    return gains(PRESS, fitted.problem, rows, [part], clusters(rows, setup))
