//! The page of a comparison: where the model fails, in figures and tables.
//!
//! `compare --report` writes it; the tables also go to the terminal. All figures are drawn from the
//! channels that a [`Comparison`] keeps, in units that fit the record's magnitudes.

mod overlay;
pub mod tables;

use super::{Chart, Heat, Ink, Marker, Page, ReportError, Stroke, envelope};
use crate::compare::{Comparison, ForceMap, Method, StepMisfit};
use crate::record::Kind;
use crate::sweep::Direction;

/// Columns of the residual force over time.
const COLUMNS: usize = 1400;
/// Steps from which curves over the frequency are drawn.
const CURVE_STEPS: usize = 3;

/// A unit with its decimal prefix.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Unit {
    /// From SI to this unit.
    pub(super) scale: f64,
    pub(super) name: String,
}

impl Unit {
    /// Prefix that suits the largest of `factor` times the values.
    pub(super) fn of(values: &[f64], factor: f64, name: &str) -> Self {
        Self::up_to(
            factor * values.iter().filter(|x| x.is_finite()).fold(0.0, |top: f64, x| top.max(x.abs())),
            name,
        )
    }

    fn up_to(largest: f64, name: &str) -> Self {
        let (scale, prefix) = match largest.abs() {
            x if x >= 5e3 && name == "N" => (1e-3, "k"),
            x if x >= 0.5 || x == 0.0 => (1.0, ""),
            x if x >= 5e-4 => (1e3, "m"),
            x if x >= 5e-7 => (1e6, "u"),
            _ => (1e9, "n"),
        };
        Self { scale, name: format!("{prefix}{name}") }
    }
}

/// The displacement: measured, or imposed.
fn motion(comparison: &Comparison) -> &[f64] {
    let channels = &comparison.channels;
    if channels.measured_d.is_empty() { &channels.imposed_d } else { &channels.measured_d }
}

/// How the model was run, in words.
pub fn method(comparison: &Comparison) -> String {
    let how = match comparison.method {
        Method::FromRest => "simulated from rest".to_owned(),
        Method::WarmStart { from_s } => format!("simulated from the measured motion at {from_s:.3} s on"),
        Method::ShortHorizons { horizon_s } => format!("simulated over horizons of {horizon_s:.4} s"),
        Method::Imposed => "measured motion imposed, force compared".to_owned(),
    };
    match comparison.band_hz {
        Some([low, high]) => format!("{how}; both sides band-passed {low:.3}-{high:.1} Hz"),
        None => how,
    }
}

/// The page.
///
/// # Errors
/// [`ReportError::Figure`] when a figure cannot be drawn.
pub fn page(comparison: &Comparison) -> Result<Page, ReportError> {
    let mut page = Page::new(&format!("{} against {}", comparison.record, comparison.model));
    page.text(&comparison.sentence);
    page.text(&format!("The model was {}.", method(comparison)));
    for finding in &comparison.quality {
        page.note(&finding.text);
    }
    for note in &comparison.notes {
        page.note(note);
    }
    page.table(&tables::summary(comparison));
    page.text(
        "NRMSE: root-mean-square of the residual over that of the measurement, counted cycles. The noise \
         floor is what a perfect model would leave, measured from this record.",
    );
    curves(&mut page, comparison)?;
    harmonics(&mut page, comparison)?;
    overlay::add(&mut page, comparison)?;
    force(&mut page, comparison)?;
    phases(&mut page, comparison)?;
    page.section("Where the misfit lies");
    for (_, table) in tables::groups(comparison) {
        page.table(&table);
    }
    if !comparison.steps.is_empty() {
        page.folded_table("All steps", &tables::steps(comparison));
        page.folded_table("Fundamental and harmonics", &tables::harmonics(comparison));
    }
    Ok(page)
}

/// Curves of a quantity over frequency, forward and backward apart; steps that are neither in one line.
fn over_frequency(
    mut chart: Chart,
    comparison: &Comparison,
    name: &str,
    dashed: bool,
    pick: impl Fn(&StepMisfit) -> Option<f64>,
) -> Chart {
    let ways = [
        (Some(Direction::Forward), ", forward", Ink::Forward, 2.4),
        (Some(Direction::Backward), ", backward", Ink::Backward, 1.3),
        (None, "", Ink::Measured, 1.5),
    ];
    for (direction, suffix, ink, width_px) in ways {
        let there = comparison.steps.iter().filter(|step| step.direction == direction);
        let mut points: Vec<(f64, f64)> =
            there.filter_map(|step| Some((step.frequency_hz?, pick(step)?))).collect();
        points.sort_by(|a, b| a.0.total_cmp(&b.0));
        let stroke = if dashed { Stroke::dashed(ink) } else { Stroke::solid(ink) };
        if !points.is_empty() {
            chart = chart.line(Some(&format!("{name}{suffix}")), stroke.width(width_px), points);
        }
    }
    chart
}

fn curves(page: &mut Page, comparison: &Comparison) -> Result<(), ReportError> {
    if comparison.steps.len() < CURVE_STEPS || comparison.kind == Kind::Component {
        return Ok(());
    }
    page.section("Curves over frequency");
    let error = &comparison.error;
    let largest = |of: fn(&StepMisfit) -> Option<f64>| {
        comparison.steps.iter().filter_map(of).fold(0.0, |top: f64, x| top.max(x))
    };
    let mut figures: Vec<(Chart, &str)> = Vec::new();
    let mut add = |label: &str,
                   unit: Unit,
                   measured: fn(&StepMisfit) -> Option<f64>,
                   model: fn(&StepMisfit) -> Option<f64>| {
        let chart = Chart::new("Frequency f (Hz)", &format!("{label} ({})", unit.name)).size(560.0, 340.0);
        let chart = over_frequency(chart, comparison, "measured", false, |s| Some(unit.scale * measured(s)?));
        let chart = over_frequency(chart, comparison, "model", true, |s| Some(unit.scale * model(s)?));
        figures.push((chart, "Peaks over the counted cycles of each step."));
    };
    if error.nrmse_a.is_some() {
        let unit = Unit::up_to(largest(|s| s.a_max_m_s2), "m/s2");
        add("A_max", unit, |s| s.a_max_m_s2, |s| s.model_a_max_m_s2);
    }
    if error.nrmse_d.is_some() {
        let unit = Unit::up_to(largest(|s| s.excursion_m), "m");
        add("Excursion E", unit, |s| s.excursion_m, |s| s.model_excursion_m);
    }
    let floor = |rms: Option<f64>, floor: Option<f64>| rms.zip(floor).map(|(rms, floor)| rms * floor);
    let mut errors = |label: &str,
                      pick: fn(&StepMisfit) -> Option<f64>,
                      rms: fn(&StepMisfit) -> Option<f64>,
                      floor: Option<f64>| {
        let chart = Chart::new("Frequency f (Hz)", label).size(560.0, 300.0);
        let chart = over_frequency(chart, comparison, "NRMSE", false, pick);
        let level = comparison.steps.iter().filter_map(|s| Some((s.frequency_hz?, floor? / rms(s)?)));
        let mut level: Vec<(f64, f64)> = level.filter(|p| p.1.is_finite()).collect();
        level.sort_by(|a, b| a.0.total_cmp(&b.0));
        let top =
            comparison.steps.iter().filter_map(pick).chain(level.iter().map(|p| p.1)).fold(0.0, f64::max);
        let chart = chart
            .line(Some("noise floor"), Stroke::dashed(Ink::Limit).width(1.2), level)
            .y_range(0.0, 1.06 * top.max(1e-9));
        figures.push((chart, "Error of each step beside what noise alone would leave."));
    };
    if error.nrmse_a.is_some() {
        errors(
            "NRMSE of A (-)",
            |s| s.nrmse_a,
            |s| s.rms_a_measured_m_s2,
            floor(error.rms_a_m_s2, error.noise_floor_a),
        );
    }
    if error.nrmse_d.is_some() {
        errors(
            "NRMSE of D (-)",
            |s| s.nrmse_d,
            |s| s.rms_d_measured_m,
            floor(error.rms_d_m, error.noise_floor_d),
        );
    }
    let all: Vec<(&Chart, &str)> = figures.iter().map(|(chart, text)| (chart, *text)).collect();
    page.figures(&all)
}

/// What is left at the fundamental and the harmonics, over frequency.
fn harmonics(page: &mut Page, comparison: &Comparison) -> Result<(), ReportError> {
    if comparison.steps.len() < CURVE_STEPS {
        return Ok(());
    }
    let of_a = comparison.steps.iter().any(|step| !step.harmonics_a.is_empty());
    let list = |step: &StepMisfit| if of_a { step.harmonics_a.clone() } else { step.harmonics_d.clone() };
    let component = comparison.kind == Kind::Component;
    let (factor, unit, what) = match (of_a, component) {
        (true, true) => (comparison.mass_kg, "N", "force"),
        (true, false) => (1.0, "m/s2", "A"),
        (false, _) => (1.0, "m", "D"),
    };
    let all: Vec<f64> =
        comparison.steps.iter().flat_map(|s| list(s).into_iter().map(|h| h.residual)).collect();
    let unit = Unit::of(&all, factor, unit);
    let mut chart =
        Chart::new("Frequency f (Hz)", &format!("Left of {what} ({})", unit.name)).size(560.0, 320.0);
    for order in 1..=5u8 {
        let mut points: Vec<(f64, f64)> = comparison
            .steps
            .iter()
            .filter_map(|step| {
                let harmonic = *list(step).get(usize::from(order) - 1)?;
                Some((step.frequency_hz?, unit.scale * factor * harmonic.residual))
            })
            .collect();
        points.sort_by(|a, b| a.0.total_cmp(&b.0));
        let name = if order == 1 { "fundamental".to_owned() } else { format!("{order}f") };
        chart = chart.points(Some(&name), Ink::Other(order - 1), Marker::Circle, 2.4, points);
    }
    let phase = Chart::new("Frequency f (Hz)", "Model leads by (deg)").size(560.0, 320.0);
    let phase = over_frequency(phase, comparison, &format!("fundamental of {what}"), false, |step| {
        Some(list(step).first()?.phase_error_rad.to_degrees())
    });
    page.section("Fundamental and harmonics");
    page.figures(&[
        (&chart, "Amplitude of measurement less model at each harmonic, phase included; all steps."),
        (&phase, "Phase of the model's fundamental against the measured one."),
    ])
}

/// Residual force over (D, D') and over time.
fn force(page: &mut Page, comparison: &Comparison) -> Result<(), ReportError> {
    let Some(map) = &comparison.residual_force else { return Ok(()) };
    page.section("Residual force -M A - F_model(D, D') along the measured motion");
    let unit =
        Unit::up_to(map.mean_n.iter().flatten().flatten().fold(0.0, |top: f64, x| top.max(x.abs())), "N");
    let mean = heat(map, &map.mean_n, "mean", true, &unit);
    let deviation = heat(map, &map.deviation_n, "deviation within a cell", false, &unit);
    page.figures(&[
        (&mean, "Mean over (D, D'): what a curve of D and D' could still take up. Red lacks in the model, blue is too much."),
        (&deviation, "Deviation at the same D and D': noise, and what no such curve can take up - memory, or time."),
    ])?;
    let mut line = Vec::new();
    let columns = (COLUMNS / comparison.windows.len().max(1)).max(2);
    for (window, values) in comparison.windows.iter().zip(&comparison.force_along) {
        let time = |i: usize| (window.counted.start + i) as f64 / comparison.sample_rate_hz;
        let time_s: Vec<f64> = (0..values.len()).map(time).collect();
        line.extend(envelope(&time_s, values, unit.scale, columns));
        line.push((f64::NAN, f64::NAN));
    }
    let chart = Chart::new("Time t (s)", &format!("Residual force ({})", unit.name))
        .size(1140.0, 260.0)
        .line(Some("residual force, counted cycles"), Stroke::solid(Ink::Other(1)).width(0.8), line);
    page.figure(&chart, "Residual force over time; gaps are not counted.")
}

fn heat(map: &ForceMap, cells: &[Vec<Option<f64>>], label: &str, signed: bool, unit: &Unit) -> Chart {
    let length = Unit::of(&map.displacement_edges_m, 1.0, "m");
    let speed = Unit::of(&map.velocity_edges_m_s, 1.0, "m/s");
    let scaled = |edges: &[f64], scale: f64| edges.iter().map(|x| x * scale).collect::<Vec<f64>>();
    let cells = cells.iter().map(|row| row.iter().map(|x| x.map(|x| x * unit.scale)).collect()).collect();
    let across = scaled(&map.displacement_edges_m, length.scale);
    let up = scaled(&map.velocity_edges_m_s, speed.scale);
    Chart::new(&format!("Displacement D ({})", length.name), &format!("Velocity D' ({})", speed.name))
        .size(560.0, 400.0)
        .heat(label, &unit.name, Heat::new(across, up, cells, signed))
}

/// Share of the misfit over the phase of the excitation.
fn phases(page: &mut Page, comparison: &Comparison) -> Result<(), ReportError> {
    if comparison.phases.is_empty() {
        return Ok(());
    }
    let line = |pick: fn(&crate::compare::Slice) -> Option<f64>| -> Vec<(f64, f64)> {
        let places = comparison.phases.iter().filter_map(|slice| {
            let from: f64 = slice.name.split('-').next()?.parse().ok()?;
            Some((from + 15.0, 100.0 * pick(slice)?))
        });
        places.collect()
    };
    let what = if comparison.kind == Kind::Component { "of the force" } else { "of A" };
    let mut chart = Chart::new("Phase of the excitation (deg)", "Share (%)").size(560.0, 280.0);
    let parts = [
        (what, Ink::Measured, line(|slice| slice.share_of_misfit_a)),
        ("of D", Ink::Model, line(|slice| slice.share_of_misfit_d)),
    ];
    let top = parts.iter().flat_map(|(_, _, points)| points).map(|p| p.1).fold(10.0, f64::max);
    for (name, ink, points) in parts.into_iter().filter(|(_, _, points)| !points.is_empty()) {
        chart = chart.line(Some(&format!("misfit {name}")), Stroke::solid(ink), points);
    }
    chart = chart
        .line(
            Some("samples"),
            Stroke::dashed(Ink::Limit).width(1.0),
            line(|slice| Some(slice.share_of_samples)),
        )
        .y_range(0.0, 1.06 * top);
    page.section("Phase of the cycle");
    page.figure(
        &chart,
        "Squared misfit in each twelfth of the cycle; 0 deg is the rising zero of the excitation.",
    )
}
