//! The functions that take pointers, as a C program calls them: for Miri (`make miri`), which sees what a compiler does
//! not. What they compute is tested in C.

use super::*;

const ZERO: stillflux_command = stillflux_command { compare: [0; 3], gates_on: 0 };
const COUNTS: stillflux_counts = stillflux_counts { i_abc: [0; 3], u_dc: 21_845 };
const SPEED: stillflux_set_point = stillflux_set_point { kind: STILLFLUX_SPEED, value: 1.0 };

/// Memory for a drive as a C program has it: not initialised but for the word that says so.
fn closed() -> Box<MaybeUninit<stillflux_drive>> {
    let mut state = Box::new(MaybeUninit::<stillflux_drive>::uninit());
    // SAFETY: within the state.
    unsafe { (&raw mut (*state.as_mut_ptr()).open).write(0) };
    state
}

/// With a change of the defaults.
fn page(change: impl Fn(&mut stillflux_settings)) -> [u32; WORDS] {
    page_of(change, |_| {}).unwrap_or_else(|field| panic!("{field} is refused"))
}

/// With a change of the defaults and of what is remembered; the name of the field that is refused.
fn page_of(
    change: impl Fn(&mut stillflux_settings),
    remember: impl Fn(&mut stillflux_memory),
) -> Result<[u32; WORDS], String> {
    let (m, i) = (Machine::preset_2k2(), Inverter::preset_2k2());
    let Saturation { L_u, a, S } = m.saturation.unwrap();
    let Machine { R_s, R_R, L_sigma, L_M, n_p, J, U_N, I_N, f_N, T_N, .. } = m;
    let machine = stillflux_machine { R_s, R_R, L_sigma, L_M, n_p, J, U_N, I_N, f_N, T_N, L_u, a, S };
    let Inverter { u_dc, f_s, u_th, r_d, dead_time, f_clk, c_out, half_periods, leg_delay } = i;
    let (current_sensors, i_full, u_full) = (3, 17.7, 810.0);
    let inverter = stillflux_inverter {
        u_dc,
        f_s,
        u_th,
        r_d,
        dead_time,
        f_clk,
        c_out,
        half_periods,
        leg_delay,
        current_sensors,
        i_full,
        u_full,
    };
    let (mut settings, mut memory) = (MaybeUninit::uninit(), MaybeUninit::uninit());
    let mut error = stillflux_error { field: [0; 32], value: 0.0, min: 0.0, max: 0.0, unit: [1; 16], note: [0; 128] };
    let mut page = [0; WORDS];
    // SAFETY: each is written before it is read; no structure has an invalid pattern.
    unsafe {
        stillflux_defaults(&machine, &inverter, &mut *settings.as_mut_ptr());
        stillflux_memory_of(&machine, &inverter, &mut *memory.as_mut_ptr());
        let (mut settings, mut memory): (stillflux_settings, stillflux_memory) =
            (settings.assume_init(), memory.assume_init());
        change(&mut settings);
        remember(&mut memory);
        match stillflux_page(&machine, &inverter, &settings, &memory, page.as_mut_ptr(), &mut error) {
            STILLFLUX_OK => Ok(page),
            _ => Err(error.field.iter().take_while(|x| **x != 0).map(|x| char::from(*x as u8)).collect()),
        }
    }
}

#[test]
fn what_no_drive_can_take_is_refused_by_its_field() {
    let blank = |memory: &mut stillflux_memory| {
        // SAFETY: numbers alone.
        *memory = unsafe { MaybeUninit::zeroed().assume_init() };
    };
    assert_eq!(page_of(|_| {}, blank), Err("memory R_s".into()));
    assert_eq!(page_of(|_| {}, |memory| memory.knee = -1.0), Err("memory knee".into()));
    assert_eq!(page_of(|settings| settings.scheme = 7, |_| {}), Err("scheme".into()));
    assert_eq!(page_of(|settings| settings.low_confidence = 3, |_| {}), Err("low_confidence".into()));
    assert_eq!(page_of(|settings| settings.encoder_mode = 2, |_| {}), Err("encoder_mode".into()));
    assert_eq!(page_of(|settings| settings.omega_s_min = 100.0, |_| {}), Err("omega_s_min".into()));
}

#[test]
fn full_scale_is_a_thousandth_above_the_range_of_the_sensors() {
    // Of the page, 17.7 A.
    let range = |part: f64| page_of(|settings| settings.i_range = part * 17.7, |_| {}).err();
    assert_eq!(range(1.0), Some("i_full".into()));
    assert_eq!(range(0.9991), Some("i_full".into()));
    assert_eq!(range(0.9989), None);
}

#[test]
fn an_error_has_its_unit_and_what_does_not_fit_is_cut() {
    let error = error_of(&ParamError {
        field: "the name of a field that is longer than the text",
        value: 1.0,
        min: 2.0,
        max: 3.0,
        unit: "rad/s³",
        note: "",
    });
    let read = |text: &[c_char]| {
        let bytes = text.iter().take_while(|x| **x != 0).map(|x| *x as u8).collect();
        String::from_utf8(bytes).unwrap()
    };
    assert_eq!((read(&error.unit), read(&error.note)), ("rad/s³".into(), String::new()));
    assert_eq!(read(&error.field), "the name of a field that is lon");
}

#[test]
fn limits_by_direction_follow_the_limit_of_both_until_they_are_set_and_zero_is_zero() {
    let (machine, inverter) = (Machine::preset_2k2(), Inverter::preset_2k2());
    let defaults = DriveParams::new(&machine, &inverter);
    let in_rust = |params: DriveParams| {
        let memory = MemorySi::of(&machine, &inverter);
        let ready = Ready::<Arithmetic>::new(&machine, &inverter, &params, (17.7, 810.0), &memory);
        *Page::seal(&ready.unwrap()).words()
    };
    assert_eq!(page(|_| {}), in_rust(defaults));
    let less = |settings: &mut stillflux_settings| (settings.torque_max, settings.omega_max) = (5.0, 50.0);
    assert_eq!(page(less), in_rust(DriveParams { torque_max: 5.0, omega_max: 50.0, ..defaults }));
    let one_way =
        |settings: &mut stillflux_settings| (settings.torque_limits, settings.speed_limits[0]) = ([0.0; 2], 0.0);
    let (torque_limits, speed_limits) = (Some((0.0, 0.0)), Some((0.0, defaults.omega_max)));
    assert_eq!(page(one_way), in_rust(DriveParams { torque_limits, speed_limits, ..defaults }));
    assert_eq!(page_of(|settings| settings.torque_limits[1] = 1e3, |_| {}), Err("torque_limits[1]".into()));
}

#[test]
fn a_fault_is_read_with_what_was_measured() {
    let (page, mut state) = (page(|_| {}), closed());
    let drive = state.as_mut_ptr();
    let mut report = stillflux_fault_report { code: 99, period: 0, value: 1.0, limit: 1.0 };
    let mut command = ZERO;
    // SAFETY: memory of a drive, a page of so many words.
    unsafe {
        assert_eq!(stillflux_fault_read(&*drive, &mut report), 0, "no drive");
        assert_eq!(stillflux_open(drive, size_of::<stillflux_drive>(), page.as_ptr()), STILLFLUX_OK);
        stillflux_period(&mut *drive, &stillflux_counts { u_dc: 4045, ..COUNTS }, &SPEED, &mut command);
        assert_eq!(stillflux_fault_read(&*drive, &mut report), 1);
    }
    assert_eq!((report.code, report.period), (Fault::UnderVoltage.code(), 1));
    assert!(
        (report.value - 100.0).abs() < 0.1 && (report.limit - 324.0).abs() < 0.1,
        "{} {}",
        report.value,
        report.limit
    );
}

#[test]
fn a_drive_is_opened_run_stored_and_opened_again() {
    let (mut page, mut state) = (page(|_| {}), closed());
    let drive = state.as_mut_ptr();
    let bytes = size_of::<stillflux_drive>();
    // SAFETY: memory of a drive, pages of so many words.
    unsafe {
        let mut torn = page;
        torn[20] ^= 1;
        assert_eq!(stillflux_open(drive, bytes - 8, page.as_ptr()), STILLFLUX_ERROR_SIZE);
        assert_eq!(stillflux_open(drive, bytes, torn.as_ptr()), STILLFLUX_ERROR_PAGE);
        let mut command = stillflux_command { gates_on: 1, ..ZERO };
        stillflux_period(&mut *drive, &COUNTS, &SPEED, &mut command);
        assert_eq!(command.gates_on, 0, "no drive");
        assert_eq!(stillflux_store(&*drive, page.as_ptr(), torn.as_mut_ptr()), STILLFLUX_ERROR_CLOSED);

        assert_eq!(stillflux_open(drive, bytes, page.as_ptr()), STILLFLUX_OK);
        for stamp in 0..40 {
            stillflux_period(&mut *drive, &COUNTS, &SPEED, &mut command);
            assert_eq!(stillflux_period_at(&mut *drive, stamp, &COUNTS, &SPEED, &mut command), 1);
        }
        assert_eq!(stillflux_status(&*drive), STILLFLUX_READING_OFFSET);
        let mut telemetry = MaybeUninit::uninit();
        stillflux_telemetry_read(&*drive, &mut *telemetry.as_mut_ptr());
        assert_eq!(telemetry.assume_init().period, 80);

        // Moved as a C program may, and stored onto its own page.
        let mut copy = closed();
        ptr::copy_nonoverlapping(drive, copy.as_mut_ptr(), 1);
        let words = page.as_mut_ptr();
        assert_eq!(stillflux_store(&*copy.as_ptr(), words, words), STILLFLUX_OK);
        assert_eq!(stillflux_open(drive, bytes, words), STILLFLUX_OK);
        assert_eq!(stillflux_status(&*drive), STILLFLUX_STOPPED);
    }
}

#[test]
fn a_chopper_works_in_every_state_where_the_library_and_the_page_have_one() {
    for on in if cfg!(feature = "dclink") { &[0.0, 650.0][..] } else { &[0.0] } {
        let mut state = closed();
        let drive = state.as_mut_ptr();
        let both = if *on > 0.0 { [*on, *on + 50.0] } else { [0.0; 2] };
        let page = page(|settings| settings.u_dc_chopper = both);
        // SAFETY: memory of a drive, a page of so many words.
        unsafe {
            let at = |drive: *const stillflux_drive, u: f64| {
                stillflux_chopper(&*drive, &stillflux_counts { u_dc: (u / 810.0 * 32_768.0) as i16, ..COUNTS })
            };
            assert_eq!(at(drive, 700.0), 0, "no drive");
            assert_eq!(stillflux_open(drive, size_of::<stillflux_drive>(), page.as_ptr()), STILLFLUX_OK);
            let full = f64::from(stillflux_timer_full(&*drive));
            for (u, part) in [(600.0, 0.0), (675.0, 0.5), (760.0, 1.0)] {
                let expected = if *on > 0.0 { part * full } else { 0.0 };
                assert!((f64::from(at(drive, u)) - expected).abs() < 0.002 * full, "{on} {u}");
            }
        }
    }
}

#[test]
fn an_encoder_is_read_where_the_library_and_the_page_have_one() {
    for lines in if cfg!(feature = "encoder") { &[0, 1024][..] } else { &[0] } {
        let mut state = closed();
        let (drive, page) = (state.as_mut_ptr(), page(|settings| settings.encoder_lines = *lines));
        let mut encoder = stillflux_encoder { omega_m: 1.0, difference: 1.0, state: 9 };
        // SAFETY: memory of a drive, a page of so many words.
        unsafe {
            stillflux_encoder_set(&mut *drive, 7);
            assert_eq!(stillflux_encoder_read(&*drive, &mut encoder), 0, "no drive");
            assert_eq!(stillflux_open(drive, size_of::<stillflux_drive>(), page.as_ptr()), STILLFLUX_OK);
            let mut command = ZERO;
            for k in 0..400 {
                stillflux_encoder_set(&mut *drive, (65_500 + k) & 0xFFFF);
                stillflux_period(&mut *drive, &COUNTS, &SPEED, &mut command);
            }
            assert_eq!(stillflux_encoder_read(&*drive, &mut encoder), u32::from(*lines > 0));
        }
        if *lines > 0 {
            // One count a period.
            let omega_m = 1e4 * core::f32::consts::TAU / 4096.0;
            assert!((encoder.omega_m - omega_m).abs() < 0.02 * omega_m && encoder.state == STILLFLUX_ENCODER_AGREES);
        } else {
            assert_eq!((encoder.omega_m, encoder.state), (1.0, 9), "untouched");
        }
    }
}

#[test]
fn a_text_ends_within_its_buffer_and_registers_are_read_as_three() {
    // SAFETY: buffers of the sizes given.
    unsafe {
        stillflux_fault_text(1, std::ptr::null_mut(), 0);
        for size in 0..16 {
            let mut text = vec![1 as c_char; size];
            stillflux_fault_text(1, text.as_mut_ptr(), size);
            assert_eq!(text.iter().filter(|c| **c == 0).count(), usize::from(size > 0));
        }
        let converters = stillflux_converters {
            current: STILLFLUX_RIGHT,
            current_bits: 12,
            zero: [2048; 3],
            offset: [0; 3],
            u_dc: STILLFLUX_LEFT,
            u_dc_bits: 12,
        };
        let mut counts = COUNTS;
        stillflux_counts_from_raw([2049, 4095, 0].as_ptr(), 0x8000, &converters, &mut counts);
        assert_eq!((counts.i_abc, counts.u_dc), ([16, i16::MAX, i16::MIN], 0x4000));
    }
}
