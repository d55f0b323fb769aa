"""Errors of left-out groups from the factorization of one fit, beside refits.

Every fold and region of simulated jobs of bundled robots: usual errors, one measurement
of five wrong by 50 mm, errors of 50 mm and 5 degrees, few measurements. Both columns
of errors are root mean squares; the difference is the largest in predicted standard
deviations.

    scripts/benchmark holdout
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from time import process_time

import numpy as np

import calib_pin
from calib_pin.errors import InputError
from calib_pin.estimation.fit import fit_model
from calib_pin.estimation.formulation import nominal_problem
from calib_pin.kinematics.chain import Chain
from calib_pin.observations import Observations
from calib_pin.setup import FrameSetup, Setup
from calib_pin.validation.held_out import left_out
from calib_pin.validation.model_errors import ModelErrors, model_errors
from calib_pin.validation.splits import Grouping, folds, regions

TOOL = FrameSetup((0.05, 0.08, 0.1), estimate=True)
SETUP = Setup(tool_frame=TOOL)
COUNT, FEW, NOISE = 60, 20, 1e-4
LARGE = {"m": 0.05, "rad": float(np.deg2rad(5.0))}


def main() -> None:
    """Print the table."""
    print(f"{'job':<34}{'parts':>6}{'refits':>7}{'left out, refit [mm]':>22}", end="")
    print(f"{'difference':>11}{'time, refits [s]':>18}")
    for name, chain, rows in _jobs():
        whole = fit_model(chain, rows, SETUP, 0)
        rows = whole.weighted(rows)
        grouping = Grouping.of(rows, SETUP)
        parts = {
            "near": folds(grouping, whole, 0),
            "away": regions(grouping, 0),
        }
        for where, masks in parts.items():
            begin = process_time()
            found = left_out(whole, masks)
            between = process_time()
            pairs = []
            for mask, one in zip(masks, found, strict=True):
                some = rows.rows(~mask & (rows.weight > 0.0))
                try:
                    model = fit_model(chain, some, SETUP, 0, effects_of=whole)
                    at = np.flatnonzero(mask)
                    again = model_errors(model, rows.rows(mask), at)
                except InputError:
                    continue
                if one is not None:
                    pairs.append((one.counted(rows.weight), again.counted(rows.weight)))
            end = process_time()
            first, second = map(ModelErrors.joined, zip(*pairs, strict=True))
            apart = (first.after - second.after) / np.sqrt(second.variance)
            rms = [1e3 * np.sqrt(np.mean(e.after[:, :3] ** 2)) for e in (first, second)]
            print(
                f"{name + ', ' + where:<34}{len(masks):>6}{found.count(None):>7}"
                f"{rms[0]:>11.4f}{rms[1]:>11.4f}{np.abs(apart).max():>11.3f}"
                f"{between - begin:>9.3f}{end - between:>9.3f}",
                flush=True,
            )


def _jobs() -> Iterator[tuple[str, Chain, Observations]]:
    """Names, robots and measurements."""
    for robot in ("space6", "space7", "pa10"):
        chain = calib_pin.load_chain(robot)
        for model in ("position", "pose"):
            problem = nominal_problem(chain, model, SETUP)
            rng = np.random.default_rng(3)
            truth = calib_pin.draw_errors(problem.parameters, rng)
            sizes = [LARGE.get(p.unit, p.scale) for p in problem.parameters]
            large = np.where(
                problem.parameters.nuisance, truth, sizes * rng.normal(size=len(sizes))
            )
            for kind, errors, count in (
                ("usual", truth, COUNT),
                ("outliers", truth, COUNT),
                ("large", large, COUNT),
                ("few", truth, FEW),
            ):
                rows = calib_pin.simulate(
                    problem, errors, rng, count=count, noise=NOISE
                ).only
                if kind == "outliers":
                    values, wrong = rows.values.copy(), rng.permutation(count)[::5]
                    values[wrong, :3] += rng.normal(0.0, 0.05, (len(wrong), 3))
                    rows = replace(rows, values=values)
                yield f"{robot}, {model}, {kind}", chain, Observations.of(rows)
