"""The torque-speed plane and what lies beyond the paper's figures, for each scheme.

Quick: a few points, mismatches and a crossing, with the published scheme as negative control where it
fails. Slow: every target but the full planes, against the committed metrics.
"""

from __future__ import annotations

import ast
import json
import math
import re
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pytest
from numpy.typing import NDArray

import stillflux as sf
from stillflux import parallel
from stillflux.cli import main
from stillflux.evidence import beyond, conditions, judge, plane_points, points
from stillflux.evidence.claims import at_most, holds
from stillflux.evidence.conditions import REACHED, SCHEMES
from stillflux.evidence.drives import DRIVES
from stillflux.evidence.errors import MISMATCHES
from stillflux.evidence.machines import ALL_MACHINES, LEAKY, inverter_of, motor_of, step
from stillflux.evidence.plane import persistence_shifted
from stillflux.evidence.registry import choose_targets, targets
from stillflux.evidence.report import maps, page, plane
from stillflux.evidence.seeds import SEEDS, seeded
from stillflux.evidence.table import Table, of_summary, order
from stillflux.evidence.target import Case
from stillflux.metrics import speed_error

ROOT = Path(__file__).resolve().parents[1]
METRICS = ROOT / "tests" / "metrics.csv"
PUMP = ROOT / "examples" / "machines" / "pump-4kW.toml"
BOTH = pytest.mark.parametrize("scheme", SCHEMES)
QUICK = ("2.2kW", LEAKY)
"""Machines of the quick tests; the slow ones have all."""


def slow_unless(quick: bool) -> Any:
    """Marks of a parameter."""
    return () if quick else pytest.mark.slow


def every_machine(quick: tuple[str, ...] = QUICK) -> pytest.MarkDecorator:
    """Parametrizes a test by machine; those that are not quick are slow."""
    return pytest.mark.parametrize(
        "machine", [pytest.param(m, marks=slow_unless(m in quick)) for m in ALL_MACHINES]
    )


MACHINE = every_machine()


@pytest.fixture(autouse=True)
def _known(request: pytest.FixtureRequest) -> None:
    """Skips what is about a scheme that this build does not have."""
    if not hasattr(request.node, "callspec"):
        return
    scheme = request.node.callspec.params.get("scheme")
    if scheme is None:
        return
    try:
        sf.Drive(motor_of("2.2kW"), inverter_of("2.2kW"), scheme=scheme)
    except ValueError:
        pytest.skip(f'scheme="{scheme}" is not built in')


def case_of(target: str, machine: str, scheme: str, label: str, arithmetic: str = "f32") -> Case:
    """The one case of a target with this label."""
    found = [c for c in targets()[target].cases(machine, scheme, arithmetic) if c.label == label]
    assert len(found) == 1
    return found[0]


def row_of(target: str, machine: str, scheme: str, label: str, arithmetic: str = "f32") -> beyond.Row:
    """Runs the one case of a target with this label."""
    return beyond.run_case(case_of(target, machine, scheme, label, arithmetic))


def point(
    machine: str, scheme: str, omega: float, torque: float, kind: str = "ramps", arithmetic: str = "f32"
) -> beyond.Row:
    """Runs one point of the plane."""
    label = f"ω = {omega:g}, T = {torque:g} T_N"
    return row_of(f"plane-{kind}", machine, scheme, label, arithmetic)


def wrong(machine: str, scheme: str, error: str, omega: float, torque: float) -> beyond.Row:
    """Runs one point with something wrong."""
    return row_of("mismatch", machine, scheme, f"{error} at ω = {omega:g}, T = {torque:g} T_N")


def as_in_motoring(case: Case) -> Case:
    """A case of the published scheme whose noise compensator is not lowered in regeneration."""
    return replace(case, scenario=case.scenario.with_settings(noise_regeneration=4.0))


def failing(row: beyond.Row) -> list[str]:
    return [f"{c.text}: {c.measured}" for c in row.claims if not c.ok]


# Points, mismatches, crossings.


AWAY = [
    pytest.param(machine, scheme, omega, torque, marks=slow_unless(machine in QUICK))
    for machine in ALL_MACHINES
    for scheme in SCHEMES
    for omega, torque in ((0.05, 0.6), (-0.1, -1.2), (0.0, 1.0), (0.1, -0.4))
    # There the published scheme leaves 0.1° or 8°, as the noise will have it.
    if not (machine.startswith("11kW") and (scheme, omega) == ("paper", 0.05))
]


@pytest.mark.parametrize(("machine", "scheme", "omega", "torque"), AWAY)
def test_point_away_from_zero_stator_frequency_is_held_within_3_degrees(
    machine: str, scheme: str, omega: float, torque: float
) -> None:
    assert failing(point(machine, scheme, omega, torque)) == []


@MACHINE
@BOTH
@pytest.mark.parametrize("torque", [-1.2, 0.6, 1.2])
def test_load_applied_at_rest_before_the_first_turn_is_held(machine: str, scheme: str, torque: float) -> None:
    assert failing(point(machine, scheme, 0.0, torque, "rest")) == []


@pytest.mark.slow
@MACHINE
@BOTH
@pytest.mark.parametrize("arithmetic", ["f64", "q"])
def test_points_are_held_in_every_arithmetic(machine: str, scheme: str, arithmetic: str) -> None:
    at = [(omega, torque) for *drive, omega, torque in AWAY if drive == [machine, scheme]]
    for omega, torque in (*at, *(((0.03, -1.0),) if scheme == "enhanced" else ())):
        assert failing(point(machine, scheme, omega, torque, arithmetic=arithmetic)) == []


@MACHINE
@BOTH
@pytest.mark.parametrize(("omega", "torque"), [(0.03, -1.0), (-0.03, 1.0)])
def test_slow_regeneration_is_held(machine: str, scheme: str, omega: float, torque: float) -> None:
    assert failing(point(machine, scheme, omega, torque)) == []


@MACHINE
def test_slow_regeneration_is_held_beyond_rated_load(machine: str) -> None:
    assert failing(point(machine, "enhanced", 0.04, -1.2)) == []


@pytest.mark.parametrize("machine", ["11kW", LEAKY])
@pytest.mark.parametrize(("omega", "torque"), [(0.03, -1.0), (-0.03, 1.0)])
def test_published_scheme_loses_slow_regeneration_with_the_noise_compensator_as_in_motoring(
    machine: str, omega: float, torque: float
) -> None:
    # At 2.2 kW these points have ω_s of the other sign, outside the band 0 < ω_s < ω that is unstable.
    case = case_of("plane-ramps", machine, "paper", f"ω = {omega:g}, T = {torque:g} T_N")
    lost = beyond.run_case(as_in_motoring(case)).measured
    assert lost.why
    # By the load: it is applied from LOAD_AT on.
    assert conditions.LOAD_AT < lost.angle_passed < math.inf


@MACHINE
@pytest.mark.parametrize("scheme", ["enhanced"])
def test_an_offset_that_appears_once_running_is_found(machine: str, scheme: str) -> None:
    assert failing(point(machine, scheme, 0.02, 1.0, "drift")) == []
    # At 2.2 kW the step costs the points of slow regeneration (docs/limits.md).
    regenerating = -0.06 if machine == "2.2kW" else -0.02
    assert failing(point(machine, scheme, regenerating, 1.0, "drift")) == []


@every_machine(quick=("2.2kW",))
@pytest.mark.parametrize("scheme", ["enhanced"])
@pytest.mark.parametrize("error", ["r_s step +25 %", "L_M −10 %", "gain of a channel +2 %"])
def test_mismatch_is_survived_in_motoring_and_regeneration(machine: str, scheme: str, error: str) -> None:
    for at in ((0.02, 1.0), (0.02, -1.0)):
        assert failing(wrong(machine, scheme, error, *at)) == []


@pytest.mark.parametrize(("machine", "at"), [("2.2kW", (0.02, 1.0)), ("11kW", (0.02, -1.0))])
def test_published_scheme_loses_a_step_of_the_resistance(machine: str, at: tuple[float, float]) -> None:
    assert wrong(machine, "paper", "r_s step +25 %", *at).measured.why


@MACHINE
@pytest.mark.parametrize("scheme", ["enhanced"])
def test_slow_reversal_under_rated_load_keeps_the_torque(machine: str, scheme: str) -> None:
    for label in ("0.1 to -0.1 in 60 s, T = 1 T_N", "0.1 to -0.1 in 20 s, T = -1 T_N"):
        assert failing(row_of("crossing", machine, scheme, label)) == []


def test_published_scheme_keeps_a_slow_reversal_by_its_noise_compensator_in_regeneration() -> None:
    case = case_of("crossing", "11kW", "paper", "0.1 to -0.1 in 60 s, T = 1 T_N")
    assert failing(beyond.run_case(case)) == []
    # As in motoring it is lost where the speed has passed zero and the load drives the machine.
    lost = beyond.run_case(as_in_motoring(case)).measured
    assert lost.why
    begin, end = case.held[0] + 2.0, case.held[1] - 3.0
    assert (begin + end) / 2 < lost.angle_passed < end


@MACHINE
@pytest.mark.parametrize("torque", [1.0, -1.0])
@pytest.mark.parametrize("seed", [SEEDS[0], *(pytest.param(s, marks=pytest.mark.slow) for s in SEEDS[1:])])
def test_loaded_drive_leaves_zero_stator_frequency_by_itself(machine: str, torque: float, seed: int) -> None:
    scenario = persistence_shifted.scenario(machine, "enhanced", torque=torque, time=40.0)
    (scenario,) = seeded([scenario], seed)
    result = sf.simulate(scenario)
    settled = (REACHED + 5.0, 44.0)
    hold = judge.measure(result, (REACHED, scenario.duration), settled)
    assert not hold.why
    assert hold.angle_held < 5.0
    # The true speed is off by the error of the slip, 3 % of its 0.05 at 2.2 kW with the flux lowered
    # (0.0015), by a ripple at three times ω_s (0.0008) and by the noise of the converters (σ 0.00024), 0.0016
    # rms. The largest value of the noise grows with the length of the record and differs between
    # realisations by 10 %, the rms value of the error by 3 %. So the rms value is judged. What becomes of the
    # error within ten minutes, `persistence-shifted` judges by its largest value.
    assert np.sqrt(np.mean(speed_error(result.window(*settled)) ** 2)) < 0.002
    drive = sf.Drive(scenario.motor, scenario.inverter)
    kept = drive.settings["omega_s_min"] / scenario.motor.base["omega"]
    assert 0.3 * kept < hold.omega_s * torque < 1.2 * kept
    assert hold.torque_ripple < 0.01
    # Beyond the line the flux is rated again.
    assert abs(result["estimate.psi_s"][-1]) > 0.97 * scenario.motor.base["psi"]


@pytest.mark.slow
def test_with_the_flux_kept_it_is_lost_there() -> None:
    # The field goes first. What is seen of that first, the speed or by the drive, is a matter of 0.1 s.
    # Most realisations of the noise are held for the two minutes: of ten of this machine two are lost.
    cases = beyond.cases(["persistence-rated"], ["11kW-leaky"], ["enhanced"])
    lost = [why for case in cases if (why := beyond.run_case(case).measured.why)]
    assert lost
    assert set(lost) <= {"speed", "estimate lost", "field lost"}


def doubtful(what: Literal["keep", "limit", "fault"]) -> sf.Result:
    """Eight seconds at ω_s = 0 with nothing that corrects the flux, then rated load."""
    scenario = conditions.drive(
        "2.2kW",
        "enhanced",
        name=what,
        duration=13.0,
        omega=[(0.0, 0.0), (12.0, 0.0)],
        load=step(12.0, 1.0),
        record_every=1,
        signals=("estimate.i_dq_ref", "estimate.confidence", "status"),
    )
    return sf.simulate(scenario.with_settings(low_confidence=what, apply_innovation=False, omega_s_min=0.0))


def test_low_confidence_leaves_the_torque_limits_it_or_stops_the_drive() -> None:
    kept, limited, stopped = doubtful("keep"), doubtful("limit"), doubtful("fault")
    before = kept.t < 12.0
    low = (kept["estimate.confidence"] < 0.5) & (kept["status"] == 3)
    assert low[before].any()
    assert kept.status == "running"
    assert stopped.status.fault == "low confidence"
    assert stopped.status.time is not None
    # Within 50 ms of a low confidence; it comes back in between.
    before_stop = low & (kept.t < stopped.status.time)
    assert 0.04 <= np.count_nonzero(before_stop) * float(kept.t[1] - kept.t[0]) <= 0.1
    # The torque reference, made by i_q at rated flux.
    motor = kept.scenario.motor
    # Before the load has taken the shaft into field weakening.
    loaded = (limited.t > 12.01) & (limited.t < 12.2)
    i_q = np.abs(limited["estimate.i_dq_ref"].imag[loaded])
    largest = 1.5 * motor.T_N / (1.5 * motor.n_p * motor.base["psi"])
    # A reference holds for eight periods, by the confidence at the first of them.
    first, last = np.flatnonzero(loaded)[[0, -1]]
    confidence = limited["estimate.confidence"][first - 7 : last + 1]
    largest_of_eight = np.lib.stride_tricks.sliding_window_view(confidence, 8).max(axis=1)
    assert (i_q <= 1.001 * largest * np.minimum(2.0 * largest_of_eight, 1.0)).all()
    asked = np.abs(kept["estimate.i_dq_ref"].imag[kept.t > 12.01])
    # The confidence falls to 0.055 on this bridge: a ninth of the torque is left of what is asked for.
    assert i_q.min() < 0.12 * largest < 0.9 * largest < asked.max()


@MACHINE
@BOTH
def test_torque_step_is_there_in_5_ms(machine: str, scheme: str) -> None:
    row = row_of("transient-torque", machine, scheme, "ω = 0.05, to 1 T_N")
    assert failing(row) == []


@pytest.mark.parametrize("scheme", ["enhanced"])
@pytest.mark.parametrize("omega", [-1.0, 0.1])
def test_coasting_motor_is_caught_without_being_braked(scheme: str, omega: float) -> None:
    assert failing(row_of("flying", "2.2kW", scheme, f"ω = {omega:g}")) == []


def test_published_scheme_brakes_a_coasting_motor() -> None:
    row = row_of("flying", "2.2kW", "paper", "ω = -0.1")
    assert "speed disturbed meanwhile by" in [c.quantity for c in row.claims if not c.ok]


@BOTH
def test_memory_of_one_run_serves_the_next(scheme: str) -> None:
    without, restored = (beyond.run_case(c) for c in targets()["memory"].cases("2.2kW", scheme))
    assert failing(restored) == []
    assert restored.measured.angle_held < 0.5 * without.measured.angle_held


@pytest.mark.slow
@MACHINE
@pytest.mark.parametrize("scheme", ["enhanced"])
def test_the_whole_plane_is_held_as_the_readme_says(machine: str, scheme: str) -> None:
    """The headline of the README: every point held, but for as many as the committed table admits."""
    rows = beyond.run_all(("plane-ramps",), (machine,), (scheme,))
    assert len(rows) == len(points.SPEEDS) * len(points.TORQUES) == 273
    table = {
        x.quantity: float(x.value) for x in Table.read(METRICS).find("target", "plane-ramps", machine, scheme)
    }
    lost = [(row.label, row.measured.why) for row in rows if row.measured.why]
    assert len(lost) <= table["runs lost"], lost
    met = [row.ok for row in rows]
    assert sum(met) >= table["runs that meet the target"], [(r.label, failing(r)) for r in rows if not r.ok]


@pytest.mark.slow
@MACHINE
@BOTH
@pytest.mark.parametrize("target", [t for t in targets() if not targets()[t].map])
def test_target_is_no_worse_than_the_committed_table(target: str, machine: str, scheme: str) -> None:
    """Under the first seed; the table holds the worst of all."""
    rows = beyond.run_cases(beyond.cases((target,), (machine,), (scheme,), seeds=SEEDS[:1]))
    assert bool(rows) == bool(targets()[target].cases(machine, scheme))
    table = Table.read(METRICS)
    for fresh in of_summary(beyond.summaries(rows)[0]) if rows else []:
        known = [x for x in table.find(*fresh.group) if (x.quantity, x.direction) == fresh.key[1:]]
        assert [x for x in known if x.holds <= fresh.holds], (fresh, "run `make metrics`, look at the diff")


# What the runs are.


@MACHINE
def test_slip_is_that_of_the_plant(machine: str) -> None:
    motor = motor_of(machine)
    scenario = points.plane(machine, "paper", omega=0.05, torque=1.0, hold=3.0)
    end = scenario.duration
    found = judge.measure(sf.simulate(scenario), (end - 3.0, end), (end - 2.0, end))
    assert found.omega_s == pytest.approx(0.05 + conditions.slip(motor, 1.0), rel=0.01)
    assert conditions.line_speed(motor, -1.0) == pytest.approx(conditions.slip(motor, 1.0))
    assert conditions.slip(motor, 0.0) == 0.0


def test_leaky_machine_differs_in_its_leakage_only() -> None:
    leaky, motor = motor_of(LEAKY), motor_of("11kW")
    assert leaky.L_sigma / leaky.base["l"] == pytest.approx(0.15)
    assert (leaky.L_s, leaky.tau_r) == pytest.approx((motor.L_s, motor.tau_r))
    assert leaky.replace(L_sigma=motor.L_sigma, L_M=motor.L_M, R_R=motor.R_R) == motor


@pytest.mark.parametrize("error", MISMATCHES)
def test_mismatches_are_of_the_real_machine_only(error: str) -> None:
    plain = points.plane("2.2kW", "paper", omega=0.0, torque=1.0)
    wrong = points.mismatch("2.2kW", "paper", error=error, omega=0.0, torque=1.0)
    assert (wrong.motor, wrong.inverter, wrong.settings) == (plain.motor, plain.inverter, plain.settings)
    assert (wrong.replace(name=plain.name) == plain) == (error == "nothing")


def test_magnetising_inductance_is_off_alone() -> None:
    scenario = points.mismatch("2.2kW", "paper", error="L_M −10 %", omega=0.0, torque=0.0)
    real, known = scenario.plant_motor, scenario.motor
    assert real is not None
    assert real.saturation is not None
    assert known.saturation is not None
    assert real.replace(L_M=known.L_M, saturation=known.saturation) == known
    assert math.isclose(real.L_M, 0.9 * known.L_M)
    assert real.saturation[0] / known.saturation[0] == pytest.approx(real.L_s / known.L_s)


def test_offset_is_there_from_power_up_or_once_running() -> None:
    early = points.plane("11kW", "paper", omega=0.0, torque=0.0)
    late = points.plane("11kW", "paper", omega=0.0, torque=0.0, kind="drift")
    offset = early.plant["current_offset"]
    assert isinstance(offset, complex)
    assert abs(offset) == pytest.approx(0.01 * math.sqrt(2) * 21.5)
    assert late.plant["current_offset"] == 0
    assert late.changes == ((conditions.OFFSET_AT, {"current_offset": offset}),)


def test_points_within_reach_of_zero_stator_frequency() -> None:
    near = {c.point for c in targets()["plane-ramps"].cases("11kW", "paper") if c.near_line}
    assert {(0.0, 0.0), (0.01, 0.0), (-0.01, 0.0), (-0.02, 1.0), (0.02, -1.0)} <= near
    assert near.isdisjoint({(0.02, 0.0), (0.02, 1.0), (0.0, 1.0), (0.03, -1.0)})


def test_targets_are_chosen_by_name_and_a_kind_that_is_none_is_named() -> None:
    assert choose_targets(["plane", "mismatch"])[-2:] == ("plane-seeds", "mismatch")
    assert choose_targets(["mismatch-stepped"]) == ("mismatch-stepped",)
    assert choose_targets(["plane-rest"]) == ("plane-rest",)
    assert choose_targets([]) == tuple(targets())
    with pytest.raises(ValueError, match="no target plain"):
        choose_targets(["plain"])
    with pytest.raises(ValueError, match="kind = 'steps'"):
        points.plane("2.2kW", "paper", omega=0.0, torque=0.0, kind="steps")  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="at speed zero"):
        points.plane("2.2kW", "paper", omega=0.1, torque=0.0, kind="rest")


# The judge.

DT = 0.005


@pytest.fixture(scope="module")
def result() -> sf.Result:
    """Ten seconds of a drive that runs from 1 s on at its reference, to be spoilt."""
    t = np.arange(0.0, 10.0, DT)
    scenario = points.plane("2.2kW", "paper", omega=0.0, torque=0.0, hold=1.0)
    zero = np.zeros_like(t)
    data = {
        "angle_error": zero,
        "omega_m": zero,
        "reference": zero,
        "estimate.confidence": np.where(t >= 1.0, 1.0, 0.0),
        "status": np.where(t >= 1.0, 3.0, 2.0),
    }
    return sf.Result(scenario=scenario, t=t, data=data, status=sf.Status("running"), memory={})


def spoilt(result: sf.Result, **signals: NDArray[np.float64]) -> sf.Result:
    data = {name.replace("estimate_", "estimate."): values for name, values in signals.items()}
    return replace(result, data={**result.data, **data})


def pulse(result: sf.Result, *stretches: tuple[float, float, float]) -> NDArray[np.float64]:
    """Zero but for (begin, end, value)."""
    x = np.zeros_like(result.t)
    for begin, end, value in stretches:
        x[(result.t >= begin) & (result.t < end)] = value
    return x


def test_excursion_is_a_miss_unless_the_confidence_dropped_first(result: sf.Result) -> None:
    twice = np.radians(pulse(result, (3.0, 4.0, 20.0), (6.0, 7.0, -20.0)))
    warned = result["estimate.confidence"] - pulse(result, (5.9, 7.0, 0.6))
    found = judge.confidence(spoilt(result, angle_error=twice, estimate_confidence=warned))
    assert (found.excursions, found.misses, found.false_alarms) == (2, 1, 0)
    assert found.blind == pytest.approx(1.0, abs=2 * DT)
    late = result["estimate.confidence"] - pulse(result, (3.1, 4.0, 0.6), (6.1, 7.0, 0.6))
    assert judge.confidence(spoilt(result, angle_error=twice, estimate_confidence=late)).misses == 2


def test_ripple_about_the_level_is_one_excursion(result: sf.Result) -> None:
    ripple = np.radians(pulse(result, (3.0, 9.0, 1.0)) * (15.0 + 3.0 * np.sin(20 * result.t)))
    assert judge.confidence(spoilt(result, angle_error=ripple)).excursions == 1
    many = np.radians(pulse(result, *((k, k + 0.5, 20.0) for k in range(2, 9))))
    assert judge.confidence(spoilt(result, angle_error=many)).excursions == 7


def test_confidence_is_judged_through_a_loss(result: sf.Result) -> None:
    """The excursion that is the loss counts, also if it comes after the moment of loss; none after it."""
    many = np.radians(pulse(result, *((k, k + 0.5, 20.0) for k in range(2, 9))))
    lost = spoilt(result, angle_error=many)
    # Lost between two excursions, by speed say: the next is that of the loss.
    assert judge.confidence(lost, loss=4.7).excursions == 4
    # Lost within one: that one is it.
    assert judge.confidence(lost, loss=4.2).excursions == 3
    warned = result["estimate.confidence"] - pulse(result, (1.9, 4.7, 0.6))
    found = judge.confidence(spoilt(lost, estimate_confidence=warned), loss=4.7)
    assert (found.excursions, found.misses) == (4, 1)
    # A fault ends it.
    fault = spoilt(lost, status=np.where(result.t >= 4.7, 4.0, 3.0))
    assert judge.confidence(fault, loss=4.7).excursions == 3


def test_false_alarm_lasts_half_a_second_without_an_error(result: sf.Result) -> None:
    trust = result["estimate.confidence"] - pulse(result, (2.0, 2.4, 0.6), (4.0, 5.0, 0.6), (7.0, 8.0, 0.6))
    error = np.radians(pulse(result, (7.0, 8.0, 8.0)))
    found = judge.confidence(spoilt(result, angle_error=error, estimate_confidence=trust))
    assert (found.false_alarms, found.misses) == (1, 0)
    assert found.false_time == pytest.approx(1.0, abs=2 * DT)


def loss(result: sf.Result) -> tuple[float, str]:
    when, why = judge.lost(result)
    return round(when, 6), why


def test_lost_by_fault_angle_or_speed(result: sf.Result) -> None:
    assert judge.lost(result) == (math.inf, "")
    turned = spoilt(result, angle_error=np.radians(pulse(result, (4.0, 4.1, 120.0))))
    assert loss(turned) == (4.0, "angle")
    assert judge.lost(turned, since=5.0) == (math.inf, "")
    base = result.scenario.motor.base["omega_m"]
    runaway = spoilt(result, omega_m=base * pulse(result, (2.0, 3.0, 0.2), (8.0, 11.0, 0.06)))
    assert loss(runaway) == (8.0, "speed")
    brief = spoilt(result, omega_m=base * pulse(result, (9.9, 11.0, 0.06)))
    assert judge.lost(brief) == (math.inf, "")
    fault = spoilt(result, status=np.where(result.t >= 5.0, 4.0, 3.0))
    fault = replace(fault, status=sf.Status("faulted", "over-current", 5.0))
    assert loss(fault) == (5.0, "over-current")
    # What comes first is what was lost.
    both = spoilt(fault, angle_error=turned["angle_error"])
    assert loss(both) == (4.0, "angle")
    both = spoilt(fault, omega_m=base * pulse(result, (4.5, 11.0, 0.06)))
    assert loss(both) == (4.5, "speed")
    both = spoilt(fault, omega_m=base * pulse(result, (8.0, 11.0, 0.06)))
    assert loss(both) == (5.0, "over-current")


def test_after_a_fault_no_angle_is_held(result: sf.Result) -> None:
    others: dict[str, NDArray[Any]] = dict.fromkeys(
        ("torque", "R_s", "estimate.torque", "estimate.R_s"), np.ones_like(result.t)
    )
    others |= dict.fromkeys(("psi_s", "estimate.psi_s", "estimate.i_dq_ref"), np.ones_like(result.t) + 0j)
    result = replace(result, data={**result.data, **others})
    fault = spoilt(result, status=np.where(result.t >= 5.0, 4.0, 3.0))
    fault = replace(fault, status=sf.Status("faulted", "over-current", 5.0))
    held = judge.measure(result, (2.0, 9.0), (3.0, 9.0))
    assert held.angle_held < 1.0
    assert held.angle_settled < 1.0
    measured = judge.measure(fault, (2.0, 9.0), (3.0, 9.0))
    assert (measured.angle_held, measured.angle_settled) == (math.inf, math.inf)


# Sums, pictures, command.


def rows_of(machine: str = "2.2kW") -> list[beyond.Row]:
    """A map of which every other point is known, one of them lost."""
    calm = judge.Confidence(1.0, 0, 0, 0.0, 0, 0.0, 20.0)
    good = judge.Measured(math.inf, "", 0.1, 0.1, math.inf, 0.001, 0.0, 0.01, 0.01, 0.01, 0.05, 0.0, calm)
    missed = replace(good, lost=7.0, why="angle", confidence=replace(calm, excursions=1, misses=1))
    rows = []
    for k, case in enumerate(targets()["plane-ramps"].cases(machine, "paper")[::2]):
        measured = missed if k == 0 else good
        claims = (holds("never lost", k != 0), at_most("angle", 0.1, 3.0, "°"))
        row = beyond.Row(
            "plane-ramps", machine, "paper", case.label, case.seed, "", case.point, measured, claims
        )
        rows += [row, replace(row, scheme="enhanced", measured=good, claims=claims[1:])]
    return rows


def test_summary_counts_runs_and_shows_the_worst() -> None:
    rows = rows_of()
    paper, enhanced, doubt, _ = beyond.summaries(rows)
    assert (paper.held, paper.runs) == (len(rows) // 2 - 1, len(rows) // 2)
    assert enhanced.held == enhanced.runs
    assert [(claim.quantity, claim.value, claim.ok) for claim in paper.claims] == [
        ("runs that meet the target", paper.held, False),
        ("runs lost", 1, False),
        ("angle", 0.1, True),
    ]
    # Of a claim the worst run is shown, wherever it stands.
    third = replace(rows[4], claims=(rows[4].claims[0], replace(rows[4].claims[1], value=2.5)))
    worse, *_ = beyond.summaries([*rows[:4], third, *rows[5:]])
    assert {claim.quantity: claim.value for claim in worse.claims}["angle"] == 2.5
    missed = {claim.quantity: claim for claim in doubt.claims}["excursions not announced"]
    assert (missed.value, missed.note) == (1, "of 1")
    lines = of_summary(paper) + of_summary(doubt)
    assert {line.group for line in lines} <= set(order())
    assert "target,plane-ramps,2.2kW,paper,runs lost,1,0,at most" in Table(lines).text()
    assert "NOT MET" in plane.table([paper])


def test_pictures_of_partial_maps_and_the_section() -> None:
    rows = rows_of()
    assert len(maps.plane(plane_points.points_of(rows)).axes) == 3
    text = plane.section(rows)
    assert text.count("<svg") == 1
    assert "stillflux beyond plane-ramps --machine 2.2kW" in text
    letters = plane.map_text([row for row in rows if row.scheme == "paper"])
    assert letters.count("X") == 1
    assert json.dumps(page.finite(plane.to_rows(rows)))


def upper(name: str) -> str:
    return name.upper()


def test_interruption_keeps_what_was_done() -> None:
    def done(finished: int, total: int, result: str) -> None:
        assert total == 3
        if finished == 2:
            raise KeyboardInterrupt

    with pytest.raises(parallel.Stopped, match="2 of 3") as stop:
        parallel.run_jobs(upper, [("a",), ("b",), ("c",)], first=lambda job: job[0] != "c", show=done)
    assert len(stop.value.results) == 2
    assert set(stop.value.results) < {"A", "B", "C"}


def test_the_command_writes_runs_and_a_page_that_says_how_to_repeat_them(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out, data = tmp_path / "out", tmp_path / "runs.json"
    arguments = ["beyond", "transient-load", "--machine", "2.2kW", "--scheme", "paper"]
    assert main([*arguments, "--out", str(out), "--json", str(data)]) == 0
    assert "transient-load" in capsys.readouterr().out
    runs = json.loads(data.read_text(encoding="utf-8"))
    assert len(runs) == 2 * len(SEEDS)
    html = (out / "beyond.html").read_text(encoding="utf-8")
    assert "stillflux beyond transient-load --machine 2.2kW" in html
    assert main(["beyond", "plain"]) == 2


def test_what_cannot_be_written_or_is_no_table_or_journal_is_said_before_the_runs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(beyond, "run_all", lambda *_, **__: pytest.fail("ran"))
    files = {"own.toml": PUMP.read_text(), "notes.txt": "notes\n", "bad/plane.csv": "t,i_a\n"}
    Path("bad").mkdir()
    for name, text in files.items():
        Path(name).write_text(text)
    own = ["--motor", "own.toml"]
    for arguments, expected in (
        (
            [*own, "--journal", "own.toml"],
            "--journal own.toml is the file of --motor: it would be overwritten",
        ),
        ([*own, "--json", "own.toml"], "--json own.toml is the file of --motor"),
        (["--json", "s.txt", "--journal", "s.txt"], "--journal s.txt is the file of --json"),
        (["--json", "r/beyond.html", "--out", "r"], "report r/beyond.html is the file of --json"),
        (["--metrics", "m.csv", "--journal", "plane.csv"], "--journal plane.csv is the file of the plane of"),
        (["--journal", "notes.txt"], "journal = notes.txt is no journal"),
        (["--journal", "none/j"], "none/j: there is no folder none"),
        (["--metrics", "notes.txt"], "notes.txt: columns notes, expected kind"),
        (["--metrics", "bad/m.csv"], "bad/plane.csv: columns t, i_a, expected machine"),
    ):
        assert main(["beyond", "plane-ramps", *arguments]) == 2
        assert expected in capsys.readouterr().err
    assert {name: Path(name).read_text() for name in files} == files


def test_a_script_without_a_guard_is_told_so(tmp_path: Path) -> None:
    script = tmp_path / "script.py"
    script.write_text(
        'from stillflux.evidence import beyond\nbeyond.run_all(["transient-load"], ["2.2kW"], ["paper"])\n'
    )
    done = subprocess.run([sys.executable, str(script)], capture_output=True, text=True, timeout=120)
    assert done.returncode == 1
    assert 'begin the campaign below `if __name__ == "__main__":`' in done.stderr


def test_the_documented_script_has_the_guard() -> None:
    (code,) = re.findall(r"```python\n(.*?)```", (ROOT / "docs" / "beyond.md").read_text("utf-8"), re.S)
    tree = ast.parse(code)
    kinds = [type(x) for x in tree.body]
    assert kinds[-1] is ast.If
    assert set(kinds[:-1]) == {ast.ImportFrom}


def test_report_of_the_figures_takes_the_section(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(beyond, "run_all", lambda *_, **__: rows_of())
    table, journal = tmp_path / "metrics.csv", tmp_path / "journal"
    arguments = ["reproduce", "6", "--machine", "2.2kW", "--beyond", "--sensitivity"]
    arguments += ["--metrics", str(table), "--journal", str(journal)]
    assert main([*arguments, "--out", str(tmp_path)]) == 0
    assert "reproduced" in capsys.readouterr().out
    assert not journal.exists()
    found = {(line.kind, line.name) for line in Table.read(table).lines}
    assert found == {
        ("figure", "6"),
        ("control", "6"),
        ("target", "plane-ramps"),
        ("target", "confidence"),
    }
    text = (tmp_path / "reproduce.html").read_text(encoding="utf-8")
    assert text.index("href='#beyond'") < text.index("id='beyond'") < text.index("id='fig-6-2-2kW'")


def test_every_case_is_named_once() -> None:
    for target in targets().values():
        names = [(c.label, c.seed) for c in target.cases("2.2kW", "paper", seeds=SEEDS)]
        assert len(set(names)) == len(names)


@pytest.mark.parametrize(
    ("drive", "warmed", "torque", "back"),
    [
        pytest.param("2.2kW", 1.3, -1.0, 0.06, marks=pytest.mark.slow),
        pytest.param("4kW", 0.85, 1.0, 0.05, marks=pytest.mark.slow),
        pytest.param("4kW", 1.3, 1.0, 0.05, marks=pytest.mark.slow),
        pytest.param("11kW", 1.3, -1.0, 0.05, marks=pytest.mark.slow),
    ],
)
def test_a_winding_that_changes_at_speed_turns_no_field_and_is_found_on_the_way_back(
    drive: str, warmed: float, torque: float, back: float
) -> None:
    """Above ω_s = 0.2 nothing of the resistance is seen: its error must not go to the leakage instead.

    At 2.2 kW in regeneration the way back ends at ω_s = 0.024: at 0.014 three of eight realisations are lost,
    see the limits. Where it ends depends on the noise (4 kW warmed: 1.6 to 3.8°): the median of five
    realisations is judged.
    """
    motor, inverter = DRIVES[drive].motor, DRIVES[drive].inverter
    fast, slow = 0.6 * motor.base["omega_m"], back * motor.base["omega_m"]
    at_the_end, resistances = [], []
    for seed in SEEDS:
        result = sf.simulate(
            sf.Scenario(
                motor=motor,
                inverter=inverter,
                duration=56.0,
                record_every=50,
                omega_ref=[(0, 0), (2, 0), (4, fast), (44, fast), (47, slow)],
                load_torque=[(0, 0), (2.5, 0), (3, torque * motor.T_N)],
                changes=[(6.0, {"R_s": warmed * motor.R_s})],
                plant={"adc_bits": 12, "adc_noise": 0.004 * motor.I_N, "seed": seed},
            )
        )
        angle = np.abs(judge.angle(result))
        assert angle[(result.t > 10) & (result.t < 44)].max() < 3.0
        assert angle[result.t > 44].max() < 15.0
        at_the_end.append(angle[result.t > 54].max())
        resistances.append(result["estimate.R_s"][-1])
    assert np.median(at_the_end) < 3.0
    # One current shows one voltage in phase with it: how it divides between resistance and loss of the
    # bridge (a tenth of it at 4 kW) is decided by their priors. 5 to 8 % of the resistance are left there,
    # the field is right.
    assert np.median(resistances) == pytest.approx(warmed * motor.R_s + inverter.r_d, rel=0.09)
