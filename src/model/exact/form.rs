//! Linear forms of the motion within a segment (distance to a knee, contact force, velocity) and the
//! search for the first that fails. A bound of the curvature over the rest of the segment gives a
//! step within which no form can reach zero, so that no crossing, nor a pair of them, is missed.

use super::local::Local;
use super::segment::{Instant, Segment};
use crate::model::elementary::exp;

/// Forms that one regime may need: two knees, two for each bumper, two for the bearings.
pub const FORMS: usize = 8;
/// Rounds after which a search gives up and the motion goes on regardless.
const PATIENCE: usize = 10_000;
/// Tries to find a failure that was guessed.
const GUESSES: usize = 4;
/// Rounds after which bounds are set anew.
const REFRESH: usize = 4;
/// Part of its size above which a form is surely more than rounding.
const FAR: f64 = 1e-9;

/// g(t) = constant + forced and free parts + tip exp(-rate t).
#[derive(Clone, Copy, Debug, Default)]
pub struct Form {
    constant: f64,
    /// Factor of the displacement where nothing else that moves enters but a tip, else 0: such forms
    /// share what is known of the displacement.
    plain: f64,
    /// By the forced part, real and imaginary.
    forced: (f64, f64),
    /// By the free state.
    free: (f64, f64),
    /// A relaxing tip at the beginning, and its rate, 1/s.
    tip: (f64, f64),
    /// Guard that fails with it.
    pub guard: usize,
}

/// What sizes will not exceed from an instant on, tips apart: of what moves in a form, of its second and of
/// its third derivative.
#[derive(Clone, Copy, Debug, Default)]
pub struct Bounds {
    reach: f64,
    second: f64,
    third: f64,
}

impl Bounds {
    fn times(&self, k: f64) -> Self {
        Self { reach: k.abs() * self.reach, second: k.abs() * self.second, third: k.abs() * self.third }
    }
}

impl Form {
    /// constant + k d + c v.
    pub fn of(segment: &Segment, guard: usize, constant: f64, k: f64, c: f64) -> Self {
        if let Some(d) = segment.held {
            return Self { constant: constant + k * d, guard, ..Self::default() };
        }
        let forced = (k, -c * segment.angular_frequency);
        let constant = constant + k * segment.closed.centre;
        let plain = if c == 0.0 { k } else { 0.0 };
        Self { constant, plain, forced, free: (k, c), tip: (0.0, 0.0), guard }
    }

    /// constant + m times the table acceleration, for a held mass.
    pub fn of_table(guard: usize, constant: f64, m: f64) -> Self {
        Self { constant, forced: (m, 0.0), guard, ..Self::default() }
    }

    /// With a tip that relaxes from `tip` m at `rate` 1/s.
    pub fn with_tip(self, tip: f64, rate: f64) -> Self {
        Self { tip: (tip, rate), ..self }
    }

    /// Its derivative in time.
    pub fn derivative(&self, segment: &Segment) -> Self {
        let (w, free) = (segment.angular_frequency, &segment.closed.free);
        Self {
            constant: 0.0,
            plain: 0.0,
            forced: (w * self.forced.1, -w * self.forced.0),
            free: (-free.stiffness * self.free.1, self.free.0 - 2.0 * free.decay * self.free.1),
            tip: (-self.tip.0 * self.tip.1, self.tip.1),
            guard: self.guard,
        }
    }

    fn free_state(&self, segment: &Segment, now: &Instant) -> (f64, f64) {
        let (z, rate) = now.free;
        let (by_z, by_rate) = self.free;
        let y = by_z * z + by_rate * rate;
        (y, by_z * rate + by_rate * segment.closed.free.curvature(now.free))
    }

    /// The displacement about its centre.
    fn displacement() -> Self {
        Self { forced: (1.0, 0.0), free: (1.0, 0.0), ..Self::default() }
    }

    /// Bounds from an instant on.
    pub fn bounds(&self, segment: &Segment, now: &Instant) -> Bounds {
        let (a, b) = self.forced;
        let w = segment.angular_frequency;
        let forced = (a * a + b * b).sqrt() * segment.amplitude;
        let [reach, second, third] = segment.closed.free.bounds(self.free_state(segment, now));
        let bend = w * w * forced;
        Bounds { reach: forced + reach, second: bend + second, third: w * bend + third }
    }

    /// What is known at an instant at a time, under bounds from there or an earlier instant on.
    #[inline]
    pub fn local(&self, segment: &Segment, now: &Instant, t: f64, bounds: &Bounds) -> Local {
        let (w, free) = (segment.angular_frequency, &segment.closed.free);
        let (re, im) = now.forced;
        let (a, b) = self.forced;
        let wave = a * re + b * im;
        let state = self.free_state(segment, now);
        let local = Local {
            value: self.constant + wave + state.0,
            slope: w * (b * re - a * im) + state.1,
            curvature: free.curvature(state) - w * w * wave,
            bound: bounds.second,
            third: bounds.third,
        };
        self.with_relaxation(local, t)
    }

    /// [`Form::local`] by what is known of the displacement about its centre.
    #[inline]
    fn local_by(&self, shared: &Local, segment: &Segment, now: &Instant, t: f64, bounds: &Bounds) -> Local {
        if self.plain == 0.0 {
            return self.local(segment, now, t, bounds);
        }
        let mut local = shared.times(self.plain);
        local.value += self.constant;
        self.with_relaxation(local, t)
    }

    /// With the tip at a time.
    #[inline]
    fn with_relaxation(&self, mut local: Local, t: f64) -> Local {
        if self.tip.0 != 0.0 {
            let (tip, rate) = (self.tip.0 * exp(-self.tip.1 * t), self.tip.1);
            let bend = rate * rate * tip;
            local.value += tip;
            local.slope -= rate * tip;
            local.curvature += bend;
            local.bound += bend.abs();
            local.third += rate * bend.abs();
        }
        local
    }

    /// Between which values it stays from one instant to another.
    pub fn range(&self, segment: &Segment, ends: &[(f64, Instant); 2]) -> (f64, f64) {
        let bounds = self.bounds(segment, &ends[0].1);
        let [start, end] = [&ends[0], &ends[1]].map(|(t, now)| self.local(segment, now, *t, &bounds).value);
        // A chord with a curve of bounded curvature over it.
        let rise = 0.125 * bounds.second * (ends[1].0 - ends[0].0).powi(2);
        (start.min(end) - rise, start.max(end) + rise)
    }

    /// Between which values it stays for good.
    pub fn swing(&self, segment: &Segment) -> (f64, f64) {
        let reach = self.bounds(segment, &segment.at(0.0)).reach;
        (self.constant - reach, self.constant + reach)
    }
}

/// Where a segment ends.
#[derive(Clone, Copy, Debug)]
pub struct End {
    /// The guard that fails; none when none does until the time.
    pub guard: Option<usize>,
    /// Time since the beginning of the segment, s.
    pub time_s: f64,
    /// Parts of the motion then.
    pub now: Instant,
}

/// A failure that was guessed and found, and what is known of all forms close by.
struct Expected {
    end: End,
    t: f64,
    locals: [Local; FORMS],
}

/// The forms of one segment.
#[derive(Clone, Copy, Debug, Default)]
pub struct Forms {
    forms: [Form; FORMS],
    bounds: [Bounds; FORMS],
    /// Sizes at the beginning.
    sizes: [f64; FORMS],
    count: usize,
}

impl Forms {
    /// Adds one.
    pub fn push(&mut self, form: Form) {
        if self.count < FORMS {
            self.forms[self.count] = form;
            self.count += 1;
        }
    }

    fn remove(&mut self, i: usize) {
        self.count -= 1;
        let last = self.count;
        self.forms[i] = self.forms[last];
        (self.bounds[i], self.sizes[i]) = (self.bounds[last], self.sizes[last]);
    }

    /// Sets the bounds from an instant on, also those of the displacement about its centre, which it gives
    /// back, and drops forms that stay above zero.
    fn refresh(&mut self, segment: &Segment, now: &Instant, begins: bool) -> Bounds {
        let shared = Form::displacement().bounds(segment, now);
        let mut i = 0;
        while i < self.count {
            let form = &self.forms[i];
            let bounds = if form.plain == 0.0 { form.bounds(segment, now) } else { shared.times(form.plain) };
            if form.constant + form.tip.0.min(0.0) > bounds.reach {
                // The last takes its place, not yet looked at.
                self.remove(i);
                continue;
            }
            if begins {
                self.sizes[i] = form.constant.abs() + bounds.reach + form.tip.0.abs();
            }
            self.bounds[i] = bounds;
            i += 1;
        }
        shared
    }

    /// The first form that falls through zero before `duration` s. `guess` is a guard and a time at which it
    /// may be expected to fail, for instance because it did one cycle ago: it saves the way there where what is
    /// known at both ends shows that nothing fails between.
    pub fn first_failure(&mut self, segment: &Segment, duration: f64, guess: Option<(usize, f64)>) -> End {
        let mut now = segment.at(0.0);
        let mut t = 0.0;
        let lasts = || End { guard: None, time_s: duration, now: segment.at(duration) };
        let (mut bounds, mut expected) = (Bounds::default(), None);
        for round in 0..PATIENCE {
            if round % REFRESH == 0 {
                bounds = self.refresh(segment, &now, round == 0);
                expected = None;
                if self.count == 0 {
                    return lasts();
                }
            }
            let shared = Form::displacement().local(segment, &now, t, &bounds);
            let (mut locals, mut steps) = ([shared; FORMS], [f64::INFINITY; FORMS]);
            for i in 0..self.count {
                locals[i] = self.forms[i].local_by(&shared, segment, &now, t, &self.bounds[i]);
                steps[i] = self.safe_step(i, segment, &locals[i]);
                if steps[i] <= 0.0 {
                    return End { guard: Some(self.forms[i].guard), time_s: t, now };
                }
            }
            if round == 0
                && let Some(guess) = guess
            {
                expected = self.expect(segment, &bounds, guess, duration);
            }
            if let Some(expected) = &expected
                && self.leads(&locals, &steps, t, expected)
            {
                return expected.end;
            }
            let nearest = self.stretch(&locals, &mut steps);
            let (step, here) = (steps[nearest], &locals[nearest]);
            if t + step >= duration {
                return lasts();
            }
            if let Some(end) = here.certain()
                && end >= step
                && (0..self.count).all(|i| i == nearest || steps[i] > end)
            {
                let (after, then) = self.polish(nearest, segment, t, here.halley(), (step, end));
                let time_s = t + after;
                if time_s >= duration {
                    return lasts();
                }
                return End { guard: Some(self.forms[nearest].guard), time_s, now: then };
            }
            t += step;
            now = segment.at(t);
        }
        End { guard: None, time_s: t, now }
    }

    /// The failure of a guessed form near a guessed time, polished; `None` where it is not there.
    fn expect(
        &self,
        segment: &Segment,
        bounds: &Bounds,
        (guard, mut t): (usize, f64),
        duration: f64,
    ) -> Option<Expected> {
        let i = self.forms[..self.count].iter().position(|form| form.guard == guard)?;
        for _ in 0..GUESSES {
            if !(t > 0.0 && t < duration) {
                return None;
            }
            let now = segment.at(t);
            let shared = Form::displacement().local(segment, &now, t, bounds);
            let look = |i: usize| self.forms[i].local_by(&shared, segment, &now, t, &self.bounds[i]);
            let here = look(i);
            let step = here.halley();
            if !(here.slope < 0.0 && step.abs() < 0.3 * t) {
                return None;
            }
            let ratio = here.bound / here.slope.abs();
            if step.abs() * (step * ratio).powi(2) > f64::EPSILON * t {
                t += step;
                continue;
            }
            let mut locals = [here; FORMS];
            for (j, local) in locals.iter_mut().enumerate().take(self.count) {
                if j != i {
                    *local = look(j);
                    if local.value <= 0.0 || local.step() <= step {
                        return None;
                    }
                }
            }
            let end = End { guard: Some(guard), time_s: t + step, now: segment.beside(t, &now, step) };
            return (end.time_s > 0.0 && end.time_s < duration).then_some(Expected { end, t, locals });
        }
        None
    }

    /// Nothing fails from a time to the expected failure: what is safe ahead of the one and back from the
    /// other overlaps.
    fn leads(&self, locals: &[Local; FORMS], steps: &[f64; FORMS], t: f64, expected: &Expected) -> bool {
        (0..self.count).all(|i| {
            // Bounds from here on hold back from there too.
            let there = Local { bound: locals[i].bound, ..expected.locals[i].reversed() };
            steps[i] + there.step() >= expected.t - t
        })
    }

    /// The form that limits the step, after those that would have are let go as far as they may.
    fn stretch(&self, locals: &[Local; FORMS], steps: &mut [f64; FORMS]) -> usize {
        let mut stretched = [false; FORMS];
        loop {
            let nearest = (1..self.count).fold(0, |least, i| if steps[i] < steps[least] { i } else { least });
            if stretched[nearest] {
                return nearest;
            }
            stretched[nearest] = true;
            if locals[nearest].value > FAR * self.sizes[nearest] {
                steps[nearest] = locals[nearest].farther(steps[nearest]);
            }
        }
    }

    /// Time within which a form does not fall below zero; zero when it does at once. At a value that is
    /// rounding alone the slope decides, then the curvature.
    fn safe_step(&self, i: usize, segment: &Segment, here: &Local) -> f64 {
        let (form, size) = (&self.forms[i], self.sizes[i]);
        if here.value > FAR * size {
            return here.step();
        }
        let rounding = 8.0 * f64::EPSILON * size;
        let rate = segment.angular_frequency.max(segment.closed.free.stiffness.sqrt()) + form.tip.1;
        let flat = 64.0 * rounding * rate;
        let at_zero = here.value <= rounding;
        if at_zero && (here.value < -1e6 * rounding || here.slope < -flat) {
            return 0.0;
        }
        let second = match (at_zero, here.bound > 0.0) {
            (false, _) => here.step(),
            (true, true) => here.slope.max(0.0) / here.bound,
            (true, false) => f64::INFINITY,
        };
        if here.slope < -flat {
            return second;
        }
        if here.curvature <= 0.0 {
            return if at_zero && here.slope <= flat { 0.0 } else { second };
        }
        // Rising by curvature: the bound of the third derivative reaches further.
        second.max(if here.third > 0.0 { here.curvature / here.third } else { f64::INFINITY })
    }

    /// The only root of a falling form between two times after `t`, from a first guess to the last bits
    /// (Halley), and the parts of the motion there.
    fn polish(
        &self,
        i: usize,
        segment: &Segment,
        t: f64,
        guess: f64,
        (mut low, mut high): (f64, f64),
    ) -> (f64, Instant) {
        let tolerance = f64::EPSILON * (t + high);
        let mut at = guess.clamp(low, high);
        let mut now = segment.at(t + at);
        for _ in 0..60 {
            let here = self.forms[i].local(segment, &now, t + at, &self.bounds[i]);
            if here.value > 0.0 {
                low = at;
            } else {
                high = at;
            }
            let step = here.halley();
            // Halley's error falls with the cube of the step.
            let ratio = here.bound / here.slope.abs();
            if step.abs() * (step * ratio).powi(2) <= tolerance {
                let next = (at + step).clamp(low, high);
                return (next, segment.beside(t + at, &now, next - at));
            }
            let next = at + step;
            at = if next > low && next < high { next } else { 0.5 * (low + high) };
            now = segment.at(t + at);
            if high - low <= tolerance {
                break;
            }
        }
        (at, now)
    }
}
