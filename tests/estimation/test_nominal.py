"""Whether measurements tell how large a robot is."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import calib_pin
from calib_pin.errors import OptionError
from calib_pin.estimation.formulation import nominal_problem
from calib_pin.estimation.nominal import (
    jacobian_at,
    observable_configurations,
    scale_deviation,
)
from calib_pin.setup import (
    AnchorSetup,
    CameraSetup,
    DistanceSetup,
    FrameSetup,
    PlaneSetup,
    PointSetup,
    Setup,
    SphereSetup,
)

ARM = calib_pin.load_chain("space6")
TOOL = FrameSetup((0.05, 0.08, 0.12), (0.2, -0.3, 0.1), estimate=True)
BASE = FrameSetup((1.5, -0.4, 0.3), (0.3, 0.2, 2.0), estimate=True)
FAR = FrameSetup((0.1, -0.2, 3.0), (0.3, -0.2, 0.4), estimate=True)
POINTS = {
    "a": PointSetup((0.05, 0.08, 0.12)),
    "b": PointSetup((-0.06, 0.03, 0.1)),
    "c": PointSetup((0.02, -0.07, 0.15)),
    "d": PointSetup((0.1, 0.1, -0.05)),
}
SOCKETS = {"s/0": PointSetup((0.6, 0.3, 0.4)), "s/1": PointSetup((0.5, -0.2, 0.6))}
TABLE = PlaneSetup((0, 0.1, 1), -0.4)
DOORS = {"a": TABLE, "b": PlaneSetup((1, 0.1, 0.3), -0.5)}
BALL = SphereSetup((0.5, 0.2, 0.4), 0.15)
CAMERA = CameraSetup("world", (900.0, 910.0), (640.0, 500.0))
TIED = (DistanceSetup(("s/0", "s/1"), 0.5, 1e-5),)
IN_SOCKETS: dict[str, Any] = {"sockets": SOCKETS, "tool_frame": TOOL}


def scaled(model: str, **stated: Any) -> bool:
    found = calib_pin.identify(ARM, model, Setup(**stated))
    return found.identifiability.scale_observable


SEEN: dict[str, Any] = {"camera": CAMERA, "base_frame": FAR}
UNKNOWN = {k: replace(p, estimate=True) for k, p in POINTS.items()}


@pytest.mark.parametrize(
    ("model", "stated", "expected"),
    [
        ("position", {"base_frame": BASE, "targets": POINTS}, True),
        ("plane-distance", {"planes": {"a": PlaneSetup((0, 1, 4.6), -0.69)}}, True),
        ("point-distance", {"anchors": {"w": AnchorSetup((1.5, 0.2, 0.4))}}, True),
        ("relative-distance", {"tool_frame": TOOL}, True),
        ("fixed-point", IN_SOCKETS, False),
        ("plane-contact", {"planes": DOORS, "tool_frame": TOOL}, False),
        # The radius of a sphere is a length.
        ("sphere-contact", {"spheres": {"s": BALL}, "tool_frame": TOOL}, True),
        (
            "sphere-contact",
            {"spheres": {"s": replace(BALL, estimate_radius=True)}, "tool_frame": TOOL},
            False,
        ),
        # So is what lies between points that are known.
        ("camera", {**SEEN, "targets": POINTS, "tool_frame": TOOL}, True),
        ("camera", {**SEEN, "targets": UNKNOWN}, False),
    ],
)
def test_models(model: str, stated: dict[str, Any], expected: bool) -> None:
    assert scaled(model, **stated) == expected


@pytest.mark.parametrize(
    "stated",
    [
        {"distances": TIED},
        # A robot of which one length is known cannot grow.
        {"fixed": ("joint_3.placement.x",)},
        {"sockets": {name: replace(s, estimate=False) for name, s in SOCKETS.items()}},
        {"parameters": ("joint-offset",), "tool_frame": replace(TOOL, estimate=False)},
        {"prior": {"joint_3.placement.x": 1e-3}},
        # Nothing of it is estimated, and nothing of it can be too large.
        {"tool_frame": replace(TOOL, estimate=False), "fixed": ("*.placement.*",)},
    ],
    ids=["distance", "held length", "known sockets", "offsets", "prior", "known robot"],
)
def test_what_gives_sockets_their_scale(stated: dict[str, Any]) -> None:
    assert scaled("fixed-point", **{**IN_SOCKETS, **stated})


@pytest.mark.parametrize(
    "stated",
    [
        # Angles are no lengths.
        {"fixed": ("*.placement.r?",)},
        # Where joint 1 stands is told by the sockets, which are free.
        {"fixed": ("joint_1.placement.*",)},
        {"prior": {"joint_1.placement.*": 1e-3}},
        {"parameters": ("placement", "transmission")},
    ],
    ids=["held angles", "held base", "prior of the base", "gears"],
)
def test_what_does_not(stated: dict[str, Any]) -> None:
    assert not scaled("fixed-point", **{**IN_SOCKETS, **stated})


def deviation(**stated: Any) -> float:
    """Standard deviation of the logarithm of the size of a robot in two sockets."""
    setup = Setup(**{**IN_SOCKETS, **stated})
    problem = nominal_problem(ARM, "fixed-point", setup)
    zero, rng = np.zeros(len(problem.parameters)), np.random.default_rng(0)
    at = [observable_configurations(problem, problem.only.key, zero, 80, rng)]
    return scale_deviation(problem, zero, at, jacobian_at(problem, zero, at))


@pytest.mark.parametrize("sigma", [1e-6, 0.1])
def test_a_distance_is_as_good_as_its_sigma(sigma: float) -> None:
    """And no better than what the rows know of the sockets."""
    apart = float(np.linalg.norm([0.1, 0.5, -0.2]))
    known = (DistanceSetup(("s/0", "s/1"), apart, sigma),)
    # Forty rows in each socket tell its center to 0.1 mm / 6.3 in every direction.
    ends = np.sqrt(2.0 / 40.0) * 1e-4
    expected = np.hypot(sigma, ends) / apart
    assert deviation(distances=known) == pytest.approx(expected, rel=0.1)
    # A tenth of a meter in half of one is no scale.
    assert scaled("fixed-point", **IN_SOCKETS, distances=known) == (sigma < 0.01)


def test_a_prior_is_as_good_as_its_deviation() -> None:
    priors = (1e-4, 1e-2)
    found = [deviation(prior={"joint_3.placement.x": sigma}) for sigma in priors]
    ratios = np.array(found) / priors
    np.testing.assert_allclose(ratios, ratios[0], rtol=1e-3)


def test_nothing_to_grow_and_nothing_to_tell() -> None:
    known = replace(TOOL, estimate=False)
    assert deviation(parameters=("joint-offset",), tool_frame=known) == 0.0
    assert deviation() > 1e3


def test_too_many_parameters(
    monkeypatch: pytest.MonkeyPatch, refused: Callable[..., Any]
) -> None:
    monkeypatch.setattr("calib_pin.estimation.nominal.MOST", 48)
    calib_pin.identify(ARM, "position")
    targets = {name: POINTS[name] for name in "abc"}
    with refused(OptionError, value=57):
        calib_pin.identify(ARM, "position", Setup(targets=targets))
