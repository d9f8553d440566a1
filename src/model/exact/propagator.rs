//! The stepping loop of the exact propagator.

use super::super::general::{Drive, General, Line, Mode, Sliding};
use super::super::system::System;
use super::super::{Options, Regime, Response, Specimen};
use super::input::{Input, Wave};
use super::piece::{Piece, Transition};

/// The fastest rate of a piece times the sample period, above which its power series is not used.
const FASTEST: f64 = 1.0;
/// Events within one sample before it is taken regardless.
const PATIENCE: usize = 100;

/// Exact solver of a piecewise-linear model, for ideal sweeps.
pub struct Exact {
    /// Holds the compiled model, state and mode, and knows what follows an event.
    pub(super) core: General<2>,
    pub(super) pieces: Vec<Piece>,
    pub(super) dt: f64,
    friction: bool,
    /// Piece and regime of the present mode, kept beside it for samples without an event.
    current: (usize, Regime),
}

impl Exact {
    /// The propagator, or the model back when it is not piecewise linear or too fast for its sample
    /// period.
    ///
    /// # Errors
    /// The compiled model, untouched.
    pub fn new(system: System) -> Result<Self, Box<System>> {
        let dt = system.sample_period_s;
        if !system.is_piecewise_linear() {
            return Err(Box::new(system));
        }
        let pieces = pieces(&system);
        let fastest = pieces.iter().map(|p| p.damping.max(p.stiffness.sqrt())).fold(0.0, f64::max);
        if fastest * dt > FASTEST {
            return Err(Box::new(system));
        }
        let friction = system.friction.is_some();
        let core = General::new(system, &Options { tolerance: 1e-12 });
        let mut exact = Self { core, pieces, dt, friction, current: (0, Regime::default()) };
        exact.note_mode();
        Ok(exact)
    }

    /// To be called whenever the mode may have changed.
    pub(super) fn note_mode(&mut self) {
        let mode = self.core.mode();
        self.current = (self.index(mode), mode.regime());
    }

    pub(super) fn index(&self, mode: &Mode) -> usize {
        let knees = self.core.system().knees_m.len() as i32;
        let contact = usize::from(mode.contact[0]) + 2 * usize::from(mode.contact[1]);
        let sliding = match mode.sliding {
            Sliding::Slip(sign) => (1 + sign) as usize,
            _ => 1,
        };
        ((mode.segment + knees) as usize * 4 + contact) * 3 + sliding
    }

    /// Advances one sample under an input, to where the piece's transition leads if no event comes between.
    #[inline]
    fn sample<I: Input + Drive>(&mut self, end: (f64, f64), input: I) {
        let [d, v] = *self.core.state();
        let (index, regime) = self.current;
        let piece = &self.pieces[index];
        let (low, high) = piece.range;
        // Most samples: free or not, on the way within reach of nothing.
        let passes = v * end.1 > 0.0 && d.min(end.0) > low && d.max(end.0) < high;
        if passes && !(regime.right_contact || regime.left_contact || regime.sticking) {
            self.core.place([end.0, end.1], self.dt);
            return;
        }
        self.careful(end, input);
    }

    /// [`Exact::sample`] where an event may lie in it.
    #[inline(never)]
    fn careful<I: Input + Drive>(&mut self, end: (f64, f64), input: I) {
        let [d, v] = *self.core.state();
        if self.current.1.sticking {
            if self.holds_still(Input::at(&input, 0.0), Input::at(&input, self.dt)) {
                self.core.place([d, 0.0], self.dt);
                return;
            }
        } else if self.undisturbed(&self.pieces[self.current.0], (d, v), end) {
            self.core.place([end.0, end.1], self.dt);
            return;
        }
        self.search(input, 0.0, self.dt);
        let state = *self.core.state();
        self.core.place(state, self.dt);
    }

    /// No event can lie between two states one sample apart.
    #[inline]
    fn undisturbed(&self, piece: &Piece, (d, v): (f64, f64), (d1, v1): (f64, f64)) -> bool {
        let turned = v * v1 <= 0.0;
        if turned && self.friction {
            return false;
        }
        let way = if turned { self.dt * (v.abs() + v1.abs()) } else { 0.0 };
        let mode = self.core.mode();
        let (low, high) = piece.range;
        if !(d1 + way < high && d1 - way > low) || d.min(d1) <= low || d.max(d1) >= high {
            return self.behind_tip((d, v), (d1, v1));
        }
        if mode.contact[0] || mode.contact[1] {
            return self.presses((d, v), (d1, v1));
        }
        true
    }

    /// Free, with the mass already within reach of a tip that has not come back: the gap opens
    /// throughout the sample.
    fn behind_tip(&self, (d, v): (f64, f64), (d1, v1): (f64, f64)) -> bool {
        let (mode, system, time) = (self.core.mode(), self.core.system(), self.core.time_s());
        if mode.contact[0] || mode.contact[1] || self.friction && v * v1 <= 0.0 {
            return false;
        }
        let (low, high) = system.bounds(mode.segment);
        if d.min(d1) <= low || d.max(d1) >= high || v * v1 <= 0.0 {
            return false;
        }
        let side = usize::from(v > 0.0);
        let (sign, gap) = if side == 0 { (1.0, system.gap_right_m) } else { (-1.0, system.gap_left_m) };
        let (other_sign, other_gap) =
            if side == 0 { (-1.0, system.gap_left_m) } else { (1.0, system.gap_right_m) };
        if other_sign * d1 >= other_gap || other_sign * d >= other_gap {
            return false;
        }
        // The mass leaves this side's tip: the gap and its rate stay above zero at both ends.
        let tip = &mode.tips[side];
        [(d, v, 0.0), (d1, v1, self.dt)].into_iter().all(|(d, v, after)| {
            let x = system.bumper.relaxed_m(tip.deformation_m, time + after - tip.since_s);
            x - (sign * d - gap) > 0.0 && system.bumper.tip_rate_m_s(x) - sign * v > 0.0
        })
    }

    /// In contact throughout the sample.
    fn presses(&self, (d, v): (f64, f64), (d1, v1): (f64, f64)) -> bool {
        let (mode, system) = (self.core.mode(), self.core.system());
        if mode.contact[0] && mode.contact[1] {
            return false;
        }
        let (sign, gap) = if mode.contact[0] { (1.0, system.gap_right_m) } else { (-1.0, system.gap_left_m) };
        let force = |d: f64, v: f64| system.bumper.force_n(sign * d - gap, sign * v);
        let (before, after) = (force(d, v), force(d1, v1));
        // A dip between both ends would have to turn within the sample.
        let stays = before.min(after) > (after - before).abs() || (after >= before) == (v * sign >= 0.0);
        let stop = system.bumper.preload_n == 0.0 || sign * d1 > gap && sign * d > gap;
        let other = if mode.contact[0] { -d1 < system.gap_left_m } else { d1 < system.gap_right_m };
        before > 0.0 && after > 0.0 && stays && stop && other
    }

    /// Friction holds with a margin at both ends of the sample.
    fn holds_still(&self, start: f64, end: f64) -> bool {
        let system = self.core.system();
        let force = system.static_force_n(self.core.state()[0]);
        let limit = 0.99 * system.friction.map_or(0.0, |f| f.breakaway_n);
        let free = !self.core.mode().contact.contains(&true);
        free && (force + system.mass_kg * start).abs() < limit && (force + system.mass_kg * end).abs() < limit
    }

    /// Advances from one time of the sample to another by power series, event by event.
    fn search<I: Input + Drive>(&mut self, input: I, from: f64, to: f64) {
        let mut t = from;
        for event in 0..=PATIENCE {
            let state = *self.core.state();
            let held = self.current.1.sticking;
            let series = self.pieces[self.current.0].series((state[0], state[1]), input, t);
            let rest = to - t;
            let at = |part: f64| if held { [state[0], 0.0] } else { series.at(part * rest).into() };
            let failure = if event < PATIENCE { self.core.failure(t, rest, input, at) } else { None };
            match failure {
                Some((guard, part)) => {
                    t += part * rest;
                    self.core.enter(at(part), guard, t, input);
                    self.note_mode();
                }
                None => {
                    self.core.set_state(at(1.0));
                    return;
                }
            }
        }
    }

    /// Advances one sample within one step of an ideal sweep, or across the end of one.
    pub(in crate::model) fn wave_sample(&mut self, waves: &[Transition], wave: Wave) {
        let [d, v] = *self.core.state();
        let end = waves[self.current.0].apply(d, v, wave.value, wave.quadrature);
        self.sample(end, wave);
    }

    /// Transitions of all pieces under a sine of this angular frequency, rad/s.
    pub(in crate::model) fn waves(&self, angular_frequency: f64) -> Vec<Transition> {
        self.pieces.iter().map(|piece| piece.wave(self.dt, angular_frequency)).collect()
    }

    /// Advances one sample in two parts with an input each, changing over at `split` s.
    pub(in crate::model) fn split_sample(&mut self, first: Wave, second: Wave, split: f64) {
        self.search(first, 0.0, split);
        self.search(Shifted { wave: second, by: split }, split, self.dt);
        let state = *self.core.state();
        self.core.place(state, self.dt);
    }

    /// The response at the present instant under the table acceleration there, m/s2.
    #[inline]
    pub(in crate::model) fn respond(&self, table: f64) -> Response {
        let [d, v] = *self.core.state();
        let (index, regime) = self.current;
        let piece = &self.pieces[index];
        let moving = -(piece.stiffness * d + piece.damping * v + piece.constant);
        let mut response = Response {
            relative_displacement_m: d,
            relative_velocity_m_s: v,
            mass_acceleration_m_s2: if regime.sticking { table } else { moving },
            right_contact_force_n: 0.0,
            left_contact_force_n: 0.0,
            regime,
        };
        if regime.right_contact || regime.left_contact {
            let system = self.core.system();
            let side = |touches: bool, sign: f64, gap: f64| {
                if touches { system.bumper.force_n(sign * d - gap, sign * v) } else { 0.0 }
            };
            response.right_contact_force_n = side(regime.right_contact, 1.0, system.gap_right_m);
            response.left_contact_force_n = side(regime.left_contact, -1.0, system.gap_left_m);
        }
        response
    }

    /// Which bumpers touch.
    pub(in crate::model) fn contacts(&self) -> [bool; 2] {
        self.core.mode().contact
    }
}

/// A wave that begins within the sample.
#[derive(Clone, Copy)]
struct Shifted {
    wave: Wave,
    by: f64,
}

impl Input for Shifted {
    fn series(&self, time_s: f64) -> [f64; super::input::TERMS] {
        self.wave.series(time_s - self.by)
    }

    fn at(&self, time_s: f64) -> f64 {
        Input::at(&self.wave, time_s - self.by)
    }
}

impl Drive for Shifted {
    fn at(&self, time_s: f64) -> f64 {
        Input::at(self, time_s)
    }
}

impl Drive for Wave {
    fn at(&self, time_s: f64) -> f64 {
        Input::at(self, time_s)
    }
}

/// All pieces: by segment, contact (none, right, left, both), sign of friction.
fn pieces(system: &System) -> Vec<Piece> {
    let knees = system.knees_m.len() as i32;
    let (m, bumper) = (system.mass_kg, &system.bumper);
    let sliding = system.friction.map_or(0.0, |friction| friction.sliding_n);
    let mut pieces = Vec::with_capacity((2 * knees as usize + 1) * 12);
    for segment in -knees..=knees {
        let (slope, intercept) = system.line(segment);
        let (low, high) = system.bounds(segment);
        for contact in 0..4_u8 {
            let (right, left) = (f64::from(contact & 1), f64::from(contact >> 1));
            for sign in [-1.0, 0.0, 1.0] {
                let stiffness = slope + (right + left) * bumper.linear_n_m;
                let damping = system.damping_n_s_m + (right + left) * bumper.damping_n_s_m;
                let mut constant = intercept + system.constant_n + sign * sliding;
                if contact & 1 != 0 && system.has_bumper {
                    constant += bumper.preload_n - bumper.linear_n_m * system.gap_right_m;
                }
                if contact >> 1 != 0 && system.has_bumper {
                    constant -= bumper.preload_n - bumper.linear_n_m * system.gap_left_m;
                }
                let free = contact == 0;
                pieces.push(Piece {
                    damping: damping / m,
                    stiffness: stiffness / m,
                    constant: constant / m,
                    range: (
                        if free { low.max(-system.gap_left_m) } else { low },
                        if free { high.min(system.gap_right_m) } else { high },
                    ),
                });
            }
        }
    }
    pieces
}

/// The exact solver driven sample by sample.
pub struct Sampled {
    exact: Exact,
    /// Transitions of all pieces under a first-order hold.
    holds: Vec<Transition>,
    /// 1/dt, 1/s.
    rate: f64,
}

impl Sampled {
    /// With the transitions that it steps by.
    pub fn new(exact: Exact) -> Self {
        let holds = exact.pieces.iter().map(|piece| piece.hold(exact.dt)).collect();
        Self { rate: 1.0 / exact.dt, holds, exact }
    }
}

impl Specimen for Sampled {
    fn reset(&mut self) {
        self.exact.core.reset();
        self.exact.note_mode();
    }

    fn step(&mut self, table_acceleration_m_s2: f64) -> Response {
        let (end, exact) = (table_acceleration_m_s2, &mut self.exact);
        let start = exact.core.table().unwrap_or(end);
        let [d, v] = *exact.core.state();
        let state = self.holds[exact.current.0].apply(d, v, start, end);
        exact.sample(state, Line { start, slope: (end - start) * self.rate });
        exact.core.prime(end);
        exact.respond(end)
    }

    fn impose(&mut self, relative_displacement_m: f64, relative_velocity_m_s: f64) -> Response {
        let response = self.exact.core.impose(relative_displacement_m, relative_velocity_m_s);
        self.exact.note_mode();
        response
    }

    fn prime(&mut self, table_acceleration_m_s2: f64) {
        self.exact.core.prime(table_acceleration_m_s2);
    }

    fn set_time_s(&mut self, time_s: f64) {
        self.exact.core.set_time_s(time_s);
    }
}
