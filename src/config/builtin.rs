//! The configurations that travel inside the binary, so that `shaketable run` works in any folder.
//!
//! A name or path given on the command line is looked up by [`find`]: a file of that path, then
//! `config/<kind>/<name>.toml` below the working folder, then the copy inside the binary.

use super::{Check, ConfigError, parse_toml};
use serde::de::DeserializeOwned;
use std::path::Path;

/// A text of configuration and where it came from.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Source {
    /// File, or `built-in:...`, for messages.
    pub origin: String,
    /// The text.
    pub text: String,
}

impl Source {
    /// Parses and checks the text.
    ///
    /// # Errors
    /// [`ConfigError::Invalid`] with the line in this source.
    pub fn parse<T: DeserializeOwned + Check>(&self) -> Result<T, ConfigError> {
        parse_toml(&self.origin, &self.text)
    }
}

/// Kind (folder below `config/`), name and text of every built-in configuration.
const BUILT_IN: &[(&str, &str, &str)] = &[
    ("rigs", "simulated", include_str!("../../config/rigs/simulated.toml")),
    ("rigs", "simulated-foldback", include_str!("../../config/rigs/simulated-foldback.toml")),
    ("rigs", "lab", include_str!("../../config/rigs/lab.toml")),
    ("models", "andreaus-2020-b0", include_str!("../../config/models/andreaus-2020-b0.toml")),
    (
        "models",
        "andreaus-2020-b0-friction",
        include_str!("../../config/models/andreaus-2020-b0-friction.toml"),
    ),
    ("models", "andreaus-2020-b1-g1", include_str!("../../config/models/andreaus-2020-b1-g1.toml")),
    ("models", "andreaus-2020-b1-g2", include_str!("../../config/models/andreaus-2020-b1-g2.toml")),
    ("models", "andreaus-2020-b1-g3", include_str!("../../config/models/andreaus-2020-b1-g3.toml")),
    ("models", "andreaus-2020-b1-g4", include_str!("../../config/models/andreaus-2020-b1-g4.toml")),
    ("models", "andreaus-2020-b2-g1", include_str!("../../config/models/andreaus-2020-b2-g1.toml")),
    ("models", "andreaus-2020-b2-g2", include_str!("../../config/models/andreaus-2020-b2-g2.toml")),
    ("models", "andreaus-2020-b2-g3", include_str!("../../config/models/andreaus-2020-b2-g3.toml")),
    ("models", "andreaus-2020-b2-g4", include_str!("../../config/models/andreaus-2020-b2-g4.toml")),
    ("models", "andreaus-2020-b3-g1", include_str!("../../config/models/andreaus-2020-b3-g1.toml")),
    ("models", "andreaus-2020-b3-g2", include_str!("../../config/models/andreaus-2020-b3-g2.toml")),
    ("models", "andreaus-2020-b3-g3", include_str!("../../config/models/andreaus-2020-b3-g3.toml")),
    ("models", "andreaus-2020-b3-g4", include_str!("../../config/models/andreaus-2020-b3-g4.toml")),
    ("models", "andreaus-2020-b4-g1", include_str!("../../config/models/andreaus-2020-b4-g1.toml")),
    ("models", "andreaus-2020-b4-g2", include_str!("../../config/models/andreaus-2020-b4-g2.toml")),
    ("models", "andreaus-2020-b4-g3", include_str!("../../config/models/andreaus-2020-b4-g3.toml")),
    ("models", "andreaus-2020-b4-g4", include_str!("../../config/models/andreaus-2020-b4-g4.toml")),
    ("campaigns", "andreaus-2020", include_str!("../../config/campaigns/andreaus-2020.toml")),
    ("campaigns", "hidden-friction", include_str!("../../config/campaigns/hidden-friction.toml")),
    ("publish", "local", include_str!("../../config/publish/local.toml")),
    ("safety", "default", include_str!("../../config/safety.toml")),
    ("sweeps", "andreaus-2020", include_str!("../../config/sweeps/andreaus-2020.toml")),
    ("sweeps", "quick", include_str!("../../config/sweeps/quick.toml")),
    ("sweeps", "log-settled", include_str!("../../config/sweeps/log-settled.toml")),
    ("sweeps", "dwell", include_str!("../../config/sweeps/dwell.toml")),
];

/// Names of the built-in configurations of a kind (`rigs`, `sweeps`, `models`, `campaigns`, `publish`,
/// `safety`).
pub fn names(kind: &str) -> impl Iterator<Item = &'static str> {
    BUILT_IN.iter().filter(move |entry| entry.0 == kind).map(|entry| entry.1)
}

/// Finds a configuration of a kind (`rigs`, `sweeps`, `models`, `campaigns`, `publish`,
/// `safety`) by path or name.
///
/// # Errors
/// [`ConfigError::Unreadable`] with the names there are when nothing is found.
pub fn find(kind: &str, name_or_path: &str) -> Result<Source, ConfigError> {
    let below = Path::new("config").join(kind).join(format!("{name_or_path}.toml"));
    for path in [Path::new(name_or_path), below.as_path()] {
        if path.is_file() {
            let text = std::fs::read_to_string(path).map_err(|error| unreadable(path, &error.to_string()))?;
            return Ok(Source { origin: path.display().to_string(), text });
        }
    }
    match BUILT_IN.iter().find(|entry| entry.0 == kind && entry.1 == name_or_path) {
        Some((_, name, text)) => {
            Ok(Source { origin: format!("built-in:{kind}/{name}.toml"), text: (*text).to_owned() })
        }
        None => {
            let known: Vec<_> = names(kind).collect();
            let reason = format!("no such file, nor a name in {kind}: {}", known.join(", "));
            Err(unreadable(Path::new(name_or_path), &reason))
        }
    }
}

fn unreadable(path: &Path, reason: &str) -> ConfigError {
    ConfigError::Unreadable { path: path.display().to_string(), reason: reason.to_owned() }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rig::RigSpec;
    use crate::sweep::SweepSpec;

    #[test]
    fn every_built_in_configuration_is_valid() {
        for name in names("rigs") {
            let rig: RigSpec = find("rigs", name).and_then(|source| source.parse()).expect("valid rig");
            assert_eq!(rig.name, name);
        }
        for name in names("models") {
            let model: crate::model::ModelSpec =
                find("models", name).and_then(|source| source.parse()).expect("valid model");
            assert_eq!(model.name, name);
        }
        for name in names("campaigns") {
            let campaign: crate::campaign::CampaignSpec =
                find("campaigns", name).and_then(|source| source.parse()).expect("valid campaign");
            assert_eq!(campaign.name, name);
        }
        for name in names("sweeps") {
            let _: SweepSpec = find("sweeps", name).and_then(|source| source.parse()).expect("valid sweep");
        }
        let paper: SweepSpec = find("sweeps", "andreaus-2020").and_then(|s| s.parse()).expect("valid");
        assert_eq!(paper, SweepSpec::paper());
    }

    #[test]
    fn an_unknown_name_lists_the_known_ones() {
        let error = find("rigs", "nowhere").expect_err("unknown").to_string();
        assert!(error.contains("nowhere") && error.contains("simulated-foldback"), "{error}");
    }
}
