//! Noise in what drives a step: all of an earthquake's or of random noise, whose motion nothing tells from it, and that of the table's
//! accelerometer where impacts kick the table. The mass answers it as a resonator does, in both channels and over many cycles, and a
//! bumper makes much of it. Residuals and slopes are made white there. The search has it told with the jumps.

use super::innovations::{Along, Innovations, Slope};
use super::{Measured, QUIET, Window};
use crate::identify::least_squares::dot;
use crate::identify::motion::{AsMeasured, Motion};
use crate::model::ModelSpec;
use crate::parallel;
use crate::record::Kind;
use std::sync::Arc;

/// The least deviation of the zero of the table's acceleration.
const LEAST_ZERO_M_S2: f64 = 1e-6;

/// Noise in what drives a window, told.
#[derive(Debug)]
pub(super) struct Driven {
    along: Arc<Along>,
    /// What it does.
    alone: Arc<Innovations>,
    /// The same where there is slow noise of the displacement sensor.
    beside_slow: Option<Innovations>,
}

/// The same of every window, where there is any; no window before it was told.
pub(super) type OfWindows = Vec<Option<Arc<Driven>>>;

impl Driven {
    /// As it is known now.
    pub(super) fn innovations(&self) -> &Innovations {
        self.beside_slow.as_ref().unwrap_or(&self.alone)
    }

    /// Beside slow noise of the displacement sensor that grows by so much variance a sample.
    pub(super) fn beside(&self, growth: f64) -> Innovations {
        Innovations::new(&self.along, growth)
    }
}

impl Measured<'_> {
    /// Tells what noise in the drive does beside the motion of a fitted model. Once; says whether there is any.
    pub fn learn_noise_of_drive(&self, spec: &ModelSpec) -> bool {
        if !self.driven().is_empty() {
            return false;
        }
        let of = |window: &Window| {
            let along = self.noisy_along(window, spec)?;
            let alone = Arc::new(Innovations::new(&along, 0.0));
            Some(Arc::new(Driven { along: Arc::new(along), alone, beside_slow: None }))
        };
        let told = parallel::map(&self.motion.windows, parallel::cores(), of);
        let any = told.iter().any(Option::is_some);
        self.tell_driven(told);
        any
    }

    /// Has it beside slow noise of each record's displacement sensor that grows by so much variance a sample.
    pub(super) fn noise_of_drive_beside(&self, growths: &[f64]) {
        let told = self.driven();
        let each: Vec<_> = told.iter().zip(&self.motion.windows).collect();
        let beside = parallel::map(&each, parallel::cores(), |(driven, window)| {
            let driven = driven.as_ref()?;
            let growth = growths.get(window.source).copied().unwrap_or(0.0);
            let beside_slow = (growth > 0.0).then(|| driven.beside(growth));
            let (along, alone) = (driven.along.clone(), driven.alone.clone());
            Some(Arc::new(Driven { along, alone, beside_slow }))
        });
        self.tell_driven(beside);
    }

    fn tell_driven(&self, told: OfWindows) {
        if let Ok(mut now) = self.driven.write() {
            *now = Arc::new(told);
        }
    }

    /// The motion of a window where there is noise in what drives it.
    fn noisy_along(&self, window: &Window, spec: &ModelSpec) -> Option<Along> {
        let motion = self.motion;
        let drive_m_s2 = self.noise_of_drive(window)?;
        let spec = motion.sources[window.source].setting.of(spec);
        let range = window.range.clone();
        Some(Along {
            slopes: motion.displacement_m[range.clone()].iter().map(|d| slope(&spec, *d)).collect(),
            counts: self.counts()[range].to_vec(),
            drive_m_s2,
            noise_of_a_m_s2: motion.restoring_noise_m_s2,
            noise_of_d_m: if self.sees_displacement { motion.laser_noise_m } else { f64::INFINITY },
            dt_s: motion.dt_s(),
        })
    }

    /// Noise of what drives each sample of a window, m/s2; nothing where it is known better everywhere.
    fn noise_of_drive(&self, window: &Window) -> Option<Vec<f64>> {
        let samples = window.range.len();
        if window.random {
            let noise_m_s2 = window.drive_noise_m_s2;
            return (noise_m_s2 > QUIET * self.table_noise_m_s2).then(|| vec![noise_m_s2; samples]);
        }
        let AsMeasured { noise_m_s2, stretches } = &window.as_measured;
        if self.motion.kind != Kind::Base || window.settling || stretches.is_empty() {
            return None;
        }
        let mut drive = vec![0.0; samples];
        for stretch in stretches {
            let place = |n: usize| n.saturating_sub(window.range.start).min(samples);
            drive[place(stretch.start)..place(stretch.end)].fill(*noise_m_s2);
        }
        Some(drive)
    }

    /// Makes both channels of a step white.
    pub(super) fn whiten(&self, window: &Window, channels: &mut [f64]) {
        match self.driven_in(window) {
            Some(driven) => driven.innovations().whiten(&self.counts()[window.range.clone()], channels),
            None => self.whiten_displacement(window.source, &mut channels[window.range.len()..]),
        }
    }

    /// Takes from both channels of a step what noise in the drive has done: what is left is as much as their own noise.
    pub(super) fn follow_drive(&self, window: &Window, channels: &mut [f64]) {
        if let Some(driven) = self.driven_in(window) {
            driven.alone.whiten(&self.counts()[window.range.clone()], channels);
        }
    }

    /// Whether noise drives a record that has no steady steps.
    pub(super) fn is_driven_at_random(&self) -> bool {
        let told = self.driven();
        told.iter().zip(&self.motion.windows).any(|(driven, window)| window.random && driven.is_some())
    }

    fn driven(&self) -> Arc<OfWindows> {
        self.driven.read().map(|driven| driven.clone()).unwrap_or_default()
    }

    /// Noise in what drives a window; nothing where there is none, or before it was told.
    pub(super) fn driven_in(&self, window: &Window) -> Option<Arc<Driven>> {
        let all = self.driven();
        let index = self.motion.windows.iter().position(|w| std::ptr::eq(w, window))?;
        all.get(index)?.clone()
    }
}

/// Deviation of the zero of the table's acceleration, its mean over a record: without a displacement of the table nothing says that it
/// ends as fast as it began. A force that is off all the time is a finding. How fast either may be goes with the acceleration in the first and last cycle.
pub(super) fn zero_of_table_m_s2(motion: &Motion) -> f64 {
    let random = motion.kind == Kind::Base && motion.windows.iter().any(|window| window.random);
    if !random || motion.table_crossover_rad_s > 0.0 {
        return LEAST_ZERO_M_S2;
    }
    let (drive, frequency_hz) = (&motion.drive_m_s2, motion.median_frequency_hz());
    let cycle = ((motion.sample_rate_hz / frequency_hz) as usize).clamp(1, drive.len());
    let rms = |a: &[f64]| (dot(a, a) / a.len() as f64).sqrt();
    let ends = rms(&drive[..cycle]).hypot(rms(&drive[drive.len() - cycle..]));
    let speed_m_s = ends / (std::f64::consts::TAU * frequency_hz);
    (speed_m_s / (drive.len() as f64 * motion.dt_s())).max(LEAST_ZERO_M_S2)
}

/// Slopes of the restoring acceleration of isolator and bumper at a displacement.
fn slope(spec: &ModelSpec, displacement_m: f64) -> Slope {
    let isolator = &spec.isolator;
    let far = displacement_m.abs();
    let segment = isolator.breakpoints_m.iter().filter(|knee| far > **knee).count();
    let mut stiffness = isolator.stiffness_n_m.get(segment).copied().unwrap_or(0.0);
    let mut damping = isolator.damping_n_s_m;
    if let Some(bumper) = spec.bumper.as_ref().filter(|bumper| far > 0.5 * bumper.total_gap_m) {
        stiffness += bumper.stiffness_n_m;
        damping += bumper.damping_n_s_m;
    }
    [stiffness / spec.mass_kg, damping / spec.mass_kg]
}

#[cfg(test)]
mod tests {
    use super::super::tests::{fitted, off};
    use super::*;
    use crate::diagnose::testing::seen;
    use crate::identify::kinematics::Tolerances;
    use crate::identify::problem::Part;
    use rand::{SeedableRng, prelude::Distribution};
    use std::f64::consts::TAU;

    /// A motion with noise of 0.02 m/s2 in a quarter of what drives it, as where impacts kick the table; and the same with those samples told.
    fn kicked(seed: u64) -> [Motion; 2] {
        let mut motion = Motion::of(&seen(&off(), seed), 500.0, Tolerances::default()).expect("a motion");
        let mut random = rand_pcg::Pcg64::seed_from_u64(seed);
        let normal = rand_distr::Normal::new(0.0, 0.02).expect("valid");
        let is_kicked = |n: &usize| n % 400 < 100;
        let samples = motion.drive_m_s2.iter_mut().enumerate();
        samples.filter(|(n, _)| is_kicked(n)).for_each(|(_, a)| *a += normal.sample(&mut random));
        let mut told = motion.clone();
        for window in &mut told.windows {
            let stretches =
                (window.warm_from..window.range.end).filter(is_kicked).map(|n| n..n + 1).collect();
            window.as_measured = AsMeasured { noise_m_s2: 0.02, stretches };
        }
        [motion, told]
    }

    #[test]
    fn noise_in_what_drives_a_step_is_followed_where_it_is() {
        let excess = |motion: &Motion| {
            let measured = Measured::new(motion).expect("a base record");
            let told = measured.learn_noise_of_drive(&fitted(&measured).0);
            let (spec, _, laid) = fitted(&measured);
            (told, measured.left(&spec, Part::Training, &laid).expect("finite").excess)
        };
        let [(told_without, unseen), (told, followed)] = kicked(14).map(|motion| excess(&motion));
        assert!(!told_without && told);
        assert!(unseen > 0.02 && followed < 0.3 * unseen, "{unseen} {followed}");
    }

    #[test]
    fn slow_noise_of_the_displacement_is_told_beside_noise_in_what_drives_a_step() {
        let slow_hz = |motion: &Motion| {
            let measured = Measured::new(motion).expect("a base record");
            measured.learn_noise_of_drive(&fitted(&measured).0);
            // It tells itself beside what was told before.
            for _ in 0..2 {
                let (spec, numbers, laid) = fitted(&measured);
                let held_out = measured.judge(&spec, &numbers, &laid).expect("finite");
                measured.learn_slow_noise(
                    &spec,
                    &numbers,
                    [(Part::Training, &laid), (Part::HeldOut, &held_out)],
                );
            }
            measured.slow_noise_hz().first().copied().unwrap_or(0.0)
        };
        let [unseen, told] = kicked(15);
        let (mistaken_hz, none_hz) = (slow_hz(&unseen), slow_hz(&told));
        let mut random = rand_pcg::Pcg64::seed_from_u64(15);
        let mut drifting = told.clone();
        let (mut walk_m, growth_m) = (0.0, drifting.laser_noise_m * TAU * 2.0 * drifting.dt_s());
        for x in &mut drifting.laser_m {
            let normal: f64 = rand_distr::StandardNormal.sample(&mut random);
            walk_m += growth_m * normal;
            *x += walk_m;
        }
        let told_hz = slow_hz(&drifting);
        assert!(none_hz < 0.2 && mistaken_hz > 0.5, "{none_hz} Hz where there is none, {mistaken_hz} Hz");
        assert!((1.0..4.0).contains(&told_hz), "{told_hz} Hz of 2 Hz");
    }
}
