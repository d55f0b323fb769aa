"""The robot, its errors and a plan in the browser."""
