"""The tool-point uncertainty that a fit predicts, as plain data."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from calib_pin.kinematics.spatial import Floats


class ByCount(Protocol):
    """The error of the tip by the number of measurements."""

    @property
    def curve(self) -> tuple[Floats, Floats]:
        """Numbers of measurements, ascending, and errors [m], both of shape (K,)."""
        ...


@dataclass(frozen=True)
class FoundCurve:
    """A curve that was found before, as a file has it."""

    curve: tuple[Floats, Floats]


@dataclass(frozen=True)
class TipAccuracy:
    """The error of the tip that the noise of the measurements leaves.

    It is the standard deviation of the tool in the measuring frame by the covariance
    of what was estimated; what stayed at nominal is not in it, nor what no parameter
    of the model describes.

    Attributes:
        q: Random configurations within the joint limits, shape (N, n) [rad, m].
        points: Tool positions in the base link, shape (N, 3) [m].
        position: Standard deviation of these, the root of the sum over the axes,
            shape (N,) [m].
        orientation: That of the rotation vectors, shape (N,) [rad].
        of_robot: Root-mean-square of both with what a displacement of base and tool
            can absorb taken away [m] and [rad].
        by_count: Root-mean-square of `position` with fewer measurements.
    """

    q: Floats
    points: Floats
    position: Floats
    orientation: Floats
    of_robot: tuple[float, float]
    by_count: ByCount

    @property
    def rms(self) -> tuple[float, float]:
        """Of position [m] and orientation [rad] over the workspace."""
        return rms(self.position), rms(self.orientation)


def rms(sizes: Floats) -> float:
    """The root-mean-square of sizes, shape (N,)."""
    return float(np.sqrt(np.mean(sizes**2)))
