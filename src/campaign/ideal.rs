//! Peaks of a model on an ideal table, fast enough to be evaluated ten thousand times: identification on
//! peaks, design maps and the trade-off call it.
//!
//! Nothing is evaluated but what may be a peak of the cycles that count.

use super::peaks::{Peaks, Resonance, peaks_of};
use crate::model::effects;
use crate::model::sweep::PEAK_CYCLES;
use crate::model::{ModelError, ModelSpec, Options, StepPeaks, steady_peaks};
use crate::sweep::{Direction, Schedule, Step, SweepSpec, Transition};

/// Sampling rates at which peaks are looked at, Hz: in closed form, where only samples beside a turn are
/// evaluated, and of the general solver, whose own steps decide.
const RATES_HZ: [f64; 2] = [4096.0, 256.0];

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
    /// Local error of the general solver.
    pub tolerance: f64,
    /// Cycles of a step at most.
    pub cycles: u32,
    /// Cycles at the end of a step from which its peaks are taken.
    pub counted: f64,
}

impl Default for Settings {
    fn default() -> Self {
        Self { tolerance: 1e-6, cycles: u32::MAX, counted: PEAK_CYCLES }
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
    let rate_hz = if effects::are_piecewise_linear(&model.effects) { RATES_HZ[0] } else { RATES_HZ[1] };
    let steps: Vec<Step> =
        steps.iter().map(|step| Step { cycles: step.cycles.min(settings.cycles), ..*step }).collect();
    let options = Options { tolerance: settings.tolerance };
    let peaks = steady_peaks(model, &steps, 1.0 / rate_hz, &options, settings.counted)?;
    let state = |(step, peaks): (&Step, &StepPeaks)| IdealStep {
        direction: step.direction,
        frequency_hz: step.frequency_hz,
        a_max_m_s2: peaks.a_max_m_s2,
        excursion_m: peaks.excursion_m().max(0.0),
    };
    Ok(steps.iter().zip(&peaks).map(state).collect())
}

/// Peaks of one direction.
pub fn peaks(states: &[IdealStep], direction: Direction, resonance: Resonance) -> Option<Peaks> {
    let there = states.iter().filter(|state| state.direction == direction);
    peaks_of(there.map(|state| (state.frequency_hz, (state.a_max_m_s2, state.excursion_m))), resonance)
}

/// Whether the largest acceleration and the largest excursion lie between the first and the last state.
pub fn peak_inside(states: &[IdealStep]) -> bool {
    let inside = |of: fn(&IdealStep) -> f64| {
        let largest = states.iter().enumerate().max_by(|a, b| of(a.1).total_cmp(&of(b.1)));
        largest.is_some_and(|(i, _)| i > 0 && i + 1 < states.len())
    };
    inside(|state| state.a_max_m_s2) && inside(|state| state.excursion_m)
}

/// Exponent of the weights of [`smooth_nu`].
const SHARPNESS: i32 = 64;

/// The pseudo-resonance between the steps of a sweep: their mean frequency weighted with a high power of the
/// response, which moves smoothly where the largest jumps from step to step.
pub fn smooth_nu(states: &[IdealStep], resonance: Resonance) -> f64 {
    let of = |state: &IdealStep| if resonance.by_acceleration { state.a_max_m_s2 } else { state.excursion_m };
    let largest = states.iter().map(of).fold(f64::MIN_POSITIVE, f64::max);
    let weigh = |(sum, weights): (f64, f64), state: &IdealStep| {
        let weight = (of(state) / largest).powi(SHARPNESS);
        (sum + weight * state.frequency_hz, weights + weight)
    };
    let (sum, weights) = states.iter().fold((0.0, 0.0), weigh);
    sum / weights / resonance.reference_hz
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::simulate_sweep;
    use crate::model::testing::effect;

    #[test]
    fn a_smooth_resonance_lies_between_the_steps_and_at_a_sharp_peak_on_one() {
        let state = |frequency_hz: f64, excursion_m: f64| IdealStep {
            direction: Direction::Forward,
            frequency_hz,
            a_max_m_s2: 1.0,
            excursion_m,
        };
        let resonance = Resonance { reference_hz: 2.0, by_acceleration: false };
        let twins = [state(1.0, 0.02), state(1.1, 0.03), state(1.2, 0.03), state(1.3, 0.02)];
        assert!((smooth_nu(&twins, resonance) - 0.575).abs() < 1e-9);
        let sharp = [state(1.0, 0.02), state(1.1, 0.03), state(1.2, 0.02)];
        assert!((smooth_nu(&sharp, resonance) - 0.55).abs() < 1e-9);
    }

    #[test]
    fn a_peak_lies_inside_when_both_responses_fall_to_either_side() {
        let state = |a_max_m_s2: f64, excursion_m: f64| IdealStep {
            direction: Direction::Forward,
            frequency_hz: 1.0,
            a_max_m_s2,
            excursion_m,
        };
        assert!(peak_inside(&[state(1.0, 0.01), state(2.0, 0.02), state(1.0, 0.01)]));
        assert!(!peak_inside(&[state(1.0, 0.01), state(2.0, 0.02), state(3.0, 0.01)]));
        assert!(!peak_inside(&[state(1.0, 0.03), state(2.0, 0.02), state(1.0, 0.01)]));
        assert!(!peak_inside(&[]));
    }

    #[test]
    fn peaks_alone_are_those_of_all_samples() {
        // The first goes through closed form, the others through the general solver.
        let added = [
            None,
            Some(effect("cubic-stiffness", &[("k3_n_m3", 1e6)])),
            Some(effect("bouc-wen-hysteresis", &[("kh_n_m", 5e3), ("dy_m", 3e-3)])),
            Some(effect("hertz-contact", &[("kh", 5e5), ("n", 1.3)])),
        ];
        for label in ["B0-0.05", "B1-G2-0.05", "B2-G1-0.05"] {
            for added in &added {
                let mut model = crate::model::paper::of_case(&label.parse().expect("case"));
                if model.bumper.is_none() && added.as_ref().is_some_and(|e| e.name == "hertz-contact") {
                    continue;
                }
                model.effects.extend(added.clone());
                let steps = steps_of(&SweepSpec::paper(), 0.05, (0.8, 3.0));
                let fine =
                    simulate_sweep(&model, &steps, 1.0 / 4096.0, &Options::default(), &mut |_, _, _, _| {});
                let fine: Vec<StepPeaks> = fine.expect("simulates").peaks;
                let alone = steady_states(&model, &steps, &Settings::default()).expect("simulates");
                for (fine, alone) in fine.iter().zip(&alone) {
                    let case = format!("{label} {added:?} {} Hz", alone.frequency_hz);
                    let apart = (alone.a_max_m_s2 / fine.a_max_m_s2 - 1.0).abs();
                    assert!(apart < 2e-3, "{case}: A {apart}");
                    let apart = (alone.excursion_m / fine.excursion_m() - 1.0).abs();
                    assert!(apart < 1e-3, "{case}: E {apart}");
                }
            }
        }
    }
}
