//! The test that would part two explanations: among what the rig can do, the one that leaves most between the rivals when the
//! wrong one is fitted again.

use super::discrimination::{self, Expected, Rival};
use crate::identify::refit::Refit;
use crate::identify::together::Setting;
use crate::model::ModelSpec;
use crate::parallel;
use crate::record::Kind;
use crate::sweep::SweepSpec;
use crate::units::STANDARD_GRAVITY_M_S2;
use serde::{Deserialize, Serialize};
use std::f64::consts::TAU;

/// A proposed test.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct NextTest {
    /// What to do, in a line.
    pub title: String,
    /// Why, in a line.
    pub reason: String,
    /// RMS difference of the rivals' A and D, each over its noise, expected; zero for tests that are not a sweep.
    pub expected_discrimination: f64,
    /// Difference of log-likelihood that the test is expected to leave between the rivals, nats, the wrong one fitted again.
    #[serde(default)]
    pub expected_nats: f64,
    /// The sweep to run, when it is one (keys as in a sweep file).
    pub sweep: Option<SweepProposal>,
}

/// A sweep that the rig can do.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SweepProposal {
    /// First frequency, Hz.
    pub start_hz: f64,
    /// Last frequency, Hz.
    pub stop_hz: f64,
    /// Step, Hz.
    pub step_hz: f64,
    /// Counted cycles a step.
    pub cycles: u32,
    /// Peak acceleration, g.
    pub acceleration_g: f64,
    /// Take the bumpers off.
    pub without_bumpers: bool,
    /// Another total gap, m.
    pub total_gap_m: Option<f64>,
}

impl NextTest {
    /// One that is no sweep.
    fn in_words(title: &str, reason: String) -> Self {
        Self {
            title: title.to_owned(),
            reason,
            expected_discrimination: 0.0,
            expected_nats: 0.0,
            sweep: None,
        }
    }

    /// Reads the test from the JSON that `diagnose --json` prints, or from its `next_test` alone.
    ///
    /// # Errors
    /// No JSON, or no test in it; in words.
    pub fn parse(text: &str) -> Result<Self, String> {
        let mut value: serde_json::Value = serde_json::from_str(text).map_err(|error| error.to_string())?;
        if let Some(test) = value.get_mut("next_test") {
            value = test.take();
        }
        if value.is_null() {
            return Err("the diagnosis proposes no test: its verdict needs none".into());
        }
        serde_json::from_value(value).map_err(|error| format!("no test in it: {error}"))
    }
}

impl SweepProposal {
    /// The sweep, everything that the proposal does not say as in `like`.
    pub fn sweep(&self, like: &SweepSpec) -> SweepSpec {
        SweepSpec {
            start_hz: Some(self.start_hz),
            stop_hz: Some(self.stop_hz),
            step_hz: Some(self.step_hz),
            steps_per_octave: None,
            frequencies_hz: None,
            dwell_hz: None,
            cycles: self.cycles,
            cycles_per_step: None,
            acceleration_g: self.acceleration_g,
            ..like.clone()
        }
    }

    /// What has to be changed on a specimen.
    pub fn setting(&self, model: &ModelSpec) -> Setting {
        let wider_m = match (&model.bumper, self.total_gap_m) {
            (Some(bumper), Some(gap_m)) => gap_m - bumper.total_gap_m,
            _ => 0.0,
        };
        Setting { without_bumpers: self.without_bumpers, wider_m }
    }
}

/// What the rig can do.
#[derive(Clone, Copy, Debug)]
pub struct Reach {
    /// Largest displacement, m.
    pub stroke_m: f64,
    /// Largest velocity, m/s.
    pub velocity_m_s: f64,
    /// Largest acceleration, m/s2.
    pub acceleration_m_s2: f64,
    /// A_G of the record, m/s2.
    pub tried_m_s2: f64,
    /// Lowest and highest frequency of the record, Hz.
    pub tried_hz: (f64, f64),
    /// Noise of A, m/s2 rms.
    pub noise_m_s2: f64,
    /// Noise of the laser, m rms.
    pub laser_noise_m: f64,
    /// Samples a second.
    pub rate_hz: f64,
}

/// Stroke (m), velocity (m/s) and acceleration (m/s2) of the paper's table.
pub const PAPERS_TABLE: (f64, f64, f64) = (0.20, 0.5, 5.9);

/// So many of the tests in which the rivals differ most are looked at with the wrong one fitted again.
const LOOKED_AT: usize = 24;
/// So many of the best of those are, not to first order alone.
const FITTED: usize = 8;

/// Counted cycles of a step; and those of a longer test, where fewer are not expected to bring so many times the nats that decide: the look
/// ahead is an upper estimate.
const CYCLES: u32 = 10;
const MORE_CYCLES: [u32; 2] = [20, 40];
const SURELY: f64 = 5.0;

/// What else parts a stand from a softer bumper.
const STAND: &str = "; an accelerometer on the stand tells, too: a softer bumper does not move its stand";

/// Tests that no simulation of a base sweep can rank: the twins of a single record.
fn known(a: &str, b: &str) -> Option<(&'static str, &'static str)> {
    let pair = |x: &str, y: &str| (a == x && b == y) || (a == y && b == x);
    Some(if pair("constant-force", "laser-zero") {
        (
            "static zero and tilt: release the mass, read D at rest on the levelled and tilted table",
            "only a force moves the mass",
        )
    } else if a == "mass-error" || b == "mass-error" {
        (
            "static pull, or repeat with a known added mass",
            "a base record fixes only force over mass; no other A_G parts mass from all stiffnesses and dampings scaled",
        )
    } else if pair("stiffness-degradation", "drift") {
        (
            "repeat or reverse the sweep",
            "a degraded isolator does not come back, a drift does not follow the load",
        )
    } else {
        return None;
    })
}

/// What to do on another rig, whose reach is not known: what is alike at one speed and amplitude is not at others.
pub fn elsewhere(first: &str, second: &str, kind: Kind) -> NextTest {
    let title = match kind {
        Kind::Component => {
            "impose a third and three times the velocity, at half the amplitude and at all of it"
        }
        Kind::Base | Kind::Force => {
            "drive it at a third and at three times the level, over the same frequencies"
        }
    };
    let reason = format!(
        "{first} and {second} do alike in this motion and differ in others: give the new record, of the same sampling rate, along \
         with this one (`diagnose THIS NEW --model MODEL`)"
    );
    NextTest::in_words(title, reason)
}

/// Proposes the test that best parts the fitted rivals.
///
/// `enough` nats between two explanations decide.
pub fn propose(
    first: (&str, &Refit),
    second: (&str, &Refit),
    reach: &Reach,
    enough: f64,
) -> Option<NextTest> {
    if let Some((title, reason)) = known(first.0, second.0) {
        return Some(NextTest::in_words(title, reason.to_owned()));
    }
    let (a, b) = (Rival::new(first.1), Rival::new(second.1));
    let tests = possible(&first.1.spec, reach);
    let far = |test: &SweepProposal| discrimination::difference(&a, &b, test, reach);
    let at_a_glance = |test: &SweepProposal| discrimination::expected(&a, &b, test, reach, true);
    let fitted = |test: &SweepProposal| discrimination::expected(&a, &b, test, reach, false);
    let best = |tests: Vec<SweepProposal>, most, of: &(dyn Fn(&SweepProposal) -> Option<Expected> + Sync)| {
        let expected = parallel::map(&tests, parallel::cores(), of);
        let mut found: Vec<_> =
            expected.into_iter().zip(tests).filter_map(|(expected, test)| Some((expected?, test))).collect();
        found.sort_by(|a, b| b.0.nats.total_cmp(&a.0.nats));
        found.truncate(most);
        found
    };
    let alone = |found: Vec<(Expected, SweepProposal)>| found.into_iter().map(|(_, test)| test).collect();
    let differing = alone(best(tests, LOOKED_AT, &far));
    let promising = alone(best(differing, FITTED, &at_a_glance));
    let found = best(promising, 1, &fitted);
    let (mut expected, mut sweep) = found.into_iter().next()?;
    for cycles in MORE_CYCLES {
        let longer = SweepProposal { cycles, ..sweep.clone() };
        let of_longer = if expected.nats < SURELY * enough { fitted(&longer) } else { None };
        if let Some(more) = of_longer.filter(|more| more.nats > expected.nats) {
            (expected, sweep) = (more, longer);
        }
    }
    let Expected { difference, nats } = expected;
    let stand = if [first.0, second.0].contains(&"stand-compliance") { STAND } else { "" };
    Some(NextTest {
        title: describe(&sweep),
        reason: format!(
            "{} and {} as they are fitted then differ by {difference:.1} times the noise of A and D (rms); with the wrong one \
             fitted again, {nats:.0} nats are expected between them, {}{stand}",
            first.0,
            second.0,
            if nats > enough { "which decides" } else { "which may not decide yet" },
        ),
        expected_discrimination: difference,
        expected_nats: nats,
        sweep: Some(sweep),
    })
}

fn describe(p: &SweepProposal) -> String {
    let bumpers = match (p.without_bumpers, p.total_gap_m) {
        (true, _) => ", bumpers off".to_owned(),
        (false, Some(gap)) => format!(", total gap {:.0} mm", 1e3 * gap),
        _ => String::new(),
    };
    let longer = if p.cycles == CYCLES { String::new() } else { format!(", {} cycles a step", p.cycles) };
    format!("sweep {:.2}-{:.2} Hz at {:.3} g{bumpers}{longer}", p.start_hz, p.stop_hz, p.acceleration_g)
}

/// Lower and higher A_G, wider frequencies, other gaps and no bumpers, all within capacity.
pub fn possible(spec: &ModelSpec, reach: &Reach) -> Vec<SweepProposal> {
    let mut out = Vec::new();
    let (low, high) = reach.tried_hz;
    let gaps: Vec<Option<f64>> = match &spec.bumper {
        Some(b) => vec![None, Some(0.7 * b.total_gap_m), Some(1.4 * b.total_gap_m)],
        None => vec![None],
    };
    for factor in [0.4, 0.7, 1.0, 1.4] {
        for (start, stop) in [(low, high), (0.5 * low, 0.5 * (low + high)), (low, 1.6 * high)] {
            let a = factor * reach.tried_m_s2;
            let w = TAU * start;
            let possible =
                a / (w * w) <= reach.stroke_m && a / w <= reach.velocity_m_s && a <= reach.acceleration_m_s2;
            if !possible {
                continue;
            }
            let mut push = |without_bumpers: bool, total_gap_m: Option<f64>| {
                out.push(SweepProposal {
                    start_hz: start,
                    stop_hz: stop,
                    step_hz: (stop - start) / 8.0,
                    cycles: CYCLES,
                    acceleration_g: a / STANDARD_GRAVITY_M_S2,
                    without_bumpers,
                    total_gap_m,
                });
            };
            for gap in &gaps {
                push(false, *gap);
            }
            if spec.bumper.is_some() {
                push(true, None);
            }
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_test_is_read_from_a_diagnosis_and_becomes_a_sweep() {
        let proposal = SweepProposal {
            start_hz: 0.6,
            stop_hz: 3.0,
            step_hz: 0.3,
            cycles: 10,
            acceleration_g: 0.03,
            without_bumpers: false,
            total_gap_m: Some(0.028),
        };
        let test = NextTest {
            title: "sweep".into(),
            reason: "they differ".into(),
            expected_discrimination: 3.0,
            expected_nats: 40.0,
            sweep: Some(proposal.clone()),
        };
        let whole = serde_json::json!({ "verdict": "ambiguous", "next_test": test });
        assert_eq!(NextTest::parse(&whole.to_string()), Ok(test.clone()));
        assert_eq!(NextTest::parse(&whole["next_test"].to_string()), Ok(test));
        assert!(NextTest::parse(r#"{"next_test": null}"#).is_err_and(|e| e.contains("proposes no test")));
        assert!(NextTest::parse("[]").is_err());
        let text = crate::config::builtin::find("sweeps", "andreaus-2020").expect("built in");
        let like: SweepSpec = text.parse().expect("valid");
        let sweep = proposal.sweep(&like);
        assert_eq!((sweep.start_hz, sweep.acceleration_g), (Some(0.6), 0.03));
        assert_eq!(sweep.direction, like.direction);
        crate::config::Check::check(&sweep).expect("a sweep that may be run");
    }
}
