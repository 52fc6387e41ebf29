//! The drive alone: faults, arbitrary measurements, random configurations, sensors.

mod faults;
mod fuzz;
mod robustness;
mod single_shunt;
mod two_sensors;
