"""The paper's figures on both machines, and the same with the mechanism off, which must fail.

Quick: most figures at both machines in single precision. Slow: all, in the other arithmetics too.
"""

from __future__ import annotations

import csv
import json
import math
from pathlib import Path
from typing import Any

import pytest

from stillflux import reproduce, scenarios, sensitivity
from stillflux.claims import Claim
from stillflux.cli import main
from stillflux.experiments import EXPERIMENTS, FIGURES
from stillflux.scenarios import MACHINES

METRICS = Path(__file__).parent / "metrics.csv"
WITHOUT_DRIVE = ("2", "6")
"""Open loop: the same in every arithmetic."""
LONG = ("headline", "2", "10-250mV", "11", "17-120")
"""Left to the slow tests in any arithmetic."""


def cases() -> list[Any]:
    found: list[Any] = []
    for name in EXPERIMENTS:
        for machine in MACHINES:
            for arithmetic in ("f32",) if name in WITHOUT_DRIVE else ("f32", "f64", "q"):
                marks = [] if arithmetic == "f32" and name not in LONG else [pytest.mark.slow]
                found.append(
                    pytest.param(name, machine, arithmetic, marks=marks, id=f"{name}-{machine}-{arithmetic}")
                )
    return found


@pytest.mark.parametrize(("name", "machine", "arithmetic"), cases())
def test_figure(name: str, machine: str, arithmetic: str) -> None:
    """Holds but for its documented limits, which are still limits; the negative control fails."""
    experiment = EXPERIMENTS[name]
    claims = experiment.run(machine, arithmetic)
    assert experiment.unexpected(machine, claims) == []
    limited = machine in experiment.limits
    assert all(claim.ok for claim in claims) != limited, "a limit that no longer is one, or none where one is"
    control = experiment.run(machine, arithmetic, control=True)
    assert not all(claim.ok for claim in control)
    if arithmetic == "f32" and name in FIGURES:
        assert stale(name, machine, claims) == [], "run `make metrics` and look at the diff"


def stale(figure: str, machine: str, claims: list[Claim]) -> list[str]:
    """Lines of the committed table of metrics that no longer hold."""
    known = {(r["figure"], r["machine"], r["quantity"]): r for r in reproduce.read_metrics(METRICS)}
    outcome = reproduce.Outcome(figure, machine, "", tuple(claims), ())
    found = []
    for claim in claims:
        row = reproduce.metrics_row(outcome, claim)
        old = known.get((figure, machine, claim.text))
        if old is None or not reproduce.agree(old, row, claim):
            found.append(f"{claim.text}: {old and old['value']} in the table, now {row['value']}")
    return found


def test_metrics_table_has_no_line_too_many() -> None:
    rows = reproduce.read_metrics(METRICS)
    found = {(row["figure"], row["machine"]) for row in rows}
    assert {(f, m) for f in FIGURES for m in MACHINES} <= found <= set(reproduce.METRICS_OF)


def test_metrics_table_keeps_what_agrees() -> None:
    def outcome(value: float) -> reproduce.Outcome:
        claim = Claim("x ≤ 1", f"{value:g}", value <= 1, value=value, limit=1.0)
        return reproduce.Outcome("5", "2.2kW", "reproduced", (claim,), ())

    def table(value: float, before: str = "") -> str:
        return reproduce.metrics_table([outcome(value)], list(csv.DictReader(before.splitlines())))

    first = table(0.5)
    assert table(0.6, first) == first
    assert table(0.9, first) != first
    assert table(1.1, first) != first


def test_a_claim_outside_the_documented_limit_fails_the_verdict() -> None:
    explained = [Claim("ripple of |ψ̂_s| ≤ 3 %", "9 %", False)]
    control = [Claim("x", "", False)]
    assert reproduce.judge("10-250mV", "2.2kW", explained, control) == "limit"
    assert reproduce.judge("10", "2.2kW", explained, control) == "FAILED"
    assert reproduce.judge("10-250mV", "2.2kW", [*explained, Claim("y", "", False)], control) == "FAILED"
    assert reproduce.judge("10-250mV", "2.2kW", explained, []) == "FAILED"


def test_choose() -> None:
    assert reproduce.choose([]) == FIGURES
    assert reproduce.choose(["13", "9"]) == ("13a", "13b", "9")
    assert reproduce.choose(["2"]) == ("2",)
    with pytest.raises(ValueError, match="no figure 7"):
        reproduce.choose(["7"])


def test_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    arguments = ["reproduce", "5", "6", "--machine", "11kW", "--out", str(tmp_path), "--json", "-"]
    assert main(arguments) == 0
    rows = json.loads(capsys.readouterr().out)
    assert [(row["figure"], row["machine"], row["verdict"]) for row in rows] == [
        ("5", "11kW", "reproduced"),
        ("6", "11kW", "reproduced"),
    ]
    page = (tmp_path / "reproduce.html").read_text(encoding="utf-8")
    assert page.count("<svg") == 2
    assert page.index("<table>") < page.index("<svg")
    assert "stillflux reproduce 5 --machine 11kW" in page
    assert (tmp_path / "figure-5-11kW.png").stat().st_size > 10_000


@pytest.mark.parametrize("machine", MACHINES)
@pytest.mark.parametrize("error", sensitivity.ERRORS)
def test_mismatches_are_what_they_are_called(machine: str, error: str) -> None:
    scenario = sensitivity.ERRORS[error].apply(scenarios.fig15(machine), 0.1)
    real, known = scenario.plant_motor or scenario.motor, scenario.motor
    ratios = {
        "r_s": real.R_s / known.R_s,
        "σl_s": real.L_sigma / known.L_sigma,
        "l_s": real.L_s / known.L_s,
        "τ_r": real.tau_r / known.tau_r,
    }
    expected = {name: 1.1 if name == error else 1.0 for name in ratios}
    assert all(math.isclose(ratios[name], expected[name], rel_tol=1e-12) for name in ratios)


@pytest.mark.slow
def test_a_margin() -> None:
    found = sensitivity.margin("15", "2.2kW", "current offset")
    assert found.down is None
    assert found.up >= 1.0
