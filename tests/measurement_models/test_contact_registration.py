"""Closed forms for what a tool touches where they fail; each model tests its own."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

from calib_pin.kinematics.spatial import Floats
from calib_pin.measurement_models.contact_registration import (
    register_distances,
    register_relative_distances,
    register_sockets,
    register_touched_plane,
)

NAN = np.full(3, np.nan)


def poses(sites: Floats, point: Floats, rng: np.random.Generator) -> Floats:
    """Poses of a tip whose point is at places, turned at random."""
    turns = [pin.exp3(rng.normal(size=3)) for _ in sites]
    return np.array(
        [
            pin.SE3(R, p - R @ point).homogeneous
            for R, p in zip(turns, sites, strict=True)
        ]
    )


def on_plane(
    normal: Floats, offset: float, count: int, rng: np.random.Generator
) -> Floats:
    p = rng.uniform(-1.0, 1.0, (count, 3))
    return np.asarray(p - np.outer(p @ normal + offset, normal))


def unit(rng: np.random.Generator) -> Floats:
    e = rng.normal(size=3)
    return np.asarray(e / np.linalg.norm(e))


def test_few_rows_leave_the_point_at_the_tip() -> None:
    """Linear equations need twelve contacts, and ways that turn."""
    rng = np.random.default_rng(4)
    for count in (3, 11):
        F = poses(on_plane(unit(rng), -0.5, count, rng), np.full(3, 0.1), rng)
        plane = register_touched_plane(F, None)
        np.testing.assert_array_equal(plane.point, 0.0)
        assert np.linalg.norm(plane.site) == pytest.approx(1.0)
    F = poses(rng.uniform(-1, 1, (9, 3)), np.full(3, 0.1), rng)
    for distances in (None, np.full(9, 1.0)):
        found = register_distances(F, distances, None)
        np.testing.assert_array_equal(found.point, 0.0)
        assert np.isfinite(found.site).all() and np.isfinite(found.size)
    F = np.tile(np.eye(4), (20, 1, 1))
    F[:, :3, 3] = rng.normal(size=(20, 3))
    d = np.linalg.norm(F[:, :3, 3], axis=1)
    np.testing.assert_allclose(register_relative_distances(F, d), 0.0, atol=1e-12)
    np.testing.assert_array_equal(register_relative_distances(F[:8], d[:8]), 0.0)


def test_what_no_row_tells_stays_unknown() -> None:
    rng = np.random.default_rng(1)
    c, t = np.array([0.3, 0.1, 0.5]), np.array([0.0, 0.1, 0.2])
    F, nothing = poses(np.tile(c, (6, 1)), t, rng), np.tile(NAN, (2, 1))
    points, sockets = register_sockets(
        F, nothing, np.ones(6, int), nothing, np.zeros(6, int)
    )
    np.testing.assert_allclose(points[1], t, atol=1e-11)
    np.testing.assert_allclose(sockets[0], c, atol=1e-11)
    assert np.isnan(points[0]).all() and np.isnan(sockets[1]).all()
    # One pose is explained by a solution without large levers.
    one = np.zeros(1, int)
    (t,), (c,) = register_sockets(F[:1], NAN[None], one, NAN[None], one)
    gap = F[0, :3, :3] @ t + F[0, :3, 3] - c
    np.testing.assert_allclose(gap, 0.0, atol=1e-12)
    assert np.abs(t).max() < 0.6
