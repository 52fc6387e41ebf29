"""`StatusCode` and `EncoderCode`: the numbers of the signals "status" and "encoder.state"."""

from __future__ import annotations

from enum import IntEnum

__all__ = ["EncoderCode", "StatusCode"]


class _Code(IntEnum):
    """Names its numbers where there is none of a value."""

    @classmethod
    def _missing_(cls, value: object) -> None:
        known = ", ".join(f"{code.name} = {code.value}" for code in cls)
        raise ValueError(f"{value!r} is none of {cls.__name__}: {known}")


class StatusCode(_Code):
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


class EncoderCode(_Code):
    """What encoder and estimate say of each other: `result["encoder.state"] == EncoderCode.AGREES`."""

    SILENT = 0
    """The encoder is not read: the drive is sensorless."""
    AGREES = 1
    """Measured and estimated speed agree, or nothing has contradicted that yet."""
    APART = 2
    """The encoder is wrong: the drive is sensorless."""
    ESTIMATE_APART = 3
    """The shaft turns faster than the estimate near zero stator frequency: the field is lost."""
