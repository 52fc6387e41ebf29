//! Plant, closed loops of drive and plant, judged on the plant's truth, and commissioning.

mod calls;
mod commission;
mod drive;
mod encoder;
mod options;
mod plant;
mod realign;
mod restart;
mod rig;
mod single_shunt;
mod supervision;
mod timing;
mod tolerance;
mod two_sensors;
