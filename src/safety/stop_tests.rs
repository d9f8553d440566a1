//! Stops from random states of the sweep: inside every limit at every sample, at rest at the end.

use super::*;
use crate::rig::RigSpec;
use crate::safety::SafetySpec;
use crate::units::STANDARD_GRAVITY_M_S2;
use proptest::prelude::*;
use std::f64::consts::TAU;

/// State of the sine that a sweep commands.
fn of_sine(acceleration_g: f64, frequency_hz: f64, phase: f64) -> (Command, f64) {
    let (amplitude, w) = (acceleration_g * STANDARD_GRAVITY_M_S2, TAU * frequency_hz);
    let (sin, cos) = (TAU * phase).sin_cos();
    let command = Command {
        displacement_m: -amplitude / (w * w) * sin,
        velocity_m_s: -amplitude / w * cos,
        acceleration_m_s2: amplitude * sin,
    };
    (command, amplitude)
}

/// Cases: a quick subset, or as many as `STOP_CASES` says.
fn cases() -> ProptestConfig {
    let cases = std::env::var("STOP_CASES").ok().and_then(|n| n.parse().ok()).unwrap_or(2000);
    ProptestConfig { failure_persistence: None, ..ProptestConfig::with_cases(cases) }
}

proptest! {
    #![proptest_config(cases())]
    #[test]
    fn a_stop_from_any_sine_ends_at_rest_inside_the_capacity(
        g in 0.01_f64..0.10, f in 0.5_f64..5.0, phase in 0.0_f64..1.0,
    ) {
        let (start, amplitude) = of_sine(g, f, phase);
        let stops = SafetySpec::built_in().expect("valid").stops;
        let capacity = RigSpec::default().capacity();
        // At 0.1 g and 0.5 Hz the sweep itself is at the end of the stroke.
        prop_assume!(amplitude / (TAU * f).powi(2) <= 0.98 * capacity.displacement_m);
        let stop = MinimumJerkStop::new(&start, amplitude, &stops, &capacity);
        let n = 200;
        let step_s = stop.duration_s() / f64::from(n);
        let mut last = start;
        for i in 0..=n {
            let now = stop.at(f64::from(i) * step_s);
            prop_assert!(now.displacement_m.abs() <= capacity.displacement_m);
            prop_assert!(now.velocity_m_s.abs() <= capacity.velocity_m_s);
            prop_assert!(now.acceleration_m_s2.abs() <= 1.0001 * amplitude, "{now:?}");
            let jerk = (now.acceleration_m_s2 - last.acceleration_m_s2) / step_s;
            prop_assert!(jerk.abs() <= 1.0001 * stops.jerk_m_s3, "{jerk}");
            last = now;
        }
        prop_assert!(stop.duration_s() < 1.5, "{}", stop.duration_s());
        prop_assert!(last.velocity_m_s.abs() < 1e-9 && last.acceleration_m_s2.abs() < 1e-6);
        let end = stop.at(stop.duration_s());
        prop_assert!(end.velocity_m_s == 0.0 && end.acceleration_m_s2 == 0.0);
        let (first, eps) = (stop.at(0.0), 1e-12);
        prop_assert!((first.displacement_m - start.displacement_m).abs() < eps);
        prop_assert!((first.acceleration_m_s2 - start.acceleration_m_s2).abs() < eps);
    }

    #[test]
    fn the_return_is_slow_and_ends_in_the_centre(from in -0.1_f64..0.1) {
        let stops = SafetySpec::built_in().expect("valid").stops;
        let back = Return::new(from, &stops);
        for i in 0..=200 {
            let now = back.at(back.duration_s() * f64::from(i) / 200.0);
            prop_assert!(now.velocity_m_s.abs() <= 1.001 * stops.return_speed_m_s);
            prop_assert!(now.acceleration_m_s2.abs() <= 1.001 * stops.return_acceleration_m_s2);
        }
        prop_assert!(back.at(0.0).displacement_m == from);
        prop_assert!(back.at(back.duration_s()).displacement_m.abs() < 1e-12);
    }
}

#[test]
fn a_state_that_cannot_be_stopped_in_time_is_still_brought_to_rest() {
    let stops = SafetySpec::built_in().expect("valid").stops;
    let start = Command { displacement_m: 0.0999, velocity_m_s: 0.5, acceleration_m_s2: 1.0 };
    let stop = MinimumJerkStop::new(&start, 0.5, &stops, &RigSpec::default().capacity());
    assert!(stop.duration_s() < 1.0);
    assert_eq!(stop.at(stop.duration_s()).velocity_m_s, 0.0);
}
