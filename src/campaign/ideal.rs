//! Peaks of a model on an ideal table, fast enough to be evaluated ten thousand times: identification on
//! peaks, design maps and the trade-off call it.
//!
//! The sweep is propagated with coarse samples (the propagator is exact between them), the peaks between
//! samples are taken from parabolas, and the paper's band-pass is applied where it is asked for.

use super::peaks::{Peaks, Resonance, peaks_of};
use crate::model::{ModelError, ModelSpec, Options, simulate_sweep};
use crate::signal::{BandPass, FilterBank};
use crate::sweep::{Direction, Schedule, Step, SweepSpec, Transition};

/// Cycles at the end of a step from which its peaks are taken.
const STEADY_CYCLES: f64 = crate::model::sweep::PEAK_CYCLES;

/// Steady state of one step: direction, frequency (Hz), A_max (m/s2), excursion (m).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct IdealStep {
    /// Sweep direction.
    pub direction: Direction,
    /// Frequency, Hz.
    pub frequency_hz: f64,
    /// Largest absolute acceleration, m/s2.
    pub a_max_m_s2: f64,
    /// Excursion, m.
    pub excursion_m: f64,
}

/// How the peaks of a model are computed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Settings {
    /// Sampling rate, Hz.
    pub sample_rate_hz: f64,
    /// Apply the band-pass of the measuring chain (0.16-30 Hz).
    pub band_pass: bool,
    /// Local error of the general solver.
    pub tolerance: f64,
}

impl Default for Settings {
    fn default() -> Self {
        Self { sample_rate_hz: 256.0, band_pass: false, tolerance: 1e-5 }
    }
}

/// Largest and smallest value of a signal, between its samples too.
#[derive(Clone, Copy, Debug)]
struct Extremes {
    before: f64,
    last: f64,
    seen: u8,
    low: f64,
    high: f64,
}

impl Extremes {
    const NONE: Self = Self { before: 0.0, last: 0.0, seen: 0, low: f64::INFINITY, high: f64::NEG_INFINITY };

    fn push(&mut self, value: f64) {
        self.low = self.low.min(value);
        self.high = self.high.max(value);
        if self.seen >= 2 {
            let turns = (self.last - self.before) * (value - self.last) < 0.0;
            if turns {
                // Vertex of the parabola through the last three samples.
                let (slope, bend) = (0.5 * (value - self.before), value - 2.0 * self.last + self.before);
                let vertex = self.last - 0.5 * slope * slope / bend;
                self.low = self.low.min(vertex);
                self.high = self.high.max(vertex);
            }
        }
        self.seen = (self.seen + 1).min(2);
        (self.before, self.last) = (self.last, value);
    }
}

/// Steps of a sweep joined at phase 0, those between two frequencies (Hz) only; none when there are none.
pub fn steps_of(sweep: &SweepSpec, acceleration_g: f64, range_hz: (f64, f64)) -> Vec<Step> {
    let ideal = SweepSpec { acceleration_g, transition: Transition::None, settling: None, ..sweep.clone() };
    let schedule = ideal.restricted(range_hz.0, range_hz.1).and_then(|sweep| Schedule::new(&sweep));
    schedule.map_or_else(|_| Vec::new(), |schedule| schedule.steps().to_vec())
}

/// Steady states of a model over the steps of an ideal sweep.
///
/// # Errors
/// [`ModelError`] as of [`crate::model::build`].
pub fn steady_states(
    model: &ModelSpec,
    steps: &[Step],
    settings: &Settings,
) -> Result<Vec<IdealStep>, ModelError> {
    let dt_s = 1.0 / settings.sample_rate_hz;
    let mut filter = FilterBank::<2>::new(BandPass::paper(settings.sample_rate_hz));
    let mut extremes = vec![(Extremes::NONE, Extremes::NONE); steps.len()];
    let mut ends = Vec::with_capacity(steps.len());
    let mut end_s = 0.0;
    for step in steps {
        end_s += f64::from(step.cycles) / step.frequency_hz;
        ends.push(end_s);
    }
    let options = Options { tolerance: settings.tolerance };
    simulate_sweep(model, steps, dt_s, &options, &mut |sample, index, _, response| {
        let (mut a, mut d) = (response.mass_acceleration_m_s2, response.relative_displacement_m);
        if settings.band_pass {
            [a, d] = filter.process(&[a, d]);
        }
        let time_s = sample as f64 * dt_s;
        if time_s >= ends[index] - STEADY_CYCLES / steps[index].frequency_hz {
            extremes[index].0.push(a);
            extremes[index].1.push(d);
        }
    })?;
    let state = |(step, (a, d)): (&Step, &(Extremes, Extremes))| IdealStep {
        direction: step.direction,
        frequency_hz: step.frequency_hz,
        a_max_m_s2: a.high.max(-a.low).max(0.0),
        excursion_m: (d.high - d.low).max(0.0),
    };
    Ok(steps.iter().zip(&extremes).map(state).collect())
}

/// Peaks of one direction.
pub fn peaks(states: &[IdealStep], direction: Direction, resonance: Resonance) -> Option<Peaks> {
    let there = states.iter().filter(|state| state.direction == direction);
    peaks_of(there.map(|state| (state.frequency_hz, (state.a_max_m_s2, state.excursion_m))), resonance)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::StepPeaks;

    #[test]
    fn coarse_samples_give_the_peaks_of_fine_ones() {
        for label in ["B0-0.05", "B1-G2-0.05", "B4-G1-0.05"] {
            let model = crate::model::paper::of_case(&label.parse().expect("case"));
            let steps = steps_of(&SweepSpec::paper(), 0.05, (0.8, 3.6));
            let fine =
                simulate_sweep(&model, &steps, 1.0 / 4096.0, &Options::default(), &mut |_, _, _, _| {});
            let fine: Vec<StepPeaks> = fine.expect("simulates").peaks;
            let coarse = steady_states(&model, &steps, &Settings::default()).expect("simulates");
            for (fine, coarse) in fine.iter().zip(&coarse) {
                // Between impacts of the stiffest bumper the motion after long dwells is chaotic at some
                // low frequencies; the bulk of the steps must agree closely.
                let apart = (coarse.a_max_m_s2 / fine.a_max_m_s2 - 1.0).abs();
                assert!(apart < 0.02, "{label} {} Hz: {apart}", coarse.frequency_hz);
                assert!(
                    (coarse.excursion_m / fine.excursion_m() - 1.0).abs() < 0.005,
                    "{label} {}",
                    coarse.frequency_hz
                );
            }
        }
    }
}
