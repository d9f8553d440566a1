//! Where most of the misfit lives, in one sentence.

use super::slices::{Cells, Sums};
use super::{StepMisfit, window::Window};
use crate::sweep::Direction;

/// What of the sums is told: residual, and samples.
type Pick = fn(&Sums) -> (f64, f64);

/// The sentence: place by regime, growth with amplitude, dependence on time.
pub fn sentence(force: Option<&Cells>, response: &Cells, windows: &[Window], steps: &[StepMisfit]) -> String {
    let (cells, what, pick): (&Cells, &str, Pick) = match force {
        Some(cells) => (cells, "residual force", |sums| (sums.force[0], sums.force_count)),
        None if response.total().a[1] > 0.0 => (response, "misfit of A", |sums| (sums.a[0], sums.count)),
        None => (response, "misfit of D", |sums| (sums.d[0], sums.count)),
    };
    let mut text = place(cells, what, pick);
    let trends = [growth(steps), with_time(windows, steps)];
    for trend in trends.into_iter().flatten() {
        text.push_str("; ");
        text.push_str(&trend);
    }
    text.push('.');
    text
}

fn place(cells: &Cells, what: &str, pick: Pick) -> String {
    let (total, samples) = pick(&cells.total());
    if total <= 0.0 {
        return format!("no {what} to speak of");
    }
    let mut places = cells.places();
    if places.len() < 2 {
        // One regime all the time tells nothing: the way of the motion does.
        places = cells.ways();
    }
    // The narrowest place that holds most of it: a cell, else a side or a way, else all contact.
    let most = |places: &[(String, Sums)]| places.iter().map(|(_, sums)| pick(sums).0).fold(0.0, f64::max);
    for wider in [unions(&places, &NARROW), unions(&places, &WIDE)] {
        if most(&places) < MOST * total {
            places.extend(wider);
        }
    }
    places.sort_by(|a, b| pick(&b.1).0.total_cmp(&pick(&a.1).0));
    match places.first() {
        Some((name, sums)) => {
            let (residual, count) = pick(sums);
            format!(
                "{:.0} % of the {what} (squares) lies in {name}, which is {:.0} % of the samples",
                100.0 * residual / total,
                100.0 * count / samples.max(1.0)
            )
        }
        None => format!("no {what} to speak of"),
    }
}

/// Share of the misfit that counts as most of it.
const MOST: f64 = 0.6;
/// Unions of places: what their names begin and end with, and how they are called.
const NARROW: [(&str, &str, &str); 5] = [
    ("right contact", "", "right contact"),
    ("left contact", "", "left contact"),
    ("", "contact while approaching", "contact while approaching, on either side"),
    ("", "contact while leaving", "contact while leaving, on either side"),
    ("free motion", "", "free motion"),
];
const WIDE: [(&str, &str, &str); 1] = [("", "approaching|leaving", "contact on either side")];

fn unions(places: &[(String, Sums)], of: &[(&str, &str, &str)]) -> Vec<(String, Sums)> {
    let union = |(from, to, name): &(&str, &str, &str)| {
        let fits = |place: &str| place.starts_with(from) && to.split('|').any(|end| place.ends_with(end));
        let parts: Vec<_> = places.iter().filter(|(place, _)| fits(place)).collect();
        let mut sums = Sums::default();
        parts.iter().for_each(|(_, part)| sums += part);
        (parts.len() > 1).then_some(((*name).to_owned(), sums))
    };
    of.iter().filter_map(union).collect()
}

/// What of a step's misfit is told: the residual force, else the residual of A or D.
fn level(step: &StepMisfit) -> Option<f64> {
    step.force_residual_n.or(step.rms_a_residual_m_s2).or(step.rms_d_residual_m).filter(|x| *x > 0.0)
}

/// Exponent of the misfit over the amplitude of D, from steps of different amplitude.
fn growth(steps: &[StepMisfit]) -> Option<String> {
    let points: Vec<(f64, f64)> = steps
        .iter()
        .filter_map(|step| {
            Some((step.rms_d_measured_m.or(step.rms_a_measured_m_s2)?.ln(), level(step)?.ln()))
        })
        .filter(|(x, y)| x.is_finite() && y.is_finite())
        .collect();
    let n = points.len() as f64;
    let (x, y) = points.iter().fold((0.0, 0.0), |(x, y), p| (x + p.0 / n, y + p.1 / n));
    let sxx: f64 = points.iter().map(|p| (p.0 - x).powi(2)).sum();
    let syy: f64 = points.iter().map(|p| (p.1 - y).powi(2)).sum();
    let sxy: f64 = points.iter().map(|p| (p.0 - x) * (p.1 - y)).sum();
    // Less than a spread of 1.4 in amplitude tells nothing.
    if points.len() < 5 || sxx / n < 0.17_f64.powi(2) {
        return None;
    }
    let (slope, correlation) = (sxy / sxx, sxy / (sxx * syy).sqrt().max(1e-300));
    Some(if correlation.abs() < 0.6 || slope.abs() < 0.2 {
        "hardly changes with the amplitude of D".to_owned()
    } else {
        let way = if slope > 0.0 { "grows" } else { "falls" };
        format!("{way} with the amplitude of D (power {slope:.1})")
    })
}

/// Forward against backward at equal frequency and amplitude.
fn with_time(windows: &[Window], steps: &[StepMisfit]) -> Option<String> {
    let size = |step: &StepMisfit| step.rms_d_measured_m.or(step.rms_a_measured_m_s2);
    let mut logs = Vec::new();
    for (i, early) in steps.iter().enumerate() {
        for (j, late) in steps.iter().enumerate().skip(i + 1) {
            let opposite = windows.get(i).zip(windows.get(j)).is_some_and(|(a, b)| {
                a.direction == Some(Direction::Forward) && b.direction == Some(Direction::Backward)
            });
            let close = |a: f64, b: f64, tolerance: f64| (a / b - 1.0).abs() < tolerance;
            let (Some(f0), Some(f1)) = (early.frequency_hz, late.frequency_hz) else { continue };
            let (Some(s0), Some(s1), Some(l0), Some(l1)) =
                (size(early), size(late), level(early), level(late))
            else {
                continue;
            };
            if opposite && close(f0, f1, 0.01) && close(s0, s1, 0.2) {
                logs.push((l1 / l0).ln());
            }
        }
    }
    if logs.len() < 3 {
        return None;
    }
    logs.sort_by(f64::total_cmp);
    let ratio = logs[logs.len() / 2].exp();
    Some(if (0.8..1.25).contains(&ratio) {
        "not with time".to_owned()
    } else {
        format!("changes with time ({ratio:.2} times as large on the way back)")
    })
}
