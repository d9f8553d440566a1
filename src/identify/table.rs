//! What drives the simulation of a base record: the table's acceleration without the noise of its accelerometer, as far as the table
//! moves periodically. Called once when a record is made ready.

use super::motion::Motion;
use super::periodic::{periodic, smooth};
use crate::record::Kind;

/// A motion with more than this share of its sine beside it is no steady step with kicks, and is taken as it is.
const STEADY: f64 = 0.2;
/// Cycles of so many samples and more are long against what is smoothed.
const LONG: f64 = 320.0;

impl Motion {
    /// What drives a simulation has no noise where the table moves periodically, and less where impacts kick it alike in every
    /// cycle; a window tells what noise is left.
    pub(super) fn remove_noise_of_the_table(&mut self) {
        if self.kind != Kind::Base {
            return;
        }
        let rate = self.sample_rate_hz;
        let noise = self.instruments.as_ref().map_or(0.0, |i| i.table_noise_m_s2);
        for window in &mut self.windows {
            let range = window.warm_from..window.range.end;
            window.drive_noise_m_s2 = noise;
            if window.settling {
                continue;
            }
            let Some(found) = periodic(&self.drive_m_s2[range.clone()], window.frequency_hz, rate) else {
                continue;
            };
            let power = |x: &[f64]| x.iter().map(|x| x * x).sum::<f64>();
            if power(&found.rest) > STEADY * STEADY * power(&found.wave) {
                continue;
            }
            // Impacts kick the table alike in every cycle of a steady step.
            let (mut rest, noise) = match found.alike() {
                Some((alike, cycles)) => (alike, noise / cycles.sqrt()),
                None if !found.white => continue,
                None => (found.rest, noise),
            };
            let noisy =
                if found.white { found.still.iter().filter(|still| !**still).count() } else { range.len() };
            window.drive_noise_m_s2 = noise * (noisy as f64 / range.len() as f64).sqrt();
            // A solver takes long steps where what drives it is smooth; the impulse of a kick is what counts.
            if rate / window.frequency_hz.max(1e-9) > LONG {
                rest = smooth(&smooth(&rest));
            }
            let of_wave = found.wave.iter().zip(&rest).zip(&found.still);
            let drive =
                of_wave.map(|((wave, rest), still)| if found.white && *still { *wave } else { wave + rest });
            self.drive_m_s2[range].iter_mut().zip(drive).for_each(|(to, drive)| *to = drive);
        }
    }
}
