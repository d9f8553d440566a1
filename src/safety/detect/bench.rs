//! An ideal table and specimen for the tests of the detectors: 1 Hz at 0.5 m/s2, a little noise, to which a
//! test adds its fault.

use crate::model::Response;
use crate::rig::RigSpec;
use crate::safety::{DetectorId, Observation, Period, SafetySpec, Setup, Watch};
use crate::stream::{Channels, Command, Sample, StatusBits};
use crate::sweep::{CommandPoint, Direction, Segment, StepPhase};
use std::f64::consts::TAU;

/// A_G, m/s2.
pub const AMPLITUDE: f64 = 0.5;
const RATE_HZ: f64 = 2048.0;
/// Not a whole number of samples.
const DELAY_S: f64 = 2.56 / RATE_HZ;

/// Command at a time, s.
fn command(time_s: f64) -> Command {
    let (sin, cos) = (TAU * time_s).sin_cos();
    Command {
        displacement_m: -AMPLITUDE / (TAU * TAU) * sin,
        velocity_m_s: -AMPLITUDE / TAU * cos,
        acceleration_m_s2: AMPLITUDE * sin,
    }
}

/// Sample `k` of a run in which nothing is wrong. D = 6 mm sine, A from kinematics.
pub fn ideal(k: u64) -> Observation {
    let time_s = k as f64 / RATE_HZ;
    let table = command(time_s - DELAY_S);
    let noise = |n: u64| ((k * 7919 + n * 104_729) % 1009) as f64 / 1009.0 - 0.5;
    let d = 6e-3 * (TAU * time_s).sin();
    let a = table.acceleration_m_s2 - TAU * TAU * d;
    let channels = Channels {
        table_displacement_m: table.displacement_m + 2e-5 * noise(1),
        table_acceleration_m_s2: table.acceleration_m_s2 + 0.02 * noise(2),
        mass_acceleration_1_m_s2: a + 0.02 * noise(3),
        mass_acceleration_2_m_s2: a + 0.02 * noise(4),
        relative_displacement_m: d + 2e-5 * noise(5),
    };
    let phase = StepPhase {
        index: 0,
        direction: Direction::Forward,
        frequency_hz: 1.0,
        acceleration_amplitude_m_s2: AMPLITUDE,
        phase_rad: TAU * time_s,
        counted: true,
    };
    Observation {
        sample: Sample {
            sequence: k,
            device_time_us: (time_s * 1e6) as u64,
            channels,
            status: StatusBits(StatusBits::DRIVE_ENABLED),
        },
        reference: CommandPoint {
            command: command(time_s),
            jerk_m_s3: 0.0,
            phase: Some(phase),
            segment: Segment::Step,
        },
        response: Response { relative_displacement_m: d, ..Response::default() },
    }
}

/// A watch and the time.
pub struct Bench {
    pub watch: Watch,
    k: u64,
}

impl Bench {
    pub fn new() -> Self {
        let spec = SafetySpec::built_in().expect("valid");
        let setup = Setup {
            sample_rate_hz: RATE_HZ,
            chain_delay_s: DELAY_S,
            capacity: RigSpec::default().capacity(),
            total_gap_m: Some(0.020),
            bumper_stiffness_n_m: Some(33e3),
        };
        Self { watch: Watch::new(&spec, &setup), k: 0 }
    }

    /// Runs samples that `spoil` may change; the number of the first one at which a detector has tripped.
    pub fn run(&mut self, samples: u64, spoil: impl Fn(u64, &mut Observation)) -> Option<(u64, DetectorId)> {
        let mut tripped = None;
        for n in 1..=samples {
            let mut observation = ideal(self.k);
            spoil(self.k, &mut observation);
            self.k += 1;
            self.watch.observe(&observation);
            let findings = self.watch.period(&Period { samples: 1, ..Period::default() });
            tripped = tripped.or(findings.first.map(|id| (n, id)));
        }
        tripped
    }

    /// Six seconds in which no detector warns; the one asked for sees what it looks at.
    pub fn healthy(&mut self, id: DetectorId) {
        self.run(6 * 2048, |_, _| {});
        let findings = self.watch.findings();
        assert!(findings.warned.is_empty() && findings.tripped.is_empty(), "{findings:?}");
        for other in DetectorId::ALL {
            let (reading, warn) = (self.watch.reading(other), self.watch.threshold(other));
            assert!(reading.high_water < warn, "{other:?}: {reading:?}, {warn}");
        }
        assert!(self.watch.reading(id).value.is_finite());
    }

    /// Samples with the fault until this detector trips.
    pub fn until_trip(&mut self, id: DetectorId, spoil: impl Fn(u64, &mut Observation)) -> Option<u64> {
        (1..=20_480).find(|_| {
            self.run(1, &spoil);
            self.watch.findings().tripped.has(id)
        })
    }
}
