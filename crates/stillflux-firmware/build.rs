//! Hands `memory.x` to the linker, wherever cargo runs, and computes the parameter page of the image.

#[path = "src/blob.rs"]
#[allow(dead_code)]
mod blob;
#[path = "src/page.rs"]
mod page;

use std::path::Path;
use std::{env, fs};

use stillflux::config::Scheme;
use stillflux::scalar::{Q, Real};
use stillflux::words::Words;

fn main() {
    let out = env::var_os("OUT_DIR").expect("cargo sets OUT_DIR");
    let out = Path::new(&out);
    fs::write(out.join("memory.x"), include_bytes!("memory.x")).expect("OUT_DIR can be written");
    write_page::<f32>(out);
    write_page::<Q>(out);
    println!("cargo:rustc-link-search={}", out.display());
    println!("cargo:rerun-if-changed=memory.x");
    println!("cargo:rerun-if-changed=src/blob.rs");
    println!("cargo:rerun-if-changed=src/page.rs");
}

/// The preset's page as the source of an array.
fn write_page<R: Real + Words>(out: &Path) {
    let ready = page::Ready::<R>::new(&blob::Parameters::preset(Scheme::default())).expect("the preset is valid");
    let page = page::Page::seal(&ready).expect("a page holds a configuration");
    fs::write(out.join(format!("page-{}.rs", R::NAME)), format!("{:?}", page.words())).expect("OUT_DIR can be written");
}
