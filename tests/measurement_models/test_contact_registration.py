"""Closed forms for what a tool touches: exact, and sane where they fail."""

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

TRIALS = 4
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


# Sockets.


@pytest.mark.parametrize("known", ["nothing", "points", "sockets", "some"])
def test_sockets_are_exact(known: str) -> None:
    rng = np.random.default_rng(0)
    for _ in range(TRIALS):
        t, c = rng.uniform(-0.2, 0.2, (2, 3)), rng.uniform(-1, 1, (3, 3))
        label, socket = np.arange(12) % 2, np.arange(12) % 3
        F = np.concatenate(
            [poses(c[k][None], t[j], rng) for j, k in zip(label, socket, strict=True)]
        )
        given_t, given_c = np.tile(NAN, (2, 1)), np.tile(NAN, (3, 1))
        if known in ("points", "some"):
            given_t[0] = t[0]
        if known == "points":
            given_t[1] = t[1]
        if known == "sockets":
            given_c[:] = c
        if known == "some":
            given_c[2] = c[2]
        kept = given_t.copy(), given_c.copy()
        found_t, found_c = register_sockets(F, given_t, label, given_c, socket)
        np.testing.assert_allclose(found_t, t, atol=1e-11)
        np.testing.assert_allclose(found_c, c, atol=1e-11)
        for one, other in zip((given_t, given_c), kept, strict=True):
            np.testing.assert_array_equal(one, other)


# Planes.


@pytest.mark.parametrize("known", [False, True])
def test_planes_are_exact(known: bool) -> None:
    rng = np.random.default_rng(3)
    for trial in range(TRIALS):
        n, f, t = unit(rng), -rng.uniform(0.1, 2.0), rng.uniform(-0.3, 0.3, 3)
        n = np.eye(3)[trial] if trial < 3 else n
        count = (12, 13, 40)[trial % 3] if not known else 3 + trial
        F = poses(on_plane(n, f, count, rng), t, rng)
        found = register_touched_plane(F, t if known else None)
        np.testing.assert_allclose(found.point, t, atol=1e-9)
        np.testing.assert_allclose(found.site, n, atol=1e-9)
        assert found.size == pytest.approx(f, abs=1e-9)


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


# Distances and spheres.


@pytest.mark.parametrize("known", [False, True])
@pytest.mark.parametrize("bias", [None, 0.03])
def test_anchors_are_exact(bias: float | None, known: bool) -> None:
    rng = np.random.default_rng(6)
    for trial in range(TRIALS):
        a, t = rng.uniform(-2, 2, 3), rng.uniform(-0.3, 0.3, 3)
        sites = rng.uniform(-1, 1, (17 + trial if not known else 5 + trial, 3))
        F = poses(sites, t, rng)
        d = np.linalg.norm(sites - a, axis=1) + 0.03
        found = register_distances(F, d, t if known else None, bias)
        np.testing.assert_allclose(found.point, t, atol=1e-8)
        np.testing.assert_allclose(found.site, a, atol=1e-8)
        assert found.size == pytest.approx(0.03, abs=1e-8)


@pytest.mark.parametrize("known", [False, True])
@pytest.mark.parametrize("stated", [False, True])
def test_spheres_are_exact(stated: bool, known: bool) -> None:
    """With the radius unknown, or as distances that are all the same."""
    rng = np.random.default_rng(7)
    for trial in range(TRIALS):
        c, t = rng.uniform(-1, 1, 3), rng.uniform(-0.3, 0.3, 3)
        r = rng.uniform(0.05, 0.5)
        sites = c + r * np.array([unit(rng) for _ in range(20 + trial)])
        F = poses(sites, t, rng)
        distances = np.full(len(F), r) if stated else None
        found = register_distances(F, distances, t if known else None)
        np.testing.assert_allclose(found.point, t, atol=1e-9)
        np.testing.assert_allclose(found.site, c, atol=1e-9)
        if not stated:
            assert found.size == pytest.approx(r, abs=1e-9)


# Ways.


@pytest.mark.parametrize("count", [9, 40])
def test_ways_are_exact(count: int) -> None:
    rng = np.random.default_rng(9)
    for _ in range(TRIALS):
        t = rng.uniform(-0.3, 0.3, 3)
        F = np.array([pin.exp6(rng.normal(size=6)).homogeneous for _ in range(count)])
        d = np.linalg.norm(F[:, :3, :3] @ t + F[:, :3, 3] - t, axis=1)
        np.testing.assert_allclose(register_relative_distances(F, d), t, atol=1e-7)


# Noise.
