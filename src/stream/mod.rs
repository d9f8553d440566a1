//! Samples and how they travel: the types that every rig produces, and the lock-free rings that
//! carry them from the control thread to the recorder and the live view.

pub mod ring;
pub mod sample;

pub use ring::{ControlEnd, Depths, Lossy, OperatorEnd, RecorderEnd, ViewEnd, split};
pub use sample::{Channels, Command, Row, Sample, StatusBits};
