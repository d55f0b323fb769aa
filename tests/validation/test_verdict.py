"""The verdict deserves its trust: findings of trials, each as a small case.

Jobs, defects and the true errors of the tool are those of `scripts/benchmark verdict`,
where all of it is looked at in numbers.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import calib_pin
from benchmarks.verdict import components, coverage, defects, real, workspace
from benchmarks.verdict.jobs import Job, draw, stream
from benchmarks.verdict.truth import judged
from calib_pin.errors import InputError
from calib_pin.estimation.fit import fit
from calib_pin.estimation.formulation import make_problem, nominal_problem
from calib_pin.observations import BlockKey, Observations
from calib_pin.setup import AnchorSetup, Setup
from calib_pin.validation.splits import Grouping, folds

DATA = Path(
    os.environ.get("CALIB_PIN_DATA", Path(__file__).parents[2] / "shared" / "data")
)
needs_data = pytest.mark.skipif(
    not DATA.is_dir(), reason=f"no real measurements in {DATA} (CALIB_PIN_DATA)"
)


def calibrated(case: defects.Case) -> calib_pin.CalibrationResult:
    return calib_pin.calibrate(
        case.job.chain, case.rows, case.setup, validation=case.validation
    )


def tracked(number: int = 0, **changes: float | str | bool) -> Job:
    """Sixty positions of space6 with a noise of 0.1 mm a component."""
    given: dict[str, float | str | bool] = {
        "robot": "space6",
        "model": "position",
        "multiple": 1.0,
        "least": 60,
        "noise": 1e-4,
        "stated": True,
    }
    return draw(number, **(given | changes))  # type: ignore[arg-type]


def spoiled(
    job: Job, row: int, size: float
) -> tuple[calib_pin.Measurements, calib_pin.Measurements]:
    """Measurements of a job, and the same with one of them spoiled."""
    rows = job.measured(stream(job.number, 1))
    rng = stream(job.number, 2)
    return rows, defects.spoil(rows, np.array([row]), np.array([size]), rng)


def requires_named(
    job: Job, rows: calib_pin.Measurements, bad: calib_pin.Measurements, row: int
) -> None:
    """The bad row is set aside and named, and the tool is as if it were not there."""
    result = calib_pin.calibrate(job.chain, bad, job.setup)
    others = rows.rows(np.arange(len(rows)) != row)
    alone = calib_pin.calibrate(job.chain, others, job.setup, validate=False)
    outcome = judged(job, result)
    assert result.verdict == "good", result.reason
    assert [(o.row, o.weight < 0.5) for o in result.statistics.outliers] == [
        (row, True)
    ]
    assert outcome.actual <= 1.1 * judged(job, alone).actual
    assert outcome.actual <= 2.0 * outcome.predicted


# 1: chi-square by degrees of freedom 680, and `good`.


def test_one_spoiled_measurement_with_a_stated_sigma() -> None:
    job = tracked()
    requires_named(job, *spoiled(job, 17, 0.02), 17)


# 2: a perfect robot was `untrusted`, since nothing is to be gained.


@pytest.mark.parametrize("number", range(3))
def test_a_perfect_robot_has_nothing_to_gain(number: int) -> None:
    job = tracked(number, perfect=True, stated=number != 1)
    rows = job.measured(stream(number, 1))
    result = calib_pin.calibrate(job.chain, rows, job.setup)
    assert result.verdict == "no-gain", result.reason
    assert result.reason and result.geometry is None


def test_rounding_is_no_error_of_a_robot() -> None:
    chain = calib_pin.load_chain("space6")
    problem = nominal_problem(chain, "position", Setup())
    perfect = np.zeros(len(problem.parameters))
    rows = calib_pin.simulate(problem, perfect, stream(0), count=40, noise=0.0)
    assert calib_pin.calibrate(chain, rows).verdict == "no-gain"


def test_a_perfect_robot_gets_its_nominal_urdf(
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    from calib_pin.cli import main

    # The figures of the page take the longest.
    monkeypatch.setattr("calib_pin.cli.requests.draw_calibration", lambda *about: [])
    job = tracked(perfect=True)
    nominal = calib_pin.robot_file("space6", "robot.urdf")
    rows, out = tmp_path / "rows.csv", tmp_path / "out"
    calib_pin.write_measurements(rows, job.measured(stream(0, 1)))
    words = ["calibrate", str(nominal), str(rows), "--model", "position", "-o"]
    assert main([*words, str(out)]) == 0
    assert "NO GAIN" in capsys.readouterr().out
    (written,) = (p for p in out.glob("*.urdf") if p.name != "nominal.urdf")
    assert written.read_bytes() == nominal.read_bytes()


# 3: `good` with 3.6 m on the validation measurements.


def test_an_instrument_that_has_moved_is_registered_anew() -> None:
    case = defects.DEFECTS["instrument moved"](0)
    result = calibrated(case)
    assert result.findings
    if result.verdict == "good":
        after = result.errors[0].validation_after
        assert after is not None
        # Six of the unknowns are found by the thirty measurements themselves.
        assert 0.5 < after.rms / (np.sqrt(3.0) * case.job.noise) < 2.0


# 4: `good` with every length too large, a wrong socket distance, a wrong board.


@pytest.mark.parametrize(
    ("kind", "number", "words"),
    [
        ("lengths 1-5 % too large", 5, ("scale", "length")),
        ("socket distance", 6, ("distance", "scale")),
        ("board", 82, ("board", "scale", "target")),
    ],
)
def test_wrong_lengths_are_not_trusted(
    kind: str, number: int, words: tuple[str, ...]
) -> None:
    result = calibrated(defects.DEFECTS[kind](number))
    assert result.verdict == "untrusted"
    assert any(word in result.reason for word in words), result.reason


@pytest.mark.slow
@needs_data
def test_real_lengths_five_percent_too_large() -> None:
    chain = calib_pin.load_chain("example:ur10_robot", base="base_link", tip="tool0")
    file = DATA / "ur10_tmac" / "train.csv"
    rows = calib_pin.read_measurements(file, chain, model="position").only
    rows = replace(rows, values=1.05 * rows.values)
    result = calib_pin.calibrate(chain, rows)
    assert result.verdict == "untrusted"
    assert "scale" in result.reason or "length" in result.reason


@pytest.mark.slow
@needs_data
def test_a_real_socket_distance_of_60_for_50_mm() -> None:
    chain = calib_pin.load_chain("example:panda", tip="panda_link8")
    file = DATA / "mukca_panda" / "panda_1.csv"
    rows = calib_pin.read_measurements(file, chain, model="fixed-point")
    right = real.known_distances(rows)
    wrong = tuple(replace(d, value=0.06) for d in right.distances)
    result = calib_pin.calibrate(chain, rows, replace(right, distances=wrong))
    assert result.verdict == "untrusted"
    assert "distance" in result.reason or "scale" in result.reason


# 5: `good` for five poses that were repeated 30 times each.


def test_five_poses_many_times_are_unchecked() -> None:
    result = calibrated(defects.DEFECTS["five configurations"](8))
    assert result.verdict == "unchecked", result.reason


# 6: `good` although a known distance is missed by 12 of its standard deviations.


def test_a_contradicted_distance_is_named() -> None:
    result = calibrated(defects.DEFECTS["ruler distance"](9))
    missed = [d for d in result.distances if abs(d.found - d.value) > 5.0 * d.sigma]
    if missed:
        assert result.verdict == "untrusted"
        assert "distance" in result.reason


# 7: outliers were never found in a mix; a part that is all validation broke it.


def mixed(validate: bool = False) -> tuple[Job, Observations, Setup]:
    """Sixty positions, then sixty distances, of space6."""
    job = tracked()
    wire = {"wire": AnchorSetup((1.5, 0.2, 0.4), 0.01, estimate_bias=True)}
    setup = Setup(anchors=wire)
    base = replace(components.TRUTH, anchors=wire, noise=job.problem.setup.noise)
    keys = BlockKey("position"), BlockKey("point-distance")
    problem = nominal_problem(job.chain, keys, base)
    rng = stream(0, 1)
    theta = np.zeros(len(problem.parameters))
    names = job.problem.parameters.names
    theta[[problem.parameters.index(name) for name in names]] = job.theta
    q = job.chain.random_configurations(120, rng)
    positions, distances = (
        calib_pin.simulate(problem, theta, rng, key=key, q=own)
        for key, own in zip(keys, np.split(q, 2), strict=True)
    )
    block = distances.only
    block = replace(block, validate=np.full(len(block), validate))
    return job, Observations.of(positions, block), setup


@pytest.mark.parametrize("row", [17, 90])
def test_outliers_are_found_in_a_mix(row: int) -> None:
    job, rows, setup = mixed()
    blocks = list(rows.blocks)
    spoiled, values = blocks[row // 60], blocks[row // 60].values.copy()
    values[row % 60, 0] += 0.02
    blocks[row // 60] = replace(spoiled, values=values)
    result = calib_pin.calibrate(job.chain, Observations.of(*blocks), setup)
    assert row in {outlier.row for outlier in result.statistics.outliers}


def test_a_part_that_is_all_validation() -> None:
    job, rows, setup = mixed(validate=True)
    with pytest.raises(InputError) as error:
        calib_pin.calibrate(job.chain, rows, setup)
    assert error.value.column == "set"
    assert "'point-distance' measurement is left to fit" in error.value.reason


# 8: predictions mixed a covariance about one reference with another's Jacobian.


def test_predictions_do_not_depend_on_the_first_guess() -> None:
    job = tracked(model="point-distance", least=150)
    rows = job.measured(stream(0, 1))
    near = calib_pin.calibrate(job.chain, rows, job.setup, validate=False)
    far = calib_pin.calibrate(
        job.chain, rows, coverage.far(job.setup, stream(0, 3)), validate=False
    )
    assert near.accuracy.tip is not None and far.accuracy.tip is not None
    # The solutions are the same up to the tolerance of the solver.
    assert far.accuracy.tip.rms == pytest.approx(near.accuracy.tip.rms, rel=1e-4)
    assert judged(job, far).actual == pytest.approx(judged(job, near).actual, rel=1e-3)


# 9: priors and known distances were scaled by the unit weight of the measurements.


def test_no_posterior_is_wider_than_its_prior() -> None:
    job = tracked(stated=False, noise=1e-3)  # Ten times what is assumed.
    sizes = {
        p.name: 0.5 * p.scale
        for p in job.problem.parameters
        if p.free and not p.nuisance
    }
    setup = replace(job.setup, prior=sizes)
    rows = job.measured(stream(0, 1))
    result = calib_pin.calibrate(job.chain, rows, setup, validate=False)
    deviations = np.sqrt(np.diag(result.covariance))
    for parameter, deviation in zip(result.parameters, deviations, strict=True):
        if parameter.name in sizes:
            assert deviation <= sizes[parameter.name] * (1.0 + 1e-9), parameter.name


# 10: random folds of a jogged file promised a tenth of the error that was found.


def test_folds_keep_stretches_together() -> None:
    job = tracked(least=150)
    rng = stream(0, 1)
    rows = job.measured(rng, q=defects.path(job, rng, 150))
    fitted = fit(make_problem(job.chain, rows, job.setup), np.random.default_rng(0))
    masks = folds(Grouping.of(fitted.problem.data, job.setup), fitted, 0)
    # A fold of random rows would have about 24 stretches of its 30 rows.
    for mask in masks:
        assert np.abs(np.diff(mask.astype(int))).sum() <= 8


# 11: `good`, and the URDF is worse than the nominal one over the workspace.


@pytest.mark.parametrize(
    "number",
    [0, 4, 5, *(pytest.param(number, marks=pytest.mark.slow) for number in (16, 49))],
)
def test_never_worse_than_nominal(number: int) -> None:
    outcome = workspace.run(number)
    assert outcome.verdict not in ("crash", "refused"), outcome.reason
    assert not outcome.worse, outcome
    assert not outcome.false, outcome


# 12: one of 60 steers the fit; a copy of the training file passes as validation.


@pytest.mark.parametrize("size", [0.005, 0.02, 0.06])
def test_one_bad_measurement_does_not_steer(size: float) -> None:
    job = tracked(1, stated=False)
    requires_named(job, *spoiled(job, 41, size), 41)


def test_a_copy_of_the_training_file_is_no_validation() -> None:
    job = tracked()
    rows = job.measured(stream(0, 1))
    result = calib_pin.calibrate(job.chain, rows, job.setup, validation=rows)
    assert result.validation.method != "file"
    assert result.findings


# 13: small things.


def test_a_prismatic_joint_without_limits(
    urdf_of: Callable[..., str], chain_of: Callable[..., calib_pin.Chain]
) -> None:
    lift = {"name": "lift", "type": "prismatic", "parent": "a", "child": "b"}
    turn = {"name": "turn", "parent": "b", "child": "c"}
    text = urdf_of(lift, turn)
    unlimited = text.replace('lower="-2.0" upper="2.0" ', "", 1)
    assert unlimited != text
    chain = chain_of(unlimited)
    # Half a turn is no length.
    assert -3.0 < chain.lower[0] < chain.upper[0] < 3.0


@pytest.mark.slow
@needs_data
def test_a_learned_model_is_registered_elsewhere() -> None:
    """The derivative where a correction fades belongs to the step."""
    chain = calib_pin.load_chain("example:ur10_robot", base="base_link", tip="tool0")
    train, other = (
        calib_pin.read_measurements(DATA / name / "train.csv", chain, model="position")
        for name in ("ur10_tmac", "ur10_tmac_b")
    )
    setup = Setup(learned="gaussian-process")
    model = calib_pin.calibrate(chain, train, setup, validate=False).model
    found = calib_pin.evaluate(model, other, registration=True)
    assert found.verdict == "good", found.reason


# What is built on top of the findings.


@pytest.mark.slow
@needs_data
def test_a_doubtful_place_is_named() -> None:
    for line in real.panda_2():
        assert line.passed is not False, line


def test_variance_components_are_recovered() -> None:
    for number in range(2):
        found = components.run(number)
        assert not found.problem and len(found.found) == 2
        for name, ratio, _ in found.found:
            # Three standard deviations of the one with the least redundancy.
            assert 0.7 < ratio < 1.35, (name, ratio)
