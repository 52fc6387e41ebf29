"""Your motor from a file: a run at low speed with a warm winding, and numbers of it."""

from pathlib import Path

import stillflux as sf

PUMP = Path(__file__).parent / "machines" / "pump-4kW.toml"


def main() -> sf.Result:
    """A start, a ramp to 0.05 pu, rated load."""
    machine = sf.load_machine(PUMP)
    motor = machine.motor
    return sf.simulate(
        sf.Scenario(
            motor=motor,
            inverter=machine.inverter,
            plant_motor=motor.replace(R_s=1.2 * motor.R_s),
            duration=3.0,
            omega_ref=[(0.0, 0.0), (1.7, 0.0), (2.0, 0.05 * motor.base["omega_m"])],
            load_torque=[(0.0, 0.0), (2.2, 0.0), (2.3, motor.T_N)],
            name=f"{machine.name}, rated load at 0.05 pu",
        )
    )


if __name__ == "__main__":
    result = main()
    print(result.summary())
    result.plot().savefig("own_motor.png")
