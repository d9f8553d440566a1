//! Imposed motion at sample resolution. Identification imposes the measured motion on models some
//! thousand times over: contacts, knees and the sign of friction are read off the sample itself, the
//! instant of a release is interpolated, and terms with states of their own carry them by [`super::super::system::Term::follow`].
//! A joint, whose
//! own motion decides on contact, keeps to the event search, and so does a stand under a nonlinear bumper.

use super::super::Response;
use super::super::contact::ContactLaw;
use super::super::cubic::Cubic;
use super::super::system::Stand;
use super::dynamics::{Joint, Line, Sliding, Tip};
use super::events::root;
use super::specimen::General;

impl<const N: usize> General<N> {
    /// True where [`General::impose_sampled`] applies.
    pub(super) fn imposes_by_sample(&self) -> bool {
        self.mode.joint == Joint::Rigid && (self.system.stand.is_none() || self.system.bumper.is_linear())
    }

    /// Moves the mass within one sample interval, along a course whose acceleration is `line`.
    pub(super) fn impose_sampled(&mut self, course: &Cubic, line: Line) -> Response {
        let ((d, v), dt) = (course.to, course.during_s);
        let before = self.contact_forces();
        if self.turns {
            self.commit_vertex(course);
        }
        if let Some(stand) = self.system.stand {
            self.follow_stand(&stand, course);
        }
        if self.integrates {
            self.follow_terms(course);
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
    fn commit_vertex(&mut self, course: &Cubic) {
        let Some(vertex) = course.turns_at_m() else { return };
        self.system.isolator_terms.iter_mut().for_each(|term| term.commit(vertex));
        self.system.mass_terms.iter_mut().for_each(|term| term.commit(vertex));
    }

    /// Carries both stands along, each free or pressed by its bumper. Where contact begins or ends within the sample it does so here: a
    /// sample late, the blow of a bumper's dashpot would leave the stand ringing otherwise.
    fn follow_stand(&mut self, stand: &Stand, course: &Cubic) {
        let (dt, law) = (course.during_s, self.system.bumper);
        for side in 0..2 {
            let (sign, gap) =
                if side == 0 { (1.0, self.system.gap_right_m) } else { (-1.0, self.system.gap_left_m) };
            let i = self.layout.stand + 2 * side;
            let [from, to] = [course.from, course.to].map(|(d, v)| (sign * d - gap, sign * v));
            let mass = Cubic { from, to, during_s: dt };
            let base = (sign * self.y[i], sign * self.y[i + 1]);
            let (contact, tip) = (self.mode.contact[side], self.mode.tips[side]);
            let mut end = stand.followed(contact, &law, base, &mass);
            let gap_m = Cubic {
                from: (mass.from.0 - base.0, mass.from.1 - base.1),
                to: (mass.to.0 - end.0, mass.to.1 - end.1),
                during_s: dt,
            };
            // As for the mass alone: a bumper in contact pushes, a tip that is free is not yet reached.
            let holds = |part: f64| {
                let (p, rate) = gap_m.at(part);
                match contact {
                    true if law.preload_n > 0.0 => law.force_n(p, rate).min(law.preload_n * p),
                    true => law.force_n(p, rate),
                    false => law.relaxed_m(tip.deformation_m, self.time_s - tip.since_s + part * dt) - p,
                }
            };
            let presses = |part: f64| {
                let (p, rate) = gap_m.at(part);
                rate >= 0.0 || law.force_n(p, rate) > 0.0
            };
            let [start, after] = [holds(0.0), holds(1.0)];
            if after < 0.0 && start > 0.0 {
                let part = root((0.0, start), (1.0, after), holds);
                if contact || presses(part) {
                    let [before, after] = mass.cut(part);
                    let halfway = stand.followed(contact, &law, base, &before);
                    end = stand.followed(!contact, &law, halfway, &after);
                    self.mode.contact[side] = !contact;
                    if contact {
                        let tip_m = gap_m.at(part).0.max(0.0);
                        self.mode.tips[side] = Tip { deformation_m: tip_m, since_s: self.time_s + part * dt };
                    }
                }
            }
            (self.y[i], self.y[i + 1]) = (sign * end.0, sign * end.1);
        }
    }

    /// Carries the states of the terms along.
    fn follow_terms(&mut self, course: &Cubic) {
        let mut at = self.layout.terms;
        // In the order in which the rates go through them.
        for term in self.system.mass_terms.iter().chain(&self.system.isolator_terms) {
            let end = at + term.states();
            if end > at {
                term.follow(course, &mut self.y[at..end]);
            }
            at = end;
        }
    }

    /// Where the states of terms are.
    pub(super) fn hidden_states(&self) -> std::ops::Range<usize> {
        let terms = self.system.mass_terms.iter().chain(&self.system.isolator_terms);
        self.layout.terms..self.layout.terms + terms.map(|term| term.states()).sum::<usize>()
    }

    /// Where those are that forget by a power law.
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

impl Stand {
    /// Displacement and velocity of a stand at the end of a course of the mass, free or pressed by the linear bumper on it; positive away
    /// from the mass.
    fn followed(&self, pressed: bool, law: &ContactLaw, from: (f64, f64), mass: &Cubic) -> (f64, f64) {
        if mass.during_s <= 0.0 {
            return from;
        }
        let push = |(p, rate): (f64, f64)| if pressed { law.force_n(p, rate) / self.mass_kg } else { 0.0 };
        self.alone(pressed, law, mass.during_s).after(from.0, from.1, push(mass.from), push(mass.to))
    }
}
