//! The numbers of the simulated table, as they stand in a rig file; every one has a default taken
//! from measurements on a model of the Moog table of Andreaus and De Angelis (2020).

use crate::units::STANDARD_GRAVITY_M_S2;
use serde::{Deserialize, Serialize};

/// A simulated rig: table, drive and instruments.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct SimulatedSpec {
    /// Table and drive.
    pub table: TableSpec,
    /// Instruments and DAQ.
    pub sensors: SensorSpec,
}

/// Table and drive.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct TableSpec {
    /// Platen, base plate, stands and reflected inertia, kg.
    pub platen_mass_kg: f64,
    /// Gain of the position loop, 1/s.
    pub position_gain_1_s: f64,
    /// Bandwidth of the velocity loop, Hz.
    pub velocity_loop_hz: f64,
    /// Share of the commanded velocity that is fed forward, 0 to 1.
    pub velocity_feedforward: f64,
    /// Share of the commanded acceleration that is fed forward, 0 to 1.
    pub acceleration_feedforward: f64,
    /// Time constant of the force behind its command, s.
    pub force_lag_s: f64,
    /// Delay from a command to the drive acting on it, sample periods.
    pub command_delay_samples: u32,
    /// Coulomb friction of the table's guides, N.
    pub friction_n: f64,
    /// Largest force of the actuator, N.
    pub peak_force_n: f64,
    /// Whole stroke, m; the table moves between minus and plus half of it.
    pub stroke_m: f64,
    /// Largest velocity, m/s.
    pub velocity_limit_m_s: f64,
    /// Largest acceleration, m/s2.
    pub acceleration_limit_m_s2: f64,
    /// Time without a command after which the drive stops by itself, s.
    pub command_timeout_s: f64,
    /// Deceleration of the drive's own stop, m/s2.
    pub quick_stop_deceleration_m_s2: f64,
    /// Continuous-force limit; absent: none.
    pub foldback: Option<FoldbackSpec>,
    /// Integration steps in one sample period.
    pub substeps: u32,
}

/// Fold-back of a drive whose continuous force is limited: above the limit (running rms) the force
/// is held down until the rms has recovered.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct FoldbackSpec {
    /// Running rms of the force that is allowed, N.
    pub limit_n_rms: f64,
    /// Time constant of the running rms, s.
    pub time_constant_s: f64,
    /// Largest force while folded, N.
    pub folded_force_n: f64,
    /// Share of the limit below which the full force comes back, 0 to 1.
    pub recovery: f64,
}

/// Instruments and DAQ.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct SensorSpec {
    /// Noise of each accelerometer, m/s2 rms.
    pub accelerometer_noise_m_s2: f64,
    /// Noise of the laser, m rms.
    pub laser_noise_m: f64,
    /// Noise of the table's displacement transducer, m rms.
    pub table_displacement_noise_m: f64,
    /// Range of the accelerometers, m/s2, plus and minus.
    pub accelerometer_range_m_s2: f64,
    /// Range of the displacement transducers, m, plus and minus.
    pub displacement_range_m: f64,
    /// Resolution of the accelerometer channels, bits.
    pub accelerometer_bits: u32,
    /// Resolution of the displacement channels, bits.
    pub displacement_bits: u32,
    /// Corner of the anti-aliasing filters as a share of the sampling rate, below 0.5.
    pub anti_aliasing: f64,
    /// Gains: table accelerometer, first and second on the mass.
    pub accelerometer_gain: [f64; 3],
    /// Zeros: table accelerometer, first and second on the mass, m/s2.
    pub accelerometer_offset_m_s2: [f64; 3],
    /// Delay of the accelerometers, s.
    pub accelerometer_delay_s: f64,
    /// Gain of the laser.
    pub laser_gain: f64,
    /// Zero of the laser, m.
    pub laser_offset_m: f64,
    /// Delay of the laser, s.
    pub laser_delay_s: f64,
}

impl Default for TableSpec {
    fn default() -> Self {
        Self {
            platen_mass_kg: 1500.0,
            position_gain_1_s: std::f64::consts::TAU * 20.0,
            velocity_loop_hz: 80.0,
            velocity_feedforward: 1.0,
            acceleration_feedforward: 1.0,
            force_lag_s: 1e-3,
            command_delay_samples: 2,
            friction_n: 60.0,
            peak_force_n: 12e3,
            stroke_m: 0.20,
            velocity_limit_m_s: 0.5,
            acceleration_limit_m_s2: 0.6 * STANDARD_GRAVITY_M_S2,
            command_timeout_s: 0.1,
            quick_stop_deceleration_m_s2: 1.0,
            foldback: None,
            substeps: 4,
        }
    }
}

impl Default for FoldbackSpec {
    fn default() -> Self {
        Self { limit_n_rms: 2590.0, time_constant_s: 1.0, folded_force_n: 1300.0, recovery: 0.3 }
    }
}

impl Default for SensorSpec {
    fn default() -> Self {
        Self {
            accelerometer_noise_m_s2: 0.01,
            laser_noise_m: 30e-6,
            table_displacement_noise_m: 10e-6,
            accelerometer_range_m_s2: 50.0,
            displacement_range_m: 0.15,
            accelerometer_bits: 24,
            displacement_bits: 18,
            anti_aliasing: 0.4,
            accelerometer_gain: [1.0; 3],
            accelerometer_offset_m_s2: [0.0; 3],
            accelerometer_delay_s: 0.0,
            laser_gain: 1.0,
            laser_offset_m: 0.0,
            laser_delay_s: 0.0,
        }
    }
}

/// One rule: dotted key, value, lowest and highest allowed, unit.
type Rule = (&'static str, f64, f64, f64, &'static str);

impl SimulatedSpec {
    fn rules(&self) -> Vec<Rule> {
        let (table, sensors) = (&self.table, &self.sensors);
        let mut rules = vec![
            ("table.platen_mass_kg", table.platen_mass_kg, 1e-3, 1e7, "kg"),
            ("table.position_gain_1_s", table.position_gain_1_s, 0.1, 1e4, "1/s"),
            ("table.velocity_loop_hz", table.velocity_loop_hz, 0.1, 500.0, "Hz"),
            ("table.velocity_feedforward", table.velocity_feedforward, 0.0, 1.0, ""),
            ("table.acceleration_feedforward", table.acceleration_feedforward, 0.0, 1.0, ""),
            ("table.force_lag_s", table.force_lag_s, 1e-5, 0.1, "s"),
            ("table.command_delay_samples", f64::from(table.command_delay_samples), 0.0, 64.0, "samples"),
            ("table.friction_n", table.friction_n, 0.0, 1e6, "N"),
            ("table.peak_force_n", table.peak_force_n, 1e-3, 1e9, "N"),
            ("table.stroke_m", table.stroke_m, 1e-6, 10.0, "m"),
            ("table.velocity_limit_m_s", table.velocity_limit_m_s, 1e-6, 100.0, "m/s"),
            ("table.acceleration_limit_m_s2", table.acceleration_limit_m_s2, 1e-6, 1e4, "m/s2"),
            ("table.command_timeout_s", table.command_timeout_s, 1e-3, 10.0, "s"),
            (
                "table.quick_stop_deceleration_m_s2",
                table.quick_stop_deceleration_m_s2,
                1e-3,
                table.acceleration_limit_m_s2,
                "m/s2",
            ),
            ("table.substeps", f64::from(table.substeps), 1.0, 64.0, ""),
            ("sensors.accelerometer_noise_m_s2", sensors.accelerometer_noise_m_s2, 0.0, 1e3, "m/s2"),
            ("sensors.laser_noise_m", sensors.laser_noise_m, 0.0, 1.0, "m"),
            ("sensors.table_displacement_noise_m", sensors.table_displacement_noise_m, 0.0, 1.0, "m"),
            ("sensors.accelerometer_range_m_s2", sensors.accelerometer_range_m_s2, 1e-6, 1e6, "m/s2"),
            ("sensors.displacement_range_m", sensors.displacement_range_m, 1e-9, 100.0, "m"),
            ("sensors.accelerometer_bits", f64::from(sensors.accelerometer_bits), 8.0, 32.0, "bits"),
            ("sensors.displacement_bits", f64::from(sensors.displacement_bits), 8.0, 32.0, "bits"),
            ("sensors.anti_aliasing", sensors.anti_aliasing, 0.05, 0.499, "of the sampling rate"),
            ("sensors.laser_gain", sensors.laser_gain, -10.0, 10.0, ""),
            ("sensors.laser_delay_s", sensors.laser_delay_s, 0.0, 0.02, "s"),
            ("sensors.accelerometer_delay_s", sensors.accelerometer_delay_s, 0.0, 0.02, "s"),
        ];
        if let Some(fold) = &table.foldback {
            rules.extend([
                ("table.foldback.limit_n_rms", fold.limit_n_rms, 1e-3, table.peak_force_n, "N"),
                ("table.foldback.time_constant_s", fold.time_constant_s, 1e-3, 1e3, "s"),
                ("table.foldback.folded_force_n", fold.folded_force_n, 0.0, table.peak_force_n, "N"),
                ("table.foldback.recovery", fold.recovery, 0.01, 1.0, ""),
            ]);
        }
        rules
    }
}

impl crate::config::Check for SimulatedSpec {
    fn check(&self) -> Result<(), (String, String)> {
        for (key, value, low, high, unit) in self.rules() {
            if !(low..=high).contains(&value) {
                return Err((key.to_owned(), format!("{value} {unit}; allowed: {low} to {high} {unit}")));
            }
        }
        Ok(())
    }
}
