"""What a calibration is worth on measurements that it was not fitted to."""
