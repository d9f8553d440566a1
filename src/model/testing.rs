//! Models that several tests share.

/// Ends the process on any allocation or release within `assert_no_alloc`; elsewhere it allocates as usual.
#[global_allocator]
static ALLOCATOR: assert_no_alloc::AllocDisabler = assert_no_alloc::AllocDisabler;

use super::{BumperSpec, EffectSpec, IsolatorSpec, ModelSpec};

/// The published model (rig: B1, gap 20 mm).
pub fn b1_g2() -> ModelSpec {
    ModelSpec {
        name: "b1-g2".into(),
        mass_kg: 500.0,
        isolator: IsolatorSpec {
            stiffness_n_m: vec![20e3, 18e3, 2e3],
            breakpoints_m: vec![0.008, 0.040],
            damping_n_s_m: 1100.0,
        },
        bumper: Some(BumperSpec { stiffness_n_m: 33e3, damping_n_s_m: 300.0, total_gap_m: 0.020 }),
        effects: Vec::new(),
        uncertainty: None,
    }
}

/// A mass on one spring and dashpot, no bumpers.
pub fn oscillator(mass_kg: f64, stiffness_n_m: f64, damping_n_s_m: f64) -> ModelSpec {
    ModelSpec {
        name: "oscillator".into(),
        mass_kg,
        isolator: IsolatorSpec {
            stiffness_n_m: vec![stiffness_n_m],
            breakpoints_m: Vec::new(),
            damping_n_s_m,
        },
        bumper: None,
        effects: Vec::new(),
        uncertainty: None,
    }
}

/// An effect with its parameters.
pub fn effect(name: &str, parameters: &[(&str, f64)]) -> EffectSpec {
    EffectSpec {
        name: name.into(),
        expression: None,
        parameters: parameters.iter().map(|(name, value)| ((*name).to_owned(), *value)).collect(),
    }
}
