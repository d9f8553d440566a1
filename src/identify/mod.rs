//! Fitting a model's parameters to records, with intervals.

mod component;
pub mod filtered;
mod fused;
pub mod kinematics;
pub mod least_squares;
pub mod motion;
pub mod numbers;
mod output_error;
pub mod periodic;
pub mod problem;
pub mod refit;
pub mod response;
mod reversals;
pub mod spectral;
mod table;
pub mod together;
mod weighing;
mod windows;
