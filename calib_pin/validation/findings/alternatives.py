"""The table of alternatives: what may be wrong, and which of it explains the errors.

A row is an `Alternative`: its code and words, what it is of, how measurements are read
with it, and what is done about it. A robot is fitted with each, by further columns of
the Jacobian (`course`, `joint_motions`) or other readings of the file (`readings`), and
those that leave the least are an `Explanation`, whose findings are made in one place.

A controller counts a joint the other way, a file exchanges two columns, measurements
stand one line below their joints. Each leaves hundreds of millimeters that no
calibration removes, and each can be tried: the nominal robot is registered on
measurements that are read so. Explanations are combined as long as each removes a good
part of what is left. Where the nominal robot is too far off to tell, its errors are
fitted as well, for one explanation at a time.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import product
from typing import Any

import numpy as np

from calib_pin.compiled.threads import serial_blas
from calib_pin.errors import CalibPinError, InputError
from calib_pin.estimation.evidence import Finding, Severity
from calib_pin.estimation.formulation import make_problem
from calib_pin.estimation.problem import Problem, measured_count
from calib_pin.kinematics.chains import Chains
from calib_pin.kinematics.spatial import Floats
from calib_pin.measurement_models import declared
from calib_pin.measurement_models.readings import read_otherwise
from calib_pin.observations import Measurements, Observations
from calib_pin.observations.measurements import with_joints
from calib_pin.parameterizations.base import expected_size
from calib_pin.setup import JointMap, ReadingSetup, Setup
from calib_pin.validation.findings.case import (
    CLEARER,
    DOUBTFUL,
    FOREIGN,
    Case,
    QuickFit,
    below_sheet,
    counted_part,
    trimmed_errors,
    unlikely,
)
from calib_pin.validation.findings.sentences import finding, lines_of, merged, shown

FITTED = 0.5
"""Part of the errors of a fit that one of them may leave."""

ROWS = 60
"""Measurements that explanations are tried on."""

IMAGES, CORNERS = 12, 8
"""The same of images, and of what is seen in each: a few images locate no board."""

SEVERAL = 2
"""Measurements at each configuration from which they are images."""

NEIGHBORS = 2000
"""Measurements that are read otherwise before these are picked, see `_runs`."""

MOST = 3
"""Faults that may occur at once."""

ALIKE = 30
"""Sets of faults that leave about the least, of which fits are asked; of true faults
there are few, and where there are more, none explains anything."""

WIDTH, LIKELY = 3, 10
"""Explanations that are kept to be combined with others, and those of which frames are
fitted well, which the roughly fitted ones come before."""

TOGETHER = 500
"""Most combinations of faults of a joint that are tried: a few seconds."""

CLOSE = 2.0
"""Errors of an explanation, by those of the best one, that a fit is asked to tell from
it; and those without a fault of several, if that is not needed."""

DECISIVE = 0.2
"""Part of the nominal robot's errors that all of them together may leave."""

CALM = 0.3
"""Part of the robot's largest correction that a frame which is fitted may leave."""

EXPLAINED, USUAL = 0.05, 4.0
"""Part of the errors, and expected sizes of an error, with either of which nothing more
is sought: nominal robots of which we have measurements leave 2 to 5 mm."""

LEAST = 3
"""Values beyond the unknowns of frames without which nothing is tried."""


@dataclass(frozen=True)
class JointReading:
    """Joint positions as an affine function of those that were read.

    `q = factors @ q_read + offsets`

    Attributes:
        factors: Shape (n, n) [rad/rad, m/m].
        offsets: Shape (n,) [rad, m].
    """

    factors: Floats
    offsets: Floats

    @staticmethod
    def plain(count: int) -> JointReading:
        """Positions of so many joints as they are read."""
        return JointReading(np.eye(count), np.zeros(count))

    def positions(self, q: Floats) -> Floats:
        """The positions, shape (N, n); none of none."""
        return np.asarray(q @ self.factors.T + self.offsets) if q.size else q

    def after(self, first: JointReading) -> JointReading:
        """This one of positions that another one has read."""
        offsets = self.factors @ first.offsets + self.offsets
        return JointReading(self.factors @ first.factors, offsets)

    def maps(
        self, joints: Sequence[str], joint_maps: Mapping[str, JointMap]
    ) -> dict[str, dict[str, Any]]:
        """The entries of `joints` in a setup file, of all that are not plain.

        Args:
            joints: Names of the joints.
            joint_maps: Those by which positions have been read, by file column.
        """
        of_joint = {m.joint: name for name, m in joint_maps.items()}
        columns = [of_joint.get(joint, joint) for joint in joints]
        pairs = zip(joints, columns, strict=True)
        given = [joint_maps.get(column, JointMap(joint)) for joint, column in pairs]
        # Every position as it has been read is an affine function of file columns.
        names = [*dict.fromkeys([*columns, *(n for g in given for n in g.coupled)])]
        by_column = np.zeros((len(joints), len(names)))
        for row, column, joint_map in zip(by_column, columns, given, strict=True):
            for name, part in [(column, 1.0), *joint_map.coupled.items()]:
                row[names.index(name)] += joint_map.sign * joint_map.gear * part
        factors = self.factors @ by_column
        offsets = self.factors @ [m.offset for m in given] + self.offsets
        # Every joint has a column that no other one has, its own where it can.
        from scipy.optimize import linear_sum_assignment  # Slow to import.

        count = len(joints)
        has = factors[:, :count] != 0.0
        _, chosen = linear_sum_assignment(has * (count + np.eye(count)), maximize=True)
        result = {}
        rows = zip(joints, chosen.tolist(), factors, offsets.tolist(), strict=True)
        for joint, k, row, offset in rows:
            factor = float(row[k])
            others = [j for j in np.flatnonzero(row).tolist() if j != k]
            coupled = {names[j]: float(row[j]) / factor for j in others}
            sign = 1 if factor > 0.0 else -1
            entry = lines_of(JointMap(joint, sign, abs(factor), offset, coupled))
            if entry != {"joint": columns[k]} or columns[k] in joint_maps:
                result[columns[k]] = entry
        return result


@dataclass(frozen=True)
class Alternative:
    """One row of the table: what may be wrong, and what is done if it is.

    Data are read otherwise, or their further columns of the Jacobian have been fitted.

    Attributes:
        code: Code of its finding.
        words: The fault in words, the beginning of a sentence.
        subject: What it is of; two explanations of one subject do not combine.
        reading: How the measurements are to be read.
        joints: How the joint positions are to be read; None for as they are.
        change: What the reader of files would do first, of which they alone know the
            numbers; None for nothing.
        chains: The chains that were measured, where they are others.
        setup: What the setup states otherwise, by the names of its attributes.
        lines: Further lines of the setup file.
        gross: Whether the errors are as large as the robot, which the nominal one
            tells; a fit to them says nothing.
        advice: What to do instead of stating something; empty where the setup helps.
        figure: What the figure of residuals that shows it has them over.
        joint: The joint that it concerns alone: what is wrong with one joint may only
            show once all of it is read otherwise.
        absorbs: Factor by which its numbers make errors of a robot smaller.
        numbers: Numbers of its finding by name, SI units.
    """

    code: str
    words: str
    subject: str
    reading: ReadingSetup = field(default_factory=ReadingSetup)
    joints: JointReading | None = None
    change: Callable[[Observations], Observations] | None = None
    chains: Chains | None = None
    setup: Mapping[str, Any] = field(default_factory=dict)
    lines: Mapping[str, Any] = field(default_factory=dict)
    gross: bool = False
    advice: str = ""
    figure: str = ""
    joint: str = ""
    absorbs: float = 1.0
    numbers: Mapping[str, Any] = field(default_factory=dict)

    @property
    def among_rows(self) -> bool:
        """Whether it takes more than a row to read this row, or leaves some out."""
        return self.change is not None or self.reading != ReadingSetup()


def read_with(data: Observations, faults: Iterable[Alternative]) -> Observations:
    """Measurements as they are to be read if they have some faults.

    Raises:
        InputError: If faults of joint columns are those of other chains.
    """
    faults = tuple(faults)
    for fault in faults:
        data = data if fault.change is None else fault.change(data)
    if (joints := joint_reading(faults)) is not None:
        if len(data.joints) != len(joints.offsets):
            raise InputError("these joints are those of another chain")
        at = joints.positions
        blocks = [replace(b, q=at(b.q), start=at(b.start)) for b in data.blocks]
        data = Observations(tuple(blocks))
    for fault in faults:
        if fault.chains is not None:
            data = _with_joints(data, fault.chains.joints)
    return read_otherwise(data, merged(fault.reading for fault in faults))


def _with_joints(data: Observations, joints: Sequence[str]) -> Observations:
    """Measurements with some of their joints, and further ones that they state."""
    new = [joint for joint in joints if joint not in data.joints]

    def with_new(b: Measurements) -> Measurements:
        if new and b.start.size:
            raise InputError("where these joints started is not known")
        part = with_joints(b, tuple(joints))
        for joint in new:
            part.q[:, part.joints.index(joint)] = b.conditions.spare[joint, joint]
        return part

    return Observations(tuple(map(with_new, data.blocks)))


def joint_reading(faults: Iterable[Alternative]) -> JointReading | None:
    """How joint positions are to be read with all of some faults."""
    reading = None
    for fault in faults:
        if fault.joints is not None:
            reading = fault.joints if reading is None else fault.joints.after(reading)
    return reading


def setup_lines(case: Case, faults: Sequence[Alternative]) -> dict[str, Any]:
    """Lines of a setup file with which measurements are read otherwise."""
    joints = joint_reading(faults)
    lines: dict[str, Any] = {
        "joints": joints and joints.maps(case.data.joints, case.setup.joints),
        "reading": lines_of(merged(fault.reading for fault in faults)),
    }
    for fault in faults:
        lines |= fault.lines
    return {key: value for key, value in lines.items() if value}


@dataclass(frozen=True)
class Explanation:
    """Faults that explain the measurements together.

    Attributes:
        faults: The faults.
        before: Errors as the measurements are read now, rms [unit of the quantity];
            infinite where the robot cannot be located.
        after: Errors if they are read so.
        fitted: Whether both are errors of a fit, or of the nominal robot.
        judged: How much it matters, where that does not follow from what is left.
    """

    faults: tuple[Alternative, ...]
    before: float
    after: float
    fitted: bool = True
    judged: Severity | None = None

    @property
    def part(self) -> float:
        """Part of the errors that is left."""
        return self.after / self.before

    @property
    def severity(self) -> Severity:
        """Whether it takes the trust: far less must be left."""
        return self.judged or ("error" if self.part < FITTED else "warning")


def findings_of(case: Case, explanation: Explanation | None) -> tuple[Finding, ...]:
    """The findings of an explanation, one of each fault, and none of none.

    Each that states lines has those of all, which belong together.
    """
    if explanation is None:
        return ()
    lines, quantity = setup_lines(case, explanation.faults), case.fit.quantity
    scale = merged(fault.reading for fault in explanation.faults).scale
    if quantity.unit != "m" or explanation.fitted:
        scale = 1.0  # Errors of the nominal robot are in the unit of the file.
    before, after = explanation.before, scale * explanation.after
    old, new = (shown(size, quantity.unit, 3) for size in (before, after))
    fall = f"drop from {old} to" if np.isfinite(before) else "are"
    robot = "of a fit" if explanation.fitted else "of the nominal robot"
    severity, result = explanation.severity, list[Finding]()
    for fault in explanation.faults:
        text = f"{fault.words}: with this corrected, the {quantity.name} errors {robot}"
        text += f" {fall} {new}"
        numbers = {**fault.numbers, "rms_before": before, "rms_after": after}
        # The lines are a way for what states some, be it beside another way.
        remedy = fault.advice, lines if setup_lines(case, [fault]) else {}, fault.figure
        error, info = severity == "error", severity == "info"
        entry = finding(fault.code, text, numbers, *remedy, error=error, info=info)
        result.append(entry)
    return tuple(result)


Family = Callable[[Case], Iterable[Alternative]]
"""The explanations of one kind that are worth a trial in a case."""


@serial_blas
def explain(case: Case, families: Sequence[Family]) -> Explanation | None:
    """The explanation that leaves the least errors; None where none is decisive.

    Args:
        case: The case.
        families: Where explanations come from.
    """
    search = _Search(case, [f for family in families for f in family(case)])
    return search.combined() or search.of_one_joint() or search.fitted()


_Faults = tuple[Alternative, ...]
"""Faults that measurements may have at once."""

_Trial = tuple[float, _Faults]
"""Error that is left with some faults, rms in standard deviations, and these."""


class _Search:
    """Trials of explanations of a case.

    Attributes:
        faults: Those that are tried.
        tried: Number of trials.
        unit: One standard deviation of the first quantity, in its unit.
        usual: Expected size of an error of a robot, in standard deviations.
        first: Error of the nominal robot on measurements as they are read now.
    """

    def __init__(self, case: Case, faults: Sequence[Alternative]) -> None:
        self.case, self.faults, self.tried = case, faults, 0
        self.data = _runs(case.data.weighted(np.ones(len(case.data))))
        self.whole = replace(case.setup, learned=None)
        self.plain = replace(self.whole, parameters=(), fixed=(), bounds={}, prior={})
        self.contact = any(declared(model).contact for model in self.data.models)
        self.sample = self._sample(self.data)
        problem, self.first = case.fit.problem, np.inf
        sigma = problem.given_sigma[problem.layout.component == 0]
        self.unit = float(np.sqrt(np.mean(sigma**2)))
        self.usual = expected_size(case.fit.quantity.unit) / self.unit
        self.first = self._nominal_rms((), thorough=True)

    def combined(self) -> Explanation | None:
        """Faults with which the nominal robot fits far better."""
        enough, last = USUAL * self.usual, self.first
        if np.isfinite(last):
            enough = max(EXPLAINED * last, enough)
        beam: list[_Trial] = [(last, ())]
        best = list(beam)
        for k in range(MOST):
            if self.case.progress is not None:
                self.case.progress(k / MOST)
            trials: dict[frozenset[int], _Trial] = {}
            limits: dict[frozenset[int], float] = {}
            for (error, faults), new in product(beam, self.faults):
                union = (*faults, new)
                key = frozenset(map(id, union))
                if key not in trials and all(f.subject != new.subject for f in faults):
                    trials[key] = self._nominal_rms(union), union
                    limits[key] = CLEARER * error / new.absorbs
            ranked = sorted(trials, key=lambda key: _rank(trials[key]))
            for key in ranked[:LIKELY]:
                faults = trials[key][1]
                trials[key] = self._nominal_rms(faults, thorough=True), faults
            # Of those that leave the same, the likelier kind comes first.
            clear = [trials[key] for key in ranked if trials[key][0] < limits[key]]
            beam = sorted(clear, key=_rank)[:WIDTH]
            best = sorted(best + beam, key=_rank)
            error, faults = best[0]
            # Each of as many again may join those that are ahead.
            count = self.tried * len(self.faults)
            if error < enough or self._ratio(faults, last, error) < unlikely(count):
                break
            last = error
        return self._best(best)

    def of_one_joint(self) -> Explanation | None:
        """All faults of a joint, each of which alone leaves as much as none."""
        if self.first <= FOREIGN * self.usual:
            return None  # Two of them at once would make larger errors.
        of_joint: dict[str, dict[str, list[Alternative | None]]] = {}
        for fault in self.faults:
            if fault.joint:
                kinds = of_joint.setdefault(fault.joint, {})
                kinds.setdefault(fault.subject, [None]).append(fault)
        choices = (product(*kinds.values()) for kinds in of_joint.values())
        sets = [tuple(filter(None, faults)) for choice in choices for faults in choice]
        sets = [faults for faults in sets if len(faults) > 1]
        if not 0 < len(sets) <= TOGETHER:
            return None
        trials = [(self._nominal_rms(faults), faults) for faults in sets]
        return self._best(sorted(trials, key=lambda trial: trial[0]))

    def fitted(self) -> Explanation | None:
        """The fault with which a robot with errors fits far better."""
        singles = [] if self.contact else self._singles()
        complete = [trial for trial in singles if not trial[1][0].reading.without]
        if complete and complete[0][0] < CLOSE * singles[0][0]:
            singles = complete
        return self._by_fits(singles[0][1], FITTED) if singles else None

    def _singles(self) -> list[_Trial]:
        """Errors that fits leave with each fault, the least first.

        A robot that is fitted shrinks with its measurements, or turns into another.
        """
        faults = [f for f in self.faults if not (f.gross or f.chains)]
        trials = [(self._fit_rms((fault,)), (fault,)) for fault in faults]
        return sorted(trials, key=lambda trial: trial[0])

    def _best(self, trials: Sequence[_Trial]) -> Explanation | None:
        """The best of some sets of faults, by the errors that the nominal robot leaves.

        A robot whose errors are fitted tells those that leave about the same, and is
        asked where what the nominal one leaves is too much.
        """
        if self.contact and not trials[0][0] < self._limits(DECISIVE, fitted=False)[1]:
            return None  # Fits are not asked, and are slow.
        # What leaves no more than a robot errs explains all.
        limit = max(CLOSE * trials[0][0], self.usual)
        near = [t for t in trials if t[1] and t[0] <= limit][:ALIKE]
        close = [self._necessary(*t) for t in near] or trials[:1]
        # What leaves none out explains more.
        close = [t for t in close if not any(f.reading.without for f in t[1])] or close
        error, faults = close[0]
        fittable = not any(fault.gross for _, faults in close for fault in faults)
        if fittable and len(close) > 1:
            # A fit that gets lost leaves no more than the nominal robot.
            fits = [(min(self._fit_rms(faults), rms), faults) for rms, faults in close]
            error, faults = close[int(np.argmin([*map(_rank, fits)]))]
        explanation = self._accepted(faults, error, DECISIVE, fitted=False)
        fittable = fittable and not any(f.chains or f.reading.without for f in faults)
        return explanation or (self._by_fits(faults, DECISIVE) if fittable else None)

    def _necessary(self, error: float, faults: _Faults) -> _Trial:
        """Those of some faults without which far more is left, and what they leave."""
        for fault in faults if len(faults) > 1 else ():
            rest = tuple(other for other in faults if other is not fault)
            without = self._nominal_rms(rest)
            needless = without < CLOSE * error
            if without < error / DECISIVE and not fault.gross:
                # Large errors of the robot hide it: its fit tells, if anything.
                fit = self._fit_rms(faults)
                if np.isfinite(fit):
                    needless = self._fit_rms(rest) < CLOSE * fit
            if needless:
                return self._necessary(without, rest)
        return error, faults

    def _by_fits(self, faults: _Faults, part: float) -> Explanation | None:
        """Faults with which a fit leaves far less.

        Contacts draw a robot together, the more so the less is known of it.
        """
        if self.contact or not faults:
            return None
        after = self._fit_rms(faults)
        # The right reading of joints leaves a robot, which a fit knows better.
        if any(f.joints for f in faults) and after > FOREIGN * self.usual:
            return None
        return self._accepted(faults, after, part, fitted=True)

    def _accepted(
        self, faults: _Faults, after: float, part: float, *, fitted: bool
    ) -> Explanation | None:
        before, limit = self._limits(part, fitted)
        if not faults or not after < limit or not self._corrects_less(faults, after):
            return None
        if self._ratio(faults, before, after) < unlikely(self.tried):
            return None
        case = self.case
        small = case.fitted is not None and case.remaining <= DOUBTFUL
        # A fit finds the same errors of the robot without it.
        offset = small and all(fault.code == "joint-offset" for fault in faults)
        judged: Severity | None = "warning" if offset else None
        # The error of a position is its length, as elsewhere, not that along an axis.
        unit = self.unit * float(np.sqrt(case.fit.quantity.dimension))
        return Explanation(faults, unit * before, unit * after, fitted, judged)

    def _corrects_less(self, faults: _Faults, after: float) -> bool:
        """Whether a robot need no longer be corrected as much, if numbers are fitted.

        A frame explains a part of large errors of joints, too, and then they are still
        there.
        """
        case, frames = self.case, any(fault.absorbs != 1.0 for fault in faults)
        if not frames or case.fitted is None or self.usual * case.remaining > after:
            return True  # Nothing is fitted, or the fit explains less.
        fit = self._fit(faults)
        corrected = np.inf if fit is None else fit.largest_correction
        return corrected < CALM * case.fit.largest_correction

    def _limits(self, part: float, fitted: bool) -> tuple[float, float]:
        """Errors as the measurements are read now, and those that may be left."""
        before = self._fit_rms(()) if fitted else self.first
        if self.case.fitted is not None:
            # A trial may get lost where the whole fit does not.
            errors = self.case.remaining if fitted else self.case.errors_nominal
            before = min(before, self.usual * errors)
        # Where nothing tells what a wrong reading leaves, it must be errors of a robot.
        of_robot = self.usual * (DOUBTFUL if fitted else FOREIGN)
        return before, part * before if np.isfinite(before) else of_robot

    def _ratio(self, faults: _Faults, before: float, after: float) -> float:
        """Logarithm of the likelihood ratio of faults; they may leave out lines."""
        if not after < before:
            return 0.0
        problem = self._problem(faults, self.plain)
        return _redundancy(problem) * float(np.log(before / max(after, 1e-12)))

    def _problem(self, faults: _Faults, setup: Setup) -> Problem:
        """The problem of some measurements that are read so."""
        chains = next((f.chains for f in faults if f.chains), self.case.chains)
        changes = {k: v for f in faults for k, v in f.setup.items()}
        setup = replace(setup, **changes) if changes else setup
        if any(fault.among_rows for fault in faults):
            data = self._sample(read_with(self.data, faults))
        else:
            data = read_with(self.sample, faults)
        return make_problem(chains, data, setup)

    def _sample(self, data: Observations) -> Observations:
        """Those measurements that trials are made on."""
        data = _thinned(data)
        if len(data) >= SEVERAL * data.configurations:
            size = IMAGES * CORNERS
        else:
            # A distance tells a third of what a position does.
            scalar = any(len(declared(m).components) == 1 for m in data.models)
            size = 3 * ROWS if scalar else ROWS
        # Each frame that is a new one needs as many.
        return data.sample(size * len(data.blocks) // len(self.data.blocks))

    def _nominal_rms(self, faults: _Faults, thorough: bool = False) -> float:
        """Error of the registered nominal robot, rms in standard deviations."""
        self.tried += 1
        try:
            problem = self._problem(faults, self.plain)
            if _redundancy(problem) < LEAST:
                return np.inf
            scale = merged(fault.reading for fault in faults).scale
            thorough = thorough or _adds_unknowns(faults)
            return trimmed_errors(problem, self.first, scale, thorough)[0]
        except (CalibPinError, np.linalg.LinAlgError):
            return np.inf  # No beam meets its plane, say.

    def _fit(self, faults: _Faults) -> QuickFit | None:
        """A robot whose errors were fitted in a few steps, if one can be."""
        try:
            problem = self._problem(faults, self.whole)
            return QuickFit.of(problem, thorough=_adds_unknowns(faults))
        except (CalibPinError, np.linalg.LinAlgError):
            return None

    @cached_property
    def _hopeless(self) -> bool:
        """Whether measurements are too few to fit a robot, however they are read."""
        fit = self._fit(())
        return fit is not None and not fit.redundant

    def _fit_rms(self, faults: _Faults) -> float:
        """Error that a fitted robot leaves, rms in standard deviations."""
        self.tried += 1
        fit = None if self._hopeless else self._fit(faults)
        if fit is None or not fit.redundant or below_sheet(fit.problem):
            return np.inf
        return fit.rms if np.isfinite(fit.rms) else np.inf


def _adds_unknowns(faults: Iterable[Alternative]) -> bool:
    """Whether other frames or numbers of instruments have to be located."""
    return any(fault.setup for fault in faults)


def _rank(trial: _Trial) -> float:
    """Order of some faults by what they leave, and by what they would leave anyway."""
    error, faults = trial
    error *= float(np.prod([fault.absorbs for fault in faults]))
    return round(float(np.log(max(error, 1e-300))), 2)


def _runs(data: Observations) -> Observations:
    """Measurements in runs of neighbors, for those that a fault takes from others."""
    if len(data) <= NEIGHBORS:
        return data
    order, length = data.in_order, 100
    starts = np.linspace(0, len(data) - length, NEIGHBORS // length).astype(np.int64)
    return data.rows(np.sort(np.unique([order[s : s + length] for s in starts])))


def _thinned(data: Observations) -> Observations:
    """Measurements with a few of each configuration, corners of an image say."""
    label = data.groups() * len(data.blocks) + data.block_of
    order = np.argsort(label, kind="stable")
    _, first, size = np.unique(label[order], return_index=True, return_counts=True)
    place, many = np.arange(len(data)) - np.repeat(first, size), np.repeat(size, size)
    most = np.minimum(many, CORNERS)
    return data.rows(np.sort(order[(place + 1) * most // many > place * most // many]))


def _redundancy(problem: Problem) -> float:
    """Values of the best part of the measurements beyond the unknowns of frames."""
    parameters = problem.parameters
    unknown = int((parameters.free & parameters.nuisance).sum())
    return counted_part(problem) * measured_count(problem) - unknown
