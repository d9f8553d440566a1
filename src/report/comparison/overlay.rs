//! Measurement and model over one another: loops, phase portraits and histories of a few stretches.

use super::{Unit, motion};
use crate::compare::{Comparison, Window};
use crate::record::Kind;
use crate::report::{Chart, Ink, Page, ReportError, Stroke};
use std::ops::Range;

/// Cycles of a step that are drawn.
const CYCLES: usize = 3;
/// Pieces from which the worst is taken when a record has no steps.
const PIECES: usize = 40;
/// Most points of a line.
const POINTS: usize = 1500;

/// A stretch worth looking at, and why.
struct Stretch {
    why: String,
    range: Range<usize>,
    /// Samples of a cycle.
    cycle: usize,
}

/// Adds the overlays of the largest response, of the worst step and of one more.
pub fn add(page: &mut Page, comparison: &Comparison) -> Result<(), ReportError> {
    for stretch in stretches(comparison) {
        page.section(&stretch.why);
        let (loops, histories) = (loops(comparison, &stretch), histories(comparison, &stretch));
        for row in [loops, histories] {
            let row: Vec<(&Chart, &str)> = row.iter().map(|(chart, text)| (chart, text.as_str())).collect();
            page.figures(&row)?;
        }
    }
    Ok(())
}

/// Squared residual and squared measurement of what is compared first: A, else D.
fn sizes(comparison: &Comparison, range: &Range<usize>) -> (f64, f64) {
    let channels = &comparison.channels;
    let (measured, model) = if channels.measured_a.is_empty() {
        (&channels.measured_d, &channels.model_d)
    } else {
        (&channels.measured_a, &channels.model_a)
    };
    let pairs = range.clone().filter_map(|i| Some((*measured.get(i)?, *model.get(i)?)));
    let (residual, size) = pairs.fold((0.0, 0.0), |(r, s), (y, m)| (r + (y - m).powi(2), s + y * y));
    let n = range.len().max(1) as f64;
    (residual / n, size / n)
}

fn stretches(comparison: &Comparison) -> Vec<Stretch> {
    let rate = comparison.sample_rate_hz;
    let periodic: Vec<&Window> = comparison.windows.iter().filter(|w| w.frequency_hz.is_some()).collect();
    if periodic.is_empty() {
        return worst_piece(comparison).into_iter().collect();
    }
    let largest_of =
        |of: &dyn Fn(&Window) -> f64| periodic.iter().copied().max_by(|a, b| of(a).total_cmp(&of(b)));
    let size = |window: &Window| sizes(comparison, &window.counted).1;
    let misfit = |window: &Window| sizes(comparison, &window.counted).0;
    let relative = |window: &Window| misfit(window) / size(window).max(f64::MIN_POSITIVE);
    let mut chosen: Vec<(&str, &Window)> = Vec::new();
    for (why, window) in [
        ("Largest response", largest_of(&size)),
        ("Largest misfit", largest_of(&misfit)),
        ("Largest misfit for its response", largest_of(&relative)),
    ] {
        let Some(window) = window else { continue };
        match chosen
            .iter_mut()
            .find(|(_, other)| other.step == window.step && other.counted == window.counted)
        {
            Some((title, _)) if *title == "Largest response" => {
                *title = "Largest response and largest misfit"
            }
            Some(_) => {}
            None => chosen.push((why, window)),
        }
    }
    chosen
        .into_iter()
        .map(|(why, window)| {
            let cycle = window.cycle_samples(rate);
            let from = window.counted.end.saturating_sub(CYCLES * cycle + 1).max(window.counted.start);
            let hz = window.frequency_hz.map_or_else(String::new, |f| format!(", {f:.3} Hz"));
            let way = window.direction.map_or_else(String::new, |way| format!(", {}", way.label()));
            let why = format!("{why}: step {}{hz}{way}", window.step);
            Stretch { why, range: from..window.counted.end, cycle }
        })
        .collect()
}

fn worst_piece(comparison: &Comparison) -> Option<Stretch> {
    let counted = &comparison.windows.first()?.counted;
    let wide = (counted.len() / PIECES).max(16).min(counted.len());
    let pieces =
        (counted.start..counted.end.saturating_sub(wide)).step_by(wide.max(1)).map(|at| at..at + wide);
    let range = pieces
        .max_by(|a, b| sizes(comparison, a).0.total_cmp(&sizes(comparison, b).0))
        .unwrap_or_else(|| counted.clone());
    let from_s = range.start as f64 / comparison.sample_rate_hz;
    Some(Stretch { why: format!("Largest misfit: from {from_s:.3} s on"), cycle: wide / 3, range })
}

type Figures = Vec<(Chart, String)>;

fn both(chart: Chart, measured: Vec<(f64, f64)>, model: Vec<(f64, f64)>) -> Chart {
    let chart = if measured.is_empty() {
        chart
    } else {
        chart.line(Some("measured"), Stroke::solid(Ink::Measured), measured)
    };
    chart.line(Some("model"), Stroke::dashed(Ink::Model).width(2.0), model)
}

/// Every so many samples of a range that a line stays light.
fn thinned(range: &Range<usize>) -> impl Iterator<Item = usize> + Clone {
    range.clone().step_by((range.len() / POINTS).max(1))
}

/// Loop of force (or A) over D, and the phase portrait, as far as they were measured.
fn loops(comparison: &Comparison, stretch: &Stretch) -> Figures {
    let (channels, range) = (&comparison.channels, &stretch.range);
    let component = comparison.kind == Kind::Component;
    let measured_d = motion(comparison);
    let model_d = if component { measured_d } else { &channels.model_d };
    if measured_d.is_empty() {
        return Vec::new();
    }
    let length = Unit::of(measured_d, 1.0, "m");
    let across = format!("Displacement D ({})", length.name);
    let pairs = |x: &[f64], y: &[f64], sx: f64, sy: f64| -> Vec<(f64, f64)> {
        thinned(range).filter_map(|i| Some((sx * x.get(i)?, sy * y.get(i)?))).collect()
    };
    let mut figures = Vec::new();
    if !channels.measured_a.is_empty() {
        let (unit, label) = response(comparison);
        let chart = both(
            Chart::new(&across, &label).size(560.0, 400.0),
            pairs(measured_d, &channels.measured_a, length.scale, unit.scale),
            pairs(model_d, &channels.model_a, length.scale, unit.scale),
        );
        let text = if component { "Force over displacement." } else { "Hysteresis loop A(D)." };
        figures.push((chart, text.to_owned()));
    }
    let rate = |d: &[f64]| -> Vec<f64> {
        let wide = (stretch.cycle / 80).max(1);
        let slope = |i: usize| {
            let (from, to) = (i.saturating_sub(wide), (i + wide).min(d.len() - 1));
            (d[to] - d[from]) * comparison.sample_rate_hz / (to - from).max(1) as f64
        };
        // Only the stretch is needed; the rest stays zero.
        let mut out = vec![0.0; d.len()];
        range.clone().for_each(|i| out[i] = slope(i));
        out
    };
    let (measured_v, model_v) = (rate(measured_d), if component { Vec::new() } else { rate(model_d) });
    let speed = Unit::of(&measured_v, 1.0, "m/s");
    let chart = Chart::new(&across, &format!("Velocity D' ({})", speed.name)).size(560.0, 400.0);
    let measured = pairs(measured_d, &measured_v, length.scale, speed.scale);
    let (chart, text) = if component {
        let line = Stroke::solid(Ink::Measured);
        (chart.line(Some("imposed"), line, measured), "Phase portrait of the imposed motion.")
    } else {
        let model = pairs(model_d, &model_v, length.scale, speed.scale);
        (both(chart, measured, model), "Phase portrait D'(D).")
    };
    figures.push((chart, text.to_owned()));
    figures
}

/// A, or the force of a component.
fn response(comparison: &Comparison) -> (Unit, String) {
    let a = &comparison.channels.measured_a;
    if comparison.kind == Kind::Component {
        let unit = Unit::of(a, comparison.mass_kg, "N");
        let label = format!("Force ({})", unit.name);
        // The channel is minus the force over the mass.
        (Unit { scale: -comparison.mass_kg * unit.scale, ..unit }, label)
    } else {
        let unit = Unit::of(a, 1.0, "m/s2");
        let label = format!("Absolute acceleration A ({})", unit.name);
        (unit, label)
    }
}

/// Measurement, model and their difference over time.
fn histories(comparison: &Comparison, stretch: &Stretch) -> Figures {
    let (channels, range) = (&comparison.channels, &stretch.range);
    let start = range.start;
    let line = |values: &dyn Fn(usize) -> Option<f64>| -> Vec<(f64, f64)> {
        let time = |i: usize| (i - start) as f64 / comparison.sample_rate_hz;
        thinned(range).filter_map(|i| Some((time(i), values(i)?))).collect()
    };
    let mut figures = Vec::new();
    let mut add = |measured: &[f64], model: &[f64], unit: &Unit, label: &str| {
        if measured.is_empty() {
            return;
        }
        let chart = both(
            Chart::new("Time since the first of these samples (s)", label).size(560.0, 300.0),
            line(&|i| Some(unit.scale * measured.get(i)?)),
            line(&|i| Some(unit.scale * model.get(i)?)),
        )
        .line(
            Some("measured - model"),
            Stroke::solid(Ink::Other(1)).width(1.0),
            line(&|i| Some(unit.scale * (measured.get(i)? - model.get(i)?))),
        );
        figures.push((chart, "The same cycles over time, with what is left between them.".to_owned()));
    };
    let (unit, label) = response(comparison);
    add(&channels.measured_a, &channels.model_a, &unit, &label);
    let unit = Unit::of(&channels.measured_d, 1.0, "m");
    add(&channels.measured_d, &channels.model_d, &unit, &format!("Displacement D ({})", unit.name));
    figures
}
