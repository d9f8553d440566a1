//! An imposed motion between two samples: the cubic through displacement and velocity at both. What turns with the motion, relaxes along
//! it or begins to touch within a sample asks here.

/// A cubic course over some time, by displacement (m) and velocity (m/s) at both ends.
#[derive(Clone, Copy, Debug)]
pub struct Cubic {
    /// At the beginning.
    pub from: (f64, f64),
    /// At the end.
    pub to: (f64, f64),
    /// s.
    pub during_s: f64,
}

impl Cubic {
    /// Its acceleration at the beginning, m/s2, and how fast that rises, m/s3.
    pub fn acceleration(&self) -> (f64, f64) {
        let (more, bulge) = (self.to.1 - self.from.1, 6.0 * self.bulge_m_s());
        ((more + bulge) / self.during_s, -2.0 * bulge / (self.during_s * self.during_s))
    }

    /// By how much the mean velocity is more than that of both ends, m/s: it is v0 + part (v1 - v0) + 6 part (1 - part) of this.
    pub fn bulge_m_s(&self) -> f64 {
        (self.to.0 - self.from.0) / self.during_s - 0.5 * (self.from.1 + self.to.1)
    }

    /// Displacement and velocity after a part of the time.
    pub fn at(&self, part: f64) -> (f64, f64) {
        let (start, more, bulge) = (self.from.1, self.to.1 - self.from.1, 6.0 * self.bulge_m_s());
        let way = part * (start + part * (0.5 * (more + bulge) - part * bulge / 3.0));
        (self.from.0 + self.during_s * way, start + part * (more + (1.0 - part) * bulge))
    }

    /// The same in two, cut after a part of the time.
    pub fn cut(&self, part: f64) -> [Self; 2] {
        let between = self.at(part);
        let (first, rest) = (part * self.during_s, (1.0 - part) * self.during_s);
        let before = Self { from: self.from, to: between, during_s: first };
        [before, Self { from: between, to: self.to, during_s: rest }]
    }

    /// Displacement at which the motion turns on its way, m; none where it does not. One that turns twice between two samples is not seen to.
    pub fn turns_at_m(&self) -> Option<f64> {
        let (start, end) = (self.from.1, self.to.1);
        if start * end >= 0.0 {
            return None;
        }
        // Of opposite sign at both ends, the velocity is nothing once between them.
        let bulge = 6.0 * self.bulge_m_s();
        let rise = end - start + bulge;
        let root = (rise * rise + 4.0 * bulge * start).sqrt();
        let part = -2.0 * start / (rise + root.copysign(end - start));
        part.is_finite().then(|| self.at(part).0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_course_is_the_cubic_through_its_ends_and_turns_where_its_velocity_is_nothing() {
        let place = |t: f64| 0.01 - 0.3 * t + 4.0 * t * t - 7.0 * t.powi(3);
        let speed = |t: f64| -0.3 + 8.0 * t - 21.0 * t * t;
        let (from_s, to_s) = (0.01, 0.06);
        let [from, to] = [from_s, to_s].map(|t| (place(t), speed(t)));
        let course = Cubic { from, to, during_s: to_s - from_s };
        let (start, slope) = course.acceleration();
        assert!(
            (start - (8.0 - 42.0 * from_s)).abs() < 1e-10 && (slope + 42.0).abs() < 1e-8,
            "{start} {slope}"
        );
        for part in [0.0, 0.3, 1.0] {
            let (t, (d, v)) = (from_s + part * (to_s - from_s), course.at(part));
            assert!((d - place(t)).abs() < 1e-15 && (v - speed(t)).abs() < 1e-14, "{part}: {d} {v}");
        }
        let turn_s = (8.0 - (64.0_f64 - 25.2).sqrt()) / 42.0;
        let turn_m = course.turns_at_m().expect("turns");
        assert!((turn_m - place(turn_s)).abs() < 1e-15, "{turn_m}");
        let [before, after] = course.cut(0.4);
        assert!((before.at(0.5).0 - course.at(0.2).0).abs() < 1e-15);
        assert!((after.at(0.5).0 - course.at(0.7).0).abs() < 1e-15);
        assert_eq!([before, after].map(|part| part.turns_at_m().is_some()), [false, true]);
    }
}
