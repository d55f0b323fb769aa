"""The problem that a setup and measurements amount to, and variants of the setup."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import replace
from functools import cache
from typing import TypeAlias

import numpy as np

from calib_pin.errors import OptionError, enumerated, in_file, nearest
from calib_pin.estimation.problem import Problem
from calib_pin.estimation.row_blocks import PLACES
from calib_pin.estimation.terms import (
    FRAME,
    Term,
    assembled,
    frames_of_blocks,
    prefixed,
)
from calib_pin.kinematics.chains import Chains, Robots
from calib_pin.kinematics.robot_types import robot_type
from calib_pin.kinematics.spatial import Floats
from calib_pin.measurement_models import as_declared, declared, measurement_model
from calib_pin.measurement_models.references import Plane, ReferenceObject
from calib_pin.observations import (
    UNSTATED,
    BlockKey,
    Labels,
    Measurements,
    Observations,
)
from calib_pin.observations.blocks import of_joints
from calib_pin.parameterizations import (
    NOTHING,
    frame_pose,
    needed_conditions,
    outside_urdf,
    parameterization,
    required_keys,
)
from calib_pin.parameterizations.drift import InstrumentDrift
from calib_pin.parameterizations.error_model import ErrorModel
from calib_pin.parameterizations.thermal import REFERENCE, ThermalGrowth, WarmUp
from calib_pin.parameters import ParameterSet, matching
from calib_pin.plugins import upper
from calib_pin.setup import WORLD, JointPrior, Setup


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
    names = [n for n in setup.parameters if not of_robot or n in outside_urdf()]
    for condition, name in needed_conditions(names).items():
        column = condition
        if condition == "direction":
            # Where it is known of none; else a joint may stand in the middle.
            column = f"{data.joints[0]}.direction"
            if of_robot or data.conditions.direction.size:
                continue
        reason = f"the parameters '{name}' need the {condition} of every measurement"
        other = f"a column '{column}', or parameters without '{name}'"
        for block in data.blocks:
            if len(block) and not len(getattr(block.conditions, condition)):
                raise block.error(0, reason, column=column, allowed=other)


def at_conditions(chains: Chains, data: Observations, setup: Setup) -> Setup:
    """The setup with what it leaves to the measurements: their temperature and times.

    Args:
        chains: The chains.
        data: The measurements.
        setup: The setup.

    Raises:
        InputError: If they do not state what is needed, see `require_conditions`.
    """
    require_conditions(data, setup)
    conditions = data.conditions
    if ThermalGrowth.name in setup.parameters and setup.thermal.reference is None:
        # A tenth of a degree is as good, and looks like a temperature.
        mean = round(float(np.mean(conditions.temperature)), 1)
        setup = replace(setup, thermal=replace(setup.thermal, reference=mean))
    if WarmUp.name in setup.parameters and len(conditions.time):
        thermal, span = setup.thermal, float(np.ptp(conditions.time))
        if not thermal.switched_on:
            thermal = replace(thermal, switched_on=(float(conditions.time.min()),))
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


Stated: TypeAlias = Setup | Mapping[str, object] | None
"""A setup, the keys of a setup file, or nothing."""


def make_problem(
    chains: Robots, data: Measurements | Observations, setup: Setup
) -> Problem:
    """Error models, measurement models and data of a setup put together.

    A measurement frame exists for positions and poses. A laser distance sensor measures
    against a plane given in the base, which is known unless the setup frees it.

    Raises:
        OptionError: If a name in the setup does not exist.
    """
    chains, (data,) = fitting(chains, setup, Observations.of(data))
    _require_payloads(data, setup)
    setup = at_conditions(chains, data, setup)
    targets = {block.key: block.target.distinct for block in data.blocks}
    terms, given = make_terms(chains, targets, setup)
    setup = _with_prior(chains, given, setup)
    return Problem(chains, terms, given, data, setup)


def setup_of(setup: Stated) -> Setup:
    """A setup; also by the keys of a file of one, and the defaults for None."""
    if isinstance(setup, Mapping):
        setup = upper("io.setup", "read_setup", setup)
    result = setup if isinstance(setup, Setup) else Setup()
    for name in result.parameters:
        parameterization(name, result)
    return result


def fitting(
    chains: Robots, setup: Setup, *measured: Observations
) -> tuple[Chains, Sequence[Observations]]:
    """The chains of measurements, and these with the joints in their order.

    Raises:
        InputError: If the measurements do not have the joints of their chains, or the
            columns of their models.
        RobotError: If there is no chain of a name.
    """
    chains = Chains.of(chains, setup)
    names = dict.fromkeys(key.chain for data in measured for key in data.keys)
    if not set(names) <= set(chains.names):
        chains = chains.named(tuple(names))
    for data in measured:
        if sorted(data.joints) != sorted(chains.joints):
            odd = sorted(set(data.joints) ^ set(chains.joints))
            reason = f"the joints are not those of the chains: {', '.join(odd)}"
            raise data.error(0, reason, allowed=", ".join(chains.joints))
        for block in data.blocks:
            as_declared(block)
    return chains, [of_joints(data, chains.joints) for data in measured]


def require_known(
    terms: Iterable[Term],
    setup: Setup,
    named: Collection[str] | None = None,
    elsewhere: Collection[str] = (),
) -> None:
    """Refuse known distances that nothing would use, or that mean nothing.

    Args:
        terms: The terms of a problem.
        setup: The setup, which states them.
        named: Names that measurements give; None for all.
        elsewhere: Names of places that are not there yet.

    Raises:
        OptionError: If there are such.
    """
    places: dict[str, tuple[ReferenceObject, str]] = {}
    for term in terms:
        for reference in term.measurement.references:
            name = term.frames.reference(reference)
            hidden = reference.section == "targets" and name in places
            measured = named is None or reference.name in named
            if measured and not hidden and isinstance(reference, (*PLACES, Plane)):
                frame = term.frames.station if reference.outer else term.frames.tool
                places[name] = reference, frame
    names = {*places, *elsewhere}
    for known in setup.distances:
        lost = [name for name in known.between if name not in names]
        ends = [places[name] for name in known.between if name in places]
        frames = sorted({frame for _, frame in ends})
        why = ""
        if any(isinstance(reference, Plane) for reference, _ in ends):
            why = "is about planes: state where they are in a frame of their own "
            why += "('estimate: false'), and let the base be estimated"
        if len(frames) > 1:
            why = f"is about two frames: {' and '.join(frames)}"
        if lost:
            hint = nearest(lost[0], names)
            why = f"names '{lost[0]}', which no measurement does{hint}"
        if why:
            reason, value = f"'distances' {why}", list(known.between)
            file, allowed = setup.file or None, ", ".join(sorted(filter(None, names)))
            raise OptionError(reason, file=file, value=value, allowed=allowed or None)


def make_terms(
    chains: Chains, targets: Mapping[BlockKey, Sequence[str]], setup: Setup
) -> tuple[dict[BlockKey, Term], ParameterSet]:
    """The terms of blocks of measurements, and all parameters.

    Args:
        chains: The chains that are measured.
        targets: By block what its measurements name, each name once.
        setup: Estimated and known quantities.

    Raises:
        OptionError: If a name in the setup does not exist.
    """
    _require_own_loads(chains, setup)
    named = frames_of_blocks(chains, tuple(targets), setup)
    models = {k: measurement_model(k.model, setup, n) for k, n in targets.items()}
    outside = {named[k].station for k, m in models.items() if m.declaration.external}
    seen = [k for k, m in models.items() if m.sees_tool and k.chain != WORLD]
    looked_at = {named[key].tool for key in seen}
    terms, drifts = [], InstrumentDrift.name

    @cache
    def created(chain: str, base: bool, tool: bool, drifting: str) -> ErrorModel:
        kinds = [k for k in setup.parameters if chain != WORLD or k == drifts]
        span = setup.drift.spans.get(drifting)
        drift = replace(setup.drift, spans={"base": span} if span else {})
        return ErrorModel.create(
            chains[chain],
            kinds,
            setup=replace(setup, drift=drift),
            estimate_base=base,
            estimate_tool=tool,
        )

    for key, frames in named.items():
        base, tool = frames.base.estimate, frames.end.estimate
        base = frames.station in outside if base is None else base
        tool = frames.tool in looked_at if tool is None else tool
        station = frames.station.rpartition(".")[0]
        drifting = station if frames.station in outside else ""
        with in_file(setup.file):
            error = created(key.chain, base, tool, drifting)
        # A tool that is known on another one shares its errors:
        # `X Exp(S_1 t_1) ... K = X K Exp(Ad S_1 t_1) ...` with the adjoint of K^-1.
        carried, inner = frames.offset.toActionMatrixInverse(), error.screws[:-FRAME]
        last = [replace(s, twist=carried @ s.twist) for s in error.screws[-FRAME:]]
        error = replace(error, screws=(*inner, *last))
        columns, index = chains.columns(key.chain), np.zeros(0, np.intp)
        terms.append(Term(error, models[key], key, frames, columns, index))
    return assembled(prefixed(terms))


def _require_own_loads(chains: Chains, setup: Setup) -> None:
    """Refuse compliance of joints that carry more than the chain that is measured.

    Raises:
        OptionError: If there is such.
    """
    counts = Counter(joint for name in chains.names for joint in chains[name].joints)
    shared = [joint for joint, count in counts.items() if count > 1]
    loaded = [n for n in setup.parameters if "payloads" in required_keys([n])]
    if shared and loaded:
        reason = f"joint '{shared[0]}' is part of several chains, and all load it"
        file, allowed = setup.file or None, "other parameters, or one chain"
        raise OptionError(reason, file=file, value=loaded[0], allowed=allowed)


def nominal_problem(
    chains: Robots,
    measured: str | Sequence[BlockKey] | Mapping[BlockKey, Sequence[str]],
    setup: Setup,
) -> Problem:
    """A problem without rows, about the frames and instruments that the setup gives.

    Args:
        chains: The chains.
        measured: Name of a measurement model, or the blocks that could be measured; of
            each the targets, where these are not all that its model can look at.
        setup: Estimated and known quantities.

    Raises:
        OptionError: If an instrument needs a reference that the setup lacks.
    """
    chains = Chains.of(chains, setup)
    keys = [BlockKey(measured)] if isinstance(measured, str) else measured
    named = keys if isinstance(keys, Mapping) else dict.fromkeys(keys, ())
    payloads = tuple(setup.payloads) or ("",)
    needed = needed_conditions(setup.parameters)
    # Rows that no one has measured have the conditions of the reference.
    given = setup.thermal.reference
    reference = REFERENCE if given is None else given
    blocks = []
    for key, names in named.items():
        model = measurement_model(key.model, setup, names)
        if model.missing:
            reason = f"a {key.model} study without measurements: {model.missing}"
            raise OptionError(reason)
        targets = tuple(names or model.targets) or ("",)
        count = len(targets) * len(payloads)
        zeros = np.zeros((count, len(chains.joints)))
        values = np.zeros((count, model.width))
        values[:, -1:] = model.declaration.oriented  # The quaternion of no rotation.
        conditions = replace(
            UNSTATED,
            temperature=np.full(count * ("temperature" in needed), reference),
            time=np.zeros(count * ("time" in needed)),
            payload=Labels.of([name for name in payloads for _ in targets]),
            direction=zeros.astype(np.int8),
        )
        block = Measurements(
            chains.joints,
            zeros,
            values=values,
            target=Labels.of(targets * len(payloads)),
            conditions=conditions,
            start=zeros if model.declaration.relative else np.zeros((0, 0)),
            **key._asdict(),
        )
        blocks.append(block)
    problem = make_problem(chains, Observations.of(*blocks), setup)
    placed = {}
    for key, term in problem.terms.items():
        frames = term.frames
        base, tool = frame_pose(frames.base), frame_pose(frames.end) * frames.offset
        placed[key] = replace(term, error=term.error.with_frames(base, tool))
    return replace(problem, terms=placed)


def restricted(setup: Setup, names: Sequence[str]) -> Setup:
    """The setup without what it says of parameters that are not there.

    Args:
        setup: The setup.
        names: Names of the parameters that are.
    """

    def known(pattern: str) -> bool:
        return bool(matching(pattern, names))

    fixed, prior = tuple(filter(known, setup.fixed)), setup.prior
    bounds = {key: value for key, value in setup.bounds.items() if known(key)}
    if not isinstance(prior, JointPrior):
        prior = {key: value for key, value in prior.items() if known(key)}
    return replace(setup, fixed=fixed, bounds=bounds, prior=prior)


def _with_prior(chains: Chains, given: ParameterSet, setup: Setup) -> Setup:
    """The setup with the noise that a joint prior states.

    Raises:
        OptionError: If it is the prior of another type, or of other parameters.
    """
    prior = setup.prior
    if not isinstance(prior, JointPrior):
        return setup
    difference = prior.robot.difference(robot_type(chains))
    if difference:
        reason = f"a prior of other robots, '{prior.robot.name}': {difference}"
        raise OptionError(reason, file=prior.file or None, value=chains.robot.name)
    known = set(prior.names)
    robot = given.with_fixed(setup.fixed)
    lacking = [p.name for p in robot if p.free and not p.nuisance | (p.name in known)]
    if lacking:
        reason = f"the prior does not have the parameters {enumerated(lacking)}"
        kinds, allowed = list(setup.parameters), "the parameters that it was made from"
        raise OptionError(reason, file=prior.file or None, value=kinds, allowed=allowed)
    return replace(setup, noise={**prior.noise, **setup.noise})


def _require_payloads(data: Observations, setup: Setup) -> None:
    """Refuse rows that carry something of which nothing is known.

    Raises:
        InputError: If there are such rows, and what they carry matters.
    """
    if not setup.payloads and "payloads" not in required_keys(setup.parameters):
        return
    known, several = (NOTHING, *setup.payloads), len(setup.payloads) > 1
    for name in data.payload.distinct:
        if name in known or not (name or several):
            continue
        reason = f"there is no payload '{name}'{nearest(name, setup.payloads)}"
        if not name:
            reason = "there are several payloads, and the row names none"
        row = int(np.argmax(data.payload.where(name)))
        raise data.error(row, reason, column="payload", allowed=", ".join(known))


def with_parameters(
    chains: Robots,
    measurements: Observations,
    setup: Setup,
    parameters: tuple[str, ...],
) -> Setup:
    """The setup with other parameterizations, and without parameters they lack."""
    setup = replace(setup, parameters=parameters)
    return restricted(setup, parameter_names(chains, measurements, setup))


def parameter_names(
    chains: Robots, measurements: Observations, setup: Setup
) -> tuple[str, ...]:
    """Names of the parameters of a robot, its frames and its instrument."""
    plain = replace(setup, fixed=(), bounds={}, prior={})
    return make_problem(chains, measurements, plain).parameters.names
