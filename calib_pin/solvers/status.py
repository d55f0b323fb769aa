"""Outcomes of a solver."""

from __future__ import annotations

from enum import Enum


class Status(Enum):
    """Outcome of a solver: a word, and a sentence of advice."""

    CONVERGED = "converged"
    TARGET = "cost target reached"
    ITERATIONS = "iteration limit"
    GENERATIONS = "generation limit"
    COLLAPSED = "collapsed"
    STALLED = "stalled"
    STOPPED = "stopped"
    NOT_FINITE = "not finite"

    @property
    def success(self) -> bool:
        """Whether the solution is a minimum, or good enough by the user's own word."""
        return self in (Status.CONVERGED, Status.TARGET)

    @property
    def advice(self) -> str:
        """The meaning of the outcome, with advice."""
        return {
            Status.CONVERGED: "the solver converged",
            Status.TARGET: "the cost fell below the target",
            Status.ITERATIONS: (
                "the solver did not converge within the iterations allowed; allow more "
                "or start closer, in a fit check units, joint signs and frames, and "
                "whether the measurements tell all that is estimated"
            ),
            Status.GENERATIONS: (
                "the search ended at its generation limit before it reached a minimum; "
                "allow more generations, or in a fit let Gauss-Newton finish it with "
                "the solver 'hybrid'"
            ),
            Status.COLLAPSED: (
                "the population collapsed before it reached a minimum; take more "
                "members or a larger mutation factor, or let Gauss-Newton finish it "
                "with the solver 'hybrid'"
            ),
            Status.STALLED: (
                "no step improves the cost although it is not at a minimum; check the "
                "derivatives, in a fit check for measurements near a singularity of "
                "the measurement model"
            ),
            Status.STOPPED: (
                "the callback stopped the search before it reached a minimum; let it "
                "run to its end for a better result"
            ),
            Status.NOT_FINITE: (
                "the cost or its derivative is not a finite number; check the first "
                "guess, in a fit the frames, in a search whether anything is feasible"
            ),
        }[self]
