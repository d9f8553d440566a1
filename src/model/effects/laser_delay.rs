//! The laser's reading arrives late.

use super::{Effect, Parameter, Place};

/// `laser-delay`.
pub static EFFECT: Effect = Effect {
    name: "laser-delay",
    place: Place::Instrument,
    equation: "D_measured(t) = D(t - dt)",
    source: "triangulation lasers average and buffer",
    states: "",
    regime: "measurement",
    shows: "D'' lags A - a_table by a phase that grows with f",
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
        system.instruments.laser_delay_s += values.get("dt_s");
        Ok(())
    },
};
