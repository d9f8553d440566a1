//! `import`: a foreign data file into one with the product's column names, units and step marks. The
//! same as `export` in the other direction; any file that it writes opens without options.

pub use super::export::{Args, execute};
