//! SVG figures and the self-contained HTML pages made of them.
//!
//! [`Chart`] draws one plot with its legend and units, [`Table`] is shown on a terminal and on a page,
//! [`Page`] joins both into one file without scripts or outside resources that reads well on light
//! and dark screens. The run, comparison, diagnosis and campaigns all use these; [`run`] draws the
//! paper's figures for a run.

mod chart;
pub mod comparison;
pub mod diagnosis;
mod heat;
mod heatmap;
pub mod of_run;
mod page;
pub mod preview;
pub mod run;
mod series;
mod style;
mod table;

pub use chart::{Chart, Marker};
pub use heat::Heat;
pub use heatmap::HeatMap;
pub use page::Page;
pub use series::{RunSeries, envelope};
pub use style::{Dash, Ink, Stroke};
pub use table::Table;

/// Why a figure or page could not be made.
#[derive(Debug, thiserror::Error)]
pub enum ReportError {
    /// The plotting library refused.
    #[error("figure `{figure}`: {reason}")]
    Figure {
        /// The label of the figure's vertical axis.
        figure: String,
        /// What the library says.
        reason: String,
    },
    /// A file could not be written.
    #[error("cannot write {path}: {source}")]
    Write {
        /// Which file.
        path: std::path::PathBuf,
        /// What the system says.
        source: std::io::Error,
    },
}
