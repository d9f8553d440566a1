//! The page of a diagnosis: verdict, error ladder, what was found and refused, the shape of the missing force.
//!
//! `diagnose --report` writes it. Figures are drawn from the numbers that the JSON carries as well.

use super::comparison::Unit;
use super::{Chart, Heat, Ink, Marker, Page, ReportError, Stroke, Table};
use crate::diagnose::missing_force::MissingForce;
use crate::diagnose::report::{Diagnosis, Short, StepErrors};

/// The page; `title` names records and model.
///
/// # Errors
/// [`ReportError::Figure`] when a figure cannot be drawn.
pub fn page(title: &str, found: &Diagnosis) -> Result<Page, ReportError> {
    let mut page = Page::new(title);
    page.note(&found.sentence());
    page.text(&format!(
        "Error of the held-out steps: {:.2} % as given, {:.2} % re-identified, {:.2} % after; the noise of the \
         instruments alone makes {:.2} %.",
        100.0 * found.error_before,
        100.0 * found.error_reidentified,
        100.0 * found.error_after,
        100.0 * found.noise_floor
    ));
    found.left.iter().for_each(|left| page.note(&format!("{}.", left.sentence())));
    if let Some(test) = &found.next_test {
        page.note(&format!("Next test: {} - {}.", test.title, test.reason));
    }
    ladder(&mut page, found)?;
    let bumpers = found.missing_force.as_ref().is_some_and(|force| force.time_in_contact > 0.0);
    steps(&mut page, &found.steps, bumpers)?;
    tables(&mut page, found);
    if let Some(force) = &found.missing_force {
        missing(&mut page, "The force that is missing after re-identification", force)?;
    }
    if let Some(force) = found.left.as_ref().and_then(|left| left.force.as_ref()) {
        missing(&mut page, "The force that is still missing with what was found", force)?;
    }
    if !found.not_identifiable.is_empty() {
        page.section("What this record cannot tell");
        found.not_identifiable.iter().for_each(|text| page.text(text));
    }
    if !found.notes.is_empty() {
        page.section("Notes");
        found.notes.iter().for_each(|text| page.text(text));
    }
    Ok(page)
}

fn ladder(page: &mut Page, found: &Diagnosis) -> Result<(), ReportError> {
    page.section("Error ladder");
    let points = |pick: fn(&crate::diagnose::report::Rung) -> f64| -> Vec<(f64, f64)> {
        found.ladder.iter().enumerate().map(|(i, rung)| (i as f64, 100.0 * pick(rung))).collect()
    };
    let (training, held_out) = (points(|r| r.training), points(|r| r.held_out));
    let top = training.iter().chain(&held_out).map(|p| p.1).filter(|y| y.is_finite()).fold(0.0, f64::max);
    let chart = Chart::new("Model", "NRMSE (%)")
        .size(900.0, 320.0)
        .x_names(found.ladder.iter().map(|rung| rung.model.clone()))
        .y_range(0.0, 1.08 * top.max(1e-6))
        .line(Some("held-out steps"), Stroke::solid(Ink::Measured).width(2.2), held_out.clone())
        .points(None, Ink::Measured, Marker::Circle, 4.0, held_out)
        .line(Some("training steps"), Stroke::dashed(Ink::Model), training.clone())
        .points(None, Ink::Model, Marker::Square, 4.0, training)
        .level(Some("noise floor"), Stroke::dashed(Ink::Limit), 100.0 * found.noise_floor);
    page.figure(
        &chart,
        "Each step re-fits all numbers of the model. NRMSE: root-mean-square of the simulated response's error over \
         that of the measurement, A and D together (of a component, its force); held-out steps were seen by no fit.",
    )
}

/// Share of what is measured in a step from which on noise says more than any model.
const MOSTLY_NOISE: f64 = 0.5;

fn steps(page: &mut Page, steps: &[StepErrors], bumpers: bool) -> Result<(), ReportError> {
    let shown: Vec<&StepErrors> = steps.iter().filter(|s| s.noise_floor < MOSTLY_NOISE).collect();
    if shown.len() < 3 {
        return Ok(());
    }
    // A record without steps has parts of one frequency: those go by their number.
    let frequencies = shown.iter().map(|s| s.frequency_hz);
    let (low, high) = frequencies.fold((f64::INFINITY, 0.0_f64), |(l, h), f| (l.min(f), h.max(f)));
    let swept = high > 1.05 * low;
    let place = |s: &StepErrors| if swept { s.frequency_hz } else { f64::from(s.step) };
    let points = |held_out: bool, pick: fn(&StepErrors) -> f64| -> Vec<(f64, f64)> {
        shown.iter().filter(|s| s.held_out == held_out).map(|s| (place(s), 100.0 * pick(s))).collect()
    };
    let mut chart = Chart::new(if swept { "Frequency f (Hz)" } else { "Part of the record" }, "NRMSE (%)")
        .size(900.0, 320.0);
    type Series = (&'static str, Ink, fn(&StepErrors) -> f64);
    let series: [Series; 2] = [
        ("re-identified", Ink::Model, |s| s.reidentified),
        ("with what was found", Ink::Measured, |s| s.after),
    ];
    for (name, ink, pick) in series {
        let (seen, kept) = (points(false, pick), points(true, pick));
        chart = chart.points(Some(&format!("{name}, training")), ink, Marker::Cross, 3.5, seen).points(
            Some(&format!("{name}, held out")),
            ink,
            Marker::Circle,
            3.5,
            kept,
        );
    }
    let mut floor: Vec<(f64, f64)> = shown.iter().map(|s| (place(s), 100.0 * s.noise_floor)).collect();
    floor.sort_by(|a, b| a.0.total_cmp(&b.0));
    chart = chart.line(Some("noise floor"), Stroke::dashed(Ink::Limit), floor);
    let small = " Where the mass moves little, noise alone is a large part of it: the dashed line.";
    let jumps = " With stiff bumpers the response is bistable in parts of a sweep: a simulation may leave on the other branch \
                 for reasons of noise alone.";
    let rests = " Not shown: parts that rest, where noise is more than half of what is measured.";
    let rest = if shown.len() < steps.len() { rests } else { "" };
    page.figure(&chart, &format!("Error step by step.{small}{rest}{}", if bumpers { jumps } else { "" }))
}

fn tables(page: &mut Page, found: &Diagnosis) {
    if !found.effects.is_empty() {
        page.section("What was found");
        let mut table = Table::new(["Effect", "Probability", "Parameter", "Value", "95 % interval", "Unit"]);
        for effect in &found.effects {
            let probability = format!("{:.2}", effect.probability);
            for (i, (name, p)) in effect.parameters.iter().enumerate() {
                let once = |text: &str| if i == 0 { text.to_owned() } else { String::new() };
                let interval = format!("{} to {}", Short(p.low95), Short(p.high95));
                let value = Short(p.value).to_string();
                let row = [once(&effect.name), once(&probability), name.clone(), value, interval];
                table.push(row.into_iter().chain([p.unit.clone()]));
            }
        }
        page.table(&table);
        if !found.ambiguous_with.is_empty() {
            page.text(&format!("Explains the record as well: {}.", found.ambiguous_with.join(", ")));
        }
    }
    if !found.reidentified.is_empty() {
        page.section(found.numbers_title());
        let mut table = Table::new(["Number", "In the model", "Re-identified", "95 % interval"]);
        for r in &found.reidentified {
            let interval = format!("{} to {}{}", Short(r.low95), Short(r.high95), r.remark());
            table.push([r.key.clone(), Short(r.nominal).to_string(), Short(r.value).to_string(), interval]);
        }
        page.table(&table);
    }
    if !found.refused.is_empty() {
        page.section("Tried and refused");
        let mut table = Table::of_sentences(["Effect", "Why"]);
        found.refused.iter().for_each(|r| table.push([r.name.clone(), r.reason.clone()]));
        page.table(&table);
    }
}

fn missing(page: &mut Page, title: &str, force: &MissingForce) -> Result<(), ReportError> {
    page.section(title);
    let edges = |centres: &[f64], scale: f64| -> Vec<f64> {
        let half = centres.get(1).zip(centres.first()).map_or(0.5, |(b, a)| 0.5 * (b - a));
        let first = centres.first().map(|x| (x - half) * scale);
        first.into_iter().chain(centres.iter().map(|x| (x + half) * scale)).collect()
    };
    let length = Unit::of(&force.displacement_m, 1.0, "m");
    let speed = Unit::of(&force.velocity_m_s, 1.0, "m/s");
    let heat = |cells: &[Vec<Option<f64>>], label: &str, signed: bool| {
        let seen: Vec<f64> = cells.iter().flatten().flatten().copied().collect();
        let unit = Unit::of(&seen, 1.0, "N");
        // Rows of the figure are velocities, those of the map displacements.
        let turned = (0..force.velocity_m_s.len())
            .map(|j| cells.iter().map(|row| row.get(j).copied().flatten().map(|x| x * unit.scale)).collect())
            .collect();
        let across = edges(&force.displacement_m, length.scale);
        let up = edges(&force.velocity_m_s, speed.scale);
        Chart::new(&format!("Displacement D ({})", length.name), &format!("Velocity D' ({})", speed.name))
            .size(560.0, 400.0)
            .heat(label, &unit.name, Heat::new(across, up, turned, signed))
    };
    page.figures(&[
        (&heat(&force.force_n, "mean", true), "Mean over (D, D'). Red lacks in the model, blue is too much."),
        (&heat(&force.sigma_n, "standard error", false), "Standard error of the mean in each cell."),
    ])?;
    page.text(&format!(
        "{:.0} % of its power is a surface over D and D', the rest is memory, time, history of contacts or noise; {:.0} % \
         lies in contact with a bumper, which is {:.0} % of the time.",
        100.0 * force.explained_by_surface,
        100.0 * force.power_in_contact,
        100.0 * force.time_in_contact
    ));
    if let Some(draft) = &force.expression {
        let parameters: Vec<String> =
            draft.parameters.iter().map(|(name, value)| format!("{name} = {}", Short(*value))).collect();
        page.text(&format!(
            "Draft of an expression effect, to be edited: {} with {} (explains {:.0} %).",
            draft.expression,
            parameters.join(", "),
            100.0 * draft.explains
        ));
    }
    Ok(())
}
