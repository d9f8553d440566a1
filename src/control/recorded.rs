//! The command of a record, as the control step wants it when the record is played back: of a run the
//! commands that were given then, stops and holds included; of a foreign record the steps that its table
//! acceleration shows. Called by `replay` and `recover`.

use crate::record::Record;
use crate::signal::offline::fundamental;
use crate::stream::{Channels, Command, Row, Sample, StatusBits};
use crate::sweep::{CommandPoint, Direction, Generator, Schedule, Segment, Step, StepPhase};
use std::collections::VecDeque;
use std::f64::consts::TAU;

/// Points of the sweep that are looked through for the one a row was recorded under: the clocks of DAQ and
/// control part by a sample now and then.
const NEAR: usize = 8;

/// The points under which the rows of a run were recorded, one a sample number from the first row's on.
/// Where the sweep gave the command, the point is the sweep's own, phase and all; where a stop or a hold
/// did, the phase is that of the command itself.
pub fn points_of_rows(rows: &[Row], mut sweep: Generator) -> Vec<CommandPoint> {
    let steps = sweep.schedule().steps().to_vec();
    let mut points: Vec<CommandPoint> = Vec::with_capacity(rows.len());
    let mut near: VecDeque<CommandPoint> = VecDeque::with_capacity(2 * NEAR + 1);
    let first = rows.first().map_or(0, |row| row.sample.sequence);
    for row in rows {
        let place = row.sample.sequence.saturating_sub(first) as usize;
        // A repeated number has its point; lost samples have those of the sweep.
        while points.len() <= place && points.len() < rows.len() * 4 + 4096 {
            let last = points.len() == place;
            // A step that had settled is counted from here on.
            if let Ok(step) = u32::try_from(row.step) {
                sweep.settled(step);
            }
            near.push_back(sweep.next_point());
            if near.len() > 2 * NEAR {
                near.pop_front();
            }
            let found = if last { sought(row, &near) } else { near.back().copied() };
            let before = points.last().copied();
            points.push(found.unwrap_or_else(|| by_command(row, &steps, before.as_ref())));
        }
    }
    points
}

/// The point of the sweep with exactly this row's command and step, the newest first.
fn sought(row: &Row, near: &VecDeque<CommandPoint>) -> Option<CommandPoint> {
    near.iter().rev().find(|point| point.command == row.command && point.counted_step() == row.step).copied()
}

/// A point made of what the row itself says.
fn by_command(row: &Row, steps: &[Step], before: Option<&CommandPoint>) -> CommandPoint {
    let step = usize::try_from(row.step).ok().and_then(|index| steps.get(index));
    let phase = step.map(|step| {
        let w = TAU * step.frequency_hz;
        let (a, v) = (row.command.acceleration_m_s2, row.command.velocity_m_s);
        let angle = a.atan2(-v * w).rem_euclid(TAU);
        let last = before.and_then(|point| point.phase).filter(|last| last.index == step.index);
        // Whole cycles go on from the row before.
        let cycles = last.map_or(0.0, |last| ((last.phase_rad - angle) / TAU).round().max(0.0));
        StepPhase { phase_rad: angle + TAU * cycles, ..phase_of(step) }
    });
    let segment = if phase.is_some() { Segment::Step } else { Segment::EndRamp };
    CommandPoint { command: row.command, jerk_m_s3: 0.0, phase, segment }
}

fn phase_of(step: &Step) -> StepPhase {
    StepPhase {
        index: step.index,
        direction: step.direction,
        frequency_hz: step.frequency_hz,
        acceleration_amplitude_m_s2: step.acceleration_amplitude_m_s2,
        phase_rad: 0.0,
        counted: true,
    }
}

/// A foreign `base` record as it would have come from a rig: its steps, the point and the sample of each
/// instant. What was not measured is zero; a lone accelerometer stands for both.
pub fn of_record(record: &Record) -> (Schedule, Vec<CommandPoint>, Vec<Sample>) {
    let rate = record.sample_rate_hz;
    let rest = CommandPoint {
        command: Command::default(),
        jerk_m_s3: 0.0,
        phase: None,
        segment: Segment::StartRamp,
    };
    let mut points = vec![rest; record.len()];
    for (i, point) in points.iter_mut().enumerate() {
        point.command.acceleration_m_s2 = record.table_acceleration_m_s2[i];
        point.command.displacement_m = record.table_displacement_m.get(i).copied().unwrap_or(0.0);
    }
    let mut steps: Vec<Step> = Vec::new();
    for (_, range) in record.step_ranges() {
        let Some((frequency_hz, phase_rad)) =
            fundamental(&record.table_acceleration_m_s2[range.clone()], rate)
        else {
            continue;
        };
        let step = step_of(record, &range, frequency_hz, &steps);
        // Counting starts with the first whole cycle.
        let start = (-phase_rad).rem_euclid(TAU);
        for (i, point) in points[range].iter_mut().enumerate() {
            let phase_rad = TAU * frequency_hz * i as f64 / rate - start;
            if phase_rad >= 0.0 {
                point.phase = Some(StepPhase { phase_rad, ..phase_of(&step) });
                point.segment = Segment::Step;
            }
        }
        steps.push(step);
    }
    let samples = (0..record.len()).map(|i| sample(record, i)).collect();
    (Schedule::of_steps(steps), points, samples)
}

/// A stretch of steady frequency as a step.
fn step_of(record: &Record, range: &std::ops::Range<usize>, frequency_hz: f64, before: &[Step]) -> Step {
    let input = &record.table_acceleration_m_s2[range.clone()];
    let mean_square = input.iter().map(|a| a * a).sum::<f64>() / input.len() as f64;
    let acceleration_amplitude_m_s2 = (2.0 * mean_square).sqrt();
    let direction = match before.last() {
        Some(last) if last.frequency_hz > frequency_hz => Direction::Backward,
        Some(last) if last.frequency_hz < frequency_hz => Direction::Forward,
        Some(last) => last.direction,
        None => Direction::Forward,
    };
    Step {
        index: before.len() as u32,
        direction,
        frequency_hz,
        acceleration_amplitude_m_s2,
        displacement_amplitude_m: acceleration_amplitude_m_s2 / (TAU * frequency_hz).powi(2),
        cycles: (range.len() as f64 / record.sample_rate_hz * frequency_hz) as u32,
        start_s: range.start as f64 / record.sample_rate_hz,
        end_s: range.end as f64 / record.sample_rate_hz,
    }
}

fn sample(record: &Record, i: usize) -> Sample {
    let of = |channel: &[f64]| channel.get(i).copied();
    let (one, two) = (of(&record.mass_acceleration_1_m_s2), of(&record.mass_acceleration_2_m_s2));
    Sample {
        sequence: i as u64,
        device_time_us: (1e6 * i as f64 / record.sample_rate_hz).round() as u64,
        channels: Channels {
            table_displacement_m: of(&record.table_displacement_m).unwrap_or(0.0),
            table_acceleration_m_s2: record.table_acceleration_m_s2[i],
            mass_acceleration_1_m_s2: one.or(two).unwrap_or(0.0),
            mass_acceleration_2_m_s2: two.or(one).unwrap_or(0.0),
            relative_displacement_m: of(&record.relative_displacement_m).unwrap_or(0.0),
        },
        status: StatusBits(StatusBits::DRIVE_ENABLED),
    }
}
