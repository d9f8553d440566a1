use super::*;
use crate::sweep::{Settling, SweepSpec, Transition};
use crate::units::SAMPLE_RATE_HZ;
use proptest::prelude::*;

fn generator(spec: &SweepSpec) -> Generator {
    Generator::new(&Schedule::new(spec).expect("valid"), SAMPLE_RATE_HZ)
}

fn short(frequencies_hz: Vec<f64>, cycles: u32) -> SweepSpec {
    SweepSpec {
        start_hz: None,
        stop_hz: None,
        step_hz: None,
        frequencies_hz: Some(frequencies_hz),
        cycles,
        ..SweepSpec::paper()
    }
}

fn points(generator: &mut Generator) -> Vec<CommandPoint> {
    let mut points = Vec::new();
    while !generator.is_done() {
        points.push(generator.next_point());
    }
    points
}

/// Checks that each derivative integrates to the quantity below it: a jump of size J anywhere would
/// leave J, while the trapezium rule on a continuous function leaves its curvature times dt^3/12. The
/// bounds scale with the local frequency; `steepness` is the largest snap in units of A_G w^2.
fn assert_continuous(points: &[CommandPoint], amplitude_m_s2: f64, steepness: f64) {
    let dt = 1.0 / SAMPLE_RATE_HZ;
    for pair in points.windows(2) {
        let (a, b) = (&pair[0], &pair[1]);
        let Some(phase) = a.phase else { continue };
        let w = TAU * phase.frequency_hz.max(b.phase.map_or(0.0, |phase| phase.frequency_hz));
        let trapezium = |ya: f64, yb: f64| 0.5 * dt * (ya + yb);
        let x = b.command.displacement_m
            - a.command.displacement_m
            - trapezium(a.command.velocity_m_s, b.command.velocity_m_s);
        let v = b.command.velocity_m_s
            - a.command.velocity_m_s
            - trapezium(a.command.acceleration_m_s2, b.command.acceleration_m_s2);
        let acc =
            b.command.acceleration_m_s2 - a.command.acceleration_m_s2 - trapezium(a.jerk_m_s3, b.jerk_m_s3);
        let snap = steepness * amplitude_m_s2 * w * w;
        assert!(x.abs() < snap / w * dt.powi(3) + 1e-15, "displacement jumps {x} m at {a:?}");
        assert!(v.abs() < snap * dt.powi(3) + 1e-15, "velocity jumps {v} m/s at {a:?}");
        assert!(acc.abs() < snap * dt * dt, "acceleration jumps {acc} m/s2 at {a:?}");
        assert!((b.jerk_m_s3 - a.jerk_m_s3).abs() < snap * dt, "jerk jumps at {a:?}");
    }
}

#[test]
fn the_paper_command_is_continuous_from_rest_to_rest() {
    let spec = SweepSpec::paper();
    let mut generator = generator(&spec);
    let nominal_s = generator.schedule().duration_s();
    let points = points(&mut generator);
    let amplitude = spec.acceleration_m_s2();
    assert_continuous(&points, amplitude, 3.0);
    assert_eq!(points.len() as u64, (nominal_s * SAMPLE_RATE_HZ).ceil() as u64 + 1);
    let (first, last) = (points[0], points[points.len() - 1]);
    for end in [first, last] {
        assert_eq!(end.command, Command::default(), "at rest");
    }
    let worst = points.iter().map(|p| p.command.acceleration_m_s2.abs()).fold(0.0, f64::max);
    assert!(worst / amplitude < 1.0625 && worst / amplitude > 1.05, "{}", worst / amplitude);
}

#[test]
fn counted_cycles_are_pure_and_complete() {
    let spec = SweepSpec::paper();
    let mut generator = generator(&spec);
    let steps = generator.schedule().steps().to_vec();
    let mut counted = vec![0u32; steps.len()];
    let mut i = 0u64;
    while !generator.is_done() {
        let point = generator.next_point();
        let time_s = i as f64 / SAMPLE_RATE_HZ;
        i += 1;
        let Ok(index) = usize::try_from(point.counted_step()) else { continue };
        let step = steps[index];
        counted[index] += 1;
        // an independent writing of the step: x = -X sin(w (t - t_k)) with the nominal start
        let phase = TAU * step.frequency_hz * (time_s - step.start_s);
        let x = -step.displacement_amplitude_m * phase.sin();
        let a = step.acceleration_amplitude_m_s2 * phase.sin();
        assert!((point.command.displacement_m - x).abs() < 1e-12);
        assert!((point.command.acceleration_m_s2 - a).abs() < 1e-10);
        assert!((point.phase.expect("in a step").phase_rad - phase).abs() < 1e-8);
    }
    for (step, &samples) in steps.iter().zip(&counted) {
        let expected = f64::from(step.cycles) / step.frequency_hz * SAMPLE_RATE_HZ;
        assert!((f64::from(samples) - expected).abs() <= 1.0, "{step:?}: {samples}");
    }
}

#[test]
fn ideal_concatenation_has_no_ramps_and_jumps_in_velocity_only() {
    let spec = SweepSpec { transition: Transition::None, ..short(vec![0.5, 0.6], 2) };
    let mut generator = generator(&spec);
    let points = points(&mut generator);
    assert!(points.iter().all(|p| matches!(p.segment, Segment::Step | Segment::Done)));
    let jump = points
        .windows(2)
        .map(|pair| (pair[1].command.velocity_m_s - pair[0].command.velocity_m_s).abs())
        .take((5.0 * SAMPLE_RATE_HZ) as usize)
        .fold(0.0, f64::max);
    // (A_G / 2 pi)(1/0.5 - 1/0.6) = 26 mm/s
    assert!((jump - 0.026).abs() < 5e-4, "{jump}");
}

#[test]
fn settling_waits_and_then_counts_whole_cycles() {
    let settling = Some(Settling { tolerance: 0.01, max_cycles: 8 });
    let spec = SweepSpec { settling, ..short(vec![1.0, 2.0], 3) };
    let mut generator = generator(&spec);
    let mut first_counted = [None, None];
    let mut cycles = [0.0f64; 2];
    while !generator.is_done() {
        let point = generator.next_point();
        let Some(phase) = point.phase.filter(|p| point.segment == Segment::Step && p.index < 2) else {
            continue;
        };
        let i = phase.index as usize;
        cycles[i] = cycles[i].max(phase.phase_rad / TAU);
        if phase.counted && first_counted[i].is_none() {
            first_counted[i] = Some((phase.phase_rad / TAU).floor());
        }
        // step 0 settles within its third cycle; step 1 never does
        if i == 0 && phase.phase_rad > 2.5 * TAU {
            generator.settled(0);
            generator.settled(1);
        }
    }
    assert_eq!(first_counted, [Some(3.0), Some(8.0)]);
    assert!(cycles[0] > 5.99 && cycles[0] <= 6.0, "{cycles:?}");
    assert!(cycles[1] > 10.99 && cycles[1] <= 11.0, "{cycles:?}");
}

#[test]
fn a_hold_repeats_the_step_uncounted_and_resumes_on_a_whole_cycle() {
    let spec = short(vec![1.0, 1.5], 4);
    let mut generator = generator(&spec);
    generator.hold_at_step_end();
    let mut points = Vec::new();
    for _ in 0..(20.3 * SAMPLE_RATE_HZ) as usize {
        points.push(generator.next_point());
    }
    assert!(points.iter().all(|p| p.phase.expect("moving").index == 0), "stays in step 0");
    let counted = points.iter().filter(|p| p.counted_step() == 0).count();
    assert_eq!(counted, (4.0 * SAMPLE_RATE_HZ) as usize, "held cycles do not count");
    generator.resume();
    while !generator.is_done() {
        points.push(generator.next_point());
    }
    assert_continuous(&points, spec.acceleration_m_s2(), 8.0);
    let left = points.iter().position(|p| p.segment == Segment::Transition).expect("went on");
    // ramp of 2 s, then whole seconds at 1 Hz
    assert_eq!(left, (21.0 * SAMPLE_RATE_HZ) as usize);
    assert!(generator.remaining_s() == 0.0);
}

#[test]
fn skipping_keeps_the_phase() {
    let spec = short(vec![0.7, 1.1, 2.3], 3);
    let (mut whole, mut skipping) = (generator(&spec), generator(&spec));
    for i in 0u64..20_000 {
        let expected = whole.next_point();
        if i % 97 < 40 {
            skipping.skip(1);
        } else {
            assert_eq!(skipping.next_point(), expected);
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]

    /// Any list of frequencies: continuous, closed at both ends, peak displacement that of the steps.
    #[test]
    fn any_sweep_is_continuous(
        frequencies in prop::collection::vec(0.4f64..4.0, 1..5),
        cycles in 1u32..4,
        transition_cycles in 1u32..4,
        ramp_cycles in 1u32..4,
    ) {
        // neighbours within a factor of two: beyond it a single cycle of transition needs several A_G
        let mut list = frequencies;
        for i in 1..list.len() {
            list[i] = list[i].clamp(list[i - 1] / 2.0, list[i - 1] * 2.0);
        }
        let spec = SweepSpec { transition_cycles, ramp_cycles, ..short(list, cycles) };
        let mut generator = generator(&spec);
        let points = points(&mut generator);
        assert_continuous(&points, spec.acceleration_m_s2(), 60.0);
        let last = points.last().expect("points");
        prop_assert_eq!(last.command, Command::default());
    }

    /// In counted cycles `a = A_G sin(phase)` and `x = -X sin(phase)`, whatever the schedule.
    #[test]
    fn phase_and_command_agree(hz in 0.3f64..6.0, cycles in 1u32..6, ag in 0.01f64..0.1) {
        let spec = SweepSpec { acceleration_g: ag, ..short(vec![hz, hz * 1.2], cycles) };
        let mut generator = generator(&spec);
        while !generator.is_done() {
            let point = generator.next_point();
            if point.counted_step() < 0 { continue; }
            let phase = point.phase.expect("in a step");
            let a = phase.acceleration_amplitude_m_s2 * phase.phase_rad.sin();
            prop_assert!((point.command.acceleration_m_s2 - a).abs() < 1e-11);
            let w = TAU * phase.frequency_hz;
            prop_assert!((point.command.displacement_m + a / (w * w)).abs() < 1e-11);
        }
    }
}
