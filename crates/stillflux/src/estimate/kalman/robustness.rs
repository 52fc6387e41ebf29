//! Tests of what the filter does where its model does not hold: steps, lost angles, effects that it does not identify.

use super::model::{B, KNEE, PSI, RS, SCALE_PSI, V};
use super::reference::ClosedLoop;
use super::{Identified, NIS_CORNER, NIS_THRESHOLD, SIGMA_HALF, SIGMA_LOST};
use crate::params::{Inverter, Machine};
use crate::scalar::Integrator;

const ALL: Identified = Identified { offset: true, resistance: true, flux: true };

fn rig(identified: Identified) -> ClosedLoop {
    let inverter = Inverter { c_out: 0.0, ..Inverter::preset_11k() };
    ClosedLoop::identifying(&Machine::preset_11k(), &inverter, identified)
}

/// Runs under load to the end of a block.
fn to_the_end_of_a_block(rig: &mut ClosedLoop, periods: u32) {
    for _ in 0..periods {
        rig.step(0.05, 0.4);
    }
    while rig.filter.period != 9 {
        rig.step(0.05, 0.4);
    }
}

#[test]
fn one_large_innovation_counts_as_one_of_three_standard_deviations() {
    let mut rig = rig(ALL);
    to_the_end_of_a_block(&mut rig, 5000);
    let before = rig.filter.nis;
    rig.filter.m = Integrator::new(2.0);
    rig.step(0.05, 0.4);
    assert!(rig.filter.innovation().abs() > 0.5);
    assert!((rig.filter.nis - before - NIS_CORNER * (9.0 - before)).abs() < 1e-9, "{}", rig.filter.nis);
}

#[test]
fn no_block_corrects_by_more_than_an_innovation_of_one() {
    let mut corrected = [2.4, 2.8].map(|m| {
        let mut rig = rig(ALL);
        to_the_end_of_a_block(&mut rig, 5000);
        rig.filter.m = Integrator::new(m);
        let psi = rig.filter.value();
        rig.step(0.05, 0.4);
        assert!(rig.filter.innovation() > 1.0);
        rig.filter.value() - psi
    });
    corrected[1] = corrected[1] - corrected[0];
    assert!(corrected[0].norm_sq() > 1e-4, "it does correct");
    assert!(corrected[1].norm_sq() < 1e-12, "by the same");
}

#[test]
fn the_innovations_of_the_first_fifth_of_a_second_are_no_steps() {
    let mut rig = rig(ALL);
    let mut rises = None;
    for k in 0..4000 {
        rig.filter.m = Integrator::new(1.5);
        rig.step(0.05, 0.4);
        if rig.filter.nis > 0.0 {
            rises = rises.or(Some(k / 10));
        }
    }
    assert!(rises.is_some_and(|block| (199..=201).contains(&block)), "{rises:?}");
}

#[test]
fn doubt_comes_from_the_deviation_of_the_angle_and_from_innovations() {
    let mut rig = rig(ALL);
    for (sigma, nis, expected) in
        [(0.0, 0.0, 1.0), (SIGMA_HALF, 0.0, 0.5), (0.0, NIS_THRESHOLD, 0.5), (SIGMA_HALF, NIS_THRESHOLD, 1.0 / 3.0)]
    {
        (rig.filter.sigma, rig.filter.nis) = (sigma, nis);
        assert!((rig.filter.confidence() - expected).abs() < 1e-12, "{sigma}, {nis}");
    }
}

#[test]
fn a_lost_angle_begins_the_covariance_anew_and_leaves_the_states() {
    let mut rig = rig(ALL);
    to_the_end_of_a_block(&mut rig, 5000);
    let states = |rig: &ClosedLoop| (rig.filter.value(), rig.filter.b(), rig.filter.r_s(), rig.filter.v());
    let (before, prior) = (states(&rig), rig.c.noise.prior());
    rig.filter.sigma = 0.99 * SIGMA_LOST;
    let c = rig.c;
    let p = rig.filter.p;
    rig.filter.confine(&c);
    assert_eq!(rig.filter.p, p, "not lost yet");
    rig.filter.sigma = 1.01 * SIGMA_LOST;
    rig.filter.confine(&c);
    assert_eq!(states(&rig), before);
    // Half a radian of rated flux, in its scale.
    let again = (0.5 / SCALE_PSI) * (0.5 / SCALE_PSI);
    for (k, variance) in prior.into_iter().enumerate() {
        let expected = if k == PSI || k == PSI + 1 { again } else { variance };
        assert_eq!(rig.filter.p.get(k, k), expected, "state {k}");
        assert!((0..k).all(|j| rig.filter.p.get(k, j) == 0.0), "state {k} is correlated");
    }
}

#[test]
fn what_is_not_identified_stays_what_it_was() {
    for (offset, resistance) in [(false, true), (true, false), (false, false)] {
        let mut rig = rig(Identified { offset, resistance, flux: true });
        let c = rig.c;
        let r_s = rig.filter.r_s();
        for k in 0..20_000 {
            // A winding that steps: what is identified takes it up.
            rig.r_s = if k < 10_000 { 1.05 } else { 1.4 };
            rig.step(0.05, 0.5);
            rig.filter.confine(&c);
        }
        let f = &rig.filter;
        // Beside what the least variance of each state does.
        let moved = (f.b().norm_sq().sqrt(), (f.r_s() / r_s - 1.0).abs(), f.v().abs(), f.knee() - 1.0);
        assert!(if offset { moved.0 > 1e-4 } else { moved.0 < 1e-6 }, "{moved:?}");
        assert!(if resistance { moved.1 > 0.05 } else { moved.1 < 1e-6 && moved.2 < 1e-6 }, "{moved:?}");
        assert!(moved.3.abs() < 1e-6, "{moved:?}");
        assert_eq!(f.p.get(B, B) < 1e-6, !offset, "{}", f.p.get(B, B));
        for k in [RS, V, KNEE] {
            // Without a capacitance among the parameters there is no knee to find.
            let known = !resistance || k == KNEE;
            assert_eq!(f.p.get(k, k) < 1e-6, known, "state {k}: {}", f.p.get(k, k));
        }
    }
}
