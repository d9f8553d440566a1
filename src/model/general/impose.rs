//! Imposed motion at sample resolution. Identification imposes the measured motion on models some
//! thousand times over: contacts, knees and the sign of friction are read off the sample itself, the
//! instant of a release is interpolated, and terms with states of their own carry them by [`super::super::system::Term::follow`].
//! A joint, whose
//! own motion decides on contact, keeps to the event search, and so does a stand under a nonlinear bumper.

use super::super::Response;
use super::super::system::{Point, Stand};
use super::dynamics::{Joint, Line, Sliding, Tip};
use super::specimen::General;

impl<const N: usize> General<N> {
    /// True where [`General::impose_sampled`] applies.
    pub(super) fn imposes_by_sample(&self) -> bool {
        self.mode.joint == Joint::Rigid && (self.system.stand.is_none() || self.system.bumper.is_linear())
    }

    /// Moves the mass to displacement `d` (m) and velocity `v` (m/s) within one sample interval, along
    /// the cubic whose acceleration is `line`.
    pub(super) fn impose_sampled(&mut self, d: f64, v: f64, line: Line) -> Response {
        let dt = self.system.sample_period_s;
        let before = self.contact_forces();
        let at = |time_s, displacement_m, velocity_m_s| Point {
            time_s,
            displacement_m,
            velocity_m_s,
            ..Point::default()
        };
        let (from, to) = (at(self.time_s, self.y[0], self.y[1]), at(self.time_s + dt, d, v));
        if self.turns {
            self.commit_vertex(&from, &to);
        }
        if let Some(stand) = self.system.stand {
            self.follow_stand(&stand, d, v);
        }
        if self.integrates {
            self.follow_terms(&from, &to);
        }
        (self.y[0], self.y[1]) = (d, v);
        self.time_s += dt;
        self.table = None;
        self.mode.segment = self.system.segment(d);
        if self.system.friction.is_some() {
            let sign = match self.mode.sliding {
                _ if v != 0.0 => v.signum() as i8,
                Sliding::Slip(sign) => sign,
                _ => 1,
            };
            self.mode.sliding = Sliding::Slip(sign);
        }
        if self.turns {
            self.mode.direction = if v < 0.0 { -1 } else { 1 };
        }
        self.commit();
        if self.system.has_bumper {
            for (side, force) in before.into_iter().enumerate() {
                self.meet(side, force, dt);
            }
            self.age_tips();
        }
        let at = (self.time_s, 0.0);
        let forces =
            self.system.rates(at, &self.y, &self.mode, &self.layout, Some(line.start + line.slope * dt)).1;
        self.response(&forces)
    }

    /// Contact forces and positions of the mass towards both bumpers at the last sample.
    fn contact_forces(&self) -> [(f64, f64); 2] {
        [0, 1].map(|side| {
            let (p, rate) = self.system.approach(side, &self.y, &self.layout);
            (p, if self.mode.contact[side] { self.system.bumper.force_n(p, rate) } else { 0.0 })
        })
    }

    /// Contact, release or push of the free tip of one side after a sample.
    fn meet(&mut self, side: usize, (p_before, force_before): (f64, f64), dt: f64) {
        let (p, rate) = self.system.approach(side, &self.y, &self.layout);
        let force = self.system.bumper.force_n(p, rate);
        if self.mode.contact[side] {
            let ended = force < 0.0 || (self.system.bumper.preload_n > 0.0 && p < 0.0);
            if ended {
                // Force runs about linearly over a sample.
                let span = force_before - force;
                let part = if span > 0.0 { (force_before / span).clamp(0.0, 1.0) } else { 1.0 };
                let tip = (p_before + part * (p - p_before)).max(0.0);
                self.mode.contact[side] = false;
                self.mode.tips[side] = Tip { deformation_m: tip, since_s: self.time_s - (1.0 - part) * dt };
            }
            return;
        }
        // No free tip stands outside its own gap.
        if p < 0.0 {
            return;
        }
        let tip = self.mode.tips[side];
        let free = self.system.bumper.relaxed_m(tip.deformation_m, self.time_s - tip.since_s);
        if p < free {
            return;
        }
        // As in free motion: it presses in, or comes back more slowly than the tip.
        if rate >= 0.0 || force > 0.0 {
            self.mode.contact[side] = true;
        } else {
            self.mode.tips[side] = Tip { deformation_m: p.max(0.0), since_s: self.time_s };
        }
    }

    /// Tells terms that remember reversals where the motion turned within the coming sample.
    fn commit_vertex(&mut self, from: &Point, to: &Point) {
        let Some(vertex) = from.turns_at_m(to) else { return };
        self.system.isolator_terms.iter_mut().for_each(|term| term.commit(vertex));
        self.system.mass_terms.iter_mut().for_each(|term| term.commit(vertex));
    }

    /// Carries both stands along, each free or pressed by its bumper as it was at the last sample.
    fn follow_stand(&mut self, stand: &Stand, d: f64, v: f64) {
        let (was, law) = ((self.y[0], self.y[1]), self.system.bumper);
        for side in 0..2 {
            let (sign, gap) =
                if side == 0 { (1.0, self.system.gap_right_m) } else { (-1.0, self.system.gap_left_m) };
            let push = |d: f64, v: f64| law.force_n(sign * d - gap, sign * v) / stand.mass_kg;
            let contact = self.mode.contact[side];
            let (f0, f1) = if contact { (push(was.0, was.1), push(d, v)) } else { (0.0, 0.0) };
            let i = self.layout.stand + 2 * side;
            let (u, rate) =
                stand.sampled[usize::from(contact)].after(sign * self.y[i], sign * self.y[i + 1], f0, f1);
            (self.y[i], self.y[i + 1]) = (sign * u, sign * rate);
        }
    }

    /// Carries the states of the terms from one instant to another.
    fn follow_terms(&mut self, from: &Point, to: &Point) {
        let mut at = self.layout.terms;
        // In the order in which the rates go through them.
        for term in self.system.mass_terms.iter().chain(&self.system.isolator_terms) {
            let end = at + term.states();
            if end > at {
                term.follow(from, to, &mut self.y[at..end]);
            }
            at = end;
        }
    }

    /// Where the states of terms are that forget by a power law.
    pub(super) fn remembering(&self) -> Vec<std::ops::Range<usize>> {
        let (mut at, mut out) = (self.layout.terms, Vec::new());
        for term in self.system.mass_terms.iter().chain(&self.system.isolator_terms) {
            if term.remembers() {
                out.push(at..at + term.states());
            }
            at += term.states();
        }
        out
    }
}
