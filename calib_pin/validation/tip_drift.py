"""How far the tips of two calibrated chains are apart, over the workspace."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from calib_pin.compiled.threads import serial_blas
from calib_pin.kinematics.spatial import Floats, adjoint, invert, se3_exp, so3_log
from calib_pin.parameterizations import NOTHING
from calib_pin.validation.calibrated_model import CalibratedChain
from calib_pin.validation.result import Accuracy
from calib_pin.validation.tool_accuracy import frame_motions

SAMPLES = 1000
"""Configurations of the workspace."""

NEGLIGIBLE = 1e-6
"""Drift that is none, whatever explains it [m, rad]: of joints that only slide, all of
an orientation is rounding."""


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
        """Size by what noise explains; in meters if that is unknown.

        Zero where nothing has drifted.
        """
        noise = self.explained or (1.0, np.inf)
        # Exact measurements explain nothing.
        pairs = zip(self.sizes, noise, strict=True)
        beyond = ((size, least) for size, least in pairs if size > NEGLIGIBLE)
        return max((size / max(least, 1e-300) for size, least in beyond), default=0.0)

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
    payload = first.setup.heaviest if same else NOTHING
    carried = first.error.tool

    def tools(model: CalibratedChain) -> Floats:
        """Poses of the first robot's tool in the base link, shape (N, 4, 4)."""
        loaded = replace(model, error=model.error.carrying(payload))
        exchanged = (loaded.error.tool.inverse() * carried).homogeneous
        base = loaded.error.base.homogeneous
        return np.asarray(invert(base) @ loaded.poses(q) @ exchanged)

    A, B = tools(first), tools(second)
    distances, turns = apart(A, absorbed(A, B, left=base, right=tool))
    ends = (("base", base), ("tool", tool))
    frames = tuple(name for name, free in ends if free)
    return TipDrift(q, A[:, :3, 3], distances, turns, frames)


def absorbed(A: Floats, B: Floats, *, left: bool = True, right: bool = True) -> Floats:
    """Move poses onto others by one displacement on the left and one on the right.

    `L B R` is brought to `A` by least squares (Gauss-Newton), see `frame_motions`. Of
    what both can do alike, as with a single joint, each does a part.

    Args:
        A: The poses to meet, shape (N, 4, 4).
        B: Poses close to these, shape (N, 4, 4).
        left: Whether there is an L.
        right: Whether there is an R.

    Returns:
        The moved poses, shape (N, 4, 4).
    """
    J = np.zeros((len(B), 6, 12))
    for _ in range(50 if left or right else 0):  # A few are enough.
        J[:, :, :6], J[:, :, 6:] = left * adjoint(invert(B)), right * np.eye(6)
        M = invert(B) @ A
        missing = np.hstack([M[:, :3, 3], so3_log(M[:, :3, :3])])
        step = frame_motions(missing[:, :, None], J)[:, 0]
        B = se3_exp(step[:6]) @ B @ se3_exp(step[6:])
        if np.abs(step).max() < 1e-10:
            break
    return B


def apart(A: Floats, B: Floats) -> tuple[Floats, Floats]:
    """Distances [m] and angles [rad] between poses, (N, 4, 4) -> (N,) each."""
    M = invert(A) @ B
    turns = so3_log(M[:, :3, :3])
    return np.linalg.norm(M[:, :3, 3], axis=1), np.linalg.norm(turns, axis=1)
