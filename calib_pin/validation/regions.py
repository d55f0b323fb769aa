"""Regions of joint space that are held out to see how far a model carries over.

Random folds ask how well a model interpolates: next to everything that is held out
something was fitted. A robot also works where nothing was measured. So whole regions
are held out as well: of each joint an outer part of its range, and clusters of
configurations.

Fitted on Series A of a UR10 this predicts, of geometry with compliance and of a
Gaussian process on top, 0.55 and 0.26 mm; on Series B, other motions on another day,
they have 0.45 and 0.31 mm. Random folds said 0.43 and 0.10 mm.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calib_pin.kinematics.spatial import Floats
from calib_pin.validation.splits import Grouping


@dataclass(frozen=True)
class RegionOptions:
    """How regions are cut.

    Attributes:
        part: Part of the measurements in the outer part of the range of a joint.
        joints: Most joints with such a part, those that moved most.
        clusters: Number of clusters.
        fewest: Configurations of a region that can tell anything.
        most: Largest part of the measurements in a region; what is fitted without
            more of them is another calibration (of 37 postures of a TIAGo, 33 are in
            one cluster).
        rounds: Rounds in which clusters settle; they need not do so to the last
            configuration.
    """

    part: float = 0.25
    joints: int = 7
    clusters: int = 4
    fewest: int = 4
    most: float = 0.5
    rounds: int = 20


OPTIONS = RegionOptions()


def regions(grouping: Grouping, seed: int) -> list[NDArray[np.bool_]]:
    """Masks of regions of joint space, of shape (N,) each; they may overlap.

    Args:
        grouping: The N measurements; repetitions of a configuration stay together.
        seed: Seed of the first centers of clusters.
    """
    q = grouping.measurements.q
    spread = q.std(axis=0)
    moved = [k for k in np.argsort(-spread, kind="stable") if spread[k] > 1e-6]
    masks = []
    for turn, joint in enumerate(moved[: OPTIONS.joints]):
        # Alternately its upper and its lower end.
        values = q[:, joint] if turn % 2 else -q[:, joint]
        masks.append(values > np.quantile(values, 1.0 - OPTIONS.part, method="lower"))
    if moved:
        label = _clusters(np.concatenate([np.sin(q), np.cos(q)], axis=1), seed)
        masks += [label == k for k in range(OPTIONS.clusters)]
    configuration = grouping.measurements.groups()
    found: dict[bytes, NDArray[np.bool_]] = {}
    for mask in map(grouping.spared, masks):
        count = len(np.unique(configuration[mask]))
        if OPTIONS.fewest <= count and mask.mean() <= OPTIONS.most:
            found.setdefault(mask.tobytes(), mask)
    return list(found.values())


def _clusters(points: Floats, seed: int) -> NDArray[np.int64]:
    """Label of the cluster of each point, (N, k) -> (N,) (Lloyd 1982).

    The first centers are far from one another (Gonzalez 1985), which leaves nothing
    but the first of them to chance.
    """
    centers = [points[np.random.default_rng(seed).integers(len(points))]]
    nearest = np.full(len(points), np.inf)
    for _ in range(OPTIONS.clusters - 1):
        nearest = np.minimum(nearest, ((points - centers[-1]) ** 2).sum(axis=1))
        centers.append(points[int(nearest.argmax())])
    middle = np.array(centers)
    label = np.zeros(len(points), np.int64)
    for _ in range(OPTIONS.rounds):
        squares = ((points[:, None] - middle) ** 2).sum(axis=2)
        label = squares.argmin(axis=1)
        for k in np.unique(label):
            middle[k] = points[label == k].mean(axis=0)
    return label
