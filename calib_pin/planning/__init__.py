"""Planning: which configurations to measure."""
