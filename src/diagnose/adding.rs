//! One effect that the user names, fitted to a record on top of a model. `effect add --fit` calls it;
//! the model's own numbers are fitted with it, since an effect beside numbers that are off takes their
//! errors over.

use super::out_there::out_there;
use super::search::{Effort, Searcher};
use super::trial::{self, Trial};
use super::{candidates, instruments, verdict};
use crate::identify::kinematics::Tolerances;
use crate::identify::least_squares::Settings;
use crate::identify::motion::{Motion, MotionError};
use crate::identify::problem::{Part, Problem};
use crate::identify::readied;
use crate::identify::refit::{Domain, Refit};
use crate::model::effects::{self, Place};
use crate::model::{EffectSpec, ModelError, ModelSpec, Scales};
use crate::parallel;
use crate::record::Record;
use serde::Serialize;

/// A number that was fitted.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Fitted {
    /// Key in the model file.
    pub key: String,
    /// Value in the model that was given, or where the effect's parameter started.
    pub before: f64,
    /// Best value.
    pub value: f64,
    /// Lower end of the 95 % interval.
    pub low95: f64,
    /// Upper end.
    pub high95: f64,
}

/// A model with an effect more, fitted to a record.
#[derive(Clone, Debug, Serialize)]
pub struct Added {
    /// The model, the effect its last one.
    pub model: ModelSpec,
    /// What was fitted.
    pub parameters: Vec<Fitted>,
    /// NRMSE of the held-out steps: the model as it was given.
    pub error_before: Option<f64>,
    /// Its own numbers re-fitted.
    pub error_reidentified: Option<f64>,
    /// With the effect; none for an instrument: the errors are of what it would have shown had it been sound.
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
    let motion = Motion::of(record, nominal.mass_kg, Tolerances::default())?;
    if effect.is_instrument() {
        return instrument(record, nominal, given, &motion);
    }
    let searcher = Searcher::new(&motion, nominal, Effort::default());
    let base = searcher.base(nominal).ok_or(AddError::NoResponse { with: "as it is" })?;
    let lost = AddError::NoResponse { with: "with the effect" };
    let trial = fitted(&searcher, &motion, nominal, &base, given, fixed_start).ok_or(lost)?;
    let trial = out_there(record, nominal, searcher.bounded(searcher.heard_by_itself(trial)));
    let (refit, after) = (&trial.refit, searcher.held_out_error(&trial));
    Ok(Added {
        parameters: parameters(refit, nominal, given, &candidates::scales(nominal, &motion)),
        error_before: searcher.problem().output_error(nominal, 0.0, Part::HeldOut).map(|e| e.nrmse()),
        error_reidentified: searcher.held_out_error(&base).map(|e| e.nrmse()),
        error_after: after.map(|e| e.nrmse()),
        noise_floor: after.map(|e| e.noise_floor(&motion)),
        model: refit.spec.clone(),
        notes: record.notes.clone(),
    })
}

/// The effect fitted from several starts by force on a thinned record, the best in full and then by the simulated response; from the
/// starts that the response itself puts first, too.
fn fitted(
    searcher: &Searcher<'_>,
    motion: &Motion,
    nominal: &ModelSpec,
    base: &Trial,
    given: &EffectSpec,
    fixed_start: &[&str],
) -> Option<Trial> {
    let effect = effects::find(&given.name).ok()?;
    let scales = candidates::scales(&base.refit.spec, motion);
    let mut starts = vec![given.clone()];
    if effect.place != Place::User {
        starts.extend(candidates::starts(effect, &scales));
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
    let by_force = searcher.finish(&judged);
    // The starts that the response itself puts first, as a diagnosis has them.
    let free = fixed_start.is_empty() && effect.place != Place::User;
    let by_response = if free { searcher.with_effect(base, effect, judged.refit) } else { None };
    match (by_force, by_response) {
        (Some(one), Some(other)) => Some(if verdict::apart(&other, &one) > 0.0 { other } else { one }),
        (one, other) => one.or(other),
    }
}

fn parameters(refit: &Refit, nominal: &ModelSpec, given: &EffectSpec, scales: &Scales) -> Vec<Fitted> {
    let mut started = nominal.clone();
    started.effects.push(given.clone());
    // Shapes that were left out have been what they are then.
    if let (Ok(effect), Some(last)) = (effects::find(&given.name), started.effects.last_mut()) {
        for parameter in (effect.parameters)(scales) {
            if let Some(default) = parameter.default {
                last.parameters.entry(parameter.name.to_owned()).or_insert(default);
            }
        }
    }
    refit
        .numbers
        .numbers
        .iter()
        .filter_map(|number| {
            let (value, low95, high95) = refit.interval(&number.key)?;
            let before = started.get(&number.key).ok()?;
            Some(Fitted { key: number.key.clone(), before, value, low95, high95 })
        })
        .collect()
}

/// An instrument's effect from the kinematics; the model's own numbers are re-fitted to what the instruments would have shown had they been
/// sound.
fn instrument(
    record: &Record,
    nominal: &ModelSpec,
    given: &EffectSpec,
    motion: &Motion,
) -> Result<Added, AddError> {
    let sound = || AddError::Sound { name: given.name.clone() };
    let found = motion.instruments.as_ref().ok_or_else(sound)?;
    let mut finding = instruments::judge(found, record, Tolerances::default())
        .into_iter()
        .find(|finding| finding.name == given.name)
        .ok_or_else(sound)?;
    if let ("accelerometer-gain", Some((_, estimate, _))) =
        (given.name.as_str(), finding.parameters.first_mut())
    {
        // The effect is one of the first accelerometer; the finding may be one of the other.
        let gain = found.accelerometers[0].gain;
        if (gain.value - 1.0).abs() < Tolerances::default().accelerometer_gain + 3.0 * gain.sigma {
            return Err(sound());
        }
        *estimate = gain.into();
    }
    let searcher = Searcher::new(motion, nominal, Effort::default());
    let base = searcher.base(nominal).ok_or(AddError::NoResponse { with: "as it is" })?;
    if finding.is_gain() {
        searcher.gains(&base).first().copied().into_iter().for_each(|gains| finding.sharpen(gains));
    }
    let base = out_there(record, nominal, base);
    let (mut model, mut effect) = (base.refit.spec.clone(), given.clone());
    let index = model.effects.len();
    let mut parameters = parameters(&base.refit, nominal, given, &candidates::scales(nominal, motion));
    for (name, estimate, _) in &finding.parameters {
        let before = effect.parameters.insert(name.clone(), estimate.value).unwrap_or(f64::NAN);
        parameters.push(Fitted {
            key: format!("effect[{index}].{name}"),
            before,
            value: estimate.value,
            low95: estimate.low95,
            high95: estimate.high95,
        });
    }
    model.effects.push(effect);
    let reidentified = searcher.held_out_error(&base);
    Ok(Added {
        model,
        parameters,
        error_before: searcher.problem().output_error(nominal, 0.0, Part::HeldOut).map(|e| e.nrmse()),
        error_reidentified: reidentified.map(|e| e.nrmse()),
        error_after: None,
        noise_floor: reidentified.map(|e| e.noise_floor(motion)),
        notes: record.notes.clone(),
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::diagnose::testing::seen;
    use crate::model::testing::{b1_g2, effect};

    fn found<'a>(added: &'a Added, key: &str) -> &'a Fitted {
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
        let record = seen(&truth, 4);
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
        let late = add(&seen(&off, 5), &b1_g2(), &late, &[]).expect("told");
        assert!((late.model.get("effect[0].dt_s").expect("there") - 1e-3).abs() < 2e-5, "{late:?}");
        let stiffness = found(&late, "isolator.stiffness_n_m[0]");
        assert!(
            stiffness.low95 < 20.8e3 && stiffness.high95 > 20.8e3 && stiffness.low95 > 20.7e3,
            "{late:?}"
        );
        assert_eq!(late.model.get("isolator.stiffness_n_m[0]").expect("there"), stiffness.value);
        let (reidentified, floor) =
            (late.error_reidentified.expect("held out"), late.noise_floor.expect("known"));
        assert!(
            reidentified < 1.05 * floor && late.error_before.expect("held out") > 2.0 * floor,
            "{late:?}"
        );
        let gain = add(&record, &b1_g2(), &effect("accelerometer-gain", &[("gain", 1.0)]), &[]);
        assert!(matches!(gain, Err(AddError::Sound { .. })), "{gain:?}");
        let mass = add(&record, &b1_g2(), &effect("mass-error", &[("dm_kg", 1.0)]), &[]);
        assert!(matches!(mass, Err(AddError::NotByRecord { .. })), "{mass:?}");
    }
}
