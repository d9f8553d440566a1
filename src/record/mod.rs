//! Run folders and data files: writing, recovering, reading, importing, exporting.

pub mod data;
pub mod samples;

pub use data::{Kind, Record};
