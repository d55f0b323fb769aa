"""The problem that a setup and measurements amount to, and variants of the setup."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pinocchio as pin

from calib_pin.errors import OptionError, nearest
from calib_pin.estimation.problem import Problem
from calib_pin.kinematics.chain import Chain
from calib_pin.measurement_models import measurement_model
from calib_pin.measurement_models.mount import Frame
from calib_pin.observations import Measurements
from calib_pin.parameterizations import (
    NOTHING,
    beyond_geometry,
    frame_pose,
    required_keys,
)
from calib_pin.parameterizations.error_model import ErrorModel
from calib_pin.parameters import matching
from calib_pin.setup import Setup


def make_problem(chain: Chain, data: Measurements, setup: Setup) -> Problem:
    """Error model, measurement model and data of a setup put together.

    A measurement frame exists for positions and poses. A laser distance sensor measures
    against a plane given in the base, which is known unless the setup frees it.

    Raises:
        OptionError: If a name in the setup does not exist.
    """
    model = measurement_model(data.model, setup, data.target)
    _require_payloads(data, setup)
    base, tool = setup.base_frame.estimate, setup.tool_frame.estimate
    try:
        error = ErrorModel.create(
            chain,
            setup.parameters,
            setup=setup,
            estimate_base=model.declaration.external if base is None else base,
            estimate_tool=model.sees_tool if tool is None else tool,
        )
    except OptionError as mistake:
        raise mistake.within(setup.file) from None
    return Problem(error, model, data, setup)


def nominal_problem(chain: Chain, model: str, setup: Setup) -> Problem:
    """A problem without rows, about the frames and instrument that the setup gives.

    Raises:
        OptionError: If the instrument needs a reference that the setup lacks.
    """
    measurement = measurement_model(model, setup)
    targets = tuple(measurement.targets) or ("",)
    payloads = tuple(setup.payloads) or ("",)
    count = len(targets) * len(payloads)
    data = Measurements(
        joints=chain.joints,
        q=np.zeros((count, len(chain.joints))),
        model=model,
        values=np.zeros((count, measurement.width)),
        target=targets * len(payloads),
        payload=tuple(name for name in payloads for _ in targets),
    )
    problem = make_problem(chain, data, setup)
    missing = problem.measurement.missing
    if missing:
        raise OptionError(f"a {model} study without measurements: {missing}")
    frames = frame_pose(setup.base_frame), frame_pose(setup.tool_frame)
    # A camera among other instruments is placed by rows; here it stands with them.
    references = [
        replace(reference, pose=pin.SE3.Identity())
        if isinstance(reference, Frame) and not reference.located
        else reference
        for reference in problem.measurement.references
    ]
    return replace(
        problem,
        error=problem.error.with_frames(*frames),
        measurement=problem.measurement.with_references(references),
    )


def restricted(setup: Setup, names: Sequence[str]) -> Setup:
    """The setup without what it says of parameters that are not there.

    Args:
        setup: The setup.
        names: Names of the parameters that are.
    """

    def known(pattern: str) -> bool:
        return bool(matching(pattern, names))

    return replace(
        setup,
        fixed=tuple(filter(known, setup.fixed)),
        bounds={key: value for key, value in setup.bounds.items() if known(key)},
        prior={key: value for key, value in setup.prior.items() if known(key)},
    )


def _require_payloads(data: Measurements, setup: Setup) -> None:
    """Refuse rows that carry something of which nothing is known.

    Raises:
        InputError: If there are such rows, and what they carry matters.
    """
    if not setup.payloads and "payloads" not in required_keys(setup.parameters):
        return
    known = ("", NOTHING, *setup.payloads)
    row = next((k for k, name in enumerate(data.payload) if name not in known), None)
    if row is not None:
        name = data.payload[row]
        raise data.error(
            row,
            f"there is no payload '{name}'{nearest(name, setup.payloads)}",
            column="payload",
            allowed=", ".join(known[1:]),
        )
    if len(setup.payloads) > 1 and "" in data.payload:
        raise data.error(
            data.payload.index(""),
            "there are several payloads, and the row names none",
            column="payload",
            allowed=", ".join(known[1:]),
        )


def geometric_setup(chain: Chain, measurements: Measurements, setup: Setup) -> Setup:
    """The setup of the geometry that a URDF can hold; without parameters for none.

    The geometry of a fit with gears and compliance is no use without them: a gear ratio
    and an offset may nearly cancel, say. It needs a fit of its own.

    Args:
        chain: The nominal chain.
        measurements: The measurements to fit.
        setup: Estimated and known quantities.
    """
    plain = replace(setup, learned=None)
    beyond = beyond_geometry()
    names = tuple(name for name in setup.parameters if name not in beyond)
    if names == setup.parameters:
        return plain
    return with_parameters(chain, measurements, plain, names)


def with_parameters(
    chain: Chain, measurements: Measurements, setup: Setup, parameters: tuple[str, ...]
) -> Setup:
    """The setup with other parameterizations, and without parameters they lack."""
    names = parameter_names(chain, measurements, setup, parameters)
    return restricted(replace(setup, parameters=parameters), names)


def parameter_names(
    chain: Chain, measurements: Measurements, setup: Setup, parameters: tuple[str, ...]
) -> tuple[str, ...]:
    """Names of the parameters of some parameterizations, frames and instrument."""
    plain = replace(setup, parameters=parameters, fixed=(), bounds={}, prior={})
    return make_problem(chain, measurements, plain).parameters.names
