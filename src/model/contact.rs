//! The contact law of a bumper and the relaxation of its massless tip, shared by both solvers.

use super::BumperSpec;

/// A tip this close to its rest is at rest, m: far below the rounding of any displacement.
const RELAXED_M: f64 = 1e-15;

/// Force of one bumper against penetration p: F0 + Kb p (or kh p^n) + kb3 p^3 + (Cb + mu p) p'.
///
/// The tip is massless, so out of contact its own force is zero and it relaxes by
/// elastic(x) + (Cb + mu x) x' = 0 (Andreaus and De Angelis 2020, equation 1).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ContactLaw {
    /// Kb, N/m.
    pub linear_n_m: f64,
    /// kh, N/m^n.
    pub hertz: f64,
    /// n.
    pub exponent: f64,
    /// kb3, N/m3.
    pub cubic_n_m3: f64,
    /// F0, N.
    pub preload_n: f64,
    /// Cb, N s/m.
    pub damping_n_s_m: f64,
    /// mu, N s/m2.
    pub hunt_crossley_n_s_m2: f64,
}

impl ContactLaw {
    pub(super) fn linear(bumper: Option<&BumperSpec>) -> Self {
        Self {
            linear_n_m: bumper.map_or(0.0, |b| b.stiffness_n_m),
            hertz: 0.0,
            exponent: 1.0,
            cubic_n_m3: 0.0,
            preload_n: 0.0,
            damping_n_s_m: bumper.map_or(0.0, |b| b.damping_n_s_m),
            hunt_crossley_n_s_m2: 0.0,
        }
    }

    /// Linear in penetration and its rate (a preload is allowed).
    pub fn is_linear(&self) -> bool {
        self.hertz == 0.0 && self.cubic_n_m3 == 0.0 && self.hunt_crossley_n_s_m2 == 0.0
    }

    /// Force at rest, N; odd in the nonlinear parts, so that rounding below zero does no harm.
    pub fn elastic_n(&self, p: f64) -> f64 {
        let mut force = self.preload_n + self.linear_n_m * p;
        if self.hertz != 0.0 {
            force += if self.exponent == 1.5 {
                self.hertz * p * p.abs().sqrt()
            } else {
                (self.hertz * p.abs().powf(self.exponent)).copysign(p)
            };
        }
        force + self.cubic_n_m3 * p * p * p
    }

    /// Coefficient of the rate of penetration, N s/m.
    pub fn viscous_n_s_m(&self, p: f64) -> f64 {
        self.damping_n_s_m + self.hunt_crossley_n_s_m2 * p.max(0.0)
    }

    /// Force of a bumper in contact, N; below zero it would pull, which ends the contact.
    pub fn force_n(&self, p: f64, rate: f64) -> f64 {
        self.elastic_n(p) + self.viscous_n_s_m(p) * rate
    }

    /// Deformation of a free tip after a while, m, from `tip` m at its beginning.
    pub fn relaxed_m(&self, tip: f64, after_s: f64) -> f64 {
        if tip <= RELAXED_M {
            return 0.0;
        }
        if !self.is_linear() {
            return self.relaxed_nonlinear_m(tip, after_s);
        }
        if self.damping_n_s_m == 0.0 {
            return if self.linear_n_m > 0.0 || self.preload_n > 0.0 { 0.0 } else { tip };
        }
        if self.linear_n_m == 0.0 {
            return (tip - self.preload_n / self.damping_n_s_m * after_s).max(0.0);
        }
        let (rest, fallen) = (self.rest_m(), self.relaxation_1_s() * after_s);
        // What is left after eighty time constants is far below rounding.
        if fallen > 80.0 { 0.0 } else { ((tip + rest) * (-fallen).exp() - rest).max(0.0) }
    }

    /// Rate at which a free tip of a linear law relaxes, 1/s; 0 when it stays where it is.
    pub fn relaxation_1_s(&self) -> f64 {
        if self.damping_n_s_m > 0.0 { self.linear_n_m / self.damping_n_s_m } else { 0.0 }
    }

    /// How far beyond its stop a tip of a linear law with preload would come back, m.
    pub fn rest_m(&self) -> f64 {
        if self.preload_n > 0.0 { self.preload_n / self.linear_n_m } else { 0.0 }
    }

    /// Rate of a free tip, m/s.
    pub fn tip_rate_m_s(&self, tip: f64) -> f64 {
        let viscous = self.viscous_n_s_m(tip);
        if tip > 0.0 && viscous > 0.0 { -self.elastic_n(tip) / viscous } else { 0.0 }
    }

    /// A free tip of a nonlinear law.
    fn relaxed_nonlinear_m(&self, tip: f64, after_s: f64) -> f64 {
        if self.viscous_n_s_m(tip) == 0.0 {
            return 0.0;
        }
        let x = self.closed_form().unwrap_or(Self::relaxed_by_steps_m)(self, tip, after_s);
        if x <= self.smallest_m(tip) { 0.0 } else { x }
    }

    /// Whether a free tip relaxes by a closed form.
    pub fn relaxes_in_closed_form(&self) -> bool {
        self.is_linear() || self.closed_form().is_some()
    }

    /// Closed form of a nonlinear law's free tip, which is there where a single nonlinear part stands in the law.
    fn closed_form(&self) -> Option<fn(&Self, f64, f64) -> f64> {
        let parts = [self.hertz, self.cubic_n_m3, self.hunt_crossley_n_s_m2, self.preload_n];
        match parts.map(|part| part != 0.0) {
            [true, false, false, false] if self.linear_n_m == 0.0 => Some(Self::relaxed_power_m),
            [false, true, false, false] if self.linear_n_m > 0.0 => Some(Self::relaxed_cubic_m),
            [false, false, true, false] if self.damping_n_s_m > 0.0 => Some(Self::relaxed_viscous_m),
            _ => None,
        }
    }

    /// What a tip is taken to be back at, m.
    fn smallest_m(&self, tip: f64) -> f64 {
        (1e-9 * tip).max(RELAXED_M)
    }

    /// kh x^n + Cb x' = 0.
    fn relaxed_power_m(&self, tip: f64, after_s: f64) -> f64 {
        let rate = self.hertz * tip.powf(self.exponent - 1.0) / self.damping_n_s_m * after_s;
        let over = self.exponent - 1.0;
        // (1 + over rate)^(-1/over), which is exp(-rate) as the exponent comes down to 1.
        let log = if over < 1e-9 { rate } else { (over * rate).ln_1p() / over };
        tip * (-log).exp()
    }

    /// Kb x + kb3 x^3 + Cb x' = 0 (Bernoulli's equation).
    fn relaxed_cubic_m(&self, tip: f64, after_s: f64) -> f64 {
        let fallen = self.relaxation_1_s() * after_s;
        let ratio = self.cubic_n_m3 * tip * tip / self.linear_n_m;
        tip * (-fallen).exp() / (1.0 - ratio * (-2.0 * fallen).exp_m1()).sqrt()
    }

    /// Kb x + (Cb + mu x) x' = 0, so that Cb ln x + mu x falls with slope Kb: Newton's method on ln x, convex
    /// and monotone.
    fn relaxed_viscous_m(&self, tip: f64, after_s: f64) -> f64 {
        let ratio = self.hunt_crossley_n_s_m2 * tip / self.damping_n_s_m;
        let goal = ratio - self.relaxation_1_s() * after_s;
        // y = ln(x / tip) solves y + ratio exp(y) = goal, and lies near the least of these.
        let mut y = goal.min(0.0).min(if goal > 0.0 { (goal / ratio).ln() } else { goal });
        for _ in 0..50 {
            let part = ratio * y.exp();
            let step = (y + part - goal) / (1.0 + part);
            y -= step;
            if step.abs() <= 1e-15 * (1.0 + y.abs()) {
                break;
            }
        }
        tip * y.exp()
    }

    /// Fourth-order steps, each a small part of the tip's own time constant.
    fn relaxed_by_steps_m(&self, tip: f64, after_s: f64) -> f64 {
        let (mut x, mut left) = (tip, after_s);
        let smallest = self.smallest_m(tip);
        for _ in 0..2000 {
            if left <= 0.0 {
                return x;
            }
            let rate = |x: f64| self.tip_rate_m_s(x);
            let k1 = rate(x);
            let h = if k1 < 0.0 { left.min(0.05 * x / -k1) } else { left };
            let k2 = rate(x + 0.5 * h * k1);
            let k3 = rate(x + 0.5 * h * k2);
            let k4 = rate(x + h * k3);
            x += h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4);
            left -= h;
            if x <= smallest {
                return 0.0;
            }
        }
        x
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn closed_forms_of_a_nonlinear_tip_are_its_steps() {
        let base = ContactLaw {
            linear_n_m: 33e3,
            hertz: 0.0,
            exponent: 1.5,
            cubic_n_m3: 0.0,
            preload_n: 0.0,
            damping_n_s_m: 300.0,
            hunt_crossley_n_s_m2: 0.0,
        };
        let power = |exponent| ContactLaw { linear_n_m: 0.0, hertz: 33e3, exponent, ..base };
        let viscous = |mu| ContactLaw { hunt_crossley_n_s_m2: mu, ..base };
        let cubic = ContactLaw { cubic_n_m3: 1e9, ..base };
        for law in [power(1.0 + 1e-12), power(1.5), power(2.7), viscous(1e3), viscous(1e6), cubic] {
            assert!(!law.is_linear());
            for tip in [1e-5, 3e-3, 0.02] {
                for after_s in [0.0, 1e-4, 3e-3, 0.02, 0.1] {
                    let (closed, steps) = (law.relaxed_m(tip, after_s), law.relaxed_by_steps_m(tip, after_s));
                    assert!((closed - steps).abs() < 2e-6 * tip, "{law:?} {tip} {after_s}: {closed} {steps}");
                }
            }
        }
    }
}
