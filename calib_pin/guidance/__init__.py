"""A job that is guided while it is measured."""

from calib_pin.guidance.events import Event as Event
from calib_pin.guidance.watch import Watch as Watch
