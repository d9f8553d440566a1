//! The meters of the bench: peaks and phases of the newest cycle of the table, from the rows of the live
//! view. Fed by the live thread, shown by the page and by `shaketable watch`; nothing acts upon them.

use crate::stream::Row;
use serde::Serialize;
use utoipa::ToSchema;

/// Readings of the newest whole cycle of the table.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, ToSchema)]
pub struct Meters {
    /// Largest magnitude of the measured table acceleration, m/s2.
    pub table_acceleration_m_s2: f64,
    /// Largest magnitude of the commanded table acceleration, m/s2.
    pub command_acceleration_m_s2: f64,
    /// Largest magnitude of the acceleration of the mass A, m/s2.
    pub mass_acceleration_m_s2: f64,
    /// The same of the onboard model, m/s2.
    pub model_acceleration_m_s2: f64,
    /// Relative displacement D now, m.
    pub relative_displacement_m: f64,
    /// Excursion (largest minus smallest D), m.
    pub excursion_m: f64,
    /// The same of the onboard model, m.
    pub model_excursion_m: f64,
    /// Phase of D behind the commanded displacement of the table, deg, -180 to 180.
    pub phase_deg: f64,
    /// Oscillations of the mass in one cycle of the table.
    pub oscillations: f64,
    /// Bumper contacts in one cycle of the table, both sides, by the measured D.
    pub contacts: u32,
    /// Frequency of the command, Hz.
    pub frequency_hz: f64,
    /// RMS difference of A and the model's over the RMS of A.
    pub residual_a: f64,
    /// RMS difference of D and the model's over the RMS of D.
    pub residual_d: f64,
}

/// Least reversal of D that counts as one, m.
const REVERSAL_M: f64 = 0.6e-3;

/// Sums of the cycle that goes on.
#[derive(Clone, Copy, Debug)]
struct Cycle {
    rows: u64,
    table: f64,
    command: f64,
    mass: f64,
    model: f64,
    d: (f64, f64),
    model_d: (f64, f64),
    in_phase: f64,
    quadrature: f64,
    squares: [f64; 4],
    reversals: u32,
    contacts: u32,
}

impl Cycle {
    const EMPTY: Self = Self {
        rows: 0,
        table: 0.0,
        command: 0.0,
        mass: 0.0,
        model: 0.0,
        d: (f64::INFINITY, f64::NEG_INFINITY),
        model_d: (f64::INFINITY, f64::NEG_INFINITY),
        in_phase: 0.0,
        quadrature: 0.0,
        squares: [0.0; 4],
        reversals: 0,
        contacts: 0,
    };
}

/// Makes readings out of rows, one a cycle of the command.
#[derive(Clone, Debug)]
pub struct Gauge {
    rate_hz: f64,
    half_gap_m: Option<f64>,
    cycle: Cycle,
    before: f64,
    extreme: (f64, bool),
    touching: bool,
    readings: Meters,
}

impl Gauge {
    /// For a sampling rate (Hz) and half the total gap (m), if there are bumpers.
    pub fn new(rate_hz: f64, half_gap_m: Option<f64>) -> Self {
        Self {
            rate_hz,
            half_gap_m,
            cycle: Cycle::EMPTY,
            before: 0.0,
            extreme: (0.0, true),
            touching: false,
            readings: Meters::default(),
        }
    }

    /// The newest readings.
    pub fn readings(&self) -> Meters {
        self.readings
    }

    /// Takes a row.
    pub fn push(&mut self, row: &Row) {
        let (d, a) =
            (row.sample.channels.relative_displacement_m, row.sample.channels.mass_acceleration_m_s2());
        self.readings.relative_displacement_m = d;
        let c = &mut self.cycle;
        c.rows += 1;
        c.table = c.table.max(row.sample.channels.table_acceleration_m_s2.abs());
        c.command = c.command.max(row.command.acceleration_m_s2.abs());
        c.mass = c.mass.max(a.abs());
        c.model = c.model.max(row.model_acceleration_m_s2.abs());
        c.d = (c.d.0.min(d), c.d.1.max(d));
        let model_d = row.model_displacement_m;
        c.model_d = (c.model_d.0.min(model_d), c.model_d.1.max(model_d));
        // The commanded displacement is -a/w^2 and the velocity is a quarter of a cycle ahead of it.
        c.in_phase -= d * row.command.acceleration_m_s2;
        c.quadrature += d * row.command.velocity_m_s;
        let (ra, rd) = (a - row.model_acceleration_m_s2, d - model_d);
        for (sum, value) in c.squares.iter_mut().zip([ra, a, rd, d]) {
            *sum += value * value;
        }
        self.reverse(d);
        self.touch(d);
        let now = row.command.acceleration_m_s2;
        let begins = self.before <= 0.0 && now > 0.0;
        self.before = now;
        if begins {
            self.close();
        }
    }

    fn reverse(&mut self, d: f64) {
        let (extreme, rising) = self.extreme;
        let beyond = if rising { d > extreme } else { d < extreme };
        if beyond {
            self.extreme.0 = d;
        } else if (d - extreme).abs() > REVERSAL_M {
            self.cycle.reversals += 1;
            self.extreme = (d, !rising);
        }
    }

    fn touch(&mut self, d: f64) {
        let Some(half_gap_m) = self.half_gap_m else { return };
        // A tenth of a millimetre of hysteresis, three times the noise of the laser.
        let touching = d.abs() > half_gap_m - if self.touching { 1e-4 } else { 0.0 };
        self.cycle.contacts += u32::from(touching && !self.touching);
        self.touching = touching;
    }

    fn close(&mut self) {
        let c = std::mem::replace(&mut self.cycle, Cycle::EMPTY);
        // Noise around zero makes cycles of a few samples while the table rests.
        if (c.rows as f64) < 0.015 * self.rate_hz {
            return;
        }
        let frequency_hz = self.rate_hz / c.rows as f64;
        let w = std::f64::consts::TAU * frequency_hz;
        let ratio = |difference: f64, of: f64| if of > 0.0 { (difference / of).sqrt() } else { 0.0 };
        self.readings = Meters {
            table_acceleration_m_s2: c.table,
            command_acceleration_m_s2: c.command,
            mass_acceleration_m_s2: c.mass,
            model_acceleration_m_s2: c.model,
            relative_displacement_m: self.readings.relative_displacement_m,
            excursion_m: c.d.1 - c.d.0,
            model_excursion_m: c.model_d.1 - c.model_d.0,
            phase_deg: -(c.quadrature * w).atan2(c.in_phase).to_degrees(),
            oscillations: 0.5 * f64::from(c.reversals),
            contacts: c.contacts,
            frequency_hz,
            residual_a: ratio(c.squares[0], c.squares[1]),
            residual_d: ratio(c.squares[2], c.squares[3]),
        };
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::stream::{Channels, Command, Sample};
    use std::f64::consts::TAU;

    #[test]
    fn a_late_sine_reads_as_such() {
        let (rate, f, lag_deg) = (2048.0, 1.6, 70.0_f64);
        let mut gauge = Gauge::new(rate, Some(0.010));
        for n in 0..20_480 {
            let phase = TAU * f * f64::from(n) / rate;
            let w = TAU * f;
            let x = -0.004 * phase.sin();
            let command = Command {
                displacement_m: x,
                velocity_m_s: -0.004 * w * phase.cos(),
                acceleration_m_s2: -w * w * x,
            };
            let d = -0.011 * (phase - lag_deg.to_radians()).sin();
            let channels = Channels {
                table_acceleration_m_s2: command.acceleration_m_s2,
                mass_acceleration_1_m_s2: 3.0 * phase.sin(),
                mass_acceleration_2_m_s2: 3.0 * phase.sin(),
                relative_displacement_m: d,
                ..Channels::default()
            };
            let sample = Sample { channels, ..Sample::default() };
            let row = Row {
                sample,
                command,
                model_displacement_m: 0.9 * d,
                model_acceleration_m_s2: 3.0 * phase.sin(),
                ..Row::default()
            };
            gauge.push(&row);
        }
        let m = gauge.readings();
        assert!((m.frequency_hz - f).abs() < 0.01, "{m:?}");
        assert!((m.phase_deg + lag_deg).abs() < 1.0 || (m.phase_deg - lag_deg).abs() < 1.0, "{m:?}");
        assert!(m.phase_deg > 0.0, "a lag is positive: {m:?}");
        assert!(
            (m.excursion_m - 0.022).abs() < 1e-5 && (m.mass_acceleration_m_s2 - 3.0).abs() < 1e-3,
            "{m:?}"
        );
        assert_eq!((m.contacts, m.oscillations), (2, 1.0));
        assert!((m.residual_d - 0.1).abs() < 1e-6 && m.residual_a == 0.0, "{m:?}");
    }
}
