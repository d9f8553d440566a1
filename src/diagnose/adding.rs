//! One effect that the user names, fitted to a record on top of a model. `effect add --fit` calls it;
//! the model's own numbers are fitted with it, since an effect beside numbers that are off takes their
//! errors over.

use super::instruments::{self, Estimate95, Finding};
use super::late_force::{self, Lagging};
use super::out_there::out_there;
use super::search::{Effort, Searcher};
use super::thresholds::Thresholds;
use super::trial::{self, Trial};
use super::{candidates, late, verdict};
use crate::identify::kinematics::Tolerances;
use crate::identify::least_squares::Settings;
use crate::identify::motion::{Motion, MotionError};
use crate::identify::problem::{OutputError, Part, Problem};
use crate::identify::refit::{Domain, FittedNumber};
use crate::identify::{answered, holding, readied};
use crate::model::effects::{self, Place};
use crate::model::{EffectSpec, ModelError, ModelSpec, Scales};
use crate::parallel;
use crate::record::Record;
use serde::Serialize;

/// A model with an effect more, fitted to a record.
#[derive(Clone, Debug, Serialize)]
pub struct Added {
    /// The model, the effect its last one.
    pub model: ModelSpec,
    /// What was fitted.
    pub parameters: Vec<FittedNumber>,
    /// NRMSE of the held-out steps: the model as it was given. Instruments are as the record has them where the effect is one of them, else
    /// put right.
    pub error_before: Option<f64>,
    /// Its own numbers re-fitted.
    pub error_reidentified: Option<f64>,
    /// With the effect.
    pub error_after: Option<f64>,
    /// Error that the noise alone leaves.
    pub noise_floor: Option<f64>,
    /// What was done to the record before.
    pub notes: Vec<String>,
}

/// Why an effect could not be fitted.
#[derive(Debug, thiserror::Error)]
pub enum AddError {
    /// The record does not do.
    #[error(transparent)]
    Motion(#[from] MotionError),
    /// The effect is refused.
    #[error(transparent)]
    Model(#[from] ModelError),
    /// No record tells.
    #[error("`{name}` cannot be fitted to a record: {reason}; give its parameters with --param")]
    NotByRecord {
        /// Effect.
        name: String,
        /// Why.
        reason: &'static str,
    },
    /// Below what the instruments may deviate.
    #[error("the record shows no `{name}` beyond the tolerance of the instruments")]
    Sound {
        /// Effect.
        name: String,
    },
    /// The model does not follow the motion of the record.
    #[error("the model gives no finite response to this record {with}")]
    NoResponse {
        /// With or without the effect.
        with: &'static str,
    },
}

/// Adds an effect to a model and fits it to a record. `given` holds starting values; a parameter named
/// in `fixed_start` starts there in every attempt.
///
/// # Errors
/// [`AddError`].
pub fn add(
    record: &Record,
    nominal: &ModelSpec,
    given: &EffectSpec,
    fixed_start: &[&str],
) -> Result<Added, AddError> {
    let effect = effects::find(&given.name)?;
    let refuse = |reason| AddError::NotByRecord { name: given.name.clone(), reason };
    match effect.name {
        "mass-error" => return Err(refuse("only force over mass shows in it")),
        "table-interaction" => return Err(refuse("the measured table acceleration contains it already")),
        _ => {}
    }
    if given.name == "expression" && given.parameters.is_empty() {
        return Err(refuse("it has no parameters"));
    }
    let record = &*readied(record);
    let nominal = &*holding(nominal, [record]);
    let motion = Motion::of(record, nominal.mass_kg, Tolerances::default())?;
    add_along(record, &motion, (nominal, given, fixed_start), true)
}

/// The same along a motion of the record; where it is a component's, it may be put on time.
fn add_along(
    record: &Record,
    motion: &Motion,
    (nominal, given, fixed_start): (&ModelSpec, &EffectSpec, &[&str]),
    may_lag: bool,
) -> Result<Added, AddError> {
    let effect = effects::find(&given.name)?;
    let searcher = Searcher::new(motion, nominal, Effort::default()).only(effect);
    let base = searcher.base(nominal).ok_or(AddError::NoResponse { with: "as it is" })?;
    let errors = |problem: &Problem<'_>, re_fitted: Option<Vec<(usize, OutputError)>>| {
        let given = problem.output_error(nominal, 0.0, Part::HeldOut);
        let re_fitted = re_fitted.and_then(|errors| problem.sum(&errors, Part::HeldOut));
        [given, re_fitted].map(|error| error.map(|e| e.nrmse()))
    };
    let (trial, told, [error_before, error_reidentified]) = if effect.is_instrument() {
        let told = told(record, given, &searcher, &base)?;
        // What it does to the errors shows where instruments are as the record has them.
        let seen = Motion::uncorrected(record, nominal.mass_kg)?;
        let as_seen = Searcher::new(&seen, nominal, Effort::default());
        (base, Some(told), errors(as_seen.problem(), as_seen.errors_as_seen(nominal)))
    } else {
        let trial = fitted(&searcher, nominal, &base, given, fixed_start)
            .ok_or(AddError::NoResponse { with: "with the effect" })?;
        let lagging = may_lag.then(|| late_force::lag(&searcher, nominal, &trial, Thresholds::default()));
        if let Some(lagging) = lagging.flatten().filter(Lagging::is_told) {
            let on_time = answered(motion, lagging.late_s);
            let mut added = add_along(record, &on_time, (nominal, given, fixed_start), false)?;
            added.notes.push(late::said_of_component(lagging.late_s));
            return Ok(added);
        }
        (
            searcher.bounded(searcher.heard_by_itself(trial)),
            None,
            errors(searcher.problem(), searcher.errors(&base)),
        )
    };
    let trial = out_there(record, motion, nominal, trial);
    let after = searcher.held_out_error(&trial);
    let mut added = Added {
        parameters: trial.refit.fitted(&started(nominal, given, &candidates::scales(nominal, motion))),
        error_before,
        error_reidentified,
        error_after: after.map(|e| e.nrmse()),
        noise_floor: after.map(|e| e.noise_floor(motion)),
        model: trial.refit.spec,
        notes: record.notes.clone(),
    };
    if let Some(finding) = told {
        added.take_up(finding, given.clone());
    }
    Ok(added)
}

/// The effect fitted from several starts by force on a thinned record, the best in full and then by the simulated response; from the
/// starts that the response itself puts first, too.
fn fitted(
    searcher: &Searcher<'_>,
    nominal: &ModelSpec,
    base: &Trial,
    given: &EffectSpec,
    fixed_start: &[&str],
) -> Option<Trial> {
    let (effect, motion) = (effects::find(&given.name).ok()?, searcher.motion);
    let scales = candidates::scales(&base.refit.spec, motion);
    let mut starts = vec![given.clone()];
    if effect.place != Place::User {
        starts.extend(searcher.starts(effect, &scales));
    }
    for start in &mut starts {
        let fixed = given.parameters.iter().filter(|(name, _)| fixed_start.contains(&name.as_str()));
        start.parameters.extend(fixed.map(|(name, value)| (name.clone(), *value)));
    }
    let screening = Problem::new(motion, nominal, Effort::default().screening_samples);
    let coarse = Settings { iterations: 10, tolerance: 1e-5, ..Settings::default() };
    let tried = parallel::map(&starts, parallel::cores(), |start| {
        trial::in_force(&screening, &base.refit, start, &scales, coarse)
    });
    let best =
        tried.into_iter().flatten().min_by(|a, b| trial::objective(a).total_cmp(&trial::objective(b)))?;
    let fine = Settings { iterations: 10, tolerance: 1e-6, ..Settings::default() };
    let refit = trial::polish(searcher.problem(), &best, Domain::Force, fine)?;
    let judged = trial::judge_by_force(searcher.problem(), std::slice::from_ref(&given.name), refit)?;
    let mut judged = vec![judged];
    if searcher.measured.is_none() {
        searcher.shape_by_force(&mut judged, &scales);
    }
    // What stands beside it now is another effect.
    let judged = judged.swap_remove(0);
    let by_force = searcher.finish(&judged);
    // As a diagnosis finds it that knows of no other effect.
    let free = fixed_start.is_empty() && effect.place != Place::User;
    let by_response = if free && searcher.measured.is_some() {
        let found = searcher.search(base.clone(), Thresholds::default());
        let mut found = found.stages.into_iter().flat_map(|stage| stage.finalists);
        found.find(|trial| trial.names.last() == Some(&given.name))
    } else {
        None
    };
    match (by_force, by_response) {
        (Some(one), Some(other)) => Some(if verdict::apart(&other, &one) > 0.0 { other } else { one }),
        (one, other) => one.or(other),
    }
}

/// The model with the effect as its fit started; shapes that were left out have been what they are then.
fn started(nominal: &ModelSpec, given: &EffectSpec, scales: &Scales) -> ModelSpec {
    let mut given = given.clone();
    let shapes = effects::find(&given.name).map(|effect| (effect.parameters)(scales)).unwrap_or_default();
    for shape in shapes {
        if let Some(default) = shape.default {
            given.parameters.entry(shape.name.to_owned()).or_insert(default);
        }
    }
    let mut started = nominal.clone();
    started.effects.push(given);
    started
}

/// An instrument's effect as the kinematics tell it, and the response of the model what it tells better.
fn told(
    record: &Record,
    given: &EffectSpec,
    searcher: &Searcher<'_>,
    base: &Trial,
) -> Result<Finding, AddError> {
    let sound = || AddError::Sound { name: given.name.clone() };
    let found = searcher.motion.instruments.as_ref().ok_or_else(sound)?;
    let mut finding = instruments::judge(found, record, Tolerances::default())
        .into_iter()
        .find(|finding| finding.name == given.name)
        .ok_or_else(sound)?;
    if finding.is_gain() {
        searcher.gains(base).first().copied().into_iter().for_each(|gains| finding.sharpen(gains));
    }
    Ok(finding)
}

impl Added {
    /// Takes an instrument's effect up as it was found.
    fn take_up(&mut self, finding: Finding, mut effect: EffectSpec) {
        let index = self.model.effects.len();
        let is_gain = finding.is_gain();
        let given = effect.parameters.clone();
        if is_gain {
            // Of two accelerometers one may be right.
            effect.parameters.values_mut().for_each(|gain| *gain = 1.0);
        }
        for (name, estimate, _) in finding.parameters {
            let Estimate95 { value, low95, high95 } = estimate;
            let left_out = if is_gain { 1.0 } else { f64::NAN };
            let nominal = given.get(&name).copied().unwrap_or(left_out);
            let key = format!("effect[{index}].{name}");
            self.parameters.push(FittedNumber { key, nominal, value, low95, high95, at_limit: false });
            effect.parameters.insert(name, value);
        }
        self.model.effects.push(effect);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::diagnose::testing::{seen, seen_briefly};
    use crate::model::testing::{b1_g2, effect};

    fn found<'a>(added: &'a Added, key: &str) -> &'a FittedNumber {
        added.parameters.iter().find(|p| p.key == key).unwrap_or_else(|| panic!("{key}: not fitted"))
    }

    #[test]
    fn an_effect_is_fitted_with_the_numbers_that_were_off() {
        let mut truth = b1_g2();
        truth.isolator.stiffness_n_m[0] *= 1.04;
        truth.effects.push(effect("coulomb-friction", &[("fc_n", 25.0)]));
        let record = seen(&truth, 3);
        let added = add(&record, &b1_g2(), &effect("coulomb-friction", &[("fc_n", 5.0)]), &[]).expect("fits");
        let (friction, stiffness) =
            (found(&added, "effect[0].fc_n"), found(&added, "isolator.stiffness_n_m[0]"));
        assert!((friction.value - 25.0).abs() < 2.0 && friction.low95 > 15.0, "{friction:?}");
        assert!((stiffness.value / 20.8e3 - 1.0).abs() < 0.02, "{stiffness:?}");
        let (before, after) =
            (added.error_reidentified.expect("held out"), added.error_after.expect("held out"));
        assert!(after < 0.5 * before && after < 2.0 * added.noise_floor.expect("known"), "{before} {after}");
        assert_eq!(added.model.get("effect[0].fc_n").expect("there"), friction.value);
    }

    #[test]
    fn parameters_of_an_expression_and_of_an_instrument_are_fitted() {
        let mut truth = b1_g2();
        truth.effects.push(effect("quadratic-damping", &[("c2_n_s2_m2", 1500.0)]));
        truth.effects.push(effect("laser-delay", &[("dt_s", 1e-3)]));
        let record = seen_briefly(&truth, 4);
        let mut own = effect("expression", &[("c", 300.0)]);
        own.expression = Some("c*v*abs(v)".into());
        let added = add(&record, &b1_g2(), &own, &[]).expect("fits");
        let c = found(&added, "effect[0].c");
        assert!(c.low95 < 1500.0 && c.high95 > 1500.0 && c.low95 > 900.0, "{c:?}");
        let told = add(&record, &b1_g2(), &effect("laser-delay", &[("dt_s", 1e-4)]), &[]).expect("told");
        assert!((told.model.get("effect[0].dt_s").expect("there") - 1e-3).abs() < 2e-5, "{told:?}");
        // Beside a spring that is off.
        let mut off = truth.clone();
        off.effects.remove(0);
        off.isolator.stiffness_n_m[0] *= 1.04;
        let late = effect("laser-delay", &[("dt_s", 1e-4)]);
        let late = add(&seen_briefly(&off, 5), &b1_g2(), &late, &[]).expect("told");
        assert!((late.model.get("effect[0].dt_s").expect("there") - 1e-3).abs() < 2e-5, "{late:?}");
        let stiffness = found(&late, "isolator.stiffness_n_m[0]");
        assert!(
            stiffness.low95 < 20.8e3 && stiffness.high95 > 20.8e3 && stiffness.low95 > 20.7e3,
            "{late:?}"
        );
        assert_eq!(late.model.get("isolator.stiffness_n_m[0]").expect("there"), stiffness.value);
        let [before, reidentified, after, floor] =
            [late.error_before, late.error_reidentified, late.error_after, late.noise_floor]
                .map(|error| error.expect("known"));
        assert!(after < 1.05 * floor && reidentified > 1.5 * floor && before > 2.0 * floor, "{late:?}");
        let gain = add(&record, &b1_g2(), &effect("accelerometer-gain", &[("gain", 1.0)]), &[]);
        assert!(matches!(gain, Err(AddError::Sound { .. })), "{gain:?}");
        // The gain of the second accelerometer, and of both.
        for gains in [[1.0, 1.06], [1.05, 1.05]] {
            let mut scaled = seen_briefly(&b1_g2(), 6);
            scaled.mass_acceleration_1_m_s2.iter_mut().for_each(|a| *a *= gains[0]);
            scaled.mass_acceleration_2_m_s2.iter_mut().for_each(|a| *a *= gains[1]);
            let told = add(&scaled, &b1_g2(), &effect("accelerometer-gain", &[("gain", 1.01)]), &[]);
            let told = told.expect("told");
            for (key, gain) in ["effect[0].gain", "effect[0].gain_2"].into_iter().zip(gains) {
                assert!((told.model.get(key).expect("there") - gain).abs() < 2e-3, "{gains:?}: {told:?}");
            }
        }
        let mass = add(&record, &b1_g2(), &effect("mass-error", &[("dm_kg", 1.0)]), &[]);
        assert!(matches!(mass, Err(AddError::NotByRecord { .. })), "{mass:?}");
    }
}
