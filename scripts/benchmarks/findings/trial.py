"""One job with a defect: what is found, and what comes out if its advice is taken."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import cache, partial
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import yaml

import calib_pin
from benchmarks.criterion import Criterion, Line, at_most, named
from benchmarks.findings.defect import MEASURED, NOISE, Defect, Input, given, job_of
from benchmarks.verdict.jobs import Job, stream
from benchmarks.verdict.truth import Outcome as Judged
from benchmarks.verdict.truth import judged
from calib_pin.cli.files import open_chains, open_rows
from calib_pin.cli.options import OfRobot
from calib_pin.errors import CalibPinError
from calib_pin.estimation.evidence import TRUSTED, Finding
from calib_pin.io.setup import read_setup
from calib_pin.io.urdf import other_robots
from calib_pin.kinematics.spatial import Floats
from calib_pin.observations import Measurements, Observations
from calib_pin.setup import Setup
from calib_pin.validation.findings.sentences import merged
from calib_pin.validation.result import CalibrationResult

SEEDS = 20
"""Jobs of each model and size."""

COSTLY = 2.0
"""Cost, by the noise, from which a defect must be named."""

AS_CLEAN = 1.5
"""Largest true error of a repaired job, by that of the clean one."""


@dataclass(frozen=True)
class Outcome:
    """The outcome of a job with a defect.

    Attributes:
        number: Number of the job.
        cell: Its model and size.
        cost: True error over the workspace that the defect adds, by the noise;
            infinite where it costs the trust.
        named: Whether it was named rightly.
        wrong: Codes of errors and warnings that are not true, or say something wrong.
        verdict: The verdict with the defect.
        repaired: Whether the job was good and right with the setup lines of its
            findings; None where these have none.
        told: What was said, for those who look.
    """

    number: int
    cell: tuple[str, str]
    cost: float
    named: bool
    wrong: tuple[str, ...]
    verdict: str
    repaired: bool | None
    told: tuple[str, ...]

    def __str__(self) -> str:
        """The outcome, line by line."""
        said = "named" if self.named else "not named"
        wrong = f", wrong: {', '.join(self.wrong)}" if self.wrong else ""
        head = f"job {self.number}: {', '.join(self.cell)}: cost {self.cost:.1f}, "
        return "\n    ".join((f"{head}{self.verdict}, {said}{wrong}", *self.told))


def criterion(number: int, defect: Defect) -> Criterion[Outcome]:
    """The criterion of a defect."""
    return Criterion(
        number,
        defect.name.capitalize(),
        SEEDS * len(defect.cells),
        partial(_run, defect),
        partial(_judge, defect.cells),
        least=len(defect.cells),
    )


def calibrated(of: Input) -> CalibrationResult:
    """The result of an input that goes through files."""
    with TemporaryDirectory() as folder:
        asked = OfRobot(robot=of.robot)
        chains = open_chains(asked, of.setup)
        files = written(Path(folder), of.files)
        chains, rows = open_rows(asked, files, chains, of.setup, quiet=True)
        validation = None
        if of.validation:
            paths = written(Path(folder), of.validation)
            _, validation = open_rows(asked, paths, chains, of.setup, quiet=True)
        return calib_pin.calibrate(
            chains,
            rows,
            of.setup,
            validation=validation,
            others=partial(other_robots, chains, of.setup),
        )


def written(
    folder: Path, files: Mapping[str, Measurements | Observations | str]
) -> list[Path]:
    """Files in a folder."""
    for name, content in files.items():
        if isinstance(content, str):
            (folder / name).write_text(content, encoding="utf-8")
        else:
            calib_pin.write_measurements(folder / name, content)
    return [folder / name for name in files]


@cache
def _clean(
    measured: Callable[[Job, np.random.Generator], Measurements], seed: int, model: str
) -> tuple[Measurements, Judged, set[str]]:
    """Measurements without the defect, their outcome, and codes of what is found."""
    job = job_of(seed, model)
    rows = measured(job, stream(seed, 1))
    result = calibrated(given(job, rows))
    return rows, judged(job, result), {f.code for f in result.findings}


def _run(defect: Defect, number: int) -> Outcome:
    seed, turn = divmod(number, len(defect.cells))
    model, size = defect.cells[turn]
    job = job_of(seed, model)
    rows, clean, usual = _clean(defect.measured, seed, model)
    value = defect.sizes[size]
    spoiled = defect.spoil(job, rows, stream(seed, 3), value)
    cost, verdict = np.inf, "refused"
    try:
        result = calibrated(spoiled)
    except CalibPinError as error:
        findings: tuple[Finding, ...] = (Finding("refused", "error", str(error)),)
    else:
        findings, verdict = result.findings, result.verdict
        # A result that must not be used has cost the whole calibration.
        if verdict in TRUSTED or clean.verdict not in TRUSTED:
            actual = judged_by_file(job, spoiled, result).actual
            cost = np.sqrt(max(actual**2 - clean.actual**2, 0.0)) / NOISE
    if defect.cost is not None:
        cost = defect.cost(job, value)
    known = {*defect.codes, *defect.also, *usual}
    naming = [f for f in findings if f.code in defect.codes]
    wrong = [f.code for f in findings if f.code not in known and f.severity != "info"]
    wrong += [f"{f.code}!" for f in naming if not spoiled.right(f)]
    said = [f"{f.severity} {f.code}: {f.message}; {f.remedy}" for f in findings]
    repaired = None
    if any(f.setup for f in findings):
        repaired, more = _repaired(job, spoiled, findings, clean)
        said.append(more)
    return Outcome(
        number,
        (model, size),
        float(cost),
        any(map(spoiled.right, naming)),
        tuple(dict.fromkeys(wrong)),
        verdict,
        repaired,
        tuple(said),
    )


def judged_by_file(job: Job, spoiled: Input, result: CalibrationResult) -> Judged:
    """The outcome of a job whose joint columns may hold something else."""
    try:
        return judged(job, result, read=partial(_positions, job, spoiled))
    except ValueError:
        # Another robot does not have the joints.
        return Judged(job.number, "", "", (), result.verdict, result.reason, np.inf)


def _positions(job: Job, spoiled: Input, q: Floats) -> Floats:
    """Positions of the URDF's joints by the file at true joint positions, (N, n).

    Where another reading of the file moves the robot in the same way, it is as right.
    """
    names, joints = job.chain.joints, spoiled.setup.joints
    columns = dict(zip(names, spoiled.columns(q).T, strict=True))
    result = dict(columns)
    columns |= {f"{MEASURED}{joint}": q[:, j] for j, joint in enumerate(names)}
    for name, stated in joints.items():
        coupled = sum(part * columns[other] for other, part in stated.coupled.items())
        factor = stated.sign * stated.gear
        result[stated.joint] = factor * (columns[name] + coupled) + stated.offset
    return np.stack([result[name] for name in names], axis=1)


def _repaired(
    job: Job, spoiled: Input, findings: Sequence[Finding], clean: Judged
) -> tuple[bool, str]:
    """Whether a job is good and right with the lines of its findings."""
    try:
        for finding in findings:
            spoiled = replace(spoiled, setup=stated(spoiled.setup, finding))
        result = calibrated(spoiled)
    except CalibPinError as error:
        return False, f"repaired: refused: {error}"
    found = judged_by_file(job, spoiled, result)
    right = found.actual <= max(AS_CLEAN * clean.actual, 2.0 * found.predicted)
    codes = ", ".join(f.code for f in result.findings if f.severity != "info")
    said = (
        f"repaired: {found.verdict}, off by {1e3 * found.actual:.3f} mm, predicted "
        f"{1e3 * found.predicted:.3f} mm, clean {1e3 * clean.actual:.3f} mm {codes}"
    )
    return found.verdict == "good" and right, said


def stated(setup: Setup, finding: Finding) -> Setup:
    """A setup to which the lines of a finding were added."""
    with TemporaryDirectory() as folder:
        path = Path(folder) / "setup.yaml"
        path.write_text(yaml.safe_dump(dict(finding.setup)), encoding="utf-8")
        lines = read_setup(path)
    plain = Setup()
    changed = {
        key.name: getattr(lines, key.name)
        for key in fields(Setup)
        if key.compare and getattr(lines, key.name) != getattr(plain, key.name)
    }
    if "reading" in changed:
        changed["reading"] = merged((setup.reading, lines.reading))
    if "joints" in changed:
        anew = {given.joint for given in lines.joints.values()}
        kept = {c: m for c, m in setup.joints.items() if m.joint not in anew}
        changed["joints"] = kept | dict(lines.joints)
    return replace(setup, **changed)


def _judge(
    cells: Sequence[tuple[str, str]], found: Sequence[Outcome]
) -> Iterator[Line]:
    """A line for each model and size, and the shares of those that cost something."""
    for model, size in sorted(cells):
        some = [o for o in found if o.cell == (model, size)]
        if some:
            yield Line(f"{model:<17} {size:<12}", _row(some))
    costly = [o for o in found if o.cost > COSTLY]
    right = [o.number for o in costly if o.named]
    text = f"named rightly, of a cost above {COSTLY:g} noise"
    yield _least(text, right, costly)
    wrong = [o.number for o in found if o.wrong]
    yield at_most("a wrong name", wrong, len(found), 2.0)
    repairable = [o for o in costly if o.named and o.repaired is not None]
    repaired = [o.number for o in repairable if o.repaired]
    yield _least("good and right with the setup lines", repaired, repairable)


def _least(text: str, right: Sequence[int], of: Sequence[Outcome]) -> Line:
    """A share that must be large, and the jobs that are missing."""
    line = at_most(text, right, len(of), 95.0, least=True)
    left = [o.number for o in of if o.number not in right]
    return replace(line, figure=f"{line.figure}, not {named(left)}") if left else line


def _row(some: Sequence[Outcome]) -> str:
    """Cost, named, wrong, silent and repaired of the jobs of a model and size."""
    silent = sum(not o.named and not o.wrong for o in some)
    lines = [o.repaired for o in some if o.named and o.repaired is not None]
    wrong = sorted({code for o in some for code in o.wrong})
    shown = (
        f"cost {np.median([o.cost for o in some]):9.1f}, "
        f"named {sum(o.named for o in some):2} of {len(some)}, "
        f"wrong {sum(bool(o.wrong) for o in some)}, silent {silent}, "
        f"repaired {sum(map(bool, lines))} of {len(lines)}"
    )
    return f"{shown} ({', '.join(wrong)})" if wrong else shown
