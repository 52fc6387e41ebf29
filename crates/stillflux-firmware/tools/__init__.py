"""Builds, runs, measures and examines the firmware images."""
