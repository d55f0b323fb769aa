"""Files in and out: robots, measurements, setups and results."""
