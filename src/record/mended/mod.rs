//! Faults of a chain of measurement that can be taken out because they cannot be the motion of a mass: samples that stand alone, and hum of
//! the mains. The record stays as it was written; what reads it to lay a model against it takes the mended one, with a note of what was done.

mod coupling;
mod hum;
mod spikes;

pub use hum::{Line, find_left, may_be_hum};

use super::data::{Kind, Record, Role};
use super::quality::{dies_out, response};
use crate::parallel;
use crate::signal::Spectrum;
use std::borrow::Cow;

/// The record with spikes and hum of the mains taken out and a note of each; the record itself where there are none.
pub fn mended(record: &Record) -> Cow<'_, Record> {
    let roles: Vec<Role> =
        record.channels().map(|(role, _)| role).filter(|role| *role != Role::Time).collect();
    let found = parallel::map(&roles, parallel::cores(), |role| mend(record, *role));
    let mut out = Cow::Borrowed(record);
    for (role, (channel, notes)) in roles.into_iter().zip(found) {
        if notes.is_empty() {
            continue;
        }
        let out = out.to_mut();
        out.notes.extend(notes);
        if let Some(to) = out.channel_mut(role) {
            *to = channel;
        }
    }
    if rests(&out) {
        let out = out.to_mut();
        out.table_acceleration_m_s2.fill(0.0);
        out.notes.push(format!(
            "{}: nothing but noise beside a motion that dies out: taken as a table that rests",
            Role::TableAcceleration.name()
        ));
    }
    // Of what the spikes and hum left.
    for coupling in coupling::find(&out) {
        let channel = coupling.undone(out.channel(coupling.role), out.sample_rate_hz);
        let out = out.to_mut();
        out.notes.push(format!(
            "{}: behind a coupling that blocks what is slow (AC), corner {:.4} Hz: undone",
            coupling.role.name(),
            coupling.corner_hz(),
        ));
        if let Some(to) = out.channel_mut(coupling.role) {
            *to = channel;
        }
    }
    out
}

/// Band that tells whether a channel is nothing but white noise, over half the sampling rate, and share of its rms that such noise makes up
/// at least.
const BAND: [f64; 2] = [0.2, 0.7];
const NOTHING_ELSE: f64 = 0.8;

/// Whether the table of a mass that is let go rests: its accelerometer shows noise. Delays and leaks would be told from that.
fn rests(record: &Record) -> bool {
    let table = &record.table_acceleration_m_s2;
    let noise = || Spectrum::tapered(table, record.sample_rate_hz).white_noise_rms(BAND[0], BAND[1]);
    record.kind == Kind::Base
        && !table.is_empty()
        && dies_out(response(record))
        && noise() > NOTHING_ELSE * rms_about_mean(table)
}

/// A channel without its spikes and hum, with notes of what was taken out; neither, where nothing was.
fn mend(record: &Record, role: Role) -> (Vec<f64>, Vec<String>) {
    let channel = record.channel(role);
    let mut notes = Vec::new();
    let mut out = Vec::new();
    let spikes = spikes::find(record, role);
    if !spikes.is_empty() {
        out = channel.to_vec();
        spikes.iter().for_each(|spike| spike.take_out(&mut out));
        let at: Vec<String> =
            spikes.iter().take(5).map(|spike| format!("{:.4}", record.time_s[spike.first])).collect();
        notes.push(format!(
            "{}: {} {} far from those beside {} (at {}{} s): replaced by what runs through those",
            role.name(),
            spikes.len(),
            if spikes.len() == 1 { "spike" } else { "spikes" },
            if spikes.len() == 1 { "it" } else { "them" },
            at.join(", "),
            if spikes.len() > 5 { ", ..." } else { "" },
        ));
    }
    let rate_hz = record.sample_rate_hz;
    for line in hum::find(if out.is_empty() { channel } else { &out }, record.input(), rate_hz) {
        if out.is_empty() {
            out = channel.to_vec();
        }
        line.take_out(&mut out, rate_hz);
        notes.push(format!(
            "{}: hum of the mains at {:.2} Hz, amplitude {:.2} % of the channel's rms: taken out",
            role.name(),
            line.frequency_hz(),
            100.0 * line.amplitude() / rms_about_mean(channel),
        ));
    }
    (out, notes)
}

fn rms_about_mean(x: &[f64]) -> f64 {
    let count = x.len().max(1) as f64;
    let mean = x.iter().sum::<f64>() / count;
    (x.iter().map(|x| (x - mean).powi(2)).sum::<f64>() / count).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{SeedableRng, prelude::Distribution};
    use std::f64::consts::TAU;

    /// A mass that is let go on a table of which an accelerometer says so much.
    fn let_go(table: impl Fn(f64) -> f64) -> Record {
        let mut random = rand_pcg::Pcg64::seed_from_u64(6);
        let mut record = Record::empty("let go", Kind::Base, 500.0);
        for i in 0..5000 {
            let t = f64::from(i) / 500.0;
            let [hiss, other, third]: [f64; 3] =
                std::array::from_fn(|_| rand_distr::StandardNormal.sample(&mut random));
            let d = 0.03 * (-0.9 * t).exp() * (TAU * 3.0 * t).cos();
            record.time_s.push(t);
            record.table_acceleration_m_s2.push(table(t) + 8e-3 * hiss);
            record.relative_displacement_m.push(d + 3e-5 * other);
            record.mass_acceleration_1_m_s2.push(-(TAU * 3.0).powi(2) * d + 8e-3 * third);
        }
        record
    }

    #[test]
    fn a_table_whose_accelerometer_hisses_rests() {
        // A laser 0.6 s early was told from it, and named.
        let rests = |record: &Record| mended(record).table_acceleration_m_s2.iter().all(|a| *a == 0.0);
        assert!(rests(&let_go(|_| 2e-3)));
        assert!(!rests(&let_go(|t| 0.1 * (-0.9 * t).exp() * (TAU * 3.0 * t).sin())));
    }
}
