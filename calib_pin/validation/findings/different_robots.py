"""Two calibrations that are hardly of one robot."""

from __future__ import annotations

from calib_pin.errors import enumerated
from calib_pin.estimation.evidence import Finding, Severity
from calib_pin.parameterizations.base import LENGTH_SCALE
from calib_pin.setup import JointMap
from calib_pin.validation.calibrated_model import CalibratedModel
from calib_pin.validation.findings.case import FOREIGN


def different_robots(
    first: CalibratedModel, second: CalibratedModel, same_nominal: bool, apart: float
) -> tuple[Finding, ...]:
    """Why the tool points of two calibrations are so far apart.

    None where they are not.

    Args:
        first: One robot.
        second: The other.
        same_nominal: Whether both have corrected the same robot.
        apart: How far their tool points are apart, rms over the workspace [m].
    """
    if apart <= FOREIGN * LENGTH_SCALE:
        return ()
    severity: Severity = "error"
    maps = _joint_maps(first), _joint_maps(second)
    joints = dict.fromkeys((*maps[0], *maps[1]))
    differ = [joint for joint in joints if maps[0].get(joint) != maps[1].get(joint)]
    if not same_nominal:
        why, remedy = "their nominal robots differ", "compare those of one robot"
    elif differ:
        why = f"they read the column of {enumerated(differ)} differently"
        remedy = "state the same 'joints' in the setup of both"
    else:
        severity, why = "warning", "no robot changes so much on its own"
        remedy = "check its mastering, and how the measurements of both are read"
    said = f"the tool points are {1e3 * apart:.0f} mm rms apart: {why}"
    return (Finding("different-robots", severity, said, {"rms": apart}, remedy),)


def _joint_maps(model: CalibratedModel) -> dict[str, JointMap]:
    """Maps of the joints whose column is not their position."""
    maps = model.setup.joints.values()
    return {given.joint: given for given in maps if given != JointMap(given.joint)}
