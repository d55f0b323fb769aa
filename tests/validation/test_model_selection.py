"""The model ladder: what it keeps, what it leaves, and what it says about the rest."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import pinocchio as pin
import pytest

import calib_pin
from calib_pin.errors import InputError, OptionError
from calib_pin.estimation.formulation import nominal_problem
from calib_pin.kinematics.chain import Chain
from calib_pin.kinematics.spatial import Floats
from calib_pin.observations import Conditions, Observations
from calib_pin.residual_models import RESIDUAL_MODELS, LearnedCorrection, TrainingRows
from calib_pin.setup import FrameSetup, Payload, Setup
from calib_pin.validation.model_errors import fitted_errors
from calib_pin.validation.model_selection import (
    Judged,
    SelectedModel,
    helps,
    select_model,
    simplest,
)
from calib_pin.validation.result import Candidate
from calib_pin.validation.splits import FOLDS
from tests.residual_models.corrections import Everywhere
from tests.shared import chain_of, joint, refused, urdf_of

NOISE = 2e-5
TOOL = FrameSetup((0.05, 0.08, 0.12))
BOTH = "+ transmission + compliance"
ALONE = ["joint offset", "geometric", "+ transmission", "+ compliance"]
RUNGS = [*ALONE, "+ cross-compliance", BOTH]
LOADED = Setup(payloads={"load": Payload(10.0, (0.1, 0.05, 0.15))})
WRIST = ("joint_5", "joint_6", "joint_7")


def without_residual_models(patch: pytest.MonkeyPatch) -> None:
    """They take long and have tests of their own."""
    # The last one first, so that they come back in their order.
    for name in reversed(list(RESIDUAL_MODELS)):
        patch.delitem(RESIDUAL_MODELS, name)  # type: ignore[arg-type]


@pytest.fixture(autouse=True)
def no_residual_models(monkeypatch: pytest.MonkeyPatch) -> None:
    without_residual_models(monkeypatch)


@pytest.fixture(scope="module")
def chain() -> Chain:
    """A quick arm of three joints, which are not neatly at right angles."""
    rng = np.random.default_rng(2)
    axes = [(0, 0, 1), (0, 1, 0.1), (0.1, 1, 0)]
    places = [
        pin.SE3(pin.exp3(0.1 * rng.normal(size=3)), np.array(at))
        for at in [(0, 0, 0.3), (0.1, 0, 0.2), (0.5, 0, 0)]
    ]
    mass = 4.0, (0.25, 0.05, 0.0)
    joints = [
        joint(f"joint_{k}", f"link_{k - 1} link_{k}", place, axis, mass=mass)
        for k, (axis, place) in enumerate(zip(axes, places, strict=True), start=1)
    ]
    tool = pin.SE3(pin.exp3(np.array([0.0, 1.2, 0.0])), np.array([0.4, 0.0, 0.0]))
    flange = joint("flange", "link_3 tool", tool, kind="fixed")
    return chain_of(urdf_of(*joints, flange))


@pytest.fixture(scope="module")
def plain(chain: Chain) -> SelectedModel:
    """The ladder for 30 rows of a robot with errors of its geometry alone."""
    with pytest.MonkeyPatch.context() as patch:
        without_residual_models(patch)
        return select_model(chain, simulated(chain, ["placement"]), Setup(), 0)


def simulated(
    chain: Chain,
    kinds: Sequence[str],
    setup: Setup = LOADED,
    *,
    joints: Sequence[str] = (),
    count: int = 30,
    seed: int = 1,
) -> Observations:
    """Positions of a robot with errors of some kinds, compliance of some joints."""
    stated = replace(setup, parameters=tuple(kinds), tool_frame=TOOL)
    problem = nominal_problem(chain, "position", stated)
    rng = np.random.default_rng(seed)
    truth = calib_pin.draw_errors(problem.parameters, rng)
    for k, parameter in enumerate(problem.parameters):
        joint, kind, _ = parameter.name.split(".")
        if kind == "compliance":
            truth[k] = parameter.scale if not joints or joint in joints else 0.0
    rows = calib_pin.simulate(problem, truth, rng, count=count, noise=NOISE).only
    # What is carried in all rows goes without saying.
    return Observations.of(replace(rows, conditions=Conditions()))


def rungs(selected: SelectedModel) -> dict[str, Candidate]:
    return {rung.name: rung for rung in selected.selection.candidates}


def kept(selected: SelectedModel) -> Candidate:
    return selected.selection.candidates[selected.selection.chosen]


# What is kept.


@pytest.mark.slow
@pytest.mark.parametrize(
    ("truth", "joints", "expected"),
    [
        (("joint-offset",), (), "joint offset"),
        (("placement", "transmission"), (), "+ transmission"),
        # What a wrist carries depends on all joints: no wave of one can pass for it.
        (("joint-offset", "compliance"), WRIST, "+ compliance"),
        (("placement", "transmission", "compliance"), (), BOTH),
    ],
    ids=lambda given: given if isinstance(given, str) else "-".join(given),
)
def test_what_a_robot_has_is_kept(
    truth: tuple[str, ...], joints: tuple[str, ...], expected: str
) -> None:
    parameters = truth
    chain = calib_pin.load_chain("pa10")
    rows = simulated(chain, truth, joints=joints, count=80)
    selected = select_model(chain, rows, LOADED, 0)
    # What helps across the axes is tried with the others.
    assert list(rungs(selected))[:5] == RUNGS[:5] and BOTH in rungs(selected)
    found = kept(selected)
    assert (found.name, found.parameters) == (expected, parameters)
    assert selected.fit.problem.setup.parameters == parameters
    helps = {rung.name for rung in selected.selection.candidates if rung.helps}
    assert {"joint offset", expected} <= helps
    assert ("geometric" in helps) == ("placement" in truth)
    assert (BOTH in helps) == (expected == BOTH)
    assert not any(rung.reason for rung in selected.selection.candidates)
    # As good as the noise, and what it was before is seen.
    assert found.score == pytest.approx(1.0, abs=0.3)
    (error,) = found.errors
    assert (error.name, error.unit) == ("position", "m")
    # The mean length of three components of unit deviation is 1.6.
    assert error.mean == pytest.approx(1.6 * NOISE * found.score, rel=0.1)
    assert selected.fit.rank == found.rank
    assert set(selected.fit.solved.problem.setup.parameters) == set(parameters)


def test_the_scores_are_those_of_unseen_rows(
    chain: Chain, plain: SelectedModel
) -> None:
    rows, selected = simulated(chain, ["placement"]), plain
    assert len(selected.parts) == FOLDS
    order = np.argsort(np.concatenate([part.positions for part in selected.parts]))
    after = np.concatenate([part.after for part in selected.parts])[order]
    found = kept(selected)
    sizes = np.sqrt(np.mean((after / NOISE) ** 2, axis=1))
    assert found.score == pytest.approx(sizes.mean())
    assert found.deviation == pytest.approx(sizes.std(ddof=1) / np.sqrt(30))
    assert found.errors[0][2] == pytest.approx(np.linalg.norm(after, axis=1).mean())
    # The fit itself has seen them all.
    fitted = fitted_errors(selected.fit, rows).after
    assert np.mean(fitted**2) < np.mean(after**2)


def test_the_geometry_of_the_setup_makes_the_second_rung(chain: Chain) -> None:
    rows = simulated(chain, ["dh"], count=8)
    setup = Setup(parameters=("compliance", "dh", "joint-offset"))
    selected = select_model(chain, rows, setup, 0)
    assert [rung.parameters for rung in selected.selection.candidates] == [
        ("joint-offset",),
        ("dh",),
        ("dh", "transmission"),
        ("dh", "compliance"),
        ("dh", "cross-compliance"),
        ("dh", "transmission", "compliance"),
    ]


# What cannot be tried.


def test_few_rows_leave_the_upper_rungs_untried(chain: Chain) -> None:
    """Five of seven configurations tell of offsets, but not of all the geometry."""
    rows = simulated(chain, ["joint-offset"], count=7)
    selected = select_model(chain, rows, Setup(), 0)
    offset, geometric, *further = selected.selection.candidates
    transmission, compliance, across, both = further
    assert not offset.reason and kept(selected) is offset
    assert not compliance.reason
    for rung in (geometric, transmission, across, both):
        assert "7 configurations" in rung.reason
        assert np.isnan(rung.score) and rung.rank == 0 and not rung.errors
        assert not rung.helps


def test_too_few_rows_for_any_rung(chain: Chain) -> None:
    rows = simulated(chain, ["joint-offset"], count=4)
    # However often they were read.
    for often in (1, 20):
        with refused(OptionError, "4 configurations"):
            select_model(chain, rows.rows(np.repeat(np.arange(4), often)), Setup(), 0)


def test_without_masses_or_with_an_unknown_payload(chain: Chain) -> None:
    massless = calib_pin.load_chain("space6")
    rows = simulated(massless, ["joint-offset"], Setup(), count=10)
    rung = rungs(select_model(massless, rows, Setup(), 0))["+ compliance"]
    assert "'compliance'" in rung.reason and "payload" in rung.reason
    assert np.isnan(rung.score) and not rung.helps
    payloads = {name: Payload(1.0, (0.0, 0.0, 0.0)) for name in "ab"}
    rows = simulated(chain, ["placement"], Setup(), count=20)
    with pytest.raises(InputError, match="payload"):
        select_model(chain, rows, Setup(payloads=payloads), 0)


# Names and globs.


def test_a_pattern_of_no_rung(chain: Chain) -> None:
    rows = simulated(chain, ["placement"], Setup())
    setup = Setup(file="s.yaml", fixed=("joint_3.placment.x",))
    reason = "'joint_3.placment.x'", "'joint_3.placement.x'"
    with refused(OptionError, reason, file="s.yaml"):
        select_model(chain, rows, setup, 0)


# Learned rungs.


@dataclass(frozen=True)
class Wave(Everywhere):
    """Every joint moves with the one before, which no parameter knows."""

    def __call__(self, q: Floats) -> Floats:
        return np.asarray(self.size * np.sin(5.0 * np.roll(q, 1, axis=1)))


@dataclass(frozen=True)
class Trainer:
    """Knows the truth, or something else, without looking."""

    size: float

    def __call__(
        self,
        rows: TrainingRows,
        rng: np.random.Generator,
        *,
        progress: Callable[[float], None] | None = None,
    ) -> Wave:
        if not self.size:
            raise OptionError("it has no mind to learn")
        if progress is not None:
            progress(0.5)
        return Wave(self.size, np.zeros(len(rows.shift)))


@pytest.fixture
def trainers(no_residual_models: None, monkeypatch: pytest.MonkeyPatch) -> None:
    for name, size in (("lazy", 0.0), ("wrong", -2e-4), ("right", 5e-4)):
        trainer = Trainer(size)
        monkeypatch.setitem(RESIDUAL_MODELS, name, trainer)  # type: ignore[arg-type]


def waving(chain: Chain, rows: Observations) -> Observations:
    """The same rows of a robot that has the wave as well."""
    problem = nominal_problem(chain, "position", Setup(tool_frame=TOOL))
    zero = np.zeros(len(problem.only.error.screws))
    wave = Wave(5e-4, np.zeros(len(zero)))
    moved = replace(problem.only.error, learned=wave).poses(rows.q, zero)
    change = moved - problem.only.error.poses(rows.q, zero)
    values = rows.only.values + change[:, :3, 3]
    return Observations.of(replace(rows.only, values=values))


@pytest.mark.usefixtures("trainers")
def test_learned_rungs_stand_on_the_last_that_helped(chain: Chain) -> None:
    rows = waving(chain, simulated(chain, ["joint-offset"], Setup()))
    told: list[tuple[str, float]] = []
    selected = select_model(chain, rows, Setup(), 0, lambda *now: told.append(now))
    stages, done = zip(*told, strict=True)
    assert list(dict.fromkeys(stages)) == [*RUNGS, "+ lazy", "+ wrong", "+ right"]
    assert list(done) == sorted(done)
    assert done[0] == 0.0 and 0.9 < done[-1] <= 1.0
    found = rungs(selected)
    assert list(found) == [*RUNGS, "+ lazy", "+ wrong", "+ right"]
    below = ("joint-offset",)
    for name in ("lazy", "wrong", "right"):
        rung = found[f"+ {name}"]
        assert (rung.learned, rung.parameters) == (name, below)
    assert found["+ lazy"].reason == "it has no mind to learn"
    assert not found["+ wrong"].helps and not found["+ wrong"].reason
    assert kept(selected) is found["+ right"] and kept(selected).helps
    assert kept(selected).score < 0.4 * found["joint offset"].score
    assert selected.fit.problem.setup.learned == "right"
    learned = selected.fit.solved.problem.only.error.learned
    assert isinstance(learned, LearnedCorrection)
    assert isinstance(learned.model, Wave) and learned.model.size == 5e-4
    # Its errors on unseen rows, not those of the parameters alone.
    after = np.concatenate([part.after for part in selected.parts])
    mean = np.linalg.norm(after, axis=1).mean()
    assert kept(selected).errors[0][2] == pytest.approx(mean)
    assert mean < 0.4 * found["joint offset"].errors[0][2]


# Which candidate helps, and which is chosen, near and away.


def sizes(mean: float, seed: int = 0) -> Floats:
    """Errors of forty configurations, which candidates share but for a little."""
    common = np.random.default_rng(9).uniform(0.5, 1.5, 40)
    own = 0.02 * np.random.default_rng(seed).normal(size=40)
    return mean * (common / common.mean() + own - own.mean())


def judged(*means: float, rank: int, learned: str | None = None) -> Judged:
    candidate = Candidate(f"of rank {rank}", (), learned, rank, helps=True)
    return Judged(candidate, sizes=tuple(sizes(m, rank) for m in means))


@pytest.mark.parametrize(
    ("near", "away", "expected"),
    [
        (0.9, 0.9, {"near", "away", "both"}),
        (0.9, 1.0, {"near", "both"}),
        (0.9, 1.2, {"near"}),
        (1.2, 0.9, {"away"}),
        (1.0, 1.0, set()),
    ],
)
def test_helping(near: float, away: float, expected: set[str]) -> None:
    """Somewhere better, and nowhere worse, where it is used."""
    before = sizes(1.0, 1), sizes(1.0, 1)
    # Exactly as good is no gain.
    after = tuple(sizes(m, 1) if m == 1.0 else sizes(m, 2) for m in (near, away))
    found = {use for use in ("near", "away", "both") if helps(after, before, use)}
    assert found == expected


def test_the_simplest_that_is_not_significantly_worse() -> None:
    plain, physics = judged(2.0, 3.0, rank=10), judged(1.0, 1.5, rank=20)
    more = judged(0.998, 1.499, rank=30)
    learned = judged(0.3, 2.5, rank=20, learned="network")
    ladder = [plain, physics, more]
    assert [simplest(ladder, use) for use in ("near", "away", "both")] == [1, 1, 1]
    ladder.append(learned)
    assert simplest(ladder, "near") == 3
    assert simplest(ladder, "away") == 1
    # No candidate is as good as the best in both: what carries over is safe.
    assert simplest(ladder, "both") == 1
    assert simplest([*ladder, judged(0.3, 1.5, rank=25)], "both") == 4


def test_without_regions_only_what_is_near_counts() -> None:
    first, second = judged(2.0, rank=10), judged(1.0, rank=20)
    assert simplest([first, second], "away") == 1
    # But what one of them alone could not be tried at is no gain.
    both = judged(1.5, 1.5, rank=10)
    assert [simplest([both, second], use) for use in ("away", "both")] == [0, 0]
    assert not helps(second.sizes, both.sizes, "away")
    assert helps(second.sizes, both.sizes, "near")
    untried = Judged(Candidate("c", (), None, reason="too few"))
    assert simplest([first, untried, second], "both") == 2
