//! The accelerometers' readings arrive late.

use super::{Effect, Parameter, Place};

/// `accelerometer-delay`.
pub static EFFECT: Effect = Effect {
    name: "accelerometer-delay",
    place: Place::Instrument,
    equation: "A_measured(t) = A(t - dt), both",
    source: "anti-aliasing filters delay",
    states: "",
    regime: "measurement",
    shows: "A - a_table lags D''",
    experiment: "A - a_table against D''",
    piecewise_linear: true,
    parameters: |s| {
        vec![Parameter::not_negative(
            "dt_s",
            "s",
            "delay",
            (0.01 * s.sample_period_s, 50.0 * s.sample_period_s),
            s.sample_period_s,
        )]
    },
    install: |values, system| {
        system.instruments.accelerometer_delay_s += values.get("dt_s");
        Ok(())
    },
};
