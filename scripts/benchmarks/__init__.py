"""Speed, each job beside references measured in the same run.

The machines are shared and noisy: read the ratios, not the seconds.
"""
