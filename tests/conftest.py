"""Fixtures shared by the tests."""

from __future__ import annotations

import pytest

import stillflux as sf

#: Files whose tests take longest: many closed loops, or images for a target that are compiled.
_LONG = ("test_firmware.py", "test_firmware_examples.py", "test_c.py", "test_beyond.py", "test_figures.py")


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Longest files first: a process that takes one of them last would leave the others idle."""
    items.sort(key=lambda item: item.path.name not in _LONG)


@pytest.fixture
def motor() -> sf.Motor:
    return sf.Motor.preset("2.2kW")


@pytest.fixture
def inverter() -> sf.Inverter:
    return sf.Inverter()


@pytest.fixture
def scenario(motor: sf.Motor, inverter: sf.Inverter) -> sf.Scenario:
    """A start to a low speed, two seconds in all."""
    return sf.Scenario(
        motor=motor,
        inverter=inverter,
        duration=2.0,
        omega_ref=5.0,
        plant={"current_offset": 0.03 + 0.02j, "thermal": (60.0, 80.0, 0.0039)},
        changes=[(1.8, {"R_s": 4.0, "current_offset": -0.01j})],
        name="start",
    )
