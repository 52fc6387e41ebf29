//! Estimators. The published scheme: flux (Fig. 7), offset (Fig. 4), resistance (Fig. 12), and the confidence
//! in them. The enhanced scheme: one filter for all of it, and the balance of the current sensors. Speed is
//! common to both.

pub mod balance;
pub mod confidence;
pub mod flux;
pub mod integral;
pub mod kalman;
pub mod offset;
pub mod priors;
pub mod resistance;
pub mod speed;
