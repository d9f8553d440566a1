//! Why a model cannot be built or changed.

/// Why a model cannot be built or changed.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum ModelError {
    /// A value that the physics forbids, or a name that does not exist.
    #[error("{key}: {reason}")]
    Invalid {
        /// Dotted key within the model file.
        key: String,
        /// What is wrong, and what is allowed.
        reason: String,
    },
    /// No effect of that name.
    #[error("no effect is called `{name}`; known: {known}")]
    UnknownEffect {
        /// The name that was asked for.
        name: String,
        /// All names of the catalogue.
        known: String,
    },
    /// No parameter under that key.
    #[error("the model has no parameter `{key}`; it has {known}")]
    UnknownKey {
        /// The key that was asked for.
        key: String,
        /// All keys of the model.
        known: String,
    },
    /// The sample period is not a positive number.
    #[error("sample period {dt_s} s; allowed: above 0 s and finite")]
    SamplePeriod {
        /// As given, s.
        dt_s: f64,
    },
    /// More hidden states than the solver carries.
    #[error("the effects of this model need {needed} states together; at most {allowed} are possible")]
    TooManyStates {
        /// Needed by the effects.
        needed: usize,
        /// Possible.
        allowed: usize,
    },
    /// Two effects that replace the same thing.
    #[error("`{first}` and `{second}` cannot be in one model: {reason}")]
    Conflict {
        /// Name of the one.
        first: String,
        /// Name of the other.
        second: String,
        /// Why.
        reason: String,
    },
}

impl ModelError {
    /// A refused key with its reason.
    pub fn invalid(key: impl Into<String>, reason: impl Into<String>) -> Self {
        Self::Invalid { key: key.into(), reason: reason.into() }
    }
}
