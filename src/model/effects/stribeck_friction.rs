//! Dry friction that falls from breakaway to sliding (Stribeck 1902; form of Armstrong-Helouvry et al. 1994, with the exponent of Bo and
//! Pavelescu 1982, 1 in Tustin's of 1947).

use super::{Effect, Parameter, Place};
use crate::model::ModelError;

/// `stribeck-friction`.
pub static EFFECT: Effect = Effect {
    name: "stribeck-friction",
    place: Place::Bearings,
    equation: "F = (Fc + (Fs - Fc) exp(-(v/vs)^delta)) sign(v); sticks within Fs; delta is 2 when left out",
    source: "R. Stribeck 1902; B. Armstrong-Helouvry, P. Dupont, C. Canudas de Wit, Automatica 30 (1994) 1083; L. C. Bo, D. Pavelescu, Wear 82 (1982) 277; A. Tustin, J. IEE 94 (1947) 143",
    states: "",
    regime: "all; sticks at rest",
    shows: "as coulomb-friction, with more force near v = 0 and stick-slip at low speed",
    experiment: "low A_G, slow cycles; several speeds",
    piecewise_linear: false,
    parameters: |s| {
        vec![
            Parameter::not_negative(
                "fc_n",
                "N",
                "sliding friction at speed",
                (1e-3 * s.force_n, 0.5 * s.force_n),
                0.02 * s.force_n,
            ),
            Parameter::not_negative(
                "fs_n",
                "N",
                "breakaway friction",
                (1e-3 * s.force_n, s.force_n),
                0.03 * s.force_n,
            ),
            Parameter::positive(
                "vs_m_s",
                "m/s",
                "Stribeck velocity",
                (1e-3 * s.velocity_m_s, s.velocity_m_s),
                0.1 * s.velocity_m_s,
            ),
            Parameter::positive(EXPONENT, "1", "exponent of the fall, 2 when left out", (0.5, 2.0), 2.0)
                .at_least(EXPONENTS.0)
                .at_most(EXPONENTS.1)
                .optional(2.0),
        ]
    },
    install: |values, system| {
        let (fc, fs) = (values.get("fc_n"), values.get("fs_n"));
        if fs < fc {
            return Err(ModelError::invalid(
                values.key("fs_n"),
                format!("{fs} N; allowed: fc_n ({fc} N) or more"),
            ));
        }
        system.add_friction(fc, fs, values.get("vs_m_s"), values.get(EXPONENT));
        Ok(())
    },
};

/// Key of the exponent of its fall.
pub const EXPONENT: &str = "delta";
/// What it may be: below, the fall is a peak at rest that never ends.
pub const EXPONENTS: (f64, f64) = (0.3, 4.0);
