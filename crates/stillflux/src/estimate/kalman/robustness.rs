//! Tests of what the filter does where its model does not hold: steps, lost angles, effects that it does not identify.

use super::covariance::N;
use super::intermediate::{Gain, Intermediate};
use super::model::{B, BlockMeans, C_MAX, KNEE, PSI, RS, SCALE_PSI, V};
use super::reference::ClosedLoop;
use super::{
    B_MAX, FilterConfig, GAMMA_RANGE, Identified, KNEE_RANGE, LEAKAGE_RANGE, Learned, M_MAX, MAGNITUDE, NIS_THRESHOLD,
    R_S_RANGE, SIGMA_HALF, SIGMA_LOST, V_MAX,
};
use crate::base::PerUnit;
use crate::estimate::temperature::Temperature;
use crate::inverter::Distortion;
use crate::params::{Inverter, Machine};
use crate::scalar::Integrator;
use crate::space::{AlphaBeta, Rotator};

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
    while rig.filter.period != rig.c.block - 1 {
        rig.step(0.05, 0.4);
    }
}

#[test]
fn one_large_innovation_counts_as_one_of_three_standard_deviations() {
    let mut rig = rig(ALL);
    to_the_end_of_a_block(&mut rig, 5000);
    let before = rig.filter.signed_nis;
    rig.filter.m = Integrator::new(2.0);
    rig.step(0.05, 0.4);
    assert!(rig.filter.innovation() > 0.5);
    let after = rig.filter.signed_nis;
    assert!((after - before - rig.c.noise.nis_corner * (9.0 - before)).abs() < 1e-9, "{after}");
}

#[test]
fn an_innovation_that_alternates_is_no_contradiction_and_one_that_stays_is() {
    let parts = [[0.02, 0.02], [0.02, -0.02]].map(|innovations| {
        let mut rig = rig(ALL);
        to_the_end_of_a_block(&mut rig, 5000);
        let mut squares = 0.0;
        for block in 0..200 {
            let psi_r = rig.filter.value() - rig.filter.i_s * rig.filter.sigma_l_s(&rig.c);
            rig.filter.m = Integrator::new(psi_r.norm_sq().sqrt() + innovations[block % 2]);
            let inv_s = rig.filter.inv_s;
            to_the_end_of_a_block(&mut rig, 1);
            let z = rig.filter.innovation;
            squares += rig.c.noise.nis_corner * (z * z * inv_s * rig.c.noise.part - squares);
        }
        rig.filter.nis() / squares
    });
    // What is left: a low-pass of ten blocks, and what `m` moves within a block.
    assert!(parts[0] > 0.99 && parts[1] < 0.25, "{parts:?} of the mean squares");
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
        if rig.filter.nis() > 0.0 {
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
        (rig.filter.sigma, rig.filter.signed_nis) = (sigma, nis);
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

#[test]
fn no_correction_takes_a_state_out_of_its_range() {
    let rig = rig(ALL);
    let (c, r_s) = (rig.c, rig.c.model.r_s);
    for (sign, k) in [(-1.0, 0), (1.0, 1)] {
        let of = |range: (f64, f64)| [range.0, range.1][k];
        let mut f = rig.filter;
        f.inv_s = 1.0;
        f.intermediate = Intermediate::Gain(Gain { ph: [sign * 1e5; N] });
        f.correct(&c, 1.0);
        f.correct_parameters(&c);
        assert_eq!(f.m.value(), of((0.0, M_MAX)));
        assert_eq!(f.b(), AlphaBeta::new(sign * B_MAX, sign * B_MAX));
        assert!((f.r_s() / r_s - of(R_S_RANGE)).abs() < 1e-12);
        assert_eq!([f.v(), f.knee(), f.leakage()], [sign * V_MAX, of(KNEE_RANGE), of(LEAKAGE_RANGE)]);
        assert_eq!([f.gamma.value(), f.c.value()], [of(GAMMA_RANGE), of((0.0, C_MAX))]);
    }
}

#[test]
fn a_memory_is_taken_back_within_the_ranges() {
    let rig = rig(ALL);
    let (c, r_s) = (rig.c, rig.c.model.r_s);
    for (sign, k) in [(-1.0, 0), (1.0, 1)] {
        let of = |range: (f64, f64)| [range.0, range.1][k];
        let mut f = rig.filter;
        let far = if k == 0 { 0.0 } else { 99.0 };
        let b = AlphaBeta::new(sign, -sign);
        f.restore(&c, &Learned { b, r_s: far * r_s, v: sign * 9.0, knee: far, leakage: far, gamma: far });
        let Learned { b, r_s: restored, v, knee, leakage, gamma } = f.learned();
        assert_eq!(b, AlphaBeta::new(sign * B_MAX, -sign * B_MAX));
        assert!((restored / r_s - of(R_S_RANGE)).abs() < 1e-12);
        assert_eq!([v, knee, leakage, gamma], [sign * V_MAX, of(KNEE_RANGE), of(LEAKAGE_RANGE), of(GAMMA_RANGE)]);
    }
}

#[test]
fn a_start_keeps_what_was_identified() {
    let mut rig = rig(ALL);
    to_the_end_of_a_block(&mut rig, 20_000);
    let (c, learned) = (rig.c, rig.filter.learned());
    assert!((learned.r_s / c.model.r_s - 1.0).abs() > 0.02 && learned.b != AlphaBeta::default());
    rig.filter.start(&c, &AlphaBeta::default());
    assert_eq!(rig.filter.learned(), learned);
}

#[test]
fn a_flux_without_a_direction_corrects_nothing() {
    for (magnitude, used) in [(0.09, false), (0.11, true)] {
        let mut rig = rig(ALL);
        to_the_end_of_a_block(&mut rig, 5000);
        let c = rig.c;
        let n = Rotator::of(&rig.filter.rotor_flux(&c)).0.axis();
        rig.filter.psi_s.set(n * magnitude + rig.filter.i_s() * rig.filter.sigma_l_s(&c));
        let (m, b) = (rig.filter.m.value(), rig.filter.b());
        rig.step(0.05, 0.4);
        let psi_r = rig.filter.rotor_flux(&c).norm_sq().sqrt();
        assert!((psi_r - magnitude).abs() < 0.1, "{psi_r}");
        assert_eq!(rig.filter.b() != b, used, "{magnitude}");
        assert_eq!((rig.filter.m.value() - psi_r).abs() < 1e-3 * m, !used, "{magnitude}");
    }
}

#[test]
fn the_model_is_followed_up_to_a_load_angle_and_a_saturation() {
    let rig = rig(ALL);
    let model = &rig.c.model;
    let at = |i_q: f64| {
        let means = BlockMeans {
            n: Rotator::default(),
            inv_psi_r: 1.0,
            i_d: 0.4,
            i_q,
            i_s: AlphaBeta::new(0.4, i_q),
            d_leakage_flux: AlphaBeta::default(),
            loss: Distortion::default(),
            omega_s: 0.1,
            steady: true,
        };
        model.operating_point(&means, model.magnetisation(1.0, 1.0, 0.2), 1.0, 1.0).0.turn / model.r_r_block
    };
    assert_eq!([1.5, 5.0, -1.5, -5.0].map(at), [1.5, 2.0, -1.5, -2.0]);
    let bend = |m: f64| model.curve(m, 0.2).bend;
    let rated = 1.0 / model.inv_m_rated;
    assert!(bend(rated).abs() < 1e-9);
    assert!((bend(2.9) - 7.0).abs() < 1e-9 && (bend(2.5) - 7.0).abs() < 1e-9, "eight times: {}", bend(2.9));
}

#[test]
fn the_weight_of_the_flux_falls_to_one_half_at_the_deviation_of_a_flux_by_current_alone() {
    for (deviation, weight) in [(MAGNITUDE, 0.5), (3.0 * MAGNITUDE, 0.1), (0.01 * MAGNITUDE, 1.0)] {
        let mut rig = rig(ALL);
        to_the_end_of_a_block(&mut rig, 5000);
        while rig.filter.period + 1 != 7 << rig.c.slot_bits {
            rig.step(0.05, 0.4);
        }
        let mut variance = [1e-6; N];
        variance[PSI] = (deviation / SCALE_PSI) * (deviation / SCALE_PSI);
        variance[PSI + 1] = variance[PSI];
        rig.filter.p.set_diagonal(&variance);
        rig.step(0.05, 0.4);
        assert!((rig.filter.magnitude_weight() - weight).abs() < 1e-3, "{}", rig.filter.magnitude_weight());
    }
}

#[test]
fn a_phase_counts_as_near_zero_within_the_swing_of_a_dead_time_and_a_least_width() {
    let machine = Machine::preset_11k();
    for (dead_time, width) in [(0.0, 2e-3), (2e-6, 0.0)] {
        let inverter = Inverter { dead_time, c_out: 0.0, ..Inverter::preset_11k() };
        let pu = PerUnit::new(&machine, &inverter).unwrap();
        let c = FilterConfig::<f64>::new(&machine, &inverter, &pu, 1.0, true, ALL);
        let width = width + pu.dead_time_swing;
        assert!(c.noise.near_zero(0.99 * width) && !c.noise.near_zero(1.01 * width), "{width}");
    }
}

#[test]
fn a_predicted_resistance_keeps_its_correlation_unless_it_is_less_known_than_the_prediction() {
    let (machine, inverter) = (Machine::preset_11k(), Inverter { c_out: 0.0, ..Inverter::preset_11k() });
    let pu = PerUnit::new(&machine, &inverter).unwrap();
    let known = Temperature { winding: 20.0, cage: 225.0, rotor_rise: 1.0, heat: Some((100.0, 600.0)) };
    for (times, kept) in [(1.0, true), (1.9, true), (2.1, false), (50.0, false)] {
        let mut rig = rig(ALL);
        rig.c = rig.c.with_temperature(&machine, &inverter, &pu, &known);
        to_the_end_of_a_block(&mut rig, 10_000);
        for _ in 0..200 {
            rig.step(0.35, 0.4);
        }
        while rig.filter.period + 1 != 6 << rig.c.slot_bits {
            rig.step(0.35, 0.4);
        }
        let scaled = rig.c.temperature.deviation().unwrap() / super::model::SCALE_R;
        let own = rig.filter.p.get(RS, RS);
        rig.filter.p.add_at(RS, RS, times * scaled * scaled - own);
        assert!(rig.filter.p.get(PSI, RS) != 0.0);
        rig.step(0.35, 0.4);
        assert_eq!(rig.filter.p.get(PSI, RS) != 0.0, kept, "{times} times its variance");
        assert!(rig.filter.p.get(RS, RS) <= times.max(1.0) * scaled * scaled * (1.0 + 1e-9), "grows no further");
    }
}
