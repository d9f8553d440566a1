//! The control thread sleeps while the table moves, for less time than a drive waits: the drive coasts along its last
//! command, the next one begins there, and neither the table nor the supervisor takes notice.

use crate::bench::{Bench, setup};
use rand::{Rng as _, SeedableRng};
use rand_pcg::Pcg64Mcg;
use shaketable::control::{Ending, Event};
use shaketable::rig::RigSpec;
use shaketable::safety::{SafetySpec, State};
use shaketable::stream::Command;
use shaketable::sweep::SweepSpec;
use std::f64::consts::TAU;

const PERIOD_S: f64 = 1.0 / 2048.0;

/// How far a command is off the one before it, carried on by a period.
fn jump(before: &Command, now: &Command) -> [f64; 3] {
    let off = *now - carried_on(before);
    [off.displacement_m, off.velocity_m_s, off.acceleration_m_s2].map(f64::abs)
}

/// A sweep of two steps with sleeps of up to `longest` periods; largest jumps of the command, sleeps taken.
fn sleepy(frequency_hz: f64, longest: u64, seed: u64) -> ([f64; 3], u64) {
    let sweep = SweepSpec::paper().restricted(frequency_hz, frequency_hz + 0.1).expect("in range");
    let mut bench = Bench::new(&setup("B1-G2-0.05", RigSpec::default(), sweep, seed), |_| {}, |guard| guard);
    let mut rng = Pcg64Mcg::seed_from_u64(seed);
    let (mut worst, mut sleeps) = ([0.0_f64; 3], 0);
    // No two sleeps within a second: a machine that sleeps more is stopped, and rightly so.
    let mut next = 4096;
    let ending = loop {
        let before = bench.controller.last_command();
        next -= 1;
        let asleep = if next == 0 { rng.random_range(1..=longest) } else { 0 };
        if next == 0 {
            next = rng.random_range(2100..6000);
            sleeps += 1;
        }
        let carried = (0..asleep).fold(before, |c, _| carried_on(&c));
        let ending = bench.step_after(1 + asleep);
        for (worst, jump) in worst.iter_mut().zip(jump(&carried, &bench.controller.last_command())) {
            *worst = worst.max(jump);
        }
        if let Some(ending) = ending {
            break ending;
        }
    };
    assert_eq!(ending, Ending::Done, "{frequency_hz} Hz, {longest} periods: {:?}", bench.events);
    let told = |event: &&Event| matches!(event, Event::Finding { tripped: true, .. });
    assert_eq!(bench.events.iter().find(told), None);
    let steps = bench.events.iter().filter(|event| matches!(event, Event::Step(_))).count();
    assert_eq!(steps, 4, "each step has a result in both directions");
    (worst, sleeps)
}

fn carried_on(from: &Command) -> Command {
    let (t, a) = (PERIOD_S, from.acceleration_m_s2);
    Command {
        displacement_m: from.displacement_m + t * (from.velocity_m_s + 0.5 * t * a),
        velocity_m_s: from.velocity_m_s + t * a,
        acceleration_m_s2: a,
    }
}

// SR-17
#[test]
fn the_sweep_is_joined_again_without_a_jump_and_without_an_abort() {
    for (seed, frequency_hz) in (1..).zip([0.5, 1.0, 2.0, 3.5, 4.9]) {
        for longest in [1, 20, 100, 160] {
            let (worst, sleeps) = sleepy(frequency_hz, longest, seed);
            assert!(sleeps > 3, "{sleeps} sleeps");
            // What the jerk of a stop and that of the sweep change within one period.
            let jerk_m_s3 = SafetySpec::built_in().expect("valid").stops.jerk_m_s3 + 0.5 * TAU * frequency_hz;
            let bounds = [jerk_m_s3 * PERIOD_S.powi(3), jerk_m_s3 * PERIOD_S.powi(2), jerk_m_s3 * PERIOD_S];
            assert!(worst.iter().zip(bounds).all(|(w, b)| *w < b), "{frequency_hz} Hz, {longest}: {worst:?}");
        }
    }
}

#[test]
fn a_stop_goes_on_from_where_the_drive_has_gone() {
    for asleep in [1, 40, 120, 180] {
        let sweep = SweepSpec::paper().restricted(1.0, 1.1).expect("in range");
        let mut bench = Bench::new(&setup("B1-G2-0.05", RigSpec::default(), sweep, 7), |_| {}, |guard| guard);
        for _ in 0..9000 {
            assert_eq!(bench.step(), None);
        }
        bench.operator.ask(shaketable::control::Request::Stop).expect("room");
        for _ in 0..100 {
            assert_eq!(bench.step(), None);
        }
        assert_eq!(bench.controller.state(), Some(State::Stopping));
        let before = (0..asleep).fold(bench.controller.last_command(), |c, _| carried_on(&c));
        let mut ending = bench.step_after(1 + asleep);
        let first = jump(&before, &bench.controller.last_command());
        assert!(first[0] < 2e-5 && first[1] < 2e-3, "{asleep}: {first:?}");
        let mut periods = 0;
        while ending.is_none() && periods < 40_000 {
            ending = bench.step();
            periods += 1;
        }
        assert_eq!(ending, Some(Ending::Stopped), "{asleep}: {:?}", bench.events);
        assert_eq!(bench.controller.last_command().velocity_m_s, 0.0);
    }
}
