"""Named points of the tool: their names in targets, and their places in the tip."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace

import numpy as np
import pinocchio as pin

from calib_pin.errors import OptionError
from calib_pin.kinematics.spatial import Floats
from calib_pin.measurement_models.references import Point
from calib_pin.measurement_models.registration import fit_pose
from calib_pin.observations import AT
from calib_pin.setup import PointSetup


def split_names(
    target: Sequence[str], sites: bool
) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """The point and the place that each row names.

    Args:
        target: Target of each row.
        sites: Whether there are places; else a name is that of a point.

    Examples:
        >>> split_names(["wall", "ball@wall"], True)
        (('', 'ball'), ('wall', 'wall'))
    """
    if not sites:
        return tuple(target), ("",) * len(target)
    halves = [name.rpartition(AT) for name in target]
    return tuple(h[0] for h in halves), tuple(h[2] for h in halves)


def named_points(
    setups: Mapping[str, PointSetup], names: Iterable[str], kind: str
) -> tuple[Point, ...]:
    """The points that a setup states, or else those that rows name.

    Args:
        setups: Points of the setup by name.
        names: Names that rows give, empty ones among them.
        kind: Kind of the points.

    Raises:
        OptionError: If a point is known and not given.
    """
    points = setups or dict.fromkeys(filter(None, names), PointSetup())
    for name, point in points.items():
        if point.estimate is False and point.xyz is None:
            raise OptionError(
                f"'{name}' is known, and its place is not given", allowed="xyz"
            )
    return tuple(
        Point(
            name,
            kind,
            xyz_or_none(point.xyz),
            point.estimate is not False,
        )
        for name, point in points.items()
    )


def tip_points(points: Sequence[Point], tool: pin.SE3 | None) -> Floats:
    """Points of the tool and, last, its origin in the tip frame, shape (J + 1, 3) [m].

    NaN for what is unknown: the origin of a tool that is, and points of it.

    Args:
        points: The J points.
        tool: The tool frame in the tip where it is known.
    """
    result = np.full((len(points) + 1, 3), np.nan)
    if tool is not None:
        result[-1] = tool.translation
        for k, point in enumerate(points):
            if point.xyz is not None:
                result[k] = tool.act(point.xyz)
    return result


def located_tool(
    in_tip: Floats, points: Sequence[Point], tool: pin.SE3 | None
) -> tuple[tuple[Point, ...], pin.SE3]:
    """The tool frame and its points from what the tip carries.

    Args:
        in_tip: Points in the tip frame, that of the tool's origin last, shape (J + 1,
            3) [m]; NaN where no row tells.
        points: The J points.
        tool: The tool frame in the tip where it is known.

    Returns:
        The points, all of them placed, and the tool frame.
    """
    seen = ~np.isnan(in_tip[:, 0])
    if tool is None:
        xyz = [*(point.xyz for point in points), np.zeros(3)]
        known = [k for k, site in enumerate(xyz) if site is not None and seen[k]]
        tool = pin.SE3.Identity()
        if known:
            tool = fit_pose(np.array([xyz[k] for k in known]), in_tip[known])
    in_tool = (in_tip - tool.translation) @ tool.rotation
    return tuple(
        point
        if point.located
        else replace(point, xyz=in_tool[k] if seen[k] else np.zeros(3))
        for k, point in enumerate(points)
    ), tool


def given_names(names: Iterable[str], default: str) -> tuple[str, ...]:
    """Names that measurements give, each once; one of its kind where they give none."""
    return tuple(dict.fromkeys(name or default for name in names)) or (default,)


def xyz_or_none(xyz: Sequence[float] | None) -> Floats | None:
    """The coordinates that a setup states, shape (3,) [m]; None where it has none."""
    return None if xyz is None else np.array(xyz, float)
