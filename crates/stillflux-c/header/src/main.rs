//! Writes `stillflux.h`: `stillflux-c-header TO`. Declarations and comments are those of `../src/lib.rs`; the size of
//! the state and the numbers of the faults are those of the core in this build.

use std::error::Error;
use std::path::Path;

use cbindgen::{Builder, Config, DocumentationStyle, ExportConfig, FunctionConfig, Language, Style};
use stillflux::drive::Fault;
use stillflux::interrupt::CountsDrive;

#[cfg(not(feature = "q"))]
type Arithmetic = f32;
#[cfg(feature = "q")]
type Arithmetic = stillflux::scalar::Q;

/// As the library lays the state out: a word, then the drive. Aligned as the union of the header in every arithmetic.
#[repr(C, align(8))]
struct State {
    open: u32,
    drive: CountsDrive<Arithmetic>,
}

const HEAD: &str = "\
/* stillflux: sensorless induction motor control. C99, no dependency.
 *
 * One control period is stillflux_period(), called in the interrupt of the current conversion. No function allocates,
 * waits or keeps a pointer. No pointer may be null. The state of a drive is used by one context at a time: the control
 * interrupt, or the main loop while that interrupt cannot run.
 *
 * Not here: self-commissioning, priors and switches of the estimators. They are in the Rust library; a page that a host
 * makes with it holds the latter for this library, too.
 *
 * Generated from crates/stillflux-c/src/lib.rs. */
";

fn main() -> Result<(), Box<dyn Error>> {
    let to = std::env::args().nth(1).ok_or("usage: stillflux-c-header TO")?;
    let source = Path::new(env!("CARGO_MANIFEST_DIR")).join("../src/lib.rs");
    let config = Config {
        language: Language::C,
        header: Some(HEAD.into()),
        include_guard: Some("STILLFLUX_H".into()),
        no_includes: true,
        after_includes: Some(state()),
        cpp_compat: true,
        style: Style::Both,
        line_length: 110,
        documentation_style: DocumentationStyle::C99,
        export: ExportConfig { exclude: vec!["stillflux_drive".into(), "OPEN".into()], ..ExportConfig::default() },
        function: FunctionConfig { must_use: None, ..FunctionConfig::default() },
        usize_is_size_t: true,
        ..Config::default()
    };
    let bindings = Builder::new().with_config(config).with_src(source).generate()?;
    let mut text = Vec::new();
    bindings.write(&mut text);
    // Written only where it changes: what depends on it is then not built again.
    if std::fs::read(&to).ok().as_deref() != Some(&text) {
        std::fs::write(&to, text)?;
    }
    Ok(())
}

/// Includes, the state, and the faults.
fn state() -> String {
    let mut text = format!(
        "#include <stddef.h>\n#include <stdint.h>\n\n\
         /* 1: this library computes in fixed point, 0: in single precision. */\n#define STILLFLUX_Q {}\n\n\
         /* Bytes of a drive's state. */\n#define STILLFLUX_DRIVE_BYTES {}\n\n\
         /* A drive: state of known size, without pointers; it may be copied and moved. All zero is no drive, which \
         blocks\n * the bridge. */\n\
         typedef union stillflux_drive {{\n  uint64_t align;\n  uint8_t bytes[STILLFLUX_DRIVE_BYTES];\n}}\n\
         #if defined(__GNUC__) /* i386 aligns an uint64_t to 4 bytes. */\n__attribute__((aligned(8)))\n#endif\n\
         stillflux_drive;\n\n",
        u8::from(cfg!(feature = "q")),
        size_of::<State>(),
    );
    for fault in Fault::ALL {
        let name: String = fault
            .to_string()
            .chars()
            .map(|c| if c.is_ascii_alphanumeric() { c.to_ascii_uppercase() } else { '_' })
            .collect();
        text += &format!("/* Fault: {fault}. */\n#define STILLFLUX_FAULT_{name} {}\n", fault.code());
    }
    text
}
