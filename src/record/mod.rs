//! Run folders and data files: writing, recovering, reading, importing, exporting.

pub mod chain;
pub mod data;
mod first_out;
pub mod folder;
pub(crate) mod kinematic;
pub mod mended;
pub mod quality;
pub mod read;
pub mod recorder;
pub mod recover;
pub mod salvage;
pub mod samples;
pub mod steps_csv;
mod syncer;
pub mod verify;

pub use data::{Kind, Record};
pub use folder::{LossReport, Manifest, RunError, RunFolder, RunState};
pub use read::read_run;
