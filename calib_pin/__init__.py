"""Robot calibration on Pinocchio.

Five lines from a URDF and a file of measurements to a corrected URDF:

    chain = calib_pin.load_chain("arm.urdf", tip="tool0")
    rows = calib_pin.read_measurements("tracker.csv", chain)
    result = calib_pin.calibrate(chain, rows)
    print(calib_pin.format_report(result))
    calib_pin.write_urdf(result.geometry, "arm_calibrated.urdf")

Lengths are in meters, angles in radians, twists in the order (linear, angular).
"""

from __future__ import annotations

from importlib import import_module
from types import FunctionType
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from calib_pin.calibration import calibrate as calibrate
    from calib_pin.control.compensation import compensate as compensate
    from calib_pin.errors import CalibPinError as CalibPinError
    from calib_pin.io.collision import load_collisions as load_collisions
    from calib_pin.io.measurements import read_measurements as read_measurements
    from calib_pin.io.measurements import write_measurements as write_measurements
    from calib_pin.io.results import read_calibration as read_calibration
    from calib_pin.io.results import read_result as read_result
    from calib_pin.io.results import write_urdf as write_urdf
    from calib_pin.io.setup import read_setup as read_setup
    from calib_pin.io.urdf import load_chain as load_chain
    from calib_pin.io.urdf import load_chains as load_chains
    from calib_pin.io.urdf import robot_file as robot_file
    from calib_pin.kinematics.chain import Chain as Chain
    from calib_pin.observations.blocks import Observations as Observations
    from calib_pin.observations.conditions import Conditions as Conditions
    from calib_pin.observations.measurements import Measurements as Measurements
    from calib_pin.planning.plan import plan as plan
    from calib_pin.plugins import register as register
    from calib_pin.report.folder import write_result as write_result
    from calib_pin.report.html import report as report
    from calib_pin.report.text import format_report as format_report
    from calib_pin.setup import Setup as Setup
    from calib_pin.simulation import draw_errors as draw_errors
    from calib_pin.simulation import simulate as simulate
    from calib_pin.validation.assessment import identify as identify
    from calib_pin.validation.comparison import compare as compare
    from calib_pin.validation.evaluation import evaluate as evaluate
    from calib_pin.validation.result import CalibrationResult as CalibrationResult

__version__ = "0.2.0"

_HOMES = {
    "CalibPinError": "errors",
    "CalibrationResult": "validation.result",
    "Chain": "kinematics.chain",
    "Conditions": "observations.conditions",
    "Measurements": "observations.measurements",
    "Observations": "observations.blocks",
    "Setup": "setup",
    "calibrate": "calibration",
    "compare": "validation.comparison",
    "compensate": "control.compensation",
    "draw_errors": "simulation",
    "evaluate": "validation.evaluation",
    "format_report": "report.text",
    "identify": "validation.assessment",
    "load_chain": "io.urdf",
    "load_chains": "io.urdf",
    "load_collisions": "io.collision",
    "plan": "planning.plan",
    "read_calibration": "io.results",
    "read_measurements": "io.measurements",
    "read_result": "io.results",
    "read_setup": "io.setup",
    "register": "plugins",
    "report": "report.html",
    "robot_file": "io.urdf",
    "simulate": "simulation",
    "write_measurements": "io.measurements",
    "write_result": "report.folder",
    "write_urdf": "io.results",
}
"""Where each public name lives; imported when it is first used."""

__all__ = sorted(_HOMES)


def __getattr__(name: str) -> Any:
    """Import a public name on first use: Pinocchio alone takes a second to load."""
    if name not in _HOMES:
        raise AttributeError(f"module 'calib_pin' has no attribute '{name}'")
    value = getattr(import_module(f"calib_pin.{_HOMES[name]}"), name)
    if isinstance(value, FunctionType):
        from calib_pin.setup.arguments import public

        value = public(value)
        value.__module__ = __name__  # Under this name it is pickled.
    return globals().setdefault(name, value)


def __dir__() -> list[str]:
    return __all__
