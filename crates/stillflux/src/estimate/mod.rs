//! Estimators: flux (Fig. 7), offset (Fig. 4), resistance (Fig. 12), speed, and the confidence in them.

pub mod confidence;
pub mod flux;
pub mod offset;
pub mod resistance;
pub mod speed;
