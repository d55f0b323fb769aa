"""Files of visits: what an acceptance test asks for, to be filled in."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from calib_pin.control.acceptance_poses import AcceptancePoses
from calib_pin.io.joint_columns import column_values, joint_sources, shown_columns
from calib_pin.io.measurements import encode_table
from calib_pin.kinematics.chain import Chain
from calib_pin.setup import JointMap


def encode_visits(
    chain: Chain,
    found: AcceptancePoses,
    cycles: int,
    *,
    joints: Mapping[str, JointMap] = {},
    degrees: bool = False,
    comments: Sequence[str] = (),
) -> bytes:
    r"""All visits of an acceptance test as a CSV file, `x`, `y`, `z` blank.

    Args:
        chain: The chain.
        found: The poses.
        cycles: Number of cycles.
        joints: How file columns become joints; the file holds what a controller
            needs.
        degrees: Whether angles are in degrees.
        comments: Lines for the head of the file.

    Raises:
        InputError: If the joint map cannot be undone.
        OutputError: If a name would not read back.

    Examples:
        >>> import calib_pin, numpy as np
        >>> from calib_pin.control.acceptance_poses import acceptance_poses
        >>> chain = calib_pin.load_chain("space6")
        >>> found = acceptance_poses(chain, np.eye(4))
        >>> encode_visits(chain, found, 30).count(b"\n")
        151
    """
    q, poses, each = found.cycles(cycles)
    sources = joint_sources(chain, joints)
    columns: dict[str, Sequence[object]] = {
        name: column.tolist()
        for name, column in shown_columns(
            column_values(q, sources), sources, degrees
        ).items()
    }
    columns |= {"cycle": each, "pose": [f"P{pose}" for pose in poses]}
    columns |= {f"{axis} [mm]": [""] * len(q) for axis in "xyz"}
    return encode_table(columns, comments)
