"""The standard deviations that a plan will give the parameters."""

from __future__ import annotations

import numpy as np

from calib_pin.planning.plan import Plan
from calib_pin.report.figures.canvas import AFTER, Drawn, marks
from calib_pin.report.figures.estimated import of_robot
from calib_pin.report.figures.labels import log_axis, log_limits
from calib_pin.report.figures.lists import Listed, lists


def predicted_deviations(plan: Plan) -> Drawn | None:
    """Predicted standard deviations of the estimates, one panel per unit."""
    estimates = of_robot(plan.parameters, plan.groups, plan.problem.error)
    estimates = [estimate for estimate in estimates if estimate.sigma > 0.0]
    if not estimates:
        return None
    figure, panels, remark = lists(estimates, lambda estimate: estimate.sigma)
    for listed in panels:
        _deviations(listed)
    weak = sum(p.status == "weak" for p in plan.parameters)
    told = f" {weak} weakly observable parameters are not shown." if weak else ""
    return Drawn(
        "predicted-deviations",
        "Predicted standard deviations",
        "Standard deviations that the parameters and combinations will have, from base "
        "to tip. Those far to the right benefit most from further measurements."
        f"{told}{remark}",
        figure,
    )


def _deviations(listed: Listed) -> None:
    axes, lines = listed.axes, np.arange(len(listed.sigmas))
    limits = log_limits(listed.sigmas)
    assert limits is not None, "only drawn where something is positive"
    axes.plot(listed.sigmas, lines, **marks(AFTER, "o", 5.0))
    log_axis(axes, "x", limits)
    axes.set_xlabel(f"standard deviation [{listed.unit}]")
