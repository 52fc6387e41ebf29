"""What a bridge loses of its voltage: measured on the switching-level plant, and the law of the inverter
model.

A direct current through one phase; the difference between the commanded and the applied voltage, less the
devices' threshold and resistance, is what dead time and node capacitance take.
"""

import numpy as np

import stillflux as sf
from stillflux.plots import new_figure


def law(i: np.ndarray, inverter: sf.Inverter) -> np.ndarray:
    """Lost part of the dead-time voltage `u_dc T_d f_s`: 1 - I_k/2i above the knee, i/2I_k below."""
    knee = inverter.c_out * inverter.u_dc / inverter.dead_time
    return np.where(i >= knee, 1.0 - knee / (2.0 * np.maximum(i, 1e-9)), i / (2.0 * knee))


def measured(i: float, inverter: sf.Inverter) -> float:
    """The lost part at a direct current, mean over 50 periods of the settled plant."""
    ideal = inverter.replace(u_th=0.0, r_d=0.0, f_clk=0.0)
    # A machine of large leakage: the current is smooth within a period, as the law assumes.
    motor = sf.Motor.preset("2.2kW").replace(L_sigma=0.1, L_M=0.224, saturation=None)
    plant = sf.Plant(motor, ideal, speed=0.0)
    full = ideal.u_dc * ideal.dead_time * ideal.f_s
    part, lost = float(law(np.array([i]), ideal)[0]), []
    plant.set_state(psi_s=(motor.L_s * i) + 0j, psi_r=(motor.L_M * i) + 0j, omega_m=0.0)
    # Phases b and c carry half of the current back.
    half = float(law(np.array([i / 2.0]), ideal)[0])
    u = motor.R_s * i + full * (2.0 * part + 2.0 * half) / 3.0
    for k in range(400):
        phases = np.array([u, -u / 2.0, -u / 2.0])
        plant.step(0.5 + phases / ideal.u_dc)
        # Integral control of the current: the voltage that keeps it is the one that is asked for.
        u += 0.2 * (i - plant.state.i_s.real)
        if k >= 350:
            lost.append(u - motor.R_s * plant.state.i_s.real)
    # The space vector loses 2/3 in phase a and 1/3 in the two that carry half.
    return (float(np.mean(lost)) / full * 3.0 - 2.0 * half) / 2.0


def main() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Currents in A, measured and modelled loss."""
    inverter = sf.Inverter.preset("2.2kW")
    i = np.array([0.05, 0.1, 0.2, 0.3, 0.5, 0.8, 1.2, 2.0, 3.0, 5.0])
    return i, np.array([measured(float(x), inverter) for x in i]), law(i, inverter)


if __name__ == "__main__":
    current, found, expected = main()
    figure = new_figure(figsize=(6.4, 3.8), layout="constrained")
    panel = figure.subplots()
    fine = np.geomspace(0.02, 6.0, 200)
    panel.semilogx(fine, law(fine, sf.Inverter.preset("2.2kW")), label="law of the inverter model")
    panel.semilogx(current, found, "o", label="switching-level plant")
    panel.set(xlabel="phase current, A", ylabel="part of the dead-time voltage lost")
    panel.grid(alpha=0.3)
    panel.legend()
    figure.savefig("bridge_curve.png", dpi=110)
    print(f"largest difference {np.abs(found - expected).max():.3f} of the dead-time voltage")
