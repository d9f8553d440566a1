//! The measured motion, ready for a model to be laid against it.
//!
//! A record of any kind becomes one thing here: displacement and velocity of the mass with little
//! noise, and the restoring force over the mass that must have acted (`-A` of a base record,
//! `F/M - a` of a force record, `F/M` of a component record). Laser and
//! accelerometers are fused: the laser counts below, the twice integrated accelerations above the
//! frequency where their noises are equal (a Wiener filter, zero phase).

use super::fastest::fastest_hz;
use super::kinematics::{self, Instruments, Tolerances};
use super::lines::along_straight_lines;
use super::together::Source;
use super::{applied, base, component, periodic, windows};
use crate::model::ModelSpec;
use crate::record::{Kind, Record};
use std::ops::Range;

/// A stretch of the record in steady state (or any stretch, where there are no steps).
#[derive(Clone, Debug, PartialEq)]
pub struct Window {
    /// Sweep step, or the number of the stretch.
    pub step: i32,
    /// Main frequency, Hz.
    pub frequency_hz: f64,
    /// Samples before the window that warm up hidden states, from here to `range.start`.
    pub warm_from: usize,
    /// Displacements (m) at which the motion has turned before `warm_from`, in their order, but for loops that have closed since.
    pub reversals_m: Vec<f64>,
    /// Samples that count.
    pub range: Range<usize>,
    /// Kept back from every fit; judges what was fitted.
    pub held_out: bool,
    /// The motion settles in it, and goes farther than in any steady stretch.
    pub settling: bool,
    /// The record has no steady steps: what drives it is known as it was measured.
    pub random: bool,
    /// Number of the record that it comes from.
    pub source: usize,
    /// Noise that is left in what drives a simulation, m/s2 rms a sample over the window.
    pub drive_noise_m_s2: f64,
    /// Noise on a sine of the main frequency in it, m/s2 rms a sample.
    pub wave_noise_m_s2: f64,
    /// Where what drives a simulation is known no better than it was measured.
    pub as_measured: AsMeasured,
}

/// Samples in which what drives a simulation is known no better than it was measured, as where impacts kick the table.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct AsMeasured {
    /// White noise in them, m/s2 rms a sample.
    pub noise_m_s2: f64,
    /// Samples of the record.
    pub stretches: Vec<Range<usize>>,
}

impl Window {
    /// A steady stretch that is fitted; what drives it and what it remembers is found out when all are known.
    pub(super) fn steady(step: i32, frequency_hz: f64, warm_from: usize, range: Range<usize>) -> Self {
        Self {
            step,
            frequency_hz,
            warm_from,
            reversals_m: Vec::new(),
            range,
            held_out: false,
            settling: false,
            random: false,
            source: 0,
            drive_noise_m_s2: 0.0,
            wave_noise_m_s2: 0.0,
            as_measured: AsMeasured::default(),
        }
    }
}

/// The motion of one record.
#[derive(Clone, Debug)]
pub struct Motion {
    /// Kind of the record.
    pub kind: Kind,
    /// Mass that the motion was made with, kg.
    pub mass_kg: f64,
    /// Sampling rate, Hz.
    pub sample_rate_hz: f64,
    /// Frequency up to which it moves, Hz; 0 of a base record, and where every model holds so far.
    pub fastest_hz: f64,
    /// The records that it consists of, one unless several were put together.
    pub sources: Vec<Source>,
    /// Displacement of the mass relative to its support, m.
    pub displacement_m: Vec<f64>,
    /// Its rate, m/s.
    pub velocity_m_s: Vec<f64>,
    /// Whether each sample of that is told, of the motion that is imposed on a component: not beside corners that its noise hides. Empty for the
    /// other kinds.
    pub(super) velocity_is_told: Vec<bool>,
    /// Whether each sample is held where it is, of the motion that is imposed on a component. Empty for the other kinds.
    pub(super) is_held: Vec<bool>,
    /// Restoring force over the mass, m/s2. Opposes positive motion.
    pub restoring_m_s2: Vec<f64>,
    /// What drives a simulation: the table acceleration that is equivalent to the input, m/s2.
    pub drive_m_s2: Vec<f64>,
    /// The same as it was seen, where a solver is given something else to make up for what it makes of samples; else empty.
    pub(super) seen_drive_m_s2: Vec<f64>,
    /// Displacement as the laser saw it, instruments corrected, m; empty where none was measured.
    pub laser_m: Vec<f64>,
    /// Steady stretches.
    pub windows: Vec<Window>,
    /// Below this frequency the table's displacement tells what drives a base record, rad/s; 0 where its accelerometer alone does.
    pub table_crossover_rad_s: f64,
    /// Deviation of the gain between both.
    pub table_gain_sigma: f64,
    /// Whether the acceleration was measured, or is the second derivative of the displacement and says nothing beside it. Of a component
    /// record: whether the force was.
    pub sees_acceleration: bool,
    /// Noise of the sensor that tells what drives a simulation, m/s2 rms a sample.
    pub drive_noise_m_s2: f64,
    /// Noise of the restoring force over the mass, m/s2 rms a sample.
    pub restoring_noise_m_s2: f64,
    /// Noise of the laser, m rms a sample.
    pub laser_noise_m: f64,
    /// Noise of the fused displacement, m rms.
    pub displacement_noise_m: f64,
    /// Noise of the fused velocity, m/s rms.
    pub velocity_noise_m_s: f64,
    /// The instruments of a base record.
    pub instruments: Option<Instruments>,
}

/// Why a record cannot be turned into a motion.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum MotionError {
    /// A channel that the kind needs is missing or has another length.
    #[error("a {kind} record needs {channel}; it is missing or of another length")]
    MissingChannel {
        /// Kind of the record.
        kind: &'static str,
        /// The channel.
        channel: &'static str,
    },
    /// Too few samples.
    #[error("{samples} samples are too few; at least {needed} are needed")]
    TooShort {
        /// Samples there are.
        samples: usize,
        /// Samples needed.
        needed: usize,
    },
}

const FEWEST: usize = 256;
/// No chain of sensor and converter is straight to better than this, over the rms of what it shows.
pub(crate) const FINEST: f64 = 1e-6;
/// Samples in a cycle below which jumps of an acceleration are left as they are: spreading them takes a hundredth off what has nine, and a
/// third off what has three.
const FEW: f64 = 20.0;
/// Samples in a cycle from which on lines between them take less than a ten-thousandth off a sine: `(pi/n)^2/3`.
pub(crate) const ALONG_LINES: usize = 200;
/// How well a solver that joins samples of a force by straight lines then tells the force of a dashpot, over the rms of the restoring force:
/// displacements are made up for, velocities between the samples are others.
const COARSE: f64 = 2e-3;
/// A force that is nowhere more than this share of the largest restoring force only hisses, unless it works: in all stretches so much of the largest kinetic
/// energy of the mass. One that keeps a resonance going is small, too.
const LET_GO: f64 = 0.02;
const WORKS: f64 = 0.1;
impl Motion {
    /// Corrects, fuses and cuts a record.
    ///
    /// # Errors
    /// A missing channel, or too few samples.
    pub fn of(record: &Record, mass_kg: f64, tolerances: Tolerances) -> Result<Self, MotionError> {
        Self::with(record, mass_kg, kinematics::examine(record, tolerances), false)
    }

    /// The same of its record with the cycles in which the mass goes farther than in any steady stretch: for the last fit of a model that
    /// is to follow it there, too. A search does without: what drives them is known with noise, and fits take many more rounds.
    ///
    /// # Errors
    /// As of the motion itself.
    pub fn farthest(&self, record: &Record) -> Result<Self, MotionError> {
        Self::with(record, self.mass_kg, self.instruments.clone(), true)
    }

    /// As [`Motion::of`], the instruments taken to be sound.
    ///
    /// # Errors
    /// A missing channel, or too few samples.
    pub fn uncorrected(record: &Record, mass_kg: f64) -> Result<Self, MotionError> {
        Self::with(record, mass_kg, None, false)
    }

    fn with(
        record: &Record,
        mass_kg: f64,
        instruments: Option<Instruments>,
        farthest: bool,
    ) -> Result<Self, MotionError> {
        if record.time_s.len() < FEWEST {
            return Err(MotionError::TooShort { samples: record.time_s.len(), needed: FEWEST });
        }
        let mut motion = match record.kind {
            Kind::Base => base::motion(record, instruments)?,
            Kind::Force => applied::motion(record, mass_kg, instruments)?,
            Kind::Component => component::motion(record, mass_kg)?,
        };
        motion.mass_kg = mass_kg;
        motion.fastest_hz = fastest_hz(record);
        motion.windows = windows::cut(record, &motion, farthest);
        let by_lines = motion.sample_rate_hz < ALONG_LINES as f64 * motion.median_frequency_hz();
        if motion.kind == Kind::Base && (by_lines || motion.windows.iter().any(|window| window.random)) {
            let over_mass: Vec<f64> = motion.drive_m_s2.iter().map(|table| -table).collect();
            motion.drive_m_s2 = driving(&over_mass, &motion.displacement_m, motion.sample_rate_hz);
        }
        if motion.is_coarse() {
            let solver = COARSE * motion.restoring_rms_m_s2();
            motion.restoring_noise_m_s2 = motion.restoring_noise_m_s2.hypot(solver);
        }
        motion.note_reversals();
        motion.remove_acceleration_zeros();
        motion.remove_noise_of_the_table();
        Ok(motion)
    }

    /// Sample period, s.
    pub fn dt_s(&self) -> f64 {
        1.0 / self.sample_rate_hz
    }

    /// An acceleration that is seen has so few samples in a cycle that what a jump is spread over is as long as what moves.
    pub(super) fn is_coarse(&self) -> bool {
        let few = self.sample_rate_hz < FEW * self.median_frequency_hz();
        self.kind != Kind::Component && self.sees_acceleration && few
    }

    /// The least noise that a restoring force can have, over its rms.
    pub(crate) fn finest(&self) -> f64 {
        if self.is_coarse() { COARSE } else { FINEST }
    }

    /// What drives a simulation of a model over what drives it for the mass that the motion was made with: a force drives a heavier mass
    /// less.
    pub(super) fn driven_by(&self, spec: &ModelSpec) -> f64 {
        let errors = spec.effects.iter().filter_map(|effect| effect.parameters.get("dm_kg"));
        match self.kind {
            Kind::Force => self.mass_kg / (spec.mass_kg + errors.sum::<f64>()),
            Kind::Base | Kind::Component => 1.0,
        }
    }

    /// Whether an applied force tells the mass: of a mass that was only let go, as of one on a moving base, force over mass is all that
    /// shows.
    pub(crate) fn tells_mass(&self) -> bool {
        let largest = |channel: &[f64]| {
            let windows = self.windows.iter().flat_map(|window| &channel[window.range.clone()]);
            windows.fold(0.0_f64, |top, x| top.max(x.abs()))
        };
        let work = |window: &Window| {
            let each = window.range.clone().map(|n| -self.drive_m_s2[n] * self.velocity_m_s[n]);
            (each.sum::<f64>() * self.dt_s()).abs()
        };
        let works = || {
            let all = self.windows.iter().map(work).sum::<f64>();
            all > WORKS * 0.5 * largest(&self.velocity_m_s).powi(2)
        };
        self.kind == Kind::Force
            && (largest(&self.drive_m_s2) > LET_GO * largest(&self.restoring_m_s2) || works())
    }

    /// What drives a simulation at a sample, as the restoring force has it, m/s2.
    pub(super) fn seen_to_drive_m_s2(&self, n: usize) -> f64 {
        self.seen_drive_m_s2.get(n).copied().unwrap_or_else(|| self.drive_m_s2[n])
    }

    /// Whether a component is held where it is at a sample.
    pub fn is_held_at(&self, n: usize) -> bool {
        self.is_held.get(n) == Some(&true)
    }

    /// RMS of the restoring force over the mass in the windows, m/s2.
    pub fn restoring_rms_m_s2(&self) -> f64 {
        self.rms(&self.restoring_m_s2)
    }

    /// Typical frequency: the median over the windows, 1 Hz without any.
    pub fn median_frequency_hz(&self) -> f64 {
        let mut frequencies: Vec<f64> = self.windows.iter().map(|w| w.frequency_hz).collect();
        frequencies.sort_by(f64::total_cmp);
        frequencies.get(frequencies.len() / 2).copied().unwrap_or(1.0)
    }

    /// RMS of a channel in the windows.
    pub fn rms(&self, channel: &[f64]) -> f64 {
        let (mut sum, mut count) = (0.0, 0usize);
        for window in &self.windows {
            sum += channel[window.range.clone()].iter().map(|x| x * x).sum::<f64>();
            count += window.range.len();
        }
        (sum / count.max(1) as f64).sqrt()
    }

    /// Accelerations average to the change of velocity over the duration: what a window shows
    /// beyond that is the zero of an accelerometer, a nuisance, and is taken out. The table comes
    /// back to where it was in a whole cycle, so its mean is zero; a record without steps may end in motion, as one that was cut short does,
    /// and its displacement then tells how fast, where it was measured.
    fn remove_acceleration_zeros(&mut self) {
        if self.kind != Kind::Base {
            return;
        }
        let (dt, rate) = (self.dt_s(), self.sample_rate_hz);
        // From the first sample to the last, as velocities change.
        let mean = |x: &[f64]| match x {
            [first, .., last] => (x.iter().sum::<f64>() - 0.5 * (first + last)) / (x.len() - 1) as f64,
            _ => x.iter().sum(),
        };
        // Of mass and table, where the table is as fast at the end as at the beginning but for so much of its mean.
        let zero = |r: Range<usize>, moved: &dyn Fn(&[f64], f64) -> f64| {
            let change = (self.velocity_m_s[r.end - 1] - self.velocity_m_s[r.start])
                / ((r.len() - 1).max(1) as f64 * dt);
            let (table, of_table) = (&self.drive_m_s2[r.clone()], mean(&self.drive_m_s2[r.clone()]));
            let moved = moved(table, of_table);
            (-mean(&self.restoring_m_s2[r]) - change - moved, of_table - moved)
        };
        // In a part of a record without steps the table need not come back; it does in the whole.
        let parts =
            self.windows.windows(2).any(|two| !two[1].settling && two[1].warm_from < two[0].range.end);
        let whole = parts.then(|| {
            let (mass, table) = zero(0..self.drive_m_s2.len(), &|_, _| 0.0);
            let known = self.table_crossover_rad_s > 0.0;
            if known { (mass - table, 0.0) } else { (mass, table) }
        });
        // A steady step ends somewhere within a sample of whole cycles.
        let own = |window: &Window| {
            let steady = |table: &[f64], mean: f64| {
                mean - periodic::zero(table, window.frequency_hz, rate).unwrap_or(mean)
            };
            whole.unwrap_or_else(|| zero(window.range.clone(), &steady))
        };
        let zeros: Vec<(f64, f64)> = self.windows.iter().map(own).collect();
        // While it settles the table does not come back: zeros are as in the steady stretch before. A sample that several windows
        // share, as what warms them up, is corrected once.
        let mut done = vec![false; self.drive_m_s2.len()];
        let mut correct = |range: Range<usize>, (mass, table): (f64, f64)| {
            for n in range {
                if !std::mem::replace(&mut done[n], true) {
                    self.restoring_m_s2[n] += mass;
                    self.drive_m_s2[n] -= table;
                }
            }
        };
        let of = |i: usize| zeros[if self.windows[i].settling { i.saturating_sub(1) } else { i }];
        for settling in [false, true] {
            let chosen = || self.windows.iter().enumerate().filter(|(_, w)| w.settling == settling);
            chosen().for_each(|(i, window)| correct(window.range.clone(), of(i)));
            chosen().for_each(|(i, window)| correct(window.warm_from..window.range.start, of(i)));
        }
    }
}

/// What is to drive a simulation, as an acceleration of the table (m/s2), so that a force over the mass moves it as it did although a solver
/// joins samples by lines.
pub(crate) fn driving(over_mass_m_s2: &[f64], displacement_m: &[f64], rate: f64) -> Vec<f64> {
    along_straight_lines(over_mass_m_s2, displacement_m, rate).into_iter().map(|f| -f).collect()
}

pub(super) fn rms(x: &[f64]) -> f64 {
    (x.iter().map(|x| x * x).sum::<f64>() / x.len().max(1) as f64).sqrt()
}

pub(super) fn channel<'a>(
    record: &Record,
    values: &'a [f64],
    channel: &'static str,
) -> Result<&'a [f64], MotionError> {
    let kind = match record.kind {
        Kind::Base => "base",
        Kind::Force => "force",
        Kind::Component => "component",
    };
    if values.len() == record.time_s.len() {
        Ok(values)
    } else {
        Err(MotionError::MissingChannel { kind, channel })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::diagnose::testing::seen;
    use crate::model;
    use crate::model::testing::{b1_g2, oscillator};
    use std::f64::consts::TAU;

    #[test]
    fn a_record_that_was_cut_short_in_motion_has_no_other_zeros_and_ends_as_it_went() {
        use rand::{SeedableRng, prelude::Distribution};
        let of = |record: &Record| Motion::of(record, 500.0, Tolerances::default()).expect("a motion");
        let mut whole = seen(&b1_g2(), 44);
        // The table's displacement, a sine in each step.
        let mut random = rand_pcg::Pcg64::seed_from_u64(45);
        let hiss = rand_distr::Normal::new(0.0, 1e-5).expect("valid");
        for (step, range) in whole.step_ranges() {
            let w = TAU * (0.5 + 0.3 * f64::from(step.min(13 - step)));
            let first = range.start;
            let wave = |n: usize| (w * (n - first) as f64 / whole.sample_rate_hz).sin_cos();
            let (mut sin, mut cos) = (0.0, 0.0);
            for n in range.clone() {
                let (s, c) = wave(n);
                let share = 2.0 * whole.table_acceleration_m_s2[n] / range.len() as f64;
                (sin, cos) = (sin + share * s, cos + share * c);
            }
            for n in range {
                let (s, c) = wave(n);
                whole.table_displacement_m[n] = -(sin * s + cos * c) / (w * w) + hiss.sample(&mut random);
            }
        }
        let known = of(&whole);
        assert!(known.table_crossover_rad_s > 0.0, "the displacement tells what is slow");
        let third = whole.step_ranges()[2].1.clone();
        for share in [0.35, 0.6, 0.77] {
            let mut cut = whole.clone();
            let end = third.start + (share * third.len() as f64) as usize;
            cut.truncate(end);
            let motion = of(&cut);
            assert!(motion.windows.iter().any(|window| window.random), "too few steps are left");
            let last_second = (end - motion.sample_rate_hz as usize)..end;
            let apart =
                |a: &[f64], b: &[f64]| last_second.clone().map(|n| (a[n] - b[n]).abs()).fold(0.0, f64::max);
            let velocity = apart(&motion.velocity_m_s, &known.velocity_m_s);
            assert!(velocity < 2e-3 && known.rms(&known.velocity_m_s) > 0.05, "{share}: {velocity}");
            // Where the whole record has a steady step its zeros are known.
            let steady = known.windows[0].range.clone();
            let mean = |motion: &Motion| {
                motion.restoring_m_s2[steady.clone()].iter().sum::<f64>() / steady.len() as f64
            };
            let zero = mean(&motion) - mean(&known);
            assert!(zero.abs() < 5e-4, "{share}: {zero}");
        }
    }

    #[test]
    fn what_is_sampled_seldom_drives_a_mass_as_far_as_it_was_driven() {
        // A chirp of 4 to 9 Hz at 100 Hz drives a mass of 4 Hz; lines between the samples are up to 2.7 % short of it.
        const FINE: usize = 64;
        let (rate, spec) = (100.0, oscillator(2.0, 2.0 * (TAU * 4.0).powi(2), 3.0));
        let mut specimen = model::build(&spec, 1.0 / (rate * FINE as f64)).expect("builds");
        let mut record = Record::empty("chirp", Kind::Base, rate);
        for n in 0..3000 {
            for k in 0..FINE {
                let t = (n as f64 + k as f64 / FINE as f64) / rate;
                let table = (TAU * t * (4.0 + 2.5 * t / 30.0)).sin();
                let response = specimen.step(table);
                if k == 0 {
                    record.time_s.push(t);
                    record.table_acceleration_m_s2.push(table);
                    record.mass_acceleration_1_m_s2.push(response.mass_acceleration_m_s2);
                    record.relative_displacement_m.push(response.relative_displacement_m);
                }
            }
        }
        let motion = Motion::uncorrected(&record, 2.0).expect("a motion");
        let mut coarse = model::build(&spec, 1.0 / rate).expect("builds");
        let mut off = |drive: &[f64]| {
            coarse.reset();
            let (mut of, mut square) = (0.0, 0.0);
            for (n, table) in drive.iter().enumerate().take(2800) {
                let d = coarse.step(*table).relative_displacement_m;
                // From a second on the start is forgotten.
                if n > 400 {
                    square += (d - record.relative_displacement_m[n]).powi(2);
                    of += record.relative_displacement_m[n].powi(2);
                }
            }
            (square / of).sqrt()
        };
        let (lines, made_up_for) = (off(&record.table_acceleration_m_s2), off(&motion.drive_m_s2));
        assert!(lines > 5e-3 && made_up_for < 0.2 * lines, "{lines} {made_up_for}");
    }
}
