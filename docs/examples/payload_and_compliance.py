"""Payload and compliance: a heavy robot that gives under 250 kg."""

from dataclasses import replace

import matplotlib.pyplot as plt
import numpy as np

import calib_pin
from calib_pin.estimation.formulation import nominal_problem

# A bundled job: three points at 24 configurations, with and without the payload; the
# column `payload` says which, and the setup file what it weighs.
chain = calib_pin.load_chain("heavy6")
setup = calib_pin.read_setup(calib_pin.robot_file("heavy6", "setup.yaml"))
file = calib_pin.robot_file("heavy6", "measurements.csv")
measurements = calib_pin.read_measurements(file, chain)


def calibrated(*parameters: str) -> calib_pin.CalibrationResult:
    """The calibration with some families of errors."""
    stated = replace(setup, parameters=parameters)
    return calib_pin.calibrate(chain, measurements, stated)


geometry = calibrated("placement")
springs = calibrated("placement", "compliance")
for name, result in (("geometry alone", geometry), ("with compliance", springs)):
    error = result.errors[0].validation_after or result.errors[0].after
    print(f"{name}: {1e3 * error.rms:.3f} mm rms, held out")

compliances = {
    found.name.split(".")[0]: (found.value, found.sigma)
    for found in springs.parameters
    if ".compliance." in found.name
}
# The truth behind the bundled file, drawn again from its seed (see its README).
expected = nominal_problem(chain, "position", setup).parameters
drawn = calib_pin.draw_errors(expected, np.random.default_rng(40))
names = [parameter.name for parameter in expected]
true = {joint: drawn[names.index(f"{joint}.compliance.k")] for joint in compliances}
for joint, (value, sigma) in compliances.items():
    if sigma is None:
        print(f"{joint}: gravity does not load its vertical axis")
        continue
    told = f"{1e6 * value:.4f} +- {1e6 * sigma:.4f} urad/Nm"
    print(f"{joint}: {told}, {1e6 * true[joint]:.4f} is true")

figure, panels = plt.subplots(1, 2, figsize=(6.8, 3.2), layout="constrained")
assert springs.held_out and geometry.held_out
lengths = {
    "nominal": springs.held_out.before,
    "geometry": geometry.held_out.after,
    "springs too": springs.held_out.after,
}
colors = ("#999999", "#d55e00", "#0072b2")
for (name, residuals), color in zip(lengths.items(), colors, strict=True):
    sizes = np.sort(1e3 * np.linalg.norm(residuals, axis=1))
    share = np.arange(1, len(sizes) + 1) / len(sizes) * 100
    panels[0].semilogx(sizes, share, color=color, label=name)
panels[0].set(xlabel="error, held out [mm]", ylabel="measurements [%]")
panels[0].set(xlim=(1e-4, 20.0), ylim=(0, 101))
panels[0].legend(frameon=False, fontsize=8, loc="upper left", handlelength=1.0)
# One bar for every joint that gravity loads, with 95 % of its uncertainty.
loaded = {joint: both for joint, both in compliances.items() if both[1] is not None}
values, sigmas = 1e6 * np.array(list(loaded.values())).T
panels[1].bar(list(loaded), values, color="#0072b2", alpha=0.7, yerr=2 * sigmas)
truths = [1e6 * true[joint] for joint in loaded]
panels[1].plot(list(loaded), truths, "_", color="black", markersize=18, label="truth")
panels[1].tick_params(axis="x", rotation=30)
panels[1].set(ylabel="compliance [urad/Nm]")
panels[1].legend(frameon=False, fontsize=8, loc="upper left")
figure.savefig("payload_and_compliance.png", dpi=110)
