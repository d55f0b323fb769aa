"""Joint limits as words of the command line."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from calib_pin.kinematics.chain import Chain


def parse_limits(words: Sequence[str], chain: Chain) -> dict[str, tuple[float, float]]:
    """Limits by joint name or glob [rad, m].

    Args:
        words: `JOINT=LOWER:UPPER`, with a unit in brackets if it is not rad or m.
        chain: The chain; whether a name is one of its joints is checked later.

    Raises:
        OptionError: If a word is not of this form, the limits cross, or the unit is
            none of a joint that is meant.

    Example:
        >>> import calib_pin
        >>> chain = calib_pin.load_chain("space6")
        >>> parse_limits(["joint_1=-90:90 [deg]", "joint_2=0:0.35"], chain)["joint_2"]
        (0.0, 0.35)
    """
    from calib_pin.errors import OptionError
    from calib_pin.io.columns import ANGLE, LENGTH, split_header
    from calib_pin.parameters import matching

    units = {**ANGLE.units, **LENGTH.units}
    limits = {}
    for word in words:
        # The name of a joint may hold a sign of equality, an interval cannot.
        joint, _, rest = word.rpartition("=")
        joint = joint.strip()
        interval, unit = split_header(rest)
        low, _, high = interval.partition(":")
        try:
            factor = 1.0 if unit is None else units[unit]
            lower, upper = factor * float(low), factor * float(high)
        except (KeyError, ValueError):
            joint = ""
        if not joint:
            raise OptionError(
                f"--limits cannot be {word!r}",
                allowed="JOINT=LOWER:UPPER, such as 'elbow=-90:90 [deg]'; units "
                + ", ".join(units),
            )
        # Degrees would leave a joint as free as it was, without a word.
        if not -ANGLE.largest <= lower <= upper <= ANGLE.largest:
            raise OptionError(
                f"--limits cannot be {word!r}",
                allowed=f"LOWER up to UPPER, at most {ANGLE.largest:.4g} rad or m; "
                "other units in brackets: [deg]",
            )
        for k in matching(joint, chain.joints):
            kind = ANGLE if chain.revolute[k] else LENGTH
            if unit is not None and unit not in kind.units:
                raise OptionError(
                    f"--limits cannot be {word!r}: joint '{chain.joints[k]}' is "
                    f"{'revolute' if chain.revolute[k] else 'prismatic'}",
                    allowed=", ".join(kind.units),
                )
        limits[joint] = (lower, upper)
    return limits
