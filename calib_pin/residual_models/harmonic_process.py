"""A Gaussian process of many measurements, made of harmonics in place of these.

The process of `gaussian_process` costs the cube of the number of measurements. Here the
same covariance is that of a sum of harmonics: measurements enter through sums alone,
chunk by chunk, and their number does not matter afterwards. Which harmonics there are
is read off some thousand measurements: again and again those join that would explain
most of what is left.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, ClassVar, cast, get_args

import numpy as np
from numpy.typing import NDArray

from calib_pin.compiled.threads import Threads, serial_blas
from calib_pin.kinematics.spatial import Floats, times
from calib_pin.residual_models.amplitudes import (
    Amplitudes,
    Variances,
    likeliest,
    shift_variances,
)
from calib_pin.residual_models.base import (
    MUCH,
    Linearized,
    Space,
    TrainingRows,
    convincing,
    correction_unit,
    root_mean_square,
)
from calib_pin.residual_models.covariance import Form
from calib_pin.residual_models.documents import (
    checked,
    fades,
    numbers,
    stated,
    written,
)
from calib_pin.residual_models.harmonics import Harmonics, candidates
from calib_pin.residual_models.region import PIECE, TrainedRegion
from calib_pin.residual_models.shifts import FREE
from calib_pin.residual_models.sums import Linear, Sums, scores

ROUNDS = (0.2, 0.5, 1.0)
"""Part of the harmonics after each round of choosing."""

WORTH = 3.0
"""Squares of the noise that a harmonic explains on average if it is to join."""

CHECKED = 2000
"""Held-out measurements that tell how large the predicted variances are."""

DIGITS = 7
"""Decimals of the factor of the covariance in a document."""


@dataclass(frozen=True)
class HarmonicProcess:
    """A Gaussian process given its measurements, as a sum of harmonics.

    Attributes:
        region: Training region; its angles are those of the harmonics.
        shift: Shift of the geometry that belongs to it, shape (P,).
        space: Space of the corrections.
        unit: Correction that counts as one, shape (m,) [rad, m].
        harmonics: The D functions.
        amplitudes: Their amplitudes in units, shape (D,).
        root: Standard deviations of amplitudes and amounts of the shift before any
            measurement, shape (D + p,).
        spread: Lower triangle T row by row: what has the derivatives x by amplitudes
            and amounts has the variance `|T (root x)|^2`, shape (K,).
        held_out: Root mean square of the whitened residuals of a part of the
            measurements, before, and predicted from all the others.
        released: Shift per amount, see `shifts.Shifts`, shape (P, p).
        fades: Whether it fades outside the region. Functions of single joints know how
            far they hold; of the others only those that the measurements call for are
            there, which are sure of themselves everywhere.
    """

    region: TrainedRegion
    shift: Floats
    space: Space
    unit: Floats
    harmonics: Harmonics
    amplitudes: Floats
    root: Floats
    spread: Floats
    held_out: tuple[float, float]
    released: Floats
    fades: bool = True
    name: ClassVar[str] = "gaussian-process"
    made_of: ClassVar[str] = "harmonics"

    @serial_blas
    def __call__(self, q: Floats) -> Floats:
        """Corrections at joint positions, (N, m) [rad, m]."""
        inside = self._inside(self.region.angles(q))
        return np.asarray(self.weight(q)[:, None] * inside)

    def weight(self, q: Floats) -> Floats:
        """Weight of the correction, see `fades`, shape (N,)."""
        return self.region.weight(q) if self.fades else np.ones(len(q))

    @serial_blas
    def deviation(
        self,
        q: Floats,
        by_correction: Floats | None = None,
        by_shift: Floats | None = None,
    ) -> Floats:
        """Standard deviations, see `ResidualModel.deviation`."""
        if by_correction is None:
            by_correction = np.tile(np.eye(len(self.unit)), (len(q), 1, 1))
        A = by_correction * self.unit
        G = np.zeros((*A.shape[:2], len(self.shift))) if by_shift is None else by_shift
        G = G @ self.released
        inside = np.empty(A.shape[:2])
        for start in range(0, len(q), PIECE):
            piece = slice(start, start + PIECE)
            inside[piece] = self._variance(
                self.region.angles(q[piece]), A[piece], G[piece]
            )
        # As large as the corrections are: the variances before any measurement are also
        # those of all the harmonics that did not join.
        size = np.bincount(
            self.harmonics.component, self.amplitudes**2, minlength=len(self.unit)
        )
        outside = inside + (A**2).dot(size)
        weight = self.weight(q)[:, None]
        return np.asarray(weight * np.sqrt(inside) + (1.0 - weight) * np.sqrt(outside))

    def _inside(self, angle: Floats) -> Floats:
        """Corrections at angles as if all were inside the region, shape (N, m)."""

        def combined(start: int) -> Floats:
            part = angle[start : start + PIECE]
            return self.harmonics.combined(part, self.amplitudes, len(self.unit))

        starts = range(0, len(angle), PIECE)
        found = [np.zeros((0, len(self.unit))), *Threads().map(combined, starts)]
        return np.concatenate(found) * self.unit

    def _variance(self, angle: Floats, A: Floats, G: Floats) -> Floats:
        """Variances of what depends on corrections in units and amounts, (K, d)."""
        values = np.ascontiguousarray(self.harmonics.values(angle))[:, None, :]
        columns = np.concatenate([values * A[:, :, self.harmonics.component], G], 2)
        found = (columns * self.root) @ self._triangle.T
        return np.asarray((found**2).sum(axis=2))

    @cached_property
    def _triangle(self) -> Floats:
        result = np.zeros((len(self.root),) * 2)
        result[np.tril_indices(len(self.root))] = self.spread
        return result

    def document(self) -> dict[str, Any]:
        """The numbers."""
        return {"kind": self.name, "made_of": self.made_of, **written(self)}

    @staticmethod
    def restore(document: Mapping[str, Any], joints: int) -> HarmonicProcess:
        """The process of a document.

        Raises:
            ValueError: If it is not one.
        """
        parts = checked(document, "gaussian-process")
        space = cast(Space, stated(parts, "space", get_args(Space)))
        m = joints if space == "joint" else 6
        harmonics = Harmonics.restore(parts.get("harmonics"), joints, m)
        shift = numbers(parts, "shift", (None,), empty=True)
        released = np.eye(len(shift))  # Every direction was free once.
        if "released" in parts:
            released = numbers(parts, "released", (len(shift), None), empty=True)
        size = len(harmonics) + released.shape[1]
        before, after = numbers(parts, "held_out", (2,))
        return HarmonicProcess(
            region=TrainedRegion.restore(parts.get("region"), joints),
            shift=shift,
            space=space,
            unit=numbers(parts, "unit", (m,), positive=True),
            harmonics=harmonics,
            amplitudes=numbers(parts, "amplitudes", (len(harmonics),)),
            root=np.abs(numbers(parts, "root", (size,))),
            spread=numbers(parts, "spread", (size * (size + 1) // 2,)),
            held_out=(float(before), float(after)),
            released=released,
            fades=fades(parts),
        )


def fit_harmonics(
    rows: TrainingRows,
    region: TrainedRegion,
    training: NDArray[np.int64],
    held: NDArray[np.int64],
    *,
    forms: Sequence[Form],
    functions: int,
    screened: int,
    report: Callable[[float], None],
) -> tuple[HarmonicProcess, Floats]:
    """Fit a Gaussian process of harmonics to the residuals of a geometric fit.

    Args:
        rows: The measurements.
        region: Their region.
        training: Those to learn from, the first of which choose the harmonics.
        held: The others, which tell in between how well it predicts.
        forms: Forms, simplest first. A later one must predict the others much better.
        functions: Most harmonics.
        screened: Most measurements that choose them.
        report: Told the part that is done, 0 to 1.

    Returns:
        The process, and the whitened residuals of the others predicted without them.
    """
    few = np.sort(training[:screened])
    best: tuple[HarmonicProcess, Floats] | None = None
    for k, form in enumerate(forms):

        def tell(part: float, k: int = k) -> None:
            report((k + part) / len(forms))

        draft = _Draft(rows, form, region).choose(few, functions)
        tell(0.5)
        found = draft.solve(np.sort(training), held, tell)
        if best is None or convincing(best[1], found[1], MUCH):
            best = found
    assert best is not None
    return best


class _Draft:
    """A process of one form, on its way."""

    def __init__(self, rows: TrainingRows, form: Form, region: TrainedRegion) -> None:
        """Linearize about no correction."""
        self._rows, self._form, self._region = rows, form, region
        joint = form.space == "joint"
        kinds = rows.revolute if joint else np.arange(6) < 3
        self._evaluate = rows.by_joint if joint else rows.by_tip
        self._released, self._kinds = rows.shift.amounts
        self._angle = region.angles(rows.q)
        zero = np.zeros((len(rows.q), len(kinds)))
        at = self._evaluate(zero, np.zeros(rows.shifts))
        self._unit = correction_unit(at, kinds)
        self._before = at.residual
        self._linear = self._about(at, -at.residual)

    def choose(self, few: NDArray[np.int64], functions: int) -> _Draft:
        """Choose harmonics and solve for them, by some of the measurements.

        All that there are where they are functions of one joint each.
        """
        form = self._form
        linear = self._linear.rows(few)
        every = candidates(linear.angle.shape[1], len(self._unit), form)
        if not form.smooth:
            self._harmonics = every
            return self
        # Phases of one product join together: so a variance is the same everywhere.
        product = np.column_stack([every.component, every.orders])
        _, group = np.unique(product, axis=0, return_inverse=True)
        group = group.reshape(-1)
        size = np.bincount(group)
        chosen = np.asarray(~every.modes.any(axis=1))
        noise, left = float((linear.target**2).mean()) or 1.0, linear
        for part in ROUNDS:
            score = np.bincount(group, scores(every, left)) / size / noise
            for k in np.argsort(-score, kind="stable"):
                if score[k] < WORTH:
                    break
                phases = group == k
                if (chosen | phases).sum() <= part * functions:
                    chosen |= phases
            self._harmonics = every.at(chosen)
            sums = Sums.of(self._harmonics, linear)
            noise = self._likeliest(sums)
            self._amplitudes = self._solved(sums, noise)
            left = replace(linear, target=linear.target - self._effect(linear))
        return self

    def solve(
        self,
        training: NDArray[np.int64],
        held: NDArray[np.int64],
        report: Callable[[float], None],
    ) -> tuple[HarmonicProcess, Floats]:
        """The process of all measurements, linearized again at its predictions."""
        if self._form.smooth:
            process = self._process()
            f = process._inside(self._angle)
            at = self._evaluate(f, process.shift)
            effect = times(at.by_correction, f) + at.by_shift @ process.shift
            self._linear = self._about(at, effect - at.residual)
        report(0.7)
        known, unknown = self._linear.rows(training), self._linear.rows(held)
        sums = Sums.of(self._harmonics, known)
        self._noise = self._likeliest(sums)
        report(0.9)
        self._amplitudes = self._solved(sums, self._noise)
        before = self._before[held]
        after = self._effect(unknown) - unknown.target
        surprise = self._surprise(unknown, after)
        sums += Sums.of(self._harmonics, unknown)
        self._amplitudes = self._solved(sums, self._noise)
        result = self._process()
        if not convincing(before, after):
            after = before
            result = replace(
                result, shift=0.0 * result.shift, amplitudes=0.0 * result.amplitudes
            )
        report(1.0)
        # All variances times one number predict the same, but less surely.
        found = replace(
            result,
            root=result.root * np.sqrt(surprise),
            held_out=(root_mean_square(before), root_mean_square(after)),
        )
        return found, after

    def _about(self, at: Linearized, target: Floats) -> Linear:
        """Residuals that amplitudes and amounts of the shift should make."""
        G = at.by_shift @ self._released
        A = at.by_correction * self._unit
        return Linear(self._angle, A, G, target + at.by_shift @ self._rows.shift.about)

    def _likeliest(self, sums: Sums) -> float:
        """The noise under the likeliest covariance, which is kept."""
        self._covariance, noise, _ = likeliest(
            sums, self._harmonics, self._free(sums), self._kinds, form=self._form
        )
        return noise

    def _free(self, sums: Sums) -> Floats:
        """Variances of the free amounts before any measurement, shape (f,)."""
        count = self._released.shape[1] - sum(self._kinds)
        squares = np.diag(sums.normal)[len(self._harmonics) :][:count]
        free = FREE * sums.square
        return np.where(squares > 0.0, free / np.where(squares > 0.0, squares, 1.0), 0)

    def _solved(self, sums: Sums, noise: float) -> Amplitudes:
        variances = Variances.of(self._covariance, self._harmonics).total
        others = shift_variances(self._covariance, self._free(sums), self._kinds)
        return Amplitudes.of(sums, np.r_[variances, others], noise)

    def _effect(self, linear: Linear) -> Floats:
        """Effect of amplitudes and shifts on the residuals, shape (N, d)."""
        mean, D, m = self._amplitudes.mean, len(self._harmonics), len(self._unit)
        result = np.empty_like(linear.target)
        for part in linear.chunks():
            f = self._harmonics.combined(linear.angle[part], mean[:D], m)
            result[part] = times(linear.A[part], f) + linear.G[part] @ mean[D:]
        return result

    def _surprise(self, held: Linear, residual: Floats) -> float:
        """Mean square of residuals in their predicted variances."""
        process, some = self._process(), slice(CHECKED)
        variance = np.concatenate(
            [
                process._variance(part.angle, part.A, part.G)
                for part in map(held.rows(some).rows, _pieces(len(residual[some])))
            ]
        )
        found = float((residual[some] ** 2 / (variance + self._noise)).mean())
        return found if found > 0.0 else 1.0

    def _process(self) -> HarmonicProcess:
        found, D = self._amplitudes, len(self._harmonics)
        return HarmonicProcess(
            region=self._region,
            shift=self._released @ found.mean[D:] - self._rows.shift.about,
            space=self._form.space,
            unit=self._unit,
            harmonics=self._harmonics,
            amplitudes=found.mean[:D],
            root=found.root,
            spread=np.round(found.spread[np.tril_indices(len(found.root))], DIGITS),
            held_out=(0.0, 0.0),
            released=self._released,
            fades=self._form.smooth,
        )


def _pieces(count: int) -> list[slice]:
    return [slice(start, start + PIECE) for start in range(0, count, PIECE)]
