"""A log as a drive's firmware writes it, and what the estimators make of it."""

import numpy as np

import stillflux as sf


def record(motor: sf.Motor, inverter: sf.Inverter, path: str) -> None:
    """Phase currents, duties and dc link of three seconds, written as CSV. Replace this by your drive."""
    drive, plant = sf.Drive(motor, inverter), sf.Plant(motor, inverter, current_offset=0.05)
    i_abc, u_dc = plant.sample()
    rows = []
    for k in range(30_000):
        duty = drive.step(i_abc, u_dc, omega_ref=0.0 if k < 17_000 else 20.0)
        rows.append([k / inverter.f_s, *i_abc, *duty, u_dc])
        i_abc, u_dc = plant.step(duty, gates_on=drive.gates_on)
    header = "t [s],Iu,Iv,Iw,d_a,d_b,d_c,Udc [V]"
    np.savetxt(path, np.array(rows), delimiter=",", header=header, comments="", fmt="%.7g")


def main() -> sf.Replay:
    """Records, then replays."""
    motor, inverter = sf.Motor.preset("2.2kW"), sf.Inverter.preset("2.2kW")
    record(motor, inverter, "log.csv")
    columns = {"i_a": "Iu", "i_b": "Iv", "i_c": "Iw", "u_dc": "Udc [V]"}
    return sf.replay("log.csv", motor, inverter, columns=columns)


if __name__ == "__main__":
    found = main()
    print(found.summary())
    found.plot().savefig("log.png")
