"""How far the tips of two calibrated chains are apart, over the workspace."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from calib_pin.compiled.threads import serial_blas
from calib_pin.estimation.tip_accuracy import LEVER
from calib_pin.kinematics.spatial import Floats, invert, se3_exp, skew, so3_log
from calib_pin.parameterizations import NOTHING
from calib_pin.validation.accuracy import Accuracy
from calib_pin.validation.calibrated_model import CalibratedChain

SAMPLES = 1000
"""Configurations of the workspace."""

STEPS = 50
"""Steps after which the fit of the frames ends at the latest; a few are enough."""


@dataclass(frozen=True)
class TipDrift:
    """Differences of the tool between two calibrated chains.

    Attributes:
        q: Random configurations within the joint limits, shape (N, n) [rad, m].
        points: Tool positions of the first robot in the base link, shape (N, 3) [m].
        drift: Distances of the second robot's from these, shape (N,) [m].
        turn: Angles between the orientations of both, shape (N,) [rad].
        absorbed: The frames that were fitted away, of `base` and `tool`.
        explained: What the noise of both explains, rms [m] and [rad]; None if unknown.
        oriented: Whether the measurements tell orientations.
    """

    q: Floats
    points: Floats
    drift: Floats
    turn: Floats
    absorbed: tuple[str, ...]
    explained: tuple[float, float] | None = None
    oriented: bool = True

    @property
    def sizes(self) -> tuple[float, float]:
        """Root mean squares [m] and, where it is known, [rad]."""
        return self.position.rms, self.oriented * self.orientation.rms

    @property
    def ratio(self) -> float:
        """Size by what noise explains; in meters if that is unknown."""
        noise = self.explained or (1.0, np.inf)
        # Exact measurements explain nothing.
        pairs = zip(self.sizes, noise, strict=True)
        return max(size / max(least, 1e-300) for size, least in pairs)

    @property
    def position(self) -> Accuracy:
        """Sizes over the workspace [m]."""
        return Accuracy.of(self.drift)

    @property
    def orientation(self) -> Accuracy:
        """Sizes over the workspace [rad]."""
        return Accuracy.of(self.turn)

    @property
    def farthest(self) -> int:
        """Position of the configuration with the largest drift."""
        return int(np.argmax(self.drift))


@serial_blas
def tip_drift(
    first: CalibratedChain,
    second: CalibratedChain,
    *,
    base: bool,
    tool: bool,
    seed: int = 0,
) -> TipDrift:
    """Compare the tool poses of two robots in their base link.

    Both carry the first robot's tool: another tool is no drift. So is what a frame can
    absorb that one of the calibrations did not know.

    Args:
        first: The first calibrated chain.
        second: The second, of the same joints.
        base: Whether a displacement of the base is fitted away.
        tool: Whether a displacement of the tool is fitted away.
        seed: Seed of the configurations.
    """
    q = first.chain.random_configurations(SAMPLES, np.random.default_rng(seed))
    same = first.setup.payloads == second.setup.payloads
    payload = next(iter(first.setup.payloads), "") if same else NOTHING
    carried = first.error.tool

    def tools(model: CalibratedChain) -> Floats:
        """Poses of the first robot's tool in the base link, shape (N, 4, 4)."""
        loaded = replace(model, error=model.error.carrying(payload))
        exchanged = (loaded.error.tool.inverse() * carried).homogeneous
        base = loaded.error.base.homogeneous
        return np.asarray(invert(base) @ loaded.poses(q) @ exchanged)

    A, B = tools(first), tools(second)
    B = absorbed(A, B, left=base, right=tool)
    ends = (("base", base), ("tool", tool))
    return TipDrift(
        q=q,
        points=A[:, :3, 3],
        drift=np.linalg.norm(B[:, :3, 3] - A[:, :3, 3], axis=1),
        turn=np.linalg.norm(turns(A, B), axis=1),
        absorbed=tuple(name for name, free in ends if free),
    )


def absorbed(A: Floats, B: Floats, *, left: bool, right: bool) -> Floats:
    """The moved poses of `absorbing`, shape (N, 4, 4)."""
    return absorbing(A, B, left=left, right=right)[0]


def absorbing(
    A: Floats, B: Floats, *, left: bool, right: bool
) -> tuple[Floats, Floats, Floats]:
    """Move poses onto others by one displacement on the left and one on the right.

    `L B R` is brought to `A` by least squares (Gauss-Newton). Orientations count as
    little as `LEVER` says.

    Args:
        A: The poses to meet, shape (N, 4, 4).
        B: Poses close to these, shape (N, 4, 4).
        left: Whether there is an L.
        right: Whether there is an R.

    Returns:
        The moved poses, shape (N, 4, 4), L and R, shape (4, 4).
    """
    L, R_ = np.eye(4), np.eye(4)
    free = np.repeat([left, right], 6)
    for _ in range(STEPS if free.any() else 0):
        R, p = B[:, :3, :3], B[:, :3, 3]
        J = np.zeros((len(B), 6, 12))
        J[:, :3, :3], J[:, :3, 3:6], J[:, :3, 6:9] = np.eye(3), -skew(p), R
        J[:, 3:, 3:6], J[:, 3:, 9:] = LEVER * R.transpose(0, 2, 1), LEVER * np.eye(3)
        missing = np.hstack([A[:, :3, 3] - p, LEVER * turns(B, A)])
        step = np.zeros(12)
        # Of what both can do alike, as with a single joint, each does a part.
        step[free] = np.linalg.lstsq(
            J.reshape(-1, 12)[:, free], missing.reshape(-1), rcond=1e-9
        )[0]
        by_left, by_right = se3_exp(step[:6]), se3_exp(step[6:])
        B, L, R_ = by_left @ B @ by_right, by_left @ L, R_ @ by_right
        if np.abs(step).max() < 1e-10:
            break
    return B, L, R_


def turns(A: Floats, B: Floats) -> Floats:
    """Rotation vectors from orientations to others, (N, 4, 4) -> (N, 3) [rad]."""
    return so3_log(A[:, :3, :3].transpose(0, 2, 1) @ B[:, :3, :3])
