//! The scale of the first accelerometer is off.

use super::{Effect, Parameter, Place};

/// `accelerometer-gain`.
pub static EFFECT: Effect = Effect {
    name: "accelerometer-gain",
    place: Place::Instrument,
    equation: "A1_measured = g A1",
    source: "calibration",
    states: "",
    regime: "measurement",
    shows: "the two accelerometers differ by one factor",
    experiment: "accelerometer against accelerometer; A - a_table against D''",
    piecewise_linear: true,
    parameters: |_| {
        vec![Parameter::positive("gain", "1", "gain of the first accelerometer", (0.8, 1.25), 1.01).linear()]
    },
    install: |values, system| {
        system.instruments.accelerometer_1_gain *= values.get("gain");
        Ok(())
    },
};
