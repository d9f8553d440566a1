//! Ideal sweeps from event to event: each segment of the motion is known in closed form, so its end
//! is searched on the forms that its regime watches, and samples are evaluated only where wanted.

use super::form::{End, Form, Forms};
use super::propagator::Exact;
use super::segment::{Closed, Forcing, Segment};
use crate::model::elementary::sin_cos;
use crate::model::general::{GUARDS, Line, Mode, Sliding, guard};
use crate::model::sweep::Plan;
use std::f64::consts::TAU;

/// Events one after the other within this part of a sample before the motion goes on regardless, and
/// the part.
const CHATTER: (u32, f64) = (60, 1e-3);
/// Stretches within one sample before it is taken regardless, as sample by sample.
const PATIENCE: u32 = 600;

/// A segment with the samples that it holds.
pub struct Stretch<'a> {
    /// Motion in closed form.
    pub segment: &'a Segment<'a>,
    /// Index of the piece.
    pub piece: usize,
    /// Regime.
    pub mode: &'a Mode,
    /// Index of the step.
    pub step: usize,
    /// First sample and their number.
    pub first: usize,
    /// Number of samples.
    pub count: usize,
    /// Time of the first sample since the beginning of the segment, s.
    pub offset: f64,
}

impl Exact {
    /// Pieces in closed form for a sweep; `None` where one of them does not allow it.
    pub fn closed(&self, plan: &Plan<'_>) -> Option<Vec<Closed>> {
        let frequencies: Vec<f64> = plan.steps.iter().map(|step| TAU * step.frequency_hz).collect();
        let system = self.core.system();
        // A free tip that would never relax by an exponential.
        let bumper = &system.bumper;
        if system.has_bumper && bumper.linear_n_m == 0.0 && bumper.preload_n > 0.0 {
            return None;
        }
        let length = system.magnitudes().0;
        self.pieces.iter().map(|piece| Closed::new(piece, &frequencies, length)).collect()
    }

    /// Contact forces (right, left; N) of the bumpers that touch at a displacement and velocity.
    pub fn contact_law(&self) -> impl Fn([bool; 2], f64, f64) -> [f64; 2] + use<> {
        let system = self.core.system();
        let (law, right, left) = (system.bumper, system.gap_right_m, system.gap_left_m);
        move |touches, d, v| {
            [
                if touches[0] { law.force_n(d - right, v) } else { 0.0 },
                if touches[1] { law.force_n(-d - left, -v) } else { 0.0 },
            ]
        }
    }

    /// Runs a sweep from the present state, event by event; gives the number of contacts that began.
    pub fn run_closed(
        &mut self,
        closed: &[Closed],
        plan: &Plan<'_>,
        watch: &mut dyn FnMut(&Stretch<'_>),
    ) -> usize {
        let pace = Pace::new(plan.dt);
        let memory = vec![None; closed.len() * GUARDS];
        let mut run =
            Run { exact: self, closed, plan, next: 0, contacts: 0, touched: [false; 2], pace, memory };
        for step in 0..plan.steps.len() {
            run.step(step, watch);
        }
        let contacts = run.contacts;
        self.note_mode();
        contacts
    }

    /// The segment that begins in the present state.
    fn segment<'a>(&self, closed: &'a [Closed], forcing: Forcing) -> (usize, Segment<'a>) {
        let mode = self.core.mode();
        let piece = self.index(mode);
        let [d, v] = *self.core.state();
        (piece, Segment::new(&closed[piece], (d, v), forcing, mode.sliding == Sliding::Stick))
    }

    /// Everything that the present regime watches. `limit` is shortened where a tip with preload
    /// reaches its rest position.
    fn forms(&self, segment: &Segment, limit: &mut f64) -> Forms {
        let (mode, system, mut forms) = (self.core.mode(), self.core.system(), Forms::default());
        let bounds = system.bounds(mode.segment);
        let outer = [bounds.1, -bounds.0];
        let gaps = [system.gap_right_m, system.gap_left_m];
        for side in 0..2 {
            let sign = if side == 0 { 1.0 } else { -1.0 };
            let (knee, gap) = (outer[side], gaps[side]);
            let free = system.has_bumper && !mode.contact[side];
            let tip = if free { self.tip(side, limit) } else { 0.0 };
            let moves = segment.held.is_none();
            if moves && knee.is_finite() && (tip > 0.0 || !free || knee <= gap) {
                forms.push(Form::of(segment, guard::KNEE_UP + side, knee, -sign, 0.0));
            }
            if free && (tip > 0.0 || moves && gap < knee) {
                let rest = if tip > 0.0 { system.bumper.rest_m() } else { 0.0 };
                let form = Form::of(segment, guard::RIGHT + side, gap - rest, -sign, 0.0);
                forms.push(form.with_tip(tip + rest, system.bumper.relaxation_1_s()));
            }
            if mode.contact[side] {
                let (k, c, preload) =
                    (system.bumper.linear_n_m, system.bumper.damping_n_s_m, system.bumper.preload_n);
                let force = preload - k * gap;
                forms.push(Form::of(segment, guard::RIGHT + side, force, sign * k, sign * c));
                if preload > 0.0 {
                    forms.push(Form::of(segment, guard::RIGHT + side, -gap, sign, 0.0));
                }
            }
        }
        match mode.sliding {
            Sliding::Smooth => {}
            Sliding::Slip(sign) => {
                forms.push(Form::of(segment, guard::BEARINGS, 0.0, 0.0, f64::from(sign)));
            }
            Sliding::Stick => {
                let [pull, m] = [self.held_force_n(), system.mass_kg];
                let holds = system.friction.map_or(0.0, |friction| friction.breakaway_n);
                forms.push(Form::of_table(guard::BEARINGS, holds - pull, -m));
                forms.push(Form::of_table(guard::BEARINGS, holds + pull, m));
            }
        }
        forms
    }

    /// Deformation of a free tip now, m; zero when it lies within rounding of its rest position.
    fn tip(&self, side: usize, limit: &mut f64) -> f64 {
        let (tip, bumper) = (&self.core.mode().tips[side], &self.core.system().bumper);
        let now = bumper.relaxed_m(tip.deformation_m, self.core.time_s() - tip.since_s);
        if now <= 1e-17 {
            return 0.0;
        }
        let rest = bumper.rest_m();
        if rest > 0.0 {
            let until = (now / rest).ln_1p() / bumper.relaxation_1_s();
            // Back within the rounding of the time axis: a stretch of that length would never end.
            if until <= 4.0 * f64::EPSILON * self.core.time_s() {
                return 0.0;
            }
            *limit = limit.min(until);
        }
        now
    }

    /// Static force on a held mass, N.
    fn held_force_n(&self) -> f64 {
        let [d, _] = *self.core.state();
        let piece = &self.pieces[self.index(self.core.mode())];
        self.core.system().mass_kg * (piece.stiffness * d + piece.constant)
    }
}

/// A sweep under way.
struct Run<'a, 'p> {
    exact: &'a mut Exact,
    closed: &'a [Closed],
    plan: &'a Plan<'p>,
    /// Next sample.
    next: usize,
    contacts: usize,
    touched: [bool; 2],
    pace: Pace,
    /// How the last segment of each piece ended (guard, s) that began by each guard: the next one may do the
    /// same.
    memory: Vec<Option<(usize, f64)>>,
}

/// Counts stretches that hardly take time, so that no run of them goes on for ever.
struct Pace {
    dt: f64,
    /// Since the times below: stretches.
    counts: [u32; 2],
    /// Time of the step since which they are counted, s.
    since: [f64; 2],
}

impl Pace {
    fn new(dt: f64) -> Self {
        Self { dt, counts: [0; 2], since: [0.0; 2] }
    }

    /// What to go on by regardless of events at a time of the step, s; `None` while the pace will do.
    fn forced(&mut self, t: f64) -> Option<f64> {
        let limits = [(CHATTER.0, CHATTER.1 * self.dt), (PATIENCE, self.dt)];
        let mut forced = None;
        for (i, (most, within)) in limits.into_iter().enumerate() {
            // Times of a step begin anew with the step.
            if !(0.0..within).contains(&(t - self.since[i])) {
                (self.counts[i], self.since[i]) = (0, t);
            }
            self.counts[i] += 1;
            if self.counts[i] > most {
                forced = Some(within);
            }
        }
        forced
    }
}

impl Run<'_, '_> {
    fn step(&mut self, step: usize, watch: &mut dyn FnMut(&Stretch<'_>)) {
        let spec = &self.plan.steps[step];
        let (amplitude, w) = (spec.acceleration_amplitude_m_s2, TAU * spec.frequency_hz);
        let duration = self.plan.end_of(step) - self.plan.starts[step];
        let (mut t, mut entered) = (0.0, None);
        while t < duration {
            let (sin, cos) = sin_cos(w * t);
            let (value, quadrature) = (amplitude * sin, amplitude * cos);
            let forcing = Forcing { value, quadrature, angular_frequency: w };
            let (piece, segment) = self.exact.segment(self.closed, forcing);
            let mut limit = duration - t;
            let mut forms = self.exact.forms(&segment, &mut limit);
            let memory = entered.map(|guard| piece * GUARDS + guard);
            let end = match self.pace.forced(t) {
                None => forms.first_failure(&segment, limit, memory.and_then(|place| self.memory[place])),
                Some(regardless) => {
                    let time_s = regardless.min(duration - t);
                    End { guard: None, time_s, now: segment.at(time_s) }
                }
            };
            let length = end.time_s;
            if length > 0.0 {
                self.count();
            }
            self.emit(step, piece, &segment, (t, length), watch);
            let (d, v) = segment.state(&end.now);
            self.exact.core.place([d, v], length);
            t = if length >= duration - t { duration } else { t + length };
            entered = end.guard;
            if let Some(guard) = end.guard {
                if let Some(place) = memory {
                    self.memory[place] = Some((guard, length));
                }
                let table = amplitude * sin_cos(w * t).0;
                self.exact.core.enter([d, v], guard, 0.0, Line { start: table, slope: 0.0 });
            }
        }
    }

    /// Counts contacts that last.
    fn count(&mut self) {
        let now = self.exact.contacts();
        self.contacts += (0..2).filter(|side| now[*side] && !self.touched[*side]).count();
        self.touched = now;
    }

    /// Shows the samples from a time of the step on, to the end of the segment (at the very end of the
    /// sweep inclusive).
    fn emit(
        &mut self,
        step: usize,
        piece: usize,
        segment: &Segment,
        (from, length): (f64, f64),
        watch: &mut dyn FnMut(&Stretch<'_>),
    ) {
        let (plan, first) = (self.plan, self.next);
        let end = plan.starts[step] + (from + length);
        let last = step + 1 == plan.steps.len() && end >= plan.end;
        let until = if last { plan.samples() } else { ((end / plan.dt).ceil() as usize).min(plan.samples()) };
        if until > first {
            let offset = first as f64 * plan.dt - plan.starts[step] - from;
            self.next = until;
            let count = until - first;
            watch(&Stretch { segment, piece, mode: self.exact.core.mode(), step, first, count, offset });
        }
    }
}
