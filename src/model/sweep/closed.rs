//! What is wanted of a sweep that is known from event to event in closed form: every sample, its
//! columns, or the peaks of each step alone.

use super::plan::Plan;
use super::{StepPeaks, SweepHistory, SweepResponse, Visit};
use crate::model::Response;
use crate::model::exact::{Closed, Exact, Form, Instant, ROW, Stretch, Tables, Turns, zeros};
use std::f64::consts::TAU;

/// Tables for the samples of a row: by piece (made when first needed) and of the step under way.
struct Rows {
    tables: Vec<Option<Box<Tables>>>,
    turns: Turns,
    step: usize,
    dt: f64,
}

impl Rows {
    fn new(plan: &Plan<'_>, pieces: usize) -> Self {
        let turns = Turns::new(TAU * plan.steps.first().map_or(0.0, |step| step.frequency_hz), plan.dt);
        Self { tables: vec![None; pieces], turns, step: 0, dt: plan.dt }
    }

    fn fill(&mut self, stretch: &Stretch<'_>, out: [&mut [f64]; 3]) {
        if self.step != stretch.step {
            self.step = stretch.step;
            self.turns = Turns::new(stretch.segment.angular_frequency, self.dt);
        }
        let tables = self.tables[stretch.piece]
            .get_or_insert_with(|| Box::new(Tables::new(&stretch.segment.closed.free, self.dt)));
        stretch.segment.fill(stretch.offset, tables, &self.turns, out);
    }
}

/// Where D and A turned last in a segment of one piece, s since its beginning: there they may do so again.
#[derive(Clone, Copy, Default)]
struct Last([Option<f64>; 2]);

fn empty(plan: &Plan<'_>) -> SweepResponse {
    SweepResponse { peaks: vec![StepPeaks::NONE; plan.steps.len()], contacts: 0, samples: plan.samples() }
}

/// Peaks alone.
pub(super) fn peaks(exact: &mut Exact, closed: &[Closed], plan: &Plan<'_>) -> SweepResponse {
    let mut response = empty(plan);
    let mut last = vec![Last::default(); closed.len()];
    response.contacts = exact.run_closed(closed, plan, &mut |stretch| {
        let step = stretch.step;
        let peaks = &mut response.peaks[step];
        take_peaks(stretch, plan.first_counted(step), plan.dt, peaks, &mut last[stretch.piece]);
    });
    response
}

/// Columns.
pub(super) fn history(
    exact: &mut Exact,
    closed: &[Closed],
    plan: &Plan<'_>,
    history: &mut SweepHistory,
) -> SweepResponse {
    let mut response = empty(plan);
    let mut rows = Rows::new(plan, closed.len());
    let mut last = vec![Last::default(); closed.len()];
    response.contacts = exact.run_closed(closed, plan, &mut |stretch| {
        let (step, range) = (stretch.step, stretch.first..stretch.first + stretch.count);
        let peaks = &mut response.peaks[step];
        take_peaks(stretch, plan.first_counted(step), plan.dt, peaks, &mut last[stretch.piece]);
        history.enter(stretch.first, stretch.mode.regime());
        let out = [
            &mut history.relative_displacement_m[range.clone()],
            &mut history.relative_velocity_m_s[range.clone()],
            &mut history.mass_acceleration_m_s2[range],
        ];
        rows.fill(stretch, out);
    });
    response
}

/// Every sample.
pub(super) fn visit(
    exact: &mut Exact,
    closed: &[Closed],
    plan: &Plan<'_>,
    visit: &mut Visit<'_>,
) -> SweepResponse {
    let mut response = empty(plan);
    let mut rows = Rows::new(plan, closed.len());
    let mut last = vec![Last::default(); closed.len()];
    let contact = exact.contact_law();
    response.contacts = exact.run_closed(closed, plan, &mut |stretch| {
        let step = stretch.step;
        let peaks = &mut response.peaks[step];
        take_peaks(stretch, plan.first_counted(step), plan.dt, peaks, &mut last[stretch.piece]);
        let (wave, regime) = (&plan.steps[step], stretch.mode.regime());
        let w = stretch.segment.angular_frequency;
        for done in (0..stretch.count).step_by(ROW) {
            let count = ROW.min(stretch.count - done);
            let (mut d, mut v, mut a) = ([0.0; ROW], [0.0; ROW], [0.0; ROW]);
            let row = Stretch { offset: stretch.offset + done as f64 * plan.dt, count, ..*stretch };
            rows.fill(&row, [&mut d[..count], &mut v[..count], &mut a[..count]]);
            for i in 0..count {
                let sample = stretch.first + done + i;
                let phase = w * (sample as f64 * plan.dt - plan.starts[step]);
                let [right, left] = contact(stretch.mode.contact, d[i], v[i]);
                let table = wave.acceleration_amplitude_m_s2 * phase.sin();
                visit(
                    sample,
                    step,
                    table,
                    &Response {
                        relative_displacement_m: d[i],
                        relative_velocity_m_s: v[i],
                        mass_acceleration_m_s2: a[i],
                        right_contact_force_n: right,
                        left_contact_force_n: left,
                        regime,
                    },
                );
            }
        }
    });
    response
}

/// The samples of a segment that may be extreme: its first and last, and, where their bounds allow more
/// than what was found already, those beside the instants at which D or A turns.
fn take_peaks(stretch: &Stretch<'_>, counted: usize, dt: f64, peaks: &mut StepPeaks, turned: &mut Last) {
    let skipped = counted.saturating_sub(stretch.first);
    if skipped >= stretch.count {
        return;
    }
    let segment = stretch.segment;
    let acceleration = if segment.held.is_some() {
        Form::of_table(0, 0.0, 1.0)
    } else {
        let piece = &segment.closed.piece;
        Form::of(segment, 0, -piece.constant, -piece.stiffness, -piece.damping)
    };
    let displacement = Form::of(segment, 0, 0.0, 1.0, 0.0);
    let moves = |(low, high): (f64, f64), peaks: &StepPeaks| low < peaks.d_min_m || high > peaks.d_max_m;
    let pulls = |(low, high): (f64, f64), peaks: &StepPeaks| high.max(-low) > peaks.a_max_m_s2;
    if !moves(displacement.swing(segment), peaks) && !pulls(acceleration.swing(segment), peaks) {
        return;
    }
    let last = (stretch.count - 1) as f64;
    let (from, until) = (stretch.offset + skipped as f64 * dt, stretch.offset + last * dt);
    let take = |now: &Instant, peaks: &mut StepPeaks| {
        let (d, v) = segment.state(now);
        let a = segment.acceleration(now, (d, v));
        peaks.a_max_m_s2 = peaks.a_max_m_s2.max(a.abs());
        (peaks.d_max_m, peaks.d_min_m) = (peaks.d_max_m.max(d), peaks.d_min_m.min(d));
    };
    let ends = [from, until].map(|t| (t, segment.at(t)));
    ends.iter().for_each(|(_, now)| take(now, peaks));
    if until - from < 1.5 * dt {
        return;
    }
    let moves = segment.held.is_none() && moves(displacement.range(segment, &ends), peaks);
    let pulls = pulls(acceleration.range(segment, &ends), peaks);
    let turns =
        [moves.then(|| Form::of(segment, 0, 0.0, 0.0, 1.0)), pulls.then(|| acceleration.derivative(segment))];
    for (form, place) in turns.into_iter().zip(&mut turned.0) {
        let Some(form) = form else { continue };
        let mut taken = skipped as f64 - 1.0;
        zeros(&form, segment, &ends, dt, place, &mut |(low, high), t, now| {
            let mut sample = ((low - stretch.offset) / dt).floor().max(taken + 1.0);
            let end = ((high - stretch.offset) / dt).floor() + 1.0;
            while sample <= end.min(last) {
                take(&segment.beside(t, now, stretch.offset + sample * dt - t), peaks);
                taken = sample;
                sample += 1.0;
            }
        });
    }
}
