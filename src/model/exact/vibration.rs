//! Free vibration of one linear piece in closed form, whatever its damping: the two fundamental
//! solutions, transitions of a free state, and bounds of what a free state can still do.

use crate::model::elementary::{exp, sin_cos};

/// Free vibration z'' + 2 alpha z' + w0^2 z = 0.
#[derive(Clone, Copy, Debug)]
pub struct Vibration {
    /// alpha, 1/s.
    pub decay: f64,
    /// w0^2, 1/s2.
    pub stiffness: f64,
    kind: Kind,
    /// Largest value that [`Vibration::fundamental`]'s S takes, s.
    largest_s: f64,
    /// w0 where the motion is a decaying oscillation whose envelope is close.
    swinging: Option<f64>,
}

#[derive(Clone, Copy, Debug)]
enum Kind {
    /// Frequency of the oscillation, rad/s, and its inverse.
    Under(f64, f64),
    /// The slower rate, and the difference of both, 1/s.
    Over(f64, f64),
    Critical,
}

impl Vibration {
    /// By alpha (1/s) and w0^2 (1/s2), neither below zero.
    pub fn new(decay: f64, stiffness: f64) -> Self {
        let difference = stiffness - decay * decay;
        let (kind, largest_s) = if difference.abs() <= 4.0 * f64::EPSILON * decay * decay {
            (Kind::Critical, 1.0 / (std::f64::consts::E * decay))
        } else if difference > 0.0 {
            let omega = difference.sqrt();
            (Kind::Under(omega, 1.0 / omega), (1.0 / omega).min(1.0 / (std::f64::consts::E * decay)))
        } else {
            let fast = decay + (-difference).sqrt();
            // The difference of two rates would cancel; their product is w0^2.
            let slow = stiffness / fast;
            (Kind::Over(slow, fast - slow), 1.0 / fast)
        };
        let swinging = (difference > decay * decay).then(|| stiffness.sqrt());
        Self { decay, stiffness, kind, largest_s, swinging }
    }

    /// C(t) and S(t) with z(t) = z0 C + (z0' + alpha z0) S and z'(t) = z0' C - (w0^2 z0 + alpha z0') S:
    /// exp(-alpha t) times cosine and sine/frequency, or their hyperbolic counterparts.
    #[inline]
    pub fn fundamental(&self, t: f64) -> (f64, f64) {
        match self.kind {
            Kind::Under(omega, inverse) => {
                let envelope = exp(-self.decay * t);
                let (sin, cos) = sin_cos(omega * t);
                (envelope * cos, envelope * inverse * sin)
            }
            Kind::Over(slow, difference) => {
                let envelope = exp(-slow * t);
                let fallen = -(-difference * t).exp_m1();
                (envelope * (1.0 - 0.5 * fallen), envelope * fallen / difference)
            }
            Kind::Critical => {
                let envelope = (-self.decay * t).exp();
                (envelope, envelope * t)
            }
        }
    }

    /// The free state (z, z') after the time of the given fundamental solutions.
    #[inline]
    pub fn advance(&self, (z, rate): (f64, f64), (c, s): (f64, f64)) -> (f64, f64) {
        (z * c + (rate + self.decay * z) * s, rate * c - (self.stiffness * z + self.decay * rate) * s)
    }

    /// z'' of a free state.
    #[inline]
    pub fn curvature(&self, (z, rate): (f64, f64)) -> f64 {
        -2.0 * self.decay * rate - self.stiffness * z
    }

    /// What abs(z), abs(z'') and abs(z''') never exceed from a free state on. An oscillation is the real part
    /// of Z exp(lambda t) with abs(lambda) = w0, so that one envelope bounds all of its derivatives.
    #[inline]
    pub fn bounds(&self, (z, rate): (f64, f64)) -> [f64; 3] {
        if let (Some(w0), Kind::Under(_, inverse)) = (self.swinging, self.kind) {
            let swing = (rate + self.decay * z) * inverse;
            let envelope = (z * z + swing * swing).sqrt();
            let second = self.stiffness * envelope;
            return [envelope, second, w0 * second];
        }
        let second = self.curvature((z, rate));
        let third = self.curvature((rate, second));
        let fourth = self.curvature((second, third));
        [(z, rate), (second, third), (third, fourth)].map(|state| self.bound(state))
    }

    /// What abs(z) never exceeds from a free state on.
    fn bound(&self, (z, rate): (f64, f64)) -> f64 {
        let swing = rate + self.decay * z;
        if swing == 0.0 && !matches!(self.kind, Kind::Under(..)) {
            return z.abs();
        }
        match self.kind {
            Kind::Under(_, inverse) => {
                let swing = swing * inverse;
                (z * z + swing * swing).sqrt().min(z.abs() + swing.abs() / inverse * self.largest_s)
            }
            _ => z.abs() + swing.abs() * self.largest_s,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_equation_holds_and_bounds_bound_for_every_damping() {
        for (decay, stiffness) in [
            (0.0, 40.0),
            (1.1, 40.0),
            (6.0, 36.0),
            (6.0, 36.0 - 1e-9),
            (6.0, 36.0 + 1e-9),
            (50.0, 40.0),
            (2.0, 0.0),
        ] {
            let free = Vibration::new(decay, stiffness);
            let start = (0.01, -0.3);
            let bounds = free.bounds(start);
            for i in 0..400 {
                let t = 0.01 * f64::from(i);
                let now = free.advance(start, free.fundamental(t));
                let second = free.curvature(now);
                let third = free.curvature((now.1, second));
                for (value, bound) in [now.0, second, third].into_iter().zip(bounds) {
                    assert!(value.abs() <= bound * (1.0 + 1e-12), "{decay} {stiffness} {t}");
                }
                // Two halves make the whole, and the rate is the derivative.
                let half = free.fundamental(0.5 * t);
                let twice = free.advance(free.advance(start, half), half);
                assert!((twice.0 - now.0).abs() < 1e-14 && (twice.1 - now.1).abs() < 1e-12);
                let at = |t: f64| free.advance(start, free.fundamental(t));
                let (before, after) = (at(t - 1e-5), at(t + 1e-5));
                assert!(((after.0 - before.0) / 2e-5 - now.1).abs() < 1e-7, "{decay} {stiffness} {t}");
                assert!(
                    ((after.1 - before.1) / 2e-5 - free.curvature(now)).abs() < 1e-4 * (1.0 + decay.powi(3))
                );
            }
        }
    }
}
