//! The effect catalogue: one file an effect, each with its equation, source, parameters, priors and
//! what it adds to the compiled [`System`]. The command line lists it, identification and diagnosis
//! draw candidates from it, the solvers get their terms from it.
//!
//! A new effect is a file with a `pub static EFFECT` and one line in [`CATALOGUE`].

mod accelerometer_delay;
mod accelerometer_gain;
mod backlash;
mod bouc_wen_hysteresis;
mod bumper_preload;
mod bumper_stiffening;
mod constant_force;
pub(crate) mod coulomb_friction;
mod cubic_stiffness;
pub mod expression;
pub(super) mod fractional_damping;
mod gap_asymmetry;
mod hertz_contact;
mod hunt_crossley_damping;
mod iwan_hysteresis;
mod laser_delay;
mod laser_gain;
mod mass_error;
pub mod maxwell_branch;
mod parameter;
mod quadratic_damping;
mod stand_compliance;
mod stiffness_degradation;
pub mod stribeck_friction;
mod table_interaction;
#[cfg(test)]
mod tests;
mod yaw_rotation;

pub use expression::Expression;
pub use parameter::{Parameter, Sign, Values, unit_behind};

use super::scales::Scales;
use super::system::System;
use super::{EffectSpec, ModelError, ModelSpec};

/// Every effect, in the order of suspicion within its place.
pub static CATALOGUE: &[&Effect] = &[
    &coulomb_friction::EFFECT,
    &stribeck_friction::EFFECT,
    &quadratic_damping::EFFECT,
    &cubic_stiffness::EFFECT,
    &bouc_wen_hysteresis::EFFECT,
    &iwan_hysteresis::EFFECT,
    &maxwell_branch::EFFECT,
    &fractional_damping::EFFECT,
    &stiffness_degradation::EFFECT,
    &backlash::EFFECT,
    &hertz_contact::EFFECT,
    &hunt_crossley_damping::EFFECT,
    &bumper_stiffening::EFFECT,
    &bumper_preload::EFFECT,
    &gap_asymmetry::EFFECT,
    &stand_compliance::EFFECT,
    &constant_force::EFFECT,
    &mass_error::EFFECT,
    &yaw_rotation::EFFECT,
    &table_interaction::EFFECT,
    &laser_delay::EFFECT,
    &laser_gain::EFFECT,
    &accelerometer_gain::EFFECT,
    &accelerometer_delay::EFFECT,
    &expression::EFFECT,
];

/// Where on the rig an effect sits.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Place {
    /// The spherical bearings and their guides.
    Bearings,
    /// The isolator between mass and table.
    Isolator,
    /// The joint in series with the isolator.
    Joint,
    /// The bumpers.
    Bumper,
    /// The stands that carry the bumpers.
    Stand,
    /// The rig as a whole.
    Rig,
    /// The measuring instruments, not the motion.
    Instrument,
    /// The user's own term.
    User,
}

/// Whether a model with these effects stays piecewise linear.
pub fn are_piecewise_linear(effects: &[EffectSpec]) -> bool {
    effects.iter().all(|own| find(&own.name).is_ok_and(|effect| effect.is_piecewise_linear(own)))
}

/// One entry of the catalogue.
pub struct Effect {
    /// Public name, the same word everywhere.
    pub name: &'static str,
    /// Where it sits.
    pub place: Place,
    /// Its equation; a force on the mass that opposes motion is positive.
    pub equation: &'static str,
    /// Paper or book.
    pub source: &'static str,
    /// States it adds, in words; empty for none.
    pub states: &'static str,
    /// Regime where it acts.
    pub regime: &'static str,
    /// How it shows in the plots.
    pub shows: &'static str,
    /// The experiment that makes it visible.
    pub experiment: &'static str,
    /// A model with only such effects stays piecewise linear (exact propagator).
    pub piecewise_linear: bool,
    /// Parameters with priors for a rig of the given magnitudes.
    pub parameters: fn(&Scales) -> Vec<Parameter>,
    /// Adds the effect to a compiled model.
    pub install: fn(&Values<'_>, &mut System) -> Result<(), ModelError>,
}

impl Effect {
    /// Acts on the measured channels only, not on the motion.
    pub fn is_instrument(&self) -> bool {
        self.place == Place::Instrument || self.name == "yaw-rotation"
    }

    /// A model with only such effects, with these parameters, stays piecewise linear.
    fn is_piecewise_linear(&self, spec: &EffectSpec) -> bool {
        let smooth = spec.parameters.get(coulomb_friction::TURNING).is_some_and(|over| *over > 0.0);
        self.piecewise_linear && !smooth
    }

    /// Needs a model with bumpers.
    pub fn needs_bumper(&self) -> bool {
        matches!(self.place, Place::Bumper | Place::Stand)
    }

    /// An [`EffectSpec`] with the starting value of every parameter that has to be given.
    pub fn starting_spec(&self, scales: &Scales) -> EffectSpec {
        let parameters = (self.parameters)(scales);
        EffectSpec {
            name: self.name.to_owned(),
            expression: None,
            parameters: parameters
                .iter()
                .filter(|p| p.default.is_none())
                .map(|p| (p.name.to_owned(), p.start))
                .collect(),
        }
    }
}

/// Finds an effect by its public name.
///
/// # Errors
/// [`ModelError::UnknownEffect`] with all names.
pub fn find(name: &str) -> Result<&'static Effect, ModelError> {
    CATALOGUE.iter().copied().find(|effect| effect.name == name).ok_or_else(|| ModelError::UnknownEffect {
        name: name.to_owned(),
        known: CATALOGUE.iter().map(|effect| effect.name).collect::<Vec<_>>().join(", "),
    })
}

/// Checks one effect of a model: name, parameter names, values, what it needs.
pub(super) fn check(index: usize, spec: &EffectSpec, model: &ModelSpec) -> Result<(), ModelError> {
    let key = |name: &str| format!("effect[{index}].{name}");
    let effect = find(&spec.name)?;
    if effect.needs_bumper() && model.bumper.is_none() {
        return Err(ModelError::invalid(key("name"), format!("`{}` needs a model with [bumper]", spec.name)));
    }
    if spec.name == expression::EFFECT.name {
        return expression::check(spec, &key);
    }
    if spec.expression.is_some() {
        return Err(ModelError::invalid(key("expression"), "only an `expression` effect has one"));
    }
    let parameters = (effect.parameters)(&Scales::of_spec(model, 1.0 / crate::units::SAMPLE_RATE_HZ));
    for name in spec.parameters.keys() {
        if !parameters.iter().any(|p| p.name == name) {
            let known = parameters.iter().map(|p| p.name).collect::<Vec<_>>().join(", ");
            return Err(ModelError::invalid(
                key(name),
                format!("`{}` has no such parameter; allowed: {known}", spec.name),
            ));
        }
    }
    for parameter in &parameters {
        match spec.parameters.get(parameter.name) {
            Some(value) => {
                parameter.check(*value).map_err(|reason| ModelError::invalid(key(parameter.name), reason))?
            }
            None if parameter.default.is_none() => {
                return Err(ModelError::invalid(
                    key(parameter.name),
                    format!("missing ({}, {})", parameter.about, parameter.unit),
                ));
            }
            None => {}
        }
    }
    Ok(())
}

/// Adds every effect of a model to its compiled form, in the order of the file.
pub(super) fn install_all(model: &ModelSpec, system: &mut System) -> Result<(), ModelError> {
    for (index, spec) in model.effects.iter().enumerate() {
        check(index, spec, model)?;
        let effect = find(&spec.name)?;
        let parameters = (effect.parameters)(&Scales::of_spec(model, system.sample_period_s));
        (effect.install)(&Values::new(index, spec, &parameters, model), system)?;
    }
    Ok(())
}
