"""Errors of the tool frame along a motion."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calib_pin.errors import OptionError
from calib_pin.kinematics.spatial import Floats, so3_log


@dataclass(frozen=True)
class TipErrors:
    """Predicted minus true tip poses, in the base frame.

    Attributes:
        position: Differences of the positions, shape (N, 3) [m].
        orientation: Rotation vectors from true to predicted, shape (N, 3) [rad].
    """

    position: Floats
    orientation: Floats

    @property
    def distances(self) -> Floats:
        """Norms of the position errors, shape (N,) [m]."""
        return np.asarray(np.linalg.norm(self.position, axis=1))

    @property
    def angles(self) -> Floats:
        """Norms of the orientation errors, shape (N,) [rad]."""
        return np.asarray(np.linalg.norm(self.orientation, axis=1))

    @property
    def largest(self) -> tuple[float, float]:
        """Largest component of position [m] and orientation [rad], unsigned."""
        return (
            float(np.abs(self.position).max(initial=0.0)),
            float(np.abs(self.orientation).max(initial=0.0)),
        )


def tip_errors(true_poses: Floats, predicted_poses: Floats) -> TipErrors:
    """Errors of predicted tip poses, in the base frame.

    Args:
        true_poses: Tip poses of the true robot in the base, shape (N, 4, 4).
        predicted_poses: Those of a model of it, shape (N, 4, 4).

    Raises:
        OptionError: If the shapes disagree.

    Example:
        >>> true = np.eye(4)[None]
        >>> predicted = true + [[[0, 0, 0, 0.5], [0] * 4, [0] * 4, [0] * 4]]
        >>> tip_errors(true, predicted).largest
        (0.5, 0.0)
    """
    true, predicted = np.asarray(true_poses), np.asarray(predicted_poses)
    if true.shape != predicted.shape or true.shape[1:] != (4, 4):
        raise OptionError(
            f"true poses have shape {true.shape}, predicted ones {predicted.shape}",
            allowed="(N, 4, 4) for both",
        )
    turned = predicted[:, :3, :3] @ np.swapaxes(true[:, :3, :3], 1, 2)
    return TipErrors((predicted - true)[:, :3, 3], so3_log(turned))
