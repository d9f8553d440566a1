//! Table acceleration within one sample, as two numbers and as a power series.

use super::super::general::Line;

/// Terms of the power series; enough for the shortest time constants that the propagator accepts.
pub const TERMS: usize = 26;

/// An input that the exact transition knows.
pub trait Input: Copy {
    /// Coefficients a_n of a(t + s) = sum a_n s^n about a time t since the start of the sample.
    fn series(&self, time_s: f64) -> [f64; TERMS];
    /// Table acceleration, m/s2.
    fn at(&self, time_s: f64) -> f64;
}

impl Input for Line {
    fn series(&self, time_s: f64) -> [f64; TERMS] {
        let mut a = [0.0; TERMS];
        (a[0], a[1]) = (self.start + self.slope * time_s, self.slope);
        a
    }

    fn at(&self, time_s: f64) -> f64 {
        self.start + self.slope * time_s
    }
}

/// A sine by its value and quadrature at the start of the sample: a = p cos(w t) + q sin(w t).
#[derive(Clone, Copy, Debug)]
pub struct Wave {
    /// m/s2.
    pub value: f64,
    /// m/s2.
    pub quadrature: f64,
    /// rad/s.
    pub angular_frequency: f64,
}

impl Wave {
    /// The wave one sample later; `turn` is sine and cosine of w h.
    #[inline]
    pub fn turned(self, (sin, cos): (f64, f64)) -> Self {
        Self {
            value: self.value * cos + self.quadrature * sin,
            quadrature: self.quadrature * cos - self.value * sin,
            ..self
        }
    }
}

impl Input for Wave {
    fn series(&self, time_s: f64) -> [f64; TERMS] {
        let (sin, cos) = (self.angular_frequency * time_s).sin_cos();
        let mut now = self.value * cos + self.quadrature * sin;
        let mut next = self.quadrature * cos - self.value * sin;
        let mut a = [0.0; TERMS];
        let mut factor = 1.0;
        for (n, slot) in a.iter_mut().enumerate() {
            *slot = factor * now;
            (now, next) = (next, -now);
            factor *= self.angular_frequency / (n + 1) as f64;
        }
        a
    }

    fn at(&self, time_s: f64) -> f64 {
        let (sin, cos) = (self.angular_frequency * time_s).sin_cos();
        self.value * cos + self.quadrature * sin
    }
}
