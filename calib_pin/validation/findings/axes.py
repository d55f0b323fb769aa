"""Columns x, y and z that hold other axes: exchanged, negated, a mirrored frame."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import permutations, product

from calib_pin.estimation.terms import FRAME
from calib_pin.measurement_models import declared
from calib_pin.setup import AXES, ReadingSetup
from calib_pin.validation.findings.case import Case
from calib_pin.validation.findings.hypotheses import Hypothesis

MIRRORED = tuple(f"-{axis}" for axis in AXES)
"""All axes negated; every left-handed frame is this one, turned."""


def axes(case: Case) -> Iterator[Hypothesis]:
    """Other axes of positions, as far as measurements can tell them apart.

    Where nothing else shows how the measurement frame is turned, every frame is right
    but a left-handed one.
    """
    data = case.data
    with_axes = [b for b in data.blocks if tuple(declared(b.model).columns)[:3] == AXES]
    if not with_axes:
        return
    terms, free = case.fit.problem.terms, case.fit.problem.parameters.free
    if not any(
        declared(b.model).oriented
        or (b.key in terms and not free[terms[b.key].index[:FRAME]].all())
        for b in with_axes
    ):
        yield _hypothesis(("x", "y", "-z"), LEFT_HANDED)
        return
    for order in permutations(AXES):
        for signs in product(("", "-"), repeat=3):
            held = tuple(s + a for s, a in zip(signs, order, strict=True))
            if held == MIRRORED:
                yield _hypothesis(held, LEFT_HANDED)
            elif held != AXES:
                code = "axes-negated" if order == AXES else "axes-exchanged"
                words = f"the columns x, y and z hold {', '.join(held)}"
                yield _hypothesis(held, (code, words))


LEFT_HANDED = (
    "left-handed-frame",
    "the frame of x, y and z is left-handed (two are exchanged, or one is negated)",
)


def _hypothesis(held: tuple[str, ...], told: tuple[str, str]) -> Hypothesis:
    return Hypothesis(*told, "axes of positions", ReadingSetup(axes=held), gross=True)
