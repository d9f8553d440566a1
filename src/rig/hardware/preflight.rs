//! Before a run: zeros and noise at rest, the way to the centre, and a small sine that measures the delay of
//! the whole chain and shows swapped, inverted, dead and wrongly scaled channels.
//!
//! Called by [`HardwareRig::open`](super::HardwareRig::open) on a thread of its own; what it returns is shown to the
//! operator and stored with the run.

use super::signature::{Finding, NAMES, Response, delay_s, judge, ratios};
use super::{HardwareRig, HardwareSpec, PreflightSpec};
use crate::control::clock::{Clock, WallClock};
use crate::rig::{Rig, RigFault};
use crate::stream::{Command, Sample};
use nalgebra::{Complex, Matrix3, Vector3};
use serde::Serialize;
use std::f64::consts::TAU;

/// What the pre-flight measured.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Preflight {
    /// Name and number of the drive.
    pub drive: String,
    /// Serial number of the DAQ.
    pub daq: String,
    /// Delay from a command to its effect in the measured table motion, s.
    pub chain_delay_s: f64,
    /// Measured over commanded table displacement at the frequency of the check.
    pub table_gain: f64,
    /// The device's clock against the host's, parts per million.
    pub clock_drift_ppm: f64,
    /// Position of the table, m, before it was brought to its centre.
    pub found_at_m: f64,
    /// By channel.
    pub channels: Vec<ChannelCheck>,
}

/// One channel in the pre-flight.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ChannelCheck {
    /// Its name.
    pub channel: &'static str,
    /// Mean at rest, SI.
    pub zero: f64,
    /// Standard deviation at rest, SI.
    pub noise: f64,
    /// What it shows over what the others make one expect; 1 is sound.
    pub gain: f64,
}

/// Why the pre-flight did not pass.
#[derive(Debug, thiserror::Error)]
pub enum PreflightError {
    /// A link or the drive failed meanwhile.
    #[error("during the loop check: {reason}")]
    Rig {
        /// What happened, in the link's own words where it has any.
        reason: String,
        /// The fault as the control step would see it.
        fault: RigFault,
    },
    /// Too few samples came.
    #[error("during the loop check only {received} of {expected} samples came: check the DAQ cable")]
    Samples {
        /// Samples received.
        received: usize,
        /// Samples expected.
        expected: usize,
    },
    /// Something is wired or set wrongly.
    #[error("the loop check found: {}", .0.iter().map(ToString::to_string).collect::<Vec<_>>().join("; "))]
    Findings(Vec<Finding>),
}

impl std::fmt::Display for Preflight {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        writeln!(f, "drive: {}; DAQ: {}", self.drive, self.daq)?;
        writeln!(
            f,
            "loop check: chain delay {:.2} ms, table gain {:.4}, DAQ clock {:+.1} ppm, table found at {:.2} mm",
            1e3 * self.chain_delay_s,
            self.table_gain,
            self.clock_drift_ppm,
            1e3 * self.found_at_m
        )?;
        for check in &self.channels {
            writeln!(
                f,
                "  {:<22} zero {:>10.3e}  noise {:>9.2e}  gain {:.4}",
                check.channel, check.zero, check.noise, check.gain
            )?;
        }
        Ok(())
    }
}

/// Seconds of rest that are measured.
const REST_S: f64 = 0.5;
/// Closer to the centre than this needs no way, m.
const CENTRED_M: f64 = 20e-6;

/// Samples with the control period in which each was read.
struct Taken {
    samples: Vec<(u64, Sample)>,
    periods: u64,
}

/// Runs the whole check.
pub(super) fn run(
    rig: &mut HardwareRig,
    spec: &HardwareSpec,
    rate_hz: f64,
) -> Result<Preflight, PreflightError> {
    let found_at_m = rig.drive.position_m();
    let mut clock = WallClock::new(rate_hz);
    let measured = centre(rig, &mut clock, &spec.preflight, rate_hz, found_at_m)
        .and_then(|()| check_loop(rig, &mut clock, &spec.preflight, rate_hz));
    let clock_drift_ppm = rig.daq.counters().clock.drift_ppm;
    measured
        .map(|report| Preflight { clock_drift_ppm, found_at_m, ..report })
        .map_err(|error| explained(rig, error))
}

/// Brings the table to its centre.
fn centre(
    rig: &mut dyn Rig,
    clock: &mut dyn Clock,
    check: &PreflightSpec,
    rate_hz: f64,
    found_at_m: f64,
) -> Result<(), PreflightError> {
    let way_s = (2.0 * found_at_m.abs() / check.centre_speed_m_s).max(0.5);
    if found_at_m.abs() > CENTRED_M {
        drive_through(rig, clock, rate_hz, way_s, |t| to_centre(found_at_m, t / way_s, way_s))?;
    }
    Ok(())
}

/// Zeros and noise of a rig at rest in its centre, then the small sine; any rig, real or simulated. Drive and DAQ
/// stay unnamed.
///
/// # Errors
/// [`PreflightError`] when the rig fails meanwhile, too few samples come or something is wired wrongly.
pub fn check_loop(
    rig: &mut dyn Rig,
    clock: &mut dyn Clock,
    check: &PreflightSpec,
    rate_hz: f64,
) -> Result<Preflight, PreflightError> {
    let rest = drive_through(rig, clock, rate_hz, REST_S, |_| Command::default())?;
    let sine = Sine::new(check.frequency_hz, check.amplitude_m, check.cycles);
    let moved = drive_through(rig, clock, rate_hz, sine.duration_s(), |t| sine.at(t))?;
    // The last word is rest, which the link may carry forward for as long as it likes.
    drive_through(rig, clock, rate_hz, 0.05, |_| Command::default())?;
    let response = sine.response(&moved, rate_hz)?;
    let findings = judge(&response, check.gain_tolerance, check.longest_delay_s);
    if !findings.is_empty() {
        return Err(PreflightError::Findings(findings));
    }
    Ok(report(&rest, &response))
}

fn report(rest: &Taken, response: &Response) -> Preflight {
    let [x, a, a1, a2] = ratios(response).map(|ratio| ratio.norm());
    // The laser takes part in both accelerometers' ratios.
    let gains = [x, a, a1, a2, 2.0 / (a1 + a2)];
    let channels = (0..5)
        .map(|i| {
            let (zero, noise) = mean_and_deviation(rest.samples.iter().map(|(_, sample)| values(sample)[i]));
            ChannelCheck { channel: NAMES[i], zero, noise, gain: gains[i] }
        })
        .collect();
    Preflight { chain_delay_s: delay_s(response), table_gain: x, channels, ..Preflight::default() }
}

fn values(sample: &Sample) -> [f64; 5] {
    let c = &sample.channels;
    [
        c.table_displacement_m,
        c.table_acceleration_m_s2,
        c.mass_acceleration_1_m_s2,
        c.mass_acceleration_2_m_s2,
        c.relative_displacement_m,
    ]
}

fn mean_and_deviation(values: impl Iterator<Item = f64> + Clone) -> (f64, f64) {
    let count = values.clone().count().max(1) as f64;
    let mean = values.clone().sum::<f64>() / count;
    (mean, (values.map(|v| (v - mean).powi(2)).sum::<f64>() / count).sqrt())
}

/// Plays a command as the control thread would, and keeps what is measured.
fn drive_through(
    rig: &mut dyn Rig,
    clock: &mut dyn Clock,
    rate_hz: f64,
    duration_s: f64,
    command: impl Fn(f64) -> Command,
) -> Result<Taken, PreflightError> {
    let failed = |fault: RigFault| PreflightError::Rig { reason: fault.to_string(), fault };
    let periods = (duration_s * rate_hz).ceil() as u64;
    let mut taken = Taken { samples: Vec::with_capacity(periods as usize + 64), periods: 0 };
    while taken.periods < periods {
        let passed = clock.tick().periods;
        taken.periods += passed;
        for _ in 0..passed {
            rig.advance();
        }
        while let Some(sample) = rig.read().map_err(failed)? {
            taken.samples.push((taken.periods, sample));
        }
        rig.write(&command(taken.periods as f64 / rate_hz)).map_err(failed)?;
    }
    Ok(taken)
}

/// The error in the words of the link that failed, where it has any.
fn explained(rig: &HardwareRig, error: PreflightError) -> PreflightError {
    let complaints = rig.monitor().complaints();
    match error {
        PreflightError::Rig { fault, .. } if !complaints.is_empty() => {
            PreflightError::Rig { reason: complaints.join("; "), fault }
        }
        other => other,
    }
}

/// The quintic from `from_m` to 0 at the share `u` of its time.
fn to_centre(from_m: f64, u: f64, duration_s: f64) -> Command {
    let u = u.clamp(0.0, 1.0);
    let left = 1.0 - u * u * u * (10.0 - 15.0 * u + 6.0 * u * u);
    Command {
        displacement_m: from_m * left,
        velocity_m_s: -from_m * 30.0 * u * u * (1.0 - u) * (1.0 - u) / duration_s,
        acceleration_m_s2: -from_m * 60.0 * u * (1.0 - u) * (1.0 - 2.0 * u) / (duration_s * duration_s),
    }
}

/// A sine that grows over one cycle, is counted for some, and fades over one.
struct Sine {
    w: f64,
    amplitude_m: f64,
    period_s: f64,
    cycles: f64,
}

impl Sine {
    fn new(frequency_hz: f64, amplitude_m: f64, cycles: u32) -> Self {
        Self { w: TAU * frequency_hz, amplitude_m, period_s: 1.0 / frequency_hz, cycles: f64::from(cycles) }
    }

    /// One cycle up, two to settle, the counted ones, one down.
    fn duration_s(&self) -> f64 {
        (self.cycles + 4.0) * self.period_s
    }

    fn at(&self, t: f64) -> Command {
        // Envelope and its derivatives: quintic at both ends.
        let end = self.duration_s();
        let (u, sign) = if t < self.period_s {
            (t / self.period_s, 1.0)
        } else if t > end - self.period_s {
            ((end - t).max(0.0) / self.period_s, -1.0)
        } else {
            (1.0, 1.0)
        };
        let e = u * u * u * (10.0 - 15.0 * u + 6.0 * u * u);
        let e1 = sign * 30.0 * u * u * (1.0 - u) * (1.0 - u) / self.period_s;
        let e2 = 60.0 * u * (1.0 - u) * (1.0 - 2.0 * u) / (self.period_s * self.period_s);
        let (sin, cos) = (self.w * t).sin_cos();
        let (s1, s2) = (self.w * cos, -self.w * self.w * sin);
        Command {
            displacement_m: self.amplitude_m * e * sin,
            velocity_m_s: self.amplitude_m * (e1 * sin + e * s1),
            acceleration_m_s2: self.amplitude_m * (e2 * sin + 2.0 * e1 * s1 + e * s2),
        }
    }

    /// Complex amplitudes over the counted cycles, by least squares of sine, cosine and constant.
    fn response(&self, taken: &Taken, rate_hz: f64) -> Result<Response, PreflightError> {
        // Sample numbers lie to periods as they did most of the time: the median forgives late bursts.
        let mut offsets: Vec<i64> =
            taken.samples.iter().map(|(period, s)| *period as i64 - s.sequence as i64).collect();
        offsets.sort_unstable();
        let expected = (self.cycles * self.period_s * rate_hz) as usize;
        let Some(offset) = offsets.get(offsets.len() / 2).copied() else {
            return Err(PreflightError::Samples { received: 0, expected });
        };
        let (from, to) = (3.0 * self.period_s, (3.0 + self.cycles) * self.period_s);
        let mut normal = Matrix3::zeros();
        let mut right = [Vector3::zeros(); 5];
        let mut received = 0;
        for (_, sample) in &taken.samples {
            // The control step pairs a sample with the command of the period before it was read.
            let t = (sample.sequence as i64 + offset - 1) as f64 / rate_hz;
            if !(from..to).contains(&t) {
                continue;
            }
            received += 1;
            let (sin, cos) = (self.w * t).sin_cos();
            let basis = Vector3::new(sin, cos, 1.0);
            // A Hann window: what the specimen still does at its own frequency must not leak in.
            let weight = 1.0 - (TAU * (t - from) / (to - from)).cos();
            normal += weight * basis * basis.transpose();
            for (sum, value) in right.iter_mut().zip(values(sample)) {
                *sum += weight * basis * value;
            }
        }
        let solved = (10 * received > 9 * expected).then(|| normal.try_inverse()).flatten();
        let inverse = solved.ok_or(PreflightError::Samples { received, expected })?;
        let channels = right.map(|sum| {
            let fit = inverse * sum;
            Complex::new(fit[0], fit[1]) / self.amplitude_m
        });
        Ok(Response { channels, w: self.w })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A command's velocity and acceleration are the derivatives of its displacement.
    fn assert_consistent(command: impl Fn(f64) -> Command, duration_s: f64) {
        let h = 1e-5;
        let mut worst = [0.0_f64; 2];
        for n in 1..1000 {
            let t = duration_s * f64::from(n) / 1000.0;
            let (before, now, after) = (command(t - h), command(t), command(t + h));
            worst[0] = worst[0]
                .max(((after.displacement_m - before.displacement_m) / (2.0 * h) - now.velocity_m_s).abs());
            worst[1] = worst[1]
                .max(((after.velocity_m_s - before.velocity_m_s) / (2.0 * h) - now.acceleration_m_s2).abs());
        }
        assert!(worst[0] < 1e-6 && worst[1] < 1e-4, "{worst:?}");
    }

    #[test]
    fn commands_are_smooth_and_end_at_rest() {
        let sine = Sine::new(2.0, 0.0015, 4);
        assert_consistent(|t| sine.at(t), sine.duration_s());
        assert_consistent(|t| to_centre(0.02, t / 2.0, 2.0), 2.0);
        for end in [sine.at(0.0), sine.at(sine.duration_s()), to_centre(0.02, 1.0, 2.0)] {
            assert!(end.displacement_m.abs() < 1e-12 && end.velocity_m_s.abs() < 1e-9, "{end:?}");
        }
    }

    #[test]
    fn the_delay_comes_out_whatever_the_numbers_begin_with() {
        let sine = Sine::new(2.0, 0.0015, 4);
        let (rate, delay) = (2048.0, 0.0037);
        let mut taken = Taken { samples: Vec::new(), periods: 0 };
        for period in 1..(sine.duration_s() * rate) as u64 {
            // The sample read in a period stands under the command of the period before.
            let t = (period as f64 - 1.0) / rate - delay;
            let mut sample = Sample { sequence: 90_000 + period, ..Sample::default() };
            sample.channels.table_displacement_m = if t > 0.0 { sine.at(t).displacement_m } else { 0.0 };
            taken.samples.push((period, sample));
        }
        let response = sine.response(&taken, rate).expect("enough samples");
        assert!((delay_s(&response) - delay).abs() < 1e-5, "{}", delay_s(&response));
        taken.samples.truncate(100);
        assert!(matches!(sine.response(&taken, rate), Err(PreflightError::Samples { .. })));
    }
}
