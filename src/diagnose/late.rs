//! Answers that come late, or early, against what drives them. Of an applied force, whose sensor has a chain of its own, that is taken back;
//! of a moving base it is said. The engine asks before it looks for effects, which do not make up for much of it, and of what it has found.

use super::search::Searcher;
use super::trial::Trial;
use crate::identify::kinematics::{Estimate, OF_A_SAMPLE};
use crate::record::Kind;

/// Share of a sample from which on a lag is spoken of, as delays of the instruments are; and one that is much, whatever the model lacks.
pub(super) const SPOKEN_OF: f64 = OF_A_SAMPLE;
pub(super) const MUCH: f64 = 0.5;

/// By how much each record's answer comes later than what drives it says, s; nothing for what is below a share of a sample, nor where the
/// response does not decide.
fn lags_s(searcher: &Searcher<'_>, trial: &Trial, share: f64) -> Vec<Option<f64>> {
    let Some(measured) = &searcher.measured else { return Vec::new() };
    let rate_hz = searcher.motion.sample_rate_hz;
    let beyond = |lag: Estimate| lag.is_late(share, rate_hz).then_some(lag.value);
    trial.lags_s(measured).into_iter().map(beyond).collect()
}

/// By how much each record's answer comes later than the force that is applied says, s, 0 for what is below a share of a sample; nothing
/// where all are, or no force is applied.
pub(super) fn of_forces(searcher: &Searcher<'_>, trial: &Trial, share: f64) -> Option<Vec<f64>> {
    let lags = lags_s(searcher, trial, share);
    let any = searcher.motion.kind == Kind::Force && lags.iter().any(Option::is_some);
    any.then(|| lags.into_iter().map(Option::unwrap_or_default).collect())
}

/// What is to be said of forces that came so much later than what answers them (s) and were put on time.
pub(super) fn taken_back(late_s: &[f64], dt_s: f64) -> Vec<String> {
    let beyond = |(_, late_s): &(usize, &f64)| late_s.abs() > SPOKEN_OF * dt_s;
    let records = late_s.len();
    let told = |(i, late_s): (usize, &f64)| {
        let (us, sense) = (1e6 * late_s.abs(), sense(*late_s));
        format!("the force{} comes {us:.0} us {sense} than what answers it: taken back", of(i, records))
    };
    late_s.iter().enumerate().filter(beyond).map(told).collect()
}

/// What is to be said of a component's force that came so much later (s) than the motion that it takes, and was put on time.
pub(super) fn said_of_component(late_s: f64) -> String {
    let (us, sense) = (1e6 * late_s.abs(), sense(late_s));
    format!("the force comes {us:.0} us {sense} than the displacement that it takes: taken back")
}

/// What is to be said of those that are late still.
pub(super) fn said(searcher: &Searcher<'_>, chosen: &Trial) -> Vec<String> {
    let lags = lags_s(searcher, chosen, SPOKEN_OF);
    let told = |(i, lag): (usize, &Option<f64>)| {
        let lag_s = (*lag)?;
        let (us, sense) = (1e6 * lag_s.abs(), sense(lag_s));
        let answers = format!("what answers{} comes {us:.0} us {sense}", of(i, lags.len()));
        Some(format!("{answers} than what drives it says: followed to first order"))
    };
    lags.iter().enumerate().filter_map(told).collect()
}

fn sense(late_s: f64) -> &'static str {
    if late_s > 0.0 { "later" } else { "earlier" }
}

/// Which of the records, where there are several.
fn of(i: usize, records: usize) -> String {
    if records > 1 { format!(" of record {}", i + 1) } else { String::new() }
}
