"""Reports of results for people."""
