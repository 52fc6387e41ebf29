//! Hands `memory.x` to the linker, wherever cargo runs, and computes the parameter page of the image.

#[path = "src/blob.rs"]
#[allow(dead_code)]
mod blob;

use std::path::Path;
use std::{env, fs};

use stillflux::config::Scheme;
use stillflux::page::Page;
use stillflux::scalar::{Q, Real};

fn main() {
    let out = env::var_os("OUT_DIR").expect("cargo sets OUT_DIR");
    let out = Path::new(&out);
    fs::write(out.join("memory.x"), include_bytes!("memory.x")).expect("OUT_DIR can be written");
    write_page::<f32>(out);
    write_page::<Q>(out);
    println!("cargo:rustc-link-search={}", out.display());
    println!("cargo:rerun-if-changed=memory.x");
    println!("cargo:rerun-if-changed=src/blob.rs");
}

/// The preset's page as the source of an array.
fn write_page<R: Real>(out: &Path) {
    let ready = blob::Parameters::preset(Scheme::default()).ready::<R>().expect("the preset is valid");
    let page = Page::seal(&ready);
    fs::write(out.join(format!("page-{}.rs", R::NAME)), format!("{:?}", page.words())).expect("OUT_DIR can be written");
}
