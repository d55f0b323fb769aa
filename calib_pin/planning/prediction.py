"""What a set of configurations will tell, before it is measured."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calib_pin.estimation.directions import WEAK, Directions
from calib_pin.kinematics.spatial import Floats
from calib_pin.parameters import ParameterSet
from calib_pin.planning.information import Information
from calib_pin.planning.rows import IdentificationRows


@dataclass(frozen=True)
class TipTests:
    """The error of the tip at test poses, in the columns of an information matrix.

    Attributes:
        position: `J_0' J_0` of its position, mean of the test poses, (m, m) [m^2].
        orientation: The same of its rotation vector, shape (m, m) [rad^2].
    """

    position: Floats
    orientation: Floats

    @staticmethod
    def at(rows: IdentificationRows, q: Floats) -> TipTests:
        """Tests at configurations.

        Args:
            rows: Rows that tell the pose of the tool, with unit sigma.
            q: Test configurations, shape (N, n) [rad, m].
        """
        J = rows.rows(q, ("",) * len(q))
        position, orientation = (
            np.einsum("ndi,ndj->ij", part, part, optimize=True) / len(q)
            for part in (J[:, :3], J[:, 3:])
        )
        return TipTests(position, orientation)


@dataclass(frozen=True)
class Predicted:
    """What a fit of planned measurements is going to know; satisfies `Estimated`.

    Attributes:
        theta: Parameter values, all zero, shape (P,).
        covariance: Of the parameters, shape (P, P).
        directions: The directions that will be estimated, and those too weak for it.
        position: Root-mean-square error of the tip over the test poses that noise
            leaves [m].
        orientation: The same of its orientation [rad].
    """

    theta: Floats
    covariance: Floats
    directions: Directions
    position: float
    orientation: float


def predict(
    found: Information, basis: Floats, tests: TipTests, of: ParameterSet
) -> Predicted:
    """Covariance of a fit; what it will not be able to tell stays at nominal there.

    A fit also holds all errors by the size that its measurements show (`shrinkage`),
    which nobody knows before: of a variance v it leaves `v / (1 + v / size^2)`.

    Args:
        found: The information.
        basis: Its columns in parameters, shape (P, m).
        tests: Where the tip's error is predicted.
        of: The parameters.
    """
    f = found.nuisances
    _, s, right = found.svd
    strong = s * WEAK > 1.0
    kept = np.eye(len(found.factor))[:, : f + int(strong.sum())]
    kept[f:, f:] = right[:, strong]
    R = found.factor @ kept
    covariance = kept @ np.linalg.inv(R.T @ R) @ kept.T
    scaled = basis / of.scales[:, None]
    robot = scaled[:, f:] @ right
    return Predicted(
        theta=np.zeros(len(of)),
        covariance=basis @ covariance @ basis.T,
        directions=Directions(scaled[:, :f], robot[:, strong], robot[:, ~strong]),
        position=float(np.sqrt(np.sum(tests.position * covariance))),
        orientation=float(np.sqrt(np.sum(tests.orientation * covariance))),
    )
