"""An older calibration as a prior: what it knew, of noise and drift as well."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from calib_pin.errors import OptionError, enumerated
from calib_pin.estimation.evidence import TRUSTED
from calib_pin.kinematics.chains import Chains
from calib_pin.kinematics.robot_types import robot_type
from calib_pin.kinematics.spatial import Floats
from calib_pin.parameters import ParameterSet
from calib_pin.setup import JointPrior, Setup
from calib_pin.setup.population import ExpectedParameter
from calib_pin.validation.result import CalibrationResult
from calib_pin.validation.summaries import DriftSize, NoiseSize

EXPECTED = (DriftSize("geometry", 1e-5, 2.0), DriftSize("joint offsets", 3e-5, 2.0))
"""Drift between two calibrations that is expected where nothing is known yet."""

NOISE = 300.0
"""Values that known noise is worth at most."""

FLOOR = 1e-4
"""Least standard deviation of an error, in its expected size: far below any drift."""


def require_usable(chains: Chains, setup: Setup, start: CalibrationResult) -> None:
    """Refuse an older calibration that says nothing of this robot.

    Raises:
        OptionError: If it is such.
    """
    file, older = start.provenance.file or None, start.model

    def refused(reason: str, given: str = "", other: str = "") -> OptionError:
        return OptionError(
            reason, file=file, value=given or None, allowed=other or None
        )

    difference = robot_type(older.chains).difference(robot_type(chains))
    ends = [
        {(c[name].base, c[name].tip) for name in c.names}
        for c in (older.chains, chains)
    ]
    if not difference and ends[0] != ends[1]:
        base, tip = min(ends[1] - ends[0] or ends[1])
        difference = f"its chain goes from {base} to {tip}"
    if difference:
        reason = f"the older calibration is not of this robot: {difference}"
        raise refused(reason, chains.robot.name, older.chains.robot.name)
    before, serial = (one.report.serial_number for one in (older.setup, setup))
    if before and serial and before != serial:
        reason = f"the older calibration is of serial number '{before}', these "
        raise refused(f"{reason}measurements are of '{serial}' ({setup.file})")
    if start.verdict not in TRUSTED:
        reason = f"an older calibration that is {start.verdict} is no start"
        raise refused(f"{reason}: {start.reason}")
    if learned := older.setup.learned or setup.learned:
        reason = "a learned correction cannot be carried on from an older calibration"
        raise refused(reason, learned, "parameters alone")
    names = older.setup.parameters
    if set(names) != set(setup.parameters):
        reason = "the older calibration has other parameters"
        raise refused(reason, ", ".join(setup.parameters), ", ".join(names))
    if not np.isfinite(start.covariance).all() or not start.statistics.noise:
        raise refused(
            "the older calibration does not say how sure it is of its parameters",
            other="a calibration of this version, with noise and redundancy",
        )


def older_prior(
    given: ParameterSet,
    free: NDArray[np.bool_],
    start: CalibrationResult,
    noise: Mapping[str, float],
) -> JointPrior:
    """The errors of the robot as the older calibration knew them.

    Raises:
        OptionError: If it has not estimated the same ones.
    """
    own = [p for p, of in zip(given, free, strict=True) if of and not p.nuisance]
    known = {p.name: k for k, p in enumerate(start.parameters) if p.status != "fixed"}
    if lacking := [p.name for p in own if p.name not in known]:
        raise OptionError(
            f"the older calibration has not estimated {enumerated(lacking)}",
            file=start.provenance.file or None,
            allowed="the same 'fixed' in both",
        )
    index = [known[p.name] for p in own]
    scales = np.array([p.scale for p in own])
    covariance = np.asarray(start.covariance)[np.ix_(index, index)]
    squares, vectors = np.linalg.eigh(covariance / np.outer(scales, scales))
    scaled = (vectors * np.maximum(squares, FLOOR**2)) @ vectors.T
    found = [(p, start.parameters[k].value) for p, k in zip(own, index, strict=True)]
    return JointPrior(
        robot=robot_type(start.model.chains),
        parameters=tuple(ExpectedParameter(p.name, p.unit, v) for p, v in found),
        covariance=covariance_rows(scaled * np.outer(scales, scales)),
        noise=noise,
        file=start.provenance.file,
    )


def covariance_rows(covariance: Floats) -> tuple[tuple[float, ...], ...]:
    """A covariance as plain data, to the last digit symmetric."""
    return tuple(map(tuple, (0.5 * (covariance + covariance.T)).tolist()))


def expected_drifts(
    start: CalibrationResult, process_noise: float | None
) -> tuple[DriftSize, ...]:
    """The drift since an older calibration before it is compared.

    Raises:
        OptionError: If the stated drift is none.
    """
    if process_noise is not None:
        if not 0.0 < process_noise < np.inf:
            raise OptionError(
                "the process noise is a standard deviation",
                value=process_noise,
                allowed="a positive number [m, rad]",
            )
        return (DriftSize(EXPECTED[0].name, process_noise, np.inf),)
    before = () if start.recalibration is None else start.recalibration.last.drifts
    # What a user has stated once, says nothing of the next time.
    found = {drift.name: drift for drift in before if np.isfinite(drift.worth)}
    return tuple(found.get(drift.name, drift) for drift in EXPECTED)


def pooled_noise(start: CalibrationResult) -> tuple[NoiseSize, ...]:
    """The noise of all quantities by an older calibration and those before it."""
    before = () if start.recalibration is None else start.recalibration.last.noise
    found = {one.quantity: one for one in before}
    for own in start.statistics.noise:
        name, left = own.quantity.split(" ")[0], own.redundancy * own.values
        known = found.get(name, NoiseSize(name, 0.0, 0.0))
        worth = known.worth + left
        if own.estimate > 0.0 and left > 0.0:
            square = known.worth * known.sigma**2 + left * own.estimate**2
            sigma = float(np.sqrt(square / worth))
            found[name] = NoiseSize(name, sigma, min(worth, NOISE))
    return tuple(found.values())


def wider(
    prior: JointPrior,
    scales: Floats,
    effects: Sequence[tuple[float, Floats]],
) -> JointPrior:
    """A prior that is wider by effects of some sizes on its scaled parameters.

    Args:
        prior: The prior of K parameters.
        scales: Their scales, shape (K,).
        effects: Sizes and directions, of the scaled parameters, shapes (K, k).
    """
    covariance = np.array(prior.covariance)
    for size, directions in effects:
        half = size * scales[:, None] * directions
        covariance += half @ half.T
    return replace(prior, covariance=covariance_rows(covariance))
