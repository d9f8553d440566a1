//! Linear forms of the motion within a segment (distance to a knee, contact force, velocity) and the
//! search for the first that fails. A bound of the curvature over the rest of the segment gives a
//! step within which no form can reach zero, so that no crossing, nor a pair of them, is missed.

use super::segment::{Instant, Segment};

/// Forms that one regime may need: two knees, two for each bumper, two for the bearings.
pub const FORMS: usize = 8;
/// Rounds after which a search gives up and the motion goes on regardless.
const PATIENCE: usize = 10_000;

/// g(t) = constant + forced and free parts + tip exp(-rate t).
#[derive(Clone, Copy, Debug, Default)]
pub struct Form {
    constant: f64,
    /// By the forced part, real and imaginary.
    forced: (f64, f64),
    /// By the free state.
    free: (f64, f64),
    /// A relaxing tip at the beginning, and its rate, 1/s.
    tip: (f64, f64),
    /// Guard that fails with it.
    pub guard: usize,
}

/// Value and slope of a form, and what the size of its curvature will not exceed from here on.
#[derive(Clone, Copy, Debug)]
struct Local {
    value: f64,
    slope: f64,
    curvature: f64,
    bound: f64,
}

impl Form {
    /// constant + k d + c v.
    pub fn of(segment: &Segment, guard: usize, constant: f64, k: f64, c: f64) -> Self {
        if let Some(d) = segment.held {
            return Self { constant: constant + k * d, guard, ..Self::default() };
        }
        let forced = (k, -c * segment.angular_frequency);
        Self { constant: constant + k * segment.closed.centre, forced, free: (k, c), tip: (0.0, 0.0), guard }
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

    fn forced_bound(&self, segment: &Segment) -> f64 {
        let (a, b) = self.forced;
        (a * a + b * b).sqrt() * segment.forced_amplitude()
    }

    #[inline]
    fn local(&self, segment: &Segment, now: &Instant, t: f64, forced_bound: f64) -> Local {
        let (w, free) = (segment.angular_frequency, &segment.closed.free);
        let (re, im) = now.forced;
        let (a, b) = self.forced;
        let wave = a * re + b * im;
        let state = self.free_state(segment, now);
        let bend = free.curvature(state);
        let bound = free.bound((bend, -2.0 * free.decay * bend - free.stiffness * state.1));
        let mut local = Local {
            value: self.constant + wave + state.0,
            slope: w * (b * re - a * im) + state.1,
            curvature: bend - w * w * wave,
            bound: w * w * forced_bound + bound,
        };
        if self.tip.0 != 0.0 {
            let (tip, rate) = (self.tip.0 * (-self.tip.1 * t).exp(), self.tip.1);
            local.value += tip;
            local.slope -= rate * tip;
            local.curvature += rate * rate * tip;
            local.bound += rate * rate * tip.abs();
        }
        local
    }

    /// It stays above zero from now on.
    fn is_safe(&self, segment: &Segment, now: &Instant, forced_bound: f64) -> bool {
        let free = segment.closed.free.bound(self.free_state(segment, now));
        self.constant + self.tip.0.min(0.0) > forced_bound + free
    }

    /// Bound of the third derivative.
    fn third_bound(&self, segment: &Segment, now: &Instant, forced_bound: f64) -> f64 {
        let (w, free) = (segment.angular_frequency, &segment.closed.free);
        let state = self.free_state(segment, now);
        let second = free.curvature(state);
        let third = free.curvature((state.1, second));
        let fourth = free.curvature((second, third));
        w.powi(3) * forced_bound + free.bound((third, fourth)) + self.tip.1.powi(3) * self.tip.0.abs()
    }

    /// Size below which a value is rounding alone.
    fn rounding(&self, segment: &Segment, forced_bound: f64) -> f64 {
        let start = segment.start();
        let (z, rate) = start.free;
        let size = self.constant.abs() + forced_bound + (self.free.0 * z).abs() + (self.free.1 * rate).abs();
        8.0 * f64::EPSILON * (size + self.tip.0.abs())
    }
}

impl Local {
    /// Time within which value + slope t - bound t^2/2 stays above zero.
    #[inline]
    fn step(&self) -> f64 {
        let root = (self.slope * self.slope + 2.0 * self.bound * self.value).sqrt();
        if self.slope < 0.0 {
            2.0 * self.value / (root - self.slope)
        } else if self.bound > 0.0 {
            (self.slope + root) / self.bound
        } else {
            f64::INFINITY
        }
    }

    /// Time before which value + slope t + bound t^2/2 is below zero, while the form falls throughout.
    #[inline]
    fn certain(&self) -> Option<f64> {
        let rest = self.slope * self.slope - 2.0 * self.bound * self.value;
        (self.slope < 0.0 && rest > 0.0).then(|| 2.0 * self.value / (rest.sqrt() - self.slope))
    }
}

/// The forms of one segment.
#[derive(Clone, Copy, Debug, Default)]
pub struct Forms {
    forms: [Form; FORMS],
    bounds: [f64; FORMS],
    count: usize,
}

impl Forms {
    /// Adds one.
    pub fn push(&mut self, segment: &Segment, form: Form) {
        if self.count < FORMS {
            (self.forms[self.count], self.bounds[self.count]) = (form, form.forced_bound(segment));
            self.count += 1;
        }
    }

    fn remove(&mut self, i: usize) {
        self.count -= 1;
        (self.forms[i], self.bounds[i]) = (self.forms[self.count], self.bounds[self.count]);
    }

    fn drop_safe(&mut self, segment: &Segment, now: &Instant) {
        let mut i = 0;
        while i < self.count {
            if self.forms[i].is_safe(segment, now, self.bounds[i]) { self.remove(i) } else { i += 1 }
        }
    }

    /// The first form that falls through zero before `duration` s: its guard and the time, s. Without
    /// a guard: none fails until the time.
    pub fn first_failure(mut self, segment: &Segment, duration: f64) -> (Option<usize>, f64) {
        let mut t = 0.0;
        for round in 0..PATIENCE {
            let now = segment.at(t);
            if round % 4 == 0 {
                self.drop_safe(segment, &now);
                if self.count == 0 {
                    return (None, duration);
                }
            }
            let mut steps = [f64::INFINITY; FORMS];
            let (mut nearest, mut local) = (0, None);
            for i in 0..self.count {
                let here = self.forms[i].local(segment, &now, t, self.bounds[i]);
                steps[i] = self.safe_step(i, segment, &now, &here);
                if steps[i] <= 0.0 {
                    return (Some(self.forms[i].guard), t);
                }
                if i == 0 || steps[i] < steps[nearest] {
                    (nearest, local) = (i, Some(here));
                }
            }
            let step = steps[nearest];
            if t + step >= duration {
                return (None, duration);
            }
            if let Some(end) = local.and_then(|local| local.certain())
                && end >= step
                && (0..self.count).all(|i| i == nearest || steps[i] > end)
            {
                let root = t + self.polish(nearest, segment, t, (step, end));
                return if root < duration {
                    (Some(self.forms[nearest].guard), root)
                } else {
                    (None, duration)
                };
            }
            t += step;
        }
        (None, t)
    }

    /// Time within which a form does not fall below zero; zero when it does at once. At a value that is
    /// rounding alone the slope decides, then the curvature.
    fn safe_step(&self, i: usize, segment: &Segment, now: &Instant, here: &Local) -> f64 {
        let form = &self.forms[i];
        let size = form.constant.abs() + self.bounds[i];
        if here.value > 1e-9 * size {
            return here.step();
        }
        let rounding = form.rounding(segment, self.bounds[i]);
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
        let third = form.third_bound(segment, now, self.bounds[i]);
        second.max(if third > 0.0 { here.curvature / third } else { f64::INFINITY })
    }

    /// The only root of a falling form between two times after `t`, to the last bits (Halley).
    fn polish(&self, i: usize, segment: &Segment, t: f64, (mut low, mut high): (f64, f64)) -> f64 {
        let tolerance = f64::EPSILON * (t + high);
        let mut at = low;
        for _ in 0..60 {
            let now = segment.at(t + at);
            let here = self.forms[i].local(segment, &now, t + at, self.bounds[i]);
            if here.value > 0.0 {
                low = at;
            } else {
                high = at;
            }
            let bent = 2.0 * here.slope * here.slope - here.value * here.curvature;
            let step = -2.0 * here.value * here.slope / bent;
            let next = at + step;
            // Halley's error falls with the cube of the step.
            let ratio = here.bound / here.slope.abs();
            if step.abs() * (step * ratio).powi(2) <= tolerance {
                return next.clamp(low, high);
            }
            at = if next > low && next < high { next } else { 0.5 * (low + high) };
            if high - low <= tolerance {
                break;
            }
        }
        at
    }
}

/// Calls `near` with every time around which a form may vanish between two times, to half a sample:
/// between two such times it keeps its sign.
pub fn zeros(form: &Form, segment: &Segment, (from, to): (f64, f64), dt: f64, mut near: impl FnMut(f64)) {
    let bound = form.forced_bound(segment);
    let mut t = from;
    while t < to {
        let now = segment.at(t);
        let mut here = form.local(segment, &now, t, bound);
        if here.value < 0.0 {
            (here.value, here.slope) = (-here.value, -here.slope);
        }
        let step = here.step();
        if step < 0.5 * dt {
            near(t);
            t += 0.5 * dt;
        } else {
            t += step;
        }
    }
}
