"""Partial pose measurements and elastostatics from one command.

Simulation and solution are in `klimchik_study`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from calib_pin.kinematics.spatial import Floats
from studies import shared
from studies.klimchik_arm import COMPLIANCE, Settings
from studies.klimchik_design import DESIGN, PLANNED, RANDOM, Design, plan_poses
from studies.klimchik_figures import FIGURES
from studies.klimchik_model import LOADS, POINTS, irreducible, ranks, robot
from studies.klimchik_study import BOTH, MODELS, Accuracy, Alternation, Seed, study
from studies.records import Condition, Report, Table

SOURCE = "Wu, Klimchik, Caro, Furet, Pashkevich: partial pose measurements"

SAME = 1e-6
"""Difference, in expected sizes of errors, up to which two solutions are the same."""

SAME_COST = 1e-9
"""The same of relative costs."""

LIKE = 1.25
"""Factor up to which errors are as large as noise leads to expect."""

SURE = 4.5
"""Deviation of an estimate, in standard deviations, that chance does not explain."""

COUNTED = (18, 30, 33)
"""Parameters of the robot; with base and tool; with base and three points."""

ACCURACIES: Mapping[str, tuple[Callable[[Accuracy], float], str]] = {
    "position": (lambda a: a.position, "um"),
    "  predicted": (lambda a: a.predicted[0], "um"),
    "  robot": (lambda a: a.robot[0], "um"),
    "  robot, predicted": (lambda a: a.predicted_robot[0], "um"),
    "orientation": (lambda a: a.orientation, "urad"),
    "  predicted ": (lambda a: a.predicted[1], "urad"),
    "  robot ": (lambda a: a.robot[1], "urad"),
    "  robot, predicted ": (lambda a: a.predicted_robot[1], "urad"),
}
"""Lines of the table of reference points, with their units."""


def main(words: Sequence[str]) -> bool:
    """Run the study, print it, write its files; whether all conditions are met."""
    candidates = Settings.candidates
    chosen = shared.options(
        "klimchik",
        SOURCE,
        words,
        seeds=shared.Number(4, 10, "number of robots"),
        candidates=shared.Number(candidates, candidates, "candidates of the plan"),
    )
    settings = Settings(candidates=chosen.candidates)
    shared.stage("plan")
    planned = plan_poses(settings)
    seeds = shared.each(partial(study, settings, planned), range(chosen.seeds), "seed")
    result = report(settings, planned, seeds)
    return result.publish(chosen.output, FIGURES, (settings, seeds))


def report(settings: Settings, planned: Floats, seeds: Sequence[Seed]) -> Report:
    """The report on the results of some seeds.

    Args:
        settings: The settings of the simulation.
        planned: The planned configurations, shape (N, 6).
        seeds: The results, seed by seed.
    """
    tables, design = _Tables(settings, seeds), Design.create(settings)
    return Report(
        name="klimchik",
        source=SOURCE,
        description=tuple(_description(settings, len(seeds))),
        settings={
            "seeds": len(seeds),
            "design_seed": DESIGN,
            **vars(settings),
            "compliance_rad_per_Nm": COMPLIANCE,
        },
        tables=(
            _ranks(),
            tables.alternation(),
            tables.elastostatics(),
            _compliances(seeds),
            _deviations(seeds),
            tables.points(),
            tables.tests(),
        ),
        results={
            "irreducible": irreducible(robot()),
            "planned": {
                "predicted_rms_m": design.predicted(planned),
                "test_poses_rad": design.tests,
                "q_rad": planned,
            },
            "seeds": seeds,
        },
    )


def _description(s: Settings, count: int) -> Iterator[str]:
    yield (
        "The published robot and its tables are not available. All numbers here are "
        "ours: the robot is heavy6, with lengths near those of a KR 270; errors of "
        f"every placement are up to {1e3 * s.length:g} mm and {1e3 * s.angle:g} mrad. "
        f"A tracker measures {len(POINTS)} points on the tool at {s.count} random "
        f"configurations, positions only, with {1e3 * s.noise:g} mm of noise in every "
        f"coordinate, {s.repeats} readings averaged. {count} "
        f"seed{'s' if count > 1 else ''}, from 0 on; test poses and plan have seed "
        f"{DESIGN}."
    )
    kept = irreducible(robot())
    yield f"Irreducible model by the rule of case D: {len(kept)} of 36 errors."
    for joint in robot().joints:
        split = [name.rpartition(".") for name in kept]
        names = [name for of, _, name in split if of == f"{joint}.placement"]
        yield f"  {joint}  {' '.join(names) or '-'}"


def _ranks() -> Table:
    """Structural ranks by the number of points."""
    table = Table(
        "Structural ranks: the irreducible model, and all placement errors",
        "Points are known in the tool frame, or the coordinates of each are free. "
        "Base, and tool or points, are counted. The irreducible errors are among "
        "all placement errors: where the ranks are equal, so are their spans.",
    )
    robots, frames, coordinates = COUNTED
    count = {"irreducible": len(irreducible(robot()))}
    rule = Condition("the rule keeps eighteen errors", "equal to", robots)
    table.add("parameters of the robot", count, "", rule)
    for (points, known), rank in ranks().items():
        ours = {
            "irreducible": rank.kept_rank,
            "of": rank.kept,
            "all": rank.rank,
            "of ": rank.parameters,
        }
        limit = frames if known else coordinates
        limits = dict.fromkeys(("irreducible", "of", "all"), float(limit))
        full = Condition("three points: no column is dependent", "equal to", limits)
        name = f"{_points(points)}, {'in the tool frame' if known else 'free'}"
        table.add(name, ours, "", *([full] if points == len(POINTS) else []))
    return table


def _compliances(seeds: Sequence[Seed]) -> Table:
    """Estimates beside the truth."""
    table = Table(
        "Compliance",
        "Medians of the seeds, and the root mean square of the deviations. sigma*: "
        "from the measurements without load alone. Gravity exerts no torque on "
        "joint 1, whose axis is vertical, and without load none on joint 6.",
        digits=4,
    )
    known, true = [seed.elastostatics.compliances for seed in seeds], COMPLIANCE
    columns = {
        "true": np.array(true),
        "found": np.median([c.value for c in known], axis=0),
        "sigma": np.median([c.sigma for c in known], axis=0),
        "rms dev.": np.sqrt(np.mean([(c.value - true) ** 2 for c in known], axis=0)),
        "sigma*": np.median([c.unloaded for c in known], axis=0),
    }
    for k, joint in enumerate(robot().joints):
        table.add(joint, {c: float(x[k]) for c, x in columns.items()}, "urad/Nm")
    return table


def _deviations(seeds: Sequence[Seed]) -> Table:
    """Deviations of the compliances in standard deviations."""
    table = Table("Deviations of the compliances, in standard deviations")
    known = [seed.elastostatics.compliances for seed in seeds]
    sizes = np.array([(c.value - COMPLIANCE) / c.sigma for c in known])
    told = np.isfinite(sizes)
    sure = Condition("compliances are found", "at most", SURE)
    five = Condition("five joints are known in every seed", "equal to", 5.0)
    none = Condition("joint 1 is reported as unobservable", "equal to", 0.0)
    table.add("rms", shared.rms(sizes[told]))
    table.add("largest", np.abs(sizes[told]).max(), "", sure)
    table.add("joints that are known in every seed", told.all(axis=0).sum(), "", five)
    table.add("seeds in which joint 1 is known", told[:, 0].sum(), "", none)
    return table


@dataclass(frozen=True)
class _Tables:
    """Tables of medians and root mean squares over the seeds.

    Attributes:
        settings: The settings of the simulation.
        seeds: The results, seed by seed.
    """

    settings: Settings
    seeds: Sequence[Seed]

    def _median(self, value: Callable[[Seed], float]) -> float:
        return float(np.median([value(seed) for seed in self.seeds]))

    def _rms(self, value: Callable[[Seed], float]) -> float:
        """Root mean square over the seeds, as deviations add up."""
        return float(np.sqrt(np.mean([value(seed) ** 2 for seed in self.seeds])))

    def alternation(self) -> Table:
        """The joint solution and the alternating ones."""
        ended = sum(seed.alternation.converged for seed in self.seeds)
        table = Table(
            "Joint solution and two-step (alternating least squares)",
            "Base, points and the irreducible errors are unknown. Rounds count until "
            f"the joint solution is {self.settings.near:g} away, in expected sizes of "
            f"errors (1 mm, 3 mrad), and end at {self.settings.rounds}. Solver "
            f"two-step reports convergence in {ended} of {len(self.seeds)} seeds.",
        )
        same = "joint solution and two-step end at the same optimum"
        limits = {"difference": SAME, "relative difference of costs": SAME_COST}
        numbers: Mapping[str, Callable[[Alternation], float]] = {
            "joint, steps": lambda a: a.steps,
            "two-step, rounds": lambda a: len(a.mixed) - 1,
            "without acceleration, rounds": lambda a: len(a.plain) - 1,
            "difference": lambda a: a.difference,
            "relative difference of costs": lambda a: a.cost,
        }
        for name, value in numbers.items():
            values = [value(seed.alternation) for seed in self.seeds]
            ours = {"median": float(np.median(values)), "largest": max(values)}
            limit = {"largest": limits.get(name, 0.0)}
            conditions = [Condition(same, "at most", limit)] if name in limits else []
            table.add(name, ours, "", *conditions)
        return table

    def elastostatics(self) -> Table:
        """Errors with and without a payload."""
        s = self.settings
        table = Table(
            "Elastostatics: mean error at validation configurations, medians",
            f"Every configuration is measured without load and with {s.mass:g} kg; no "
            f"spring balances the arm. Judged by the points at {s.unseen} "
            "configurations.",
        )

        def by_load(value: Callable[[str], float]) -> dict[str, float]:
            return {title: value(load) for load, title in LOADS.items()}

        for model in MODELS:
            mean = by_load(
                lambda load: self._median(lambda s: s.elastostatics.mean(model, load))  # noqa: B023
            )
            table.add(model, mean, "mm")
        left = by_load(
            lambda load: self._rms(
                lambda s: shared.rms(s.elastostatics.errors[BOTH][load])
            )
        )
        noise = by_load(
            lambda load: self._rms(lambda s: s.elastostatics.predicted[load])
        )
        table.add(f"{BOTH}, rms", left, "mm")
        table.add("  predicted from noise, rms", noise, "mm")
        ratio = {load: left[load] / noise[load] for load in left}
        noisy = Condition("with compliance, only noise is left", "at most", LIKE)
        table.add("  ratio", ratio, "", noisy)
        return table

    def points(self) -> Table:
        """One, two and three points."""
        table = Table(
            "Tool frame at validation configurations, rms",
            "The points are known in the tool frame, whose unobservable part stays at "
            "its nominal value. Robot: apart from a constant motion of the tool.",
        )
        counts = {_points(n): n for n in self.seeds[0].accuracies}
        first, *_, last = counts
        found = self.seeds[0].accuracies
        table.add("rank", {name: found[n].rank for name, n in counts.items()})
        ours: dict[str, dict[str, float]] = {}
        for label, (value, unit) in ACCURACIES.items():
            ours[label] = {
                name: self._rms(lambda s: value(s.accuracies[n]))  # noqa: B023
                for name, n in counts.items()
            }
            table.add(label, ours[label], unit)
        orientation = ours["orientation"]
        ratio = {last: orientation[last] / ours["  predicted "][last]}
        given = f"{last} give the orientation"
        low, high = (
            Condition(given, "at least", 1 / LIKE),
            Condition(given, "at most", LIKE),
        )
        table.add("  ratio", ratio, "", low, high)
        lost = {first: orientation[first] / orientation[last]}
        hidden = Condition(f"{first} does not give the orientation", "above", 10.0)
        table.add(f"  over that of {last}", lost, "", hidden)
        return table

    def tests(self) -> Table:
        """Random and planned configurations for the test poses."""
        s = self.settings
        table = Table(
            f"Position at {s.tests} test poses",
            "Planned by the predicted variance at these test poses, over a workpiece; "
            f"{s.candidates} candidates. Means are medians of the seeds.",
        )
        random, planned = (
            {
                "predicted rms": self._rms(lambda s: s.planned[name].predicted),  # noqa: B023
                "rms": self._rms(lambda s: shared.rms(s.planned[name].errors)),  # noqa: B023
                "mean": self._median(lambda s: s.planned[name].errors.mean()),  # noqa: B023
            }
            for name in (RANDOM, PLANNED)
        )
        limits = {column: random[column] for column in ("mean", "predicted rms")}
        claim = "planned configurations are better at the test poses than random ones"
        table.add(f"{s.count} {RANDOM}", random, "um")
        better = Condition(claim, "below", limits)
        table.add(f"{s.count} {PLANNED}", planned, "um", better)
        return table


def _points(count: int) -> str:
    return f"{count} point{'s' if count > 1 else ''}"
