"""Validation: the worth of a calibration on measurements that were not fitted."""
