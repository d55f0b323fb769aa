"""The verdict: what a user may do with a calibration, in one word and one sentence.

It reads what the other modules have found and finds nothing by itself.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from calib_pin.estimation.evidence import (
    ExpectedAccuracy,
    Finding,
    Gain,
)
from calib_pin.estimation.fitted import Fit
from calib_pin.estimation.problem import distinct_values, known_values
from calib_pin.estimation.statistics.distributions import chi_square_quantile, f_tail
from calib_pin.parameterizations.base import expected_size
from calib_pin.setup import JointPrior
from calib_pin.units import DISPLAY
from calib_pin.validation.accuracy import Accuracy, QuantityErrors
from calib_pin.validation.gains import PRESS

SCALE = (
    "the absolute scale is unobservable: a robot larger by any factor fits these "
    "measurements as well"
)
"""Why a robot of unknown size must not be trusted."""

MISSING = (
    "add a known length: a distance between two sockets, say ('distances' in the setup "
    "file), or a length of the robot that is held ('fixed')"
)
"""The advice where no distance is stated."""

STATED = (
    "the stated distances are too uncertain, or their ends are not measured, or set "
    "aside"
)
"""The advice where there are distances."""

CHECK = (
    "check the base and tip links, the joint columns with their signs and offsets, and "
    "units"
)
"""The advice about measurements that nothing explains."""


NAMED = 3
"""Causes that a reason names; findings name all of them."""


@dataclass(frozen=True)
class VerdictOptions:
    """Limits of the verdict.

    Attributes:
        unexplained: Remaining errors, in expected sizes of an error, that no
            calibration leaves.
        breakdown: Part of the configurations beyond which what is set aside may be
            the better part.
        clusters: Independent held-out configurations, or stretches of a path,
            without which a fit counts as unchecked.
        configurations: Distinct configurations without which it does.
        redundant: Redundant values by which noise that nobody has stated is known
            to a factor of two. By fewer it comes out less than half as large in one
            of a hundred cases.
        gain_chance: Probability by chance below which a gain counts as shown.
        loss_chance: Probability by chance below which a loss on held-out
            measurements takes the trust. Of a thousand perfect robots one is
            refused.
        misjudged: Found by predicted held-out error from which a fit misjudges
            itself.
        exact: Gain on exact measurements, in given standard deviations, below which
            it is numerically zero.
        sure: Probability that the corrected robot is better over the workspace for
            `good`. Of 345 simulated jobs with 0.95 or more, narrow ones and paths
            among them, one was worse; a real arm of a humanoid, measured in front
            of it, has 0.95.
    """

    unexplained: float = 20.0
    breakdown: float = 0.4
    clusters: int = 5
    configurations: int = 8
    redundant: float = 10.0
    gain_chance: float = 0.01
    loss_chance: float = 1e-3
    misjudged: float = 2.0
    exact: float = 1e-6
    sure: float = 0.9


OPTIONS = VerdictOptions()


@dataclass(frozen=True)
class Grounds:
    """The grounds of a verdict.

    Attributes:
        fitted: The fit.
        errors: Accuracy by quantity.
        gains: Paired tests on held-out configurations, the first of all quantities.
        findings: Defects of the data or the result.
        workspaces: Accuracy to expect over the workspace of each chain; empty where
            nothing is known.
        aside: Part of the configurations that was set aside, or would have to be.
        causes: Those of them from which errors follow that no robot explains.
    """

    fitted: Fit
    errors: Sequence[QuantityErrors]
    gains: Sequence[Gain]
    findings: Sequence[Finding]
    workspaces: Mapping[str, ExpectedAccuracy]
    aside: float = 0.0
    causes: Sequence[Finding] = ()

    @property
    def worst(self) -> tuple[str, ExpectedAccuracy | None]:
        """The chain that is the least sure to be better, and its accuracy.

        Of several chains one that nothing has corrected is as good as it was.
        """
        found = {n: w for n, w in self.workspaces.items() if w.nominal != w.calibrated}
        found = found or dict(self.workspaces)
        if not found:
            return "", None
        name = min(found, key=lambda name: found[name].better)
        told = f" of the chain '{name}'" if name and len(self.workspaces) > 1 else ""
        return told, found[name]


def verdict(grounds: Grounds) -> tuple[str, str]:
    """`good`, `no-gain`, `unchecked` or `untrusted`, and the reason."""
    if reason := _distrust(grounds):
        return "untrusted", reason
    nothing = _chance(grounds) > OPTIONS.gain_chance
    if reason := _unchecked(grounds):
        if nothing and _as_nominal(grounds.fitted):
            return "no-gain", _nothing(grounds)
        return "unchecked", reason
    first = grounds.gains[0]
    # Where parts are left out little may be left; the hat matrix leaves out one each.
    chances = [g.better for g in grounds.gains if g.quantity == first.quantity]
    shown = first.mean > 0.0 and min(chances) < OPTIONS.gain_chance
    if nothing and not shown:
        return "no-gain", _nothing(grounds)
    if reason := _disproved(grounds):
        return "untrusted", reason
    return _gain(grounds, shown, nothing)


def unexplained(fitted: Fit, errors: Sequence[QuantityErrors]) -> str:
    """The errors that no calibration explains; empty where there are none."""
    free = fitted.problem.parameters.free & ~fitted.problem.parameters.nuisance
    enough = distinct_values(fitted.problem) >= fitted.structure.rank
    if enough and free.any() and fitted.directions.robot.shape[1] == 0:
        return "the errors are so large that no robot parameter is observable"
    for quantity in errors:
        for accuracy in (quantity.after, quantity.validation_after):
            if accuracy and (
                reason := too_large(quantity.name, quantity.unit, accuracy)
            ):
                return reason
    return ""


def too_large(name: str, unit: str, found: Accuracy) -> str:
    """Why errors of a quantity are more than a robot has; empty where they are not."""
    if not found.rms > OPTIONS.unexplained * expected_size(unit):
        return ""
    size = _shown(found.rms, unit)
    return (
        f"{name} errors of {size} rms remain, far more than a robot's geometry explains"
    )


def _distrust(grounds: Grounds) -> str:
    """The reason to distrust a fit whatever a check says."""
    fitted = grounds.fitted
    if causes := grounds.causes:
        return told(causes)
    if not fitted.structure.scaled:
        stated = bool(fitted.problem.setup.distances)
        return f"{SCALE}; {STATED if stated else MISSING}"
    if not fitted.result.status.success:
        return fitted.result.status.advice
    if grounds.aside > OPTIONS.breakdown:
        return (
            f"{100.0 * grounds.aside:.0f} % of the configurations are outliers; beyond "
            f"{100.0 * OPTIONS.breakdown:.0f} % they cannot be told from the others; "
            f"{CHECK}"
        )
    if reason := unexplained(fitted, grounds.errors):
        return f"{reason}; {CHECK}"
    for finding in grounds.findings:
        if finding.severity == "error":
            return "; ".join(filter(None, (finding.message, finding.remedy)))
    return ""


def told(findings: Sequence[Finding]) -> str:
    """The first of some findings as one sentence, with what corrects them."""
    said = [finding.message for finding in findings[:NAMED]]
    if len(findings) > NAMED:
        said.append(f"and {len(findings) - NAMED} more")
    remedies = dict.fromkeys(finding.remedy for finding in findings)
    return "; ".join(filter(None, (*said, *remedies)))


def _unchecked(grounds: Grounds) -> str:
    """The reason why there is no check; empty where there is one."""
    fitted = grounds.fitted
    values, rank = known_values(fitted.problem), fitted.structure.rank
    known = "values and priors" if fitted.problem.further.priors else "values"
    if values < rank:
        return (
            f"{values} measured {known} cannot determine {rank} identifiable "
            "parameters; measure more configurations or estimate fewer parameters"
        )
    if values <= fitted.rank:
        return (
            f"{values} measured {known} for {fitted.rank} estimated parameters leave "
            "nothing to check the fit with; measure more configurations"
        )
    left = sum(v.redundancy * v.values for v in fitted.noise)
    sure = all(noise.stated and not noise.contradicted for noise in fitted.noise)
    prior = fitted.problem.setup.prior
    sure |= isinstance(prior, JointPrior) and bool(prior.noise)
    if not sure and left < OPTIONS.redundant:
        return (
            f"{left:.1f} redundant values are too few to estimate the noise; measure "
            "more configurations, or state the standard deviations"
        )
    held = grounds.gains[0].configurations if grounds.gains else 0
    data = fitted.problem.data
    distinct = data.rows(data.weight > 0.0).configurations
    # Exact rows say by one what noisy ones say by many.
    least = (OPTIONS.clusters, OPTIONS.configurations) if fitted.noise else (1, 1)
    if held < least[0] or distinct < least[1]:
        return (
            f"{held} independent held-out configurations of {distinct} are too few to "
            "check the fit with; measure more configurations"
        )
    return ""


def _disproved(grounds: Grounds) -> str:
    """The objection of held-out measurements to the fit; empty where there is none."""
    units = {quantity.name: DISPLAY[quantity.unit] for quantity in grounds.errors}
    # A quantity says more than all of them together, which have no unit.
    for gain in sorted(grounds.gains, key=lambda gain: gain.quantity not in units):
        if gain.worse < OPTIONS.loss_chance:
            unit, factor = units.get(gain.quantity, ("standard deviations", 1.0))
            return (
                "on held-out measurements the corrected robot is worse than the "
                f"nominal one: {gain.quantity} errors larger by "
                f"{-factor * gain.mean:.3g} +- {factor * gain.deviation:.1g} {unit}"
            )
    first = grounds.gains[0]
    # Of few configurations the ratio itself is uncertain.
    limit = OPTIONS.misjudged * (1.0 + 2.0 / np.sqrt(2.0 * first.configurations))
    if first.ratio > limit:
        return (
            f"errors on held-out measurements are {first.ratio:.1f} times as large as "
            "the fit predicts"
        )
    return ""


def _gain(grounds: Grounds, shown: bool, nothing: bool) -> tuple[str, str]:
    """`good` where a gain is shown, here and over the workspace; else why not.

    Shown is by held-out measurements; nothing, that the errors may be chance.
    """
    gain, (chain, workspace) = grounds.gains[0], grounds.worst
    name, before, after = _errors(grounds)
    held = f"{gain.configurations} independent held-out configurations"
    found = f"{name} error {after} rms instead of {before}"
    first = grounds.errors[0].validation_before
    last = grounds.errors[0].validation_after
    if gain.mean > 0.0 and first and last and last.rms > first.rms:
        # A few that nobody can predict, near the plane of a camera say, outweigh all.
        found = (
            f"errors smaller by {gain.mean:.2g} +- {gain.deviation:.1g} of their "
            "standard deviations"
        )
    if workspace is None:
        # Exact rows leave no doubt.
        return "good", f"{found} on {held}"
    nominal, calibrated = (
        _shown(size[0], "m") for size in (workspace.nominal, workspace.calibrated)
    )
    sure = workspace.better >= OPTIONS.sure
    if shown and sure:
        return "good", (
            f"{found} on {held}; over the workspace{chain} {calibrated} instead of "
            f"{nominal} are expected"
        )
    halved = workspace.calibrated[0] < 0.5 * workspace.nominal[0]
    if not shown and sure and halved:
        return "unchecked", (
            f"{held} do not confirm the correction: {found}; measure more "
            "configurations"
        )
    if nothing or not shown:
        return "no-gain", _nothing(grounds)
    return "untrusted", (
        "the corrected robot is better where it was measured, but over the workspace"
        f"{chain} {calibrated} instead of {nominal} are expected, better with a "
        f"probability of only {100.0 * workspace.better:.0f} %; measure configurations "
        "that differ more"
    )


def _as_nominal(fitted: Fit) -> bool:
    """Whether the nominal robot leaves no more than what is stated or assumed.

    Frames and instrument alone explain a few values, which then say nothing of it.
    """
    plain = replace(fitted.problem, units=np.zeros(0))
    nuisances = int((plain.parameters.free & plain.parameters.nuisance).sum())
    left = plain.count - nuisances
    if left < OPTIONS.redundant:
        return False
    return 2.0 * plain.cost(fitted.before) < chi_square_quantile(
        left, OPTIONS.loss_chance
    )


def _nothing(grounds: Grounds) -> str:
    """The reason why nothing is to be corrected."""
    name, before, after = _errors(grounds)
    count = grounds.gains[0].configurations if grounds.gains else 0
    return (
        f"the measurements show no error of the robot: {name} error {before} rms as it "
        f"is, {after} corrected, on {count} independent held-out configurations"
    )


def _chance(grounds: Grounds) -> float:
    """Probability of so large errors by chance if the robot were as nominal."""
    fitted, evidence = grounds.fitted, grounds.fitted.evidence
    if evidence is None or evidence.count == 0:
        # Exact rows leave no doubt, but for rounding.
        return float(all(abs(gain.mean) < OPTIONS.exact for gain in grounds.gains))
    return f_tail(evidence.square / evidence.count, evidence.count, max(fitted.dof, 1))


def _errors(grounds: Grounds) -> tuple[str, str, str]:
    """The first quantity that was held out, its errors before and after."""
    method = grounds.gains[0].method if grounds.gains else PRESS
    for quantity in grounds.errors:
        pair = quantity.validation_before, quantity.validation_after
        if method == PRESS or not all(pair):
            # Without rows of its own the test leaves out one configuration each.
            pair = quantity.before, quantity.after
        before, after = (_shown(a.rms, quantity.unit) for a in pair if a)
        return quantity.name, before, after
    return "", "", ""


def _shown(size: float, unit: str) -> str:
    shown, factor = DISPLAY[unit]
    return f"{factor * size:.3g} {shown}"
