"""Planned configurations, played in their order."""

from __future__ import annotations

from typing import TYPE_CHECKING

from calib_pin.viewer.controls import Controls, put
from calib_pin.viewer.joints import Joints
from calib_pin.viewer.scene import Plan

if TYPE_CHECKING:
    import viser


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
