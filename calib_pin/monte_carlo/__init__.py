"""Monte Carlo: how accurate robots of a type would be after a calibration."""

from calib_pin.monte_carlo.study import Study, Trial, study_of, try_robot
from calib_pin.monte_carlo.summary import Outlook, outlooks

__all__ = ["Outlook", "Study", "Trial", "outlooks", "study_of", "try_robot"]
