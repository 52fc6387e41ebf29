//! x
use stillflux::params::{Inverter, Machine};
use stillflux_sim::{Plant, PlantParams};
fn main(){ let mut p=PlantParams::new(Machine::preset_2k2(),Inverter::preset_2k2()); p.saturation=false; p.mechanics.speed=Some(0.14);
 let mut pl=Plant::new(p).unwrap(); let omega=6.283; let inv=Inverter::preset_2k2();
 for k in 0..40000 { let a = omega * k as f64 * 1e-4; let u=omega+30.;
   pl.step([0.0, 1.0, 2.0].map(|p| 0.5 + u / inv.u_dc * (a - p * std::f64::consts::TAU / 3.0).cos()),true,0.);
   if k%1000==0 {println!("{:?} {:?}", pl.phase_currents(), pl.truth().psi_s);} }
 }
