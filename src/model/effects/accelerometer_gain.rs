//! The scale of an accelerometer is off, or that of both.

use super::{Effect, Parameter, Place};

/// `accelerometer-gain`.
pub static EFFECT: Effect = Effect {
    name: "accelerometer-gain",
    place: Place::Instrument,
    equation: "A1_measured = g A1, A2_measured = g2 A2",
    source: "calibration",
    states: "",
    regime: "measurement",
    shows: "the two accelerometers differ by one factor; both alike from D'' by it",
    experiment: "accelerometer against accelerometer; A - a_table against D''",
    piecewise_linear: true,
    parameters: |_| {
        let gain = |name, about| Parameter::positive(name, "1", about, (0.8, 1.25), 1.01).linear();
        vec![
            gain("gain", "gain of the first accelerometer, or of the only one"),
            gain("gain_2", "gain of the second accelerometer").optional(1.0),
        ]
    },
    install: |values, system| {
        let [one, two] = &mut system.instruments.accelerometer_gains;
        *one *= values.get("gain");
        *two *= values.get("gain_2");
        Ok(())
    },
};
