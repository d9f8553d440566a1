//! The part of the search that the force along the measured motion decides: candidates are fitted by it, and the best are judged by the
//! held-out steps.

use super::by_response::first_of_each;
use super::search::Searcher;
use super::trial::{self, Trial};
use super::{candidates, verdict};
use crate::identify::least_squares::Settings;
use crate::identify::refit::{Domain, Refit};
use crate::model::effects::{self, Effect};
use crate::model::{EffectSpec, Scales};
use crate::parallel;

/// Starts of an effect that the force sorts out where the response does so, too, and of a long record.
const FEW: usize = 5;
const FEWER: usize = 3;
/// So many effects go on from there.
const GOING_ON: usize = 10;
/// So many finalists are simulated at most, those within so many nats of the best.
const SIMULATED: usize = 3;
const CLOSE: f64 = 50.0;

impl Searcher<'_> {
    /// The best fit of every effect on the thinned record, best first: all starts take two steps, the best of
    /// an effect goes on, the best two where no response sorts them out.
    pub(super) fn screen(
        &self,
        base: &Refit,
        effects: &[&'static Effect],
        scales: &Scales,
    ) -> Vec<(&'static str, Refit)> {
        let first = Settings { iterations: 2, ..Settings::default() };
        let then = Settings { iterations: 8, tolerance: 1e-5, ..Settings::default() };
        // Where there is a response, it sorts the others out.
        let most = match &self.measured {
            Some(measured) if measured.is_long() => FEWER,
            Some(_) => FEW,
            None => usize::MAX,
        };
        // A springpot's many states beside a joint that opens and closes take a minute.
        let joint = base.spec.effects.iter().any(|effect| effect.name == "backlash");
        let quick =
            |e: &&&'static Effect| !(joint && e.name == "fractional-damping" && self.measured.is_some());
        let work: Vec<(&'static str, EffectSpec)> = effects
            .iter()
            .filter(quick)
            .flat_map(|e| self.starts(e, scales).into_iter().take(most).map(|s| (e.name, s)))
            .collect();
        let tried = parallel::map(&work, parallel::cores(), |(name, start)| {
            trial::in_force(&self.screening, base, start, scales, first).map(|refit| (*name, refit))
        });
        let mut tried: Vec<(&'static str, Refit)> = tried.into_iter().flatten().collect();
        tried.sort_by(|a, b| trial::objective(&a.1).total_cmp(&trial::objective(&b.1)));
        let most = if self.measured.is_some() { 1 } else { 2 };
        first_of_each(&mut tried, |_| most, |(_, refit)| refit.spec.effects.last());
        if self.measured.is_some() {
            tried.truncate(GOING_ON);
        }
        let fitted = parallel::map(&tried, parallel::cores(), |(name, refit)| {
            trial::polish(&self.screening, refit, Domain::Force, then).map(|refit| (*name, refit))
        });
        let mut best: Vec<(&'static str, Refit)> = Vec::new();
        for (name, refit) in fitted.into_iter().flatten() {
            match best.iter_mut().find(|(n, _)| *n == name) {
                Some((_, old)) if trial::objective(&refit) < trial::objective(old) => *old = refit,
                Some(_) => {}
                None => best.push((name, refit)),
            }
        }
        best.sort_by(|a, b| trial::objective(&a.1).total_cmp(&trial::objective(&b.1)));
        best
    }

    /// Fits those that passed in full, ranks them by force on held-out steps, and has the best of
    /// them simulated.
    pub(super) fn finalists(&self, from: &Trial, best: &[(&'static str, Refit)]) -> Vec<Trial> {
        let fitted = parallel::map(best, parallel::cores(), |(name, refit)| {
            let mut names = from.names.clone();
            names.push((*name).to_owned());
            let fine = Settings { iterations: 10, tolerance: 1e-6, ..Settings::default() };
            let mut fit = trial::polish(&self.fitting, refit, Domain::Force, fine)?;
            // What contains the model cannot fit worse than it: the fit of the thinned record led astray.
            if trial::objective(&fit) > from.objective {
                let other = trial::polish(&self.fitting, &self.beside(from, refit), Domain::Force, fine);
                fit = other.filter(|o| trial::objective(o) < trial::objective(&fit)).unwrap_or(fit);
            }
            trial::judge_by_force(&self.fitting, &names, fit)
        });
        let mut finalists: Vec<Trial> = fitted.into_iter().flatten().collect();
        let scales = candidates::scales(&from.refit.spec, self.motion);
        self.shape_by_force(&mut finalists, &scales);
        finalists.sort_by(|a, b| a.force.chi2.total_cmp(&b.force.chi2));
        let close = finalists
            .iter()
            .take(SIMULATED)
            .filter(|t| verdict::gain(&finalists[0], t) < CLOSE)
            .cloned()
            .collect::<Vec<_>>();
        let simulated =
            parallel::map(&close, parallel::cores(), |t| trial::finish(&self.fitting, t, self.stride));
        for (slot, trial) in finalists.iter_mut().zip(simulated) {
            if let Some(trial) = trial {
                *slot = trial;
            }
        }
        finalists
    }

    /// A trial fitted by the force along the measured motion, and judged by it.
    pub(super) fn fitted_by_force(&self, trial: &Trial) -> Option<Trial> {
        let fine = Settings { iterations: 20, tolerance: 1e-6, ..Settings::default() };
        let refit = trial::polish(&self.fitting, &trial.refit, Domain::Force, fine)?;
        trial::judge_by_force(&self.fitting, &trial.names, refit)
    }

    /// Trials fitted so, the one that explains most.
    pub(super) fn likeliest_by_force(&self, starts: &[Trial]) -> Option<Trial> {
        let fitted = parallel::map(starts, parallel::cores(), |start| self.fitted_by_force(start));
        let better = |best, trial| if verdict::apart(&trial, &best) > 0.0 { trial } else { best };
        fitted.into_iter().flatten().reduce(better)
    }

    /// The model that a candidate was added to, with the candidate all but absent and shaped as it was fitted.
    fn beside(&self, from: &Trial, fitted: &Refit) -> Refit {
        let base = self.fitted.as_ref().filter(|_| from.names.is_empty()).unwrap_or(&from.refit);
        let mut start = Refit { zero_m: base.zero_m, ..fitted.clone() };
        for number in &base.numbers.numbers {
            if let Ok(value) = base.spec.get(&number.key) {
                // Every number of the base is one of the candidate's.
                let _ = start.spec.set(&number.key, value);
            }
        }
        let scales = candidates::scales(&base.spec, self.motion);
        if let Some(last) = start.spec.effects.last_mut()
            && let Ok(effect) = effects::find(&last.name)
        {
            let faint = effect.starting_spec(&scales);
            let leading = (effect.parameters)(&scales).first().map(|p| p.name);
            match leading.and_then(|name| faint.parameters.get_key_value(name)) {
                // In place of the bumper's line: only both of its numbers together leave things as they are.
                _ if last.name == "hertz-contact" => *last = faint,
                Some((name, value)) => {
                    last.parameters.insert(name.clone(), *value);
                }
                None => {}
            }
        }
        start
    }
}
