"""`StatusCode`: the states of a drive as the numbers of the signal "status"."""

from __future__ import annotations

from enum import IntEnum

__all__ = ["StatusCode"]


class StatusCode(IntEnum):
    """State of a drive's sequence: `result["status"] == StatusCode.RUNNING`."""

    STOPPED = 0
    """Gates off, waiting for a reference."""
    READING_OFFSET = 1
    """Reading the current offsets, gates off."""
    MAGNETISING = 2
    """Building up the flux."""
    RUNNING = 3
    """Under control."""
    FAULTED = 4
    """Gates off after a fault."""
