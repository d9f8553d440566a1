//! A sweep as it stands in its file: frequencies, cycles, transitions, settling.

use super::SweepError;
use crate::config::Check;
use crate::units::STANDARD_GRAVITY_M_S2;
use serde::{Deserialize, Serialize};

/// A sweep file. The frequencies are given in one of four ways: `start_hz`, `stop_hz` with `step_hz`
/// (equal steps) or with `steps_per_octave` (equal ratios); `frequencies_hz` (a list); `dwell_hz` (one).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(deny_unknown_fields)]
pub struct SweepSpec {
    /// Lowest frequency, Hz.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub start_hz: Option<f64>,
    /// Highest frequency, Hz.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub stop_hz: Option<f64>,
    /// Distance of the steps, Hz.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub step_hz: Option<f64>,
    /// Steps an octave, for equal ratios in place of equal distances; the last step is `stop_hz`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub steps_per_octave: Option<f64>,
    /// The frequencies one by one, Hz, in the order of the forward sweep.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub frequencies_hz: Option<Vec<f64>>,
    /// A single frequency to dwell at, Hz.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub dwell_hz: Option<f64>,
    /// Counted cycles of a step.
    #[serde(default = "default_cycles")]
    pub cycles: u32,
    /// Cycles of each step by its place in the forward list, in place of `cycles`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub cycles_per_step: Option<Vec<u32>>,
    /// Which way the frequencies are run through.
    #[serde(default)]
    pub direction: SweepDirection,
    /// Peak acceleration of the table A_G, g.
    pub acceleration_g: f64,
    /// How steps are joined.
    #[serde(default)]
    pub transition: Transition,
    /// Whole cycles of a smooth transition between two steps.
    #[serde(default = "default_transition_cycles")]
    pub transition_cycles: u32,
    /// Whole cycles of the ramps at start and end.
    #[serde(default = "default_ramp_cycles")]
    pub ramp_cycles: u32,
    /// Wait for the steady state before counting; without it counting starts at once.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub settling: Option<Settling>,
}

/// Waiting, before the counted cycles of a step, until the peak changes little from cycle to cycle.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(deny_unknown_fields)]
pub struct Settling {
    /// Relative change of the peak from one cycle to the next that counts as settled.
    #[serde(default = "default_tolerance")]
    pub tolerance: f64,
    /// Cycles after which counting starts anyhow.
    pub max_cycles: u32,
}

/// Which way the frequencies are run through.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "kebab-case")]
pub enum SweepDirection {
    /// Up, then down; the highest frequency is held in both.
    #[default]
    ForwardBackward,
    /// Up only.
    Forward,
    /// Down only.
    Backward,
}

/// How steps are joined.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Transition {
    /// Frequency and amplitude glide over whole cycles outside the counted ones, ramps at both ends.
    #[default]
    Smooth,
    /// Ideal concatenation at phase 0, no ramps; the velocity jumps, so for simulation only.
    None,
}

fn default_cycles() -> u32 {
    10
}
fn default_transition_cycles() -> u32 {
    1
}
fn default_ramp_cycles() -> u32 {
    2
}
fn default_tolerance() -> f64 {
    0.01
}

/// Frequencies that a sweep may ask for, Hz.
const FREQUENCY_RANGE_HZ: std::ops::RangeInclusive<f64> = 0.05..=50.0;
/// Most steps of one direction.
const MAX_STEPS: usize = 2000;

type Refusal = (String, String);

fn within(key: &str, value: f64, range: &std::ops::RangeInclusive<f64>, unit: &str) -> Result<(), Refusal> {
    if range.contains(&value) {
        Ok(())
    } else {
        Err((key.into(), format!("{value} {unit}; allowed: {} to {} {unit}", range.start(), range.end())))
    }
}

fn count_within(key: &str, value: u32, low: u32, high: u32) -> Result<(), Refusal> {
    if (low..=high).contains(&value) {
        Ok(())
    } else {
        Err((key.into(), format!("{value} cycles; allowed: {low} to {high}")))
    }
}

/// Rounds to the nanohertz, so that 0.5 + 3 x 0.1 reads 0.8.
fn tidy_hz(frequency_hz: f64) -> f64 {
    (frequency_hz * 1e9).round() / 1e9
}

impl SweepSpec {
    /// The sweep of the paper (Andreaus and De Angelis 2020): 0.5-5.0-0.5 Hz by 0.1 Hz, 10 cycles a step,
    /// at 0.05 g.
    pub fn paper() -> Self {
        Self {
            start_hz: Some(0.5),
            stop_hz: Some(5.0),
            step_hz: Some(0.1),
            steps_per_octave: None,
            frequencies_hz: None,
            dwell_hz: None,
            cycles: default_cycles(),
            cycles_per_step: None,
            direction: SweepDirection::ForwardBackward,
            acceleration_g: 0.05,
            transition: Transition::Smooth,
            transition_cycles: default_transition_cycles(),
            ramp_cycles: default_ramp_cycles(),
            settling: None,
        }
    }

    /// Peak acceleration A_G, m/s2.
    pub fn acceleration_m_s2(&self) -> f64 {
        self.acceleration_g * STANDARD_GRAVITY_M_S2
    }

    /// The same sweep with only the steps from `low_hz` to `high_hz`, both included.
    ///
    /// # Errors
    /// [`SweepError::EmptyRange`] when nothing is left, [`SweepError::Invalid`] when the sweep itself is.
    pub fn restricted(&self, low_hz: f64, high_hz: f64) -> Result<Self, SweepError> {
        let all = self.forward_hz().map_err(|(key, reason)| SweepError::Invalid { key, reason })?;
        let keep = |f: &f64| (low_hz - 1e-9..=high_hz + 1e-9).contains(f);
        let kept: Vec<f64> = all.iter().copied().filter(keep).collect();
        if kept.is_empty() {
            let first_hz = all.iter().copied().fold(f64::INFINITY, f64::min);
            let last_hz = all.iter().copied().fold(0.0, f64::max);
            return Err(SweepError::EmptyRange { low_hz, high_hz, first_hz, last_hz });
        }
        let cycles_per_step = self
            .cycles_per_step
            .as_ref()
            .map(|cycles| all.iter().zip(cycles).filter(|(f, _)| keep(f)).map(|(_, &n)| n).collect());
        Ok(Self {
            start_hz: None,
            stop_hz: None,
            step_hz: None,
            steps_per_octave: None,
            dwell_hz: None,
            frequencies_hz: Some(kept),
            cycles_per_step,
            ..self.clone()
        })
    }

    /// The frequencies of the forward sweep, Hz.
    ///
    /// # Errors
    /// The key and what is wrong with it, as [`Check::check`].
    pub fn forward_hz(&self) -> Result<Vec<f64>, Refusal> {
        let ranged = [
            ("start_hz", self.start_hz),
            ("stop_hz", self.stop_hz),
            ("step_hz", self.step_hz),
            ("steps_per_octave", self.steps_per_octave),
        ];
        let alone = |key: &str| match ranged.iter().find(|(_, value)| value.is_some()) {
            Some((other, _)) => Err(((*other).to_owned(), format!("not together with {key}"))),
            None => Ok(()),
        };
        match (&self.frequencies_hz, self.dwell_hz) {
            (Some(_), Some(_)) => Err(("dwell_hz".into(), "not together with frequencies_hz".into())),
            (Some(list), None) => alone("frequencies_hz").and_then(|()| listed(list)),
            (None, Some(dwell_hz)) => {
                alone("dwell_hz")?;
                within("dwell_hz", dwell_hz, &FREQUENCY_RANGE_HZ, "Hz")?;
                Ok(vec![dwell_hz])
            }
            (None, None) => self.ranged_hz(),
        }
    }

    fn ranged_hz(&self) -> Result<Vec<f64>, Refusal> {
        let missing = |key: &str| -> Refusal {
            (key.into(), "missing; give start_hz, stop_hz and step_hz, or frequencies_hz, or dwell_hz".into())
        };
        let start_hz = self.start_hz.ok_or_else(|| missing("start_hz"))?;
        let stop_hz = self.stop_hz.ok_or_else(|| missing("stop_hz"))?;
        within("start_hz", start_hz, &FREQUENCY_RANGE_HZ, "Hz")?;
        within("stop_hz", stop_hz, &FREQUENCY_RANGE_HZ, "Hz")?;
        if stop_hz <= start_hz {
            let reason = format!("{stop_hz} Hz; allowed: above start_hz = {start_hz} Hz (see direction)");
            return Err(("stop_hz".into(), reason));
        }
        match (self.step_hz, self.steps_per_octave) {
            (Some(_), Some(_)) => Err(("steps_per_octave".into(), "not together with step_hz".into())),
            (None, None) => Err(missing("step_hz")),
            (Some(step_hz), None) => linear(start_hz, stop_hz, step_hz),
            (None, Some(per_octave)) => logarithmic(start_hz, stop_hz, per_octave),
        }
    }

    fn check_cycles(&self, steps: usize) -> Result<(), Refusal> {
        count_within("cycles", self.cycles, 1, 100_000)?;
        count_within("transition_cycles", self.transition_cycles, 1, 20)?;
        count_within("ramp_cycles", self.ramp_cycles, 1, 20)?;
        if let Some(cycles) = &self.cycles_per_step {
            if cycles.len() != steps {
                let reason = format!("{} entries; allowed: one for each of the {steps} steps", cycles.len());
                return Err(("cycles_per_step".into(), reason));
            }
            for (i, &n) in cycles.iter().enumerate() {
                count_within(&format!("cycles_per_step[{i}]"), n, 1, 100_000)?;
            }
        }
        if let Some(settling) = self.settling {
            within("settling.tolerance", settling.tolerance, &(1e-4..=0.5), "(relative)")?;
            count_within("settling.max_cycles", settling.max_cycles, 2, 1000)?;
        }
        Ok(())
    }
}

impl Check for SweepSpec {
    fn check(&self) -> Result<(), Refusal> {
        let steps = self.forward_hz()?.len();
        within("acceleration_g", self.acceleration_g, &(0.0005..=2.0), "g")?;
        self.check_cycles(steps)
    }
}

fn listed(list: &[f64]) -> Result<Vec<f64>, Refusal> {
    if list.is_empty() || list.len() > MAX_STEPS {
        let reason = format!("{} frequencies; allowed: 1 to {MAX_STEPS}", list.len());
        return Err(("frequencies_hz".into(), reason));
    }
    for (i, &f) in list.iter().enumerate() {
        within(&format!("frequencies_hz[{i}]"), f, &FREQUENCY_RANGE_HZ, "Hz")?;
    }
    Ok(list.to_vec())
}

fn linear(start_hz: f64, stop_hz: f64, step_hz: f64) -> Result<Vec<f64>, Refusal> {
    let span = stop_hz - start_hz;
    if !(step_hz > 0.0 && step_hz <= span * (1.0 + 1e-9)) {
        return Err(("step_hz".into(), format!("{step_hz} Hz; allowed: above 0 to {} Hz", tidy_hz(span))));
    }
    let count = (span / step_hz).round();
    if count as usize >= MAX_STEPS {
        let least = tidy_hz(span / (MAX_STEPS - 1) as f64);
        return Err((
            "step_hz".into(),
            format!("{step_hz} Hz makes {count} steps; allowed: {least} Hz or more"),
        ));
    }
    if (count * step_hz - span).abs() > 1e-6 * step_hz {
        let reason =
            format!("{step_hz} Hz does not divide {} Hz, the span of the sweep, evenly", tidy_hz(span));
        return Err(("step_hz".into(), reason));
    }
    Ok((0..=count as usize).map(|k| tidy_hz(start_hz + k as f64 * span / count)).collect())
}

fn logarithmic(start_hz: f64, stop_hz: f64, per_octave: f64) -> Result<Vec<f64>, Refusal> {
    within("steps_per_octave", per_octave, &(0.1..=200.0), "steps")?;
    let count = ((stop_hz / start_hz).log2() * per_octave - 1e-9).ceil().max(1.0) as usize;
    let ratio = 2f64.powf(1.0 / per_octave);
    let mut list: Vec<f64> = (0..count).map(|k| tidy_hz(start_hz * ratio.powi(k as i32))).collect();
    list.push(stop_hz);
    Ok(list)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::parse_toml;

    const PAPER: &str = "start_hz = 0.5\nstop_hz = 5.0\nstep_hz = 0.1\ncycles = 10\n\
        direction = \"forward-backward\"\nacceleration_g = 0.05\ntransition = \"smooth\"\n";

    #[test]
    fn the_paper_file_is_the_paper_sweep() {
        let spec: SweepSpec = parse_toml("s.toml", PAPER).expect("valid");
        assert_eq!(spec, SweepSpec::paper());
        let hz = spec.forward_hz().expect("valid");
        assert_eq!(hz.len(), 46);
        assert_eq!((hz[0], hz[3], hz[45]), (0.5, 0.8, 5.0));
    }

    fn refusal(text: &str) -> String {
        parse_toml::<SweepSpec>("s.toml", text).expect_err("refused").to_string()
    }

    #[test]
    fn mistakes_are_refused_with_their_line() {
        let broken = |from: &str, to: &str| refusal(&PAPER.replace(from, to));
        assert!(
            broken("stop_hz = 5.0", "stop_hz = 0.2").starts_with("s.toml:2: stop_hz: 0.2 Hz; allowed: above")
        );
        assert!(
            broken("step_hz = 0.1", "step_hz = 0.4").starts_with("s.toml:3: step_hz: 0.4 Hz does not divide")
        );
        assert!(broken("step_hz = 0.1", "step_hz = 0.0").starts_with("s.toml:3: step_hz"));
        assert!(broken("cycles = 10", "cycles = 0").starts_with("s.toml:4: cycles: 0 cycles; allowed: 1 to"));
        assert!(
            broken("acceleration_g = 0.05", "acceleration_g = -0.1").starts_with("s.toml:6: acceleration_g")
        );
        assert!(broken("acceleration_g", "acceleration_m_s2").contains("unknown field"));
        assert!(broken("cycles = 10", "dwell_hz = 1.0").starts_with("s.toml:1: start_hz: not together"));
        assert!(broken("smooth", "sudden").contains("unknown variant"));
        assert!(
            broken("cycles = 10", "settling = { max_cycles = 1 }")
                .starts_with("s.toml:4: settling.max_cycles")
        );
    }

    #[test]
    fn other_schedules() {
        let log: SweepSpec =
            parse_toml("l", "start_hz = 0.5\nstop_hz = 4.0\nsteps_per_octave = 4\nacceleration_g = 0.03")
                .expect("valid");
        let hz = log.forward_hz().expect("valid");
        assert_eq!(hz.len(), 13);
        for pair in hz.windows(2) {
            assert!((pair[1] / pair[0] - 2f64.powf(0.25)).abs() < 1e-8);
        }
        let dwell: SweepSpec =
            parse_toml("d", "dwell_hz = 1.3\ncycles = 100\ndirection = \"forward\"\nacceleration_g = 0.03")
                .expect("valid");
        assert_eq!(dwell.forward_hz(), Ok(vec![1.3]));
        let list = "frequencies_hz = [1.0, 1.4, 1.2]\ncycles_per_step = [10, 20, 30]\nacceleration_g = 0.03";
        let list: SweepSpec = parse_toml("f", list).expect("valid");
        let part = list.restricted(1.1, 2.0).expect("two left");
        assert_eq!(part.frequencies_hz, Some(vec![1.4, 1.2]));
        assert_eq!(part.cycles_per_step, Some(vec![20, 30]));
        assert!(matches!(list.restricted(2.0, 3.0), Err(SweepError::EmptyRange { .. })));
        assert_eq!(
            SweepSpec::paper().restricted(2.0, 3.0).expect("some").forward_hz().expect("ok").len(),
            11
        );
    }
}
