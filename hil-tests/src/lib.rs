//! Helpers of the tests that run the product against the simulated table, emulated devices,
//! injected faults and hidden effects.
pub mod arguments;
pub mod chains;
pub mod forced;
pub mod hidden;
pub mod imposed;

use shaketable::diagnose::Diagnosis;

/// Names of the effects that were found, in their order.
pub fn named(found: &Diagnosis) -> Vec<&str> {
    found.effects.iter().map(|effect| effect.name.as_str()).collect()
}
