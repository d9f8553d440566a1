//! The numbers of a model by dotted key, the same for identification, uncertainty, sensitivities
//! and the command line: `mass_kg`, `isolator.stiffness_n_m[1]`, `bumper.total_gap_m`,
//! `effect[0].fc_n`.

use super::{ModelError, ModelSpec};

/// Where a key points.
enum Place<'a> {
    Mass,
    Slope(usize),
    Breakpoint(usize),
    Damping,
    BumperStiffness,
    BumperDamping,
    Gap,
    Effect(usize, &'a str),
}

fn parse(key: &str) -> Option<Place<'_>> {
    Some(match key {
        "mass_kg" => Place::Mass,
        "isolator.stiffness_n_m" => Place::Slope(0),
        "isolator.damping_n_s_m" => Place::Damping,
        "bumper.stiffness_n_m" => Place::BumperStiffness,
        "bumper.damping_n_s_m" => Place::BumperDamping,
        "bumper.total_gap_m" => Place::Gap,
        _ => {
            let (head, rest) = key.split_once('[')?;
            let (index, tail) = rest.split_once(']')?;
            let index = index.parse::<usize>().ok()?;
            match head {
                "isolator.stiffness_n_m" if tail.is_empty() => Place::Slope(index),
                "isolator.breakpoints_m" if tail.is_empty() => Place::Breakpoint(index),
                "effect" => Place::Effect(index, tail.strip_prefix('.')?),
                _ => return None,
            }
        }
    })
}

impl ModelSpec {
    /// Keys of every number in the model, in the order of the file.
    pub fn parameter_keys(&self) -> Vec<String> {
        let mut keys = vec!["mass_kg".to_owned()];
        keys.extend((0..self.isolator.stiffness_n_m.len()).map(|i| format!("isolator.stiffness_n_m[{i}]")));
        keys.extend((0..self.isolator.breakpoints_m.len()).map(|i| format!("isolator.breakpoints_m[{i}]")));
        keys.push("isolator.damping_n_s_m".to_owned());
        if self.bumper.is_some() {
            keys.extend(
                ["bumper.stiffness_n_m", "bumper.damping_n_s_m", "bumper.total_gap_m"].map(str::to_owned),
            );
        }
        for (i, effect) in self.effects.iter().enumerate() {
            keys.extend(effect.parameters.keys().map(|name| format!("effect[{i}].{name}")));
        }
        keys
    }

    /// The number under a key.
    ///
    /// # Errors
    /// [`ModelError::UnknownKey`] with the keys that exist.
    pub fn get(&self, key: &str) -> Result<f64, ModelError> {
        let value = match parse(key) {
            Some(Place::Mass) => Some(self.mass_kg),
            Some(Place::Slope(i)) => self.isolator.stiffness_n_m.get(i).copied(),
            Some(Place::Breakpoint(i)) => self.isolator.breakpoints_m.get(i).copied(),
            Some(Place::Damping) => Some(self.isolator.damping_n_s_m),
            Some(Place::BumperStiffness) => self.bumper.as_ref().map(|b| b.stiffness_n_m),
            Some(Place::BumperDamping) => self.bumper.as_ref().map(|b| b.damping_n_s_m),
            Some(Place::Gap) => self.bumper.as_ref().map(|b| b.total_gap_m),
            Some(Place::Effect(i, name)) => {
                self.effects.get(i).and_then(|effect| effect.parameters.get(name)).copied()
            }
            None => None,
        };
        value.ok_or_else(|| self.unknown_key(key))
    }

    /// Replaces the number under a key; the model is not checked ([`crate::config::Check`] does).
    ///
    /// # Errors
    /// [`ModelError::UnknownKey`] with the keys that exist.
    pub fn set(&mut self, key: &str, value: f64) -> Result<(), ModelError> {
        let slot = match parse(key) {
            Some(Place::Mass) => Some(&mut self.mass_kg),
            Some(Place::Slope(i)) => self.isolator.stiffness_n_m.get_mut(i),
            Some(Place::Breakpoint(i)) => self.isolator.breakpoints_m.get_mut(i),
            Some(Place::Damping) => Some(&mut self.isolator.damping_n_s_m),
            Some(Place::BumperStiffness) => self.bumper.as_mut().map(|b| &mut b.stiffness_n_m),
            Some(Place::BumperDamping) => self.bumper.as_mut().map(|b| &mut b.damping_n_s_m),
            Some(Place::Gap) => self.bumper.as_mut().map(|b| &mut b.total_gap_m),
            Some(Place::Effect(i, name)) => {
                self.effects.get_mut(i).and_then(|effect| effect.parameters.get_mut(name))
            }
            None => None,
        };
        match slot {
            Some(slot) => {
                *slot = value;
                Ok(())
            }
            None => Err(self.unknown_key(key)),
        }
    }

    fn unknown_key(&self, key: &str) -> ModelError {
        ModelError::UnknownKey { key: key.to_owned(), known: self.parameter_keys().join(", ") }
    }
}

#[cfg(test)]
mod tests {
    use crate::model::testing::b1_g2;
    use crate::model::{EffectSpec, ModelError};

    #[test]
    fn every_key_reads_back_what_was_set() {
        let mut spec = b1_g2();
        spec.effects.push(EffectSpec {
            name: "coulomb-friction".into(),
            expression: None,
            parameters: [("fc_n".to_owned(), 12.0)].into(),
        });
        let keys = spec.parameter_keys();
        assert_eq!(keys.len(), 1 + 3 + 2 + 1 + 3 + 1);
        for (i, key) in keys.iter().enumerate() {
            spec.set(key, i as f64 + 0.5).expect("known");
        }
        for (i, key) in keys.iter().enumerate() {
            assert_eq!(spec.get(key).expect("known"), i as f64 + 0.5, "{key}");
        }
        for wrong in ["mass", "isolator.stiffness_n_m[9]", "effect[1].fc_n", "effect[0].fs_n", "bumper[0]"] {
            assert!(matches!(spec.get(wrong), Err(ModelError::UnknownKey { .. })), "{wrong}");
        }
    }
}
