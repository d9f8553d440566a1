//! The stepping loop: step control and events.

use super::super::system::System;
use super::super::{Options, Response, Specimen};
use super::dynamics::{Drive, Forces, Joint, Layout, Mode, Motion, Sliding, Tip};
use super::events::{GUARDS, Guards, first_failure, guard};
use super::runge_kutta::Step;

/// Events allowed within one stretch before the step is taken regardless (chatter without end).
const PATIENCE: usize = 200;
/// Steps within one stretch, and for each sample of it, beyond which a model is not followed any farther.
const STEPS: [f64; 2] = [10_000.0, 50.0];

/// The general solver of one model with `N` states.
pub struct General<const N: usize> {
    pub(super) system: System,
    pub(super) layout: Layout,
    pub(super) tolerance: f64,
    pub(super) y: [f64; N],
    pub(super) mode: Mode,
    /// Time since reset, s.
    pub(super) time_s: f64,
    /// Step that the error control would take, s.
    pub(super) preferred_s: f64,
    /// Table acceleration now; `None` when it is not known after an imposed motion.
    pub(super) table: Option<f64>,
    /// Largest displacement and velocity so far, for the error control.
    pub(super) largest: [f64; 2],
    pub(super) turns: bool,
    /// Terms have states of their own.
    pub(super) integrates: bool,
    /// Nothing has moved it since its reset.
    pub(super) at_rest: bool,
}

/// Rates, forces and guards at the present instant.
pub(super) struct Now<const N: usize> {
    rates: [f64; N],
    pub(super) forces: Forces,
    guards: Guards,
}

impl<const N: usize> General<N> {
    /// The solver at rest in its equilibrium.
    pub fn new(system: System, options: &Options) -> Self {
        let layout = Layout::of(&system);
        let turns = system.isolator_terms.iter().chain(&system.mass_terms).any(|term| term.turns());
        let integrates = system.hidden_states() > 0;
        let mode = Mode {
            segment: 0,
            contact: [false; 2],
            tips: [Tip::default(); 2],
            sliding: Sliding::Smooth,
            joint: Joint::Rigid,
            direction: 0,
        };
        let preferred_s = system.sample_period_s;
        let tolerance = options.tolerance;
        let mut solver = Self {
            system,
            layout,
            tolerance,
            y: [0.0; N],
            mode,
            time_s: 0.0,
            preferred_s,
            table: Some(0.0),
            largest: [0.0; 2],
            turns,
            integrates,
            at_rest: true,
        };
        solver.reset();
        solver
    }

    /// Error relative to what is allowed; 1 is just allowed.
    fn excess(&self, error: &[f64; N]) -> f64 {
        let [length, speed] = self.largest;
        let mut worst = error[0].abs() / length;
        worst = worst.max(error[1].abs() / speed);
        for (i, e) in error.iter().enumerate().skip(2) {
            let rate = self.system.stand.is_some() && (i == 3 || i == 5);
            worst = worst.max(e.abs() / if rate { speed } else { length });
        }
        worst / self.tolerance
    }

    pub(super) fn now<D: Drive>(&self, offset: f64, drive: D, motion: Motion) -> Now<N> {
        let at = (self.time_s + offset, drive.at(offset));
        let (rates, forces) =
            self.system.rates(at, &self.y, &self.mode, &self.layout, imposed(motion, offset));
        let guards = self.system.guards(at, &self.y, &self.mode, &self.layout, &forces);
        Now { rates, forces, guards }
    }

    /// A step, and the forces at its end.
    fn take<D: Drive>(&self, from: f64, h: f64, now: &Now<N>, drive: D, motion: Motion) -> (Step<N>, Forces) {
        Step::take(h, &self.y, &now.rates, |offset, y| {
            let t = from + offset;
            let at = (self.time_s + t, drive.at(t));
            self.system.rates(at, y, &self.mode, &self.layout, imposed(motion, t))
        })
    }

    fn guards_at<D: Drive>(&self, t: f64, y: &[f64; N], drive: D, motion: Motion) -> Guards {
        let at = (self.time_s + t, drive.at(t));
        let (_, forces) = self.system.rates(at, y, &self.mode, &self.layout, imposed(motion, t));
        self.system.guards(at, y, &self.mode, &self.layout, &forces)
    }

    /// Advances by `duration` s. `emit(begin, end, state)` is called for every accepted step with
    /// its dense output (`state(part)` from 0 to 1) and may evaluate it anywhere.
    pub fn advance<D: Drive>(
        &mut self,
        duration: f64,
        drive: D,
        motion: Motion,
        emit: &mut impl FnMut(&Self, f64, f64, &Step<N>),
    ) -> Forces {
        let mut t = 0.0;
        let mut now = self.now(t, drive, motion);
        let mut events = 0;
        let mut taken = 0.0;
        let enough = STEPS[0] + STEPS[1] * duration / self.system.sample_period_s;
        while duration - t > 1e-13 * duration {
            let rest = duration - t;
            let mut h = self.preferred_s.min(rest);
            if rest - h < 0.01 * h {
                h = rest;
            }
            let (step, forces, excess) = self.controlled(t, &mut h, &now, drive, motion);
            taken += 1.0;
            if !step.end.iter().all(|y| y.is_finite()) || taken > enough {
                // A model that runs away (a loss below zero, say) leaves no state to go on from; one far too stiff to be followed
                // would take for ever.
                self.y = [f64::NAN; N];
                break;
            }
            let at = (self.time_s + t + h, drive.at(t + h));
            let guards = self.system.guards(at, &step.end, &self.mode, &self.layout, &forces);
            let nearly = self.may_dip(h, &now, &guards, &step);
            let failed = guards.iter().any(|g| *g < 0.0) || nearly.contains(&true);
            let failure = if failed && events < PATIENCE {
                first_failure(&now.guards, &guards, &nearly, |part| {
                    self.guards_at(t + part * h, &step.at(part), drive, motion)
                })
            } else {
                None
            };
            if let Some((index, part)) = failure {
                events += 1;
                let short = part * h;
                if short > 0.0 {
                    let (step, _) = self.take(t, short, &now, drive, motion);
                    emit(self, t, t + short, &step);
                    self.y = step.end;
                    t += short;
                }
                self.commit();
                self.switch(index, t, drive, motion);
                now = self.now(t, drive, motion);
            } else {
                emit(self, t, t + h, &step);
                self.y = step.end;
                t = if h == rest { duration } else { t + h };
                self.commit();
                let growth = 0.9 / fifth_root(excess.max(1e-6));
                self.preferred_s = (h * growth.clamp(0.2, 5.0)).max(if h == rest {
                    self.preferred_s.min(h * 5.0)
                } else {
                    0.0
                });
                // Terms with memory may go on otherwise than they came.
                now = if self.turns {
                    self.now(t, drive, motion)
                } else {
                    Now { rates: step.rates, forces, guards }
                };
            }
        }
        self.time_s += duration;
        self.age_tips();
        now.forces
    }

    /// A step within the tolerance, the forces at its end and its error; shortens `h` until it is (or cannot get shorter).
    fn controlled<D: Drive>(
        &self,
        t: f64,
        h: &mut f64,
        now: &Now<N>,
        drive: D,
        motion: Motion,
    ) -> (Step<N>, Forces, f64) {
        let smallest = 1e-7 * self.system.sample_period_s;
        loop {
            let (step, forces) = self.take(t, *h, now, drive, motion);
            let excess = self.excess(&step.error);
            if excess <= 1.0 || *h <= smallest {
                return (step, forces, excess);
            }
            *h *= if excess.is_finite() { (0.9 / fifth_root(excess)).clamp(0.1, 0.9) } else { 0.1 };
        }
    }

    /// Guards that are above zero at both ends of a step but could have dipped below in between.
    fn may_dip(&self, h: f64, now: &Now<N>, end: &Guards, step: &Step<N>) -> [bool; GUARDS] {
        let mut nearly = [false; GUARDS];
        let way = h * self.y[1].abs().max(step.end[1].abs()) + 0.5 * h * h * step.rates[1].abs();
        let turned = self.y[1] * step.end[1] <= 0.0;
        let loose = turned
            || self.system.stand.is_some()
            || self.mode.joint != Joint::Rigid
            || self.mode.tips.iter().any(|tip| tip.deformation_m > 0.0);
        for (i, dips) in nearly.iter_mut().enumerate() {
            let (g0, g1) = (now.guards[i], end[i]);
            if g1 < 0.0 || g1.is_infinite() {
                continue;
            }
            let side = i.wrapping_sub(guard::RIGHT);
            *dips = match i {
                guard::KNEE_UP | guard::KNEE_DOWN => loose && g0.min(g1) < way,
                guard::RIGHT | guard::LEFT if !self.mode.contact[side] => loose && g0.min(g1) < way,
                guard::BEARINGS if matches!(self.mode.sliding, Sliding::Slip(_)) => {
                    g0.min(g1) < h * now.rates[1].abs().max(step.rates[1].abs())
                        && now.rates[1] * step.rates[1] <= 0.0
                }
                guard::REVERSAL => {
                    now.rates[1] * step.rates[1] <= 0.0
                        && g0.min(g1) < h * now.rates[1].abs().max(step.rates[1].abs())
                }
                _ => g0.min(g1) < 2.0 * (g1 - g0).abs(),
            };
        }
        nearly
    }

    /// Tells terms with memory, and the error control, where the motion has come to.
    #[inline]
    pub(super) fn commit(&mut self) {
        self.largest[0] = self.largest[0].max(self.y[0].abs());
        self.largest[1] = self.largest[1].max(self.y[1].abs());
        if self.turns {
            if self.mode.direction == 0 && self.y[1] != 0.0 {
                self.mode.direction = if self.y[1] < 0.0 { -1 } else { 1 };
            }
            self.remember();
        }
    }

    /// Displacement of what is in series with the joint, the mass's own where there is none, m.
    fn element_m(&self) -> f64 {
        self.y[if self.mode.joint == Joint::Rigid { 0 } else { self.layout.element }]
    }

    /// Tells terms with memory where they are.
    pub(super) fn remember(&mut self) {
        let element = self.element_m();
        self.system.isolator_terms.iter_mut().for_each(|term| term.commit(element));
        self.system.mass_terms.iter_mut().for_each(|term| term.commit(self.y[0]));
    }

    /// Terms with memory begin where they are, pushed there from nothing.
    pub(super) fn forget(&mut self) {
        let terms = self.system.isolator_terms.iter_mut().chain(&mut self.system.mass_terms);
        terms.for_each(|term| term.reset());
        self.remember();
    }

    /// States free tips as they are now: a nonlinear one relaxes by small steps, which must not begin at
    /// the release again each time that it is asked for.
    pub(super) fn age_tips(&mut self) {
        if self.system.bumper.is_linear() {
            return;
        }
        for tip in self.mode.tips.iter_mut().filter(|tip| tip.deformation_m > 0.0) {
            let deformation_m = self.system.bumper.relaxed_m(tip.deformation_m, self.time_s - tip.since_s);
            *tip = Tip { deformation_m, since_s: self.time_s };
        }
    }

    /// Enters the mode that follows a failed guard.
    fn switch<D: Drive>(&mut self, index: usize, t: f64, drive: D, motion: Motion) {
        match index {
            guard::KNEE_UP => self.mode.segment += 1,
            guard::KNEE_DOWN => self.mode.segment -= 1,
            guard::RIGHT | guard::LEFT => self.switch_contact(index - guard::RIGHT, t),
            guard::BEARINGS => self.switch_bearings(t, drive, motion),
            guard::REVERSAL => self.mode.direction = -self.mode.direction,
            _ => self.switch_joint(index),
        }
    }

    fn switch_contact(&mut self, side: usize, t: f64) {
        let (p, rate) = self.system.approach(side, &self.y, &self.layout);
        if self.mode.contact[side] {
            self.mode.contact[side] = false;
            self.mode.tips[side] = Tip { deformation_m: p.max(0.0), since_s: self.time_s + t };
            return;
        }
        // The gap closes when the mass presses in, or comes back more slowly than the tip.
        if rate >= 0.0 || self.system.bumper.force_n(p, rate) > 0.0 {
            self.mode.contact[side] = true;
        } else {
            self.mode.tips[side] = Tip { deformation_m: p.max(0.0), since_s: self.time_s + t };
        }
    }

    fn switch_bearings<D: Drive>(&mut self, t: f64, drive: D, motion: Motion) {
        if let (Motion::Imposed(_), Sliding::Slip(sign)) = (motion, self.mode.sliding) {
            self.mode.sliding = Sliding::Slip(-sign);
            return;
        }
        self.y[1] = 0.0;
        let at = (self.time_s + t, drive.at(t));
        let was = self.mode.sliding;
        self.mode.sliding = Sliding::Stick;
        let forces = self.system.rates(at, &self.y, &self.mode, &self.layout, None).1;
        let reaction = self.system.table_inverse_mass_1_kg * (forces.contact_n[0] - forces.contact_n[1]);
        let pull = forces.without_friction_n + self.system.mass_kg * (at.1 + reaction);
        let holds = self.system.friction.map_or(0.0, |friction| friction.breakaway_n);
        if was == Sliding::Stick || pull.abs() > holds {
            self.mode.sliding = Sliding::Slip(if pull > 0.0 { -1 } else { 1 });
        }
    }

    fn switch_joint(&mut self, index: usize) {
        let element = self.layout.element;
        let half = self.system.joint_half_width_m.unwrap_or(0.0);
        self.mode.joint = match self.mode.joint {
            Joint::Open => {
                let sign = if index == guard::JOINT_UP { 1 } else { -1 };
                self.y[element] = self.y[0] - f64::from(sign) * half;
                Joint::Closed(sign)
            }
            _ => Joint::Open,
        };
    }

    /// Mode that fits the present state: where segments, contacts and directions are taken from it.
    pub(super) fn settle_mode(&mut self) {
        let element = self.element_m();
        self.mode.segment = self.system.segment(element);
        for side in 0..2 {
            self.mode.contact[side] =
                self.system.has_bumper && self.system.approach(side, &self.y, &self.layout).0 > 0.0;
        }
        if self.system.friction.is_some() {
            self.mode.sliding = match self.y[1] {
                v if v > 0.0 => Sliding::Slip(1),
                v if v < 0.0 => Sliding::Slip(-1),
                _ => Sliding::Stick,
            };
        }
    }

    /// The response at the present instant.
    pub fn response(&self, forces: &Forces) -> Response {
        self.response_of(&self.y, forces)
    }

    /// The response of a state of this mode.
    #[inline]
    pub fn response_of(&self, y: &[f64; N], forces: &Forces) -> Response {
        Response {
            relative_displacement_m: y[0],
            relative_velocity_m_s: y[1],
            mass_acceleration_m_s2: -forces.restoring_n / self.system.mass_kg,
            right_contact_force_n: forces.contact_n[0],
            left_contact_force_n: forces.contact_n[1],
            regime: self.mode.regime(),
        }
    }

    /// The compiled model.
    pub fn system(&self) -> &System {
        &self.system
    }

    /// The present mode.
    pub fn mode(&self) -> &Mode {
        &self.mode
    }

    /// The present state.
    pub fn state(&self) -> &[f64; N] {
        &self.y
    }

    /// Time since reset, s; within a stretch that of its beginning.
    pub fn time_s(&self) -> f64 {
        self.time_s
    }

    /// Table acceleration now, m/s2; `None` after an imposed motion.
    pub fn table(&self) -> Option<f64> {
        self.table
    }

    /// Replaces the state.
    pub fn set_state(&mut self, y: [f64; N]) {
        self.y = y;
    }

    /// Ends a stretch of time in this state.
    pub fn place(&mut self, y: [f64; N], duration: f64) {
        self.y = y;
        self.time_s += duration;
    }

    /// First guard that fails from a time of the stretch over `rest` s, along `state(part)`.
    pub fn failure<D: Drive>(
        &self,
        t: f64,
        rest: f64,
        drive: D,
        state: impl Fn(f64) -> [f64; N],
    ) -> Option<(usize, f64)> {
        let guards = |part: f64| self.guards_at(t + part * rest, &state(part), drive, Motion::Free);
        let (start, end) = (guards(0.0), guards(1.0));
        let nearly = end.map(f64::is_finite);
        first_failure(&start, &end, &nearly, guards)
    }

    /// Goes to the state where a guard failed and enters the mode that follows.
    pub fn enter<D: Drive>(&mut self, y: [f64; N], guard: usize, t: f64, drive: D) {
        self.y = y;
        self.switch(guard, t, drive, Motion::Free);
    }
}

/// Near enough for the length of the next step.
fn fifth_root(x: f64) -> f64 {
    f64::from((x as f32).powf(0.2))
}

fn imposed(motion: Motion, t: f64) -> Option<f64> {
    match motion {
        Motion::Free => None,
        Motion::Imposed(acceleration) => Some(acceleration.at(t)),
    }
}
