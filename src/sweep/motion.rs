//! Table motion `x = -g(t) sin(phi(t))` with its first three derivatives in closed form.
//!
//! Every segment of a sweep is of this shape: in a step g is the amplitude X, in a ramp X times a
//! smooth rise, in a transition A_G/w(t)^2. One formula serves the generator and the preview.

use std::f64::consts::TAU;

/// Commanded motion of the table at one instant.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Motion {
    /// Displacement, m.
    pub displacement_m: f64,
    /// Velocity, m/s.
    pub velocity_m_s: f64,
    /// Acceleration, m/s2.
    pub acceleration_m_s2: f64,
    /// Jerk, m/s3.
    pub jerk_m_s3: f64,
}

/// A function of time and its first three derivatives.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Jet(pub [f64; 4]);

/// Smooth step `S = 10 u^3 - 15 u^4 + 6 u^5` with its first three derivatives with respect to u; first and
/// second derivative vanish at both ends.
pub(super) fn smooth_step(u: f64) -> Jet {
    let v = 1.0 - u;
    Jet([
        u * u * u * (10.0 + u * (6.0 * u - 15.0)),
        30.0 * u * u * v * v,
        60.0 * u * v * (1.0 - 2.0 * u),
        60.0 * (1.0 - 6.0 * u * v),
    ])
}

/// Integral of [`smooth_step`] from 0 to u: `2.5 u^4 - 3 u^5 + u^6`.
fn smooth_step_integral(u: f64) -> f64 {
    u * u * u * u * (2.5 + u * (u - 3.0))
}

/// Motion in a step: amplitude X = A_G/w^2, constant angular frequency w (rad/s), phase (rad).
pub(super) fn steady(acceleration_amplitude_m_s2: f64, angular_rad_s: f64, phase_rad: f64) -> Motion {
    let (sin, cos) = phase_rad.sin_cos();
    let a = acceleration_amplitude_m_s2;
    Motion {
        displacement_m: -a / (angular_rad_s * angular_rad_s) * sin,
        velocity_m_s: -a / angular_rad_s * cos,
        acceleration_m_s2: a * sin,
        jerk_m_s3: a * angular_rad_s * cos,
    }
}

/// Motion and phase (rad) in a ramp of `duration_s` at time `t_s` in it: from rest to the steady sine
/// (`rising`), or mirrored.
pub(super) fn ramp(
    acceleration_amplitude_m_s2: f64,
    angular_rad_s: f64,
    duration_s: f64,
    t_s: f64,
    rising: bool,
) -> (Motion, f64) {
    let u = (t_s / duration_s).clamp(0.0, 1.0);
    let sign = if rising { 1.0 } else { -1.0 };
    let s = smooth_step(if rising { u } else { 1.0 - u }).0;
    let x = acceleration_amplitude_m_s2 / (angular_rad_s * angular_rad_s);
    let r = 1.0 / duration_s;
    let envelope = Jet([x * s[0], sign * x * s[1] * r, x * s[2] * r * r, sign * x * s[3] * r * r * r]);
    let phase_rad = angular_rad_s * t_s;
    (product(envelope, Jet([phase_rad, angular_rad_s, 0.0, 0.0])), phase_rad)
}

/// Change of frequency between two steps over N whole cycles: `w = w_k + dw S(t/T)`,
/// `phi = w_k t + dw T I(t/T)`, amplitude A_G/w^2, `T = 2 N/(f_k + f_k+1)` so that phi(T) = 2 pi N.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Glide {
    from_rad_s: f64,
    change_rad_s: f64,
    acceleration_amplitude_m_s2: f64,
    /// Duration T, s.
    pub duration_s: f64,
}

impl Glide {
    /// From one frequency (Hz) to the next (Hz) over whole cycles at constant A_G (m/s2).
    pub fn new(from_hz: f64, to_hz: f64, cycles: u32, acceleration_amplitude_m_s2: f64) -> Self {
        Self {
            from_rad_s: TAU * from_hz,
            change_rad_s: TAU * (to_hz - from_hz),
            acceleration_amplitude_m_s2,
            duration_s: 2.0 * f64::from(cycles) / (from_hz + to_hz),
        }
    }

    /// Motion, phase (rad) and angular frequency (rad/s) at time `t_s` in the transition.
    pub fn at(&self, t_s: f64) -> (Motion, f64, f64) {
        let u = (t_s / self.duration_s).clamp(0.0, 1.0);
        let s = smooth_step(u).0;
        let r = 1.0 / self.duration_s;
        let w = self.from_rad_s + self.change_rad_s * s[0];
        let w1 = self.change_rad_s * s[1] * r;
        let w2 = self.change_rad_s * s[2] * r * r;
        let w3 = self.change_rad_s * s[3] * r * r * r;
        let phase_rad = self.from_rad_s * t_s + self.change_rad_s * self.duration_s * smooth_step_integral(u);
        let a = self.acceleration_amplitude_m_s2;
        let q = 1.0 / w;
        let g = a * q * q;
        let envelope = Jet([
            g,
            -2.0 * g * q * w1,
            g * q * (6.0 * q * w1 * w1 - 2.0 * w2),
            g * q * (18.0 * q * w1 * w2 - 2.0 * w3 - 24.0 * q * q * w1 * w1 * w1),
        ]);
        (product(envelope, Jet([phase_rad, w, w1, w2])), phase_rad, w)
    }
}

/// `x = -g sin(phi)` and its derivatives by Leibniz' rule, from the jets of g and phi.
fn product(g: Jet, phi: Jet) -> Motion {
    let [g0, g1, g2, g3] = g.0;
    let [p0, p1, p2, p3] = phi.0;
    let (s, c) = p0.sin_cos();
    let s1 = p1 * c;
    let s2 = p2 * c - p1 * p1 * s;
    let s3 = p3 * c - 3.0 * p1 * p2 * s - p1 * p1 * p1 * c;
    Motion {
        displacement_m: -(g0 * s),
        velocity_m_s: -(g1 * s + g0 * s1),
        acceleration_m_s2: -(g2 * s + 2.0 * g1 * s1 + g0 * s2),
        jerk_m_s3: -(g3 * s + 3.0 * g2 * s1 + 3.0 * g1 * s2 + g0 * s3),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Velocity and acceleration in a transition in the explicit form that follows from inserting
    /// g = A_G/w^2: an independent writing of the same formula.
    #[test]
    fn a_transition_matches_its_explicit_form() {
        let (a, f0, f1) = (0.49, 0.5, 0.6);
        let glide = Glide::new(f0, f1, 1, a);
        for i in 0..=100 {
            let t = glide.duration_s * f64::from(i) / 100.0;
            let (motion, phi, w) = glide.at(t);
            let r = 1.0 / glide.duration_s;
            let [_, s1, s2, _] = smooth_step(t * r).0;
            let (w1, w2) = (TAU * (f1 - f0) * s1 * r, TAU * (f1 - f0) * s2 * r * r);
            let v = -(a / w) * phi.cos() + 2.0 * a * w1 / w.powi(3) * phi.sin();
            let acc = a
                * (phi.sin() * (1.0 + 2.0 * w2 / w.powi(3) - 6.0 * w1 * w1 / w.powi(4))
                    + 3.0 * w1 / (w * w) * phi.cos());
            assert!((motion.velocity_m_s - v).abs() < 1e-14);
            assert!((motion.acceleration_m_s2 - acc).abs() < 1e-14);
        }
        assert!((glide.at(glide.duration_s).1 - TAU).abs() < 1e-12);
    }

    /// Each derivative against a central difference of the one below it.
    #[test]
    fn derivatives_agree_with_differences() {
        let glide = Glide::new(1.0, 0.7, 2, 0.5);
        let h = 1e-5;
        let check = |motion: &dyn Fn(f64) -> Motion, t: f64| {
            let (lo, mid, hi) = (motion(t - h), motion(t), motion(t + h));
            let slope = |f: fn(&Motion) -> f64| (f(&hi) - f(&lo)) / (2.0 * h);
            assert!((slope(|m| m.displacement_m) - mid.velocity_m_s).abs() < 1e-8);
            assert!((slope(|m| m.velocity_m_s) - mid.acceleration_m_s2).abs() < 1e-8);
            assert!((slope(|m| m.acceleration_m_s2) - mid.jerk_m_s3).abs() < 1e-7);
        };
        for i in 1..40 {
            let u = f64::from(i) / 40.0;
            check(&|t| glide.at(t).0, u * glide.duration_s);
            check(&|t| ramp(0.5, TAU * 0.5, 4.0, t, true).0, u * 4.0);
            check(&|t| ramp(0.5, TAU * 0.5, 4.0, t, false).0, u * 4.0);
            check(&|t| steady(0.5, TAU * 1.3, TAU * 1.3 * t), u);
        }
    }
}
