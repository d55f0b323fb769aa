"""URDFs by their joints, and a mesh."""

from __future__ import annotations

TETRAHEDRON = """v 0 0 0\nv 0.2 0 0\nv 0 0.2 0\nv 0 0 0.2
f 1 3 2\nf 1 2 4\nf 2 3 4\nf 1 4 3\n"""
"""An OBJ file: its edges are of 0.2 m, in the positive octant."""


def joint(
    name: str,
    ends: str,
    place: str = "0 0 0",
    axis: str = "0 0 1",
    kind: str = "revolute",
    limits: str = "-3 3",
    more: str = "",
    inside: str = "",
) -> str:
    """A joint, and before it the link that it carries.

    Args:
        name: Its name.
        ends: Names of parent and child.
        place: Its xyz, and behind a semicolon its rpy.
        axis: Its axis.
        kind: Its type.
        limits: Lower and upper.
        more: Further elements of the joint.
        inside: Elements of the link.
    """
    parent, child = ends.split()
    xyz, _, rpy = place.partition(";")
    lower, upper = limits.split()
    moves = f'<axis xyz="{axis}"/><limit lower="{lower}" upper="{upper}" '
    moves += 'effort="1" velocity="1"/>'
    return f"""<link name="{child}">{inside}</link>
<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>
<origin xyz="{xyz}" rpy="{rpy or "0 0 0"}"/>{moves * (kind != "fixed")}{more}</joint>
"""


def robot(*joints: str, root: str = "base", name: str = "arm", inside: str = "") -> str:
    """A robot; `inside` its root link are some elements."""
    head = f'<robot name="{name}">\n<link name="{root}">{inside}</link>\n'
    return f"{head}{''.join(joints)}</robot>"
