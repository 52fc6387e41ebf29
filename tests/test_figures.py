"""The paper's figures on both machines, and the same with the mechanism off, which must fail."""

from __future__ import annotations

from typing import Any

import pytest

from stillflux import metrics
from stillflux.scenarios import EXPERIMENTS, MACHINES, OFFSET_250_MV, fig10
from stillflux.simulation import simulate

def cases() -> list[Any]:
    found: list[Any] = []
    for name in EXPERIMENTS:
        for machine in MACHINES:
            for arithmetic in ("f32", "f64", "q"):
                marks = [pytest.mark.slow] if arithmetic == "q" else []
                case = f"{name}-{machine}-{arithmetic}"
                found.append(pytest.param(name, machine, arithmetic, marks=marks, id=case))
    return found


@pytest.mark.parametrize(("name", "machine", "arithmetic"), cases())
def test_holds(name: str, machine: str, arithmetic: str) -> None:
    claims = EXPERIMENTS[name].run(machine, arithmetic)
    assert [claim for claim in claims if not claim.ok] == []


@pytest.mark.parametrize(("name", "machine", "arithmetic"), cases())
def test_negative_control_fails(name: str, machine: str, arithmetic: str) -> None:
    claims = EXPERIMENTS[name].run(machine, arithmetic, control=True)
    assert not all(claim.ok for claim in claims)


@pytest.mark.parametrize("machine", MACHINES)
def test_without_offset_estimator_the_tenfold_offset_is_more_than_the_noise_compensator_can_hold(
    machine: str,
) -> None:
    """Fig. 10 at 250 mV: on these machines the circle does not stay round, as the README's limits say."""
    result = simulate(fig10(machine, offset=OFFSET_250_MV))
    settled = result.window(result.t[-1] - 5.0)
    assert result.status != "running" or metrics.flux_ripple(settled) > 0.03
