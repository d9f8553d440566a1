//! Explanations that come near each other, fitted to all steps. Numbers that the steps of the fit leave open cost an explanation nats
//! on those held out, the right one as much as its rivals: where mass and isolator resonate one step may say more than all others.
//! That something is missing is decided by steps that no fit has seen; which of two it is, by the evidence of all
//! (MacKay, Neural Computation 4 (1992) 415).

use super::search::Searcher;
use super::trial::{self, Trial};
use super::verdict;
use crate::identify::least_squares::Settings;
use crate::identify::problem::Part;
use crate::identify::response::Measured;
use crate::parallel;

/// Nats within which explanations are near, some three times what such a step has cost the right one; and so many at most are told.
const NEAR: f64 = 60.0;
const MOST: usize = 4;

/// What a fit says of a model.
#[derive(Clone, Copy, Debug)]
pub struct Evidence {
    /// Sum of squares of the residuals and the priors', in units of the noise.
    pub total: f64,
    /// How many residuals count as one independent one.
    pub colour: f64,
    /// What the freedom of its numbers is worth there, nats.
    pub freedom_nats: f64,
}

impl Evidence {
    /// How much likelier it is than another one, its numbers left open, nats.
    pub fn ahead_of(&self, other: &Self) -> f64 {
        let colour = self.colour.min(other.colour).max(1.0);
        0.5 * (other.total - self.total) / colour - (self.freedom_nats - other.freedom_nats)
    }
}

impl Searcher<'_> {
    /// Has those of the explanations beside a model that come near the best told by all steps.
    pub(super) fn told_by_all_steps(&self, finalists: &mut [Trial], from: &Trial) {
        let Some(best) = finalists.iter().reduce(verdict::better) else { return };
        let is_near = |trial: &Trial| verdict::apart(best, trial) < NEAR && verdict::apart(trial, from) > 0.0;
        let mut near: Vec<usize> = (0..finalists.len()).filter(|i| is_near(&finalists[*i])).collect();
        let behind = |i: &usize| verdict::apart(best, &finalists[*i]);
        near.sort_by(|a, b| behind(a).total_cmp(&behind(b)));
        near.truncate(MOST);
        if near.len() < 2 {
            return;
        }
        let Some(measured) = self.measured.as_ref() else { return };
        let all = measured.of_all_steps();
        // Of steps that no fit has seen so far the likeliest tells where jumps are.
        if measured.leaves_steps_out()
            && let Some(fitted) = near.first().and_then(|i| fitted(&all, &finalists[*i]))
            && let Some(response) = &fitted.response
        {
            let laid = [(Part::Training, &response.training), (Part::HeldOut, &response.held_out)];
            all.learn_jumps(&fitted.refit.spec, laid);
        }
        let told = parallel::map(&near, parallel::cores(), |i| whole(&all, &finalists[*i]));
        // Compared alike, or not at all.
        if told.iter().all(Option::is_some) {
            near.into_iter().zip(told).for_each(|(i, whole)| finalists[i].whole = whole);
        }
    }
}

/// What a model says fitted to all steps.
fn whole(measured: &Measured<'_>, trial: &Trial) -> Option<Evidence> {
    let response = fitted(measured, trial)?.response?;
    Some(Evidence { colour: response.left[0].colour, ..response.evidence() })
}

/// A model fitted to all steps from where it stands.
fn fitted(measured: &Measured<'_>, trial: &Trial) -> Option<Trial> {
    trial.response.as_ref()?;
    let settings = Settings { iterations: 20, ..Settings::default() };
    trial::respond(measured, trial, None, settings)
}
