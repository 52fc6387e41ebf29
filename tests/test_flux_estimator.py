"""FluxEstimator over records."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import stillflux as sf

OMEGA = 2 * np.pi * 1.5


def record(motor: sf.Motor, inverter: sf.Inverter, offset: complex, n: int) -> tuple[np.ndarray, ...]:
    """Voltage, current and flux of a machine turning steadily; the voltage carries an offset."""
    t = np.arange(n) / inverter.f_s
    psi = motor.base["psi"] * np.exp(1j * OMEGA * t)
    i = (3.0 + 1.0j) * np.exp(1j * OMEGA * t)
    u = np.zeros(n, complex)
    u[1:] = np.diff(psi) * inverter.f_s + motor.R_s * (i[1:] + i[:-1]) / 2
    return u + offset, i, psi


def test_clean_record_gives_the_flux(motor: sf.Motor, inverter: sf.Inverter) -> None:
    u, i, psi = record(motor, inverter, 0j, 40_000)
    trace = sf.FluxEstimator(motor, inverter).run(u, i)
    assert trace.psi_s == pytest.approx(psi, rel=1e-5)
    # Not bit for bit: the arctangents of the C library (within 1 ulp) and of numpy's vector kernels (within
    # 4 ulp, chosen by what the processor has) round differently.
    np.testing.assert_array_max_ulp(trace.angle, np.angle(trace.psi_s), maxulp=5)
    assert trace.omega_s[-1] == pytest.approx(OMEGA, rel=1e-3)
    assert len(trace.t) == len(u)


def test_offset_is_found(motor: sf.Motor, inverter: sf.Inverter) -> None:
    u, i, psi = record(motor, inverter, 0.05 - 0.03j, 150_000)
    trace = sf.FluxEstimator(motor, inverter, offset_gain=0.5).run(u, i, omega_s=OMEGA, psi_s0=psi[0])
    assert trace.u_off[-1] == pytest.approx(0.05 - 0.03j, rel=0.03)
    assert np.degrees(np.abs(np.angle(trace.psi_s[-1000:] / psi[-1000:])).max()) < 1.0


def test_a_constant_gives_what_a_series_of_it_does(motor: sf.Motor, inverter: sf.Inverter) -> None:
    u, i, _ = record(motor, inverter, 0j, 100)
    estimator = sf.FluxEstimator(motor, inverter)
    constant = estimator.run(u, i, R_s=3.0, omega_s=1.0)
    series = estimator.run(u, i, R_s=np.full(100, 3.0), omega_s=np.ones(100))
    assert np.array_equal(constant.psi_s, series.psi_s)
    assert len(estimator.run(u[:0], i[:0]).t) == 0


def test_a_record_that_does_not_fit_is_named(motor: sf.Motor, inverter: sf.Inverter) -> None:
    u, i, _ = record(motor, inverter, 0j, 100)
    estimator = sf.FluxEstimator(motor, inverter)
    with pytest.raises(ValueError, match="i_s has 99 samples, u_s has 100"):
        estimator.run(u, i[:-1])
    i[7] = np.nan
    with pytest.raises(ValueError, match=r"i_s\[7\]"):
        estimator.run(u, i)


def test_records_may_be_of_other_types_but_mean_what_they_say(motor: sf.Motor, inverter: sf.Inverter) -> None:
    u, i, _ = record(motor, inverter, 0j, 100)
    estimator: Any = sf.FluxEstimator(motor, inverter)
    exact = estimator.run(u, i, omega_s=np.ones(100)).psi_s
    assert np.array_equal(estimator.run(list(u), list(i), omega_s=[1] * 100).psi_s, exact)
    assert estimator.run(u.astype(np.complex64), i, omega_s=1).psi_s == pytest.approx(exact, rel=1e-4)
    with pytest.raises(TypeError, match="omega_s is complex, real numbers are needed"):
        estimator.run(u, i, omega_s=np.ones(100, complex))
    with pytest.raises(ValueError, match="omega_s has masked values, numbers are needed"):
        estimator.run(u, i, omega_s=np.ma.masked_greater(np.arange(100.0), 98.0))
    with pytest.raises(TypeError, match="u_s is not an array of one dimension"):
        estimator.run(u.reshape(2, 50), i)
    with pytest.raises(ValueError, match=r"R_s\[3\] = inf is not finite"):
        estimator.run(u, i, R_s=[3.0] * 3 + [np.inf] * 97)
    with pytest.raises(ValueError, match="psi_s0 = NaN"):
        estimator.run(u, i, psi_s0=complex("nan"))


def test_with_the_inverter_model_the_voltage_is_that_of_the_bridge(motor: sf.Motor) -> None:
    inverter = sf.Inverter(c_out=0.0)
    u, i, psi = record(motor, inverter, 0j, 20_000)
    # Of every phase threshold and dead time are lost in the direction of its current, and r_d i.
    mean = np.concatenate((i[:1], (i[1:] + i[:-1]) / 2))
    axes = np.exp(2j * np.pi / 3 * np.arange(3))
    volts = inverter.u_th + inverter.u_dc * inverter.dead_time * inverter.f_s
    lost = sum(2 / 3 * axis * volts * np.sign((mean * np.conj(axis)).real) for axis in axes)
    bridge = u + lost + inverter.r_d * mean
    off: Any = {"offset_estimator": False, "noise_compensator": False}
    modelled = sf.FluxEstimator(motor, inverter, inverter_model=True, **off).run(bridge, i, psi_s0=psi[0])
    assert np.abs(modelled.psi_s - psi).max() < 0.02 * np.abs(psi[0])
    ignored = sf.FluxEstimator(motor, inverter, inverter_model=False, **off).run(bridge, i, psi_s0=psi[0])
    assert np.abs(ignored.psi_s - psi).max() > 0.2 * np.abs(psi[0])


def test_a_negative_resistance_or_link_is_refused(motor: sf.Motor, inverter: sf.Inverter) -> None:
    u, i, _ = record(motor, inverter, 0j, 10)
    estimator = sf.FluxEstimator(motor, inverter)
    with pytest.raises(ValueError, match=r"R_s\[0\] = -1 is outside the admissible range from 0 on"):
        estimator.run(u, i, R_s=-1.0)
    with pytest.raises(ValueError, match=r"u_dc\[3\] = -540 is outside the admissible range from 0 on"):
        estimator.run(u, i, u_dc=np.where(np.arange(10) == 3, -540.0, 540.0))
    with pytest.raises(TypeError, match="psi_s0 = 'a' is not a number"):
        estimator.run(u, i, psi_s0="a")  # type: ignore[arg-type]
