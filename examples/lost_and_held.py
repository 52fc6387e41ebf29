"""Rated load near zero stator frequency, a winding 10 % warmer than known, and an offset of the current
sensors that steps by 1 % along β: the published scheme is lost, the enhanced one holds. An animation of the
flux.

With a step along α both are lost (docs/limits.md)."""

import numpy as np
from matplotlib.animation import FuncAnimation, PillowWriter
from matplotlib.figure import Figure

import stillflux as sf


def main() -> dict[str, sf.Result]:
    """Both schemes at - 0.03 pu; the offset steps after five seconds."""
    motor = sf.Motor.preset("2.2kW")
    fast = 0.1 * motor.base["omega_m"]
    base = sf.Scenario(
        motor=motor,
        inverter=sf.Inverter.preset("2.2kW"),
        duration=16.0,
        plant_motor=motor.replace(R_s=1.1 * motor.R_s),
        plant={"adc_bits": 12, "adc_noise": 0.02, "current_offset": 0.05},
        omega_ref=[(0.0, 0.0), (1.6, 0.0), (2.0, fast), (3.5, fast), (4.5, -0.3 * fast)],
        changes=[(5.0, {"current_offset": 0.05 + 0.01j * motor.base["i"]})],
        load_torque=[(0.0, 0.0), (2.4, 0.0), (2.8, motor.T_N)],
        signals=["psi_s", "estimate.psi_s", "angle_error", "status"],
    )
    return {scheme: sf.simulate(base.replace(scheme=scheme)) for scheme in ("paper", "enhanced")}


def animate(runs: dict[str, sf.Result], path: str) -> None:
    """True and estimated flux vector of each run, five pictures a second of the run."""
    figure = Figure(figsize=(7.2, 4.2), layout="constrained")
    panels, lines = figure.subplots(1, 2), []
    for panel, scheme in zip(panels, runs, strict=True):
        panel.set(xlim=(-1.5, 1.5), ylim=(-1.5, 1.5), aspect="equal", title=f'scheme="{scheme}"\n')
        panel.grid(alpha=0.3)
        lines.append(
            [panel.plot([], [], color=c, label=n)[0] for c, n in (("C0", "true"), ("C1", "estimated"))]
        )
        panel.set_xlabel("α, V·s")
    panels[0].set_ylabel("β, V·s")
    panels[0].legend(loc="upper left", fontsize="small")
    figure.draw_without_rendering()
    figure.set_layout_engine("none")
    length = min(len(result.t) for result in runs.values())

    def show(k: int) -> None:
        for panel, pair, (scheme, result) in zip(panels, lines, runs.items(), strict=True):
            path = slice(max(0, k - 400), k + 1)
            for line, name in zip(pair, ("psi_s", "estimate.psi_s"), strict=True):
                psi = result[name][path]
                line.set_data(np.append(psi.real, 0.0), np.append(psi.imag, 0.0))
            off = np.degrees(abs(result["angle_error"][k]))
            panel.set_title(f'scheme="{scheme}"\nt = {result.t[k]:.1f} s, field angle {off:.0f}° off')

    frames = range(4000, length, 200)
    FuncAnimation(figure, show, frames=frames).save(path, writer=PillowWriter(fps=8), dpi=80)


if __name__ == "__main__":
    found = main()
    for scheme, result in found.items():
        error = np.degrees(np.abs(result["angle_error"]))
        print(f"{scheme}: {result.status}, field angle {error[result.t > 5.0].max():.1f}° off at most")
    animate(found, "lost_and_held.gif")
