"""Setups that differ from a given one in their parameterizations."""

from __future__ import annotations

from dataclasses import replace

from calib_pin.estimation.formulation import make_problem, restricted
from calib_pin.kinematics.chain import Chain
from calib_pin.observations import Measurements
from calib_pin.parameterizations import beyond_geometry
from calib_pin.setup import Setup


def geometric_setup(chain: Chain, measurements: Measurements, setup: Setup) -> Setup:
    """The setup of the geometry that a URDF can hold; without parameters for none.

    The geometry of a fit with gears and compliance is no use without them: a gear ratio
    and an offset may nearly cancel, say. It needs a fit of its own.

    Args:
        chain: The nominal chain.
        measurements: The measurements to fit.
        setup: What is estimated, what is known.
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
