"""The chains of one robot that a job measures, by the names that measurements give."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import chain as joined
from pathlib import Path
from types import MappingProxyType
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from calib_pin.errors import OptionError, RobotError, nearest
from calib_pin.kinematics.chain import Chain
from calib_pin.kinematics.joint_space import JointSpace
from calib_pin.kinematics.robot import Robot
from calib_pin.kinematics.spatial import Floats
from calib_pin.plugins import upper
from calib_pin.setup import WORLD, ChainSetup, RobotSetup


class Chains:
    """Chains of one tree, whose configurations have the joints of all.

    Args:
        robot: The robot.
        base: Link at which chains start that do not state another; default the root.
        tip: Link at which the default chain ends; default the only leaf.
        setups: Base and tip of chains by name.
        names: Names of the chains that are measured: empty for the default one, `WORLD`
            for what stands still, a name among `setups`, else a link, the tip.
        built: Chains by name that exist already.

    Attributes:
        robot: The robot.
        names: The names, each once.
        joints: Names of the n moving joints: those of the only chain in its order, of
            several each once in the order of the tree, with all that these follow.
        mimics: The mimic joints among them.
        revolute: True for revolute and continuous joints, shape (n,).
        lower: Lower position limits, shape (n,) [rad, m], see `JointSpace`.
        upper: Upper position limits, shape (n,) [rad, m].
        unlimited: Joints without usable limits in the URDF, see `JointSpace`.

    Raises:
        RobotError: If there is no chain or link of a name, a stated chain is called
            `WORLD`, or a chain cannot be used.

    Examples:
        >>> import calib_pin
        >>> head = calib_pin.load_chain("example:talos_reduced", tip="head_2_link")
        >>> both = Chains(head.robot, names=("arm_left_7_link", "head_2_link", "world"))
        >>> len(both.joints), both.columns("head_2_link").tolist()
        (11, [0, 1, 9, 10])
    """

    def __init__(
        self,
        robot: Robot,
        base: str | None = None,
        tip: str | None = None,
        setups: Mapping[str, ChainSetup] = MappingProxyType({}),
        names: Sequence[str] = ("",),
        built: Mapping[str, Chain] = MappingProxyType({}),
    ) -> None:
        """Build the chains."""
        self.robot = robot
        self.names = tuple(dict.fromkeys(names))
        self._base, self._tip, self._setups = base, tip, dict(setups)
        if WORLD in setups:
            raise RobotError(
                f"'{WORLD}' is the name of what stands still, not of a chain",
                column="chains",
                allowed="another name",
            )
        self._chains = {
            name: built.get(name) or self._build(name) for name in self.names
        }
        model = robot.model
        moving = [chain.joints for chain in self._chains.values() if chain.joints]
        joints = list(dict.fromkeys(joined.from_iterable(moving)))
        if len(moving) > 1:
            leaders = JointSpace(model, joints, robot.mimics).joints
            joints = sorted(leaders, key=model.getJointId)
        self._space = JointSpace(model, joints, robot.mimics)
        self.joints = self._space.joints
        self.mimics = self._space.mimics
        self.revolute = self._space.revolute
        self.lower, self.upper = self._space.lower, self._space.upper
        self.unlimited = self._space.unlimited

    @staticmethod
    def of(chain: Robots, setup: RobotSetup | None = None) -> Chains:
        """A single chain under the empty name; several as they are.

        Args:
            chain: The chains, or the name or file of a robot, see `load_chain`.
            setup: What it states of the chains of a robot that is named; must not
                state another base or tip than a chain has.

        Raises:
            OptionError: If it does.
        """
        if isinstance(chain, str | Path):
            setup = setup or RobotSetup()
            given = {"base": setup.base, "tip": setup.tip, "stated": setup.chains}
            chains: Chains = upper("io.urdf", "load_chains", chain, **given)
            return chains
        if isinstance(chain, Chains):
            return chain
        for key in ("base", "tip"):
            stated, link = getattr(setup, key, None), getattr(chain, key)
            if stated not in (None, link):
                reason = f"the '{key}' of the setup is not that of the chain, '{link}'"
                raise OptionError(reason, value=stated)
        return Chains(chain.robot, chain.base, chain.tip, built={"": chain})

    def named(self, names: Sequence[str]) -> Chains:
        """The chains of other names of the same robot and statements."""
        return Chains(
            self.robot, self._base, self._tip, self._setups, names, self._chains
        )

    @property
    def base(self) -> str:
        """The link at which chains start that do not state another."""
        return self._base or self.robot.root

    def __getitem__(self, name: str) -> Chain:
        """The chain of a name."""
        return self._chains[name]

    def columns(self, name: str) -> NDArray[np.intp]:
        """Positions of a chain's joints among those of all."""
        return np.array([self.joints.index(k) for k in self[name].joints], np.intp)

    def follow(self, q: Floats) -> Floats:
        """Joint positions (N, n) [rad, m], with mimic joints where leaders put them."""
        return self._space.follow(q)

    def random_configurations(self, count: int, rng: np.random.Generator) -> Floats:
        """Configurations drawn uniformly within the limits, shape (count, n).

        Mimic joints follow their leaders.
        """
        return self._space.random_configurations(count, rng)

    def _build(self, name: str) -> Chain:
        """The chain of a name, not yet built."""
        robot, base = self.robot, self._base
        if name == WORLD:
            still = robot.root if base is None else base
            return Chain(robot, still, still)
        tip = name or self._tip
        if name in self._setups:
            tip, base = self._setups[name].tip, self._setups[name].base or base
        elif name and name not in robot.links:
            known = [WORLD, *self._setups, *robot.links]
            raise RobotError(
                f"there is no chain or link '{name}'{nearest(name, known)}",
                file=robot.file,
                allowed=", ".join(known) if len(known) <= 12 else None,
            )
        chain = Chain(robot, base, tip)
        if not chain.joints:
            raise RobotError(
                f"the chain ends at its base '{chain.base}', where nothing moves",
                file=robot.file,
                allowed=f"another tip, or {WORLD} for what stands still",
            )
        return chain


Robots: TypeAlias = Chain | Chains | str | Path
"""A chain, the chains of a robot, or the name or file of a robot."""
