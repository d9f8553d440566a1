//! What is known beforehand of what belongs to one step: its start, what drives it, the zero of A and the drift of the displacement
//! sensor. Called for every step that is laid against a model.

use super::Measured;
use crate::identify::least_squares::dot;
use crate::identify::motion::Window;
use crate::identify::problem::DRIFT_MEMORY;
use nalgebra::DMatrix;

/// The least deviation: what is known exactly, as the amplitude of what drives a mass that was only let go.
const KNOWN: f64 = 1e-100;

impl Measured<'_> {
    /// Prior deviations of a step's nuisances before the drift.
    pub(super) fn sigmas(&self, window: &Window) -> Vec<f64> {
        let motion = self.motion;
        let drive = &motion.drive_m_s2[window.range.clone()];
        let power = dot(drive, drive).max(1e-300);
        // Of the amplitude of a sine in white noise, relative; its phase is as uncertain.
        let amplitude = (window.wave_noise_m_s2 / power.sqrt()).hypot(motion.table_gain_sigma);
        let w = std::f64::consts::TAU * window.frequency_hz.max(1e-9);
        let offsets = self.offsets(window);
        let half_cycle = window.range.len() as f64 / offsets.max(1) as f64;
        // The displacement sensor's slow noise and gain are in the measured state.
        let last = window.range.start.max(1) - 1;
        let gain = 3.0 * self.gain_sigmas[0];
        // What was had from the acceleration alone lacks what is slow.
        let slow = if self.sees_displacement { [0.0; 2] } else { self.slow_start };
        let mut sigmas = vec![
            (3.0 * motion.displacement_noise_m)
                .hypot(self.drift_m)
                .hypot(gain * motion.displacement_m[last])
                .hypot(slow[0]),
            (3.0 * motion.velocity_noise_m_s).hypot(gain * motion.velocity_m_s[last]).hypot(slow[1]),
            amplitude,
            amplitude / w,
            // Frequency of a sine in white noise.
            3.0_f64.sqrt() * amplitude / w,
        ];
        sigmas.extend(vec![window.drive_noise_m_s2 / half_cycle.sqrt(); offsets]);
        sigmas.push(motion.restoring_noise_m_s2);
        sigmas
    }

    /// Prior precisions of a step's nuisances; those of the drift are correlated.
    pub(super) fn precision(&self, window: &Window) -> DMatrix<f64> {
        let sigmas = self.sigmas(window);
        let (first, knots) = (sigmas.len(), self.knots(window));
        let mut out = DMatrix::zeros(first + knots, first + knots);
        for (j, sigma) in sigmas.into_iter().enumerate() {
            out[(j, j)] = sigma.max(KNOWN).powi(-2);
        }
        // A first-order autoregression from knot to knot.
        let innovation = (1.0 - DRIFT_MEMORY * DRIFT_MEMORY) * self.drift_m.max(1e-300).powi(2);
        for j in first..first + knots {
            let ends = j == first || j + 1 == first + knots;
            out[(j, j)] = (1.0 + if ends { 0.0 } else { DRIFT_MEMORY * DRIFT_MEMORY }) / innovation;
            if j + 1 < first + knots {
                out[(j, j + 1)] = -DRIFT_MEMORY / innovation;
                out[(j + 1, j)] = -DRIFT_MEMORY / innovation;
            }
        }
        out
    }
}
