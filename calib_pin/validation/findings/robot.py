"""Another robot, other links at the ends of its chain, or another tool."""

from __future__ import annotations

from collections.abc import Hashable, Iterator
from dataclasses import replace
from functools import partial
from typing import Literal

from calib_pin.errors import RobotError
from calib_pin.kinematics.chain import Chain
from calib_pin.kinematics.chains import Chains
from calib_pin.measurement_models import declared
from calib_pin.setup import FrameSetup
from calib_pin.validation.findings.case import LINKS, Case
from calib_pin.validation.findings.hypotheses import Hypothesis

OF = "the chain"
"""The subject of these explanations, of which only one can be true."""

MOUNTS: dict[Literal["hand", "world"], str] = {
    "hand": "moves with the tool",
    "world": "stands still",
}
"""Where a camera may be."""

ABSORBED = 4.0
"""Factor by which six numbers of a frame make errors of a robot smaller: they are half
as large on six joints, and less than a third on three."""


def robots(case: Case) -> Iterator[Hypothesis]:
    """Explanations by what was measured: the robot, its links, the tool."""
    yield from _frames(case)
    if (camera := case.setup.camera) is not None:
        (mount,) = MOUNTS.keys() - {camera.mount}
        yield Hypothesis(
            "camera-mount",
            f"the camera {MOUNTS[mount]}, and is not one that {MOUNTS[camera.mount]}",
            OF,
            setup={"camera": replace(camera, mount=mount)},
            stated={"camera": {"mount": mount}},
        )
    # A shorter chain touches one point the better the less it moves.
    touching = any(declared(model).contact for model in case.data.models)
    if case.chains.names == ("",) and not touching:
        yield from _ends(case.chains[""], case)
    for other in case.others():
        yield Hypothesis(
            "robot",
            f"the robot is '{other.robot.file}', not '{case.chains.robot.name}'",
            OF,
            chains=other,
            advice=f"use '{other.robot.file}' in place of '{case.chains.robot.file}'",
        )


def turned_by_base(case: Case) -> str:
    """The joint whose offset is a turn of a base that is known; empty for none."""
    chain = case.chains[case.chains.names[0]]
    known = case.setup.base_frame.estimate is False and len(case.chains.names) == 1
    return chain.joints[0] if known and chain.revolute[0] else ""


def _frames(case: Case) -> Iterator[Hypothesis]:
    """Frames that are stated, and that are others if they are estimated."""
    for code, end in (("tool-frame", "tool"), ("base-frame", "base")):
        frame = getattr(case.setup, f"{end}_frame")
        if frame.estimate is False:
            yield Hypothesis(
                code,
                f"the frame of the {end} is not the stated one",
                f"{end} frame",
                # Half a turn away the stated one is no start.
                setup={f"{end}_frame": FrameSetup(estimate=True)},
                stated={"frames": {end: {"estimate": True}}},
                absorbs=ABSORBED,
            )


def _ends(chain: Chain, case: Case) -> Iterator[Hypothesis]:
    """Other links of the chain as its tip or its base."""
    names = case.fit.problem.parameters.names
    links = {"base": chain.base, "tip": chain.tip}
    spare = {joint for joint, _ in case.data.conditions.spare}
    for k, (end, code) in enumerate(LINKS.items()):
        # A frame that is estimated absorbs where on its body a link is.
        frame = "base.frame.x" if end == "base" else "tool.frame.x"
        body = _joints if frame in names else partial(_placed, k)
        seen = [body(chain)]
        for link in chain.robot.links:
            try:
                other = Chain(chain.robot, **{**links, end: link})
            except RobotError:
                continue
            if not other.joints or body(other) in seen:
                continue
            if not {*other.joints} <= {*case.data.joints, *spare}:
                continue
            seen.append(body(other))
            yield Hypothesis(
                code,
                f"the {end} link is '{link}', not '{links[end]}'",
                OF,
                chains=Chains.of(other),
                stated={end: link},
            )


def _joints(chain: Chain) -> Hashable:
    """All that matters of a chain between frames that are estimated."""
    return chain.joints


def _placed(end: int, chain: Chain) -> Hashable:
    """The same where one end is known."""
    place = chain.ends[end].homogeneous.round(9) + 0.0
    return chain.joints, place.tobytes()
