//! Blocks of the enhanced scheme beside the drive: its filter, each period of a block separately, and its balance.

use super::{Cost, Input};
use core::hint::black_box;
use stillflux::config::BALANCE_PERIODS;
use stillflux::drive::{Drive, Estimate};
use stillflux::estimate::balance::{Balance, BalanceConfig};
use stillflux::estimate::kalman::{self, Filter, FilterConfig};
use stillflux::space::AlphaBeta;
use stillflux_firmware::exchange::Word;

/// Name of the step in the report.
pub const STEP: &str = "drive_step_enhanced";
/// Name of the whole interrupt in the report.
pub const INTERRUPT: &str = "interrupt_enhanced";

/// Slots in a block of the filter, and control periods in a slot at the preset's 10 kHz.
const SLOTS: usize = 10;
const PERIODS: usize = 2;
/// Names of the parts of the filter's work.
const PARTS: [&str; SLOTS] = [
    "filter_close",
    "filter_1",
    "filter_2",
    "filter_3",
    "filter_4",
    "filter_5",
    "filter_6",
    "filter_7",
    "filter_8",
    "filter_9",
];

/// What is measured.
#[derive(Clone, Copy, Default)]
pub struct Costs {
    filter: Cost,
    /// The same by slot of a block, in the periods in which it has work.
    filter_part: [Cost; SLOTS],
    balance: Cost,
    /// Its fit, every eighth period.
    balance_fit: Cost,
}

impl Costs {
    /// Each with its name.
    pub fn each(&self, mut f: impl FnMut(&str, &Cost)) {
        f("filter", &self.filter);
        for (name, part) in PARTS.iter().zip(&self.filter_part) {
            f(name, part);
        }
        f("balance", &self.balance);
        f("balance_fit", &self.balance_fit);
    }
}

/// Copies of the drive's blocks.
pub struct Blocks<R: Word> {
    filter: Filter<R>,
    balance: Balance<R>,
    /// Period within the filter's block.
    part: usize,
    /// Periods in which the copy's flux and the drive's were apart.
    different: u32,
}

impl<R: Word> Blocks<R> {
    /// As the drive starts them in a machine at rest.
    pub fn start(drive: &Drive<R>, _: AlphaBeta<R>) -> Self {
        let (c, e) = (drive.config(), drive.estimate());
        let f = c.filter_config();
        let mut filter = Filter::new(f);
        filter.start(f, &e.i_s);
        filter.settle(f, c.flux_control_config().psi_rated);
        Self { filter, balance: Balance::default(), part: 0, different: 0 }
    }

    /// Periods in which the copy's flux and the drive's were apart.
    pub fn apart(&self) -> u32 {
        self.different
    }

    /// One period on the drive's own inputs, but for the voltage of the inverter model, which stays within the
    /// drive: the one at the present current serves.
    pub fn period(
        &mut self,
        costs: &mut Costs,
        drive: &Drive<R>,
        before: &Estimate<R>,
        i_s: &AlphaBeta<R>,
        input: &Input<R>,
    ) {
        let (c, e) = (drive.config(), drive.estimate());
        let f = c.filter_config();
        let i_m = costs.balance.call(|| black_box(balance(black_box(&self.balance), i_s)));
        let inverter = c.inverter_model();
        let loss = inverter.distortion(inverter.nominal(), &e.i_s, input.measured.u_dc, R::ONE);
        let x = kalman::Input { u_s: e.u_s, loss: &loss, i_m, i_ref: &before.i_dq_ref, omega_s: before.speed.omega_s };
        if drive.period() % BALANCE_PERIODS == 4 {
            // The offsets read at rest differ in their sum only, which the fit takes for its constant.
            let [i_a, i_b, i_c] = input.measured.i_abc;
            let sum = i_a + i_b + i_c;
            costs.balance_fit.call(|| balance_fit(&mut self.balance, c.balance_config(), i_s, sum));
        }
        let n = costs.filter.sum;
        costs.filter.call(|| predict(&mut self.filter, f, &x));
        let n = costs.filter.sum - n;
        self.part = (self.part + 1) % (SLOTS * PERIODS);
        if self.part.is_multiple_of(PERIODS) {
            costs.filter_part[self.part / PERIODS].add(n as u32);
        }
        let apart = self.filter.value() - e.flux.psi_s;
        if !apart.norm_sq().within(R::from_f64(0.01)) {
            self.different += 1;
            // With the voltage of another inverter model the copy may lose a field that the drive keeps, and would not find it again.
            self.filter.place(f, e.speed.psi_r, &e.i_s, R::ZERO);
        }
    }
}

// Calls that the optimiser leaves where they are.

#[inline(never)]
fn predict<R: Word>(s: &mut Filter<R>, c: &FilterConfig<R>, x: &kalman::Input<'_, R>) {
    s.step(c, x, false);
}
#[inline(never)]
fn balance<R: Word>(s: &Balance<R>, i: &AlphaBeta<R>) -> AlphaBeta<R> {
    s.remove(i)
}
#[inline(never)]
fn balance_fit<R: Word>(s: &mut Balance<R>, c: &BalanceConfig<R>, i: &AlphaBeta<R>, sum: R) {
    s.fit(c, i, sum);
}
