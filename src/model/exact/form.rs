//! Linear forms of the motion within a segment (distance to a knee, contact force, velocity) and the
//! search for the first that fails. A bound of the curvature over the rest of the segment gives a
//! step within which no form can reach zero, so that no crossing, nor a pair of them, is missed.

use super::segment::{Instant, Segment};
use crate::model::elementary::exp;

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
            let (tip, rate) = (self.tip.0 * exp(-self.tip.1 * t), self.tip.1);
            local.value += tip;
            local.slope -= rate * tip;
            local.curvature += rate * rate * tip;
            local.bound += rate * rate * tip.abs();
        }
        local
    }

    /// Between which values it stays from one instant to another.
    pub fn range(&self, segment: &Segment, ends: &[(f64, Instant); 2]) -> (f64, f64) {
        let bound = self.forced_bound(segment);
        let [start, end] = [&ends[0], &ends[1]].map(|(t, now)| self.local(segment, now, *t, bound));
        // A chord with a curve of bounded curvature over it.
        let rise = 0.125 * start.bound * (ends[1].0 - ends[0].0).powi(2);
        (start.value.min(end.value) - rise, start.value.max(end.value) + rise)
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
        let start = segment.at(0.0);
        let (z, rate) = start.free;
        let size = self.constant.abs() + forced_bound + (self.free.0 * z).abs() + (self.free.1 * rate).abs();
        8.0 * f64::EPSILON * (size + self.tip.0.abs())
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

impl Local {
    /// Halley's step to the root nearby, s.
    #[inline]
    fn halley(&self) -> f64 {
        let bent = 2.0 * self.slope * self.slope - self.value * self.curvature;
        -2.0 * self.value * self.slope / bent
    }

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

    /// The first form that falls through zero before `duration` s.
    pub fn first_failure(mut self, segment: &Segment, duration: f64) -> End {
        let mut now = segment.at(0.0);
        let mut t = 0.0;
        let lasts = || End { guard: None, time_s: duration, now: segment.at(duration) };
        for round in 0..PATIENCE {
            if round % 4 == 0 {
                self.drop_safe(segment, &now);
                if self.count == 0 {
                    return lasts();
                }
            }
            let mut steps = [f64::INFINITY; FORMS];
            let (mut nearest, mut local) = (0, None);
            for i in 0..self.count {
                let here = self.forms[i].local(segment, &now, t, self.bounds[i]);
                steps[i] = self.safe_step(i, segment, &now, &here);
                if steps[i] <= 0.0 {
                    return End { guard: Some(self.forms[i].guard), time_s: t, now };
                }
                if i == 0 || steps[i] < steps[nearest] {
                    (nearest, local) = (i, Some(here));
                }
            }
            let step = steps[nearest];
            if t + step >= duration {
                return lasts();
            }
            if let Some(end) = local.and_then(|local| local.certain())
                && end >= step
                && (0..self.count).all(|i| i == nearest || steps[i] > end)
            {
                let (after, then) = self.polish(nearest, segment, t, (step, end));
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

    /// The only root of a falling form between two times after `t`, to the last bits (Halley), and the
    /// parts of the motion there.
    fn polish(&self, i: usize, segment: &Segment, t: f64, (mut low, mut high): (f64, f64)) -> (f64, Instant) {
        let tolerance = f64::EPSILON * (t + high);
        let mut at = low;
        let mut now = segment.at(t + at);
        for _ in 0..60 {
            let here = self.forms[i].local(segment, &now, t + at, self.bounds[i]);
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

/// Calls `near` with every time around which a form may vanish between two times, to half a sample, and
/// with the parts of the motion then: between two such times it keeps its sign.
pub fn zeros(
    form: &Form,
    segment: &Segment,
    (from, to): (f64, f64),
    dt: f64,
    mut near: impl FnMut(f64, &Instant),
) {
    let bound = form.forced_bound(segment);
    let mut t = from;
    let mut now = segment.at(t);
    while t < to {
        let mut here = form.local(segment, &now, t, bound);
        if here.value < 0.0 {
            (here.value, here.slope, here.curvature) = (-here.value, -here.slope, -here.curvature);
        }
        let step = here.step();
        if step >= 0.5 * dt {
            // Close to the only root of a falling form Halley's step ends within a part of a sample of it.
            let jump = here.halley();
            let ratio = here.bound / here.slope.abs();
            let sure = here.certain().is_some_and(|end| jump >= step && jump <= end)
                && jump * (jump * ratio).powi(2) < 0.1 * dt;
            t += if sure { jump } else { step };
            now = segment.at(t);
            if !sure {
                continue;
            }
        }
        if t < to {
            near(t, &now);
            now = segment.beside(t, &now, 0.5 * dt);
            t += 0.5 * dt;
        }
    }
}
