"""Robots of a fleet by their type: what they have in common, and who stands out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from calib_pin.estimation.statistics.population_prior import (
        Population,
        RobotEvidence,
    )
    from calib_pin.io.jobs import Job
    from calib_pin.validation.fleet import FleetRow


@dataclass(frozen=True)
class Types:
    """The types of a fleet.

    Attributes:
        populations: Those with robots enough, the largest first.
        rows: The rows of the fleet, those of such types with their farthest joint.
    """

    populations: Sequence[Population]
    rows: Sequence[FleetRow]

    def priors(self, folder: Path, name: str) -> dict[Path, bytes]:
        """The files of the priors.

        Args:
            folder: Where they go.
            name: Name of the first one; the others have that of their robot behind it.
        """
        from calib_pin.io.json_text import encode
        from calib_pin.io.population_prior import prior_document
        from calib_pin.io.results import urdf_name

        found: dict[Path, bytes] = {}
        for population in self.populations:
            path = folder / name
            if path in found:
                robot = Path(urdf_name(population.evidences[0].robot.name)).stem
                path = path.with_stem(f"{path.stem}-{robot}")
            number = 2
            while path in found:  # Two types may have one name.
                path = path.with_stem(f"{path.stem}-{number}")
            found[path] = encode(prior_document(population.prior()))
        return found


def types_of(
    jobs: Sequence[Job],
    rows: Sequence[FleetRow],
    evidences: Sequence[RobotEvidence | None],
) -> Types:
    """The types of a fleet; of a serial number its last calibration counts.

    Args:
        jobs: The jobs.
        rows: The row of each.
        evidences: The evidence of each; None where it tells nothing of a type.
    """
    from calib_pin.estimation.statistics.population_prior import (
        LEAST,
        joint_deviations,
        population_of,
    )
    from calib_pin.validation.fleet import with_joint

    earlier = {job.before for job in jobs}
    alike: list[list[int]] = []
    for k, (job, evidence) in enumerate(zip(jobs, evidences, strict=True)):
        if evidence is None or job.name in earlier:
            continue
        for members in alike:
            first = evidences[members[0]]
            assert first is not None
            same = not first.robot.difference(evidence.robot)
            if same and first.names == evidence.names:
                members.append(k)
                break
        else:
            alike.append([k])
    found, result = [], list(rows)
    for members in sorted(alike, key=len, reverse=True):
        if len(members) < LEAST:
            continue
        population = population_of([e for k in members if (e := evidences[k])])
        found.append(population)
        for k, joints in zip(members, joint_deviations(population), strict=True):
            result[k] = with_joint(result[k], joints)
    return Types(found, result)
