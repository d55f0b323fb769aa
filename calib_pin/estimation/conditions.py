"""Parts of a setup that are left to the conditions of the measurements."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from calib_pin.estimation.terms import frames_of_blocks
from calib_pin.kinematics.chains import Chains
from calib_pin.measurement_models import declared
from calib_pin.observations import Conditions, Observations
from calib_pin.parameterizations import needed_conditions, outside_urdf
from calib_pin.parameterizations.drift import InstrumentDrift
from calib_pin.parameterizations.thermal import REFERENCE, ThermalGrowth, WarmUp
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
        for block in data.blocks:
            if len(block) and not len(getattr(block.conditions, condition)):
                raise block.error(
                    0,
                    f"the parameters '{name}' need the {condition} of every "
                    "measurement, and here it is not stated",
                    column=condition,
                    allowed=f"a column '{condition}', or parameters without '{name}'",
                )


def usual_conditions(setup: Setup, count: int) -> Conditions:
    """Conditions of so many rows that no one has measured: those of the reference."""
    stated, needed = setup.thermal.reference, needed_conditions(setup.parameters)
    reference, none = REFERENCE if stated is None else stated, np.zeros(0)
    return Conditions(
        temperature=np.full(count, reference) if "temperature" in needed else none,
        time=np.zeros(count) if "time" in needed else none,
    )


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
    found: dict[str, list[float]] = {}
    for block in data.blocks:
        if declared(block.model).external and len(block):
            time, station = block.conditions.time, station_of(named[block.key].station)
            found.setdefault(station, []).extend((time.min(), time.max()))
    for station, times in found.items():
        first, last = float(min(times)), float(max(times))
        if station not in spans and last > first:
            spans[station] = first, last
    return replace(setup, drift=replace(setup.drift, spans=spans))


def station_of(frame: str) -> str:
    """Name of a station by its frame, such as `day1.station`.

    Examples:
        >>> station_of("day1.station"), station_of("base.frame")
        ('day1', 'base')
    """
    return frame.rpartition(".")[0]
