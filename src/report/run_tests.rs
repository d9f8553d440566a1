use super::*;
use crate::stream::Row;
use crate::sweep::{Generator, Schedule, SweepSpec};
use crate::units::SAMPLE_RATE_HZ;
use std::f64::consts::TAU;

/// Rows of a linear oscillator of 1.3 Hz (6 % damping, semi-implicit steps) on an ideal table; its
/// "model" is 5 % stiffer.
fn rows(spec: &SweepSpec) -> (Vec<Row>, Schedule) {
    let schedule = Schedule::new(spec).expect("valid");
    let mut generator = Generator::new(&schedule, SAMPLE_RATE_HZ);
    let mut rows = Vec::new();
    let mut oscillators = [(1.3, 0.0, 0.0), (1.33, 0.0, 0.0)];
    while !generator.is_done() {
        let point = generator.next_point();
        let mut row = Row { command: point.command, step: point.counted_step(), ..Row::default() };
        let response = oscillators.each_mut().map(|(hz, d, v)| {
            let w = TAU * *hz;
            let force = -(w * w * *d + 0.12 * w * *v);
            *v += (force - point.command.acceleration_m_s2) / SAMPLE_RATE_HZ;
            *d += *v / SAMPLE_RATE_HZ;
            (*d, force)
        });
        row.sample.sequence = rows.len() as u64;
        let channels = &mut row.sample.channels;
        channels.table_displacement_m = point.command.displacement_m;
        channels.table_acceleration_m_s2 = point.command.acceleration_m_s2;
        (channels.relative_displacement_m, channels.mass_acceleration_1_m_s2) = response[0];
        channels.mass_acceleration_2_m_s2 = response[0].1;
        (row.model_displacement_m, row.model_acceleration_m_s2) = response[1];
        rows.push(row);
    }
    (rows, schedule)
}

fn point(index: u32, direction: Direction, frequency_hz: f64, a: f64, e: f64) -> StepPoint {
    StepPoint {
        index,
        direction,
        frequency_hz,
        a_max_m_s2: a,
        excursion_m: e,
        model_a_max_m_s2: 1.1 * a,
        model_excursion_m: 1.1 * e,
        nrmse_a: 0.02,
        nrmse_d: 0.01,
        table_amplitude_ratio: 0.998,
    }
}

fn report() -> RunReport {
    let spec = SweepSpec { cycles: 6, ..SweepSpec::paper() }.restricted(0.8, 2.0).expect("steps");
    let (rows, schedule) = rows(&spec);
    let mut series = RunSeries::new(SAMPLE_RATE_HZ);
    rows.iter().for_each(|row| series.push(row));
    let steps = schedule.steps().iter().map(|step| {
        let q = 1.0 / ((1.0 - (step.frequency_hz / 1.3).powi(2)).powi(2) + 0.015).sqrt();
        let shift = if step.direction == Direction::Forward { 1.0 } else { 0.93 };
        point(step.index, step.direction, step.frequency_hz, 0.49 * q * shift, 0.015 * q * shift)
    });
    let steps: Vec<_> = steps.collect();
    RunReport {
        title: "B0 at 0.05 g".into(),
        lead: "Done.".into(),
        notes: vec!["3 samples lost".into()],
        summary: peaks_table(
            true,
            [("measured", peaks(&steps, measured)), ("onboard model", peaks(&steps, modelled))],
        ),
        planned_steps: steps.len(),
        published: vec![("Table 2".into(), Peaks { frequency_hz: 1.4, a_max_m_s2: 2.9, excursion_m: 0.07 })],
        steps,
        series,
        timing: None,
        losses: Table::new(["", "lost"]).row(["samples", "0"]),
        configuration: vec![("sweep".into(), "start_hz = <0.5>".into())],
    }
}

#[test]
fn peaks_are_those_of_the_forward_sweep() {
    let steps = [
        point(0, Direction::Forward, 1.0, 1.0, 0.03),
        point(1, Direction::Forward, 1.1, 2.0, 0.02),
        point(2, Direction::Backward, 1.1, 9.0, 0.09),
    ];
    let found = peaks(&steps, measured).expect("steps");
    assert_eq!(found, Peaks { frequency_hz: 1.1, a_max_m_s2: 2.0, excursion_m: 0.03 });
    assert_eq!(peaks(&steps[2..], measured).expect("backward only").a_max_m_s2, 9.0);
    assert_eq!(peaks(&[], measured), None);
    let text = peaks_table(true, [("measured", Some(found)), ("Table 2", None)]).text();
    assert!(text.contains("measured                   1.10          2.00        30.0"), "{text}");
}

#[test]
fn the_page_is_self_contained_and_has_all_figures() {
    let html = report().page().expect("drawn").html();
    assert_eq!(html.matches("<svg").count(), 14);
    for text in [
        "measured, forward",
        "model, backward",
        "Hysteresis loop",
        "Phase portrait",
        "Command x (mm)",
        "Table 2",
    ] {
        assert!(html.contains(text), "{text}");
    }
    let outside = html.replace("http://www.w3.org/2000/svg", "");
    assert!(!outside.contains("http") && !outside.contains("<script"), "nothing is fetched or run");
    assert!(html.contains("start_hz = &lt;0.5&gt;"));
    assert!(html.contains("prefers-color-scheme:dark"));
    assert!(html.len() < 2_000_000, "{} bytes", html.len());
}

#[test]
fn what_is_largest_so_far_is_no_pseudo_resonance() {
    let whole = report();
    let planned = whole.planned_steps;
    let at =
        whole.steps.iter().position(|step| step.frequency_hz == whole.top().expect("steps").frequency_hz);
    let stopped = |steps: usize| RunReport { steps: whole.steps[..steps].to_vec(), ..whole.clone() };
    let told = |run: &RunReport| run.page().expect("drawn").html().contains("At pseudo-resonance, ");
    assert!(told(&whole), "the sweep is over");
    let forward = whole.steps.iter().filter(|step| step.direction == Direction::Forward).count();
    assert!(told(&stopped(forward + 1)), "it turned back");
    for steps in [2, at.expect("there") + 1, at.expect("there") + 2] {
        assert!(!told(&stopped(steps)), "{steps} of {planned}");
    }
    // A sweep that ends below the resonance does not have it either.
    let below = stopped(at.expect("there"));
    assert!(!passes_resonance(&below.steps, below.steps.len()));
    let text = peaks_table(false, [("measured", peaks(&below.steps, measured))]).text();
    assert!(text.contains("A_max at (Hz)") && !text.contains("pseudo-resonance"), "{text}");
}

#[test]
fn a_run_without_steps_or_samples_still_has_a_page() {
    let empty =
        RunReport { steps: Vec::new(), series: RunSeries::new(2048.0), published: Vec::new(), ..report() };
    let html = empty.page().expect("drawn").html();
    assert!(html.contains("Timing and losses"));
}

/// The loop at pseudo-resonance is that of the linear oscillator: an ellipse whose slope is -w^2.
#[test]
fn the_loop_at_resonance_has_the_slope_of_the_spring() {
    let report = report();
    let s = &report.series;
    let step = report.top().expect("steps");
    let window = s.end_of_step(step.index, 3.0 / step.frequency_hz);
    let (mut dd, mut da) = (0.0, 0.0);
    for i in window {
        let (d, a) = (f64::from(s.relative_m[i]), f64::from(s.mass_acceleration_m_s2[i]));
        dd += d * d;
        da += d * a;
    }
    let w = (TAU * 1.3).powi(2);
    assert!((-da / dd / w - 1.0).abs() < 5e-3, "{}", -da / dd / w);
}
