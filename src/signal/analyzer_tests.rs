use super::*;
use crate::sweep::{Generator, Schedule, SweepSpec};
use crate::units::SAMPLE_RATE_HZ;
use proptest::prelude::*;

/// A periodic signal with all that is demodulated: mean, five harmonics with their phases.
fn rich(phi: f64) -> f64 {
    0.2 + 3.0 * (phi + 0.4).sin()
        + 0.5 * (2.0 * phi - 1.1).sin()
        + 0.3 * (3.0 * phi + 2.2).sin()
        + 0.2 * (4.0 * phi - 3.0).sin()
        + 0.1 * (5.0 * phi).sin()
}

const RICH: [(f64, f64); HARMONICS] = [(3.0, 0.4), (0.5, -1.1), (0.3, 2.2), (0.2, -3.0), (0.1, 0.0)];

fn place(index: u32, cycles: f64) -> Option<CyclePlace> {
    Some(CyclePlace { index, cycles, counted: true })
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(40))]

    /// Whatever the frequency (no whole number of samples a period) and the first sample's delay.
    #[test]
    fn demodulation_recovers_amplitudes_and_phases(hz in 0.5f64..5.0, late in 0.0f64..1.0) {
        let mut analyzer = StepAnalyzer::<1>::new(3);
        let step = hz / SAMPLE_RATE_HZ;
        let mut result = None;
        let mut cycles = late * step;
        while cycles < 5.0 {
            prop_assert!(analyzer.push(place(0, cycles), &[rich(TAU * cycles)]).is_none());
            cycles += step;
        }
        if let Some(found) = analyzer.push(None, &[rich(TAU * cycles)]) { result = Some(found); }
        let result = result.expect("step ended");
        prop_assert_eq!((result.index, result.cycles), (0, 3));
        let channel = result.channels[0];
        prop_assert!((channel.mean - 0.2).abs() < 2e-5, "mean {}", channel.mean);
        for (found, (amplitude, phase)) in channel.harmonics.iter().zip(RICH) {
            prop_assert!((found.amplitude - amplitude).abs() < 3e-5, "{:?} for {}", found, amplitude);
            prop_assert!((found.phase_rad - phase).abs() * amplitude < 3e-5, "{:?} for {}", found, phase);
        }
        let exact = (0..100_000).map(|i| rich(TAU * f64::from(i) / 1e5));
        let (max, min) = exact.fold((f64::MIN, f64::MAX), |(a, b), y| (a.max(y), b.min(y)));
        // the curvature is at most 3 + 4 0.5 + 9 0.3 + 16 0.2 + 25 0.1 = 13.4; a peak between samples hides
        // at most that times the squared distance over 8, and so does one of the reference
        let (hidden, missed) = (13.4 * (TAU * step).powi(2) / 8.0, 13.4 * (TAU * 1e-5_f64).powi(2) / 8.0);
        prop_assert!(channel.max <= max + missed && channel.max > max - hidden);
        prop_assert!(channel.min >= min - missed && channel.min < min + hidden);
    }
}

#[test]
fn only_the_last_cycles_count() {
    let mut analyzer = StepAnalyzer::<1>::new(2);
    let mut cycles = 0.0;
    while cycles < 6.0 {
        // decays, with its largest values in the first cycles
        analyzer.push(place(7, cycles), &[(10.0 - cycles.floor()) * (TAU * cycles).sin()]);
        cycles += 1.0 / 1000.0;
    }
    let result = analyzer.push(None, &[0.0]).expect("ended");
    assert_eq!((result.index, result.cycles), (7, 2));
    assert!((result.channels[0].peak() - 6.0).abs() < 1e-4, "{:?}", result.channels[0]);
    assert!((result.channels[0].excursion() - 12.0).abs() < 2e-4);
    assert!((result.channels[0].harmonics[0].amplitude - 5.5).abs() < 1e-4);
}

#[test]
fn every_step_of_a_sweep_gives_one_result() {
    let spec = SweepSpec { cycles: 4, ..SweepSpec::paper() }.restricted(1.0, 2.0).expect("steps");
    let schedule = Schedule::new(&spec).expect("valid");
    let mut generator = Generator::new(&schedule, SAMPLE_RATE_HZ);
    let mut analyzer = StepAnalyzer::<2>::new(3);
    let mut results = Vec::new();
    loop {
        let point = generator.next_point();
        let values = [point.command.acceleration_m_s2, point.command.displacement_m];
        results.extend(analyzer.push(CyclePlace::of(&point), &values));
        if generator.is_done() {
            break;
        }
    }
    assert_eq!(results.len(), schedule.steps().len());
    for (result, step) in results.iter().zip(schedule.steps()) {
        assert_eq!((result.index, result.cycles), (step.index, 3));
        let [a, x] = &result.channels;
        let (ag, xk) = (step.acceleration_amplitude_m_s2, step.displacement_amplitude_m);
        assert!((a.harmonics[0].amplitude / ag - 1.0).abs() < 1e-5);
        assert!(a.harmonics[0].phase_rad.abs() < 1e-5);
        assert!((x.harmonics[0].amplitude / xk - 1.0).abs() < 1e-5);
        assert!((x.harmonics[0].phase_rad.abs() - PI).abs() < 1e-5, "opposite to the acceleration");
        assert!(a.distortion() < 1e-5);
        assert!((x.excursion() / (2.0 * xk) - 1.0).abs() < 1e-4);
    }
}

#[test]
fn change_tells_when_a_response_has_settled() {
    let mut analyzer = StepAnalyzer::<1>::new(3);
    let mut changes = Vec::new();
    let mut cycles: f64 = 0.0;
    while cycles < 8.0 {
        let before = cycles.floor();
        let place = CyclePlace { index: 0, cycles, counted: false };
        let grown = 1.0 - 0.5f64.powf(cycles);
        assert!(analyzer.push(Some(place), &[grown * (TAU * cycles).sin()]).is_none());
        cycles += 1.0 / 2000.0;
        if cycles.floor() > before {
            changes.push(analyzer.change(0));
        }
    }
    assert_eq!(changes[0], None);
    let late: Vec<f64> = changes.iter().flatten().copied().collect();
    assert!(late.windows(2).all(|pair| pair[1] < pair[0]), "{late:?}");
    assert!(late[late.len() - 1] < 0.02);
    assert!(analyzer.push(None, &[0.0]).is_none(), "uncounted cycles give no result");
}

#[test]
fn a_step_cut_short_or_joined_midway_gives_its_whole_cycles_only() {
    let mut analyzer = StepAnalyzer::<1>::new(3);
    let mut run = |index: u32, from: f64, to: f64| {
        let mut cycles = from;
        while cycles < to {
            analyzer.push(place(index, cycles), &[rich(TAU * cycles)]);
            cycles += 1.0 / 1500.0;
        }
        analyzer.push(None, &[0.0])
    };
    assert!(run(0, 0.0, 0.8).is_none(), "no whole cycle");
    assert_eq!(run(1, 0.0, 2.5).map(|r| r.cycles), Some(2));
    assert_eq!(run(2, 0.5, 3.0 + 1e-9).map(|r| r.cycles), Some(2));
}
