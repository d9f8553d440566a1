//! Is a record fit to judge a model by? Asked before any physics is blamed.
//!
//! [`examine`] looks at length, steadiness, stuck, constant and saturated channels, and at kinematics
//! (`kinematic`): signs, units and swapped sensors. It needs no model and no scale:
//! every figure is relative to the record itself, so that grams and micrometres are judged like tonnes.

use super::data::{Kind, Record, Role};
use super::kinematic;
use crate::signal::fundamental_hz;
use serde::Serialize;

/// How bad a finding is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Severity {
    /// Worth knowing; verdicts stand.
    Notice,
    /// Verdicts may suffer.
    Warning,
    /// No verdict on the model can be trusted.
    Error,
}

/// What was found.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Problem {
    /// Fewer than three cycles of the input, or hardly any samples.
    TooShort,
    /// The steps end before the response is steady.
    NoSteadyState,
    /// A channel sits at its largest or smallest value.
    Saturated,
    /// A channel never changes.
    Constant,
    /// A channel stands still while the input moves.
    Stuck,
    /// A displacement is nothing but noise.
    Silent,
    /// A channel has the wrong sign.
    WrongSign,
    /// A channel is in another unit than said.
    WrongUnit,
    /// Two channels are exchanged.
    Swapped,
    /// Channels contradict each other in a way that no sign, unit or exchange explains.
    Inconsistent,
    /// Samples are missing and were bridged.
    Lost,
}

/// One finding.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Finding {
    /// How bad.
    pub severity: Severity,
    /// What.
    pub problem: Problem,
    /// Where; `None` concerns the whole record.
    pub channel: Option<&'static str>,
    /// A sentence for the operator.
    pub text: String,
    /// The number behind it: cycles, share of samples, relative misfit, by problem.
    pub figure: f64,
}

impl Finding {
    pub(crate) fn new(
        severity: Severity,
        problem: Problem,
        channel: Option<Role>,
        text: String,
        figure: f64,
    ) -> Self {
        Self { severity, problem, channel: channel.map(Role::name), text, figure }
    }
}

/// Cycles of the input that a record needs, and that a step needs for its steady state.
const FEWEST_CYCLES: f64 = 3.0;
/// Cycles that a component needs, whose force is judged along whatever is imposed: pressed and let go, or held.
const FEWEST_IMPOSED: f64 = 1.0;
/// Samples that a record needs.
const FEWEST_SAMPLES: usize = 64;
/// Equal samples that make a standstill.
const SHORTEST_STANDSTILL: usize = 50;
/// Samples at its largest or smallest value that make a channel look saturated.
const FEWEST_AT_THE_EDGE: usize = 8;

/// All findings, the worst first; none on a sound record.
pub fn examine(record: &Record) -> Vec<Finding> {
    let mut findings = Vec::new();
    let short = too_short(record);
    let has_length = short.is_none();
    findings.extend(short);
    for (role, values) in record.channels().filter(|(role, _)| *role != Role::Time) {
        let range = span(values);
        match constant(role, range) {
            // A mass that is let go needs nothing that drives it.
            Some(_) if std::ptr::eq(values, record.input()) && dies_out(response(record)) => {
                findings.push(Finding::new(
                    Severity::Notice,
                    Problem::Constant,
                    Some(role),
                    format!("{} is constant: taken as a free decay", role.name()),
                    range.0,
                ));
            }
            Some(finding) => findings.push(finding),
            None => {
                findings.extend(saturated(record, role, values, range));
                findings.extend(stuck(record, role, values, range));
                findings.extend(silent(role, values));
            }
        }
    }
    // A channel that says nothing has no sign or unit.
    let says_nothing = |finding: &Finding| {
        matches!(finding.problem, Problem::Constant | Problem::Silent) && finding.severity == Severity::Error
    };
    if has_length && !findings.iter().any(says_nothing) {
        findings.extend(kinematic::examine(record));
        findings.extend(unsteady(record));
    }
    for note in record.notes.iter().filter(|note| note.contains("filled in by straight lines")) {
        let count = note.split(' ').next().and_then(|word| word.parse().ok()).unwrap_or(0.0);
        let share = count / record.len().max(1) as f64;
        let severity = if share > 0.01 { Severity::Warning } else { Severity::Notice };
        findings.push(Finding::new(severity, Problem::Lost, None, note.clone(), share));
    }
    findings.sort_by_key(|finding| std::cmp::Reverse(finding.severity));
    findings
}

fn too_short(record: &Record) -> Option<Finding> {
    let samples = record.len();
    let error = |text: String, figure: f64| {
        Some(Finding::new(Severity::Error, Problem::TooShort, None, text, figure))
    };
    if samples < FEWEST_SAMPLES {
        return error(format!("{samples} samples are too few ({FEWEST_SAMPLES} at least)"), samples as f64);
    }
    let input = record.input();
    // What hits a mass or lets it go is over before the mass has answered.
    let mut seen = cycles(input);
    if seen < FEWEST_CYCLES && rests(input) {
        seen = seen.max(cycles(response(record)));
    }
    let fewest = if record.kind == Kind::Component { FEWEST_IMPOSED } else { FEWEST_CYCLES };
    if seen < fewest {
        let seconds = samples as f64 / record.sample_rate_hz;
        let text = format!("{seconds:.3} s hold {seen:.1} cycles of the input ({fewest} at least)");
        return error(text, seen);
    }
    None
}

/// Crossings of the mean upwards, with a hysteresis of half the RMS either side. An input that never
/// crosses twice has at most one cycle.
fn cycles(input: &[f64]) -> f64 {
    let n = input.len().max(1) as f64;
    let mean = input.iter().sum::<f64>() / n;
    let rms = (input.iter().map(|x| (x - mean).powi(2)).sum::<f64>() / n).sqrt();
    let (mut low, mut high, mut halves) = (false, false, 0u32);
    for x in input {
        if x - mean < -0.5 * rms && !low {
            (low, high) = (true, false);
            halves += 1;
        } else if x - mean > 0.5 * rms && !high {
            (low, high) = (false, true);
            halves += 1;
        }
    }
    0.5 * f64::from(halves)
}

/// What answers the input.
pub(super) fn response(record: &Record) -> &[f64] {
    match record.kind {
        Kind::Base if !record.relative_displacement_m.is_empty() => &record.relative_displacement_m,
        Kind::Base => &record.mass_acceleration_1_m_s2,
        Kind::Force if !record.displacement_m.is_empty() => &record.displacement_m,
        Kind::Force => &record.acceleration_m_s2,
        Kind::Component => &record.force_n,
    }
}

/// Share of its range within which an input rests, and of the samples at which it does.
const AT_REST: f64 = 0.05;
const MOSTLY: f64 = 0.5;

/// Whether an input is at rest most of the time, as blows of a hammer are.
fn rests(input: &[f64]) -> bool {
    let (low, high) = span(input);
    let mut sorted = input.to_vec();
    let middle = sorted.len() / 2;
    if sorted.is_empty() {
        return false;
    }
    let median = *sorted.select_nth_unstable_by(middle, f64::total_cmp).1;
    let still = input.iter().filter(|x| (**x - median).abs() <= AT_REST * (high - low)).count();
    still as f64 > MOSTLY * input.len() as f64
}

/// Parts in which a motion is looked at, and what the last of them has of the first one's power at most.
const PARTS: usize = 5;
const DIED_OUT: f64 = 0.25;

/// Whether a motion dies out, as nothing driven does.
pub(super) fn dies_out(motion: &[f64]) -> bool {
    let power = |part: &[f64]| {
        let mean = part.iter().sum::<f64>() / part.len().max(1) as f64;
        part.iter().map(|x| (x - mean).powi(2)).sum::<f64>()
    };
    let powers: Vec<f64> = motion.chunks_exact((motion.len() / PARTS).max(1)).map(power).collect();
    let ends = powers.first().zip(powers.last());
    // Noise is all that is left at the end.
    let floor = ends.map_or(0.0, |(first, _)| 0.01 * first);
    let falls = powers.windows(2).all(|two| two[1] <= two[0].max(floor));
    falls && ends.is_some_and(|(first, last)| *last < DIED_OUT * first)
}

/// Smallest and largest value, by lanes that do not wait for each other.
pub(crate) fn span(values: &[f64]) -> (f64, f64) {
    const LANES: usize = 8;
    let (mut low, mut high) = ([f64::INFINITY; LANES], [f64::NEG_INFINITY; LANES]);
    let rows = values.chunks_exact(LANES);
    let rest = rows.remainder();
    for row in rows {
        for (i, x) in row.iter().enumerate() {
            low[i] = if *x < low[i] { *x } else { low[i] };
            high[i] = if *x > high[i] { *x } else { high[i] };
        }
    }
    let least = |values: &[f64]| values.iter().copied().fold(f64::INFINITY, f64::min);
    let most = |values: &[f64]| values.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    (least(&low).min(least(rest)), most(&high).max(most(rest)))
}

fn constant(role: Role, (low, high): (f64, f64)) -> Option<Finding> {
    let largest = low.abs().max(high.abs());
    (high - low <= 1e-9 * largest).then(|| {
        let text = format!("{} is constant at {low:.6e} {}", role.name(), role.unit());
        Finding::new(Severity::Error, Problem::Constant, Some(role), text, low)
    })
}

/// A saturated sensor has many samples at exactly its largest (or smallest) value and few just below:
/// of a sine that is cut at 99 %, 0.8 times as many at the top as in the 2 % of the range below; of a
/// whole one, however coarsely quantised, 0.3 times at most when the band is 16 steps wide at least. What comes to rest there, as a
/// mass held by friction does, was slow before.
fn saturated(record: &Record, role: Role, values: &[f64], (low, high): (f64, f64)) -> Option<Finding> {
    let at = [high, low].map(|extreme| values.iter().map(|x| usize::from(*x == extreme)).sum::<usize>());
    if at.iter().all(|count| *count < FEWEST_AT_THE_EDGE) {
        return None;
    }
    let quantum = quantum(values, high - low);
    let band = (0.02 * (high - low)).max(16.0 * quantum);
    if band > 0.25 * (high - low) {
        return None;
    }
    let mut near = [0usize; 2];
    for &x in values {
        for (side, distance) in [high - x, x - low].into_iter().enumerate() {
            near[side] += usize::from(distance > 0.0 && distance < band);
        }
    }
    let cut = |side: usize| {
        at[side] >= FEWEST_AT_THE_EDGE
            && at[side] as f64 > 0.6 * near[side] as f64
            && !comes_to_rest(values, [high, low][side])
    };
    if !cut(0) && !cut(1) {
        return None;
    }
    let count = (0..2).filter(|side| cut(*side)).map(|side| at[side]).sum::<usize>();
    let share = count as f64 / values.len() as f64;
    let level = if cut(0) { high } else { low };
    // What is imposed may dwell on purpose, and a computed friction force does.
    let computed = role == Role::Force && white_noise(values) < 1e-9 * (high - low);
    let imposed = std::ptr::eq(values, record.input());
    let severity = if imposed || computed { Severity::Warning } else { Severity::Error };
    let text = format!(
        "{} sits at {level:.6e} {} in {count} samples: saturated or clipped",
        role.name(),
        role.unit()
    );
    Some(Finding::new(severity, Problem::Saturated, Some(role), text, share))
}

/// Speed at which a channel comes to rest, over its usual one; what is cut off arrives faster.
const SLOW: f64 = 0.03;

/// Whether a channel is slow before it sits at a value: the median over its stays there.
fn comes_to_rest(values: &[f64], level: f64) -> bool {
    const BEFORE: usize = 3;
    let squares: f64 = values.windows(2).map(|two| (two[1] - two[0]).powi(2)).sum();
    let usual = (squares / values.len().max(1) as f64).sqrt();
    let (mut first, mut speeds) = (0, Vec::new());
    for run in values.chunk_by(|a, b| a == b) {
        if run[0] == level && run.len() >= BEFORE && first >= BEFORE {
            // The farthest of them: noise at the edge of a cut returns at once.
            let away = values[first - BEFORE..first].iter().map(|x| (level - x).abs()).fold(0.0, f64::max);
            speeds.push(away / BEFORE as f64);
        }
        first += run.len();
    }
    speeds.sort_by(f64::total_cmp);
    speeds.get(speeds.len() / 2).is_some_and(|speed| *speed < SLOW * usual)
}

/// Deviation of what the steps of a converter do to a channel.
pub(crate) fn of_rounding(values: &[f64]) -> f64 {
    let (low, high) = span(values);
    quantum(values, high - low) / 12f64.sqrt()
}

/// Smallest difference between neighbours, the step of a converter; rounding of doubles is none.
fn quantum(values: &[f64], range: f64) -> f64 {
    let least = 1e-9 * range;
    values
        .windows(2)
        .map(|pair| (pair[1] - pair[0]).abs())
        .filter(|difference| *difference > least)
        .fold(f64::INFINITY, f64::min)
        .min(range)
}

/// White noise, rms, from sixth differences, which pass no slow motion: median of their size over what
/// the median of unit noise gives.
pub fn white_noise(values: &[f64]) -> f64 {
    // Sum of the squares of the binomial coefficients 1, 6, 15, 20, 15, 6, 1.
    const GAIN: f64 = 924.0;
    let sixths = values
        .windows(7)
        .step_by(one_of(values.len()))
        .map(|w| w[0] - 6.0 * w[1] + 15.0 * w[2] - 20.0 * w[3] + 15.0 * w[4] - 6.0 * w[5] + w[6]);
    deviation_by_median(sixths) / GAIN.sqrt()
}

/// One of so many of a channel's places tells a median: some ten thousand do to a per cent.
pub(in crate::record) fn one_of(samples: usize) -> usize {
    (samples / 20_000).max(1)
}

/// Standard deviation of normal deviates about zero by the median of their size, which the few that are far out do not move; 0 of none.
pub(in crate::record) fn deviation_by_median(deviates: impl Iterator<Item = f64>) -> f64 {
    const MEDIAN: f64 = 0.674_489_750_196_081_7;
    let mut sizes: Vec<f64> = deviates.map(f64::abs).collect();
    if sizes.is_empty() {
        return 0.0;
    }
    let middle = sizes.len() / 2;
    *sizes.select_nth_unstable_by(middle, f64::total_cmp).1 / MEDIAN
}

/// Correlation of a displacement with itself some samples later, at most, of which there is nothing but white noise: whatever moves, at how
/// few samples a cycle ever, shows in one of them.
const UNRELATED: f64 = 0.1;
const LATER: usize = 8;

/// A displacement that is white noise, as of a sensor that is not connected.
fn silent(role: Role, values: &[f64]) -> Option<Finding> {
    let is_displacement = matches!(role, Role::RelativeDisplacement | Role::Displacement);
    if !is_displacement || values.len() < FEWEST_SAMPLES {
        return None;
    }
    let mean = values.iter().sum::<f64>() / values.len() as f64;
    let with_later = |later: usize| -> f64 {
        values.iter().zip(&values[later..]).map(|(now, then)| (now - mean) * (then - mean)).sum()
    };
    let power = with_later(0);
    let is_unrelated = |later: usize| with_later(later).abs() < UNRELATED * power;
    // Neither of what is no number, nor of what never moves.
    (power > 0.0 && (1..=LATER).all(is_unrelated)).then(|| {
        let text =
            format!("{} shows nothing but noise: is its sensor connected, and switched on?", role.name());
        Finding::new(Severity::Error, Problem::Silent, Some(role), text, with_later(1) / power)
    })
}

/// Share of a channel's other samples that are as the one before, at most, where it stands still: of a sensor, and of an input, which
/// is never told twice where it is measured, and may be held where it is made.
const STANDS: f64 = 0.5;
const IS_MADE: f64 = 0.02;
/// Share of its range that the input, or what answers it, moves by meanwhile; share of its range within which an input is at rest.
const MOVES: f64 = 0.25;
const RESTS: f64 = 0.02;

/// The longest stretch of equal values inside the record, if the input moves on during it while the
/// channel elsewhere never holds still. An input that is measured may stand still, too: what answers it moves on.
fn stuck(record: &Record, role: Role, values: &[f64], (bottom, top): (f64, f64)) -> Option<Finding> {
    // A run that counts covers two places of this comb.
    let comb = SHORTEST_STANDSTILL / 2 - 1;
    let stands = |k: usize| values[k + 1..=k + comb].iter().all(|x| *x == values[k]);
    if !(0..values.len().saturating_sub(comb)).step_by(comb).any(stands) {
        return None;
    }
    let (mut first, mut best, mut still) = (0, 0..0usize, 0usize);
    for run in values.chunk_by(|a, b| a == b) {
        let end = first + run.len();
        still += run.len() - 1;
        // Rest before the start and after the end is no fault.
        if first > 0 && end < values.len() && run.len() > best.len() {
            best = first..end;
        }
        first = end;
    }
    let elsewhere = (still + 1).saturating_sub(best.len()) as f64 / values.len() as f64;
    let is_input = std::ptr::eq(values, record.input());
    let held = values[best.start];
    // What is imposed on a component may be held, and any input may rest.
    let may_be = is_input && (record.kind == Kind::Component || held.abs() < RESTS * (top - bottom));
    let most_elsewhere = if is_input { IS_MADE } else { STANDS };
    if best.len() < SHORTEST_STANDSTILL || elsewhere > most_elsewhere || may_be {
        return None;
    }
    let (other, what) =
        if is_input { (response(record), "what answers it") } else { (record.input(), "the input") };
    let (low, high) = span(other);
    let (least, most) = span(&other[best.clone()]);
    let moves = most - least > MOVES * (high - low);
    // A held extreme value is saturation, which has been named.
    let extreme = held <= bottom || held >= top;
    (moves && !extreme).then(|| {
        let seconds = best.len() as f64 / record.sample_rate_hz;
        let text = format!(
            "{} stands still for {seconds:.3} s from {:.3} s on while {what} moves",
            role.name(),
            record.time_s[best.start]
        );
        let share = best.len() as f64 / values.len() as f64;
        Finding::new(Severity::Error, Problem::Stuck, Some(role), text, share)
    })
}

/// Steps too short or still growing: most of them have fewer than three cycles, or their last two cycles
/// differ by more than a tenth in the size of the response.
fn unsteady(record: &Record) -> Option<Finding> {
    // What is imposed on a component is answered whether it is steady or not.
    if record.kind == Kind::Component {
        return None;
    }
    let response = response(record);
    let steps = record.step_ranges();
    let judged = steps.iter().filter_map(|(_, range)| {
        let window = range.clone();
        let hz = fundamental_hz(record.input().get(window.clone())?, record.sample_rate_hz)?;
        let period = (record.sample_rate_hz / hz).round() as usize;
        if window.len() as f64 / (period.max(1) as f64) < FEWEST_CYCLES - 0.2 {
            return Some(false);
        }
        let size = |end: usize| {
            let (low, high) = span(response.get(end.checked_sub(period)?..end)?);
            Some(high - low)
        };
        let (last, before) = (size(window.end)?, size(window.end - period)?);
        let noise = 6.0 * white_noise(&response[window]);
        Some((last - before).abs() <= 0.1 * last.max(before) + noise)
    });
    let judged: Vec<bool> = judged.collect();
    let bad = judged.iter().filter(|steady| !**steady).count();
    (!judged.is_empty() && bad * 2 > judged.len()).then(|| {
        let text = format!(
            "{bad} of {} steps end before the response is steady (three cycles, the last two within a tenth)",
            judged.len()
        );
        let share = bad as f64 / judged.len() as f64;
        Finding::new(Severity::Warning, Problem::NoSteadyState, None, text, share)
    })
}

#[cfg(test)]
#[path = "quality_tests.rs"]
mod tests;
