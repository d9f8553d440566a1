//! All detectors together: shows them every sample and every period, judges their indicators, and says
//! what was found. Called by the control step; O(1) a sample, nothing allocates after construction.

use super::action::Action;
use super::context::{Conditioner, Context};
use super::detect::{
    accelerometers_disagree::AccelerometersDisagree, control_slips::ControlSlips,
    device_status::DeviceStatus, following_error::FollowingError, frozen_sensor::FrozenSensor,
    mass_acceleration, mass_oscillations::MassOscillations, model_divergence::ModelDivergence, not_a_number,
    operator_link, out_of_range, recorder_behind, relative_displacement::RelativeDisplacement,
    repeated_sample::RepeatedSample, sensor_plausibility::SensorPlausibility, sequence_gap::SequenceGap,
    stale_sample::StaleSample, table_acceleration::TableAcceleration, table_distortion::TableDistortion,
    table_fundamental::TableFundamental, table_peak_error::TablePeakError,
};
use super::judge::{Estimate, Judge, Level, Reading};
use super::observation::{Observation, Period, Setup};
use super::spec::{Detection, DetectorId, SafetySpec};

/// Number of detectors.
const COUNT: usize = DetectorId::ALL.len();

/// Some of the detectors.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct DetectorSet(u32);

impl DetectorSet {
    /// Whether the set holds a detector.
    pub fn has(self, id: DetectorId) -> bool {
        self.0 >> id as u32 & 1 != 0
    }

    /// Whether it holds none.
    pub fn is_empty(self) -> bool {
        self.0 == 0
    }

    /// The detectors, in their order.
    pub fn iter(self) -> impl Iterator<Item = DetectorId> {
        DetectorId::ALL.into_iter().filter(move |id| self.has(*id))
    }

    pub(super) fn with(self, id: DetectorId, on: bool) -> Self {
        Self(self.0 & !(1 << id as u32) | u32::from(on) << id as u32)
    }
}

/// What the detectors say at the moment.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Findings {
    /// The highest action asked for.
    pub action: Action,
    /// The detector that tripped first with a latching action, until it is reset: the first-out cause. Of
    /// several in one sample, the one with the highest action, then the first in order.
    pub first: Option<DetectorId>,
    /// Trips that are in force: their condition is there, or it was and waits for a reset.
    pub tripped: DetectorSet,
    /// Trips whose condition is there now.
    pub present: DetectorSet,
    /// Warnings.
    pub warned: DetectorSet,
}

/// All detectors.
pub struct Watch {
    detection: Detection,
    actions: [Action; COUNT],
    warns: [f64; COUNT],
    judges: [Judge; COUNT],
    conditioner: Conditioner,
    detectors: Detectors,
    findings: Findings,
}

struct Detectors {
    device_status: DeviceStatus,
    table_acceleration: TableAcceleration,
    relative_displacement: RelativeDisplacement,
    following_error: FollowingError,
    table_fundamental: TableFundamental,
    table_distortion: TableDistortion,
    table_peak_error: TablePeakError,
    mass_oscillations: MassOscillations,
    frozen_sensor: FrozenSensor,
    accelerometers_disagree: AccelerometersDisagree,
    sensor_plausibility: SensorPlausibility,
    model_divergence: ModelDivergence,
    stale_sample: StaleSample,
    repeated_sample: RepeatedSample,
    sequence_gap: SequenceGap,
    control_slips: ControlSlips,
}

impl Detectors {
    fn new(spec: &SafetySpec, setup: &Setup) -> Self {
        let (rate_hz, detection) = (setup.sample_rate_hz, &spec.detection);
        Self {
            device_status: DeviceStatus::default(),
            table_acceleration: TableAcceleration::new(rate_hz),
            relative_displacement: RelativeDisplacement::new(setup, detection),
            following_error: FollowingError::new(detection, &spec.following_error),
            table_fundamental: TableFundamental::default(),
            table_distortion: TableDistortion::new(rate_hz),
            table_peak_error: TablePeakError::new(rate_hz),
            mass_oscillations: MassOscillations::new(setup, detection),
            frozen_sensor: FrozenSensor::default(),
            accelerometers_disagree: AccelerometersDisagree::new(rate_hz, detection),
            sensor_plausibility: SensorPlausibility::new(rate_hz, detection),
            model_divergence: ModelDivergence::new(rate_hz, detection),
            stale_sample: StaleSample::default(),
            repeated_sample: RepeatedSample::new(rate_hz),
            sequence_gap: SequenceGap::new(rate_hz),
            control_slips: ControlSlips::new(rate_hz),
        }
    }
}

impl Watch {
    /// All detectors at rest.
    pub fn new(spec: &SafetySpec, setup: &Setup) -> Self {
        Self {
            detection: spec.detection.clone(),
            actions: DetectorId::ALL.map(|id| spec.row(id).action),
            warns: DetectorId::ALL.map(|id| spec.row(id).warn.unwrap_or(spec.row(id).trip)),
            judges: DetectorId::ALL.map(|id| Judge::new(spec.row(id))),
            conditioner: Conditioner::new(setup, spec.detection.acceleration_floor_m_s2),
            detectors: Detectors::new(spec, setup),
            findings: Findings::default(),
        }
    }

    /// Shows one sample to the detectors.
    pub fn observe(&mut self, observation: &Observation) -> Findings {
        use DetectorId as Id;
        let c = self.conditioner.prepare(observation);
        let before = self.findings.first;
        let status = self.detectors.device_status.sample(c.sample.status);
        self.judge(Id::DeviceStatus, status);
        self.judge(Id::NotANumber, not_a_number::estimate(&c));
        let repeated = self.detectors.repeated_sample.estimate(&c);
        self.judge(Id::RepeatedSample, repeated);
        let missing = self.detectors.sequence_gap.estimate(&c);
        self.judge(Id::SequenceGap, missing);
        self.judge_limits(&c);
        // An old sample says nothing new about the motion.
        if !c.repeated {
            self.judge_table(&c);
            self.judge_instruments(&c);
        }
        self.settle_first(before);
        self.findings
    }

    fn judge_limits(&mut self, c: &Context) {
        use DetectorId as Id;
        self.judge(Id::OutOfRange, out_of_range::estimate(c, &self.detection));
        self.judge(Id::MassAcceleration, mass_acceleration::estimate(c));
        let estimate = self.detectors.table_acceleration.estimate(c);
        self.judge(Id::TableAcceleration, estimate);
        let estimate = self.detectors.relative_displacement.estimate(c);
        self.judge(Id::RelativeDisplacement, estimate);
    }

    fn judge_table(&mut self, c: &Context) {
        use DetectorId as Id;
        let d = &mut self.detectors;
        let estimates = [
            (Id::FollowingError, d.following_error.estimate(c)),
            (Id::TableFundamental, d.table_fundamental.estimate(c)),
            (Id::TableDistortion, d.table_distortion.estimate(c)),
            (Id::TablePeakError, d.table_peak_error.estimate(c)),
            (Id::MassOscillations, d.mass_oscillations.estimate(c)),
        ];
        estimates.into_iter().for_each(|(id, estimate)| self.judge(id, estimate));
    }

    fn judge_instruments(&mut self, c: &Context) {
        use DetectorId as Id;
        let d = &mut self.detectors;
        let estimates = [
            (Id::FrozenSensor, d.frozen_sensor.estimate(c)),
            (Id::AccelerometersDisagree, d.accelerometers_disagree.estimate(c)),
            (Id::SensorPlausibility, d.sensor_plausibility.estimate(c)),
            (Id::ModelDivergence, d.model_divergence.estimate(c)),
        ];
        estimates.into_iter().for_each(|(id, estimate)| self.judge(id, estimate));
    }

    /// Tells the detectors that a control period is over, with or without samples.
    pub fn period(&mut self, period: &Period) -> Findings {
        use DetectorId as Id;
        let before = self.findings.first;
        let d = &mut self.detectors;
        let estimates = [
            (Id::DeviceStatus, d.device_status.period(period.rig_fault)),
            (Id::StaleSample, d.stale_sample.estimate(period)),
            (Id::ControlSlips, d.control_slips.estimate(period)),
            (Id::RecorderBehind, recorder_behind::estimate(period)),
            (Id::OperatorLink, operator_link::estimate(period)),
        ];
        estimates.into_iter().for_each(|(id, estimate)| self.judge(id, estimate));
        self.settle_first(before);
        self.findings
    }

    /// What the detectors say at the moment.
    pub fn findings(&self) -> Findings {
        self.findings
    }

    /// State of one detector.
    pub fn reading(&self, id: DetectorId) -> &Reading {
        self.judges[id as usize].reading()
    }

    /// Those of a set whose action latches.
    pub fn latching(&self, set: DetectorSet) -> DetectorSet {
        let latches = |id: &DetectorId| self.actions[*id as usize].latches();
        set.iter().filter(latches).fold(DetectorSet::default(), |set, id| set.with(id, true))
    }

    /// Smallest threshold of a detector.
    pub fn threshold(&self, id: DetectorId) -> f64 {
        self.warns[id as usize]
    }

    /// Forgets trips whose condition is gone. Returns whether nothing is left that keeps the table from
    /// running.
    pub fn reset(&mut self) -> bool {
        let mut clear = true;
        for id in DetectorId::ALL {
            clear &= self.judges[id as usize].reset() || !self.actions[id as usize].latches();
        }
        if clear {
            self.findings.first = None;
        }
        DetectorId::ALL.into_iter().for_each(|id| self.find(id));
        clear
    }

    /// Forgets the high-water marks.
    pub fn reset_high_water(&mut self) {
        self.judges.iter_mut().for_each(Judge::reset_high_water);
    }

    fn judge(&mut self, id: DetectorId, estimate: Estimate) {
        if self.judges[id as usize].judge(estimate) {
            self.find(id);
        }
    }

    /// Takes a changed finding over into the sets, and finds the highest action anew.
    fn find(&mut self, id: DetectorId) {
        let judge = &self.judges[id as usize];
        let level = judge.reading().level;
        let findings = &mut self.findings;
        findings.tripped = findings.tripped.with(id, judge.tripped());
        findings.present = findings.present.with(id, level == Level::Trip);
        findings.warned = findings.warned.with(id, level == Level::Warn);
        let warned = if findings.warned.is_empty() { Action::None } else { Action::Warn };
        let tripped = findings.tripped.iter().map(|id| self.actions[id as usize]).max();
        findings.action = warned.max(tripped.unwrap_or_default());
    }

    /// Names the first-out cause among the trips of this sample.
    fn settle_first(&mut self, before: Option<DetectorId>) {
        if before.is_some() || !self.findings.action.latches() {
            return;
        }
        let highest = self.findings.action;
        self.findings.first = self.findings.tripped.iter().find(|id| self.actions[*id as usize] == highest);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::safety::detect::bench::Bench;

    #[test]
    fn the_first_out_cause_stays_and_a_reset_waits_for_the_condition() {
        let mut bench = Bench::new();
        bench.run(4096, |_, _| {});
        let first = bench.run(30, |_, o| o.sample.channels.mass_acceleration_1_m_s2 = f64::NAN);
        assert_eq!(first, Some((3, DetectorId::NotANumber)));
        assert!(!bench.watch.reset(), "still there");
        bench.run(4096, |_, o| o.sample.status.0 |= crate::stream::StatusBits::LINK_DOWN);
        assert_eq!(bench.watch.findings().first, Some(DetectorId::NotANumber), "the second does not count");
        bench.run(4096, |_, _| {});
        let findings = bench.watch.findings();
        assert!(findings.present.is_empty() && findings.tripped.has(DetectorId::DeviceStatus));
        assert!(bench.watch.reset());
        assert_eq!(bench.watch.findings(), Findings::default());
    }

    #[test]
    fn the_highest_action_wins() {
        let mut bench = Bench::new();
        bench.run(4096, |_, _| {});
        bench.run(1, |_, o| o.sample.sequence += 1);
        assert_eq!(bench.watch.findings().action, Action::Warn);
        // The first sample has the number of the one that came early, and says nothing new.
        bench.run(5, |_, o| o.sample.channels.table_displacement_m += 1e-3);
        assert_eq!(bench.watch.findings().action, Action::Abort);
    }

    #[test]
    fn observing_does_not_allocate() {
        let mut bench = Bench::new();
        assert_no_alloc::assert_no_alloc(|| {
            bench.run(4096, |k, o| {
                if k > 3000 {
                    o.sample.channels.relative_displacement_m = f64::NAN;
                }
            })
        });
    }
}
