//! Estimators. The published scheme: flux (Fig. 7), offset (Fig. 4), resistance (Fig. 12), and the confidence
//! in them; with the feature `variants` also its other method for the resistance and the two flux estimators that it
//! argues against. The enhanced scheme: one filter for all of it, the balance of the current sensors, the flux and the
//! speed of a machine that turns at the start, the differences of the bridge's legs, and the rotor resistance by the
//! temperature. Speed is
//! common to both, and so is the speed of an encoder that they are compared with.

pub mod balance;
#[cfg(feature = "enhanced")]
pub(crate) mod catch;
#[cfg(all(feature = "enhanced", feature = "restart"))]
pub(crate) mod circle;
pub mod confidence;
#[cfg(feature = "encoder")]
pub mod encoder;
pub mod flux;
pub mod integral;
pub mod kalman;
#[cfg(all(feature = "legs", any(feature = "enhanced", feature = "commission")))]
#[cfg_attr(not(feature = "enhanced"), allow(dead_code))]
pub(crate) mod legs;
#[cfg(feature = "variants")]
pub mod light_load;
#[cfg(feature = "variants")]
pub mod limiter;
#[cfg(feature = "variants")]
pub mod lowpass;
pub mod offset;
pub mod pair;
pub mod priors;
#[cfg(feature = "weakening")]
pub(crate) mod radius;
#[cfg(not(feature = "weakening"))]
#[path = "left_out/radius.rs"]
pub(crate) mod radius;
pub mod regeneration;
pub mod resistance;
#[cfg(feature = "enhanced")]
pub(crate) mod search;
#[cfg(all(feature = "enhanced", feature = "restart"))]
pub(crate) mod slow_turn;
pub mod speed;
pub mod temperature;
#[cfg(all(feature = "enhanced", feature = "restart"))]
pub(crate) mod turning;
