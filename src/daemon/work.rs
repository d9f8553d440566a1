//! What is set up for the next run: case, sweep, onboard model with the effects added to it, and what
//! stands on the simulated table. Owned by the desk; every change is checked as the same file would be.

use crate::config::{Case, Check};
use crate::control::setup::{Setup, model_of_case};
use crate::model::{EffectSpec, ModelSpec, Scales, build, effects};
use crate::rig::RigSpec;
use crate::sweep::SweepSpec;

/// Models that can be gone back to.
const MOST_UNDOS: usize = 50;

/// A change that was refused.
#[derive(Debug, thiserror::Error)]
pub enum WorkError {
    /// A value that is not allowed, with its key.
    #[error("{key}: {reason}")]
    Invalid {
        /// Dotted key as in the file.
        key: String,
        /// What is wrong and what is allowed.
        reason: String,
    },
    /// There is nothing to take back.
    #[error("nothing to undo: the model is as it was set")]
    NothingToUndo,
}

/// The work at hand.
#[derive(Clone, Debug)]
pub struct Work {
    /// Case of the paper, if one was named.
    pub case: Option<Case>,
    /// The command.
    pub sweep: SweepSpec,
    /// The onboard model.
    pub model: ModelSpec,
    /// What stands on the simulated table.
    pub specimen: ModelSpec,
    /// Name of the next run.
    pub name: String,
    undo: Vec<ModelSpec>,
}

fn checked(value: &impl Check) -> Result<(), WorkError> {
    value.check().map_err(|(key, reason)| WorkError::Invalid { key, reason })
}

impl Work {
    /// Begins with a case, or a model of one's own; `specimen` is what really stands on the simulated table.
    pub fn new(case: Option<Case>, sweep: SweepSpec, model: ModelSpec, specimen: Option<ModelSpec>) -> Self {
        let name = case.map_or_else(|| model.name.clone(), |case| case.to_string());
        let specimen = specimen.unwrap_or_else(|| model.clone());
        Self { case, sweep, model, specimen, name, undo: Vec::new() }
    }

    /// Everything that defines the next run but for the safety file, which is not the work's to choose.
    pub fn setup(&self, rig: &RigSpec, seed: u64) -> Setup {
        Setup {
            rig: rig.clone(),
            sweep: self.sweep.clone(),
            model: self.model.clone(),
            specimen: self.specimen.clone(),
            case: self.case,
            safety: None,
            seed,
            name: self.name.clone(),
        }
    }

    /// Takes another sweep.
    ///
    /// # Errors
    /// [`WorkError::Invalid`] as the file would be refused.
    pub fn set_sweep(&mut self, sweep: SweepSpec) -> Result<(), WorkError> {
        checked(&sweep)?;
        self.sweep = sweep;
        Ok(())
    }

    /// Takes another case: its bumpers and gap, its acceleration, its published model. Effects stay, on the
    /// model and on what stands on the simulated table.
    pub fn set_case(&mut self, case: Case) {
        let published = model_of_case(&case);
        let effects = std::mem::take(&mut self.model.effects);
        let suffix: String = effects.iter().map(|effect| format!("+{}", effect.name)).collect();
        let keep = |effect: &EffectSpec| {
            published.bumper.is_some() || effects::find(&effect.name).is_ok_and(|found| !found.needs_bumper())
        };
        self.specimen.bumper = published.bumper.clone();
        self.specimen.effects.retain(keep);
        self.model = published.clone();
        self.model.effects = effects.into_iter().filter(keep).collect();
        self.model.name += &suffix;
        self.sweep.acceleration_g = case.acceleration_g;
        self.name = case.to_string();
        self.case = Some(case);
        self.undo.clear();
    }

    /// Takes another onboard model.
    ///
    /// # Errors
    /// [`WorkError::Invalid`] as the file would be refused, or when it cannot be solved.
    pub fn set_model(&mut self, model: ModelSpec, sample_rate_hz: f64) -> Result<(), WorkError> {
        checked(&model)?;
        build(&model, 1.0 / sample_rate_hz)
            .map_err(|error| WorkError::Invalid { key: model.name.clone(), reason: error.to_string() })?;
        if self.undo.len() == MOST_UNDOS {
            self.undo.remove(0);
        }
        self.undo.push(std::mem::replace(&mut self.model, model));
        Ok(())
    }

    /// The onboard model with one more effect; parameters left out get their starting values.
    ///
    /// # Errors
    /// [`WorkError::Invalid`] for an unknown name.
    pub fn with_effect(&self, effect: &EffectSpec, sample_rate_hz: f64) -> Result<ModelSpec, WorkError> {
        let found = effects::find(&effect.name)
            .map_err(|error| WorkError::Invalid { key: "name".into(), reason: error.to_string() })?;
        let scales = Scales::of_spec(&self.model, 1.0 / sample_rate_hz);
        let mut spec = found.starting_spec(&scales);
        spec.parameters.extend(effect.parameters.clone());
        spec.expression = effect.expression.clone();
        let mut model = self.model.clone();
        model.name = format!("{}+{}", model.name, effect.name);
        model.effects.push(spec);
        Ok(model)
    }

    /// Goes back to the model before the last change.
    ///
    /// # Errors
    /// [`WorkError::NothingToUndo`].
    pub fn undo(&mut self) -> Result<(), WorkError> {
        self.model = self.undo.pop().ok_or(WorkError::NothingToUndo)?;
        Ok(())
    }

    /// Changes that can be taken back.
    pub fn undos(&self) -> usize {
        self.undo.len()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeMap;

    fn work() -> Work {
        let case: Case = "B1-G2-0.05".parse().expect("case");
        let mut specimen = model_of_case(&case);
        let coulomb = EffectSpec {
            name: "coulomb-friction".into(),
            expression: None,
            parameters: BTreeMap::from([("fc_n".to_owned(), 15.0)]),
        };
        specimen.effects.push(coulomb);
        Work::new(Some(case), SweepSpec::paper(), model_of_case(&case), Some(specimen))
    }

    #[test]
    fn another_case_keeps_the_effects_that_still_act() {
        let mut work = work();
        let stiffening = EffectSpec {
            name: "bumper-stiffening".into(),
            expression: None,
            parameters: BTreeMap::from([("kb3_n_m3".to_owned(), 1e9)]),
        };
        let model = work.with_effect(&stiffening, 2048.0).expect("known");
        work.set_model(model, 2048.0).expect("valid");
        work.set_case("B2-G3-0.04".parse().expect("case"));
        assert_eq!(work.specimen.bumper, model_of_case(&"B2-G3-0.04".parse().expect("case")).bumper);
        assert_eq!((work.specimen.effects.len(), work.model.effects.len()), (1, 1));
        assert_eq!(work.sweep.acceleration_g, 0.04);
        work.set_case("B0-0.03".parse().expect("case"));
        assert!(work.model.effects.is_empty() && work.specimen.effects.len() == 1);
    }

    #[test]
    fn an_effect_is_added_and_taken_back() {
        let mut work = work();
        let before = work.model.clone();
        let effect =
            EffectSpec { name: "coulomb-friction".into(), expression: None, parameters: BTreeMap::new() };
        let with = work.with_effect(&effect, 2048.0).expect("known");
        assert!(with.effects[0].parameters["fc_n"] > 0.0);
        work.set_model(with, 2048.0).expect("valid");
        work.undo().expect("one to undo");
        assert_eq!(work.model, before);
        assert!(matches!(work.undo(), Err(WorkError::NothingToUndo)));
        let mut heavy = before;
        heavy.mass_kg = -1.0;
        assert!(matches!(work.set_model(heavy, 2048.0), Err(WorkError::Invalid { .. })));
    }
}
