//! The answer of a diagnosis: what was decided, with its errors, numbers, intervals and notes.

use super::anew::ASTRAY;
use super::engine::Options;
use super::instruments::Finding;
use super::missing_force::MissingForce;
use super::next_test::{self, Reach};
use super::report::{Diagnosis, Left, NamedEffect, ParameterEstimate, Rung, StepErrors};
use super::search::{Search, Searcher};
use super::trial::{Response, Trial};
use super::verdict::{self, Decision, Refused, Verdict};
use super::{late, laws, missing_force};
use crate::identify::least_squares::Free;
use crate::identify::motion::Motion;
use crate::identify::numbers::Number;
use crate::identify::problem::{OutputError, Part, Problem};
use crate::identify::refit::Refit;
use crate::identify::response::Measured;
use crate::identify::together::Setting;
use crate::model::{EffectSpec, ModelSpec, effects};
use crate::record::{Kind, Record};
use std::collections::BTreeSet;

/// Share of the missing force by which a sum of terms explains more than a law before it is the draft.
const AS_WELL: f64 = 0.01;

/// What an answer is put together from.
pub(super) struct Composer<'a> {
    pub(super) tests: &'a [(&'a Record, &'a ModelSpec)],
    pub(super) nominal: &'a ModelSpec,
    pub(super) options: &'a Options,
    pub(super) motion: &'a Motion,
    pub(super) searcher: &'a Searcher<'a>,
}

impl Composer<'_> {
    /// The whole answer; nothing where a response leaves the finite numbers.
    pub(super) fn compose(
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
        let seen = if findings.is_empty() { None } else { self.seen() };
        let as_seen = seen.as_ref().map(|motion| Searcher::new(motion, self.nominal, self.options.effort));
        let (before_problem, reidentified) = match &as_seen {
            Some(searcher) => (searcher.problem(), searcher.errors_as_seen(self.nominal)),
            None => (problem, without.clone()),
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
        // What was made leaner in the end, or a law, was at no stage.
        let stages = search.stages.iter().flat_map(|stage| &stage.finalists);
        if !chosen.names.is_empty() && stages.clone().all(|trial| trial.names != chosen.names) {
            ladder.push(rung(&format!("+ {}", chosen.names.join(" + ")), problem, Some(&with)));
        }
        let verdict = match (decision.verdict, findings.is_empty()) {
            (Verdict::Adequate, false) => Verdict::Missing,
            (verdict, _) => verdict,
        };
        let mut effects: Vec<NamedEffect> =
            findings.iter().map(|f| instrument_effect(f, ladder.get(2).map(|r| r.held_out))).collect();
        if verdict != Verdict::OutsideCatalogue {
            effects.extend(self.named(search, &decision));
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
            missing_force: self.missing_force(search, chosen, verdict),
            model: found(chosen, findings),
            left: self.left(chosen, verdict, after.nrmse() / after.noise_floor(self.motion)),
            steps: self.steps(&without.unwrap_or_default(), &with),
            ladder,
            reidentified: chosen.refit.fitted(self.nominal),
            not_identifiable: self.not_identifiable(&chosen.refit),
            notes: self.notes(
                chosen,
                findings,
                [notes, astray(&chosen.refit), late::said(self.searcher, chosen)].concat(),
            ),
            share_left: left,
            structure_left: chosen.response.as_ref().map(Response::excess),
            wall_s: 0.0,
        })
    }

    /// The motion with the instruments taken as they are.
    fn seen(&self) -> Option<Motion> {
        let part = |(record, model): &(&Record, &ModelSpec)| {
            let motion = Motion::uncorrected(record, model.mass_kg).ok()?;
            Some((motion, Setting::between(self.nominal, model).ok()?))
        };
        Motion::together(self.tests.iter().map(part).collect::<Option<_>>()?).ok()
    }

    /// What the re-identified model lacks, and a draft of it: the law, where there is one that explains as much, or a sum of terms. Of
    /// what is adequate nothing is drafted.
    fn missing_force(&self, search: &Search, chosen: &Trial, verdict: Verdict) -> Option<MissingForce> {
        let force = missing_force::map(self.searcher.problem(), &search.base.refit, Part::All)?;
        if verdict == Verdict::Adequate {
            return Some(MissingForce { expression: None, ..force });
        }
        let law = laws::draft(chosen, &search.base, self.searcher);
        let of_terms = force.expression.as_ref().map_or(0.0, |terms| terms.explains);
        let expression = law.filter(|law| law.explains + AS_WELL > of_terms).or(force.expression);
        Some(MissingForce { expression, ..force })
    }

    fn named(&self, search: &Search, decision: &Decision) -> Vec<NamedEffect> {
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
                .and_then(|t| self.searcher.held_out_error(t));
            out.push(NamedEffect {
                name: name.clone(),
                probability,
                parameters,
                error_after: partial.map(|e| e.nrmse()),
            });
        }
        out
    }

    /// What is left beside effects that were named all the same.
    fn left(&self, chosen: &Trial, verdict: Verdict, times_noise: f64) -> Option<Left> {
        let more = times_noise > self.options.thresholds.most_over_noise(self.motion);
        let named = !chosen.names.is_empty() && verdict != Verdict::OutsideCatalogue;
        let force = || missing_force::map(self.searcher.problem(), &chosen.refit, Part::All);
        (more && named).then(|| Left { times_noise, force: force() })
    }

    fn refused(&self, decision: &Decision) -> Vec<Refused> {
        // The last stage that an effect was tried in speaks.
        let mut out: Vec<Refused> = Vec::new();
        for refused in &decision.refused {
            if [&decision.chosen.names, &decision.ambiguous_with]
                .iter()
                .any(|said| said.contains(&refused.name))
            {
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
        let Some(reach) = self.reach() else {
            return Some(next_test::elsewhere(&first.0, &first.1, self.motion.kind));
        };
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
                noise_floor: with.noise_floor(self.motion),
            }
        };
        without.iter().zip(with).map(step).collect()
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

    /// What is to be said of the records, and then of the instruments.
    fn notes(&self, chosen: &Trial, findings: &[Finding], mut notes: Vec<String>) -> Vec<String> {
        notes.extend(self.options.without.iter().map(|name| format!("{name} was not tried, as asked for")));
        notes.extend(findings.iter().map(|f| format!("{}: {}", f.name, f.text)));
        let zeros = match self.motion.kind {
            Kind::Base => None,
            Kind::Force => Some("of the sensor of the force, or of the displacement,"),
            Kind::Component => Some("of the force sensor"),
        };
        if let Some(of) = zeros.filter(|_| chosen.names.iter().any(|name| name == "constant-force")) {
            notes.push(format!("constant-force: a zero {of} looks the same"));
        }
        notes.extend(self.motion.instruments.as_ref().map(|found| found.told(self.motion.kind)));
        let slow = self.searcher.measured.as_ref().map_or(Vec::new(), Measured::slow_noise_hz);
        notes.extend(slow.iter().enumerate().filter(|(_, corner)| **corner > 0.0).map(|(i, corner)| {
            let of = if slow.len() > 1 { format!(" in record {}", i + 1) } else { String::new() };
            format!(
                "slow noise beside the model{of}: as much as the displacement sensor's white one at {corner:.2} Hz, more below; its own drift, or motion of what the mass stands on that no sensor shows (counted as noise)"
            )
        }));
        // What was said before records were taken otherwise is said of those again.
        let mut said = BTreeSet::new();
        notes.retain(|note| said.insert(note.clone()));
        notes
    }
}

/// What is to be said of numbers of the model that went far from where its file has them: a guess that is held too tightly leaves a
/// misfit that effects stand in for. Those of effects are held by what is usual, not by the file.
pub(super) fn astray(refit: &Refit) -> Vec<String> {
    let of_effects = |key: &str| key.starts_with("effect[");
    let told = |(number, free): (&Number, &Free)| {
        let (given, sigma) = free.prior;
        let (value, ..) = refit.interval(&number.key)?;
        let deviations = (value - given).abs() / sigma;
        (!of_effects(&number.key) && deviations > ASTRAY).then(|| {
            format!(
                "{} goes to {value:.4e}, {deviations:.0} deviations from the {given:.4e} of the model file: if that was a guess, give it a wider `uncertainty` there, or an effect may stand in for what it is held back by",
                number.key
            )
        })
    };
    refit.numbers.numbers.iter().zip(&refit.numbers.free).filter_map(told).collect()
}

/// The model of a trial, with what the instruments do.
fn found(chosen: &Trial, findings: &[Finding]) -> ModelSpec {
    let mut model = chosen.refit.spec.clone();
    model.effects.extend(findings.iter().map(|finding| EffectSpec {
        name: finding.name.clone(),
        expression: None,
        parameters: finding.parameters.iter().map(|(name, of, _)| (name.clone(), of.value)).collect(),
    }));
    let names = findings.iter().map(|finding| &finding.name).chain(&chosen.names);
    model.name = names.fold(model.name, |name, effect| format!("{name}+{effect}"));
    model
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
