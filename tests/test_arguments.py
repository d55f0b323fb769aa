"""Arguments from Python: taken where they are clear, else one line that names them."""

from __future__ import annotations

import copy
import pickle
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from types import SimpleNamespace
from typing import Any, TypeVar

import numpy as np
import pinocchio as pin
import pytest
from numpy.typing import NDArray
from typing_extensions import TypeAliasType

import calib_pin
from calib_pin.estimation.formulation import nominal_problem
from calib_pin.observations.blocks import Observations
from calib_pin.observations.measurements import Measurements
from calib_pin.setup import FrameSetup, Payload, ReadingSetup, Setup, SolverSetup
from calib_pin.setup.arguments import parse

OFFSETS = Setup(parameters=("joint-offset",), tip="tool")


@cache
def known() -> SimpleNamespace:
    """A robot, measurements of it in all forms, and its calibration."""
    chain = calib_pin.load_chain("pa10", tip="tool")
    rng = np.random.default_rng(0)
    q = rng.uniform(-2.0, 2.0, (30, 7))
    T = chain.poses(q + 0.01)
    y = T[:, :3, 3] + rng.normal(0.0, 1e-4, (30, 3))
    rows = Measurements(chain.joints, q, "position", y)
    result = calib_pin.calibrate(chain, rows, OFFSETS, validate=False)
    return SimpleNamespace(
        chain=chain,
        joints=chain.joints,
        q=q,
        y=y,
        T=T,
        rows=rows,
        result=result,
        model=result.model,
        robot=result.model.of(),
        problem=nominal_problem(chain, "position", OFFSETS),
        rng=rng,
    )


def measured(k: SimpleNamespace, **changes: Any) -> Measurements:
    given = {"joints": k.joints, "q": k.q, "model": "position", "values": k.y}
    return Measurements(**(given | changes))


def calibrated(k: SimpleNamespace, *args: Any, **options: Any) -> Any:
    given = (*args, *(k.chain, k.rows, OFFSETS)[len(args) :])
    return calib_pin.calibrate(*given, **{"validate": False} | options)


def of(k: SimpleNamespace, **changes: Any) -> Any:
    return calibrated(k, k.chain, measured(k, **changes))


def by(k: SimpleNamespace, setup: Any = OFFSETS, **changes: Any) -> Any:
    setup = replace(setup, **changes) if changes else setup
    return calibrated(k, k.chain, k.rows, setup)


WRONG: dict[str, Callable[[SimpleNamespace], object]] = {
    "no robot": lambda k: calibrated(k, 5),
    "arrays": lambda k: calibrated(k, k.chain, (k.q, k.y)),
    "two columns": lambda k: of(k, values=k.y[:, :2]),
    "unknown model": lambda k: of(k, model="positions"),
    "other joints": lambda k: of(k, joints=[*k.joints[:6], "elbow"]),
    "zero quaternion": lambda k: of(k, model="pose", values=np.zeros((30, 7))),
    "long quaternion": lambda k: of(k, model="pose", values=np.ones((30, 7))),
    "masked": lambda k: measured(k, values=np.ma.masked_less(k.y, 0.0)),
    "negative weights": lambda k: measured(k, weight=np.full(30, -1.0)),
    "half a direction": lambda k: calib_pin.Conditions(direction=0.5 * k.q),
    "no rows": lambda k: of(k, q=k.q[:0], values=k.y[:0]),
    "model of no chain": lambda k: k.model.of("arm"),
    "sigma of one axis": lambda k: of(k, sigma=np.full((30, 1), 1e-4)),
    "one word as setup": lambda k: by(k, "joint-offset"),
    "unknown key": lambda k: by(k, {"parametres": []}),
    "unknown word": lambda k: by(k, {"parameters": ["x"]}),
    "parameters unknown": lambda k: by(k, Setup(parameters="x")),
    "holdout in percent": lambda k: calibrated(k, holdout=20.0),
    "holdout as text": lambda k: calibrated(k, holdout="0.2"),
    "seed": lambda k: calibrated(k, seed=-1),
    "workers": lambda k: calibrated(k, workers=4),
    "start": lambda k: calibrated(k, start="calibration.json"),
    "process noise": lambda k: calibrated(k, process_noise=[1e-5]),
    "orientation of arrays": lambda k: by(
        k, {"reading": {"orientation": {"columns": "quaternion"}}}
    ),
    "q of five joints": lambda k: k.chain.poses(np.zeros((1, 5))),
    "q as words": lambda k: k.chain.poses(["a"] * 7),
    "ragged q": lambda k: k.chain.jacobian([[0.0], [0.0, 1.0]]),
    "q of three axes": lambda k: k.chain.regressor(np.zeros((2, 7, 1))),
    "no q": lambda k: k.chain.gravity_torques(None, (0.0, 0.0, -9.81)),
    "seed for rng": lambda k: k.chain.random_configurations(3, 0),
    "chain of a name": lambda k: calib_pin.Chain("pa10"),
    "no link": lambda k: calib_pin.load_chain("pa10", tip=3),
    "model at five joints": lambda k: k.robot.poses(np.zeros(5)),
    "predict": lambda k: k.result.predict(np.zeros((2, 6))),
    "no joints": lambda k: measured(k, joints=7),
    "values as words": lambda k: measured(k, values=np.full((30, 3), "x")),
    "negative sigma": lambda k: measured(k, sigma=-1e-4),
    "sigma as text": lambda k: measured(k, sigma="0.1 mm"),
    "nan": lambda k: measured(k, q=np.full((30, 7), np.nan)),
    "validate as numbers": lambda k: measured(k, validate=[0.5] * 30),
    "few targets": lambda k: measured(k, target=["a", "b"]),
    "a number as target": lambda k: measured(k, target=range(30)),
    "blocks": lambda k: Observations((k.q,)),
    "no blocks": lambda k: Observations(()),
    "loss": lambda k: by(k, loss="x"),
    "learned": lambda k: by(k, learned="x"),
    "solver": lambda k: by(k, solver=SolverSetup("x")),
    "gravity": lambda k: Setup(gravity=9.81),
    "gravity in mm": lambda k: Setup(gravity=(0.0, 0.0, -9810.0)),
    "noise": lambda k: Setup(noise={"position": -1e-4}),
    "frame in mm": lambda k: Setup(base_frame=FrameSetup((500.0, 0.0, 0.0))),
    "frame of two": lambda k: Setup(tool_frame=FrameSetup((0.1, 0.0))),
    "frame as matrix": lambda k: Setup(tool_frame=np.eye(4)),
    "degrees": lambda k: Setup(limits={"joint_1": (-170.0, 170.0)}),
    "payload": lambda k: Setup(payloads={"box": 2.0}),
    "negative mass": lambda k: Setup(payloads={"box": Payload(-2.0, (0.0, 0.0, 0.1))}),
    "fixed": lambda k: Setup(fixed=[0]),
    "identify": lambda k: calib_pin.identify(k.chain, 3),
    "evaluate": lambda k: calib_pin.evaluate(k.result, k.rows),
    "register": lambda k: calib_pin.evaluate(k.model, k.rows, registration=1),
    "plan none": lambda k: calib_pin.plan(k.chain, "position", 0),
    "collisions": lambda k: calib_pin.plan(k.chain, "position", 9, collisions=True),
    "targets of points": lambda k: calib_pin.compensate(k.robot, k.y, k.q),
    "compensate a model": lambda k: calib_pin.compensate(k.model, k.T),
    "frame": lambda k: calib_pin.compensate(k.robot, k.T, k.q, frame="world"),
    "true errors": lambda k: calib_pin.simulate(k.problem, {}, k.rng, count=5),
    "few true errors": lambda k: calib_pin.simulate(k.problem, [0], k.rng, count=5),
    "no result": lambda k: calib_pin.compare(k.result, k.model),
    "urdf of a result": lambda k: calib_pin.write_urdf(k.result, "x.urdf"),
    "urdf of no gain": lambda k: calib_pin.write_urdf(
        replace(k.result, verdict="no-gain").geometry, "x.urdf"
    ),
    "read nothing": lambda k: calib_pin.read_setup(None),
    "clearance": lambda k: calib_pin.load_collisions(k.chain, clearance="1 mm"),
    "family": lambda k: calib_pin.register("models", "x", object),
    "member": lambda k: calib_pin.register("dialects", "x", object()),
}


@pytest.mark.parametrize("call", WRONG.values(), ids=WRONG)
def test_a_wrong_call_is_one_line(call: Callable[[SimpleNamespace], object]) -> None:
    with pytest.raises(calib_pin.CalibPinError) as caught:
        call(known())
    assert "\n" not in str(caught.value) and len(str(caught.value)) < 400


def same(found: Any, k: SimpleNamespace) -> None:
    """The calibration is the one of `known`, up to rounding by the order of sums."""
    assert np.allclose(found.model.theta, k.model.theta, rtol=0.0, atol=1e-9)


def test_clear_arguments_are_taken() -> None:
    k = known()
    listed = measured(k, joints=[*k.joints], q=k.q.tolist(), values=k.y.tolist())
    reading = replace(OFFSETS, reading=ReadingSetup(scale=0.001))
    for found in (
        calibrated(k, k.chain, listed),
        of(k, q=k.q.astype(object)),
        calibrated(k, "pa10"),
        by(k, Setup(parameters="joint-offset")),
        by(k, {"parameters": ["joint-offset"]}),
        of(k, joints=k.joints[::-1], q=k.q[:, ::-1]),
        calibrated(k, k.chain, measured(k, values=1e3 * k.y), reading),
        pickle.loads(pickle.dumps(calib_pin.calibrate))(
            k.chain, [k.rows][0], OFFSETS, validate=False
        ),
    ):
        same(found, k)
    told = measured(k, sigma=5e-5).sigma
    assert told is not None and told.shape == (30, 3) and (told == 5e-5).all()
    assert np.array_equal(k.chain.poses(k.q[0]), k.chain.poses(k.q[:1]))
    one = calib_pin.compensate(k.robot, k.robot.poses(k.q[0])[0], k.q[0])
    assert one.complete and len(one) == 1
    heights = Measurements(["lift"], [[0.1], [0.2]], "plane-distance", [1.0, 2.0])
    assert heights.values.shape == (2, 1)


def test_arrays_are_read_as_files_are() -> None:
    """Quaternions have length one, and joints come from where they stood before."""
    k, setup = known(), replace(OFFSETS, tool_frame=FrameSetup(estimate=False))
    turned = np.array([pin.SE3ToXYZQUAT(pin.SE3(T)) for T in k.T])
    longer = turned * np.repeat([1.0, 1.005], (3, 4))
    thetas = [
        calibrated(k, k.chain, measured(k, model="pose", values=poses), setup)
        for poses in (turned, longer)
    ]
    assert np.allclose(*(found.model.theta for found in thetas), rtol=0.0, atol=1e-12)
    lost = Setup(parameters=("joint-offset", "hysteresis"), tip="tool")
    moved = np.sign(np.diff(k.q, axis=0, prepend=k.q[:1]))
    stated = measured(k, conditions=calib_pin.Conditions(direction=moved))
    found, same = (calibrated(k, k.chain, r, lost) for r in (k.rows, stated))
    assert np.array_equal(found.model.theta, same.model.theta)


def test_errors_name_arguments() -> None:
    k = known()
    with pytest.raises(calib_pin.CalibPinError, match="name one with tip=;"):
        calib_pin.load_chain("example:ur10_robot")
    with pytest.raises(TypeError, match=r"calibrate\(\) .* argument 'parameters'"):
        calibrated(k, parameters="dh")


def test_a_robot_may_be_the_text_of_its_urdf() -> None:
    k = known()
    chain = calib_pin.load_chain(k.chain.robot.source.decode(), tip="tool")
    assert np.array_equal(chain.poses(k.q), k.chain.poses(k.q))
    with pytest.raises(calib_pin.CalibPinError, match=r"^robot_description:1: "):
        calib_pin.load_chain("<robot>")


def test_a_copy_of_a_result_is_whole() -> None:
    result = known().result
    for other in (pickle.loads(pickle.dumps(result)), copy.deepcopy(result)):
        assert other.covariance.rows == result.covariance.rows != ()
        assert calib_pin.format_report(other) == calib_pin.format_report(result)


def test_a_result_stays_as_it_is() -> None:
    """Whatever becomes of the arrays that it was made from, and of those it gives."""
    k = known()
    y, found = k.y.copy(), k.result.residuals
    result, before = of(k, values=y), np.array(found)
    y *= 1e3
    assert np.array_equal(result.fitted.rows.only.values, k.y)
    found *= 1e3
    assert np.array_equal(k.result.fitted.after, before)


def test_annotations_may_be_aliases() -> None:
    # As NDArray is one from numpy 2.5 on, which needs Python 3.12.
    of = TypeVar("of", bound=np.generic)
    alias: Any = TypeAliasType("alias", NDArray[of], type_params=(of,))
    for hint in (alias[np.float64], alias[np.float64] | None):
        found = parse("q", [1, 2], hint)
        assert found.dtype == np.float64 and found.tolist() == [1.0, 2.0]


@pytest.mark.slow
def test_arrays_in_mm_are_told_what_to_do() -> None:
    k = known()
    found = of(k, values=1e3 * k.y)
    assert "; multiply values by 0.001, or state in the setup" in found.reason
    (after,) = (f.evidence["rms_after"] for f in found.findings if f.code == "unit")
    assert f"{1e3 * float(after):.3g} mm" in found.reason and float(after) < 0.1


def test_what_is_shown_is_short() -> None:
    k = known()
    assert repr(k.chain) == "Chain(pa10: base_link to tool, 7 joints)"
    assert repr(Observations((k.rows,))) == "Observations(30 position)"
    assert repr(Setup(tip="tool")) == "Setup(tip='tool')"
    assert "q=array (30, 7), model='position'" in repr(k.rows)
    for found in (k.model, k.robot, k.rows, calib_pin.compensate(k.robot, k.T, k.q)):
        assert len(repr(found)) < 400
    lines = calib_pin.format_report(k.result).splitlines()
    assert repr(k.result).splitlines()[:8] == lines[:8]
    plan = calib_pin.plan(
        k.chain, "position", 9, OFFSETS, candidates=40, method="exchange"
    )
    study = calib_pin.identify(k.chain, "position", OFFSETS)
    judged = calib_pin.evaluate(k.model, k.rows)
    for found in (k.result, plan, study, judged, calib_pin.compare(k.result, k.result)):
        assert 1 < len(repr(found).splitlines()) <= 17
