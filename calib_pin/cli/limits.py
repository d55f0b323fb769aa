"""Joint limits as words of the command line."""

from __future__ import annotations

from collections.abc import Sequence

__all__ = ["parse_limits"]


def parse_limits(words: Sequence[str]) -> dict[str, tuple[float, float]]:
    """Limits by joint name or glob [rad, m].

    Args:
        words: `JOINT=LOWER:UPPER`, with a unit in brackets if it is not rad or m.

    Raises:
        OptionError: If a word is not of this form, or the limits cross.

    Example:
        >>> parse_limits(["elbow=-90:90 [deg]", "lift=0:0.35"])["lift"]
        (0.0, 0.35)
    """
    from calib_pin.errors import OptionError
    from calib_pin.io.columns import ANGLE, LENGTH, split_header

    units = {**ANGLE.units, **LENGTH.units}
    limits = {}
    for word in words:
        # The name of a joint may hold a sign of equality, an interval cannot.
        joint, _, rest = word.rpartition("=")
        interval, unit = split_header(rest)
        low, _, high = interval.partition(":")
        try:
            factor = 1.0 if unit is None else units[unit]
            lower, upper = factor * float(low), factor * float(high)
        except (KeyError, ValueError):
            joint = ""
        if not joint.strip():
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
        limits[joint.strip()] = (lower, upper)
    return limits
