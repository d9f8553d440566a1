//! The motion between two events of an ideal sweep in closed form: a constant, the forced sine, and
//! the free vibration of the piece; evaluated at one instant, or at a row of samples.

use super::piece::Piece;
use super::vibration::Vibration;
use crate::model::elementary::sin_cos;

/// Samples that are evaluated in one go.
pub const ROW: usize = 64;

/// What a piece needs for closed form.
#[derive(Clone, Copy, Debug)]
pub struct Closed {
    /// Coefficients.
    pub piece: Piece,
    /// Free vibration.
    pub free: Vibration,
    /// Displacement about which it vibrates, m.
    pub centre: f64,
}

impl Closed {
    /// `None` where closed form would lose digits: a constant force on hardly any stiffness, or an
    /// undamped piece driven close to its own frequency (`frequencies`, rad/s).
    pub fn new(piece: &Piece, frequencies: &[f64], length: f64) -> Option<Self> {
        let centre = if piece.constant == 0.0 { 0.0 } else { -piece.constant / piece.stiffness };
        let within = centre.abs() <= 1e4 * length;
        if !within {
            return None;
        }
        let resonant = |w: &f64| {
            let (re, im) = (piece.stiffness - w * w, piece.damping * w);
            re * re + im * im < 1e-6 * piece.stiffness.max(w * w).powi(2)
        };
        if frequencies.iter().any(resonant) {
            return None;
        }
        Some(Self { piece: *piece, free: Vibration::new(0.5 * piece.damping, piece.stiffness), centre })
    }
}

/// Table acceleration a(t) = p cos(w t) + q sin(w t) about the beginning of a segment.
#[derive(Clone, Copy, Debug)]
pub struct Forcing {
    /// p, m/s2.
    pub value: f64,
    /// q, m/s2.
    pub quadrature: f64,
    /// w, rad/s.
    pub angular_frequency: f64,
}

/// The motion from one event to the next. A held mass (dry friction) keeps its displacement, and its
/// forced part is the table acceleration itself.
#[derive(Clone, Copy, Debug)]
pub struct Segment<'a> {
    /// The piece.
    pub closed: &'a Closed,
    /// w, rad/s.
    pub angular_frequency: f64,
    /// Forced part at the beginning: Re(z exp(i w t)).
    forced: (f64, f64),
    /// Amplitude of the forced part, m (or m/s2 while held).
    pub amplitude: f64,
    /// Free state at the beginning.
    free: (f64, f64),
    /// Where friction holds the mass, m.
    pub held: Option<f64>,
}

/// The parts of the motion at one instant.
#[derive(Clone, Copy, Debug)]
pub struct Instant {
    /// Forced part, real and imaginary.
    pub forced: (f64, f64),
    /// Free state.
    pub free: (f64, f64),
}

impl<'a> Segment<'a> {
    /// From displacement and velocity under a forcing.
    pub fn new(closed: &'a Closed, (d, v): (f64, f64), forcing: Forcing, held: bool) -> Self {
        let w = forcing.angular_frequency;
        let begin = |forced: (f64, f64), free, held| {
            let amplitude = (forced.0 * forced.0 + forced.1 * forced.1).sqrt();
            Self { closed, angular_frequency: w, forced, amplitude, free, held }
        };
        if held {
            return begin((forcing.value, -forcing.quadrature), (0.0, 0.0), Some(d));
        }
        // z = -(p - i q) / (w0^2 - w^2 + i c w).
        let (re, im) = (closed.piece.stiffness - w * w, closed.piece.damping * w);
        let inverse = 1.0 / (re * re + im * im);
        let (p, q) = (forcing.value, forcing.quadrature);
        let forced = ((q * im - p * re) * inverse, (q * re + p * im) * inverse);
        begin(forced, (d - closed.centre - forced.0, v + w * forced.1), None)
    }

    /// The parts after a time, s.
    #[inline]
    pub fn at(&self, t: f64) -> Instant {
        if t == 0.0 {
            return Instant { forced: self.forced, free: self.free };
        }
        let (sin, cos) = sin_cos(self.angular_frequency * t);
        let (re, im) = self.forced;
        let forced = (re * cos - im * sin, re * sin + im * cos);
        let free = if self.held.is_some() {
            self.free
        } else {
            self.closed.free.advance(self.free, self.closed.free.fundamental(t))
        };
        Instant { forced, free }
    }

    /// The parts a short time after (or before) an instant at a time, s: by power series, which near an
    /// instant take a third of the work.
    pub fn beside(&self, t: f64, now: &Instant, after: f64) -> Instant {
        // 1/(n (n - 1)) for the terms from n = 2 on.
        const INVERSE: [f64; 7] =
            [1.0 / 2.0, 1.0 / 6.0, 1.0 / 12.0, 1.0 / 20.0, 1.0 / 30.0, 1.0 / 42.0, 1.0 / 56.0];
        let free = &self.closed.free;
        let fastest = self.angular_frequency.max(free.stiffness.sqrt()).max(2.0 * free.decay);
        if fastest * after.abs() > 0.05 {
            return self.at(t + after);
        }
        // Two terms do where the third is below rounding.
        let tiny = fastest * after.abs() < 5e-6;
        let turn = self.angular_frequency * after;
        let (sin, cos) = if tiny { (turn, 1.0 - 0.5 * turn * turn) } else { sin_cos(turn) };
        let (re, im) = now.forced;
        let forced = (re * cos - im * sin, re * sin + im * cos);
        if self.held.is_some() {
            return Instant { forced, free: now.free };
        }
        if tiny {
            let (z, rate) = now.free;
            let bend = free.curvature(now.free);
            let third = free.curvature((rate, bend));
            let x = z + after * (rate + 0.5 * after * bend);
            return Instant { forced, free: (x, rate + after * (bend + 0.5 * after * third)) };
        }
        // x_n after^n, and the same of the rate.
        let (mut last, mut term) = (now.free.0, now.free.1 * after);
        let (mut x, mut rate) = (last + term, term);
        for (n, inverse) in INVERSE.iter().enumerate() {
            let m = n as f64 + 1.0;
            let bend = 2.0 * free.decay * m * term + free.stiffness * after * last;
            (last, term) = (term, -after * inverse * bend);
            x += term;
            rate += (m + 1.0) * term;
        }
        let rate = if after == 0.0 { now.free.1 } else { rate / after };
        Instant { forced, free: (x, rate) }
    }

    /// Displacement (m) and velocity (m/s) at an instant.
    #[inline]
    pub fn state(&self, now: &Instant) -> (f64, f64) {
        match self.held {
            Some(d) => (d, 0.0),
            None => (
                self.closed.centre + now.forced.0 + now.free.0,
                now.free.1 - self.angular_frequency * now.forced.1,
            ),
        }
    }

    /// Absolute acceleration of the mass in a state at an instant, m/s2.
    #[inline]
    pub fn acceleration(&self, now: &Instant, (d, v): (f64, f64)) -> f64 {
        if self.held.is_some() {
            return now.forced.0;
        }
        let piece = &self.closed.piece;
        -(piece.stiffness * d + piece.damping * v + piece.constant)
    }

    /// Displacement, velocity and acceleration at samples from `first` s on, into columns of equal
    /// length.
    pub fn fill(&self, first: f64, tables: &Tables, turns: &Turns, out: [&mut [f64]; 3]) {
        let mut now = self.at(first);
        let [d, v, a] = out;
        if self.held.is_some() {
            self.fill_held(now, turns, d, v, a);
            return;
        }
        let free = &self.closed.free;
        for ((d, v), a) in d.chunks_mut(ROW).zip(v.chunks_mut(ROW)).zip(a.chunks_mut(ROW)) {
            self.row(&now, tables, turns, d, v, a);
            let ((re, im), (cos, sin)) = (now.forced, turns.whole);
            now.forced = (re * cos - im * sin, re * sin + im * cos);
            now.free = free.advance(now.free, tables.whole);
        }
    }

    #[inline]
    fn row(
        &self,
        now: &Instant,
        tables: &Tables,
        turns: &Turns,
        d: &mut [f64],
        v: &mut [f64],
        a: &mut [f64],
    ) {
        let (piece, free, w) = (&self.closed.piece, &self.closed.free, self.angular_frequency);
        let ((re, im), (z, rate)) = (now.forced, now.free);
        let (centre, re_v, im_v) = (self.closed.centre, w * re, w * im);
        let (swing, pull) = (rate + free.decay * z, free.stiffness * z + free.decay * rate);
        let (k, c, g) = (piece.stiffness, piece.damping, piece.constant);
        let columns = turns.cos.iter().zip(&turns.sin).zip(tables.c.iter().zip(&tables.s));
        let out = d.iter_mut().zip(v.iter_mut()).zip(a.iter_mut());
        for (((cos, sin), (c_j, s_j)), ((d, v), a)) in columns.zip(out) {
            let x = (centre + (re * cos - im * sin)) + (z * c_j + swing * s_j);
            let y = (rate * c_j - pull * s_j) - (im_v * cos + re_v * sin);
            (*d, *v, *a) = (x, y, -((k * x + g) + c * y));
        }
    }

    fn fill_held(&self, mut now: Instant, turns: &Turns, d: &mut [f64], v: &mut [f64], a: &mut [f64]) {
        d.fill(self.held.unwrap_or(0.0));
        v.fill(0.0);
        for row in a.chunks_mut(ROW) {
            let (re, im) = now.forced;
            for ((a, cos), sin) in row.iter_mut().zip(&turns.cos).zip(&turns.sin) {
                *a = re * cos - im * sin;
            }
            let (cos, sin) = turns.whole;
            now.forced = (re * cos - im * sin, re * sin + im * cos);
        }
    }
}

/// Fundamental solutions of one piece at the samples of a row.
#[derive(Clone, Debug)]
pub struct Tables {
    c: [f64; ROW],
    s: [f64; ROW],
    whole: (f64, f64),
}

impl Tables {
    /// For samples `dt` s apart.
    pub fn new(free: &Vibration, dt: f64) -> Self {
        let at = |i: usize| free.fundamental(i as f64 * dt);
        Self { c: std::array::from_fn(|i| at(i).0), s: std::array::from_fn(|i| at(i).1), whole: at(ROW) }
    }
}

/// Cosine and sine of one angular frequency at the samples of a row.
#[derive(Clone, Debug)]
pub struct Turns {
    cos: [f64; ROW],
    sin: [f64; ROW],
    whole: (f64, f64),
}

impl Turns {
    /// For samples `dt` s apart.
    pub fn new(angular_frequency: f64, dt: f64) -> Self {
        let (mut cos, mut sin) = ([0.0; ROW], [0.0; ROW]);
        for i in 0..ROW {
            (sin[i], cos[i]) = (angular_frequency * (i as f64 * dt)).sin_cos();
        }
        let (s, c) = (angular_frequency * (ROW as f64 * dt)).sin_cos();
        Self { cos, sin, whole: (c, s) }
    }
}
