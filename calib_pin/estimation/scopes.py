"""Which frames blocks of measurements share, and the names of their parameters.

A station is a place of an instrument before one base link, a tool is something mounted
on one tip. Where there is only one of them it has the base or the tool frame.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace

import pinocchio as pin

from calib_pin.estimation.system import Part, Scope
from calib_pin.kinematics.chains import Chains
from calib_pin.measurement_models import declared
from calib_pin.observations import BlockKey
from calib_pin.parameterizations import frame_pose
from calib_pin.setup import FrameSetup, Setup, ToolSetup

BASE, TOOL = "base.frame", "tool.frame"
"""Names of the frames without names."""

Place = tuple[str, str]
"""A station or a tool, and the link that it stands before or is mounted on."""


def scopes(
    chains: Chains, keys: Sequence[BlockKey], setup: Setup
) -> dict[BlockKey, Scope]:
    """The names of the frames of blocks of measurements, and what is stated of them.

    Args:
        chains: The chains that are measured.
        keys: The blocks.
        setup: The frames that the user states.
    """
    stations = {k: (own_name(k, keys, k.station), chains[k.chain].base) for k in keys}
    tools = {k: (own_name(k, keys, k.tool), chains[k.chain].tip) for k in keys}
    default = chains[""] if "" in chains.names else None
    base = default.base if default else stations[keys[0]][1]
    bases = _owners(set(stations.values()), base)
    ends = _owners(set(tools.values()), default.tip if default else "")
    result = {}
    for key in keys:
        station, tool = bases[stations[key]], ends[tools[key]]
        result[key] = _on_tool(
            Scope(
                station=f"{station}.station" if station else BASE,
                base=_stated(setup.stations, station, key.station, setup.base_frame),
            ),
            tool,
            _stated(setup.tools, tool, key.tool, setup.tool_frame),
            setup.tools,
        )
    return result


def prefixed(parts: Iterable[Part]) -> list[Part]:
    """Parts whose reference objects have names that differ between stations and tools.

    An object is another one at another station, or on another tool, whatever its name;
    then the station or the tool stands before that.
    """
    parts = list(parts)
    where: dict[tuple[str, str], set[str]] = {}
    for part in parts:
        for reference in part.measurement.references:
            place = part.scope.station if reference.outer else part.scope.tool
            where.setdefault((reference.section, reference.name), set()).add(place)
    ambiguous = {
        place for places in where.values() if len(places) > 1 for place in places
    }

    def prefix(place: str) -> str:
        named = place in ambiguous and place not in (BASE, TOOL)
        return f"{place.rpartition('.')[0]}/" if named else ""

    return [
        replace(
            part,
            scope=replace(
                part.scope,
                outer=prefix(part.scope.station),
                inner=prefix(part.scope.tool),
            ),
        )
        for part in parts
    ]


def own_name(key: BlockKey, keys: Sequence[BlockKey], stated: str) -> str:
    """Name of a station or a tool, that of the model where it follows nothing.

    A camera among others is at a place of its own and looks at something of its own.
    """
    alone = all(other.model == key.model for other in keys)
    follows = declared(key.model).tracks or not declared(key.model).external
    return stated or ("" if alone or follows else key.model)


def _owners(places: set[Place], default: str) -> dict[Place, str]:
    """The owner of each frame, empty for the one without a name.

    Args:
        places: The places.
        default: The link that need not be named.
    """
    if len(places) == 1:
        return dict.fromkeys(places, "")
    links: dict[str, set[str]] = {}
    for name, link in places:
        links.setdefault(name, set()).add(link)
    return {
        (name, link): "/".join(
            filter(
                None,
                (
                    name,
                    "" if link == default or (name and len(links[name]) == 1) else link,
                ),
            )
        )
        for name, link in places
    }


def _stated(
    frames: Mapping[str, FrameSetup], owner: str, name: str, default: FrameSetup
) -> FrameSetup:
    """Frame that a setup states, by its owner or by the name in measurements."""
    if owner in frames or name in frames:
        return frames[owner if owner in frames else name]
    return FrameSetup() if owner else default


def _on_tool(
    scope: Scope, owner: str, stated: FrameSetup, tools: Mapping[str, ToolSetup]
) -> Scope:
    """The scope with a tool, which may be known on another one."""
    offset = pin.SE3.Identity()
    for _ in tools:
        if not isinstance(stated, ToolSetup) or stated.on is None:
            break
        offset = frame_pose(stated) * offset
        owner, stated = stated.on, tools.get(stated.on, FrameSetup())
    name = f"{owner}.tool" if owner else TOOL
    return replace(scope, tool=name, end=stated, offset=offset)
