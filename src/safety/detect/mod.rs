//! One detector a file: each turns samples or periods into one indicator, O(1) and without allocation.
//! Thresholds, persistence and what follows are the judge's and the configuration's business. Together they stop a
//! table that loses its command, and leave alone one that does not (SR-15).

pub mod accelerometers_disagree;
pub mod control_slips;
pub mod device_status;
pub mod following_error;
pub mod frozen_sensor;
pub mod mass_acceleration;
pub mod mass_oscillations;
pub mod model_divergence;
pub mod not_a_number;
pub mod operator_link;
pub mod out_of_range;
pub mod recorder_behind;
pub mod relative_displacement;
pub mod repeated_sample;
pub mod sensor_plausibility;
pub mod sequence_gap;
pub mod stale_sample;
pub mod table_acceleration;
pub mod table_distortion;
pub mod table_fundamental;
pub mod table_peak_error;

#[cfg(test)]
pub(crate) mod bench;
