//! Run folders and data files: writing, recovering, reading, importing, exporting.

pub mod data;

pub use data::{Kind, Record};
