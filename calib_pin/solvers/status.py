"""How a solver can end."""

from __future__ import annotations

from enum import Enum

__all__ = ["Status"]


class Status(Enum):
    """How a solver ended: a word, and a sentence of advice."""

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
        """What it means and what to do about it."""
        return {
            Status.CONVERGED: "The fit converged.",
            Status.TARGET: "The cost fell below the target.",
            Status.ITERATIONS: (
                "The fit did not converge within the iterations allowed; check units, "
                "joint signs and frames, or start closer with a first guess."
            ),
            Status.GENERATIONS: (
                "The evolution ended at its generation limit before it reached a "
                "minimum; allow more generations or let Gauss-Newton finish it with "
                "the solver 'hybrid'."
            ),
            Status.COLLAPSED: (
                "The population collapsed before it reached a minimum; take more "
                "members or a larger mutation factor, or let Gauss-Newton finish it "
                "with the solver 'hybrid'."
            ),
            Status.STALLED: (
                "No step improves the fit although it is not at a minimum; check for "
                "measurements near a singularity of the measurement model."
            ),
            Status.STOPPED: (
                "The callback stopped the evolution before it reached a minimum; let "
                "it run to its end for a better fit."
            ),
            Status.NOT_FINITE: (
                "The residual is not a finite number at the start; check the frames "
                "and the first guess."
            ),
        }[self]
