//! The report of one run: the final table, and the paper's figures 9 to 14 for this table and specimen.
//!
//! `run` and `recover` fill a [`RunReport`] and write its [`RunReport::page`] into the run folder; the
//! figure functions serve other pages as well.

use super::ReportError;
use super::chart::{Chart, Marker};
use super::page::Page;
use super::series::{RunSeries, envelope};
use super::style::{Ink, Stroke};
use super::table::Table;
use crate::sweep::Direction;

/// Columns of the long time histories.
const COLUMNS: usize = 1400;
/// Size of figures over the whole width, px.
const WIDE_PX: (f64, f64) = (1140.0, 250.0);

/// Steady state of one step, measured and by the onboard model.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StepPoint {
    /// Index of the step.
    pub index: u32,
    /// Sweep direction.
    pub direction: Direction,
    /// Frequency, Hz.
    pub frequency_hz: f64,
    /// Measured A_max, m/s2.
    pub a_max_m_s2: f64,
    /// Measured excursion E_max, m.
    pub excursion_m: f64,
    /// A_max of the onboard model, m/s2.
    pub model_a_max_m_s2: f64,
    /// Excursion of the onboard model, m.
    pub model_excursion_m: f64,
    /// Root-mean-square difference of A over its standard deviation.
    pub nrmse_a: f64,
    /// Root-mean-square difference of D over its standard deviation.
    pub nrmse_d: f64,
    /// Fundamental of the measured table acceleration over A_G.
    pub table_amplitude_ratio: f64,
}

/// Pseudo-resonance frequency with the peaks there.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Peaks {
    /// Frequency of the largest A_max of the forward sweep, Hz.
    pub frequency_hz: f64,
    /// A_max there, m/s2.
    pub a_max_m_s2: f64,
    /// Largest excursion of the forward sweep, m.
    pub excursion_m: f64,
}

/// All that the page of a run shows.
#[derive(Clone, Debug)]
pub struct RunReport {
    /// First heading.
    pub title: String,
    /// One sentence: what was run, how it ended.
    pub lead: String,
    /// What the reader must not miss: losses, slips, an abort and its cause.
    pub notes: Vec<String>,
    /// The final table, as on the terminal.
    pub summary: Table,
    /// Steady states, in the order of the sweep.
    pub steps: Vec<StepPoint>,
    /// Steps of the whole sweep; fewer were run where it was stopped.
    pub planned_steps: usize,
    /// Channels of the run.
    pub series: RunSeries,
    /// Published peaks of the case, with the label of their legend.
    pub published: Vec<(String, Peaks)>,
    /// Timing of the control thread.
    pub timing: Option<Table>,
    /// What was lost.
    pub losses: Table,
    /// Role and text of each configuration.
    pub configuration: Vec<(String, String)>,
}

/// The peaks of a forward sweep (of whatever there is when there is no forward step); `None` of nothing.
/// `of` picks (A_max, excursion): measured or model.
pub fn peaks(steps: &[StepPoint], of: impl Fn(&StepPoint) -> (f64, f64)) -> Option<Peaks> {
    let used = forward_or_all(steps);
    let top = used.clone().max_by(|a, b| of(a).0.total_cmp(&of(b).0))?;
    let excursion_m = used.map(|step| of(step).1).fold(0.0, f64::max);
    Some(Peaks { frequency_hz: top.frequency_hz, a_max_m_s2: of(top).0, excursion_m })
}

/// The measured pair of [`peaks`].
pub fn measured(step: &StepPoint) -> (f64, f64) {
    (step.a_max_m_s2, step.excursion_m)
}

/// The model's pair of [`peaks`].
pub fn modelled(step: &StepPoint) -> (f64, f64) {
    (step.model_a_max_m_s2, step.model_excursion_m)
}

/// Whether the sweep has passed its pseudo-resonance: it ended or turned back, and its largest A_max is not at an edge of the
/// frequencies that were run. `planned` is the number of steps of the whole sweep.
pub fn passes_resonance(steps: &[StepPoint], planned: usize) -> bool {
    let turned = steps.windows(2).any(|two| two[0].direction != two[1].direction);
    let any = |is: &dyn Fn(f64) -> bool| forward_or_all(steps).any(|step| is(step.frequency_hz));
    let inside = peaks(steps, measured)
        .is_some_and(|top| any(&|hz| hz < top.frequency_hz) && any(&|hz| hz > top.frequency_hz));
    inside && (turned || steps.len() >= planned)
}

/// The steps of a forward sweep, or whatever there is when there is no forward step.
fn forward_or_all(steps: &[StepPoint]) -> impl Iterator<Item = &StepPoint> + Clone {
    let forward = steps.iter().any(|step| step.direction == Direction::Forward);
    steps.iter().filter(move |step| !forward || step.direction == Direction::Forward)
}

/// The final table: a row a source, columns frequency of the largest A_max (the pseudo-resonance if the sweep has passed it, see
/// [`passes_resonance`]), A_max, E_max.
pub fn peaks_table<'a>(passed: bool, rows: impl IntoIterator<Item = (&'a str, Option<Peaks>)>) -> Table {
    let frequency = if passed { "pseudo-resonance (Hz)" } else { "A_max at (Hz)" };
    let mut table = Table::new(["", frequency, "A_max (m/s2)", "E_max (mm)"]);
    for (label, peaks) in rows {
        match peaks {
            Some(p) => table.push([
                label.to_owned(),
                format!("{:.2}", p.frequency_hz),
                format!("{:.2}", p.a_max_m_s2),
                format!("{:.1}", p.excursion_m * 1e3),
            ]),
            None => table.push([label, "-", "-", "-"]),
        }
    }
    table
}

/// Pseudo-resonance curves of one quantity: measured solid, model dashed, forward red and thick,
/// backward blue and thin; published values as points. `scale` goes from SI to the unit of the label.
pub fn resonance_curves(
    steps: &[StepPoint],
    y_label: &str,
    scale: f64,
    pick: impl Fn(&StepPoint) -> (f64, f64),
    published: &[(String, f64, f64)],
) -> Chart {
    let mut chart = Chart::new("Frequency f (Hz)", y_label).size(560.0, 380.0);
    let ways = [(Direction::Forward, Ink::Forward, 2.6), (Direction::Backward, Ink::Backward, 1.2)];
    for (direction, ink, width_px) in ways {
        let curve = |pair: &dyn Fn(&StepPoint) -> f64| -> Vec<(f64, f64)> {
            let there = steps.iter().filter(|step| step.direction == direction);
            there.map(|step| (step.frequency_hz, pair(step) * scale)).collect()
        };
        let name = direction.label();
        let (test, model) = (curve(&|step| pick(step).0), curve(&|step| pick(step).1));
        if test.is_empty() {
            continue;
        }
        chart = chart
            .line(Some(&format!("measured, {name}")), Stroke::solid(ink).width(width_px), test)
            .line(Some(&format!("model, {name}")), Stroke::dashed(ink).width(width_px), model);
    }
    let markers = [Marker::Square, Marker::Cross, Marker::Triangle, Marker::Circle];
    for ((label, x, y), marker) in published.iter().zip(markers.into_iter().cycle()) {
        chart = chart.points(Some(label), Ink::Published, marker, 5.0, vec![(*x, *y * scale)]);
    }
    let top = steps.iter().map(|step| pick(step).0.max(pick(step).1)).chain(published.iter().map(|p| p.2));
    let top = top.filter(|value| value.is_finite()).fold(0.0, f64::max) * scale;
    if top > 0.0 { chart.y_range(0.0, 1.06 * top) } else { chart }
}

impl RunReport {
    /// The page.
    ///
    /// # Errors
    /// [`ReportError::Figure`] when a figure cannot be drawn.
    pub fn page(&self) -> Result<Page, ReportError> {
        let mut page = Page::new(&self.title);
        page.text(&self.lead);
        for note in &self.notes {
            page.note(note);
        }
        page.table(&self.summary);
        self.resonance(&mut page)?;
        self.at_resonance(&mut page)?;
        self.command(&mut page)?;
        self.histories(&mut page)?;
        self.model_error(&mut page)?;
        self.accounts(&mut page);
        Ok(page)
    }

    /// Only what the paper draws: the command, the pseudo-resonance curves, loops, portraits and histories.
    ///
    /// # Errors
    /// [`ReportError::Figure`] when a figure cannot be drawn.
    pub fn paper_figures(&self, page: &mut Page) -> Result<(), ReportError> {
        page.table(&self.summary);
        self.resonance(page)?;
        self.at_resonance(page)?;
        self.command(page)?;
        self.histories(page)
    }

    fn top(&self) -> Option<&StepPoint> {
        forward_or_all(&self.steps).max_by(|a, b| a.a_max_m_s2.total_cmp(&b.a_max_m_s2))
    }

    fn resonance(&self, page: &mut Page) -> Result<(), ReportError> {
        if self.steps.is_empty() {
            return Ok(());
        }
        page.section("Pseudo-resonance curves");
        let points = |value: fn(&Peaks) -> f64| -> Vec<(String, f64, f64)> {
            self.published.iter().map(|(label, p)| (label.clone(), p.frequency_hz, value(p))).collect()
        };
        let a = resonance_curves(
            &self.steps,
            "A_max (m/s2)",
            1.0,
            |s| (s.a_max_m_s2, s.model_a_max_m_s2),
            &points(|p| p.a_max_m_s2),
        );
        let e = resonance_curves(
            &self.steps,
            "Excursion E_max (mm)",
            1e3,
            |s| (s.excursion_m, s.model_excursion_m),
            &points(|p| p.excursion_m),
        );
        page.figures(&[
            (&a, "Largest absolute acceleration of the mass in the steady state of each step (figure 12 of the paper)."),
            (&e, "Excursion D_max - D_min in the steady state of each step (figure 12 of the paper)."),
        ])
    }

    fn at_resonance(&self, page: &mut Page) -> Result<(), ReportError> {
        let Some(step) = self.top() else { return Ok(()) };
        let s = &self.series;
        let window = s.end_of_step(step.index, 3.0 / step.frequency_hz);
        if window.is_empty() {
            return Ok(());
        }
        let passed = passes_resonance(&self.steps, self.planned_steps);
        let place = if passed { "pseudo-resonance" } else { "the largest A_max" };
        page.section(&format!("At {place}, {:.2} Hz", step.frequency_hz));
        let pairs = |x: &dyn Fn(usize) -> f64, y: &dyn Fn(usize) -> f64| -> Vec<(f64, f64)> {
            window.clone().map(|i| (x(i), y(i))).collect()
        };
        let test_d = |i: usize| f64::from(s.relative_m[i]) * 1e3;
        let model_d = |i: usize| f64::from(s.model_relative_m[i]) * 1e3;
        let test = Stroke::solid(Ink::Measured);
        let model = Stroke::dashed(Ink::Model).width(2.0);
        let draw = |chart: Chart, measured: Vec<(f64, f64)>, modelled: Vec<(f64, f64)>| {
            chart.line(Some("measured"), test, measured).line(Some("onboard model"), model, modelled)
        };
        let hysteresis = draw(
            Chart::new("Relative displacement D (mm)", "Absolute acceleration A (m/s2)").size(560.0, 400.0),
            pairs(&test_d, &|i| f64::from(s.mass_acceleration_m_s2[i])),
            pairs(&model_d, &|i| f64::from(s.model_acceleration_m_s2[i])),
        );
        let portrait = draw(
            Chart::new("Relative displacement D (mm)", "Relative velocity D' (mm/s)").size(560.0, 400.0),
            pairs(&test_d, &|i| s.rate(&s.relative_m, i) * 1e3),
            pairs(&model_d, &|i| s.rate(&s.model_relative_m, i) * 1e3),
        );
        page.figures(&[
            (&hysteresis, "Hysteresis loop A(D), last three cycles: minus M A is the total restoring force (figures 13, 14)."),
            (&portrait, "Phase portrait D'(D) of the same cycles (figures 13, 14)."),
        ])?;
        let start_s = s.time_s[window.start];
        let time = |i: usize| s.time_s[i] - start_s;
        let a = draw(
            Chart::new("Time since the first of these cycles (s)", "A (m/s2)").size(560.0, 280.0),
            pairs(&time, &|i| f64::from(s.mass_acceleration_m_s2[i])),
            pairs(&time, &|i| f64::from(s.model_acceleration_m_s2[i])),
        );
        let d = draw(
            Chart::new("Time since the first of these cycles (s)", "D (mm)").size(560.0, 280.0),
            pairs(&time, &test_d),
            pairs(&time, &model_d),
        );
        page.figures(&[
            (
                &a,
                "Absolute acceleration of the mass over the last three cycles of the step (figures 10, 11).",
            ),
            (&d, "Relative displacement over the same cycles (figures 10, 11)."),
        ])
    }

    fn command(&self, page: &mut Page) -> Result<(), ReportError> {
        let s = &self.series;
        if s.is_empty() {
            return Ok(());
        }
        page.section("Command");
        let chart = Chart::new("Time t (s)", "Command x (mm)").size(WIDE_PX.0, WIDE_PX.1).line(
            Some("commanded displacement"),
            Stroke::solid(Ink::Backward).width(0.8),
            envelope(&s.time_s, &s.command_m, 1e3, COLUMNS),
        );
        page.figure(
            &chart,
            "Displacement command: constant peak acceleration, X = A_G/(2 pi f)^2 (figure 9).",
        )?;
        let Some(window) = self.first_transition() else { return Ok(()) };
        let (t, x) = (&s.time_s[window.clone()], &s.command_m[window.clone()]);
        let displacement = Chart::new("Time t (s)", "x (mm)")
            .size(560.0, 260.0)
            .line(Some("command"), Stroke::solid(Ink::Backward), envelope(t, x, 1e3, COLUMNS))
            .line(
                Some("measured"),
                Stroke::dashed(Ink::Measured),
                envelope(t, &s.table_m[window.clone()], 1e3, COLUMNS),
            );
        let acceleration = Chart::new("Time t (s)", "Table acceleration (m/s2)")
            .size(560.0, 260.0)
            .line(
                Some("command"),
                Stroke::solid(Ink::Backward),
                envelope(t, &s.command_acceleration_m_s2[window.clone()], 1.0, COLUMNS),
            )
            .line(
                Some("measured, 0.16-30 Hz"),
                Stroke::dashed(Ink::Measured),
                envelope(t, &s.table_acceleration_m_s2[window], 1.0, COLUMNS),
            );
        page.figures(&[
            (&displacement, "Displacement of the table about the first transition between two steps."),
            (
                &acceleration,
                "Acceleration about the same transition: smooth in the command, no spike in the table. The measured one has passed the band-pass, which leads at low frequencies.",
            ),
        ])
    }

    /// Samples from two cycles before the first transition between steps to two after it.
    fn first_transition(&self) -> Option<std::ops::Range<usize>> {
        let step = &self.series.step;
        let first = step.iter().position(|&k| k >= 0)?;
        let leave = first + step[first..].iter().position(|&k| k != step[first])?;
        let enter = leave + step[leave..].iter().position(|&k| k >= 0)?;
        let rate = step.len() as f64 / self.series.time_s.last()?.max(1e-9);
        let margin = (2.0 * rate / self.steps.first()?.frequency_hz) as usize;
        Some(leave.saturating_sub(margin)..(enter + margin).min(step.len()))
    }

    fn histories(&self, page: &mut Page) -> Result<(), ReportError> {
        let s = &self.series;
        if s.is_empty() {
            return Ok(());
        }
        page.section("Time histories");
        let history = |y_label: &str, test: &[f32], model: &[f32], scale: f64| {
            Chart::new("Time t (s)", y_label)
                .size(WIDE_PX.0, WIDE_PX.1)
                .line(
                    Some("measured"),
                    Stroke::solid(Ink::Measured).width(0.8),
                    envelope(&s.time_s, test, scale, COLUMNS),
                )
                .line(
                    Some("onboard model"),
                    Stroke::solid(Ink::Model).width(0.8),
                    outline(&s.time_s, model, scale, true),
                )
                .line(None, Stroke::solid(Ink::Model).width(0.8), outline(&s.time_s, model, scale, false))
        };
        page.figure(
            &history("A (m/s2)", &s.mass_acceleration_m_s2, &s.model_acceleration_m_s2, 1.0),
            "Absolute acceleration of the mass: measured as a band, the model as its upper and lower outline (figures 10, 11).",
        )?;
        page.figure(
            &history("D (mm)", &s.relative_m, &s.model_relative_m, 1e3),
            "Relative displacement of the mass, in the same way.",
        )
    }

    fn model_error(&self, page: &mut Page) -> Result<(), ReportError> {
        if self.steps.is_empty() {
            return Ok(());
        }
        page.section("Model against measurement, step by step");
        let curve = |direction: Direction, pick: fn(&StepPoint) -> f64| -> Vec<(f64, f64)> {
            let there = self.steps.iter().filter(|step| step.direction == direction);
            there.map(|step| (step.frequency_hz, pick(step))).collect()
        };
        let both = |chart: Chart, pick: fn(&StepPoint) -> f64| {
            chart
                .line(
                    Some("forward"),
                    Stroke::solid(Ink::Forward).width(2.6),
                    curve(Direction::Forward, pick),
                )
                .line(
                    Some("backward"),
                    Stroke::solid(Ink::Backward).width(1.2),
                    curve(Direction::Backward, pick),
                )
        };
        let error = |label: &str, pick: fn(&StepPoint) -> f64| {
            let top = self.steps.iter().map(pick).filter(|e| e.is_finite()).fold(0.0, f64::max);
            both(
                Chart::new("Frequency f (Hz)", label).size(560.0, 280.0).y_range(0.0, 1.06 * top.max(1e-3)),
                pick,
            )
        };
        page.figures(&[
            (
                &error("NRMSE of A (-)", |s| s.nrmse_a),
                "Root-mean-square difference of A over its standard deviation, counted cycles.",
            ),
            (&error("NRMSE of D (-)", |s| s.nrmse_d), "The same for D."),
        ])?;
        let table = both(Chart::new("Frequency f (Hz)", "Table, A_1 / A_G (-)").size(560.0, 280.0), |s| {
            s.table_amplitude_ratio
        });
        page.figure(&table, "Fundamental of the measured table acceleration over the commanded one.")
    }

    fn accounts(&self, page: &mut Page) {
        page.section("Timing and losses");
        if let Some(timing) = &self.timing {
            page.table(timing);
        }
        page.table(&self.losses);
        let mut table = Table::new([
            "step",
            "direction",
            "f (Hz)",
            "A_max (m/s2)",
            "E_max (mm)",
            "model A_max",
            "model E_max",
            "NRMSE A",
            "NRMSE D",
        ]);
        for s in &self.steps {
            table.push([
                s.index.to_string(),
                s.direction.label().to_owned(),
                format!("{:.2}", s.frequency_hz),
                format!("{:.3}", s.a_max_m_s2),
                format!("{:.2}", s.excursion_m * 1e3),
                format!("{:.3}", s.model_a_max_m_s2),
                format!("{:.2}", s.model_excursion_m * 1e3),
                format!("{:.4}", s.nrmse_a),
                format!("{:.4}", s.nrmse_d),
            ]);
        }
        page.folded_table("All steps", &table);
        for (role, text) in &self.configuration {
            page.folded_text(&format!("Configuration: {role}"), text);
        }
    }
}

/// Upper or lower edge of a long channel; a short one is its own upper edge and has no lower one.
fn outline(time_s: &[f64], values: &[f32], scale: f64, upper: bool) -> Vec<(f64, f64)> {
    let columns = COLUMNS / 2;
    let band = envelope(time_s, values, scale, columns);
    if band.len() != 2 * columns {
        return if upper { band } else { Vec::new() };
    }
    let edge = |a: f64, b: f64| if upper { a.max(b) } else { a.min(b) };
    band.chunks_exact(2).map(|pair| (pair[0].0, edge(pair[0].1, pair[1].1))).collect()
}

#[cfg(test)]
#[path = "run_tests.rs"]
mod tests;
