"""Work that leaves the process: local processes, or a cluster."""
