"""Robust estimation: measurements that do not fit are found and set aside."""
