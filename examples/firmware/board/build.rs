//! Computes the parameter page of `src/machine.rs`, and hands `memory.x` to the linker.

#[path = "src/machine.rs"]
mod machine;

use std::path::Path;
use std::{env, fs};

use stillflux::page::{Page, Ready};
use stillflux::si::MemorySi;

fn main() {
    let out = env::var_os("OUT_DIR").expect("cargo sets OUT_DIR");
    let out = Path::new(&out);
    let (machine, inverter, params) = machine::parameters();
    let memory = MemorySi::of(&machine, &inverter);
    let ready = match Ready::<f32>::new(&machine, &inverter, &params, machine::FULL_SCALE, &memory) {
        Ok(ready) => ready,
        Err(e) => panic!("src/machine.rs: {e}"),
    };
    fs::write(out.join("page.rs"), format!("{:?}", Page::seal(&ready).words())).expect("OUT_DIR can be written");
    fs::write(out.join("memory.x"), include_bytes!("../memory.x")).expect("OUT_DIR can be written");
    println!("cargo:rustc-link-search={}", out.display());
    println!("cargo:rerun-if-changed=src/machine.rs");
    println!("cargo:rerun-if-changed=../memory.x");
}
