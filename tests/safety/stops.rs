//! Stops from everywhere a sweep can be, and what they do to the mass.

use crate::bench::in_parallel;
use crate::pages::write_section;
use rand::{Rng as _, SeedableRng};
use rand_pcg::Pcg64Mcg;
use shaketable::config::Case;
use shaketable::control::setup::model_of_case;
use shaketable::model::build;
use shaketable::rig::RigSpec;
use shaketable::safety::{Decay, MinimumJerkStop, SafetySpec, Stops};
use shaketable::stream::Command;
use shaketable::sweep::{CommandPoint, Direction, Generator, Schedule, Segment, StepPhase, SweepSpec};
use std::f64::consts::TAU;
use std::ops::Range;

const RATE_HZ: f64 = 2048.0;
const G: f64 = 9.80665;

/// A stop, whichever the guard would choose.
enum Chosen {
    AtOnce(MinimumJerkStop),
    Gentle(Decay),
}

impl Chosen {
    fn at(&self, time_s: f64) -> Command {
        match self {
            Self::AtOnce(stop) => stop.at(time_s),
            Self::Gentle(decay) => decay.at(time_s),
        }
    }

    fn duration_s(&self) -> f64 {
        match self {
            Self::AtOnce(stop) => stop.duration_s(),
            Self::Gentle(decay) => decay.duration_s(),
        }
    }
}

fn at_once(point: &CommandPoint, stops: &Stops) -> Chosen {
    let amplitude = point.phase.map_or(0.2, |phase| phase.acceleration_amplitude_m_s2);
    let capacity = RigSpec::default().capacity();
    Chosen::AtOnce(MinimumJerkStop::new(&point.command, amplitude, stops, &capacity))
}

/// Both stops of a point; the gentle one only where it is offered.
fn stops_of(point: &CommandPoint, stops: &Stops) -> impl Iterator<Item = Chosen> {
    [Some(at_once(point, stops)), Decay::of(point, stops).map(Chosen::Gentle)].into_iter().flatten()
}

/// Every limit at instants of a stop; what it exceeds.
fn judge(start: &CommandPoint, stop: &Chosen, instants: u32) -> Result<(), String> {
    let capacity = RigSpec::default().capacity();
    let step_s = stop.duration_s() / f64::from(instants);
    let mut last = start.command;
    for i in 0..=instants {
        let now = stop.at(f64::from(i) * step_s);
        let jerk = if i == 0 { 0.0 } else { (now.acceleration_m_s2 - last.acceleration_m_s2) / step_s };
        let inside = now.displacement_m.abs() <= capacity.displacement_m
            && now.velocity_m_s.abs() <= capacity.velocity_m_s
            && now.acceleration_m_s2.abs() <= capacity.acceleration_m_s2
            && jerk.abs() <= capacity.jerk_m_s3;
        let continuous = i > 0
            || (now.displacement_m - last.displacement_m).abs() < 1e-9
                && (now.velocity_m_s - last.velocity_m_s).abs() < 1e-7
                && (now.acceleration_m_s2 - last.acceleration_m_s2).abs() < 1e-6;
        if !inside || !continuous {
            return Err(format!("from {start:?}: {now:?}, jerk {jerk} m/s3"));
        }
        last = now;
    }
    let end = stop.at(stop.duration_s());
    if end.velocity_m_s != 0.0 || end.acceleration_m_s2 != 0.0 {
        return Err(format!("from {start:?}: ends with {end:?}"));
    }
    Ok(())
}

/// Random points of the paper's sweep at an amplitude, ramps and transitions included.
fn walk(acceleration_g: f64, share: f64, seed: u64) -> (u64, f64, Vec<String>) {
    let sweep = SweepSpec { acceleration_g, ..SweepSpec::paper() };
    let mut generator = Generator::new(&Schedule::new(&sweep).expect("schedule"), RATE_HZ);
    let mut rng = Pcg64Mcg::seed_from_u64(seed);
    let stops = SafetySpec::built_in().expect("valid").stops;
    let (mut states, mut longest_s, mut wrong) = (0, 0.0_f64, Vec::new());
    while !generator.is_done() {
        let point = generator.next_point();
        if !rng.random_bool(share) {
            continue;
        }
        states += 1;
        for stop in stops_of(&point, &stops) {
            longest_s = longest_s.max(stop.duration_s());
            wrong.extend(judge(&point, &stop, 100).err());
        }
    }
    (states, longest_s, wrong)
}

// SR-08
#[test]
fn stops_from_random_points_of_the_sweep_stay_inside_every_limit() {
    let (states, _, wrong) = walk(0.10, 0.001, 1);
    assert!(states > 500 && wrong.is_empty(), "{wrong:?}");
}

#[test]
#[ignore = "a million states: a minute or two in release"]
fn a_million_stops_stay_inside_every_limit() {
    let jobs: Vec<(f64, u64)> = [0.03, 0.05, 0.07, 0.10].into_iter().zip(1..).collect();
    let results = in_parallel(&jobs, |(acceleration_g, seed)| walk(*acceleration_g, 0.27, *seed));
    let states: u64 = results.iter().map(|result| result.0).sum();
    let longest_s = results.iter().map(|result| result.1).fold(0.0, f64::max);
    let wrong: Vec<_> = results.into_iter().flat_map(|result| result.2).collect();
    println!("{states} states, longest stop {longest_s:.2} s, {} outside", wrong.len());
    assert!(states >= 1_000_000 && wrong.is_empty(), "{:?}", &wrong[..wrong.len().min(5)]);
}

/// Peak acceleration of the mass in a stop over its peak in the two cycles before, on a table that follows exactly.
fn mass_ratio(case: &str, frequency_hz: f64, phase_share: f64, gentle: bool) -> f64 {
    let case: Case = case.parse().expect("a case");
    let mut specimen = build(&model_of_case(&case), 1.0 / RATE_HZ).expect("built");
    let (amplitude, w) = (case.acceleration_g * G, TAU * frequency_hz);
    let until_s = (8.0 + phase_share) / frequency_hz;
    let samples = (until_s * RATE_HZ) as u64;
    let mut before = 0.0_f64;
    for k in 0..=samples {
        let t = k as f64 / RATE_HZ;
        let rise = (t * frequency_hz / 2.0).min(1.0);
        let response = specimen.step(amplitude * rise * (w * t).sin());
        if t > until_s - 2.0 / frequency_hz {
            before = before.max(response.mass_acceleration_m_s2.abs());
        }
    }
    let phase_rad = w * samples as f64 / RATE_HZ;
    let (sin, cos) = phase_rad.sin_cos();
    let command = Command {
        displacement_m: -amplitude / (w * w) * sin,
        velocity_m_s: -amplitude / w * cos,
        acceleration_m_s2: amplitude * sin,
    };
    let phase = StepPhase {
        index: 0,
        direction: Direction::Forward,
        frequency_hz,
        acceleration_amplitude_m_s2: amplitude,
        phase_rad,
        counted: true,
    };
    let point = CommandPoint { command, jerk_m_s3: 0.0, phase: Some(phase), segment: Segment::Step };
    let stops = SafetySpec::built_in().expect("valid").stops;
    let stop = match Decay::of(&point, &stops).filter(|_| gentle) {
        Some(decay) => Chosen::Gentle(decay),
        None => at_once(&point, &stops),
    };
    let mut during = 0.0_f64;
    for k in 1..=((stop.duration_s() + 0.5) * RATE_HZ) as u64 {
        let response = specimen.step(stop.at(k as f64 / RATE_HZ).acceleration_m_s2);
        during = during.max(response.mass_acceleration_m_s2.abs());
    }
    during / before
}

/// Random stops of all cases between two frequencies, Hz; ratios in rising order, with what they belong to.
fn mass_ratios(seeds: Range<u64>, low_hz: f64, high_hz: f64, gentle: bool) -> Vec<(f64, String)> {
    let jobs: Vec<u64> = seeds.collect();
    let mut ratios = in_parallel(&jobs, |seed| {
        let mut rng = Pcg64Mcg::seed_from_u64(*seed);
        let (bumper, gap) = (rng.random_range(1..=4), rng.random_range(1..=4));
        let case = format!("B{bumper}-G{gap}-{}", ["0.03", "0.04", "0.05", "0.07"][rng.random_range(0..4)]);
        let (frequency_hz, phase) = (rng.random_range(low_hz..high_hz), rng.random_range(0.0..1.0));
        let ratio = mass_ratio(&case, frequency_hz, phase, gentle);
        (ratio, format!("{case} at {frequency_hz:.3} Hz, phase {phase:.3}: {ratio:.2}"))
    });
    ratios.sort_by(|a, b| a.0.total_cmp(&b.0));
    ratios
}

// SR-08
#[test]
fn a_stop_does_not_throw_the_mass() {
    for (low_hz, high_hz, gentle) in [(0.5, 3.0, false), (0.5, 0.8, false), (0.5, 0.8, true)] {
        let ratios = mass_ratios(0..60, low_hz, high_hz, gentle);
        let worst = ratios.last().expect("some");
        assert!(worst.0 <= 2.0, "{}", worst.1);
    }
}

/// Where a mass swings just short of its bumpers and a stop that brakes as hard as the sweep turns would throw it into one.
// SR-08
#[test]
fn a_mass_that_swings_just_short_of_its_bumpers_is_not_thrown_into_one() {
    for (case, frequency_hz, phase) in [
        ("B3-G4-0.04", 0.55, 0.87),
        ("B3-G2-0.03", 0.517, 0.350),
        ("B4-G2-0.03", 0.510, 0.361),
        ("B4-G4-0.04", 0.533, 0.347),
        ("B4-G2-0.03", 0.524, 0.874),
        ("B4-G2-0.03", 0.528, 0.734),
        ("B4-G3-0.03", 0.660, 0.712),
    ] {
        for gentle in [false, true] {
            let ratio = mass_ratio(case, frequency_hz, phase, gentle);
            assert!(ratio <= 2.0, "{case} at {frequency_hz} Hz, phase {phase}, gentle {gentle}: {ratio:.2}");
        }
    }
}

#[test]
#[ignore = "thousands of stops: a minute in release"]
fn thousands_of_stops_do_not_throw_the_mass() {
    let first = std::env::var("FIRST_SEED").ok().and_then(|n| n.parse().ok()).unwrap_or(0);
    let mut table = String::from(
        "| stop | Hz | stops | mean | median | 99 % | 99.9 % | worst | where |\n|---|---|---|---|---|---|---|---|---|\n",
    );
    let mut thrown = Vec::new();
    for (name, low_hz, high_hz, gentle, count) in [
        ("at once", 0.5, 3.0, false, 20_000),
        ("at once", 0.5, 0.8, false, 10_000),
        ("decay", 0.5, 0.8, true, 10_000),
    ] {
        let ratios = mass_ratios(first..first + count, low_hz, high_hz, gentle);
        let at = |share: f64| ratios[((ratios.len() - 1) as f64 * share) as usize].0;
        let mean = ratios.iter().map(|ratio| ratio.0).sum::<f64>() / ratios.len() as f64;
        let worst = ratios.last().expect("some");
        let (place, _) = worst.1.rsplit_once(':').expect("a place");
        table += &format!(
            "| {name} | {low_hz} to {high_hz} | {count} | {mean:.2} | {:.2} | {:.2} | {:.2} | {:.2} | {place} |\n",
            at(0.5),
            at(0.99),
            at(0.999),
            worst.0
        );
        thrown.extend(ratios.into_iter().filter(|ratio| ratio.0 > 2.0).map(|ratio| ratio.1));
    }
    println!("{table}");
    if std::env::var_os("WRITE_DOCS").is_some() {
        write_section("stops", &table);
    }
    assert!(thrown.is_empty(), "{thrown:?}");
}
