//! Reading TOML so that every mistake is answered with file, line, reason and allowed range.

pub mod builtin;
pub mod case;
pub mod published;

pub use case::Case;

use miette::{Diagnostic, NamedSource, SourceSpan};
use serde::de::DeserializeOwned;
use std::path::Path;
use std::sync::Arc;

/// A configuration that was refused.
#[derive(Debug, thiserror::Error, Diagnostic)]
pub enum ConfigError {
    /// The file could not be read.
    #[error("cannot read {path}: {reason}")]
    Unreadable {
        /// Path as given.
        path: String,
        /// What the operating system said.
        reason: String,
    },
    /// The text is not what is expected there: syntax, unknown key, wrong type, value out of range.
    #[error("{file}:{line}: {reason}")]
    Invalid {
        /// File as given.
        file: String,
        /// Line, from 1.
        line: usize,
        /// What is wrong, and what is allowed.
        reason: String,
        /// The text, for the excerpt.
        #[source_code]
        text: Arc<NamedSource<String>>,
        /// Where in the text.
        #[label("here")]
        span: SourceSpan,
    },
}

/// A configuration whose numbers can be checked after parsing.
pub trait Check {
    /// Reports the first impossible value as (dotted key, what is wrong and what is allowed).
    ///
    /// # Errors
    /// The key and the reason; the caller adds file and line.
    fn check(&self) -> Result<(), (String, String)>;
}

/// Reads, parses and checks a TOML file.
///
/// # Errors
/// [`ConfigError`] with file, line, reason and allowed range.
pub fn read_toml<T: DeserializeOwned + Check>(path: &Path) -> Result<T, ConfigError> {
    let text = std::fs::read_to_string(path).map_err(|error| ConfigError::Unreadable {
        path: path.display().to_string(),
        reason: error.to_string(),
    })?;
    parse_toml(&path.display().to_string(), &text)
}

/// Parses and checks TOML text; `file` is only for messages.
///
/// # Errors
/// [`ConfigError::Invalid`].
pub fn parse_toml<T: DeserializeOwned + Check>(file: &str, text: &str) -> Result<T, ConfigError> {
    let value: T = toml::from_str(text)
        .map_err(|error| invalid(file, text, error.span().unwrap_or(0..0), error.message().to_owned()))?;
    value
        .check()
        .map_err(|(key, reason)| invalid(file, text, locate(text, &key), format!("{key}: {reason}")))?;
    Ok(value)
}

fn invalid(file: &str, text: &str, span: std::ops::Range<usize>, reason: String) -> ConfigError {
    let start = span.start.min(text.len());
    ConfigError::Invalid {
        file: file.to_owned(),
        line: text[..start].matches('\n').count() + 1,
        reason,
        text: Arc::new(NamedSource::new(file, text.to_owned())),
        span: (start..span.end.clamp(start, text.len())).into(),
    }
}

/// Byte range of the value of a dotted key (`isolator.stiffness_n_m`, `effect[0].fc_n`).
fn locate(text: &str, key: &str) -> std::ops::Range<usize> {
    let Ok(table) = toml::de::DeTable::parse(text) else { return 0..0 };
    let mut span = table.span();
    let mut value: Option<&toml::de::DeValue<'_>> = None;
    for part in key.split('.') {
        let (name, index) = match part.split_once('[') {
            Some((name, rest)) => (name, rest.trim_end_matches(']').parse::<usize>().ok()),
            None => (part, None),
        };
        let next = match value {
            None => table.get_ref().get(name),
            Some(toml::de::DeValue::Table(inner)) => inner.get(name),
            Some(_) => None,
        };
        let Some(mut found) = next else { break };
        if let (Some(index), toml::de::DeValue::Array(items)) = (index, found.get_ref())
            && let Some(item) = items.get(index)
        {
            found = item;
        }
        span = found.span();
        value = Some(found.get_ref());
    }
    span
}

#[cfg(test)]
mod tests {
    use super::*;

    #[derive(Debug, serde::Deserialize)]
    #[serde(deny_unknown_fields)]
    struct Gap {
        gap_m: f64,
    }

    impl Check for Gap {
        fn check(&self) -> Result<(), (String, String)> {
            if self.gap_m > 0.0 {
                Ok(())
            } else {
                Err(("gap_m".into(), format!("{} m; allowed: above 0 m", self.gap_m)))
            }
        }
    }

    #[test]
    fn mistakes_name_their_line() {
        let impossible = parse_toml::<Gap>("a.toml", "# gap\ngap_m = -1.0\n").expect_err("refused");
        assert_eq!(impossible.to_string(), "a.toml:2: gap_m: -1 m; allowed: above 0 m");
        let unknown = parse_toml::<Gap>("a.toml", "gap_m = 1.0\ngpa_m = 2.0\n").expect_err("refused");
        assert!(unknown.to_string().starts_with("a.toml:2: unknown field"), "{unknown}");
    }
}
