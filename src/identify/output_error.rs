//! Errors of a response in its own units, summed over samples.

use super::motion::Motion;

/// Noise-weighted errors of a simulated response.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct OutputError {
    /// Sum of squared errors of A, (m/s2)^2.
    pub sum_a: f64,
    /// Sum of squares of the measured A, (m/s2)^2.
    pub power_a: f64,
    /// Sum of squared errors of D, m^2.
    pub sum_d: f64,
    /// Sum of squares of the measured D about its mean, m^2.
    pub power_d: f64,
    /// Sum of squares of what the noise of an imposed motion makes of A, (m/s2)^2.
    pub carried_a: f64,
    /// Samples.
    pub count: usize,
}

impl OutputError {
    /// The sum of two.
    pub(crate) fn with(self, other: &Self) -> Self {
        Self {
            sum_a: self.sum_a + other.sum_a,
            power_a: self.power_a + other.power_a,
            sum_d: self.sum_d + other.sum_d,
            power_d: self.power_d + other.power_d,
            carried_a: self.carried_a + other.carried_a,
            count: self.count + other.count,
        }
    }

    /// Both errors are finite.
    pub fn is_finite(&self) -> bool {
        self.sum_a.is_finite() && self.sum_d.is_finite()
    }

    /// Normalised RMS error of A.
    pub fn nrmse_a(&self) -> f64 {
        (self.sum_a / self.power_a.max(1e-300)).sqrt()
    }

    /// Normalised RMS error of D.
    pub fn nrmse_d(&self) -> f64 {
        (self.sum_d / self.power_d.max(1e-300)).sqrt()
    }

    /// NRMSE that stands in reports: the mean square of A's and D's where both were measured.
    pub fn nrmse(&self) -> f64 {
        match (self.power_a > 0.0, self.power_d > 0.0) {
            (true, true) => (0.5 * (self.nrmse_a().powi(2) + self.nrmse_d().powi(2))).sqrt(),
            (false, true) => self.nrmse_d(),
            _ => self.nrmse_a(),
        }
    }

    /// The same of the instruments' noise alone, and of what the noise of an imposed motion makes of the force.
    pub fn noise_floor(&self, motion: &Motion) -> f64 {
        let count = self.count as f64;
        let noise = Self {
            sum_a: motion.restoring_noise_m_s2.powi(2) * count + self.carried_a,
            sum_d: motion.laser_noise_m.powi(2) * count,
            ..*self
        };
        noise.nrmse()
    }
}
