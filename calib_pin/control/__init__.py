"""Numerical inverse kinematics, on the calibrated robot or any other kinematics."""
