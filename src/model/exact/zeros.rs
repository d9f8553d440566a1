//! Where a linear form of the motion vanishes within a segment, to a part of a sample: peaks lie there.
//! What is known at both ends of a span either shows that nothing vanishes within, or where to look.

use super::form::{Bounds, Form};
use super::local::Local;
use super::segment::{Instant, Segment};

/// How far off a zero may be left, in samples.
const SLACK: f64 = 0.1;
/// Halvings after which a span is taken as a whole.
const DEPTH: usize = 40;

/// What a search calls: with begin and end of a span, and with an instant and the parts of the motion then.
type Near<'a> = dyn FnMut((f64, f64), f64, &Instant) + 'a;

/// An instant with what is known of the form there.
#[derive(Clone, Copy)]
struct Place {
    t: f64,
    now: Instant,
    local: Local,
}

/// Calls `near` in the order of time with every span in which a form may vanish between two instants, and
/// with an instant close by and the parts of the motion then; elsewhere the form keeps its sign. `last` is
/// where a zero may be expected, for instance because one was there a cycle ago, and is set to the last found.
pub fn zeros(
    form: &Form,
    segment: &Segment,
    ends: &[(f64, Instant); 2],
    dt: f64,
    last: &mut Option<f64>,
    near: &mut Near<'_>,
) {
    let mut search = Search { form, segment, bounds: form.bounds(segment, &ends[0].1), dt, last, near };
    let [from, to] = ends.map(|(t, now)| search.look(t, now));
    search.span(&from, &to, 0);
}

struct Search<'a, 'n, 'v> {
    form: &'a Form,
    segment: &'a Segment<'a>,
    bounds: Bounds,
    dt: f64,
    last: &'n mut Option<f64>,
    near: &'n mut Near<'v>,
}

impl Search<'_, '_, '_> {
    fn look(&self, t: f64, now: Instant) -> Place {
        Place { t, now, local: self.form.local(self.segment, &now, t, &self.bounds) }
    }

    fn span(&mut self, from: &Place, to: &Place, depth: usize) {
        if from.local.value * to.local.value < 0.0 {
            let (root, place) = self.root(from, to);
            let slack = SLACK * self.dt;
            // At the root, whose slope is known to a few per cent.
            let local = Local { value: 0.0, slope: 0.95 * place.local.slope, ..place.local };
            let zero = Place { t: root, now: place.now, local };
            self.same(from, &zero, depth);
            (self.near)((root - slack, root + slack), place.t, &place.now);
            *self.last = Some(root);
            self.same(&zero, to, depth);
        } else {
            self.same(from, to, depth);
        }
    }

    /// A span at whose ends the form has one sign.
    fn same(&mut self, from: &Place, to: &Place, depth: usize) {
        let sign = if from.local.value + to.local.value < 0.0 { -1.0 } else { 1.0 };
        let (ahead, back) = (from.local.times(sign).step(), to.local.times(sign).reversed().step());
        let length = to.t - from.t;
        if length <= 0.0 || ahead + back >= length {
            return;
        }
        if depth >= DEPTH || length <= 0.5 * self.dt {
            (self.near)((from.t, to.t), from.t, &from.now);
            return;
        }
        let t = 0.5 * ((from.t + ahead) + (to.t - back));
        let middle = self.look(t, self.segment.at(t));
        self.span(from, &middle, depth + 1);
        self.span(&middle, to, depth + 1);
    }

    /// A root between two places where the form differs in sign, to the slack, and a place close by.
    fn root(&self, from: &Place, to: &Place) -> (f64, Place) {
        let slack = SLACK * self.dt;
        let (mut low, mut high) = (from.t, to.t);
        let within = |t: f64, low: f64, high: f64| if t > low && t < high { t } else { 0.5 * (low + high) };
        let [ahead, back] = [from, to].map(|place| place.local.halley());
        let nearer = if ahead.abs() <= back.abs() { from.t + ahead } else { to.t + back };
        // Where one was before, or half a cycle after the one just found.
        let half = std::f64::consts::PI / self.segment.angular_frequency;
        let expected =
            self.last.and_then(|last| [last, last + half].into_iter().find(|t| *t > low && *t < high));
        let mut t = within(expected.unwrap_or(nearer), low, high);
        loop {
            let place = self.look(t, self.segment.at(t));
            let jump = place.local.halley();
            // Halley's error falls with the cube of the step.
            let part = (jump * place.local.bound / place.local.slope).abs();
            let root = t + jump;
            if part < 0.02 && jump.abs() * part * part <= slack && root >= low && root <= high {
                return (root, place);
            }
            if high - low <= slack {
                return (t, place);
            }
            if place.local.value * from.local.value > 0.0 {
                low = t;
            } else {
                high = t;
            }
            t = within(root, low, high);
        }
    }
}
