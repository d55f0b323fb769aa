"""Robust fits: measurements that are wrong are named, and steer nothing.

The jobs are those of `scripts/benchmark recovery`, with some configurations spoiled.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest
from numpy.typing import NDArray

import calib_pin
from benchmarks.recovery import CASES, Study
from calib_pin.errors import OptionError
from calib_pin.estimation.fit import fit
from calib_pin.estimation.fitted import Fit
from calib_pin.estimation.problem import Problem
from calib_pin.kinematics.spatial import Floats
from calib_pin.observations import Measurements, Observations
from calib_pin.setup import LOSSES

GROSS = (5e-3, 1.0)
"""Sizes of gross errors, equally often in every factor [m, rad, kpx]."""

BENT = (5e-3, 0.3)
"""The same of every joint where contacts have no values to spoil [rad]."""


@dataclass(frozen=True)
class Job:
    """Simulated measurements of one robot, some of which are spoiled.

    Attributes:
        study: What was measured.
        truth: True parameter values, shape (P,).
        rows: The measurements.
        bad: The spoiled rows, shape (N,).
    """

    study: Study
    truth: Floats
    rows: Observations
    bad: NDArray[np.bool_]

    def fit(
        self, loss: str = "auto", rows: Measurements | Observations | None = None
    ) -> Fit:
        problem = self.study.problem
        setup = replace(problem.setup, loss=loss)
        data = Observations.of(self.rows if rows is None else rows)
        return fit(replace(problem, data=data, setup=setup), np.random.default_rng(0))

    def ahead(self, fitted: Fit) -> float:
        """Error on new configurations, in the standard deviations of the rows."""
        # Those of a fit that was spoiled are wide enough for anything.
        given = replace(fitted.problem, units=np.zeros(0))
        plain = replace(fitted, problem=given)
        return float(np.sqrt(self.study._ahead(self.truth, plain)[0]))

    def named(self, fitted: Fit) -> NDArray[np.bool_]:
        """The rows that were set aside, which are those that are named."""
        aside = fitted.problem.data.weight == 0.0
        rows = sorted(o.row for o in fitted.robust.outliers)
        assert rows == np.flatnonzero(aside).tolist()
        assert all(outlier.weight == 0.0 for outlier in fitted.robust.outliers)
        return aside


def job(name: str, share: float, seed: int, size: float = 1.0, count: int = 0) -> Job:
    """A job of a case with a share of its configurations spoiled."""
    study, rng = Study(CASES[name]), np.random.default_rng(seed)
    study.rng = rng
    truth, case = study.truth(size), study.case
    rows = calib_pin.simulate(
        study.problem, truth, rng, count=count or case.rows, noise=case.noise
    )
    number = round(share * rows.configurations)
    bad = np.isin(rows.groups(), rng.choice(rows.configurations, number, replace=False))
    if bad.any():
        rows = spoiled(study.problem, rows, bad, rng)
    return Job(study, truth, rows, bad)


def spoiled(
    problem: Problem,
    found: Observations,
    bad: NDArray[np.bool_],
    rng: np.random.Generator,
) -> Observations:
    """Rows with gross errors in random directions in some of them, shape (N,)."""
    measurement, rows = problem.only.measurement, found.only
    if measurement.declaration.contact:
        sizes = np.exp(rng.uniform(*np.log(BENT), (len(rows), 1)))
        signs = rng.choice([-1.0, 1.0], rows.q.shape)
        q = np.where(bad[:, None], rows.q + sizes * signs, rows.q)
        return Observations.of(replace(rows, q=q))
    assert rows.sigma is not None
    errors = np.zeros(rows.sigma.shape)
    for quantity in measurement.quantities:
        drawn = rng.normal(size=(len(rows), errors[:, quantity.columns].shape[1]))
        drawn /= np.linalg.norm(drawn, axis=1)[:, None]
        sizes = np.exp(rng.uniform(*np.log(GROSS), (len(rows), 1)))
        sizes *= 1e3 if quantity.unit == "px" else 1.0
        errors[:, quantity.columns] = drawn * sizes
    errors[~bad] = 0.0
    values = measurement.disturb(rows.values, errors)
    return Observations.of(replace(rows, values=values))


def test_clean_rows_give_the_least_squares_fit() -> None:
    clean = job("position", 0.0, 1)
    squared = clean.fit("squared")
    for loss in ("auto", "gnc"):
        found = clean.fit(loss)
        np.testing.assert_array_equal(found.theta, squared.theta)
        np.testing.assert_array_equal(found.covariance, squared.covariance)
        assert found.robust.outliers == ()
        assert found.robust.squared is None and found.robust.disagreement == 0.0


@pytest.mark.parametrize(
    ("name", "share", "size"),
    [
        ("position", 0.2, 1.0),
        ("pose", 0.4, 5.0),
        ("plane-contact", 0.2, 1.0),
        pytest.param("camera", 0.2, 1.0, marks=pytest.mark.slow),
    ],
)
def test_spoiled_configurations_steer_nothing(
    name: str, share: float, size: float
) -> None:
    """As good as the fit with the good ones alone: issue 16, robustness."""
    found = job(name, share, 0, size)
    fitted, good = found.fit(), found.fit("squared", found.rows.rows(~found.bad))
    named = found.named(fitted)
    assert found.ahead(fitted) < 1.3 * found.ahead(good)
    assert not named[~found.bad].any()
    about_good = replace(good.problem, data=found.rows)
    z = about_good.errors(good.theta) / about_good.given_sigma
    (block,) = about_good.blocks
    gross = found.bad & (np.linalg.norm(block.table(z), axis=1) > 10.0)
    assert named[gross].all() and gross.sum() > 0.5 * found.bad.sum()


@pytest.mark.parametrize(("millimeters", "stated"), [(60.0, True), (5.0, False)])
def test_one_wrong_measurement_of_sixty(millimeters: float, stated: bool) -> None:
    """It steered the fit by 0.23 to 2.61 mm, and its sigma of 0.1 mm was believed."""
    found = job("position", 0.0, 4)
    values = found.rows.blocks[0].values.copy()
    values[17] += 1e-3 * millimeters * np.array([0.6, 0.0, 0.8])
    sigma = np.full(values.shape, 1e-4) if stated else None
    rows = replace(found.rows.only, values=values, sigma=sigma)
    fitted = found.fit(rows=rows)
    assert [outlier.row for outlier in fitted.robust.outliers] == [17]
    # What it would be with it.
    assert fitted.robust.squared is not None
    assert found.ahead(fitted.robust.squared) > 3.0 * found.ahead(fitted)
    without = found.fit("squared", rows.rows(np.arange(60) != 17))
    assert found.ahead(fitted) == pytest.approx(found.ahead(without), rel=1e-5)
    # Told to, it counts like the others, and is named all the same.
    squared = found.fit("squared", rows)
    assert (squared.problem.data.weight == 1.0).all()
    assert squared.robust.outliers[0].row == 17
    assert squared.robust.outliers[0].weight == 1.0


def test_what_has_no_majority_is_left_alone() -> None:
    """A joint that turns the other way: no solution holds most of the rows."""
    found = job("position", 0.0, 3)
    q = found.rows.q * [1.0, 1.0, -1.0, 1.0, 1.0, 1.0]
    fitted = found.fit(rows=replace(found.rows.only, q=q))
    assert (fitted.problem.data.weight == 1.0).all()
    assert fitted.robust.squared is None


def test_rows_that_were_exchanged_are_named() -> None:
    found = job("position", 0.0, 5)
    values = found.rows.blocks[0].values.copy()
    values[[10, 20]] = values[[20, 10]]
    fitted = found.fit(rows=replace(found.rows.only, values=values))
    told = {o.row: o.cause for o in fitted.robust.outliers}
    assert told == {10: "exchanged with row 20", 20: "exchanged with row 10"}


def test_corners_fail_alone_and_images_as_a_whole() -> None:
    """A corner in each of ten images, and an image of which all corners are off."""
    study, rng = Study(CASES["camera"]), np.random.default_rng(4)
    truth = study.truth()
    found = calib_pin.simulate(
        study.problem, truth, rng, count=40, per_configuration=True, noise=0.3
    )
    images = found.groups()
    whole = images == 7
    bad = whole | np.isin(np.arange(len(images)), np.unique(images, True)[1][10:20])
    values = found.only.values + 25.0 * bad[:, None]
    spoiled = Job(
        study, truth, Observations.of(replace(found.only, values=values)), bad
    )
    fitted = spoiled.fit()
    assert spoiled.named(fitted).tolist() == bad.tolist()
    clean = replace(spoiled, rows=found)
    assert spoiled.ahead(fitted) < 1.3 * spoiled.ahead(clean.fit())


def test_unknown_loss() -> None:
    with pytest.raises(OptionError) as error:
        job("position", 0.0, 1).fit("gnd")
    assert error.value.allowed == ", ".join(LOSSES)
