//! Many cases as one study: the matrix of bumpers, gaps and accelerations, its runs, their peaks, and what
//! follows from them - the paper's tables and figures, the comparison with a published table, the
//! identification on peaks alone, the trade-off.
//!
//! The command line calls it. A campaign is a file ([`CampaignSpec`]) and a folder ([`Store`]) in which every
//! case leaves one result; runs resume, may be spread over machines, and results never depend on who ran
//! them or in which order.

pub mod design_map;
pub mod diagnose;
pub mod figures;
mod first_look;
pub mod fit;
pub mod ideal;
pub mod ladder;
pub mod numbers;
pub mod odd;
pub mod optimise;
pub mod peaks;
pub mod report;
pub mod runner;
mod search;
pub mod spec;
pub mod store;
pub mod tables;
#[cfg(test)]
mod testing;

pub use runner::{Options, Summary, run};
pub use spec::{CampaignSpec, CaseKey, Configuration};
pub use store::{CaseOutcome, CaseResult, Store};

/// Why a campaign could not be read, run or evaluated.
#[derive(Debug, thiserror::Error)]
pub enum CampaignError {
    /// A configuration that the campaign names.
    #[error(transparent)]
    Config(#[from] crate::config::ConfigError),
    /// A case that cannot be set up.
    #[error("case {case}: {source}")]
    Setup {
        /// Which case.
        case: String,
        /// What is wrong.
        source: crate::control::setup::SetupError,
    },
    /// A run that could not be started or closed.
    #[error("case {case}: {reason}")]
    Run {
        /// Which case.
        case: String,
        /// What is wrong.
        reason: String,
    },
    /// The model of a case.
    #[error("case {case}: {source}")]
    Model {
        /// Which case.
        case: String,
        /// What is wrong.
        source: crate::model::ModelError,
    },
    /// A file of the campaign's folder.
    #[error("{path}: {reason}")]
    File {
        /// Which file.
        path: std::path::PathBuf,
        /// What is wrong.
        reason: String,
    },
    /// The folder holds another campaign than the file says.
    #[error("{path}: {reason}")]
    Foreign {
        /// Folder.
        path: std::path::PathBuf,
        /// What differs.
        reason: String,
    },
    /// A figure or a page.
    #[error(transparent)]
    Report(#[from] crate::report::ReportError),
    /// There are no results to evaluate.
    #[error("{path}: no case has a result yet; run the campaign first")]
    Empty {
        /// Folder.
        path: std::path::PathBuf,
    },
}

impl CampaignError {
    /// A file that could not be read, written or understood.
    pub(crate) fn file(path: &std::path::Path, reason: impl std::fmt::Display) -> Self {
        Self::File { path: path.to_owned(), reason: reason.to_string() }
    }
}
