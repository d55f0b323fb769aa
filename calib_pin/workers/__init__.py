"""Work that leaves the process: local processes, or a cluster."""

from calib_pin.workers.base import SERIAL, Workers

__all__ = ["SERIAL", "Workers"]
