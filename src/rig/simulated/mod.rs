//! The simulated rig: table, specimen and instruments, coupled both ways. The specimen's reaction
//! moves the platen, the platen's motion drives the specimen. Deterministic: same seed, same
//! samples. Faults can be switched while it runs ([`FaultSwitches`]).

mod actuator;
mod faults;
mod sensors;
mod spec;

pub use faults::{ALL_CHANNELS, Channel, Fault, FaultSwitches, LATE_BURST_SAMPLES};
pub use spec::{FoldbackSpec, SensorSpec, SimulatedSpec, TableSpec};

use super::{Rig, RigFault};
use crate::model::{Observation, Observer, Specimen};
use crate::safety::StopLine;
use crate::stream::{Channels, Command, Sample, StatusBits};
use actuator::{Actuator, Drive};
use faults::Active;
use rand::{Rng, SeedableRng};
use rand_pcg::Pcg64Mcg;
use sensors::{Motion, Sensors};
use std::collections::VecDeque;

/// Samples that the DAQ can hold before it loses the oldest, 4 s at 2048 Hz.
const DAQ_BUFFER: usize = 8192;

/// A table, a specimen on it and the instruments, advanced in virtual time.
pub struct SimulatedRig {
    actuator: Actuator,
    specimen: Box<dyn Specimen>,
    specimen_mass_kg: f64,
    mass_acceleration_m_s2: f64,
    observer: Option<Observer>,
    sensors: Sensors,
    substeps: u32,
    sample_rate_hz: f64,
    chain_delay_s: f64,
    sequence: u64,
    delivered: VecDeque<Sample>,
    held: u32,
    last: [f64; 5],
    faults: FaultSwitches,
    line: StopLine,
    now: Active,
    garbage: Pcg64Mcg,
}

impl SimulatedRig {
    /// Builds the rig at rest. The specimen must have been made for a step of
    /// `1 / (sample_rate_hz * spec.table.substeps)` seconds ([`specimen_step_s`]) and
    /// `specimen_mass_kg` must be its mass.
    pub fn new(
        spec: &SimulatedSpec,
        mut specimen: Box<dyn Specimen>,
        specimen_mass_kg: f64,
        sample_rate_hz: f64,
        seed: u64,
    ) -> Self {
        specimen.reset();
        let substeps = spec.table.substeps.max(1);
        Self {
            actuator: Actuator::new(&spec.table, sample_rate_hz),
            specimen,
            specimen_mass_kg,
            mass_acceleration_m_s2: 0.0,
            observer: None,
            sensors: Sensors::new(&spec.sensors, sample_rate_hz, substeps, Pcg64Mcg::seed_from_u64(seed)),
            substeps,
            sample_rate_hz,
            chain_delay_s: chain_delay_s(spec, sample_rate_hz),
            sequence: 0,
            delivered: VecDeque::with_capacity(DAQ_BUFFER),
            held: 0,
            last: [0.0; 5],
            faults: FaultSwitches::default(),
            line: StopLine::default(),
            now: Active::default(),
            garbage: Pcg64Mcg::seed_from_u64(seed ^ 0x9e37_79b9_7f4a_7c15),
        }
    }

    /// The same rig with what the specimen's model says of the instruments (gains, delays, yaw of the
    /// mass), made for the step of the specimen.
    pub fn with_instruments(self, observer: Observer) -> Self {
        Self { observer: Some(observer), ..self }
    }

    /// The rig's fault switches; the handle may go to any thread.
    pub fn faults(&self) -> FaultSwitches {
        self.faults.clone()
    }

    /// Whether the drive's continuous-force limit holds its force down at the moment.
    pub fn folded(&self) -> bool {
        self.actuator.folded()
    }

    /// True displacement (m), velocity (m/s) and acceleration (m/s2) of the table, for tests.
    pub fn true_table_motion(&self) -> (f64, f64, f64) {
        (self.actuator.displacement_m, self.actuator.velocity_m_s, self.actuator.acceleration_m_s2)
    }

    fn move_table_and_specimen(&mut self) {
        self.actuator.begin_period();
        for _ in 0..self.substeps {
            // The mass pushes on the table with minus M A; taking A from the step before keeps the
            // coupling explicit, which is stable as contact is slow against the step.
            let reaction_n = -self.specimen_mass_kg * self.mass_acceleration_m_s2;
            let table_acceleration_m_s2 = self.actuator.substep(reaction_n);
            let response = self.specimen.step(table_acceleration_m_s2);
            self.mass_acceleration_m_s2 = response.mass_acceleration_m_s2;
            let plain = Observation {
                relative_displacement_m: response.relative_displacement_m,
                mass_acceleration_1_m_s2: response.mass_acceleration_m_s2,
                mass_acceleration_2_m_s2: response.mass_acceleration_m_s2,
            };
            let seen = self.observer.as_mut().map_or(plain, |observer| observer.observe(&response));
            self.sensors.follow(&Motion {
                table_displacement_m: self.actuator.displacement_m,
                table_acceleration_m_s2,
                mass_acceleration_1_m_s2: seen.mass_acceleration_1_m_s2,
                mass_acceleration_2_m_s2: seen.mass_acceleration_2_m_s2,
                relative_displacement_m: seen.relative_displacement_m,
            });
        }
    }

    fn take_sample(&mut self) -> Sample {
        let (channels, overrange) = self.sensors.sample();
        let mut values = [
            channels.table_displacement_m,
            channels.table_acceleration_m_s2,
            channels.mass_acceleration_1_m_s2,
            channels.mass_acceleration_2_m_s2,
            channels.relative_displacement_m,
        ];
        if !self.now.none() {
            self.now.spoil(&mut values, &self.last);
        }
        // What a stuck or frozen channel repeats must be a number.
        for (last, value) in self.last.iter_mut().zip(values) {
            if value.is_finite() {
                *last = value;
            }
        }
        let mut status = match self.actuator.drive() {
            Drive::Enabled => StatusBits::DRIVE_ENABLED,
            Drive::QuickStop => 0,
            Drive::Tripped => StatusBits::DRIVE_FAULT,
        };
        if overrange {
            status |= StatusBits::OVERRANGE;
        }
        if self.now.bus_off() {
            status |= StatusBits::LINK_DOWN;
        }
        Sample {
            sequence: self.sequence,
            device_time_us: (self.sequence as f64 * 1e6 / self.sample_rate_hz) as u64,
            channels: Channels {
                table_displacement_m: values[0],
                table_acceleration_m_s2: values[1],
                mass_acceleration_1_m_s2: values[2],
                mass_acceleration_2_m_s2: values[3],
                relative_displacement_m: values[4],
            },
            status: StatusBits(status),
        }
    }

    fn deliver(&mut self, sample: Sample) {
        if self.now.dropout() || self.now.garbage() && self.garbage.random_range(0..3) != 0 {
            return;
        }
        if self.delivered.len() == DAQ_BUFFER {
            self.delivered.pop_front();
        }
        if self.now.repeated()
            && let Some(before) = sample.sequence.checked_sub(1)
        {
            self.delivered.push_back(Sample { sequence: before, ..sample });
        } else {
            self.delivered.push_back(sample);
        }
        if self.now.late_burst() {
            self.held = if self.held + 1 >= LATE_BURST_SAMPLES { 0 } else { self.held + 1 };
        } else {
            self.held = 0;
        }
    }
}

/// Step that the specimen of a simulated rig must be made for, s.
pub fn specimen_step_s(spec: &SimulatedSpec, sample_rate_hz: f64) -> f64 {
    1.0 / (sample_rate_hz * f64::from(spec.table.substeps.max(1)))
}

/// Delay from a command to its effect in the measured motion: the drive's delay line, the sample
/// that has to be waited for, and the anti-aliasing filter (`sqrt(2) / w` of a second-order
/// Butterworth at low frequency). The loop itself adds nothing: feed-forward is exact there, save
/// the lag of the force, which the position loop turns into less than a tenth of a sample.
pub fn chain_delay_s(spec: &SimulatedSpec, sample_rate_hz: f64) -> f64 {
    let corner_rad_s = std::f64::consts::TAU * spec.sensors.anti_aliasing * sample_rate_hz;
    f64::from(spec.table.command_delay_samples) / sample_rate_hz + std::f64::consts::SQRT_2 / corner_rad_s
}

impl Rig for SimulatedRig {
    fn read(&mut self) -> Result<Option<Sample>, RigFault> {
        if self.held > 0 {
            return Ok(None);
        }
        Ok(self.delivered.pop_front())
    }

    fn write(&mut self, command: &Command) -> Result<(), RigFault> {
        if self.faults.active().bus_off() {
            return Err(RigFault::DriveLink);
        }
        if self.actuator.drive() == Drive::Tripped {
            return Err(RigFault::DriveTrip);
        }
        self.actuator.command(command);
        Ok(())
    }

    fn quick_stop(&mut self) {
        self.actuator.stop(false);
    }

    fn advance(&mut self) {
        self.now = self.faults.active();
        if self.now.trip() {
            self.actuator.stop(true);
        }
        if self.line.is_open() {
            self.actuator.stop(false);
        }
        self.move_table_and_specimen();
        let sample = self.take_sample();
        self.deliver(sample);
        self.sequence += 1;
    }

    fn stop_line(&self) -> Option<StopLine> {
        Some(self.line.clone())
    }

    fn chain_delay_s(&self) -> f64 {
        self.chain_delay_s
    }
}

#[cfg(test)]
mod tests;
