"""Partial pose measurements and elastostatics from one command.

What is simulated and how it is solved stands in `klimchik_study`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict
from functools import partial

import numpy as np

from calib_pin.kinematics.spatial import Floats
from studies import klimchik_figures as figures
from studies import shared
from studies.klimchik_arm import COMPLIANCE, Settings
from studies.klimchik_design import DESIGN, PLANNED, RANDOM, Design, plan_poses
from studies.klimchik_model import LOADS, POINTS, irreducible, ranks, robot
from studies.klimchik_study import BOTH, GEOMETRY, MODELS, Accuracy, Seed, study

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

ACCURACIES: Mapping[str, Callable[[Accuracy], float]] = {
    "position [um]": lambda a: a.position,
    "  predicted": lambda a: a.predicted[0],
    "  the robot's part": lambda a: a.robot[0],
    "    predicted": lambda a: a.predicted_robot[0],
    "orientation [urad]": lambda a: a.orientation,
    "  predicted ": lambda a: a.predicted[1],
    "  the robot's part ": lambda a: a.robot[1],
    "    predicted ": lambda a: a.predicted_robot[1],
}
"""Lines of the table of reference points."""


def main(words: Sequence[str]) -> None:
    """Run the study, print it, and write its files."""
    parser = shared.options("klimchik", SOURCE, 10)
    parser.add_argument(
        *("--candidates",),
        type="count",
        default=Settings.candidates,
        metavar="C",
        help="configurations that the plan chooses from, fewer for a short run "
        "(default: %(default)s)",
    )
    chosen = parser.parse_args(words)
    settings = Settings(candidates=chosen.candidates)
    planned = plan_poses(settings)
    seeds = shared.each(partial(study, settings, planned), range(chosen.seeds), "seed")
    report = Report(settings, planned, seeds)
    print(report.text())
    for condition in report.conditions():
        print(condition)
    shared.write_json(chosen.output / "klimchik.json", report.document())
    written = figures.draw(chosen.output, settings, seeds)
    print()
    for name in ("klimchik.json", *written):
        print(f"wrote {chosen.output / name}")


class Report:
    """The numbers of some seeds.

    Args:
        settings: What was simulated.
        planned: The configurations that were planned, shape (N, 6).
        seeds: What came out, seed by seed.
    """

    def __init__(
        self, settings: Settings, planned: Floats, seeds: Sequence[Seed]
    ) -> None:
        """Keep them, and count the ranks."""
        self.settings, self.planned, self.seeds = settings, planned, seeds
        self.ranks = ranks()
        self.predicted = Design.create(settings).predicted(planned)

    def median(self, value: Callable[[Seed], float]) -> float:
        """Median of a number over the seeds."""
        return float(np.median([value(seed) for seed in self.seeds]))

    def rms(self, value: Callable[[Seed], float]) -> float:
        """Root mean square of a number over the seeds, as deviations add up."""
        return float(np.sqrt(np.mean([value(seed) ** 2 for seed in self.seeds])))

    def text(self) -> str:
        """Tables for the terminal."""
        parts = (
            self._head(),
            self._model(),
            self._turns(),
            self._elastostatics(),
            self._compliances(),
            self._points(),
            self._tests(),
        )
        return "\n".join(line for part in parts for line in (*part, ""))

    def _head(self) -> Iterator[str]:
        s, count = self.settings, len(self.seeds)
        yield SOURCE
        yield shared.wrapped(
            "The published robot and its tables are not available. All numbers here "
            "are ours: the robot is heavy6, with lengths near those of a KR 270; "
            f"errors of every placement are up to {1e3 * s.length:g} mm and "
            f"{1e3 * s.angle:g} mrad. A tracker measures {len(POINTS)} points on the "
            f"tool at {s.count} random configurations, positions only, with "
            f"{1e3 * s.noise:g} mm of noise in every coordinate, {s.repeats} readings "
            f"averaged. {count} seed{'s' if count > 1 else ''}, from 0 on; "
            f"test poses and plan have seed {DESIGN}."
        )

    # --- tables --------------------------------------------------------------------

    def _model(self) -> Iterator[str]:
        kept = irreducible(robot())
        yield f"Irreducible model by the rule of case D: {len(kept)} of 36 errors"
        for joint in robot().joints:
            own = [name.rpartition(".") for name in kept]
            names = [name for of, _, name in own if of == f"{joint}.placement"]
            yield f"  {joint}  {' '.join(names) or '-'}"
        yield ""
        yield row("Structural ranks", ("all placements", "irreducible"))
        for (points, known), rank in self.ranks.items():
            of = "point" if points == 1 else "points"
            what = "known in the tool frame" if known else "each with its coordinates"
            yield row(
                f"  {points} {of}, {what}",
                (
                    f"{rank.rank} of {rank.parameters}",
                    f"{rank.kept_rank} of {rank.kept}",
                ),
            )
        yield shared.wrapped(
            "Base, and tool or points, are counted. The irreducible errors are among "
            "all placement errors: where the ranks are equal, so is what they span."
        )

    def _turns(self) -> Iterator[str]:
        yield row("Joint solve and two steps", ("median", "most"))
        for name, values in (
            ("joint solve, steps", [s.turns.steps for s in self.seeds]),
            ("two-step, rounds", [len(s.turns.mixed) - 1 for s in self.seeds]),
            (
                "the same without acceleration, rounds",
                [len(s.turns.plain) - 1 for s in self.seeds],
            ),
        ):
            yield row(f"  {name}", (f"{np.median(values):g}", f"{max(values)}"))
        for name, apart in (
            ("difference of the solutions", [s.turns.difference for s in self.seeds]),
            ("relative difference of costs", [s.turns.cost for s in self.seeds]),
        ):
            yield row(f"  {name}", (f"{np.median(apart):.0e}", f"{max(apart):.0e}"))
        ended = sum(s.turns.converged for s in self.seeds)
        yield shared.wrapped(
            "Unknown are base, points and the irreducible errors. Rounds count until "
            f"the joint solution is {self.settings.near:g} away, in expected sizes of "
            f"errors (1 mm, 3 mrad), and end at {self.settings.rounds}. Solver "
            f"two-step says that it has converged in {ended} of {len(self.seeds)} "
            "seeds."
        )

    def _elastostatics(self) -> Iterator[str]:
        s = self.settings
        yield row("Elastostatics: mean error on unseen [mm]", LOADS.values())
        for model in MODELS:
            yield row(f"  {model}", (mm(self._mean(model, load)) for load in LOADS))
        yield row(f"  {BOTH}, rms", (mm(self._left(load)) for load in LOADS))
        yield row(
            "  what noise leaves of it, rms", (mm(self._noise(load)) for load in LOADS)
        )
        yield shared.wrapped(
            f"Every configuration is measured without load and with {s.mass:g} kg; no "
            f"spring balances the arm. Judged by the points on {s.unseen} unseen "
            "configurations."
        )

    def _mean(self, model: str, load: str) -> float:
        return self.median(lambda seed: seed.elastostatics.mean(model, load))

    def _left(self, load: str) -> float:
        """Root-mean-square error of the geometry with the compliances."""
        return self.rms(lambda seed: rms(seed.elastostatics.errors[BOTH][load]))

    def _noise(self, load: str) -> float:
        return self.rms(lambda seed: seed.elastostatics.predicted[load])

    def _compliances(self) -> Iterator[str]:
        """Estimates beside the truth."""
        columns = ("true", "found", "sigma", "rms dev.", "sigma*")
        yield row("Compliance [urad/Nm]", columns, 11, 24)
        known = [seed.elastostatics.compliances for seed in self.seeds]
        for k, joint in enumerate(robot().joints):
            true = COMPLIANCE[k]
            cells = [
                np.median([c.value[k] for c in known]),
                np.median([c.sigma[k] for c in known]),
                np.sqrt(np.mean([(c.value[k] - true) ** 2 for c in known])),
                np.median([c.unloaded[k] for c in known]),
            ]
            words = [f"{1e6 * x:.4f}" if np.isfinite(x) else "-" for x in cells]
            yield row(f"  {joint}", (f"{1e6 * true:g}", *words), 11, 24)
        yield shared.wrapped(
            "Medians of the seeds, and the root mean square of the deviations. sigma*: "
            "from the rows without load alone. Gravity exerts no torque on joint 1, "
            "whose axis is vertical, and without load none on joint 6."
        )

    def _points(self) -> Iterator[str]:
        """One, two and three points."""
        names = [f"{n} point{'s' if n > 1 else ''}" for n in self._counts]
        yield row("Tool frame on unseen configurations, rms", names, 11)
        found = (str(self.seeds[0].accuracies[n].rank) for n in self._counts)
        yield row("  rank", found, 11)
        for label, value in ACCURACIES.items():
            cells = (number(1e6 * self._accuracy(n, value)) for n in self._counts)
            yield row(f"  {label}", cells, 11)
        yield shared.wrapped(
            "The points are known in the tool frame. What they cannot tell of it "
            "stays where it was mounted; the robot's part is what a constant motion "
            "of the tool does not explain."
        )

    @property
    def _counts(self) -> Sequence[int]:
        """Numbers of points."""
        return tuple(self.seeds[0].accuracies)

    def _accuracy(self, points: int, value: Callable[[Accuracy], float]) -> float:
        return self.rms(lambda seed: value(seed.accuracies[points]))

    def _tests(self) -> Iterator[str]:
        s = self.settings
        title = f"Position at {s.tests} test poses [um]"
        yield row(title, ("predicted rms", "rms", "mean"), 14, 38)
        for name in (RANDOM, PLANNED):
            cells = (self._predicted(name), *(f(name) for f in (self._at, self._met)))
            yield row(f"  {s.count} {name}", (number(1e6 * x) for x in cells), 14, 38)
        yield shared.wrapped(
            "Planned by the predicted variance at these test poses, over a workpiece; "
            f"{s.candidates} candidates. Means are medians of the seeds."
        )

    def _predicted(self, name: str) -> float:
        return self.rms(lambda seed: seed.planned[name].predicted)

    def _at(self, name: str) -> float:
        """Root-mean-square error at the test poses."""
        return self.rms(lambda seed: rms(seed.planned[name].errors))

    def _met(self, name: str) -> float:
        """Mean error there."""
        return self.median(lambda seed: float(seed.planned[name].errors.mean()))

    # --- conditions ----------------------------------------------------------------

    def conditions(self) -> Iterator[shared.Condition]:
        """What must be shown, whether it is, and by what numbers."""
        yield self._counted()
        yield self._same()
        yield self._falls()
        yield self._sure()
        yield self._oriented()
        yield self._better()

    def _counted(self) -> shared.Condition:
        count = len(POINTS)
        known, own = self.ranks[count, True], self.ranks[count, False]
        robots, frames, coordinates = COUNTED
        kept = len(irreducible(robot()))
        return shared.Condition(
            f"three points: {kept} parameters of the robot by the rule, rank "
            f"{known.kept_rank} = {kept} + 6 + 6 with the tool a frame (all placements "
            f"{known.rank}), {own.kept_rank} with the points' own coordinates (all "
            f"placements {own.rank}); no column is dependent",
            kept == robots
            and (known.kept, known.kept_rank, known.rank) == (frames,) * 3
            and (own.kept, own.kept_rank, own.rank) == (coordinates,) * 3,
            {"irreducible": kept}
            | {f"known_{key}": x for key, x in asdict(known).items()}
            | {f"own_{key}": x for key, x in asdict(own).items()},
        )

    def _same(self) -> shared.Condition:
        apart = max(seed.turns.difference for seed in self.seeds)
        cost = max(seed.turns.cost for seed in self.seeds)
        mixed = self.median(lambda seed: len(seed.turns.mixed) - 1)
        plain = self.median(lambda seed: len(seed.turns.plain) - 1)
        return shared.Condition(
            f"joint solve and two-step end at the same optimum: parameters differ by "
            f"up to {apart:.0e} of their expected size (limit {SAME:g}), costs by "
            f"{cost:.0e} (limit {SAME_COST:g}); {mixed:g} rounds, without acceleration "
            f"{plain:g}",
            apart <= SAME and cost <= SAME_COST,
            {
                "largest_difference": apart,
                "largest_relative_cost": cost,
                "median_rounds": mixed,
                "median_plain_rounds": plain,
            },
        )

    def _falls(self) -> shared.Condition:
        numbers = {
            f"{model}_{load}_m": self._mean(model, load)
            for model in (GEOMETRY, BOTH)
            for load in LOADS
        }
        ratios = {load: self._left(load) / self._noise(load) for load in LOADS}
        words = [
            f"{mm(self._mean(GEOMETRY, load))} against "
            f"{mm(self._mean(BOTH, load))} mm {name}"
            for load, name in LOADS.items()
        ]
        most = max(ratios.values())
        return shared.Condition(
            f"geometry alone against geometry with compliance: {', '.join(words)}; "
            f"what is left is {most:.2f} times what noise leaves (limit {LIKE:g})",
            most <= LIKE,
            numbers | {f"over_noise_{load}": x for load, x in ratios.items()},
        )

    def _sure(self) -> shared.Condition:
        sizes = np.array(
            [
                (c.value - COMPLIANCE) / c.sigma
                for c in (seed.elastostatics.compliances for seed in self.seeds)
            ]
        )
        told = np.isfinite(sizes)
        largest = float(np.abs(sizes[told]).max())
        spread = rms(sizes[told])
        count = int(told.all(axis=0).sum())
        return shared.Condition(
            f"compliances of {count} joints are found: deviations are {spread:.2f} "
            f"standard deviations (rms), at most {largest:.1f} (limit {SURE:g}); that "
            "of joint 1 is told to be hidden",
            largest <= SURE and count == 5 and not told[:, 0].any(),
            {"joints": count, "rms_sigmas": spread, "largest_sigmas": largest},
        )

    def _oriented(self) -> shared.Condition:
        few, *_, most = self._counts
        one, three = (self._accuracy(n, lambda a: a.orientation) for n in (few, most))
        predicted = self._accuracy(most, lambda a: a.predicted[1])
        ratio = three / predicted
        return shared.Condition(
            f"positions of three points give the orientation: {number(1e6 * three)} "
            f"urad (predicted {number(1e6 * predicted)}), with one point "
            f"{number(1e6 * one)}",
            1.0 / LIKE <= ratio <= LIKE and one > 10.0 * three,
            {
                "orientation_1_rad": one,
                "orientation_3_rad": three,
                "predicted_3_rad": predicted,
            },
        )

    def _better(self) -> shared.Condition:
        numbers = {
            f"{kind}_{name}_m": value(name)
            for kind, value in (
                ("predicted", self._predicted),
                ("rms", self._at),
                ("mean", self._met),
            )
            for name in (RANDOM, PLANNED)
        }
        means = self._met(PLANNED), self._met(RANDOM)
        predicted = self._predicted(PLANNED), self._predicted(RANDOM)
        words = [
            f"{number(1e6 * ours)} against {number(1e6 * random)} um"
            for ours, random in (means, predicted)
        ]
        return shared.Condition(
            f"planned configurations are better at the test poses than random ones: "
            f"mean error {words[0]}, predicted {words[1]} (rms)",
            means[0] < means[1] and predicted[0] < predicted[1],
            numbers,
        )

    # --- document ------------------------------------------------------------------

    def document(self) -> dict[str, object]:
        """All numbers; names end in their unit."""
        return {
            "study": "klimchik",
            "source": SOURCE,
            "versions": shared.versions(),
            "settings": {"seeds": len(self.seeds), "design_seed": DESIGN}
            | settings_of(self.settings),
            "conditions": [asdict(condition) for condition in self.conditions()],
            "irreducible": irreducible(robot()),
            "ranks": [
                {"points": points, "known_in_tool_frame": known} | asdict(rank)
                for (points, known), rank in self.ranks.items()
            ],
            "planned": {
                "predicted_rms_m": self.predicted,
                "test_poses_rad": Design.create(self.settings).tests.tolist(),
                "q_rad": self.planned.tolist(),
            },
            "seeds": [
                {"seed": k} | numbers_of(seed) for k, seed in enumerate(self.seeds)
            ],
        }


def settings_of(settings: Settings) -> dict[str, object]:
    """Settings under names with their units."""
    names = {
        "noise": "noise_m",
        "length": "placement_errors_m",
        "angle": "placement_errors_rad",
        "mass": "payload_kg",
        "com": "payload_com_m",
        "near": "near_in_expected_sizes",
    }
    return shared.renamed(settings, names) | {"compliance_rad_per_Nm": COMPLIANCE}


def numbers_of(seed: Seed) -> dict[str, object]:
    """The numbers of a seed."""
    elastic = seed.elastostatics
    return {
        "turns": asdict(seed.turns),
        "elastostatics": {
            "rank": elastic.rank,
            "errors": {
                model: {
                    load: {
                        "mean_m": float(errors.mean()),
                        "rms_m": rms(errors),
                        "max_m": float(errors.max()),
                    }
                    for load, errors in of.items()
                }
                for model, of in elastic.errors.items()
            },
            "predicted_rms_m": dict(elastic.predicted),
            "compliance_rad_per_Nm": told(elastic.compliances.value),
            "sigma_rad_per_Nm": told(elastic.compliances.sigma),
            "sigma_without_load_rad_per_Nm": told(elastic.compliances.unloaded),
        },
        "points": {
            points: {
                "rank": found.rank,
                "position_m": found.position,
                "orientation_rad": found.orientation,
                "robot_m_rad": found.robot,
                "predicted_m_rad": told(found.predicted),
                "predicted_robot_m_rad": found.predicted_robot,
            }
            for points, found in seed.accuracies.items()
        },
        "test_poses": {
            name: {
                "predicted_rms_m": found.predicted,
                "rms_m": rms(found.errors),
                "mean_m": float(found.errors.mean()),
                "max_m": float(found.errors.max()),
            }
            for name, found in seed.planned.items()
        },
    }


def told(values: Iterable[float]) -> list[float | None]:
    """Numbers, and nothing where there are none."""
    return [float(x) if np.isfinite(x) else None for x in values]


def rms(values: Floats) -> float:
    """Root mean square."""
    return float(np.sqrt(np.mean(values**2)))


def row(label: str, cells: Iterable[str], width: int = 16, first: int = 46) -> str:
    """A line of a table, with the widths of its columns and of the first one."""
    return f"{label:<{first}}{''.join(f'{cell:>{width}}' for cell in cells)}"


def mm(value: float) -> str:
    """A length in millimeters."""
    return f"{number(1e3 * value)}"


def number(value: float) -> str:
    """Three significant digits without an exponent; a dash where there is none."""
    if not np.isfinite(value):
        return "-"
    digits = 2 - int(np.floor(np.log10(value))) if value > 0.0 else 0
    return f"{value:.{max(0, digits)}f}"
