//! The whole diagnosis of one record: instruments, re-identification, search, verdict.

use super::by_response::ASTRAY;
use super::instruments::{self, Finding};
use super::missing_force;
use super::next_test::{self, Reach};
use super::parts;
use super::report::{Diagnosis, NamedEffect, ParameterEstimate, Reidentified, Rung, StepErrors};
use super::search::{Effort, Search, Searcher};
use super::trial::{self, Response, Trial};
use super::verdict::{self, Decision, Refused, Thresholds, Verdict};
use crate::identify::kinematics::{Estimate, Tolerances};
use crate::identify::least_squares::Free;
use crate::identify::motion::{Motion, MotionError};
use crate::identify::numbers::Number;
use crate::identify::problem::{OutputError, Part, Problem};
use crate::identify::readied;
use crate::identify::refit::Refit;
use crate::identify::response::Measured;
use crate::identify::together::{Setting, TogetherError};
use crate::model::{ModelError, ModelSpec, effects};
use crate::record::{Kind, Record, quality};
use std::time::Instant;

/// How a diagnosis is done.
#[derive(Clone, Debug, Default)]
pub struct Options {
    /// Tolerances of the instruments.
    pub tolerances: Tolerances,
    /// Effort of the search.
    pub effort: Effort,
    /// Thresholds of the verdict.
    pub thresholds: Thresholds,
    /// What the rig can do; defaults to the paper's table.
    pub reach: Option<(f64, f64, f64)>,
    /// Diagnose a record that is not fit for it all the same.
    pub anyway: bool,
    /// Effects that are not tried: what the user knows not to be there.
    pub without: Vec<&'static str>,
}

/// Why a record cannot be diagnosed.
#[derive(Debug, thiserror::Error)]
pub enum DiagnoseError {
    /// The record does not hold what its kind needs.
    #[error(transparent)]
    Motion(#[from] MotionError),
    /// The record itself is at fault: no verdict on a model could be trusted.
    #[error("the record `{record}` is not fit to judge a model by: {faults}")]
    Unfit {
        /// Name of the record.
        record: String,
        /// What is wrong with it.
        faults: String,
    },
    /// The records do not belong together.
    #[error(transparent)]
    Together(#[from] TogetherError),
    /// The model cannot be built.
    #[error(transparent)]
    Model(#[from] ModelError),
    /// The model as given cannot follow the record at all.
    #[error("the model `{name}` gives no finite response to this record")]
    Diverges {
        /// Name of the model.
        name: String,
    },
}

/// Diagnoses a record against a model.
///
/// # Errors
/// A record that lacks a channel or is not fit to judge a model by, a model that cannot be built or follows nothing.
pub fn diagnose(record: &Record, nominal: &ModelSpec, options: &Options) -> Result<Diagnosis, DiagnoseError> {
    diagnose_together(&[(record, nominal)], options)
}

/// Diagnoses several records of one specimen as one; their models may differ in gap and bumpers alone, and the first
/// record is one with bumpers, if any is.
///
/// # Errors
/// As of [`diagnose`]; records that do not belong together; none.
pub fn diagnose_together(
    tests: &[(&Record, &ModelSpec)],
    options: &Options,
) -> Result<Diagnosis, DiagnoseError> {
    let begun = Instant::now();
    let records: Vec<_> = tests.iter().map(|(record, _)| readied(record)).collect();
    let tests: Vec<(&Record, &ModelSpec)> =
        records.iter().zip(tests).map(|(record, (_, model))| (&**record, *model)).collect();
    let tests = tests.as_slice();
    let Some((_, nominal)) = tests.first() else {
        return Err(MotionError::TooShort { samples: 0, needed: 1 }.into());
    };
    let mut motions = Vec::with_capacity(tests.len());
    let mut findings: Vec<(usize, Finding)> = Vec::new();
    let mut notes: Vec<String> = Vec::new();
    for (i, (record, model)) in tests.iter().enumerate() {
        crate::model::build(model, 1.0 / record.sample_rate_hz)?;
        notes.extend(of_record(record, options.anyway)?);
        let motion = Motion::of(record, model.mass_kg, options.tolerances)?;
        let judged = |found| instruments::judge(found, record, options.tolerances);
        for finding in motion.instruments.as_ref().map(judged).unwrap_or_default() {
            if !findings.iter().any(|(_, known)| known.name == finding.name) {
                findings.push((i, finding));
            }
        }
        motions.push((motion, Setting::between(nominal, model)?));
    }
    let motion = Motion::together(motions)?;
    parts::done("fitness, instruments, motion");
    let mut out = of_motion((tests, nominal), options, motion, (findings, notes), QUIETER)?;
    parts::done("errors, missing force");
    out.wall_s = begun.elapsed().as_secs_f64();
    Ok(out)
}

/// So many times at most the noise is taken to be what a diagnosis leaves, or a drift taken out.
const QUIETER: usize = 2;

/// Diagnoses the motion of the tests; once more with the noise that is left, where that is less than the record showed.
fn of_motion(
    (tests, nominal): (&[(&Record, &ModelSpec)], &ModelSpec),
    options: &Options,
    motion: Motion,
    (mut findings, mut notes): (Vec<(usize, Finding)>, Vec<String>),
    again: usize,
) -> Result<Diagnosis, DiagnoseError> {
    let searcher = Searcher::new(&motion, nominal, options.effort).without(&options.without);
    parts::done("weights");
    let diverges = || DiagnoseError::Diverges { name: nominal.name.clone() };
    let search = searcher.search(nominal, options.thresholds).ok_or_else(diverges)?;
    let mut decision = verdict::decide(&search, &searcher, options.thresholds);
    if again > 0
        && let Some((steadier, drift)) = searcher.steadier(search.best())
    {
        notes.push(format!(
            "the force drifts by {:.2} % of its rms over the record: taken out",
            100.0 * drift
        ));
        return of_motion((tests, nominal), options, steadier, (findings, notes), again - 1);
    }
    if again > 0
        && let Some(quieter) = searcher.quieter(&decision.chosen)
    {
        return of_motion((tests, nominal), options, quieter, (findings, notes), again - 1);
    }
    // Of an explanation that does not hold no numbers are told.
    if decision.verdict != Verdict::OutsideCatalogue {
        decision.chosen = searcher.bounded(decision.chosen);
    }
    parts::done("verdict and limits");
    let gains = searcher.gains(&decision.chosen);
    for (i, finding) in &mut findings {
        gains.get(*i).copied().into_iter().for_each(|gains| finding.sharpen(gains));
    }
    let findings: Vec<Finding> = findings.into_iter().map(|(_, finding)| finding).collect();
    Composer { tests, nominal, options, motion: &motion, searcher: &searcher }
        .compose(&search, decision, &findings, notes)
        .ok_or_else(diverges)
}

/// What is to be said of a record; refuses one that is not fit before any physics is blamed, unless it is to be used anyway.
fn of_record(record: &Record, anyway: bool) -> Result<Vec<String>, DiagnoseError> {
    let text = |finding: quality::Finding| finding.text;
    let (errors, rest): (Vec<_>, Vec<_>) = quality::examine(record)
        .into_iter()
        .partition(|finding| !anyway && finding.severity == quality::Severity::Error);
    if !errors.is_empty() {
        let faults: Vec<String> = errors.into_iter().map(text).collect();
        return Err(DiagnoseError::Unfit { record: record.source.clone(), faults: faults.join("; ") });
    }
    let new = rest.into_iter().map(text).filter(|text| !record.notes.contains(text));
    Ok(record.notes.iter().cloned().chain(new).collect())
}

struct Composer<'a> {
    tests: &'a [(&'a Record, &'a ModelSpec)],
    nominal: &'a ModelSpec,
    options: &'a Options,
    motion: &'a Motion,
    searcher: &'a Searcher<'a>,
}

impl Composer<'_> {
    fn compose(
        &self,
        search: &Search,
        decision: Decision,
        findings: &[Finding],
        notes: Vec<String>,
    ) -> Option<Diagnosis> {
        let problem = self.searcher.problem();
        let chosen = &decision.chosen;
        // Response of both ends of the ladder, simulated once.
        let (with, without) = (self.searcher.errors(chosen)?, self.searcher.errors(&search.base));
        let after = problem.sum(&with, Part::HeldOut)?;
        // As given means as measured: instruments uncorrected.
        let raw = if findings.is_empty() { None } else { self.raw_motion() };
        let raw_problem = raw
            .as_ref()
            .map(|motion| Problem::new(motion, self.nominal, self.options.effort.fitting_samples));
        let before_problem = raw_problem.as_ref().unwrap_or(problem);
        let reidentified = match &raw_problem {
            Some(raw) => {
                let base =
                    trial::base(raw, self.nominal, Some(&search.base.refit), self.searcher.stride())?.refit;
                raw.output_errors(&base.spec, base.zero_m, Part::All)
            }
            None => without.clone(),
        };
        let rung = |model: &str, p: &Problem<'_>, errors: Option<&[(usize, OutputError)]>| {
            let error =
                |part| errors.and_then(|errors| p.sum(errors, part)).map_or(f64::INFINITY, |e| e.nrmse());
            Rung { model: model.to_owned(), training: error(Part::Training), held_out: error(Part::HeldOut) }
        };
        let given = before_problem.output_errors(self.nominal, 0.0, Part::All);
        let mut ladder = vec![
            rung("as given", before_problem, given.as_deref()),
            rung("re-identified", before_problem, reidentified.as_deref()),
        ];
        if !findings.is_empty() {
            let label =
                format!("+ {}", findings.iter().map(|f| f.name.as_str()).collect::<Vec<_>>().join(" + "));
            ladder.push(rung(&label, problem, without.as_deref()));
        }
        for stage in &search.stages {
            if let Some(trial) = stage.finalists.iter().find(|t| chosen.names.starts_with(&t.names)) {
                let label = format!("+ {}", verdict::last_name(trial));
                let own = if trial.names == chosen.names {
                    Some(with.clone())
                } else {
                    self.searcher.errors(trial)
                };
                ladder.push(rung(&label, problem, own.as_deref()));
            }
        }
        let verdict = match (decision.verdict, findings.is_empty()) {
            (Verdict::Adequate, false) => Verdict::Missing,
            (verdict, _) => verdict,
        };
        let mut effects: Vec<NamedEffect> =
            findings.iter().map(|f| instrument_effect(f, ladder.get(2).map(|r| r.held_out))).collect();
        if verdict != Verdict::OutsideCatalogue {
            effects.extend(self.named(search, &decision, problem));
        }
        let refused = self.refused(&decision);
        let left = decision.left;
        Some(Diagnosis {
            verdict,
            effects,
            refused,
            error_before: ladder[0].held_out,
            error_reidentified: ladder[1].held_out,
            error_after: after.nrmse(),
            noise_floor: after.noise_floor(self.motion),
            next_test: if verdict == Verdict::Ambiguous { self.next_test(search, &decision) } else { None },
            ambiguous_with: decision.ambiguous_with,
            missing_force: missing_force::map(problem, &search.base.refit, Part::All),
            steps: self.steps(&without.unwrap_or_default(), &with),
            ladder,
            reidentified: self.reidentified(&chosen.refit),
            not_identifiable: self.not_identifiable(&chosen.refit),
            notes: self.notes(
                chosen,
                findings,
                [notes, self.astray(&chosen.refit), self.late(chosen)].concat(),
            ),
            share_left: left,
            structure_left: chosen.response.as_ref().map(Response::excess),
            wall_s: 0.0,
        })
    }

    /// The motion with the instruments taken as they are.
    fn raw_motion(&self) -> Option<Motion> {
        let part = |(record, model): &(&Record, &ModelSpec)| {
            let motion = Motion::uncorrected(record, model.mass_kg).ok()?;
            Some((motion, Setting::between(self.nominal, model).ok()?))
        };
        Motion::together(self.tests.iter().map(part).collect::<Option<_>>()?).ok()
    }

    fn named(&self, search: &Search, decision: &Decision, problem: &Problem<'_>) -> Vec<NamedEffect> {
        let chosen = &decision.chosen;
        let first = chosen.refit.spec.effects.len() - chosen.names.len();
        let mut out = Vec::new();
        for (i, name) in chosen.names.iter().enumerate() {
            let index = first + i;
            let scales = super::candidates::scales(&chosen.refit.spec, self.motion);
            let units = effects::find(name).map(|e| (e.parameters)(&scales)).unwrap_or_default();
            let mut parameters = std::collections::BTreeMap::new();
            for parameter in units {
                if let Some((value, low95, high95)) =
                    chosen.refit.interval(&format!("effect[{index}].{}", parameter.name))
                {
                    let estimate =
                        ParameterEstimate { value, low95, high95, unit: parameter.unit.to_owned() };
                    parameters.insert(parameter.name.to_owned(), estimate);
                }
            }
            let probability = decision.probabilities.get(i).copied().unwrap_or(verdict::EXPERIENCE);
            let partial = search
                .stages
                .iter()
                .flat_map(|s| &s.finalists)
                .find(|t| t.names == chosen.names[..=i])
                .and_then(|t| problem.sum(&self.searcher.errors(t)?, Part::HeldOut));
            out.push(NamedEffect {
                name: name.clone(),
                probability,
                parameters,
                error_after: partial.map(|e| e.nrmse()),
            });
        }
        out
    }

    fn refused(&self, decision: &Decision) -> Vec<Refused> {
        // The last stage that an effect was tried in speaks.
        let mut out: Vec<Refused> = Vec::new();
        for refused in &decision.refused {
            if decision.chosen.names.contains(&refused.name) {
                continue;
            }
            match out.iter_mut().find(|known| known.name == refused.name) {
                Some(known) => known.clone_from(refused),
                None => out.push(refused.clone()),
            }
        }
        out
    }

    fn next_test(&self, search: &Search, decision: &Decision) -> Option<next_test::NextTest> {
        let reach = self.reach()?;
        let stage =
            search.stages.iter().rfind(|s| s.finalists.iter().any(|t| t.names == decision.chosen.names));
        let chosen = &decision.chosen;
        let finalists = stage.map(|s| s.finalists.as_slice()).unwrap_or_default();
        // As the rivals were told apart: of pairs it may be the first effect that they differ in.
        let own = |trial: &Trial| verdict::own_name(trial, chosen);
        let rival: Option<&Trial> = finalists
            .iter()
            .find(|t| decision.ambiguous_with.contains(&own(t)))
            .or_else(|| finalists.iter().find(|t| own(t) != verdict::own_name(chosen, t)));
        let rival = rival?;
        let first = (verdict::own_name(chosen, rival), own(rival));
        let enough = self.options.thresholds.tie;
        next_test::propose((&first.0, &chosen.refit), (&first.1, &rival.refit), &reach, enough)
    }

    /// What the rig can do, beside what it did.
    fn reach(&self) -> Option<Reach> {
        let frequencies = self.motion.windows.iter().map(|w| w.frequency_hz);
        let (low, high) = frequencies.fold((f64::INFINITY, 0.0_f64), |(l, h), f| (l.min(f), h.max(f)));
        let (stroke_m, velocity_m_s, acceleration_m_s2) =
            self.options.reach.unwrap_or(next_test::PAPERS_TABLE);
        let tried = if self.motion.kind == Kind::Base {
            self.motion.rms(&self.motion.drive_m_s2) * 2f64.sqrt()
        } else {
            return None;
        };
        Some(Reach {
            stroke_m,
            velocity_m_s,
            acceleration_m_s2,
            tried_m_s2: tried,
            tried_hz: (low, high),
            noise_m_s2: self.motion.restoring_noise_m_s2,
            laser_noise_m: self.motion.laser_noise_m,
            rate_hz: 1.0 / self.motion.dt_s(),
        })
    }

    /// The errors step by step; none when one of the two leaves the finite numbers.
    fn steps(&self, without: &[(usize, OutputError)], with: &[(usize, OutputError)]) -> Vec<StepErrors> {
        let finite = |errors: &[(usize, OutputError)]| {
            self.motion.kind == Kind::Component || errors.iter().all(|(_, error)| error.is_finite())
        };
        if !finite(without) || !finite(with) {
            return Vec::new();
        }
        let step = |((k, without), (_, with)): (&(usize, OutputError), &(usize, OutputError))| {
            let window = &self.motion.windows[*k];
            StepErrors {
                step: window.step,
                frequency_hz: window.frequency_hz,
                held_out: window.held_out,
                reidentified: without.nrmse(),
                after: with.nrmse(),
            }
        };
        without.iter().zip(with).map(step).collect()
    }

    fn reidentified(&self, refit: &Refit) -> Vec<Reidentified> {
        refit
            .numbers
            .numbers
            .iter()
            .filter_map(|number| {
                let nominal = self.nominal.get(&number.key).ok()?;
                let (value, low95, high95) = refit.interval(&number.key)?;
                Some(Reidentified { key: number.key.clone(), nominal, value, low95, high95 })
            })
            .collect()
    }

    /// Numbers whose interval is hardly narrower than what the model file allowed.
    fn not_identifiable(&self, refit: &Refit) -> Vec<String> {
        let mut out = Vec::new();
        if self.motion.kind != Kind::Component && !self.motion.tells_mass() {
            out.push(
                "mass_kg against all stiffnesses and dampings together (only force over mass is seen)"
                    .to_owned(),
            );
        }
        for (j, free) in refit.numbers.free.iter().enumerate() {
            if refit.sigmas[j] > 0.7 * free.prior.1 {
                out.push(free.key.clone());
            }
        }
        out
    }

    /// What is to be said of numbers of the model that went far from where its file has them: a guess that is held too tightly leaves a
    /// misfit that effects stand in for.
    fn astray(&self, refit: &Refit) -> Vec<String> {
        let told = |(number, free): (&Number, &Free)| {
            let (given, sigma) = free.prior;
            let (value, ..) = refit.interval(&number.key)?;
            let deviations = (value - given).abs() / sigma;
            let own = self.nominal.get(&number.key).is_ok();
            (own && deviations > ASTRAY).then(|| {
                format!(
                    "{} goes to {value:.4e}, {deviations:.0} deviations from the {given:.4e} of the model file: if that was a guess, give it a wider `uncertainty` there, or an effect may stand in for what it is held back by",
                    number.key
                )
            })
        };
        refit.numbers.numbers.iter().zip(&refit.numbers.free).filter_map(told).collect()
    }

    /// What is to be said of records whose answer is late, or early, against what drives the model by more than a tenth of a sample.
    fn late(&self, chosen: &Trial) -> Vec<String> {
        let Some(measured) = &self.searcher.measured else { return Vec::new() };
        let lags = chosen.lags_s(measured);
        let beyond = |lag: &Estimate| lag.value.abs() > (4.0 * lag.sigma).max(0.1 * self.motion.dt_s());
        let of = |i: usize| if lags.len() > 1 { format!(" of record {}", i + 1) } else { String::new() };
        let told = |(i, lag): (usize, &Estimate)| {
            format!(
                "what answers{} comes {:.0} us {} than what drives it says: followed by the fits, not by the errors told",
                of(i),
                1e6 * lag.value.abs(),
                if lag.value > 0.0 { "later" } else { "earlier" },
            )
        };
        lags.iter().enumerate().filter(|(_, lag)| beyond(lag)).map(told).collect()
    }

    /// What is to be said of the records, and then of the instruments.
    fn notes(&self, chosen: &Trial, findings: &[Finding], mut notes: Vec<String>) -> Vec<String> {
        notes.extend(self.options.without.iter().map(|name| format!("{name} was not tried, as asked for")));
        notes.extend(findings.iter().map(|f| format!("{}: {}", f.name, f.text)));
        if self.motion.kind == Kind::Component && chosen.names.iter().any(|name| name == "constant-force") {
            notes.push("constant-force: a zero of the force sensor looks the same".to_owned());
        }
        notes.extend(self.motion.instruments.as_ref().map(|found| found.told(self.motion.kind)));
        let slow = self.searcher.measured.as_ref().map_or(Vec::new(), Measured::slow_noise_hz);
        notes.extend(slow.iter().enumerate().filter(|(_, corner)| **corner > 0.0).map(|(i, corner)| {
            let of = if slow.len() > 1 { format!(" in record {}", i + 1) } else { String::new() };
            format!(
                "slow noise beside the model{of}: as much as the laser's white one at {corner:.2} Hz, more below; its own drift, or motion that the table's sensors do not show (counted as noise)"
            )
        }));
        notes
    }
}

fn instrument_effect(finding: &Finding, error_after: Option<f64>) -> NamedEffect {
    let parameters = finding
        .parameters
        .iter()
        .map(|(name, e, unit)| {
            let estimate =
                ParameterEstimate { value: e.value, low95: e.low95, high95: e.high95, unit: unit.clone() };
            (name.clone(), estimate)
        })
        .collect();
    NamedEffect { name: finding.name.clone(), probability: 0.99, parameters, error_after }
}
