"""Sliders that show and change the posture of the robots, and a plan played."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from calib_pin.kinematics.spatial import Floats
from calib_pin.viewer.controls import Controls, put
from calib_pin.viewer.scene import Plan, Scene
from calib_pin.viewer.stage import Stage

if TYPE_CHECKING:
    import viser

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


class Player:
    """Controls of a plan.

    Args:
        controls: The window's controls.
        plan: The configurations.
        joints: What moves the robots.
        path: The path of the tip.
    """

    def __init__(
        self,
        controls: Controls,
        plan: Plan,
        joints: Joints,
        path: viser.LineSegmentsHandle,
    ) -> None:
        """Add the controls; nothing is played yet."""
        self._lock, self._plan, self._joints = controls.lock, plan, joints
        self._number, self._playing = 0.0, False
        count = len(plan.q)
        with controls.gui.add_folder("Plan"):
            self._slider = controls.gui.add_slider("number", 1, max(count, 2), 1, 1)
            self._button = controls.gui.add_button("play", disabled=count < 2)
            self._speed = controls.gui.add_slider("per second", 0.1, 5.0, 0.1, 1.0)
            controls.switch("path of the tip", path)
        controls.on(self._slider, lambda value: self._show(min(value, count) - 1.0))
        self._button.on_click(lambda _: self.play(not self._playing))

    def play(self, playing: bool) -> None:
        """Go on from where it stands, or pause."""
        with self._lock:
            self._playing = playing
            self._button.label = "pause" if playing else "play"
            if playing:
                self._show(self._number)

    def tick(self, seconds: float) -> None:
        """Go on while the plan is played; from its end it begins again.

        Args:
            seconds: Time since the last tick [s].
        """
        if not self._playing:
            return
        with self._lock:
            if self._joints.mover is not self:  # Somebody looks at something else.
                self.play(False)
                return
            number = self._number + seconds * self._speed.value
            self._show(number if number <= len(self._plan.q) - 1 else 0.0)
            put(self._slider, int(self._number) + 1)

    def _show(self, number: float) -> None:
        self._number = number
        self._joints.move(self._plan.at(number), "", self)
