"""Parts of a setup that are left to the conditions of the measurements."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from calib_pin.estimation.terms import frames_of_blocks
from calib_pin.kinematics.chains import Chains
from calib_pin.kinematics.spatial import Floats
from calib_pin.measurement_models import declared
from calib_pin.observations import Observations
from calib_pin.parameterizations import needed_conditions, outside_urdf
from calib_pin.parameterizations.drift import InstrumentDrift
from calib_pin.parameterizations.thermal import ThermalGrowth, WarmUp
from calib_pin.setup import Setup


def require_conditions(
    data: Observations, setup: Setup, *, of_robot: bool = False
) -> None:
    """Refuse measurements that do not state what their parameters depend on.

    Args:
        data: The measurements.
        setup: The setup.
        of_robot: Whether only errors of the robot count. Without a time an instrument
            stands where it was when its drift began.

    Raises:
        InputError: If there are such.
    """
    names = setup.parameters
    if of_robot:
        names = tuple(name for name in names if name in outside_urdf())
    for condition, name in needed_conditions(names).items():
        if condition == "direction":
            continue  # Where it is not known a joint stands in the middle.
        reason = f"the parameters '{name}' need the {condition} of every measurement"
        reason += ", and here it is not stated"
        other = f"a column '{condition}', or parameters without '{name}'"
        for block in data.blocks:
            if len(block) and not len(getattr(block.conditions, condition)):
                raise block.error(0, reason, column=condition, allowed=other)


def at_conditions(chains: Chains, data: Observations, setup: Setup) -> Setup:
    """The setup with what it leaves to the measurements: their temperature and times.

    Args:
        chains: The chains.
        data: The measurements, which state what is needed.
        setup: The setup.
    """
    held = data.conditions
    if ThermalGrowth.name in setup.parameters and setup.thermal.reference is None:
        # A tenth of a degree is as good, and looks like a temperature.
        mean = round(float(np.mean(held.temperature)), 1)
        setup = replace(setup, thermal=replace(setup.thermal, reference=mean))
    if WarmUp.name in setup.parameters and len(held.time):
        thermal, span = setup.thermal, float(np.ptp(held.time))
        if not thermal.switched_on:
            thermal = replace(thermal, switched_on=(float(held.time.min()),))
        if thermal.warm_up_time is None and span > 0.0:
            thermal = replace(thermal, warm_up_time=span / 3.0)
        setup = replace(setup, thermal=thermal)
    if InstrumentDrift.name not in setup.parameters:
        return setup
    spans = dict(setup.drift.spans)
    named = frames_of_blocks(chains, data.keys, setup)
    times: dict[str, list[Floats]] = {}
    for block in data.blocks:
        if declared(block.model).external and len(block):
            station = named[block.key].station.rpartition(".")[0]
            times.setdefault(station, []).append(block.conditions.time)
    for station, parts in times.items():
        first, last = (float(end(np.concatenate(parts))) for end in (np.min, np.max))
        if station not in spans and last > first:
            spans[station] = first, last
    return replace(setup, drift=replace(setup.drift, spans=spans))
