"""Simple solids, and surfaces of fewer triangles."""

from __future__ import annotations

import numpy as np
import pytest

from calib_pin.kinematics.shapes import (
    Surface,
    ball,
    box,
    capsule,
    cylinder,
    simplified,
)


def volume(surface: Surface) -> float:
    """By the divergence theorem; negative for a surface that is inside out."""
    a, b, c = np.moveaxis(surface.vertices[surface.triangles], 1, 0)
    return float(np.einsum("ij,ij->i", a, np.cross(b, c)).sum() / 6.0)


@pytest.mark.parametrize(
    ("surface", "size", "content", "within"),
    [
        (box(np.array([1.0, 2.0, 3.0])), (1, 2, 3), 6.0, 1e-12),
        (cylinder(0.5, 2.0), (1, 1, 2), np.pi / 2, 0.02),
        (ball(0.5), (1, 1, 1), np.pi / 6, 0.03),
        (capsule(0.5, 1.0), (1, 1, 2), np.pi / 4 + np.pi / 6, 0.03),
    ],
)
def test_solids(
    surface: Surface, size: tuple[float, ...], content: float, within: float
) -> None:
    assert np.ptp(surface.vertices, axis=0) == pytest.approx(size, rel=0.01)
    assert surface.vertices.mean(axis=0) == pytest.approx([0, 0, 0], abs=1e-9)
    assert volume(surface) == pytest.approx(content, rel=within)


def test_a_simplified_surface_is_where_it_was_with_fewer_triangles() -> None:
    fine = ball(0.5)
    coarse = simplified(fine, 0.12)
    assert 50 < len(coarse.triangles) < 0.6 * len(fine.triangles)
    sizes = np.linalg.norm(coarse.vertices, axis=1)
    assert sizes.max() <= 0.5 and sizes.min() > 0.5 - 0.12 * np.sqrt(3.0)
    assert volume(coarse) == pytest.approx(volume(fine), rel=0.12)
    same = simplified(fine, 1e-4)
    assert volume(same) == pytest.approx(volume(fine))
