//! Records of a component: a motion is imposed on it, the force that takes is measured. Nothing moves freely: the model's mass is a
//! number that force is told over, here as in all other records.

use super::fused::Fused;
use super::imposed::imposed;
use super::jumpless::noise_beside_jumps;
use super::motion::{Motion, MotionError, channel};
use super::response::{are_too_many, beside_jumps_of_few_samples};
use super::spectral::noise_of_sensor;
use crate::model::{ModelSpec, hermite};
use crate::record::{Kind, Record};

/// The motion that was imposed and the force it took, over the mass of the model.
pub(super) fn motion(record: &Record, mass_kg: f64) -> Result<Motion, MotionError> {
    let force = channel(record, &record.force_n, "force_n")?;
    let (fused, laser_noise_m) = followed(record)?;
    Ok(Motion {
        restoring_m_s2: force.iter().map(|f| f / mass_kg).collect(),
        restoring_noise_m_s2: noise_beside_jumps(force, record.sample_rate_hz) / mass_kg,
        laser_noise_m,
        ..fused.motion(record)
    })
}

/// Displacement (m) and velocity (m/s) that were imposed on a component, sample by sample, as models are fitted along them: without most of their
/// noise, and at rest where a place is held.
///
/// # Errors
/// A channel that is missing.
pub fn imposed_on_component(record: &Record) -> Result<[Vec<f64>; 2], MotionError> {
    let (fused, _) = followed(record)?;
    Ok([fused.displacement_m, fused.velocity_m_s])
}

/// What is imposed, with the noise of its sensor (m rms).
fn followed(record: &Record) -> Result<(Fused, f64), MotionError> {
    let displacement = channel(record, &record.displacement_m, "displacement_m")?;
    let noise_m = noise_of_sensor(displacement, record.sample_rate_hz);
    Ok((imposed(displacement, noise_m, record.sample_rate_hz), noise_m))
}

/// The motion that a component's force answers, where that comes so much later than the motion as it was recorded (s, below zero earlier): along
/// the cubic through two samples and their velocities.
pub fn answered(motion: &Motion, late_s: f64) -> Motion {
    let dt_s = motion.dt_s();
    let mut out = motion.clone();
    for record in motion.records() {
        let last = record.end.saturating_sub(2).max(record.start);
        for n in record.clone() {
            let at = n as f64 - late_s / dt_s;
            let before = (at.floor().max(record.start as f64) as usize).min(last);
            let u = (at - before as f64).clamp(0.0, 1.0);
            let after = (before + 1).min(record.end - 1);
            let [d0, d1] = [before, after].map(|i| motion.displacement_m[i]);
            let [s0, s1] = [before, after].map(|i| motion.velocity_m_s[i] * dt_s);
            out.displacement_m[n] = hermite(d0, s0, d1, s1, u);
            out.velocity_m_s[n] = (6.0 * u * (1.0 - u) * (d1 - d0)
                + (1.0 - u) * (1.0 - 3.0 * u) * s0
                + u * (3.0 * u - 2.0) * s1)
                / dt_s;
        }
    }
    out
}

/// Whether each sample of a component's force counts: where a joint opens or friction turns, which of two samples it falls between is
/// chance, and beside a corner of the velocity that is not known. Nothing for the other kinds, whose response decides.
pub(super) fn beside_jumps(motion: &Motion) -> Vec<bool> {
    if motion.kind != Kind::Component {
        return Vec::new();
    }
    let counts = beside_jumps_of_few_samples(&motion.restoring_m_s2, motion.restoring_noise_m_s2);
    let told = &motion.velocity_is_told;
    // Too many, and the noise was told wrong.
    if are_too_many(&counts) {
        return told.clone();
    }
    counts.into_iter().enumerate().map(|(n, counts)| counts && told.get(n) != Some(&false)).collect()
}

/// Change of a component's force over the mass with the velocity at a sample, 1/s: viscous damping, that of a bumper in contact with
/// it. The velocity of a component is the derivative of its noisy displacement; that of a mass is told better, from its acceleration.
pub(super) fn damping<'m>(motion: &'m Motion, spec: &ModelSpec) -> impl Fn(usize) -> f64 + use<'m> {
    let component = motion.kind == Kind::Component;
    let of_isolator = if component { spec.isolator.damping_n_s_m / spec.mass_kg } else { 0.0 };
    let bumper = spec.bumper.as_ref().filter(|_| component);
    let (of_bumper, half_gap_m) =
        bumper.map_or((0.0, f64::INFINITY), |b| (b.damping_n_s_m / spec.mass_kg, 0.5 * b.total_gap_m));
    move |n| {
        let touches = of_bumper > 0.0 && motion.displacement_m[n].abs() > half_gap_m;
        of_isolator + if touches { of_bumper } else { 0.0 }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::TAU;

    #[test]
    fn a_motion_is_moved_by_parts_of_a_sample_and_stands_still_beyond_its_ends() {
        let at = |t: f64| ((TAU * t).sin(), TAU * (TAU * t).cos());
        let record = Record {
            time_s: (0..200).map(|i| f64::from(i) / 50.0).collect(),
            displacement_m: (0..200).map(|i| at(f64::from(i) / 50.0).0).collect(),
            force_n: vec![1.0; 200],
            ..Record::empty("sine", Kind::Component, 50.0)
        };
        let mut sine = motion(&record, 1.0).expect("a motion");
        (sine.displacement_m, sine.velocity_m_s) = (0..200).map(|i| at(f64::from(i) / 50.0)).unzip();
        for late in [-1.7, -0.5, 0.3, 2.25] {
            let moved = answered(&sine, late / 50.0);
            for n in 3..197 {
                let (d, v) = at((n as f64 - late) / 50.0);
                assert!((moved.displacement_m[n] - d).abs() < 1e-5, "{late} {n}");
                assert!((moved.velocity_m_s[n] - v).abs() < 1e-3, "{late} {n}");
            }
        }
        let moved = answered(&sine, 0.1);
        assert!(moved.displacement_m[..5].iter().all(|d| (d - sine.displacement_m[0]).abs() < 1e-12));
    }
}
