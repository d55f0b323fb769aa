"""Columns in which a controller shows its joints: one for each drive.

All joints of a chain follow from these columns by one linear map, `q = A c + b`: with
the signs, gears and couplings that the setup states, and with mimic joints where their
leaders put them, be these in the chain or not. A mimic joint has no drive, and needs no
column.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from calib_pin.errors import InputError, nearest
from calib_pin.kinematics.chain import Chain
from calib_pin.kinematics.chains import Chains
from calib_pin.kinematics.spatial import Floats
from calib_pin.setup import JointMap


@dataclass(frozen=True)
class JointColumns:
    """The K columns of the drives that move the n joints of a chain, or of several.

    Attributes:
        maps: Column and map of each joint, of leaders outside the chain and of mimic
            joints, too: a file may hold these as well.
        names: Names of the columns: those of the drives in the order of the chain, then
            those that are only coupled to others, such as that of an external axis.
        joints: The drive that each column belongs to, empty for the others.
        angular: Whether a column counts angles, of mimic joints' own ones as well.
        factors: Derivative A of the joints by the columns, shape (n, K).
        offsets: Positions b of the joints where all columns are zero, shape (n,) [rad,
            m].
        tells: The joint that tells the value of each drive's column, shape (D,).
    """

    maps: Mapping[str, tuple[str, JointMap]]
    names: tuple[str, ...]
    joints: tuple[str, ...]
    angular: Mapping[str, bool]
    factors: Floats
    offsets: Floats
    tells: NDArray[np.intp]

    @staticmethod
    def of(
        chain: Chain | Chains, joints: Mapping[str, JointMap] = MappingProxyType({})
    ) -> JointColumns:
        """The columns of a chain.

        Args:
            chain: The chain, or all chains that are measured.
            joints: How columns become joints; others have the name of their joint.
                Maps of joints outside the chain are idle.

        Raises:
            InputError: If the map names a joint that the robot does not have, or leaves
                a joint with two columns or none.

        Examples:
            >>> import calib_pin
            >>> chain = calib_pin.load_chain("space6")
            >>> geared = {"J1": JointMap("joint_1", gear=2.0, offset=0.5)}
            >>> columns = JointColumns.of(chain, geared)
            >>> columns.names[0], columns.positions(np.ones((1, 6)))[0, :2].tolist()
            ('J1', [2.5, 1.0])
        """
        chains = Chains.of(chain)
        maps = _maps(chains, joints)
        turning = dict(zip(chains.joints, chains.revolute.tolist(), strict=True))
        drives = drives_of(chain)
        angular = {column: turning[joint] for joint, (column, _) in maps.items()}
        names = [maps[joint][0] for joint in drives]
        for joint, (_, given) in maps.items():
            for name in given.coupled:
                # Its own joint's unit, or that of the joint it is coupled to.
                angular.setdefault(name, turning[joint])
                if joint in drives and name not in names:
                    names.append(name)
        A, b = np.zeros((len(chains.joints), len(names))), np.zeros(len(chains.joints))
        place, row = {name: k for k, name in enumerate(names)}, chains.joints.index
        for joint in drives:
            column, given = maps[joint]
            for name, factor in {**given.coupled, column: 1.0}.items():
                A[row(joint), place[name]] = given.sign * given.gear * factor
            b[row(joint)] = given.offset
        for joint, mimic in chains.mimics.items():
            leader = row(mimic.leader)
            A[row(joint)] = mimic.factor * A[leader]
            b[row(joint)] = mimic.factor * b[leader] + mimic.offset
        rows = [row(joint) for joint in chain.joints]
        A, b = A[rows], b[rows]
        tells = [_teller(chain, joint, A[:, k]) for k, joint in enumerate(drives)]
        owners = *drives, *[""] * (len(names) - len(drives))
        return JointColumns(
            maps, (*names,), owners, angular, A, b, np.array(tells, int)
        )

    @property
    def revolute(self) -> NDArray[np.bool_]:
        """Whether the columns count angles, shape (K,)."""
        return np.array([self.angular[name] for name in self.names], bool)

    def positions(self, values: Floats) -> Floats:
        """Joint positions at the values of the columns, (N, K) -> (N, n) [rad, m]."""
        return np.asarray(values @ self.factors.T + self.offsets)

    def values(self, q: Floats) -> Floats:
        """Values of the columns at joint positions, (N, n) -> (N, K) [rad, m].

        Columns that are only coupled to others are zero.

        Raises:
            InputError: If the couplings cannot be undone.
        """
        result, n = np.zeros((len(q), len(self.names))), len(self.tells)
        square, right = self.factors[self.tells, :n], (q - self.offsets)[:, self.tells]
        if np.linalg.matrix_rank(square) < n:
            raise InputError("the couplings in 'joints' cannot be undone")
        diag = np.diag(square)
        # Without couplings nothing is solved, so that no digit changes.
        alone = (np.diag(diag) == square).all()
        result[:, :n] = right / diag if alone else np.linalg.solve(square, right.T).T
        return result


def drives_of(chain: Chain | Chains) -> list[str]:
    """The joints whose drives move a chain: those that mimic none, and leaders."""
    mimics = chain.mimics
    # With a factor of zero a mimic joint stands still, whatever its leader does.
    joints = [j for j in chain.joints if j not in mimics or mimics[j].factor]
    return [*dict.fromkeys(mimics[j].leader if j in mimics else j for j in joints)]


def advice(chain: Chain, missing: Sequence[str]) -> str:
    """A hint about drives of a chain for which there are no columns."""
    drives = drives_of(chain)
    if [*missing] == drives[: len(missing)] != drives and not chain.reversed.any():
        return f"; start behind them with --base {chain.robot.carried(missing[-1])}"
    return ""


def _teller(chain: Chain | Chains, drive: str, factors: Floats) -> int:
    """Row of the joint that tells where a drive is: its own, or one that follows it."""
    if drive in chain.joints:
        return chain.joints.index(drive)
    followers = [j for j, mimic in chain.mimics.items() if mimic.leader == drive]
    return int(np.argmax(np.abs(factors) * np.isin(chain.joints, followers)))


def _maps(
    chains: Chains, joints: Mapping[str, JointMap]
) -> dict[str, tuple[str, JointMap]]:
    """Column and map of every joint, checked against the robot."""
    # The first name is Pinocchio's "universe", which is no joint.
    known = [*chains.robot.model.names][1:]
    mapped: dict[str, str] = {}
    for column, given in joints.items():
        if given.joint not in known:
            raise InputError(
                f"'joints' maps column '{column}' to joint '{given.joint}', which the "
                f"robot does not have{nearest(given.joint, known)}",
                allowed=", ".join(chains.joints),
            )
        if given.joint in mapped:
            raise InputError(
                f"'joints' maps two columns, '{mapped[given.joint]}' and '{column}', "
                f"to joint '{given.joint}'"
            )
        mapped[given.joint] = column
    result = {}
    for joint in chains.joints:
        column = mapped.get(joint, joint)
        given = joints.get(column, JointMap(joint))
        if given.joint != joint:
            raise InputError(
                f"column '{joint}' is mapped to joint '{given.joint}', so joint "
                f"'{joint}' has no column; map another one to it"
            )
        result[joint] = column, given
    return result
