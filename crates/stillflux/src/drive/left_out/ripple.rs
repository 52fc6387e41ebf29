//! Without the feature `ripple` the loss of the inverter model is that of the sampled current.

use crate::inverter::{Distortion, InverterModel, Knee};
use crate::scalar::Real;
use crate::space::AlphaBeta;
use core::marker::PhantomData;

/// None.
#[derive(Clone, Copy, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(bound = ""))]
pub(super) struct Ripple<R: Real>(PhantomData<R>);

#[allow(clippy::unused_self, clippy::needless_pass_by_ref_mut)]
impl<R: Real> Ripple<R> {
    pub fn new() -> Self {
        Self(PhantomData)
    }

    #[inline(always)]
    pub fn block(&mut self) {}

    #[inline(always)]
    pub fn follow(&mut self, _: &InverterModel<R>, _: &AlphaBeta<R>, _: &AlphaBeta<R>, _: &Knee<R>, _: &Distortion<R>) {
    }

    #[inline(always)]
    pub fn add_to(&self, _: &mut [R; 3]) {}
}
