"""Payload and compliance: a heavy robot that gives under 250 kg."""

from dataclasses import replace

import matplotlib.pyplot as plt
import numpy as np

import calib_pin

# A bundled job: 72 configurations, each with and without the payload; the column
# `payload` says which, and the setup file what it weighs.
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
    print(f"{name}: {1e3 * result.errors[0].validation_after.rms:.3f} mm rms, held out")

compliances = {
    found.name.split(".")[0]: (found.value, found.sigma)
    for found in springs.parameters
    if ".compliance." in found.name
}
for joint, (value, sigma) in compliances.items():
    told = "not loaded" if sigma is None else f"{1e6 * value:.3f} +- {1e6 * sigma:.3f}"
    print(f"{joint} gives {told} urad/Nm")

figure, panels = plt.subplots(1, 2, figsize=(6.8, 3.2), layout="constrained")
lengths = {
    "nominal": springs.held_out.before,
    "geometry": geometry.held_out.after,
    "compliance too": springs.held_out.after,
}
colors = ("#999999", "#d55e00", "#0072b2")
for (name, residuals), color in zip(lengths.items(), colors, strict=True):
    sizes = np.sort(1e3 * np.linalg.norm(residuals, axis=1))
    share = np.arange(1, len(sizes) + 1) / len(sizes) * 100
    panels[0].semilogx(sizes, share, color=color, label=name)
panels[0].set(xlabel="error, held out [mm]", ylabel="measurements [%]")
panels[0].set(xlim=(1e-4, 20.0), ylim=(0, 101))
panels[0].legend(frameon=False, fontsize=8, loc="upper left")
values = 1e6 * np.array([value for value, _ in compliances.values()])
panels[1].bar(range(1, len(values) + 1), values, color="#0072b2")
panels[1].set(xlabel="joint", ylabel="compliance [urad/Nm]")
figure.savefig("payload_and_compliance.png", dpi=110)
