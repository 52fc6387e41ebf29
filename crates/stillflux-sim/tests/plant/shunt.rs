//! A single shunt against phase currents sampled at the same instants.

use super::{Inverter, Machine, Plant, PlantParams, T_S, ideal_sensors, plant};
use stillflux::control::shunt::Pulses;
use stillflux_sim::Shunt;

/// Falling edges `m` half periods apart, legs in this order; duties near one half.
fn pulses([max, mid, min]: [usize; 3], m: f64, d: f64) -> Pulses<f64> {
    let (mut rising, mut falling) = ([d; 3], [d; 3]);
    (rising[max], falling[max]) = (d - m + 0.12, d + m);
    (rising[min], falling[min]) = (d + m - 0.08, d - m);
    Pulses { rising, falling, sample: [falling[mid], falling[max]] }
}

/// A machine with a shunt, and the same with a channel in each phase at the instants of the two samples.
fn pair(c_out: f64, settling: f64, p: &Pulses<f64>, [max, _, min]: [usize; 3]) -> (Plant, Plant) {
    let params = ideal_sensors(Machine::preset_2k2(), Inverter { c_out, ..Inverter::preset_2k2() });
    let mut channels = params;
    channels.adc.skew[min] = (1.0 - p.sample[0]) * 0.5 * T_S;
    channels.adc.skew[max] = (1.0 - p.sample[1]) * 0.5 * T_S;
    (plant(PlantParams { shunt: Some(Shunt { settling }), ..params }), plant(channels))
}

#[test]
fn the_shunt_reads_the_smallest_and_the_largest_phase_and_nothing_in_the_zero_vector() {
    for order in [[0, 1, 2], [1, 2, 0], [2, 0, 1], [0, 2, 1], [2, 1, 0], [1, 0, 2]] {
        for c_out in [0.0, 1e-9] {
            let p = pulses(order, 0.09, 0.5);
            let (mut shunt, mut channels) = pair(c_out, 0.0, &p, order);
            for period in 0..200 {
                let seen = shunt.step_pulses(&p, true, 0.0).i_abc;
                let i = channels.step_pulses(&p, true, 0.0).i_abc;
                if period > 5 {
                    let want = [-i[order[2]], i[order[0]], 0.0];
                    for (s, w) in seen.iter().zip(want) {
                        assert!((s - w).abs() < 1e-7, "{order:?} {c_out} {period}: {seen:?}, not {want:?}");
                    }
                }
            }
            assert!(channels.truth().i_s[0].hypot(channels.truth().i_s[1]) > 0.5);
        }
    }
}

#[test]
fn an_amplifier_too_slow_for_the_window_keeps_some_of_the_state_before() {
    let (order, settling) = ([0, 1, 2], 0.5e-6);
    let p = pulses(order, 0.09, 0.5);
    let (mut slow, _) = pair(0.0, settling, &p, order);
    let (mut quick, _) = pair(0.0, 0.0, &p, order);
    let (mut seen, mut want) = ([0.0; 3], [0.0; 3]);
    for _ in 0..300 {
        seen = slow.step_pulses(&p, true, 0.0).i_abc;
        want = quick.step_pulses(&p, true, 0.0).i_abc;
    }
    // Of the window of 4.5 µs the dead time is over after 2 µs; the current of the smallest leg, negative, frees the link
    // only then. And the current rises by 2/3 u_dc/L_σ in this state.
    let (machine, inverter) = (Machine::preset_2k2(), Inverter::preset_2k2());
    let kept = want[0] * (-2.5e-6 / settling).exp();
    let lag = 2.0 / 3.0 * inverter.u_dc / machine.L_sigma * settling;
    let error = want[0] - seen[0];
    assert!(want[0] > 0.5 && (error / (kept + lag) - 1.0).abs() < 0.1, "{error}, not {kept} + {lag}: {want:?}");
}

#[test]
fn a_shunt_in_the_average_model_or_with_a_double_update_is_refused_by_name() {
    let params = PlantParams::new(Machine::preset_2k2(), Inverter::preset_2k2());
    let with = |settling| PlantParams { shunt: Some(Shunt { settling }), ..params };
    let double = Inverter { half_periods: 1, ..params.inverter };
    for (field, p) in [
        ("shunt", with(-1.0)),
        ("half_periods", PlantParams { mode: stillflux_sim::Mode::Averaged, ..with(0.0) }),
        ("half_periods", PlantParams { inverter: double, ..with(0.0) }),
    ] {
        assert_eq!(Plant::new(p).unwrap_err().field, field);
    }
}
