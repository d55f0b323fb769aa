"""What others published, or reach, on the same measurements."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Published:
    """An error of another tool on measurements that it has not fitted.

    Attributes:
        data_set: Key of the data set.
        where: `near` or `away`.
        method: What was done.
        statistic: `mean` or `rms`.
        error: The error [mm].
        source: Who says so.
    """

    data_set: str
    where: str
    method: str
    statistic: str
    error: float
    source: str


BESIDE = "run beside ours on the same measurements"
JACOBI = (
    "P. Jacobi, A hybrid error compensation method for enhancing the pose accuracy of "
    "serial industrial robots, thesis, Tsinghua University, 2025"
)
MUKCA = "G. Franzese et al., MUKCa, arXiv:2503.12584, 2025; " + BESIDE
FIGAROH = "FIGAROH 1.0.2, " + BESIDE

PUBLISHED: tuple[Published, ...] = (
    Published("ur10-a", "near", "geometric least squares", "mean", 0.399, BESIDE),
    Published("ur10-a", "near", "geometry, Gaussian process", "mean", 0.169, BESIDE),
    Published("ur5", "near", "geometry, graph network", "mean", 0.1549, JACOBI),
    Published("wam", "near", "geometry, graph network", "mean", 2.9178, JACOBI),
    Published("panda-1", "away", "48 parameters", "mean", 0.619, MUKCA),
    Published("talos", "near", "joint offsets", "rms", 1.62, FIGAROH),
    Published("talos", "near", "full placements", "rms", 0.86, FIGAROH),
    Published("tiago", "away", "joint offsets", "rms", 4.23, FIGAROH),
    Published("tiago", "away", "full placements", "rms", 3.22, FIGAROH),
)


def published(data_set: str, where: str) -> tuple[Published, ...]:
    """What is known of a data set, near or away."""
    return tuple(p for p in PUBLISHED if (p.data_set, p.where) == (data_set, where))
