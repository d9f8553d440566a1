//! Records of an applied force: it drives the mass, whose displacement or acceleration or both are seen.

use super::coherence::beside_answers;
use super::fused::{differentiate, fuse, integrate};
use super::kinematics::{Estimate, Instruments, earlier, on_time};
use super::motion::{Motion, MotionError, channel, driving, rms};
use super::spectral::noise_of_sensor;
use crate::record::Record;

/// Noise over the rms of a force from which on the upper part of the spectrum is taken for force, and what its sensor's noise is then
/// taken to be.
const FILLED: f64 = 0.3;
const UNKNOWN: f64 = 2e-3;

/// The record of an applied force, that came so much later than what answers it (s, below zero earlier), with the force on time.
pub fn force_on_time(record: &Record, late_s: f64) -> Record {
    let force_n = match late_s {
        0.0 => record.force_n.clone(),
        _ => earlier(&record.force_n, late_s, record.sample_rate_hz),
    };
    Record { force_n, ..record.clone() }
}

/// Noise of the sensor of an applied force of which so much looks like white noise: of one that fills the band, what displacement and
/// acceleration that answer it (those that were measured) do not show, too; where even that is most of it, nothing tells.
pub fn applied_noise(hiss: f64, force: &[f64], answers: [&[f64]; 2], sample_rate_hz: f64) -> f64 {
    let noise = beside_answers(hiss, force, &answers, sample_rate_hz);
    match rms(force) {
        size if noise < FILLED * size => noise,
        size => UNKNOWN * size,
    }
}

/// The motion of a mass that a force is applied to, with instruments corrected as they were found.
pub(super) fn motion(
    record: &Record,
    mass_kg: f64,
    found: Option<Instruments>,
) -> Result<Motion, MotionError> {
    let rate = record.sample_rate_hz;
    let force = channel(record, &record.force_n, "force_n")?;
    let displacement = channel(record, &record.displacement_m, "displacement_m").ok();
    let acceleration = channel(record, &record.acceleration_m_s2, "acceleration_m_s2").ok();
    let noise = |x: &[f64]| noise_of_sensor(x, rate);
    let [of_displacement, of_acceleration] = match &found {
        Some(i) => [
            (i.laser_delay_s, i.laser_gain.value),
            (i.accelerometers_late_s(), i.accelerometers[0].gain.value),
        ],
        None => [(Estimate::default(), 1.0); 2],
    };
    let corrected = |seen: &[f64], (late, gain): (Estimate, f64)| -> Vec<f64> {
        on_time(seen, late, noise(seen), rate).into_iter().map(|x| x / gain).collect()
    };
    let displacement = displacement.map(|seen| corrected(seen, of_displacement));
    let acceleration = acceleration.map(|seen| corrected(seen, of_acceleration));
    let [of_d, of_a] = [&displacement, &acceleration].map(|x| x.as_deref().map_or(0.0, noise));
    let fused = match (&displacement, &acceleration) {
        (Some(d), Some(a)) => fuse(d, of_d, a, of_a, rate),
        (Some(d), None) => differentiate(d, of_d, rate),
        (None, Some(a)) => integrate(a, of_a, rate),
        (None, None) => {
            return Err(MotionError::MissingChannel {
                kind: "force",
                channel: "displacement_m or acceleration_m_s2",
            });
        }
    };
    let (seen, noise_acceleration) = match &acceleration {
        Some(a) => (a.clone(), of_a),
        None => (fused.acceleration_m_s2.clone(), fused.acceleration_noise_m_s2),
    };
    let over_mass: Vec<f64> = force.iter().map(|f| f / mass_kg).collect();
    let answers = [&record.displacement_m[..], &record.acceleration_m_s2];
    let drive_noise_m_s2 = applied_noise(noise(&over_mass), &over_mass, answers, rate);
    Ok(Motion {
        restoring_m_s2: over_mass.iter().zip(&seen).map(|(f, a)| f - a).collect(),
        drive_m_s2: driving(&over_mass, &fused.displacement_m, rate),
        seen_drive_m_s2: over_mass.iter().map(|f| -f).collect(),
        sees_acceleration: acceleration.is_some(),
        drive_noise_m_s2,
        restoring_noise_m_s2: drive_noise_m_s2.hypot(noise_acceleration),
        laser_noise_m: of_d,
        laser_m: displacement.unwrap_or_default(),
        instruments: found,
        ..fused.motion(record)
    })
}
