"""The posture of the robots, and the sliders that show and change it."""

from __future__ import annotations

import math

import numpy as np

from calib_pin.kinematics.spatial import Floats
from calib_pin.viewer.controls import Controls, put
from calib_pin.viewer.scene import Scene
from calib_pin.viewer.stage import Stage

LAST = 1e9
"""Place of the sliders in the panel: there may be many."""


class Joints:
    """A slider for every joint, in degrees or millimeters.

    Args:
        controls: The window's controls.
        scene: What is drawn.
        stage: Where it is drawn.

    Attributes:
        mover: What has moved the robots last; None for a person at these sliders.
    """

    def __init__(self, controls: Controls, scene: Scene, stage: Stage) -> None:
        """Add the sliders and take the first posture."""
        skeleton = scene.bodies[0].skeleton
        self._stage, self._places = stage, scene.places
        self._q, self._payload = scene.start, ""
        self._factors = np.where(skeleton.revolute, 180.0 / math.pi, 1e3)
        self.mover: object | None = None
        lower, upper = (self._factors * end for end in _range(scene))
        units = ["" if turns else " [mm]" for turns in skeleton.revolute]
        alone = scene.rows is None and scene.plan is None
        with controls.gui.add_folder(
            "Joints [deg]", order=LAST, expand_by_default=alone
        ):
            self._sliders = [
                controls.gui.add_slider(
                    name + units[k],
                    math.floor(lower[k]),
                    math.ceil(upper[k]),
                    0.1,
                    self._displayed(k),
                )
                for k, name in enumerate(skeleton.joints)
            ]
        for slider in self._sliders:
            controls.on(slider, lambda _: self._read())
        stage.pose(self._q, self._payload)

    def move(self, q: Floats, payload: str, mover: object) -> None:
        """Move the chain; other joints stay where they are.

        Args:
            q: Positions of the chain's joints, shape (n,) [rad, m].
            payload: Name of what the robot carries.
            mover: Who asks for it.
        """
        self._q[self._places] = q
        self._payload, self.mover = payload, mover
        self._stage.pose(self._q, payload)
        for place in self._places:
            put(self._sliders[place], self._displayed(place))

    def _displayed(self, place: int) -> float:
        return round(float(self._factors[place] * self._q[place]), 2)

    def _read(self) -> None:
        values = np.array([slider.value for slider in self._sliders])
        self._q, self.mover = values / self._factors, None
        self._stage.pose(self._q, self._payload)


def _range(scene: Scene) -> tuple[Floats, Floats]:
    """Limits of all joints: those of the URDF, and what was measured or planned."""
    skeleton, places = scene.bodies[0].skeleton, scene.places
    lower, upper = skeleton.lower.copy(), skeleton.upper.copy()
    shown = [] if scene.rows is None else [scene.rows.data.q]
    shown += [] if scene.plan is None else [scene.plan.q]
    for q in shown:
        lower[places] = np.minimum(lower[places], q.min(axis=0))
        upper[places] = np.maximum(upper[places], q.max(axis=0))
    return lower, upper
