//! Run folders and data files: writing, recovering, reading, importing, exporting.

pub mod data;
pub mod folder;
pub mod recorder;
pub mod samples;

pub use data::{Kind, Record};
pub use folder::{LossReport, Manifest, RunError, RunFolder, RunState};
