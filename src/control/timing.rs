//! How well the control thread keeps time: histograms of wake-up latency, period error, step time and
//! every phase, and the count of slips. The control thread records, the run reports.

use hdrhistogram::Histogram;
use serde::{Deserialize, Serialize};

/// Longest time that the histograms resolve; longer ones count as this, ns.
const HIGHEST_NS: u64 = 60_000_000_000;
/// Significant decimal digits of the histograms.
const DIGITS: u8 = 3;

/// The phases of the control step, in their order.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
#[repr(u8)]
pub enum Phase {
    /// Between the deadline and the step: the scheduler's part.
    WakeUp,
    /// Letting a simulated rig follow; nothing with a real one.
    Simulate,
    /// Taking what the DAQ delivered.
    Acquire,
    /// Filters and demodulation.
    Condition,
    /// Onboard model.
    Predict,
    /// Detectors.
    Watch,
    /// Supervisor.
    Decide,
    /// Next command.
    Command,
    /// Rows and events into the rings.
    Publish,
}

impl Phase {
    /// All phases in order.
    pub const ALL: [Phase; 9] = [
        Phase::WakeUp,
        Phase::Simulate,
        Phase::Acquire,
        Phase::Condition,
        Phase::Predict,
        Phase::Watch,
        Phase::Decide,
        Phase::Command,
        Phase::Publish,
    ];

    /// Name as in events and reports.
    pub fn name(self) -> &'static str {
        match self {
            Phase::WakeUp => "wake-up",
            Phase::Simulate => "simulate",
            Phase::Acquire => "acquire",
            Phase::Condition => "condition",
            Phase::Predict => "predict",
            Phase::Watch => "watch",
            Phase::Decide => "decide",
            Phase::Command => "command",
            Phase::Publish => "publish",
        }
    }
}

/// Times of one control step, ns, by [`Phase`].
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct StepTimes {
    /// Time of each phase, ns; that of [`Phase::WakeUp`] is the latency.
    pub phase_ns: [u64; 9],
}

impl StepTimes {
    /// Adds to a phase.
    pub fn add(&mut self, phase: Phase, nanoseconds: u64) {
        self.phase_ns[phase as usize] += nanoseconds;
    }

    /// Time of the step itself, without the wake-up and the simulation of the rig, ns.
    pub fn step_ns(&self) -> u64 {
        self.phase_ns[2..].iter().sum()
    }

    /// The phase that took longest, the wake-up left out.
    pub fn longest(&self) -> Phase {
        let mut longest = Phase::Simulate;
        for phase in &Phase::ALL[1..] {
            if self.phase_ns[*phase as usize] > self.phase_ns[longest as usize] {
                longest = *phase;
            }
        }
        longest
    }
}

/// Histograms of a run; preallocated, recording neither allocates nor fails.
#[derive(Clone, Debug)]
pub struct Timing {
    latency: Histogram<u64>,
    period_error: Histogram<u64>,
    step: Histogram<u64>,
    phases: [Histogram<u64>; 9],
    cycles: u64,
    slips: u64,
    skipped_periods: u64,
}

impl Timing {
    /// Empty histograms.
    ///
    /// # Panics
    /// Never: the bounds are constants that the histogram accepts.
    pub fn new() -> Self {
        let empty = || {
            Histogram::new_with_bounds(1, HIGHEST_NS, DIGITS)
                .expect("constant bounds, 1 < high / 2 and at most 5 digits")
        };
        Self {
            latency: empty(),
            period_error: empty(),
            step: empty(),
            phases: std::array::from_fn(|_| empty()),
            cycles: 0,
            slips: 0,
            skipped_periods: 0,
        }
    }

    /// Counts a step, whether its times were recorded or not.
    pub fn pass(&mut self) {
        self.cycles += 1;
    }

    /// Records one step with its times and the deviation of its start from one period after the last
    /// start, ns. In virtual time there is neither latency nor period, only step times.
    pub fn record(&mut self, times: &StepTimes, period_error_ns: Option<u64>) {
        if let Some(error) = period_error_ns {
            self.latency.saturating_record(times.phase_ns[0]);
            self.period_error.saturating_record(error);
        }
        self.step.saturating_record(times.step_ns());
        for (histogram, &nanoseconds) in self.phases.iter_mut().zip(&times.phase_ns) {
            histogram.saturating_record(nanoseconds);
        }
    }

    /// Counts one slip of so many periods.
    pub fn slip(&mut self, periods: u64) {
        self.slips += 1;
        self.skipped_periods += periods;
    }

    /// Number of slips.
    pub fn slips(&self) -> u64 {
        self.slips
    }

    /// The report of the run.
    pub fn report(&self) -> TimingReport {
        TimingReport {
            cycles: self.cycles,
            slips: self.slips,
            skipped_periods: self.skipped_periods,
            latency_histogram: classes(&self.latency),
            wake_up_latency: percentiles(&self.latency),
            period_error: percentiles(&self.period_error),
            step: percentiles(&self.step),
            phases: Phase::ALL[1..]
                .iter()
                .map(|phase| PhaseTiming { phase: *phase, times: percentiles(&self.phases[*phase as usize]) })
                .collect(),
        }
    }
}

impl Default for Timing {
    fn default() -> Self {
        Self::new()
    }
}

/// Percentiles of a time, us.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Percentiles {
    /// Median, us.
    pub p50_us: f64,
    /// 99 %, us.
    pub p99_us: f64,
    /// 99.9 %, us.
    pub p999_us: f64,
    /// Largest, us.
    pub max_us: f64,
    /// Mean, us.
    pub mean_us: f64,
}

/// Percentiles of one phase.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct PhaseTiming {
    /// Which.
    pub phase: Phase,
    /// Its times.
    #[serde(flatten)]
    pub times: Percentiles,
}

/// Timing of a run as it stands in `run.toml` and in the JSON of `run`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct TimingReport {
    /// Control steps.
    pub cycles: u64,
    /// Times that the thread came a period or more too late.
    pub slips: u64,
    /// Periods skipped in all slips together.
    pub skipped_periods: u64,
    /// Histogram of the wake-up latency: upper end of each class (us, each twice the one before), count.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub latency_histogram: Vec<(f64, u64)>,
    /// From the deadline to the start of the step; zeros in virtual time.
    pub wake_up_latency: Percentiles,
    /// Deviation of the distance of two starts from the period; zeros in virtual time.
    pub period_error: Percentiles,
    /// The whole step.
    pub step: Percentiles,
    /// Each phase of the step.
    pub phases: Vec<PhaseTiming>,
}

/// Classes of a histogram of nanoseconds, from 1 us on, each twice as wide as the one before.
fn classes(histogram: &Histogram<u64>) -> Vec<(f64, u64)> {
    let class = |c: hdrhistogram::iterators::IterationValue<u64>| {
        (c.value_iterated_to() as f64 / 1e3, c.count_since_last_iteration())
    };
    histogram.iter_log(1000, 2.0).map(class).collect()
}

/// Percentiles of a histogram of nanoseconds.
pub fn percentiles(histogram: &Histogram<u64>) -> Percentiles {
    if histogram.is_empty() {
        return Percentiles::default();
    }
    let at = |quantile: f64| histogram.value_at_quantile(quantile) as f64 / 1e3;
    Percentiles {
        p50_us: at(0.5),
        p99_us: at(0.99),
        p999_us: at(0.999),
        max_us: histogram.max() as f64 / 1e3,
        mean_us: histogram.mean() / 1e3,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn percentiles_are_those_of_the_recorded_times() {
        let mut timing = Timing::new();
        for k in 1..=1000u64 {
            let mut times = StepTimes::default();
            times.add(Phase::WakeUp, 1000 * k);
            times.add(Phase::Predict, 500);
            times.add(Phase::Publish, 250);
            assert_eq!(times.longest(), Phase::Predict);
            timing.record(&times, Some(10 * k));
            timing.pass();
        }
        timing.slip(3);
        let report = timing.report();
        assert_eq!(report.latency_histogram.iter().map(|class| class.1).sum::<u64>(), 1000);
        assert!(report.latency_histogram.iter().all(|(us, n)| *us < 600.0 || *n > 0), "{report:?}");
        assert_eq!((report.cycles, report.slips, report.skipped_periods), (1000, 1, 3));
        assert!((report.wake_up_latency.p50_us - 500.0).abs() < 1.0);
        assert!((report.wake_up_latency.p999_us - 999.0).abs() < 2.0);
        assert!((report.step.p50_us - 0.75).abs() < 0.01);
        assert!((report.period_error.max_us - 10.0).abs() < 0.1);
    }
}
