"""Plant: against scipy on the same equations, and its interface."""

from __future__ import annotations

import cmath
import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import stillflux as sf


@pytest.mark.parametrize("saturated", [False, True])
def test_agrees_with_solve_ivp(motor: sf.Motor, inverter: sf.Inverter, saturated: bool) -> None:
    """State error at most 1e-6 relative after a second of start-up at rated voltage under load."""
    g = motor.to_gamma()
    assert motor.saturation is not None
    L_u, a, S = motor.saturation

    def field(psi_s: complex, psi_r: complex) -> tuple[complex, float]:
        inverse = (1 + (a * abs(psi_s)) ** S) / L_u if saturated else 1 / g["L_s"]
        i_r = (psi_s - psi_r) / g["L_l"]
        return psi_s * inverse + i_r, 1.5 * motor.n_p * (psi_r.conjugate() * psi_s).imag / g["L_l"]

    def voltage(t: float) -> complex:
        return 200.0 * cmath.exp(2j * math.pi * 30.0 * t)

    def slope(x: np.ndarray, u: complex, load: float) -> list[float]:
        psi_s, psi_r, omega = complex(x[0], x[1]), complex(x[2], x[3]), x[4]
        i_s, torque = field(psi_s, psi_r)
        d_s = u - motor.R_s * i_s
        d_r = g["R_r"] / g["L_l"] * (psi_s - psi_r) + 1j * motor.n_p * omega * psi_r
        return [d_s.real, d_s.imag, d_r.real, d_r.imag, (torque - load) / motor.J]

    plant = sf.Plant(motor, inverter, saturation=saturated)
    dt, n = 1e-3, 1000
    x = np.zeros(5)
    for k in range(n):
        u, load = voltage(k * dt), 5.0 if k > 500 else 0.0
        plant.step_voltage(u, dt, load)
        x = solve_ivp(
            lambda _, x, u=u, load=load: slope(x, u, load),
            (0, dt),
            x,
            method="DOP853",
            rtol=1e-11,
            atol=1e-12,
        ).y[:, -1]
    state = plant.state
    assert state.t == pytest.approx(1.0)
    assert abs(state.psi_s - complex(x[0], x[1])) <= 1e-6 * abs(state.psi_s)
    i_s, torque = field(complex(x[0], x[1]), complex(x[2], x[3]))
    assert abs(state.i_s - i_s) <= 1e-6 * abs(i_s)
    assert state.omega_m == pytest.approx(x[4], rel=1e-6)
    assert state.torque == pytest.approx(torque, rel=1e-5)
    assert state.omega_m > 50.0


@pytest.mark.parametrize("backlash", [0.0, 0.02])
def test_a_load_behind_a_coupling_agrees_with_solve_ivp(
    motor: sf.Motor, inverter: sf.Inverter, backlash: float
) -> None:
    """Start-up at rated voltage, then a load: within what one torque a control period leaves."""
    g = motor.to_gamma()
    J_load = 2.0 * motor.J
    resonance = 2.0 * math.pi * 25.0
    reduced = motor.J * J_load / (motor.J + J_load)
    stiffness, damping = resonance**2 * reduced, 0.1 * resonance * reduced

    def load_torque(t: float) -> float:
        return 8.0 if t >= 0.3 else 0.0

    def slope(t: float, x: np.ndarray) -> list[float]:
        psi_s, psi_r = complex(x[0], x[1]), complex(x[2], x[3])
        i_r = (psi_s - psi_r) / g["L_l"]
        d_s = 200.0 * cmath.exp(2j * math.pi * 30.0 * t) - motor.R_s * (psi_s / g["L_s"] + i_r)
        d_r = g["R_r"] * i_r + 1j * motor.n_p * x[4] * psi_r
        torque = 1.5 * motor.n_p * (psi_r.conjugate() * psi_s).imag / g["L_l"]
        bent = x[6] - min(max(x[6], -backlash / 2), backlash / 2)
        shaft = stiffness * bent + damping * (x[4] - x[5]) if bent else 0.0
        speeds = [(torque - shaft) / motor.J, (shaft - load_torque(t)) / J_load, x[4] - x[5]]
        return [d_s.real, d_s.imag, d_r.real, d_r.imag, *speeds]

    plant = sf.Plant(
        motor, inverter, saturation=False, J_load=J_load, coupling=(stiffness, damping, backlash)
    )
    dt, n = 1e-4, 6000
    found = np.empty((n, 2))
    for k in range(n):
        # The mean of the voltage over the step.
        middle = (k + 0.5) * dt
        u = 200.0 * cmath.exp(2j * math.pi * 30.0 * middle) * np.sinc(30.0 * dt)
        plant.step_voltage(u, dt, load_torque(k * dt))
        found[k] = plant.state.omega_m, plant.state.omega_load
    t = dt * np.arange(1, n + 1)
    x = solve_ivp(slope, (0.0, n * dt), np.zeros(7), t_eval=t, max_step=dt, rtol=1e-7, atol=1e-9).y
    # They differ from each other by far more than from the solution.
    assert np.abs(found[:, 0] - found[:, 1]).max() > 5.0
    assert np.abs(found[:, 0] - x[4]).max() < 0.1
    assert np.abs(found[:, 1] - x[5]).max() < 0.1


def test_leakage_and_slots_follow_from_the_energy_of_the_field(
    motor: sf.Motor, inverter: sf.Inverter
) -> None:
    """Currents and torque as derivatives of the field's energy, by differences, over an inrush."""
    g = motor.to_gamma()
    share, current, Z, p, zigzag = 0.25, 8.0, 28, 0.01, 0.05
    knee = share / (1 - share) / ((1 - share) * g["L_l"] * current) ** 2

    def energy(psi_s: complex, psi_r: complex, theta: float) -> float:
        leak, slot = psi_s - psi_r, cmath.exp(-1j * Z * theta)
        gap = abs(psi_s) ** 2 * (1 + p * slot.real) / (2 * g["L_s"])
        linear = (abs(leak) ** 2 + zigzag * (leak**2 * slot).real) / (2 * g["L_l"])
        return 1.5 * (gap + linear + knee * abs(leak) ** 4 / (4 * g["L_l"]))

    def derivative(f: Callable[[float], float]) -> float:
        return (f(1e-4) - f(-1e-4)) / 2e-4

    def field(psi_s: complex, psi_r: complex, theta: float) -> tuple[complex, complex, float]:
        def gradient(f: Callable[[complex], float]) -> complex:
            return complex(derivative(f), derivative(lambda x: f(1j * x))) / 1.5

        i_s = gradient(lambda d: energy(psi_s + d, psi_r, theta))
        i_r = gradient(lambda d: energy(psi_s, psi_r + d, theta))
        # With the rotor's flux linkage held in the rotor.
        turned = 1e-2 / Z
        torque = -derivative(
            lambda x: (
                energy(psi_s, psi_r * cmath.exp(1j * motor.n_p * turned * x), theta + turned * x) / turned
            )
        )
        return i_s, i_r, torque

    def slope(t: float, x: np.ndarray, u: complex) -> list[float]:
        psi_s, psi_r, omega = complex(x[0], x[1]), complex(x[2], x[3]), x[4]
        i_s, i_r, torque = field(psi_s, psi_r, x[5])
        d_s = u - motor.R_s * i_s
        d_r = -g["R_r"] * i_r + 1j * motor.n_p * omega * psi_r
        return [d_s.real, d_s.imag, d_r.real, d_r.imag, torque / motor.J, omega]

    options: dict[str, Any] = {"leakage_saturation": (share, current), "slot_ripple": (Z, p, zigzag)}
    dt, n, begin = 1e-3, 50, 20.0

    def start(**given: Any) -> sf.Plant:
        plant = sf.Plant(motor, inverter, saturation=False, **given)
        plant.set_state(0j, 0j, begin)
        return plant

    plant, plain = start(**options), start()
    x = np.array([0.0, 0.0, 0.0, 0.0, begin, 0.0])
    for k in range(n):
        u = 200.0 * cmath.exp(2j * math.pi * 30.0 * k * dt)
        plant.step_voltage(u, dt)
        plain.step_voltage(u, dt)
        x = solve_ivp(slope, (0, dt), x, args=(u,), method="DOP853", rtol=1e-9, atol=1e-10).y[:, -1]
    i_s, _, torque = field(complex(x[0], x[1]), complex(x[2], x[3]), x[5])
    state = plant.state
    assert abs(state.psi_s - complex(x[0], x[1])) <= 1e-6 * abs(state.psi_s)
    assert abs(state.i_s - i_s) <= 1e-6 * abs(i_s)
    assert state.omega_m == pytest.approx(x[4], rel=1e-6)
    assert state.theta_m == pytest.approx(x[5], rel=1e-6)
    assert state.torque == pytest.approx(torque, rel=1e-5)
    assert abs(state.i_s - plain.state.i_s) > 0.02 * abs(i_s)


class Event:
    """Ends a stretch where a margin falls through zero."""

    terminal, direction = True, -1

    def __init__(self, margin: Callable[[np.ndarray], float]) -> None:
        self.margin = margin

    def __call__(self, _: float, x: np.ndarray) -> float:
        return self.margin(x)


class Reference:
    """Motor at constant speed on a bridge with node capacitance, each stretch between events by solve_ivp."""

    def __init__(
        self, motor: sf.Motor, inverter: sf.Inverter, psi: tuple[complex, complex], omega_m: float
    ) -> None:
        self.motor, self.inverter, self.gamma = motor, inverter, motor.to_gamma()
        self.omega = motor.n_p * omega_m
        self.x = np.array([psi[0].real, psi[0].imag, psi[1].real, psi[1].imag, 0.0, 0.0, 0.0])
        self.lower = [(-math.inf, False)] * 3
        # Whether a leg's node is held at its lower (1) or upper (-1) bound, or floats (0).
        self.held = [1 if i > 0 else -1 for i in self.currents(self.x)]
        self.x[4:] = [-inverter.u_th * h for h in self.held]
        self.t, self.period = 0.0, 1 / inverter.f_s

    def current(self, x: np.ndarray) -> complex:
        """Γ form: i_s of the state (psi_s, psi_r, v_a, v_b, v_c)."""
        psi_s, psi_r = complex(x[0], x[1]), complex(x[2], x[3])
        assert self.motor.saturation is not None
        L_u, a, S = self.motor.saturation
        return complex(psi_s * (1 + (a * abs(psi_s)) ** S) / L_u + (psi_s - psi_r) / self.gamma["L_l"])

    def currents(self, x: np.ndarray) -> list[float]:
        i = self.current(x)
        return [(i * cmath.exp(-2j * math.pi * k / 3)).real for k in range(3)]

    def slope(self, x: np.ndarray) -> list[float]:
        psi_s, psi_r, i_s = complex(x[0], x[1]), complex(x[2], x[3]), self.current(x)
        u = sum(2 / 3 * v * cmath.exp(2j * math.pi * k / 3) for k, v in enumerate(x[4:]))
        d_s = u - (self.motor.R_s + self.inverter.r_d) * i_s
        d_r = self.gamma["R_r"] / self.gamma["L_l"] * (psi_s - psi_r) + 1j * self.omega * psi_r
        dv = [
            0.0 if h else -i / self.inverter.c_out for h, i in zip(self.held, self.currents(x), strict=True)
        ]
        return [d_s.real, d_s.imag, d_r.real, d_r.imag, *dv]

    def bounds(self, on: list[bool | None]) -> list[tuple[float, float]]:
        u_dc, u_th = self.inverter.u_dc, self.inverter.u_th
        return [(u_dc - u_th if upper else -u_th, u_th if upper is False else u_dc + u_th) for upper in on]

    def runs_out(self, k: int) -> Event:
        return Event(lambda x: self.held[k] * self.currents(x)[k])

    def meets(self, k: int, bound: float, sign: float) -> Event:
        return Event(lambda x: sign * (float(x[4 + k]) - bound))

    def run(self, schedule: list[tuple[float, list[bool | None]]]) -> None:
        """Through gate states: each (until, per leg True: upper on, False: lower on, None: both off)."""
        for until, on in schedule:
            bounds = self.bounds(on)
            for k, (low, high) in enumerate(bounds):
                v, i = self.x[4 + k], self.currents(self.x)[k]
                self.x[4 + k] = min(max(v, low), high)
                if self.held[k] and v != (low if self.held[k] > 0 else high):
                    self.held[k] = 0
                if not self.held[k] and ((v < low and i > 0) or (v > high and i < 0)):
                    self.held[k] = 1 if i > 0 else -1
            while self.t < until:
                events: list[tuple[int, Event]] = []
                for k, (low, high) in enumerate(bounds):
                    if self.held[k]:
                        events.append((k, self.runs_out(k)))
                    else:
                        events += [(k, self.meets(k, low, 1.0)), (k, self.meets(k, high, -1.0))]
                out = solve_ivp(
                    lambda _, x: self.slope(x),
                    (self.t, until),
                    self.x,
                    method="DOP853",
                    events=[event for _, event in events],
                    rtol=1e-11,
                    atol=1e-13,
                    max_step=2e-6,
                )
                self.t, self.x = out.t[-1], out.y[:, -1]
                for (k, _), times in zip(events, out.t_events, strict=True):
                    if len(times) and self.held[k]:
                        self.held[k] = 0
                    elif len(times):
                        self.held[k] = 1 if self.x[4 + k] < 0.5 * sum(bounds[k]) else -1
                        self.x[4 + k] = bounds[k][0 if self.held[k] > 0 else 1]

    def step(self, duty: list[float], gates_on: bool) -> None:
        """One period of centred pulses."""
        begin, T = self.t, self.period
        if not gates_on:
            self.lower = [(-math.inf, False)] * 3
            self.run([(begin + T, [None] * 3)])
            return
        # Command edges as (time, level); the last one before this period is carried along.
        edges = [
            [carry, (begin + (1 - d) / 2 * T, True), (begin + (1 + d) / 2 * T, False)]
            for carry, d in zip(self.lower, duty, strict=True)
        ]
        dead = self.inverter.dead_time
        cuts = sorted({t + delay for leg in edges for t, _ in leg for delay in (0.0, dead)} | {begin + T})
        schedule = []
        for start, end in zip([begin, *cuts], [*cuts, math.inf], strict=True):
            if begin < end <= begin + T:
                middle = 0.5 * (max(start, begin) + end)
                last = [max((e for e in leg if e[0] <= middle), key=lambda e: e[0]) for leg in edges]
                schedule.append((end, [level if middle >= t + dead else None for t, level in last]))
        self.lower = [leg[-1] for leg in edges]
        self.run(schedule)


@pytest.mark.parametrize(
    ("c_out", "current", "speed", "voltage", "blocked"),
    [
        (1e-9, 0.1 + 0.02j, 0.0, 2.0, False),
        (1e-9, 4.0 - 1.0j, 10.0, 40.0, False),
        (0.2e-9, 0.02 + 0.4j, 5.0, 12.0, False),
        (5e-9, 1.0 + 2.0j, 60.0, 120.0, False),
        (1e-9, 2.0 + 2.0j, 120.0, 230.0, True),
        (0.2e-9, 3.0j, 0.0, 10.0, True),
    ],
)
def test_capacitive_edges_agree_with_solve_ivp(
    motor: sf.Motor, c_out: float, current: complex, speed: float, voltage: float, blocked: bool
) -> None:
    """Current within 1e-6 of I_N after each of eight periods: reversals, floating legs, blocked gates."""
    inverter = sf.Inverter(c_out=c_out, f_clk=0.0)
    plant = sf.Plant(motor, inverter, speed=speed, adc_bits=0)
    psi_r = 0.85 * cmath.exp(0.4j)
    plant.set_state(psi_r + motor.L_sigma * current, psi_r, speed)
    state = plant.state
    assert motor.saturation is not None
    L_u, a, S = motor.saturation
    leakage = motor.to_gamma()["L_l"] * (state.i_s - state.psi_s * (1 + (a * abs(state.psi_s)) ** S) / L_u)
    reference = Reference(motor, inverter, (state.psi_s, state.psi_s - leakage), speed)
    acting = [0.5] * 3
    for n in range(8):
        u = voltage * cmath.exp(1j * (0.7 + motor.n_p * speed * n / inverter.f_s))
        duty = [0.5 + (u * cmath.exp(-2j * math.pi * k / 3)).real / inverter.u_dc for k in range(3)]
        gates_on = not (blocked and 2 <= n < 6)
        plant.step(duty, gates_on=gates_on)
        reference.step(acting, gates_on)
        acting = duty
        assert abs(plant.state.i_s - reference.current(reference.x)) <= 1e-6 * motor.I_N, n
        assert abs(plant.state.psi_s - complex(*reference.x[:2])) <= 1e-7, n


def test_duties_act_one_period_later(motor: sf.Motor) -> None:
    plant = sf.Plant(motor, sf.Inverter(u_th=0.0, dead_time=0.0, f_clk=0.0), adc_bits=0)
    first, u_dc = plant.step([0.6, 0.5, 0.4])
    assert np.abs(first).max() < 1e-9
    second, _ = plant.step([0.5, 0.5, 0.5])
    assert second[0] > 0.05
    assert u_dc == pytest.approx(540.0, abs=810.0 / 4096)


def test_averaged_follows_switching(motor: sf.Motor, inverter: sf.Inverter) -> None:
    torques = []
    for mode in ("switching", "averaged"):
        plant = sf.Plant(motor, inverter, mode=mode, speed=0.0)
        for k in range(5000):
            u = 0.06 * cmath.exp(2j * math.pi * 2.0 * k / inverter.f_s)
            duty = [0.5 + (u * cmath.exp(-2j * math.pi * p / 3)).real for p in range(3)]
            plant.step(duty)
        torques.append(plant.state.torque)
    assert torques[0] == pytest.approx(torques[1], rel=0.03)


def test_a_reading_has_offset_noise_and_range_and_repeats_with_its_seed(
    motor: sf.Motor, inverter: sf.Inverter
) -> None:
    plant = sf.Plant(
        motor, inverter, current_offset=0.5j, adc_noise=0.01, adc_range=20.0, adc_bits=14, seed=3
    )
    twin = sf.Plant(motor, inverter, current_offset=0.5j, adc_noise=0.01, adc_range=20.0, adc_bits=14, seed=3)
    reading, _ = plant.sample()
    assert reading == pytest.approx([0.0, 0.5 * math.sqrt(0.75), -0.5 * math.sqrt(0.75)], abs=0.05)
    assert list(reading) == list(twin.sample()[0])
    plant.current_offset = (0.1, 0.2, 0.3)
    assert plant.sample()[0] == pytest.approx([0.1, 0.2, 0.3], abs=0.05)
    with pytest.raises(ValueError, match=r"current_offset = 21 A .* range -20 to 20 A"):
        plant.current_offset = (0.0, 21.0, 0.0)
    assert plant.current_offset == (0.1, 0.2, 0.3)


def test_what_is_set_of_a_plant_is_checked_and_its_state(motor: sf.Motor, inverter: sf.Inverter) -> None:
    plant = sf.Plant(motor, inverter)
    plant.R_s = 4.4
    plant.u_dc = 500.0
    plant.speed = 3.0
    plant.step([0.5] * 3)
    assert (plant.state.R_s, plant.state.u_dc, plant.state.omega_m) == (4.4, 500.0, 3.0)
    plant.set_state(1.0, 0.9j, 3.0)
    assert (plant.state.psi_s, plant.state.omega_m) == (1.0, 3.0)
    assert plant.state.psi_r == pytest.approx(0.9j)
    with pytest.raises(ValueError, match=r"R_s = -1 ohm .* range"):
        plant.R_s = -1.0
    with pytest.raises(ValueError, match="u_dc = NaN"):
        plant.u_dc = float("nan")


def test_what_a_plant_cannot_take_is_named(motor: sf.Motor, inverter: sf.Inverter) -> None:
    with pytest.raises(TypeError, match="'fricton'"):
        sf.Plant(motor, inverter, fricton=1.0)  # type: ignore[call-arg]
    with pytest.raises(ValueError, match=r"viscous = -1 .* range 0 to"):
        sf.Plant(motor, inverter, viscous=-1.0)
    with pytest.raises(ValueError, match=r"mode = .*'averaged'"):
        sf.Plant(motor, inverter, mode="mean")  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="load_torque = NaN"):
        sf.Plant(motor, inverter).step([0.5] * 3, load_torque=float("nan"))
    nan, plant = float("nan"), sf.Plant(motor, inverter)
    half = [0.5] * 3
    for step, expected in (
        (lambda: plant.step([nan, 0.5, 0.5]), "duty = NaN"),
        (lambda: plant.step(half, pulses=((nan,) * 3, (0.5,) * 3, (0.1, 0.2))), "pulses = NaN"),
        (
            lambda: plant.step(half, pulses=((0.5,) * 3, (0.5,) * 3, (0.1, 9.0))),
            r"pulses = 9 .* range 0 to 1",
        ),
        (lambda: plant.step_voltage(1e5, 1e-3), r"u_s = 100000 V .* range -4000 to 4000"),
    ):
        with pytest.raises(ValueError, match=expected):
            step()
    assert plant.state.i_s == 0.0


def test_imperfections_reach_the_plant(motor: sf.Motor, inverter: sf.Inverter) -> None:
    def current(**options: Any) -> complex:
        plant = sf.Plant(motor, inverter, speed=30.0, adc_bits=0, **options)
        for k in range(200):
            plant.step([0.5 + 0.1 * math.cos(2e-2 * k - 2.1 * p) for p in range(3)])
        return plant.state.i_s

    plain = current()
    for option in (
        {"turn_on_delay": [(1e-7, 0.0)] * 3},
        {"turn_off_delay": [(0.0, 3e-7), (0.0, 0.0), (1e-7, 0.0)]},
        {"iron_loss": (900.0, 150e-6)},
        {"deep_bar": (0.3, 0.6)},
        {"leakage_saturation": (0.25, 5.0)},
        {"slot_ripple": (28, 0.01, 0.05)},
        {"dc_link": (1e-3, 0.4, None)},
        {"dc_link": (1e-3, 0.4, None), "grid": (50.0, 0.5e-3)},
    ):
        assert 1e-3 < abs(current(**option) - plain) < 1.0, option
    # These change what is read or called, not the plant.
    calls = {"missed_calls": 0.0, "doubled_calls": 0.0}
    assert current(adc_skew=(0.0, 1e-6, 2e-6), **calls) == pytest.approx(plain, abs=1e-6)
    for name, value, text in (
        ("turn_off_delay", [(0.0, 4e-6)] * 3, "turn_off_delay = "),
        ("adc_skew", (0.0, 0.0, 1e-3), "adc_skew = "),
        ("iron_loss", (900.0, 1e-6), "time constant"),
        ("deep_bar", (0.0, 0.5), "conductance"),
        ("leakage_saturation", (0.7, 5.0), "leakage_saturation share = 0.7"),
        ("slot_ripple", (28, 0.3, 0.0), "slot_ripple permeance = 0.3"),
        ("grid", (50.0, 1e-3), "that is not given"),
        ("missed_calls", 1.5, "missed_calls = 1.5 is outside"),
        ("missed_calls", 0.1, "missed_calls = 0.1 is an option of the plant of a scenario"),
        ("doubled_calls", 0.1, "doubled_calls = 0.1 is an option of the plant of a scenario"),
    ):
        with pytest.raises(ValueError, match=text):
            sf.Plant(motor, inverter, **{name: value})  # type: ignore[arg-type]


def test_an_argument_is_named_with_its_value(motor: sf.Motor, inverter: sf.Inverter) -> None:
    make: Any = sf.Plant
    plant = make(motor, inverter)
    half = [0.5] * 3
    for call, text in (
        (lambda: plant.step(half, load_torque="a"), "load_torque = 'a' is not a number"),
        (lambda: plant.step(half, load_torque=None), "load_torque = None is not a number"),
        (lambda: plant.step(half, gates_on=1), "gates_on = 1 is neither True nor False"),
        (lambda: plant.step(half, pulses=5), r"pulses = 5 is not \(three half widths before"),
        (lambda: plant.step_voltage("x", 1e-4), "u_s = 'x' is not a number"),
        (lambda: plant.step_voltage(1j, "x"), "dt = 'x' is not a number"),
        (lambda: plant.set_state(1.0, "x", 0.0), "psi_r = 'x' is not a number"),
        (lambda: setattr(plant, "R_s", None), "R_s = None is not a number"),
        (lambda: setattr(plant, "u_dc", True), "u_dc = True is not a number"),
        (lambda: setattr(plant, "speed", "x"), "speed = 'x' is not a number"),
        (lambda: setattr(plant, "current_offset", "x"), "current_offset = 'x' is neither a complex"),
        (lambda: make(motor, inverter, seed=1.5), "seed = 1.5 is not a whole number from 0 to 1844"),
        (
            lambda: make(motor, inverter, turn_on_delay=3),
            "turn_on_delay = 3 is not a pair of numbers for",
        ),
    ):
        with pytest.raises(TypeError, match=text):
            call()
    plant.step(half, gates_on=np.True_, load_torque=np.float32(1.0))
