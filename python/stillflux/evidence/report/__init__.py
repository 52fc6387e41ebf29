"""Pages of what the runs showed."""
