"""Recorded logs: reading, checks, and what the estimators need to begin. `stillflux.replay` is made of it."""
