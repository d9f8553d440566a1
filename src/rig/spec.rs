//! A rig as it stands in its file: what the table can give, how it is simulated, how well the
//! instruments can be trusted. The simulated rig is built from it, the preview and the stop
//! trajectories keep inside its capacity, diagnosis reads the tolerances.

use super::hardware::HardwareSpec;
use super::simulated::{SensorSpec, SimulatedSpec, TableSpec};
use crate::config::Check;
use crate::units::SAMPLE_RATE_HZ;
use serde::{Deserialize, Serialize};

/// A rig file.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RigSpec {
    /// Name shown in reports.
    pub name: String,
    /// Samples and commands a second.
    #[serde(default = "default_sample_rate_hz")]
    pub sample_rate_hz: f64,
    /// Model, by name or path, of what really stands on the simulated table; without it the onboard
    /// model. It may carry effects that the onboard model lacks.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub specimen: Option<String>,
    /// Peak jerk that a command may ask for, m/s3.
    #[serde(default = "default_jerk_limit_m_s3")]
    pub jerk_limit_m_s3: f64,
    /// Table and drive, their limits included.
    #[serde(default)]
    pub table: TableSpec,
    /// Instruments as they are simulated.
    #[serde(default)]
    pub sensors: SensorSpec,
    /// How far the instruments may be off (effects below these are estimated and taken out, not
    /// reported as physics).
    #[serde(default)]
    pub tolerances: Tolerances,
    /// Real devices; absent: the rig is simulated.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub hardware: Option<HardwareSpec>,
}

/// What a table can give; a sweep that asks for more is refused.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Capacity {
    /// Largest displacement either way, m: half the stroke.
    pub displacement_m: f64,
    /// Peak velocity, m/s.
    pub velocity_m_s: f64,
    /// Peak acceleration, m/s2.
    pub acceleration_m_s2: f64,
    /// Peak jerk, m/s3.
    pub jerk_m_s3: f64,
    /// Peak force of the actuator, N.
    pub force_n: f64,
}

/// How far the instruments may be off, relative unless a unit says otherwise.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Tolerances {
    /// Gain of an accelerometer.
    pub accelerometer_gain: f64,
    /// Leak of another axis into an accelerometer.
    pub accelerometer_cross_axis: f64,
    /// Gain of the laser.
    pub laser_gain: f64,
    /// Zero of the laser, m.
    pub laser_zero_m: f64,
    /// Zero of an accelerometer, m/s2.
    pub accelerometer_zero_m_s2: f64,
}

fn default_sample_rate_hz() -> f64 {
    SAMPLE_RATE_HZ
}
fn default_jerk_limit_m_s3() -> f64 {
    200.0
}

impl Default for Tolerances {
    fn default() -> Self {
        Self {
            accelerometer_gain: 0.005,
            accelerometer_cross_axis: 0.005,
            laser_gain: 0.001,
            laser_zero_m: 20e-6,
            accelerometer_zero_m_s2: 0.02,
        }
    }
}

impl Default for RigSpec {
    fn default() -> Self {
        Self {
            name: "simulated".to_owned(),
            sample_rate_hz: default_sample_rate_hz(),
            specimen: None,
            jerk_limit_m_s3: default_jerk_limit_m_s3(),
            table: TableSpec::default(),
            sensors: SensorSpec::default(),
            tolerances: Tolerances::default(),
            hardware: None,
        }
    }
}

impl RigSpec {
    /// What the table can give.
    pub fn capacity(&self) -> Capacity {
        Capacity {
            displacement_m: 0.5 * self.table.stroke_m,
            velocity_m_s: self.table.velocity_limit_m_s,
            acceleration_m_s2: self.table.acceleration_limit_m_s2,
            jerk_m_s3: self.jerk_limit_m_s3,
            force_n: self.table.peak_force_n,
        }
    }

    /// The part that the simulated rig is built from.
    pub fn simulated(&self) -> SimulatedSpec {
        SimulatedSpec { table: self.table.clone(), sensors: self.sensors.clone() }
    }
}

impl Check for RigSpec {
    fn check(&self) -> Result<(), (String, String)> {
        let o = &self.tolerances;
        let own = [
            ("sample_rate_hz", self.sample_rate_hz, 100.0, 50_000.0, "Hz"),
            ("jerk_limit_m_s3", self.jerk_limit_m_s3, 0.1, 1e6, "m/s3"),
            ("tolerances.accelerometer_gain", o.accelerometer_gain, 0.0, 0.2, ""),
            ("tolerances.accelerometer_cross_axis", o.accelerometer_cross_axis, 0.0, 0.2, ""),
            ("tolerances.laser_gain", o.laser_gain, 0.0, 0.2, ""),
            ("tolerances.laser_zero_m", o.laser_zero_m, 0.0, 0.01, "m"),
            ("tolerances.accelerometer_zero_m_s2", o.accelerometer_zero_m_s2, 0.0, 1.0, "m/s2"),
        ];
        for (key, value, low, high, unit) in own {
            if !(low..=high).contains(&value) {
                return Err((key.to_owned(), format!("{value} {unit}; allowed: {low} to {high} {unit}")));
            }
        }
        self.hardware.as_ref().map_or(Ok(()), Check::check)?;
        self.simulated().check()
    }
}
