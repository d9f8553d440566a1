//! Fitting a model's parameters to records, with intervals.

pub mod kinematics;
pub mod least_squares;
pub mod spectral;
