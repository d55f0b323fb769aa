"""Solids in perspective: where they are seen, what hides what, light and shadow."""

from __future__ import annotations

import numpy as np
import pytest

from calib_pin.kinematics.shapes import ball, box, cylinder
from calib_pin.report.figures.raster import (
    Solid,
    View,
    balls,
    outlines,
    picture,
    shadow,
    shrunk,
    widened,
)

CORNERS = box(np.array([1.0, 1.0, 1.0])).vertices
ROOM = np.array([200.0, 160.0])
RED, BLUE = (0.9, 0.1, 0.1), (0.1, 0.1, 0.9)


def at(x: float, y: float, z: float) -> np.ndarray:
    pose = np.eye(4)
    pose[:3, 3] = x, y, z
    return pose


@pytest.mark.parametrize("azimuth", [-2.0, 0.0, 0.7])
def test_a_view_has_all_points_and_no_room_around(azimuth: float) -> None:
    view = View.of(CORNERS, azimuth, 0.4, ROOM)
    spots, depths = view.project(CORNERS)
    assert spots.min(axis=0) == pytest.approx([0.0, 0.0], abs=1e-9)
    size = spots.max(axis=0)
    assert (size <= ROOM + 1e-9).all() and (size / ROOM).max() == pytest.approx(1.0)
    assert np.ceil(size - 1e-9).tolist() == [*view.size]
    assert depths.min() > 0.0
    np.testing.assert_allclose(view.axes @ view.axes.T, np.eye(3), atol=1e-12)
    # Up is up.
    low, high = view.project(np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 0.1]]))[0]
    assert high[1] < low[1] and high[0] == pytest.approx(low[0])
    double = view.scaled(2.0)
    np.testing.assert_allclose(double.project(CORNERS)[0], 2.0 * spots)


def test_near_solids_hide_those_behind() -> None:
    view = View.of(CORNERS, 0.0, 0.0, ROOM)
    far = Solid(box(np.array([0.01, 0.8, 0.8])), at(-0.4, 0.0, 0.0), RED)
    near = Solid(box(np.array([0.01, 0.4, 0.4])), at(0.4, 0.0, 0.0), BLUE)
    x, y = view.project(np.zeros(3))[0].astype(int)
    for solids in ([far, near], [near, far]):
        seen = picture(view, solids)
        assert seen.color[y, x].argmax() == 2
        depth = view.eye[0] - 0.405
        assert seen.nearness[y, x] == pytest.approx(1.0 / depth, rel=1e-6)
        reds = (seen.color.argmax(axis=2) == 0) & (seen.nearness > 0.0)
        assert 0.5 < reds.sum() / (seen.nearness > 0.0).sum() < 0.8
        rim = outlines(seen)
        assert rim.any() and not rim[y, x] and not rim[seen.nearness == 0.0].any()


def test_surfaces_are_lit_from_above_whatever_way_they_face() -> None:
    view = View.of(CORNERS, 0.3, 0.5, ROOM)
    solid = ball(0.4)
    found = [picture(view, [Solid(solid, at(0.0, 0.0, 0.0), (0.5, 0.5, 0.5))])]
    flipped = type(solid)(solid.vertices, solid.triangles[:, ::-1])
    found.append(picture(view, [Solid(flipped, at(0.0, 0.0, 0.0), (0.5, 0.5, 0.5))]))
    np.testing.assert_allclose(found[0].color, found[1].color, atol=0.02)
    x, y = view.project(np.zeros(3))[0].astype(int)
    radius = int(0.3 * view.focal / np.linalg.norm(view.eye))
    light = found[0].color[..., 0]
    assert light[y - radius, x] > 1.15 * light[y + radius, x]
    assert light.max() <= 1.0 and light[found[0].nearness > 0.0].min() > 0.1


def test_smooth_surfaces_have_no_facets_and_sharp_ones_keep_their_edges() -> None:
    view = View.of(CORNERS, 0.0, 0.5, ROOM)
    solid = Solid(cylinder(0.4, 0.8), at(0.0, 0.0, 0.0), (0.7, 0.7, 0.7))
    light = picture(view, [solid]).color[..., 0].astype(float)
    x, y = view.project(np.array([0.0, 0.0, 0.0]))[0].astype(int)
    around = light[y, x - 40 : x + 40]
    assert np.abs(np.diff(around)).max() < 0.03
    top = view.project(np.array([0.4, 0.0, 0.4]))[0].astype(int)[1]
    assert abs(light[top - 4, x] - light[top + 4, x]) > 0.05


def test_balls_in_front_and_behind() -> None:
    view = View.of(CORNERS, 0.0, 0.0, ROOM)
    wall = picture(view, [Solid(box(np.array([0.01, 0.5, 0.9])), at(0, 0, 0), RED)])
    points = np.array([[0.4, 0.0, 0.2], [-0.4, 0.0, -0.2], [0.0, 0.4, 0.0]])
    colors = np.array([[0.1, 0.8, 0.1], [0.1, 0.1, 0.8], [0.8, 0.8, 0.1]])
    pixels, lit, hidden = balls(view, wall, points, 0.05, colors)
    assert len(np.unique(pixels)) == len(pixels) == len(lit) == len(hidden)
    spots, depths = view.project(points)
    for k, behind in enumerate((False, True, False)):
        middle = int(spots[k, 1]) * view.size[0] + int(spots[k, 0])
        (place,) = np.flatnonzero(pixels == middle)
        assert hidden[place] == behind
        assert lit[place].argmax() == (1, 2, 0)[k]
    area = np.pi * (view.focal * 0.05 / depths) ** 2
    assert len(pixels) == pytest.approx(area.sum(), rel=0.05)


def test_the_shadow_falls_on_the_floor() -> None:
    frame = np.concatenate([CORNERS, CORNERS * [3.0, 3.0, 1.0]])
    view = View.of(frame, 0.3, 0.6, ROOM)
    solids = [Solid(box(np.array([0.4, 0.4, 0.02])), at(0.0, 0.0, -0.49), RED)]
    dark = shadow(view, solids, -0.5)
    x, y = view.project(np.array([0.0, 0.0, -0.5]))[0].astype(int)
    assert dark[y, x] == pytest.approx(1.0, abs=0.02) and dark.max() <= 1.0 + 1e-9
    assert not dark[0].any() and not dark[:, -1].any()


def test_images_shrink_and_grow() -> None:
    image = np.arange(24.0).reshape(4, 6)
    small = shrunk(image, 2)
    np.testing.assert_allclose(small, [[3.5, 5.5, 7.5], [15.5, 17.5, 19.5]])
    np.testing.assert_allclose(shrunk(widened(small, 2), 2), small)
