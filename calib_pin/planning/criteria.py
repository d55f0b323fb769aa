"""Criteria for a set of configurations, as costs of its information matrix.

Every cost is the logarithm of what is to be small, so that steps of a search compare.
With singular values s_1 >= ... >= s_m of the scaled identification matrix of the robot:

    condition, O2   log(s_1 / s_m)              Driels, Pathre
    O1              -log(s_1 ... s_m) / m       Borm, Menq; the D-criterion
    O3              -log(s_m)                   Nahvi et al.
    O4              -log(s_m^2 / s_1)           Nahvi, Hollerbach
    O5              log(1/s_1 + ... + 1/s_m)    Sun, Hollerbach
    prediction      log(trace(J_0 M^-1 J_0')) / 2   Wu, Klimchik et al.

Those of singular values are power means of the eigenvalues x = s^2,

    a log(mean_p(x)) - b log(mean_-p(x)),   mean_p(x) = (sum_i x_i^p)^(1/p),

of which the exponents infinity and zero give the extremes and the geometric mean.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calib_pin.estimation.identifiability import observability
from calib_pin.kinematics.spatial import Floats
from calib_pin.planning.information import Information

SHARPER = (4.0, 16.0, 64.0)
"""Exponents of power means in place of the largest and the smallest eigenvalue.

Where several eigenvalues are extreme the criterion itself has a corner, and a descent
along its gradient would stop there.
"""


@dataclass(frozen=True)
class Spectral:
    """A criterion of the singular values.

    Attributes:
        name: Name as users write it.
        largest: Weight a of the mean with the exponent.
        smallest: Weight b of the mean with its opposite.
        exponent: The exponent p.
    """

    name: str
    largest: float
    smallest: float
    exponent: float = np.inf

    @property
    def tried(self) -> int:
        """Trials whose costs are computed, the best ones to first order.

        With more, exchange ends no lower; corners need more than smooth costs.
        """
        return 12 if np.isinf(self.exponent) else 4

    @property
    def sharpnesses(self) -> tuple[float, ...]:
        """Exponents of successive descents; one where the cost is smooth."""
        return SHARPER if np.isinf(self.exponent) else (self.exponent,)

    def cost(self, found: Information) -> float:
        """The cost of the singular values."""
        return self._means(found.singular_values**2, self.exponent)[0]

    def value(self, found: Information, count: int) -> float:
        """The index, or the condition number, of a count of configurations."""
        s = found.singular_values
        if self.name == "condition":
            return float(s[0] / s[-1])
        return observability(s, count)[self.name]

    def slope(self, found: Information, sharpness: float) -> tuple[float, Floats]:
        """A smooth cost and its derivative by the information matrix, (m, m).

        By the chain rule through eigenvalues, S and M.
        """
        V, eigenvalues = found.right_vectors, found.singular_values**2
        cost, by_eigenvalue = self._means(eigenvalues, sharpness)
        return cost, found.pull((V * by_eigenvalue) @ V.T)

    def _means(self, x: Floats, exponent: float) -> tuple[float, Floats]:
        """The cost of eigenvalues, shape (r,), and its derivative by these."""
        high, by_high = _power_mean(x, exponent)
        low, by_low = _power_mean(x, -exponent)
        cost = self.largest * high - self.smallest * low
        return cost, self.largest * by_high - self.smallest * by_low


@dataclass(frozen=True)
class Prediction:
    """The root-mean-square error of the tip that noise leaves, at given test poses.

    Attributes:
        tests: `J_0' J_0`, the mean over the test poses, in the columns of the
            information matrix, shape (m, m) [m^2].
        name: Name as users write it.
        tried: Trials whose costs are computed: first order has them in order.
    """

    tests: Floats
    name: str = "prediction"
    tried: int = 1
    sharpnesses: tuple[float, ...] = (np.inf,)

    def cost(self, found: Information) -> float:
        """Logarithm of the error."""
        return float(np.log(self.value(found, 0)))

    def value(self, found: Information, count: int) -> float:
        """The error [m]."""
        return float(np.sqrt(np.sum((self.tests @ found.inverse) * found.inverse)))

    def slope(self, found: Information, sharpness: float) -> tuple[float, Floats]:
        """`d trace(A M^-1) = -trace(M^-1 A M^-1 dM)`."""
        C = found.inverse @ found.inverse.T
        left = float(np.sum(self.tests * C))
        return 0.5 * float(np.log(left)), -0.5 / left * (C @ self.tests @ C)


def _power_mean(x: Floats, exponent: float) -> tuple[float, Floats]:
    """Logarithm of the mean of positive numbers, and its derivative by these."""
    logs = np.log(x)
    if exponent == 0.0:
        return float(logs.mean()), 1.0 / (x.size * x)
    signed = np.copysign(1.0, exponent) * logs
    if np.isinf(exponent):
        extreme = int(signed.argmax())
        return float(logs[extreme]), (np.arange(x.size) == extreme) / x
    size = abs(exponent)
    weights = np.exp(size * (signed - signed.max()))
    total = float(weights.sum())
    return (size * signed.max() + np.log(total)) / exponent, weights / total / x


Criterion = Spectral | Prediction
"""A cost of information matrices."""

CRITERIA: dict[str, Spectral] = {
    "condition": Spectral("condition", 0.5, 0.5),
    "O1": Spectral("O1", 0.0, 0.5, 0.0),
    "O2": Spectral("O2", 0.5, 0.5),
    "O3": Spectral("O3", 0.0, 0.5),
    "O4": Spectral("O4", 0.5, 1.0),
    "O5": Spectral("O5", 0.0, 0.5, 0.5),
}
"""The criteria of the singular values, by name."""
