//! Helpers of the tests that run the product against the simulated table, emulated devices,
//! injected faults and hidden effects.
pub mod arguments;
pub mod chains;
pub mod forced;
pub mod hidden;
pub mod imposed;
