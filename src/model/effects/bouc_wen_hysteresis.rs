//! Rate-independent hysteresis of Bouc (1967) and Wen (1976).

use super::{Effect, Parameter, Place};
use crate::model::cubic::Cubic;
use crate::model::system::{Point, Term};

/// `bouc-wen-hysteresis`.
pub static EFFECT: Effect = Effect {
    name: "bouc-wen-hysteresis",
    place: Place::Isolator,
    equation: "F = kh z, z' = v (1 - (beta sign(v z) + gamma) |z/dy|^n)",
    source: "R. Bouc 1967; Y.-K. Wen, J. Eng. Mech. Div. ASCE 102 (1976) 249",
    states: "z (m)",
    regime: "all",
    shows: "closed, rate-independent loops A(D) with rounded corners; softening with amplitude",
    experiment: "slow cycles at several A_G",
    piecewise_linear: false,
    parameters: |s| {
        vec![
            Parameter::not_negative(
                "kh_n_m",
                "N/m",
                "stiffness of the hysteretic part",
                (1e-2 * s.stiffness_n_m(), 10.0 * s.stiffness_n_m()),
                0.2 * s.stiffness_n_m(),
            ),
            Parameter::positive(
                "dy_m",
                "m",
                "yield displacement",
                (1e-2 * s.displacement_m, s.displacement_m),
                0.2 * s.displacement_m,
            ),
            Parameter::positive("n", "1", "sharpness of the yield", (1.0, 10.0), 1.0)
                .optional(1.0)
                .at_most(100.0),
            // Only their sum over dy^n counts beside their ratio.
            Parameter::either("beta", "1", "loading shape, 1 - gamma when left out", 2.0, 0.5).optional(0.5),
            Parameter::either("gamma", "1", "unloading shape", 2.0, 0.5).optional(0.5),
        ]
    },
    install: |values, system| {
        let [kh, dy, n] = ["kh_n_m", "dy_m", "n"].map(|name| values.get(name));
        let gamma = values.get("gamma");
        let beta = values.spec().parameters.get("beta").copied().unwrap_or(1.0 - gamma);
        system.isolator_terms.push(Box::new(BoucWen {
            kh,
            inverse_dy: 1.0 / dy,
            n,
            beta,
            gamma,
            integer: n.fract() == 0.0,
        }));
        Ok(())
    },
};

struct BoucWen {
    kh: f64,
    inverse_dy: f64,
    n: f64,
    beta: f64,
    gamma: f64,
    /// An integer power needs no logarithm.
    integer: bool,
}

/// Steps for a yield displacement, and for the way of one sample at most; a sharp yield, within dy/n, takes more of both.
const STEPS: f64 = 10.0;
const MOST_STEPS: f64 = 64.0;
const SHARP: f64 = 5.0;
/// What is smaller is nearer by four terms of a series than by the function itself.
const SMALL: f64 = 1e-3;

impl BoucWen {
    /// dz/dd while moving with the sign of `v`.
    fn slope(&self, z: f64, v: f64) -> f64 {
        let reach = (z * self.inverse_dy).abs();
        let power = if self.integer { reach.powi(self.n as i32) } else { reach.powf(self.n) };
        1.0 - self.shape(z, v) * power
    }

    /// The same for n of 1.
    fn slope_of_one(&self, z: f64, v: f64) -> f64 {
        1.0 - self.shape(z, v) * (z * self.inverse_dy).abs()
    }

    fn shape(&self, z: f64, v: f64) -> f64 {
        if v * z >= 0.0 { self.beta + self.gamma } else { self.gamma - self.beta }
    }

    /// z after a way that does not turn: in closed form for n of 1, and by steps of Heun's, each a tenth of dy or of a sharp yield, what
    /// another n makes of it. The steps' errors have no edge there, where slopes along n begin.
    fn moved(&self, z: f64, way_m: f64) -> f64 {
        let sign = way_m.signum();
        let of_one = self.moved_in_closed_form(z * sign, way_m.abs()) * sign;
        if self.n == 1.0 {
            return of_one;
        }
        let sharper = (self.n / SHARP).max(1.0);
        let steps = (STEPS * sharper * way_m.abs() * self.inverse_dy).ceil().min(MOST_STEPS * sharper);
        let h = way_m / steps.max(1.0);
        let step = |z: f64, slope: &dyn Fn(f64) -> f64| {
            let first = slope(z);
            z + 0.5 * h * (first + slope(z + h * first))
        };
        let (mut by_steps, mut one_by_steps) = (z, z);
        for _ in 0..steps as usize {
            by_steps = step(by_steps, &|z| self.slope(z, h));
            one_by_steps = step(one_by_steps, &|z| self.slope_of_one(z, h));
        }
        let apart = by_steps - one_by_steps;
        if apart.is_finite() { of_one + apart } else { by_steps }
    }

    /// z along the way for n of 1: dz/ds = 1 + rate z, with one rate on the way back to none and another from there on.
    fn moved_in_closed_form(&self, mut z: f64, mut way_m: f64) -> f64 {
        if z < 0.0 {
            let back = (self.gamma - self.beta) * self.inverse_dy;
            // Where it is none, if it ever is.
            let none_m = -z / unwound(back * z);
            if none_m.is_nan() || none_m >= way_m {
                return z + way_m * wound(back * way_m) * (1.0 + back * z);
            }
            (z, way_m) = (0.0, way_m - none_m);
        }
        let on = -(self.beta + self.gamma) * self.inverse_dy;
        z + way_m * wound(on * way_m) * (1.0 + on * z)
    }
}

/// (e^x - 1) / x.
fn wound(x: f64) -> f64 {
    if x.abs() > SMALL { x.exp_m1() / x } else { 1.0 + x * (1.0 / 2.0 + x * (1.0 / 6.0 + x / 24.0)) }
}

/// x / ln(1 + x); not a number where there is none.
fn unwound(x: f64) -> f64 {
    if x.abs() > SMALL { x / x.ln_1p() } else { 1.0 + x * (1.0 / 2.0 - x * (1.0 / 12.0 - x / 24.0)) }
}

impl Term for BoucWen {
    fn states(&self) -> usize {
        1
    }

    fn turns(&self) -> bool {
        true
    }

    fn force(&self, at: &Point, state: &[f64], rate: &mut [f64]) -> f64 {
        rate[0] = at.velocity_m_s * self.slope(state[0], at.velocity_m_s);
        self.kh * state[0]
    }

    fn follow(&self, course: &Cubic, state: &mut [f64]) {
        // z depends on the way alone, out to where the motion turns and back.
        let turn = course.turns_at_m().unwrap_or(course.to.0);
        state[0] = self.moved(state[0], turn - course.from.0);
        state[0] = self.moved(state[0], course.to.0 - turn);
    }

    fn tangent_n_m(&self) -> f64 {
        self.kh
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn element(n: f64, (beta, gamma): (f64, f64)) -> BoucWen {
        BoucWen { kh: 1.0, inverse_dy: 1.0 / 2e-3, n, beta, gamma, integer: n.fract() == 0.0 }
    }

    #[test]
    fn the_closed_form_is_what_many_small_steps_come_to() {
        for shape in [(0.5, 0.5), (0.9, -0.4), (0.0, -1.0), (-0.3, 1.2), (0.75, 0.75), (0.5, 0.49)] {
            let closed = element(1.0, shape);
            for z in [-1.5e-3, -2e-6, 0.0, 1e-3] {
                for way_m in [-4e-3, -3e-7, 1e-12, 5e-4, 6e-3] {
                    let steps = 20_000;
                    let h = way_m / f64::from(steps);
                    let by_steps = (0..steps).fold(z, |z, _| {
                        let first = closed.slope(z, h);
                        z + 0.5 * h * (first + closed.slope(z + h * first, h))
                    });
                    let at_once = closed.moved(z, way_m);
                    assert!((at_once - by_steps).abs() < 1e-9, "{shape:?} {z} {way_m}: {at_once} {by_steps}");
                }
            }
        }
    }

    #[test]
    fn a_sharpness_next_to_one_does_next_to_the_same() {
        let z = |n: f64| [-3e-3, 2e-4, 5e-3].map(|way_m| element(n, (0.6, 0.4)).moved(1e-3, way_m));
        let slopes = |h: f64| {
            let (one, next) = (z(1.0), z(1.0 + h));
            [0, 1, 2].map(|i| (next[i] - one[i]) / h)
        };
        for (near, far) in slopes(1e-7).into_iter().zip(slopes(1e-4)) {
            assert!((near - far).abs() < 1e-3 * far.abs().max(1e-4), "{near} {far}");
        }
    }

    #[test]
    fn what_never_comes_back_to_none_stays_on_its_side() {
        // Loaded beyond what turns it: the slope along the way back is of the other sign.
        let element = element(1.0, (-0.5, 1.0));
        let z = element.moved(-2e-3, 1e-3);
        assert!(z < -2e-3 && z.is_finite(), "{z}");
        assert!(element.moved(1.9e-3, 1.0).is_finite());
    }
}
