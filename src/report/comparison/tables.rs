//! The tables of a comparison, for the terminal and for its page.

use crate::compare::{Comparison, HarmonicMisfit, Slice};
use crate::record::Kind;
use crate::report::Table;
use crate::sweep::Direction;

fn number(x: Option<f64>) -> String {
    scaled(x, 1.0, 4)
}

fn percent(x: Option<f64>) -> String {
    scaled(x, 100.0, 1)
}

fn scaled(x: Option<f64>, scale: f64, decimals: usize) -> String {
    x.map_or_else(|| "-".to_owned(), |x| format!("{:.decimals$}", scale * x))
}

/// Four significant figures, whatever the magnitude.
fn figures(x: Option<f64>) -> String {
    match x {
        Some(x) if x != 0.0 && !(1e-3..1e5).contains(&x.abs()) => format!("{x:.3e}"),
        Some(x) => {
            let decimals = (3.0 - x.abs().max(1e-3).log10().floor()).clamp(0.0, 6.0) as usize;
            format!("{x:.decimals$}")
        }
        None => "-".to_owned(),
    }
}

fn way(direction: Option<Direction>) -> &'static str {
    direction.map_or("-", Direction::label)
}

/// Error beside the noise floor.
pub fn summary(comparison: &Comparison) -> Table {
    let error = &comparison.error;
    let mut table = Table::new(["", "NRMSE", "noise floor", "error / floor"]);
    let mut add = |name: &str, nrmse: Option<f64>, floor: Option<f64>| {
        if nrmse.is_some() {
            let ratio = nrmse.zip(floor).filter(|(_, floor)| *floor > 0.0).map(|(e, floor)| e / floor);
            table.push([name.to_owned(), number(nrmse), number(floor), scaled(ratio, 1.0, 2)]);
        }
    };
    if comparison.kind == Kind::Component {
        add("force", error.nrmse_force, error.noise_floor_a);
    } else {
        add("A", error.nrmse_a, error.noise_floor_a);
        add("D", error.nrmse_d, error.noise_floor_d);
        add("restoring force", error.nrmse_force, None);
    }
    table
}

/// A row a step.
pub fn steps(comparison: &Comparison) -> Table {
    let component = comparison.kind == Kind::Component;
    let mut head = vec!["step", "way", "f (Hz)"];
    head.extend(if component {
        ["NRMSE force", "force peak (N)", "model", "residual force (N)"].as_slice()
    } else {
        ["NRMSE A", "NRMSE D", "A_max (m/s2)", "model", "E (mm)", "model", "residual force (N)"].as_slice()
    });
    let mut table = Table::new(head);
    for step in &comparison.steps {
        let mut row = vec![
            step.index.to_string(),
            way(step.direction).to_owned(),
            scaled(step.frequency_hz, 1.0, 3),
            number(step.nrmse_a),
        ];
        let force = |a: Option<f64>| figures(a.map(|a| a * comparison.mass_kg));
        if component {
            row.extend([force(step.a_max_m_s2), force(step.model_a_max_m_s2)]);
        } else {
            row.extend([
                number(step.nrmse_d),
                figures(step.a_max_m_s2),
                figures(step.model_a_max_m_s2),
                figures(step.excursion_m.map(|e| 1e3 * e)),
                figures(step.model_excursion_m.map(|e| 1e3 * e)),
            ]);
        }
        row.push(figures(step.force_residual_n));
        table.push(row);
    }
    table
}

/// All groups of parts with their titles; empty ones are left out.
pub fn groups(comparison: &Comparison) -> Vec<(&'static str, Table)> {
    [
        ("regime", &comparison.regimes),
        ("direction of the sweep", &comparison.directions),
        ("phase of the cycle", &comparison.phases),
        ("amplitude", &comparison.amplitudes),
        ("time", &comparison.times),
    ]
    .into_iter()
    .filter(|(_, slices)| !slices.is_empty())
    .map(|(title, slices)| (title, parts(title, slices, comparison.kind)))
    .collect()
}

fn parts(title: &str, slices: &[Slice], kind: Kind) -> Table {
    let component = kind == Kind::Component;
    let by_force = slices.iter().any(|slice| slice.share_of_misfit_force.is_some()) && !component;
    let by_d = slices.iter().any(|slice| slice.nrmse_d.is_some());
    let mut head = vec![title, "samples %", if component { "NRMSE force" } else { "NRMSE A" }];
    head.extend(by_d.then_some("NRMSE D"));
    head.push(if component { "of the misfit %" } else { "of the misfit of A %" });
    head.extend(by_d.then_some("of that of D %"));
    head.extend(by_force.then_some("of the residual force %"));
    let mut table = Table::new(head);
    for slice in slices {
        let mut row = vec![slice.name.clone(), percent(Some(slice.share_of_samples)), number(slice.nrmse_a)];
        row.extend(by_d.then(|| number(slice.nrmse_d)));
        row.push(percent(slice.share_of_misfit_a));
        row.extend(by_d.then(|| percent(slice.share_of_misfit_d)));
        row.extend(by_force.then(|| percent(slice.share_of_misfit_force)));
        table.push(row);
    }
    table
}

/// Harmonics of every step.
pub fn harmonics(comparison: &Comparison) -> Table {
    let mut table =
        Table::new(["step", "f (Hz)", "of", "order", "measured", "model", "difference", "phase (deg)"]);
    // Minus force over mass stands for the acceleration of a component.
    let (name, scale) = if comparison.kind == Kind::Component {
        ("force (N)", comparison.mass_kg)
    } else {
        ("A (m/s2)", 1.0)
    };
    for step in &comparison.steps {
        let mut add = |of: &str, scale: f64, harmonic: &HarmonicMisfit| {
            table.push([
                step.index.to_string(),
                scaled(step.frequency_hz, 1.0, 3),
                of.to_owned(),
                harmonic.order.to_string(),
                figures(Some(scale * harmonic.measured)),
                figures(Some(scale * harmonic.model)),
                figures(Some(scale * harmonic.residual)),
                format!("{:.2}", harmonic.phase_error_rad.to_degrees()),
            ]);
        };
        step.harmonics_a.iter().for_each(|harmonic| add(name, scale, harmonic));
        step.harmonics_d.iter().for_each(|harmonic| add("D (mm)", 1e3, harmonic));
    }
    table
}
