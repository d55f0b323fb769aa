"""Robots of one type: the same joints in the same nominal places."""

from __future__ import annotations

from calib_pin.kinematics.chains import Chains
from calib_pin.setup.population import JointType, RobotType


def robot_type(chains: Chains) -> RobotType:
    """The type of a robot by the nominal geometry between its joints.

    Where base and tip are belongs to how it is mounted and measured, and a file may say
    more than geometry: neither counts.

    Examples:
        >>> import calib_pin
        >>> from calib_pin.kinematics.chains import Chains
        >>> [robot_type(Chains.of(calib_pin.load_chain(r))).name for r in ["space6"]]
        ['space6']
    """
    joints: dict[str, JointType] = {}
    for name in chains.names:
        chain = chains[name]
        # Up to the root, and down from there.
        top = int(chain.reversed.sum())
        for k, joint in enumerate(chain.joints):
            pose = chain.placements[k]
            if k == top and k > 0:
                pose = chain.placements[k - 1].inverse() * pose
            first = k == top - 1 or (k == top and k == 0)
            placement = () if first else tuple(pose.homogeneous[:3].ravel().tolist())
            axis = tuple(chain.axes[k].tolist())
            joints.setdefault(joint, JointType(joint, axis, placement))
    return RobotType(chains.robot.name, tuple(joints.values()))
