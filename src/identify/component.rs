//! Records of a component: a motion is imposed on it, the force that takes is measured. Nothing moves freely: the model's mass is a
//! number that force is told over, here as in all other records.

use super::fused::imposed;
use super::jumpless::noise_beside_jumps;
use super::motion::{Motion, MotionError, channel};
use super::response::{are_too_many, beside_jumps_of_few_samples};
use super::spectral::noise_of_sensor;
use crate::model::ModelSpec;
use crate::record::{Kind, Record};

/// The motion that was imposed and the force it took, over the mass of the model.
pub(super) fn motion(record: &Record, mass_kg: f64) -> Result<Motion, MotionError> {
    let rate = record.sample_rate_hz;
    let displacement = channel(record, &record.displacement_m, "displacement_m")?;
    let force = channel(record, &record.force_n, "force_n")?;
    let laser_noise_m = noise_of_sensor(displacement, rate);
    let fused = imposed(displacement, laser_noise_m, rate);
    Ok(Motion {
        restoring_m_s2: force.iter().map(|f| f / mass_kg).collect(),
        restoring_noise_m_s2: noise_beside_jumps(force, rate) / mass_kg,
        laser_noise_m,
        ..fused.motion(record)
    })
}

/// Whether each sample of a component's force counts: where a joint opens or friction turns, which of two samples it falls between is
/// chance. Nothing for the other kinds, whose response decides.
pub(super) fn beside_jumps(motion: &Motion) -> Vec<bool> {
    if motion.kind != Kind::Component {
        return Vec::new();
    }
    let counts = beside_jumps_of_few_samples(&motion.restoring_m_s2, motion.restoring_noise_m_s2);
    // Too many, and the noise was told wrong.
    if are_too_many(&counts) { Vec::new() } else { counts }
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
