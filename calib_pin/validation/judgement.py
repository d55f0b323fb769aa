"""The judgement of a fit: its accuracy, what is wrong with it, the verdict.

The verdict says what a user may do with a calibration, in one word and one sentence. It
reads what the other modules have found and finds nothing by itself.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from calib_pin.estimation.evidence import ExpectedAccuracy, Finding, Gain
from calib_pin.estimation.fit import with_effects
from calib_pin.estimation.fitted import Fit
from calib_pin.estimation.problem import (
    Problem,
    distinct_values,
    known_count,
    known_values,
)
from calib_pin.estimation.statistics.distributions import chi_square_quantile, f_tail
from calib_pin.estimation.statistics.variance_components import unplaced
from calib_pin.parameterizations.base import expected_size
from calib_pin.progress import Progress
from calib_pin.setup import JointPrior
from calib_pin.units import DISPLAY
from calib_pin.validation.findings import LACKS, Findings, find
from calib_pin.validation.findings.case import (
    DOUBTFUL,
    FOREIGN,
    MEASUREMENTS,
    Case,
    Others,
)
from calib_pin.validation.findings.sentences import shown
from calib_pin.validation.held_out import ALL, PRESS, HeldOut
from calib_pin.validation.model_errors import ModelErrors, quantity_errors
from calib_pin.validation.result import Accuracy, QuantityErrors, ToolAccuracy
from calib_pin.validation.splits import FEWEST_HELD_OUT
from calib_pin.validation.tool_accuracy import LIKELY, tool_accuracy

SCALE = (
    "the absolute scale is unobservable: a robot larger by any factor fits these "
    "measurements as well"
)
"""Why a robot of unknown size must not be trusted."""

KNOWN_LENGTH = (
    "add a known length: a distance between two sockets, say ('distances' in the setup "
    "file), or a length of the robot that is held ('fixed')"
)
"""The advice then."""

CHECK = (
    "check the base and tip links, the joint columns with their signs and offsets, and "
    "units"
)
"""The advice about measurements that nothing explains."""

NAMED = 3
"""Causes that a reason names; findings name all of them."""

NOISY = 3.0
"""Multiple of the noise up to which errors that are left say nothing."""

LARGE, COARSE = 0.005, 0.02
"""Errors that are left, by the reach of the robot, that no robot has which has been
calibrated; the second where nobody knows the noise.

Seven real robots of 0.9 to 1.3 m leave 0.01 to 0.36 % of their reach, a hobby arm of
0.4 m measured with a ruler 0.42 %.
"""

BREAKDOWN = 0.4
"""Part of the configurations beyond which what is set aside may be the better part."""

CONFIGURATIONS = 8
"""Distinct configurations without which a fit counts as unchecked, as it does without
`FEWEST_HELD_OUT` independent held-out ones, or stretches of a path."""

REDUNDANT = 10.0
"""Redundant values by which noise that nobody has stated is known to a factor of two.

By fewer it comes out less than half as large in one of a hundred cases.
"""

GAIN_CHANCE = 0.01
"""Probability by chance below which a gain counts as shown."""

LOSS_CHANCE = 1e-3
"""Probability by chance below which a loss on held-out measurements takes the trust.

Of a thousand perfect robots one is refused.
"""

MISJUDGED = 2.0
"""Found by predicted held-out error from which a fit misjudges itself."""

UNCERTAIN = 1.4
"""Bound of the expected error, by that itself, from which the verdict tells it: what a
region leaves open is a few directions, and half of the true errors are farther from
what is expected."""

PRINTED = 0.001
"""Part of the size of a board whose cost the verdict tells; calipers are as good."""

SURE = 0.9
"""Probability that the corrected robot is better over the workspace for `good`.

Of 345 simulated jobs with 0.95 or more, narrow ones and paths among them, one was
worse; a real arm of a humanoid, measured in front of it, has 0.95.
"""


@dataclass(frozen=True)
class Judgement:
    """A verdict with what it is based on; see `CalibrationResult`.

    Attributes:
        fitted: The fit.
        errors: Accuracy by quantity.
        gains: Paired tests on held-out configurations, the first of all quantities.
        findings: Defects of the data or the result.
        accuracies: Errors of the tool to expect by chain.
        aside: Part of the configurations that was set aside, or would have to be.
        causes: Findings from which errors follow that no robot explains.
    """

    fitted: Fit
    errors: tuple[QuantityErrors, ...]
    gains: Sequence[Gain]
    findings: tuple[Finding, ...]
    accuracies: Mapping[str, ToolAccuracy]
    aside: float
    causes: Sequence[Finding]

    @cached_property
    def verdict(self) -> tuple[str, str]:
        """`good`, `no-gain`, `unchecked` or `untrusted`, and the reason."""
        return next((word, reason) for word, reason in _rules(self) if reason)

    @property
    def misjudged(self) -> bool:
        """Whether held-out errors are larger than the fit predicts."""
        if not self.gains:
            return False
        first = self.gains[0]
        # Of few configurations the ratio itself is uncertain.
        uncertain = 1.0 + 2.0 / np.sqrt(2.0 * first.configurations)
        return bool(first.ratio > MISJUDGED * uncertain)

    @property
    def remaining(self) -> tuple[QuantityErrors, ...]:
        """The errors that noise or a robot has to explain.

        Where held-out ones are as large as the fit predicts, too few measurements are
        left to tell a robot, and only those of the fitted ones count.
        """
        if self.misjudged:
            return self.errors
        return tuple(
            replace(errors, validation_before=None, validation_after=None)
            for errors in self.errors
        )

    @property
    def worst(self) -> tuple[str, ExpectedAccuracy | None]:
        """The chain that is the least sure to be better, and its accuracy.

        Of several chains one that nothing has corrected is as good as it was.
        """
        known = {n: a.workspace for n, a in self.accuracies.items() if a.workspace}
        chains = {n: w for n, w in known.items() if w.nominal != w.calibrated} or known
        if not chains:
            return "", None
        name = min(chains, key=lambda name: chains[name].better)
        text = f" of the chain '{name}'" if name and len(known) > 1 else ""
        return text, chains[name]


def examine(
    fitted: Fit,
    seed: int,
    progress: Progress | None = None,
    others: Others = tuple,
    seek: bool = True,
) -> tuple[Mapping[str, ToolAccuracy], Findings]:
    """Examine a fit.

    Args:
        fitted: The fit.
        seed: Seed of configurations.
        progress: Told how far the search for explanations is.
        others: Other robots that may have been measured.
        seek: Whether to seek faults of the measurements that no robot explains; they
            have been sought with another model otherwise.

    Returns:
        Errors of the tool to expect by chain, and what is wrong with the measurements
        or with the fit.
    """
    # What was not estimated errs elsewhere as well.
    missing = unplaced(fitted.problem.setup)
    expecting = with_effects(fitted, missing) if missing else fitted
    chains = fitted.solved.problem.by_chain.items()
    accuracies = {
        name: tool_accuracy(fitted, expecting, term, seed) for name, term in chains
    }
    case = Case.of(fitted, progress, others, accuracies)
    return accuracies, find(case, seek)


def judge(
    fitted: Fit,
    fitted_errors: ModelErrors,
    held_out: HeldOut,
    accuracies: Mapping[str, ToolAccuracy],
    findings: Findings,
) -> Judgement:
    """Judge a fit.

    Args:
        fitted: The fit.
        fitted_errors: Errors of the measurements that were fitted.
        held_out: Its check on held-out measurements.
        accuracies: Errors of the tool to expect by chain.
        findings: What is wrong with the measurements or with the fit.
    """
    data, quantities = fitted.problem.data, fitted.problem.layout.quantities
    counted = fitted_errors.counted(data.weight), *held_out.counted
    errors = quantity_errors(quantities, *counted)
    known = (*findings.causes, *held_out.findings, *findings.others)
    seen = data.rows(data.weight > 0.0).configurations / max(data.configurations, 1)
    aside = max(1.0 - seen, fitted.robust.disagreement)
    given = errors, held_out.gains, known, accuracies, aside, findings.causes
    return Judgement(fitted, *given)


def unexplained(fitted: Fit, errors: Sequence[QuantityErrors]) -> str:
    """The errors that no calibration explains; empty where there are none."""
    free = fitted.problem.parameters.free & ~fitted.problem.parameters.nuisance
    enough = distinct_values(fitted.problem) >= fitted.structure.rank
    if enough and free.any() and fitted.directions.robot.shape[1] == 0:
        return "the errors are so large that no robot parameter is observable"
    stages = ((q, a) for q in errors for a in (q.after, q.validation_after) if a)
    reasons = (too_large(quantity.name, quantity.unit, a) for quantity, a in stages)
    return next(filter(None, reasons), "")


def too_large(name: str, unit: str, accuracy: Accuracy) -> str:
    """Why errors of a quantity are more than a robot has; empty where they are not."""
    if not accuracy.rms > FOREIGN * expected_size(unit):
        return ""
    size = f"{name} errors of {shown(accuracy.rms, unit, 3)} rms remain"
    return f"{size}, far more than a robot's geometry explains"


def error_limit(problem: Problem, unit: str, part: float = LARGE) -> float:
    """Errors that no calibrated robot exceeds, by its reach, in their unit.

    Args:
        problem: The problem of measurements of the robot.
        unit: The unit; an angle or a pixel counts as the length that is as usual. Of a
            camera that is closer than a meter so many pixels do as this moves images.
        part: The part of the reach, `LARGE` or `COARSE`.
    """
    blocks = problem.blocks
    tips = (term.error.chain.poses(data.q)[:, :3, 3] for term, data, _, _ in blocks)
    reach = max(float(np.linalg.norm(points, axis=1).max()) for points in tips)
    by_length = expected_size(unit) / expected_size("m")
    if unit == "px":
        by_length = max(by_length, _pixels_per_meter(problem))
    return part * reach * by_length


def _pixels_per_meter(problem: Problem) -> float:
    """How far images move with the base of the robot, the median [px/m]."""
    data = problem.data.rows(problem.data.weight > 0.0).sample(MEASUREMENTS)
    problem = replace(problem, data=data)
    _, J = problem.linearize_rows(np.zeros(len(problem.parameters)))
    J = J[: len(problem.sigma)] * problem.sigma[:, None]
    cameras = [block for block in problem.blocks if block.data.model == "camera"]
    motions = [J[block.values][:, block.term.index[:3]] for block in cameras]
    sizes = np.linalg.norm(np.concatenate(motions), axis=1)
    return float(np.median(sizes[np.isfinite(sizes)]))


def summary(findings: Sequence[Finding]) -> str:
    """The first of some findings as one sentence, with what corrects them."""
    messages = [finding.message for finding in findings[:NAMED]]
    if len(findings) > NAMED:
        messages.append(f"and {len(findings) - NAMED} more")
    remedies = dict.fromkeys(finding.remedy for finding in findings)
    return "; ".join(filter(None, (*messages, *remedies)))


def _rules(judgement: Judgement) -> Iterator[tuple[str, str]]:
    """Verdicts in the order in which they are tried, with the reason for each.

    A reason is empty where a verdict does not hold; the first that does is given.
    """
    for reason in _distrust(judgement):
        yield "untrusted", reason
    # The errors may be chance, and the nominal robot as good as it should be.
    chance, unchecked = _chance(judgement) > GAIN_CHANCE, _unchecked(judgement)
    if unchecked and chance and _as_nominal(judgement.fitted):
        yield from _no_gain(judgement)
    yield "unchecked", unchecked
    first = judgement.gains[0]
    # Where parts are left out little may be left; PRESS leaves out one each.
    chances = [g.better for g in judgement.gains if g.quantity == first.quantity]
    better = first.mean > 0.0 and min(chances) < GAIN_CHANCE
    if chance and not better:
        yield from _no_gain(judgement)
    yield "untrusted", _disproved(judgement)
    gain, held = _gain(judgement)
    chain, workspace = judgement.worst
    if workspace is None:
        # Exact rows leave no doubt.
        yield "good", f"{gain} on {held}"
        return
    nominal, calibrated = workspace.nominal.position, workspace.calibrated.position
    bound, size = workspace.bound.position, shown(calibrated, "m", 3)
    if bound > UNCERTAIN * calibrated:
        size += f" (95 %: below {shown(bound, 'm', 3)})"
    size += f" instead of {shown(nominal, 'm', 3)}"
    expected = f"over the workspace{chain} {size} are expected"
    expected += _if_learned(judgement, calibrated)
    unsure = f"{expected}, better with a probability of only "
    unsure += f"{100.0 * workspace.better:.0f} %; "
    unsure += _advice(judgement, "measure configurations that differ more")
    small = nominal <= min(bound, expected_size("m"))
    if better and workspace.better < LIKELY and small:
        # As good as robots are, and perhaps no better where it was not measured.
        yield "no-gain", unsure
    if workspace.better >= SURE:
        if better:
            condition = _if_noise(judgement, calibrated) + _if_board(judgement)
            yield "good", f"{gain} on {held}; {expected}{condition}"
        if calibrated < 0.5 * nominal:
            reason = f"{held} do not confirm the correction: {gain}"
            yield "unchecked", f"{reason}; measure more configurations"
    if chance or not better:
        yield from _no_gain(judgement)
    yield "untrusted", unsure


def _distrust(judgement: Judgement) -> Iterator[str]:
    """The reasons to distrust a fit whatever a check says, empty ones among them."""
    fitted, status = judgement.fitted, judgement.fitted.result.status
    unknown = unexplained(fitted, judgement.remaining)
    yield summary(judgement.causes)
    # Errors that nothing explains hide the scale as well.
    yield "" if unknown or fitted.structure.scaled else f"{SCALE}; {KNOWN_LENGTH}"
    yield "" if status.success else status.advice
    yield summary([f for f in judgement.findings if f.severity == "error"][:1])
    if judgement.aside > BREAKDOWN:
        part = f"{100.0 * judgement.aside:.0f} % of the configurations are outliers"
        most = f"beyond {100.0 * BREAKDOWN:.0f} %"
        yield f"{part}; {most} they cannot be told from the others; {CHECK}"
    yield f"{unknown}; {CHECK}" if unknown else ""
    yield _unaccounted(judgement, COARSE)


def _unaccounted(judgement: Judgement, coarse: float) -> str:
    """Errors left that neither noise nor the robot explains; empty without such.

    Args:
        judgement: What is judged.
        coarse: Errors, by the reach, that noise may leave where nobody knows it.
    """
    for quantity in (q for q in judgement.remaining if q.unit in ("m", "px")):
        before, after = (sizes.rms for sizes in quantity.shown)
        unit, noise = quantity.unit, _noise(judgement, quantity)
        # Whatever finds the corners of a board finds them well.
        known = noise is not None or unit == "px"
        problem, part = judgement.fitted.problem, LARGE if known else coarse
        # Half of the nominal robot's errors may be left.
        small = after <= max(0.5 * before, NOISY * (noise or 0.0))
        if small or after <= error_limit(problem, unit, part):
            continue
        times = "" if noise is None else f", {after / noise:.2g} times the noise"
        state = "" if known else ", state the 'noise' if the instrument is so coarse"
        advice = _advice(judgement, f"measure at rest{state}, and {CHECK}")
        first, last = (shown(errors, unit, 3) for errors in (before, after))
        text = f"{quantity.name} errors of {last} rms remain (nominal robot: {first})"
        return f"{text}{times}: nothing that was estimated explains them; {advice}"
    return ""


def _advice(judgement: Judgement, otherwise: str) -> str:
    """Causes that the model lacks, and how to estimate them, if that is known."""
    lacks = (f for f in judgement.findings if f.code in LACKS)
    return next((f"{f.message}; {f.remedy}" for f in lacks), otherwise)


def _if_noise(judgement: Judgement, promised: float) -> str:
    """The condition of a claim, where more is left and nobody knows the noise.

    Args:
        judgement: What is judged.
        promised: Error that is claimed to be left [m].
    """
    quantity = judgement.errors[0]
    rms = quantity.shown[1].rms
    unknown = quantity.unit == "m" and _noise(judgement, quantity) is None
    if not (unknown and rms > max(promised, DOUBTFUL * expected_size("m"))):
        return ""
    size = shown(rms, "m", 3)
    return f" if the {size} that are left are noise; state it, or repeat measurements"


def _if_learned(judgement: Judgement, alone: float) -> str:
    """The ways to use what was learned, which no URDF holds, and what they promise.

    At configurations like the measured ones errors are as on held-out measurements, and
    elsewhere, where a correction fades, those of the URDF.

    Args:
        judgement: What is judged.
        alone: Error that is expected of the corrected URDF [m].
    """
    learned, quantity = judgement.fitted.learned, judgement.errors[0]
    (tip, *_), held = judgement.accuracies.values(), quantity.validation_after
    if learned is None:
        return ""
    text = " of the URDF alone"
    if quantity.unit == "m" and tip.tip is not None and held is not None:
        near = float(learned.model.region.inside(tip.tip.q).mean())
        size = np.sqrt(near * held.rms**2 + (1.0 - near) * alone**2)
        text += f", at most {shown(size, 'm', 3)} with what was learned"
    return text


def _if_board(judgement: Judgement) -> str:
    """Errors by a wrong size of the board, for a claim where it alone gives the scale.

    The errors of a small robot hide a board that was printed a percent too large.
    """
    problem = judgement.fitted.problem
    tips = [accuracy.tip for accuracy in judgement.accuracies.values()]
    lengths = (p.unit == "m" and not p.nuisance for p in problem.parameters if p.free)
    others = problem.data.models != ("camera",) or problem.setup.distances
    if others or not any(lengths):
        return ""
    points = [tip.points for tip in tips if tip is not None]
    spread = max((float(np.linalg.norm(np.std(p, axis=0))) for p in points), default=0)
    size = shown(PRINTED * spread, "m", 2)
    return f"; {100.0 * PRINTED:g} % of error in the size of the board is up to {size}"


def _noise(judgement: Judgement, quantity: QuantityErrors) -> float | None:
    """Noise of a quantity as its errors are shown, rms; None where nothing tells it.

    That among repetitions, else what is stated.
    """
    layout = judgement.fitted.problem.layout
    slices = (q.columns for q in layout.quantities if q.name == quantity.name)
    columns = np.r_[next(slices, slice(0, 0))]
    pairs = zip(judgement.fitted.noise, layout.of_components, strict=False)
    parts = [n for n, k in pairs if np.isin(layout.column[k[:1]], columns).any()]
    sizes = [n.given if n.pure is None else n.pure for n in parts]
    if not parts or not all(n.stated or n.pure is not None for n in parts):
        return None
    # Copies show none.
    return float(np.sqrt(len(columns) * np.mean(np.square(sizes)))) or None


def _unchecked(judgement: Judgement) -> str:
    """The reason why there is no check; empty where there is one."""
    fitted, data = judgement.fitted, judgement.fitted.problem.data
    values, needed = known_values(fitted.problem), fitted.structure.rank
    known = "values and priors" if len(fitted.problem.further.priors) else "values"
    prior = fitted.problem.setup.prior
    sure = isinstance(prior, JointPrior) and bool(prior.noise)
    sure |= all(noise.as_stated for noise in fitted.noise)
    redundancy = sum(v.redundancy * v.values for v in fitted.noise)
    held = judgement.gains[0].configurations if judgement.gains else 0
    distinct = data.rows(data.weight > 0.0).configurations
    # Exact rows say by one what noisy ones say by many.
    least = (FEWEST_HELD_OUT, CONFIGURATIONS) if fitted.noise else (1, 1)
    remedy = "measure more configurations"
    if values < needed or values <= fitted.rank:
        reason = f"{values} measured {known} are too few for {max(needed, fitted.rank)}"
        return f"{reason} identifiable parameters; {remedy} or estimate fewer"
    if not sure and redundancy < REDUNDANT:
        reason = f"{redundancy:.1f} redundant values are too few to estimate the noise"
        return f"{reason}; {remedy}, or state the standard deviations"
    if held < least[0] or distinct < least[1]:
        reason = f"{held} independent held-out configurations of {distinct} are too few"
        return f"{reason} to check the fit with; {remedy}"
    return ""


def _disproved(judgement: Judgement) -> str:
    """The objection of held-out measurements to the fit; empty where there is none."""
    text = "on held-out measurements the corrected robot is worse than the nominal one"
    # A quantity says more than all of them together, which have no unit.
    for gain in sorted(judgement.gains, key=lambda gain: gain.quantity == ALL):
        if gain.worse < LOSS_CHANCE:
            larger = _margin(judgement, gain, -1.0)
            return f"{text}: {gain.quantity} errors larger by {larger}"
    if judgement.misjudged:
        larger = f"{judgement.gains[0].ratio:.1f} times as large as the fit predicts"
        return f"errors on held-out measurements are {larger}"
    return ""


def _as_nominal(fitted: Fit) -> bool:
    """Whether the nominal robot leaves no more than what is stated or assumed.

    Frames and instrument alone explain a few values, which then say nothing of it.
    """
    plain = replace(fitted.problem, units=np.zeros(0))
    nuisances = int((plain.parameters.free & plain.parameters.nuisance).sum())
    dof = known_count(plain) - nuisances
    square = 2.0 * plain.cost(fitted.before)
    return dof >= REDUNDANT and square < chi_square_quantile(dof, LOSS_CHANCE)


def _no_gain(judgement: Judgement) -> Iterator[tuple[str, str]]:
    """`no-gain`, unless more is left than noise and a robot explain."""
    yield "untrusted", _unaccounted(judgement, LARGE)
    reason = "the measurements show no error of the robot"
    if judgement.gains:
        gain, held = _gain(judgement, nothing=True)
        reason += f"{_if_noise(judgement, 0.0)}: {gain}, on {held}"
    chain, workspace = judgement.worst
    if workspace is not None:
        expected = shown(workspace.nominal.position, "m", 3)
        reason += f"; over the workspace{chain} {expected} are expected as it is"
    yield "no-gain", reason


def _chance(judgement: Judgement) -> float:
    """Probability of so large errors by chance if the robot were as nominal."""
    fitted, evidence = judgement.fitted, judgement.fitted.evidence
    if evidence is None or evidence.count == 0:
        # Exact rows leave no doubt, but for rounding, if they are checked.
        gains = [abs(gain.mean) for gain in judgement.gains]
        return float(max(gains, default=np.inf) < 1e-6)
    return f_tail(evidence.square / evidence.count, evidence.count, max(fitted.dof, 1))


def _gain(judgement: Judgement, nothing: bool = False) -> tuple[str, str]:
    """Errors of the first quantity before and after, and where they are of.

    Where the test leaves out one configuration each (PRESS), errors of measurements
    that were fitted say nothing, and their mean difference is told.

    Args:
        judgement: What is judged.
        nothing: Whether nothing is gained.
    """
    gain, quantity = judgement.gains[0], judgement.errors[0]
    name, (before, after) = quantity.name, quantity.shown
    held = gain.method != PRESS and after is quantity.validation_after
    where = f"{gain.configurations} independent held-out configurations"
    if gain.method == PRESS:
        where = f"{gain.configurations} configurations, each predicted by the others"
    noisy = (_by_noise(judgement, quantity) for quantity in judgement.errors)
    if times := "; ".join(filter(None, noisy)):
        where += f" ({times})"
    # A few that nobody can predict, near the plane of a camera say, outweigh all.
    outweighed = gain.mean > 0.0 and after.rms > before.rms
    if nothing:
        outweighed = _certain(judgement, quantity) is not after
    if held and not outweighed:
        old, new = (shown(sizes.rms, quantity.unit, 3) for sizes in (before, after))
        text = f"{new} rms instead of {old}"
        if nothing:
            text = f"{old} rms as it is, {new} corrected"
        return f"{name} error {text}", where
    if not held:
        of_first = (g for g in judgement.gains if g.method == gain.method)
        gain = next((g for g in of_first if g.quantity == name), gain)
    by = _margin(judgement, gain)
    text = f"differ by {by} if it is corrected" if nothing else f"smaller by {by}"
    return f"{'' if held else f'{name} '}errors {text}", where


def _certain(judgement: Judgement, quantity: QuantityErrors) -> Accuracy:
    """The errors that are shown, but for those that too few others predict."""
    after = quantity.shown[1]
    far = after.rms > NOISY * quantity.after.rms and not judgement.misjudged
    return quantity.after if far else after


def _by_noise(judgement: Judgement, quantity: QuantityErrors) -> str:
    """Errors by their noise, in words; empty where they are no more than that."""
    noise, rms = _noise(judgement, quantity), _certain(judgement, quantity).rms
    if not noise or rms < NOISY * noise:
        return ""
    name = f"{quantity.name} " * (quantity is not judgement.errors[0])
    times = f"{name}{rms / noise:.2g} times the noise"
    return f"{times}, {shown(noise, quantity.unit, 3)}"


def _margin(judgement: Judgement, gain: Gain, sign: float = 1.0) -> str:
    """A gain with its standard error, or a loss, in the unit of its quantity."""
    units = {quantity.name: DISPLAY[quantity.unit] for quantity in judgement.errors}
    unit, factor = units.get(gain.quantity, ("standard deviations", 1.0))
    return f"{sign * factor * gain.mean:.3g} +- {factor * gain.deviation:.1g} {unit}"
