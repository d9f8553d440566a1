//! The band in which displacement and acceleration are laid side by side, and their noise in it.

use crate::signal::{Spectrum, TAPERED};
use realfft::num_complex::Complex64;

/// Power of a bin over that of the noise in it above which it is motion: of a hundred thousand bins of noise, one may be above the half of it.
const ABOVE_NOISE: f64 = 24.0;

/// The band in which the relation is tested, and the samples far enough from the ends.
pub(super) struct Band {
    low_rad_s: f64,
    high_rad_s: f64,
    interior: std::ops::Range<usize>,
    stride: usize,
    /// How many thinned samples count as one independent one: noise has passed the band alone.
    pub(super) colour: f64,
    laser_noise_m: f64,
    acceleration_noise_m_s2: f64,
}

impl Band {
    /// From half the frequency below which 1 % of the motion lies to where the laser's noise
    /// reaches the motion.
    pub(super) fn of(laser: &Spectrum, laser_noise_m: f64, acceleration_noise_m_s2: f64) -> Option<Self> {
        let power: Vec<f64> = laser.bins.iter().map(|z| z.norm_sqr()).collect();
        let first = laser.band(0.0, 1e300).start + 2;
        let floor = ABOVE_NOISE * laser.samples() as f64 * TAPERED * laser_noise_m * laser_noise_m;
        let total: f64 = power.get(first..)?.iter().filter(|p| **p > floor).sum();
        let mut sum = 0.0;
        let mut low = None;
        let mut high = first;
        for (bin, p) in power.iter().enumerate().skip(first).filter(|(_, p)| **p > floor) {
            sum += p;
            if low.is_none() && sum > 0.01 * total {
                low = Some(bin);
            }
            if sum < 0.9999 * total {
                high = bin;
            }
        }
        let low_rad_s = 0.5 * laser.omega_rad_s(low?);
        let high_rad_s = (1.5 * laser.omega_rad_s(high)).max(4.0 * low_rad_s);
        let edge = (8.0 / low_rad_s * laser.sample_rate_hz()) as usize;
        let samples = laser.samples();
        if samples < 3 * edge {
            return None;
        }
        let stride = ((laser.sample_rate_hz() * std::f64::consts::PI / (2.0 * high_rad_s)) as usize).max(1);
        let nyquist_rad_s = std::f64::consts::PI * laser.sample_rate_hz() / stride as f64;
        Some(Self {
            low_rad_s,
            high_rad_s,
            colour: (nyquist_rad_s / (high_rad_s - low_rad_s)).max(1.0),
            interior: edge..samples - edge,
            stride,
            laser_noise_m,
            acceleration_noise_m_s2,
        })
    }

    /// High-pass of fourth order (it swallows a double integration) and low-pass, times what makes
    /// the noise of the relation white with unit variance a sample: 1/m.
    fn gain(&self, w: f64) -> f64 {
        let h = (w / self.low_rad_s).powi(4);
        let density = self.laser_noise_m.powi(2) + (self.acceleration_noise_m_s2 / (w * w)).powi(2);
        h / (1.0 + h) / (1.0 + (w / self.high_rad_s).powi(8)) / density.sqrt().max(1e-12)
    }

    /// A channel filtered by the band times a factor, thinned to the interior.
    pub(super) fn series(&self, spectrum: &Spectrum, factor: impl Fn(f64) -> Complex64) -> Vec<f64> {
        let filtered = spectrum
            .clone()
            .multiply(|w| if w > 0.0 { factor(w) * self.gain(w) } else { Complex64::ZERO })
            .channel();
        filtered[self.interior.clone()].iter().step_by(self.stride).copied().collect()
    }

    /// What the noise of laser and accelerometers leaves in the filtered relation, rms.
    pub(super) fn expected_rms(&self, laser: &Spectrum) -> f64 {
        let power = |bin: usize| {
            let w = laser.omega_rad_s(bin);
            let density = self.laser_noise_m.powi(2) + (self.acceleration_noise_m_s2 / (w * w)).powi(2);
            self.gain(w).powi(2) * density
        };
        ((1..laser.bins.len()).map(power).sum::<f64>() / laser.bins.len() as f64).sqrt()
    }
}
