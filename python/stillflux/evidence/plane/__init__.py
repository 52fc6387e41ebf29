"""The targets of the torque-speed plane, one a file: runs, claims and what its table shows."""
