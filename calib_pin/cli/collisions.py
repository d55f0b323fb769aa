"""Options of commands that look after collisions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import calib_pin.cli.options as options
from calib_pin.cli.printing import notice
from calib_pin.cli.request import Told, number
from calib_pin.errors import OptionError

if TYPE_CHECKING:
    from calib_pin.kinematics.chain import Chain
    from calib_pin.kinematics.chains import Chains
    from calib_pin.kinematics.collision import Collisions
    from calib_pin.planning.travel import Ways
    from calib_pin.setup import Obstacle

CLEARANCE = number(float, "--clearance", "0 to 1 m", 0.0, 1.0)


@dataclass(frozen=True, kw_only=True)
class Untouched(options.QuietAnswer):
    """The collisions that a command looks after, as they are asked for.

    Attributes:
        srdf: SRDF file of the pairs of links that need no collision check.
        clearance: Least distance from obstacles and between links [m]; default 0.01.
    """

    srdf: Annotated[Path | None, Told("FILE", "Constraints")] = None
    clearance: Annotated[float | None, Told("S", "Constraints", CLEARANCE)] = None
    package_dir: options.PackageDirs = None

    def refuse_unused(
        self, reason: str, package_dir: Sequence[Path] | None = None
    ) -> None:
        """Refuse options of checks that are not made.

        Raises:
            OptionError: If there is one, with the reason.
        """
        if self.srdf is not None or package_dir or self.clearance is not None:
            package = ", --package-dir" if package_dir else ""
            raise OptionError(f"{reason} --srdf{package} and --clearance")

    def collisions(
        self, chain: Chain | Chains, obstacles: Sequence[Obstacle], file: str
    ) -> Collisions | None:
        """The collisions of a robot; none if its URDF describes no solids."""
        from calib_pin.io.collision import CLEARANCE, load_collisions

        return load_collisions(
            chain,
            obstacles,
            srdf=self.srdf,
            package_dirs=self.package_dir or [],
            clearance=CLEARANCE if self.clearance is None else self.clearance,
            notice=None if self.quiet else notice,
            file=file,
        )


def ways_of(option: str, chain: Chain, collisions: Collisions | None) -> Ways:
    """The ways of a chain on which nothing is touched.

    Raises:
        OptionError: If its URDF describes no solids, or a joint follows one elsewhere.
    """
    from calib_pin.kinematics.chains import Chains
    from calib_pin.planning.travel import Ways

    chains = Chains.of(chain)
    if len(chains.joints) > len(chain.joints):
        reason = f"{option} needs the joints that others mimic in the chain"
        raise OptionError(reason, value=chains.joints[-1])
    solid = require_solids(option, chains, collisions)
    return Ways(chains, solid, chain.lower, chain.upper)


def require_solids(
    option: str, chains: Chains, collisions: Collisions | None
) -> Collisions:
    """The collisions of a robot.

    Raises:
        OptionError: If its URDF describes no solids, which an option needs.
    """
    if collisions is None:
        reason = f"{option} needs the solids of the robot, and the URDF has none"
        file, allowed = chains.robot.file, "<collision> in its links"
        raise OptionError(reason, file=file, allowed=allowed)
    return collisions
