//! Records of a moving base: the table's acceleration drives the mass, whose displacement and acceleration are fused, gains, leaks and delays
//! taken out.

use super::fused::{differentiate, fuse, integrate};
use super::kinematics::{Accelerometer, Instruments, on_time};
use super::motion::{Motion, MotionError, channel};
use super::table::Table;
use crate::record::Record;

/// The motion of a mass on a moving base, with instruments corrected as they were found.
pub(super) fn motion(record: &Record, found: Option<Instruments>) -> Result<Motion, MotionError> {
    let rate = record.sample_rate_hz;
    let table = channel(record, &record.table_acceleration_m_s2, "table_acceleration_m_s2")?;
    let laser = channel(record, &record.relative_displacement_m, "relative_displacement_m").ok();
    let [first, second] = [&record.mass_acceleration_1_m_s2, &record.mass_acceleration_2_m_s2]
        .map(|values| channel(record, values, "a mass acceleration").ok());
    let i = found.clone().unwrap_or_else(|| Instruments::assumed_sound(record));
    let [a1, a2] = i.accelerometers;
    let late = i.accelerometers_late_s();
    let of_mass = |channel: &[f64], a: Accelerometer| -> Vec<f64> {
        let both = on_time(channel, late, a.noise_m_s2, rate).into_iter().zip(table);
        both.map(|(seen, table)| (seen - a.leak.value * table) / a.gain.value).collect()
    };
    // A channel's noise is scaled along with it.
    let noise = |a: Accelerometer| (a.noise_m_s2 / a.gain.value).abs();
    let mass = match (first, second) {
        (Some(one), Some(two)) => {
            let both = of_mass(one, a1).into_iter().zip(of_mass(two, a2));
            Some((
                both.map(|(one, two)| 0.5 * (one + two)).collect::<Vec<_>>(),
                0.5 * noise(a1).hypot(noise(a2)),
            ))
        }
        (Some(alone), None) => Some((of_mass(alone, a1), noise(a1))),
        (None, Some(alone)) => Some((of_mass(alone, a2), noise(a2))),
        (None, None) => None,
    };
    let laser: Option<Vec<f64>> = laser.map(|laser| {
        on_time(laser, i.laser_delay_s, i.laser_noise_m, rate)
            .into_iter()
            .map(|x| x / i.laser_gain.value)
            .collect()
    });
    let laser_noise_m = (i.laser_noise_m / i.laser_gain.value).abs();
    let both = Table::of(record, i.table_noise_m_s2);
    let relative =
        |mass: &[f64]| -> Vec<f64> { mass.iter().zip(&both.acceleration_m_s2).map(|(a, t)| a - t).collect() };
    let fused = match (&laser, &mass) {
        (Some(laser), Some((mass, noise))) => {
            fuse(laser, laser_noise_m, &relative(mass), noise.hypot(i.table_noise_m_s2), rate)
        }
        (Some(laser), None) => differentiate(laser, laser_noise_m, rate),
        (None, Some((mass, noise))) => integrate(&relative(mass), noise.hypot(i.table_noise_m_s2), rate),
        (None, None) => {
            return Err(MotionError::MissingChannel {
                kind: "base",
                channel: "relative_displacement_m or mass_acceleration_1_m_s2",
            });
        }
    };
    let sees_acceleration = mass.is_some();
    // Where no accelerometer is on the mass its acceleration is that of the displacement.
    let (mass, restoring_noise_m_s2) = mass.unwrap_or_else(|| {
        let over = fused.acceleration_m_s2.iter().zip(&both.acceleration_m_s2);
        (over.map(|(a, t)| a + t).collect(), fused.acceleration_noise_m_s2.hypot(i.table_noise_m_s2))
    });
    Ok(Motion {
        restoring_m_s2: mass.iter().map(|a| -a).collect(),
        drive_m_s2: both.acceleration_m_s2,
        table_crossover_rad_s: both.crossover_rad_s,
        table_gain_sigma: both.gain_sigma,
        laser_m: laser.unwrap_or_default(),
        sees_acceleration,
        drive_noise_m_s2: i.table_noise_m_s2,
        restoring_noise_m_s2,
        laser_noise_m,
        instruments: found,
        ..fused.motion(record)
    })
}
