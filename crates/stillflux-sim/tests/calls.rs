//! Control calls that do not come or come twice: the drive's clock goes by its calls.

use std::borrow::Cow;

use stillflux::drive::Status;
use stillflux::params::{Inverter, Machine};
use stillflux_sim::Calls;
use stillflux_sim::simulate::{Run, Scenario};

/// Time until the drive runs, s.
fn start(calls: Calls) -> f64 {
    let mut s = Scenario::new(Machine::preset_2k2(), Inverter::preset_2k2(), 4.0);
    s.plant.calls = calls;
    s.signals = Some(vec![]);
    let mut run = Run::new(Cow::Owned(s)).unwrap();
    while run.drive().status() != Status::Running {
        assert!(run.advance(1), "never ran, {:?}", run.drive().status());
    }
    run.time()
}

#[test]
fn a_drives_time_passes_by_its_calls() {
    let nominal = start(Calls::default());
    for (missed, doubled) in [(0.2, 0.0), (0.0, 0.2), (0.1, 0.1)] {
        let time = start(Calls { missed, doubled });
        let want = nominal / (1.0 - missed + doubled);
        // Some 10⁴ calls: their number scatters by 0.4 %.
        assert!((time / want - 1.0).abs() < 0.02, "{missed} {doubled}: {time} s, {want} s expected");
    }
}

#[test]
fn probabilities_are_checked() {
    let field = |missed, doubled| {
        let mut s = Scenario::new(Machine::preset_2k2(), Inverter::preset_2k2(), 1.0);
        s.plant.calls = Calls { missed, doubled };
        Run::new(Cow::Owned(s)).err().map(|e| e.field())
    };
    assert_eq!(field(-0.1, 0.0), Some("missed_calls"));
    assert_eq!(field(0.5, 0.6), Some("doubled_calls"));
    assert_eq!(field(0.5, 0.5), None);
}
