//! The laser's scale is off.

use super::{Effect, Parameter, Place};

/// `laser-gain`.
pub static EFFECT: Effect = Effect {
    name: "laser-gain",
    place: Place::Instrument,
    equation: "D_measured = g D",
    source: "calibration",
    states: "",
    regime: "measurement",
    shows: "D'' and A - a_table differ by one factor",
    experiment: "A - a_table against D''; a shim under the laser",
    piecewise_linear: true,
    parameters: |_| vec![Parameter::positive("gain", "1", "gain", (0.8, 1.25), 1.01).linear()],
    install: |values, system| {
        system.instruments.laser_gain *= values.get("gain");
        Ok(())
    },
};
