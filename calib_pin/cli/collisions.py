"""Options of commands that look after collisions."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import calib_pin.cli.options as options
from calib_pin.cli.files import require_folders
from calib_pin.cli.printing import notice
from calib_pin.errors import OptionError

if TYPE_CHECKING:
    from calib_pin.kinematics.chain import Chain
    from calib_pin.kinematics.chains import Chains
    from calib_pin.kinematics.collision import Collisions
    from calib_pin.planning.ways import Ways
    from calib_pin.setup import Obstacle

Srdf = Annotated[
    Path | None,
    options.constraints(
        "--srdf FILE", "SRDF file of the pairs of links that need no collision check."
    ),
]
Clearance = Annotated[
    float | None,
    options.constraints(
        "--clearance S",
        "Least distance from obstacles and between links [m]; default 0.01.",
        options.number(float, "--clearance", "0 to 1 m", 0.0, 1.0),
    ),
]


def check_options(
    checked: bool,
    srdf: Path | None,
    package_dir: Sequence[Path] | None,
    clearance: float | None,
    reason: str,
) -> None:
    """Refuse folders that are none, and options of checks that are not made.

    Raises:
        OptionError: If so, with the reason.
    """
    require_folders(package_dir or [])
    if not checked and (srdf is not None or package_dir or clearance is not None):
        package = ", --package-dir" if package_dir else ""
        raise OptionError(f"{reason} --srdf{package} and --clearance")


def open_collisions(
    chain: Chain | Chains,
    obstacles: Sequence[Obstacle],
    srdf: Path | None,
    package_dir: Sequence[Path] | None,
    clearance: float | None,
    *,
    file: str,
    quiet: bool,
) -> Collisions | None:
    """The collisions of a robot; none if its URDF describes no solids."""
    from calib_pin.io.collision import CLEARANCE, load_collisions

    return load_collisions(
        chain,
        obstacles,
        srdf=srdf,
        package_dirs=package_dir or [],
        clearance=CLEARANCE if clearance is None else clearance,
        notice=None if quiet else notice,
        file=file,
    )


def ways_of(option: str, chain: Chain, collisions: Collisions | None) -> Ways:
    """The ways of a chain on which nothing is touched.

    Raises:
        OptionError: If its URDF describes no solids, or a joint follows one elsewhere.
    """
    from calib_pin.kinematics.chains import Chains
    from calib_pin.planning.ways import Ways

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
