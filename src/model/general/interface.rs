//! The general solver as a [`Specimen`]: from sample to sample, over many of them, and along an imposed motion.

use super::super::cubic::Cubic;
use super::super::{Response, Specimen};
use super::dynamics::{Course, Drive, Joint, Line, Motion, Sliding, Tip};
use super::specimen::General;

/// Second differences over the rms from which on samples are joined by lines, as the closed-form solver joins them all.
const ROUGH: f64 = 0.005;

/// Whether a course bends so much at most of its samples, as noise has it do.
fn is_rough(samples: &[f64]) -> bool {
    let rms = (samples.iter().map(|x| x * x).sum::<f64>() / samples.len().max(1) as f64).sqrt();
    let bent = samples.windows(3).filter(|w| (w[2] - 2.0 * w[1] + w[0]).abs() > ROUGH * rms).count();
    2 * bent > samples.len()
}

impl<const N: usize> Specimen for General<N> {
    fn reset(&mut self) {
        self.y = [0.0; N];
        self.y[0] = self.system.equilibrium_m();
        self.at_rest = true;
        (self.time_s, self.table) = (0.0, Some(0.0));
        self.preferred_s = self.system.sample_period_s;
        let (length, frequency) = self.system.magnitudes();
        // What is far below the specimen's own size need not be resolved.
        self.largest = [1e-3 * length, 1e-3 * length * frequency];
        self.mode.tips = [Tip::default(); 2];
        // Which way it goes first is not known yet.
        self.mode.direction = 0;
        self.mode.joint = if self.system.joint_half_width_m.is_some() { Joint::Open } else { Joint::Rigid };
        self.forget();
        self.settle_mode();
    }

    fn step(&mut self, table_acceleration_m_s2: f64) -> Response {
        let dt = self.system.sample_period_s;
        let start = self.table.unwrap_or(table_acceleration_m_s2);
        let line = Line { start, slope: (table_acceleration_m_s2 - start) / dt };
        let forces = self.advance(dt, line, Motion::Free, &mut |_, _, _, _| {});
        self.prime(table_acceleration_m_s2);
        self.response(&forces)
    }

    fn run(&mut self, table_acceleration_m_s2: &[f64], visit: &mut dyn FnMut(&Response)) {
        let Some((first, last)) = table_acceleration_m_s2.first().zip(table_acceleration_m_s2.last()) else {
            return;
        };
        // A tip that relaxes by small steps has to be stated anew after each sample; and a course with corners at its samples leaves an
        // error control no step to lengthen, while a line from one to the next has none.
        if !self.system.bumper.relaxes_in_closed_form() || is_rough(table_acceleration_m_s2) {
            table_acceleration_m_s2.iter().for_each(|table| visit(&self.step(*table)));
            return;
        }
        let drive = Course {
            start: self.table.unwrap_or(*first),
            samples: table_acceleration_m_s2,
            rate_hz: 1.0 / self.system.sample_period_s,
        };
        if self.system.is_plain() {
            self.run_of::<true>(drive, visit);
        } else {
            self.run_of::<false>(drive, visit);
        }
        self.prime(*last);
    }

    fn impose(&mut self, relative_displacement_m: f64, relative_velocity_m_s: f64) -> Response {
        let dt = self.system.sample_period_s;
        // An imposed motion starts with everything undeformed: where a constant force would hold the mass is no place it comes from.
        if self.at_rest {
            self.at_rest = false;
            self.y[0] = 0.0;
            self.forget();
            self.settle_mode();
        }
        let (from, to) = ((self.y[0], self.y[1]), (relative_displacement_m, relative_velocity_m_s));
        let course = Cubic { from, to, during_s: dt };
        let (start, slope) = course.acceleration();
        let line = Line { start, slope };
        if self.imposes_by_sample() {
            return self.impose_sampled(&course, line);
        }
        if self.system.friction.is_some() && self.mode.sliding == Sliding::Stick {
            let moves = if from.1 != 0.0 { from.1 } else { to.0 - from.0 };
            self.mode.sliding = Sliding::Slip(if moves < 0.0 { -1 } else { 1 });
        }
        let still = Line { start: 0.0, slope: 0.0 };
        self.advance(dt, still, Motion::Imposed(line), &mut |_, _, _, _| {});
        (self.y[0], self.y[1]) = to;
        self.table = None;
        let at = (self.time_s, 0.0);
        let forces = self.system.rates(at, &self.y, &self.mode, &self.layout, Some(line.at(dt))).1;
        self.response(&forces)
    }

    fn memory(&self) -> Vec<f64> {
        self.remembering().into_iter().next().map(|range| self.y[range].to_vec()).unwrap_or_default()
    }

    fn recall(&mut self, memory: &[f64], now: (f64, f64)) {
        for range in self.remembering().into_iter().filter(|range| range.len() == memory.len()) {
            self.y[range].copy_from_slice(memory);
            self.at_rest = false;
            (self.y[0], self.y[1]) = now;
            self.settle_mode();
        }
    }

    fn hidden(&self) -> Vec<f64> {
        let jointed = self.system.joint_half_width_m.is_some();
        if jointed || self.system.isolator_terms.iter().any(|term| term.retraces()) {
            return Vec::new();
        }
        self.y[self.hidden_states()].to_vec()
    }

    fn resume(&mut self, hidden: &[f64], now: (f64, f64)) {
        let states = self.hidden_states();
        if states.len() == hidden.len() {
            self.at_rest = false;
            self.y[states].copy_from_slice(hidden);
            (self.y[0], self.y[1]) = now;
            self.settle_mode();
        }
    }

    fn retrace(&mut self, reversals_m: &mut dyn Iterator<Item = f64>, now: (f64, f64)) {
        // What is in series with a joint moves otherwise than the mass.
        let jointed = self.system.joint_half_width_m.is_some();
        if jointed || !self.system.isolator_terms.iter().any(|term| term.retraces()) {
            return;
        }
        self.at_rest = false;
        for displacement_m in reversals_m.chain([now.0]) {
            self.y[0] = displacement_m;
            self.remember();
        }
        self.y[1] = now.1;
        self.settle_mode();
    }

    fn prime(&mut self, table_acceleration_m_s2: f64) {
        self.at_rest = false;
        self.table = Some(table_acceleration_m_s2);
    }

    fn set_time_s(&mut self, time_s: f64) {
        // Free tips have come back as far as before.
        let shift = time_s - self.time_s;
        self.mode.tips.iter_mut().for_each(|tip| tip.since_s += shift);
        self.time_s = time_s;
    }
}
