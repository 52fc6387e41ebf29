"""What cannot be seen at zero stator frequency, and what the drive does about it.

Rated load where the stator frequency is zero: one direction of the flux error does not show in the
terminals. Kept there (`omega_s_min=0`), the expected deviation of the angle grows and the angle drifts, under
some realisations of the noise until the field is lost. By default the drive lowers its flux, the slip rises
and the field keeps turning.
"""

import math

import numpy as np

import stillflux as sf
from stillflux.plots import new_figure


def main() -> dict[str, sf.Result]:
    """Eleven seconds at that point, with and without the flux shift."""
    motor, inverter = sf.Motor.preset("11kW"), sf.Inverter.preset("11kW")
    psi_r = motor.base["psi"] * motor.L_M / motor.L_s
    slip = motor.T_N / (1.5 * motor.n_p) * motor.R_R / psi_r**2
    speed = -slip / motor.n_p
    base = sf.Scenario(
        motor=motor,
        inverter=inverter,
        duration=15.0,
        plant={"adc_bits": 12, "adc_noise": 0.004 * motor.I_N, "current_offset": 0.01 * motor.base["i"]},
        omega_ref=[(0.0, 0.0), (1.6, 0.0), (2.0, 20.0), (3.0, 20.0), (4.0, speed)],
        load_torque=[(0.0, 0.0), (2.4, 0.0), (2.8, motor.T_N)],
        signals=["angle_error", "omega_s", "psi_s", "estimate.angle_deviation", "status"],
        record_every=50,
    )
    runs = {"omega_s_min=0": base.with_settings(omega_s_min=0.0), "default": base}
    return {name: sf.simulate(run) for name, run in runs.items()}


if __name__ == "__main__":
    figure = new_figure(figsize=(7.2, 5.0), layout="constrained")
    axes = figure.subplots(2, 2, sharex=True, sharey="row")
    for (upper, lower), (name, result) in zip(axes.T, main().items(), strict=True):
        error = np.degrees(result["angle_error"])
        band = 2.0 * np.degrees(result["estimate.angle_deviation"])
        shown = result.t > 2.0
        upper.fill_between(result.t[shown], -band[shown], band[shown], alpha=0.3, label="± 2 σ expected")
        upper.plot(result.t[shown], error[shown], linewidth=0.9, label="true error")
        upper.set(title=name, ylim=(-30.0, 30.0), ylabel="field angle, °" if name != "default" else "")
        lower.plot(result.t[shown], result["omega_s"][shown] / (2.0 * math.pi), linewidth=0.9)
        lower.set(xlabel="time, s", ylabel="stator frequency, Hz" if name != "default" else "")
        print(f"{name}: angle error at most {np.abs(error[result.t > 4.5]).max():.1f}°")
    axes[0][0].legend(loc="lower left", fontsize="small")
    for panel in axes.flat:
        panel.grid(alpha=0.3)
    figure.savefig("observability.png", dpi=110)
