//! The platen moves with the contact force. Only for a model driven by the *command*: a measured table acceleration has it already.

use super::{Effect, Parameter, Place};

/// `table-interaction`.
pub static EFFECT: Effect = Effect {
    name: "table-interaction",
    place: Place::Rig,
    equation: "a_table = a_command + (N_right - N_left) / m_eff",
    source: "A. R. Plummer, J. Syst. Control Eng. 221 (2007) 115 (specimen reaction on shaking tables)",
    states: "",
    regime: "contact",
    shows: "table acceleration departs from the command during contact",
    experiment: "command against table motion",
    piecewise_linear: false,
    parameters: |s| {
        vec![Parameter::not_negative(
            "m_eff_inv_1_kg",
            "1/kg",
            "inverse effective mass of table and drive",
            (1e-3 / s.mass_kg, 1.0 / s.mass_kg),
            0.05 / s.mass_kg,
        )]
    },
    install: |values, system| {
        system.table_inverse_mass_1_kg += values.get("m_eff_inv_1_kg");
        Ok(())
    },
};
