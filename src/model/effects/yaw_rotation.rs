//! Eccentric mass: a rotational mode, driven by the acceleration of the mass, that the two
//! accelerometers at its edges see with opposite signs. The radius of gyration is that of a uniform
//! plate of half length L (L / sqrt 3); what rotation does to D is of second order and left out.

use super::{Effect, Parameter, Place};
use crate::model::observe::Yaw;
use std::f64::consts::TAU;

/// `yaw-rotation`.
pub static EFFECT: Effect = Effect {
    name: "yaw-rotation",
    place: Place::Rig,
    equation: "y'' + 2 zeta w y' + w^2 y = -(3 e / L) A, w = 2 pi f; A1 = A + y'', A2 = A - y''",
    source: "R. W. Clough, J. Penzien, Dynamics of Structures, 1993 (eccentric mass)",
    states: "y, y' (m, m/s)",
    regime: "all",
    shows: "the two accelerometers differ at the rotational frequency",
    experiment: "accelerometer against accelerometer",
    piecewise_linear: true,
    parameters: |s| {
        vec![
            Parameter::either("e_m", "m", "eccentricity of the mass", 0.05, 0.005),
            Parameter::positive(
                "f_hz",
                "Hz",
                "rotational frequency",
                (s.frequency_hz, (0.4 / s.sample_period_s).max(2.0 * s.frequency_hz)),
                10.0 * s.frequency_hz,
            ),
            Parameter::positive("zeta", "1", "damping ratio", (0.005, 0.3), 0.05).at_most(0.99),
            Parameter::positive(
                "half_spacing_m",
                "m",
                "half the distance L of the accelerometers",
                (0.25, 1.0),
                0.5,
            )
            .optional(0.5),
        ]
    },
    install: |values, system| {
        system.instruments.yaw = Some(Yaw {
            coupling: 3.0 * values.get("e_m") / values.get("half_spacing_m"),
            angular_frequency_rad_s: TAU * values.get("f_hz"),
            damping_ratio: values.get("zeta"),
        });
        Ok(())
    },
};
