"""A tolerance sweep on a Dask cluster: here one on this machine, `Client("tcp://…:8786")` for any other."""

from dask.distributed import Client, LocalCluster

import stillflux as sf


def main() -> sf.Sweep:
    """Eight machines drawn within their tolerances."""
    motor = sf.Motor.preset("2.2kW")
    base = sf.Scenario(
        motor=motor,
        inverter=sf.Inverter.preset("2.2kW"),
        duration=2.6,
        omega_ref=[(0.0, 0.0), (1.6, 0.0), (1.9, 15.0)],
        load_torque=[(0.0, 0.0), (2.0, 0.0), (2.1, 10.0)],
        signals=["angle_error", "status", "omega_m", "reference", "estimate.confidence"],
    )
    points = sf.draws(
        base, 8, {"plant_motor.R_s": sf.normal(0.07), "plant_motor.R_R": sf.uniform(0.2)}, seed=1
    )
    with (
        LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None) as cluster,
        Client(cluster) as client,
    ):
        return sf.sweep(points, ["angle_max", "confidence_min"], executor=client, resume="sweep_dask.jsonl")


if __name__ == "__main__":
    found = main()
    print(found.summary())
    found.save("sweep_dask.csv")
    found.spread().savefig("sweep_dask.png")
