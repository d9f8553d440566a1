//! The signal chain on the control thread: the same band-pass on measurement and onboard model, the
//! steady-state peaks of each step, the running difference of the two. Called by the control step with
//! every sample; the same chain serves replay, so that a record gives the same numbers again.

use super::event::{Nrmse, StepSummary};
use crate::model::Response;
use crate::signal::{BandPass, CyclePlace, FilterBank, STEADY_CYCLES, StepAnalyzer, StepResult};
use crate::stream::Channels;
use crate::sweep::{CommandPoint, Schedule, Settling, Step};

/// Memory of the live error, s.
const LIVE_MEMORY_S: f64 = 2.0;

/// One sample after the band-pass.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Conditioned {
    /// Mean acceleration of the mass A, m/s2.
    pub mass_acceleration_m_s2: f64,
    /// Relative displacement D, m.
    pub relative_displacement_m: f64,
    /// Acceleration of the table, m/s2.
    pub table_acceleration_m_s2: f64,
}

/// Channels of the step statistics: measured A and D, table acceleration, modelled A and D.
const CHANNELS: usize = 5;
const D: usize = 1;

/// Filters, statistics of the present step, live error.
pub struct Chain {
    measured: FilterBank<3>,
    model: FilterBank<2>,
    analyzer: StepAnalyzer<CHANNELS>,
    steps: Vec<Step>,
    settling: Option<Settling>,
    step_a: Difference,
    step_d: Difference,
    whole_a: Difference,
    whole_d: Difference,
    live_a: Forgetting,
    live_d: Forgetting,
}

impl Chain {
    /// Filters at rest, for a schedule.
    pub fn new(sample_rate_hz: f64, schedule: &Schedule) -> Self {
        let filter = BandPass::paper(sample_rate_hz);
        Self {
            measured: FilterBank::new(filter),
            model: FilterBank::new(filter),
            analyzer: StepAnalyzer::new(STEADY_CYCLES),
            steps: schedule.steps().to_vec(),
            settling: schedule.settling(),
            step_a: Difference::default(),
            step_d: Difference::default(),
            whole_a: Difference::default(),
            whole_d: Difference::default(),
            live_a: Forgetting::new(LIVE_MEMORY_S * sample_rate_hz),
            live_d: Forgetting::new(LIVE_MEMORY_S * sample_rate_hz),
        }
    }

    /// Filters one sample.
    pub fn condition(&mut self, channels: &Channels) -> Conditioned {
        let [mass, displacement, table] = self.measured.process(&[
            channels.mass_acceleration_m_s2(),
            channels.relative_displacement_m,
            channels.table_acceleration_m_s2,
        ]);
        Conditioned {
            mass_acceleration_m_s2: mass,
            relative_displacement_m: displacement,
            table_acceleration_m_s2: table,
        }
    }

    /// Compares one sample with the onboard model; gives the result of a step that has just ended.
    pub fn compare(
        &mut self,
        reference: &CommandPoint,
        measured: &Conditioned,
        response: &Response,
    ) -> Option<StepSummary> {
        let (a, d) = (measured.mass_acceleration_m_s2, measured.relative_displacement_m);
        let [model_a, model_d] =
            self.model.process(&[response.mass_acceleration_m_s2, response.relative_displacement_m]);
        self.live_a.add(a, model_a);
        self.live_d.add(d, model_d);
        let values = [a, d, measured.table_acceleration_m_s2, model_a, model_d];
        let ended = self.analyzer.push(CyclePlace::of(reference), &values);
        let summary = ended.and_then(|result| self.summary(&result));
        if reference.phase.is_some_and(|phase| phase.counted) {
            self.step_a.add(a, model_a);
            self.step_d.add(d, model_d);
            self.whole_a.add(a, model_a);
            self.whole_d.add(d, model_d);
        }
        summary
    }

    /// Index of the step in which the response has become steady, if the schedule waits for that.
    pub fn settled(&self, reference: &CommandPoint) -> Option<u32> {
        let settling = self.settling?;
        let phase = reference.phase.filter(|phase| !phase.counted)?;
        (self.analyzer.change(D)? <= settling.tolerance).then_some(phase.index)
    }

    /// How far the onboard model is off over all counted cycles so far.
    pub fn error(&self) -> Nrmse {
        Nrmse { nrmse_a: self.whole_a.nrmse(), nrmse_d: self.whole_d.nrmse() }
    }

    /// How far the onboard model is off at the moment.
    pub fn live_error(&self) -> Nrmse {
        Nrmse { nrmse_a: self.live_a.nrmse(), nrmse_d: self.live_d.nrmse() }
    }

    /// Closes the sums of a step.
    fn summary(&mut self, result: &StepResult<CHANNELS>) -> Option<StepSummary> {
        let (a, d) = (std::mem::take(&mut self.step_a), std::mem::take(&mut self.step_d));
        let step = self.steps.get(result.index as usize)?;
        let [mass, displacement, table, model_mass, model_displacement] = &result.channels;
        Some(StepSummary {
            index: result.index,
            direction: step.direction.into(),
            frequency_hz: step.frequency_hz,
            a_max_m_s2: mass.peak(),
            excursion_m: displacement.excursion(),
            model_a_max_m_s2: model_mass.peak(),
            model_excursion_m: model_displacement.excursion(),
            nrmse_a: a.nrmse(),
            nrmse_d: d.nrmse(),
            table_amplitude_ratio: table.harmonics[0].amplitude / step.acceleration_amplitude_m_s2,
            table_acceleration: table.harmonics,
            mass_acceleration: mass.harmonics,
            relative_displacement: displacement.harmonics,
        })
    }
}

/// Sums for a normalised root-mean-square error: root of the mean square difference over the standard
/// deviation of what was measured.
#[derive(Clone, Copy, Debug, Default)]
struct Difference {
    count: f64,
    sum: f64,
    square: f64,
    error: f64,
}

impl Difference {
    fn add(&mut self, measured: f64, model: f64) {
        self.count += 1.0;
        self.sum += measured;
        self.square += measured * measured;
        self.error += (measured - model) * (measured - model);
    }

    fn nrmse(&self) -> f64 {
        let variance = self.square - self.sum * self.sum / self.count.max(1.0);
        if variance > 0.0 { (self.error / variance).sqrt() } else { 0.0 }
    }
}

/// The same with exponential forgetting; band-passed signals have no mean.
#[derive(Clone, Copy, Debug)]
struct Forgetting {
    share: f64,
    square: f64,
    error: f64,
}

impl Forgetting {
    fn new(samples: f64) -> Self {
        Self { share: 1.0 / samples.max(1.0), square: 0.0, error: 0.0 }
    }

    fn add(&mut self, measured: f64, model: f64) {
        let difference = measured - model;
        self.square += self.share * (measured * measured - self.square);
        self.error += self.share * (difference * difference - self.error);
    }

    fn nrmse(&self) -> f64 {
        if self.square > 0.0 { (self.error / self.square).sqrt() } else { 0.0 }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sweep::{Generator, SweepSpec};

    fn response(d: f64, a: f64) -> Response {
        Response { relative_displacement_m: d, mass_acceleration_m_s2: a, ..Response::default() }
    }

    #[test]
    fn a_step_gives_its_steady_peaks_and_the_models_error() {
        let spec = SweepSpec::paper().restricted(1.9, 2.1).expect("in range");
        let schedule = Schedule::new(&spec).expect("a schedule");
        let mut generator = Generator::new(&schedule, 2048.0);
        let mut chain = Chain::new(2048.0, &schedule);
        let mut steps = Vec::new();
        while !generator.is_done() {
            let point = generator.next_point();
            let a = point.command.acceleration_m_s2;
            let channels = Channels {
                table_acceleration_m_s2: a,
                mass_acceleration_1_m_s2: 2.0 * a + 0.3,
                mass_acceleration_2_m_s2: 2.0 * a - 0.3,
                relative_displacement_m: 0.01 * a,
                ..Channels::default()
            };
            let measured = chain.condition(&channels);
            steps.extend(chain.compare(&point, &measured, &response(0.01 * a, 1.9 * a)));
        }
        assert_eq!(steps.len(), schedule.steps().len());
        let amplitude = spec.acceleration_m_s2();
        for step in &steps {
            // The band-pass passes 2 Hz within 1 %.
            assert!((step.a_max_m_s2 / (2.0 * amplitude) - 1.0).abs() < 0.01, "{step:?}");
            assert!((step.excursion_m / (0.02 * amplitude) - 1.0).abs() < 0.01, "{step:?}");
            assert!((step.nrmse_a - 0.05).abs() < 1e-3, "{step:?}");
            assert!(step.nrmse_d < 1e-6, "{step:?}");
            assert!((step.table_amplitude_ratio - 1.0).abs() < 0.01, "{step:?}");
        }
    }
}
