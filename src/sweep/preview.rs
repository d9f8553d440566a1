//! What a sweep asks of the table, before anything moves: peaks of displacement, velocity,
//! acceleration, jerk and force of every step and of the way into it, against the rig's capacity.

use super::motion::{Motion, ramp};
use super::schedule::{Schedule, Step};
use super::{SweepError, Transition};
use crate::rig::Capacity;
use std::f64::consts::TAU;
use std::fmt::Write as _;

/// Points at which a ramp or transition is evaluated; its peaks are found to about 1e-5.
const POINTS: u32 = 1024;

/// A quantity of the preview: what it is called, in which unit it is shown, and how it is got.
#[derive(Clone, Copy, Debug)]
pub struct Quantity {
    /// Name as in messages.
    pub name: &'static str,
    /// Unit shown.
    pub unit: &'static str,
    /// Factor from SI to the unit shown.
    pub scale: f64,
    /// The peak of a row, SI.
    pub asked: fn(&PreviewRow) -> f64,
    /// The limit of the rig, SI.
    pub allowed: fn(&Capacity) -> f64,
}

/// The quantities that are checked.
pub(super) static QUANTITIES: [Quantity; 5] = [
    Quantity {
        name: "displacement",
        unit: "mm",
        scale: 1e3,
        asked: |r| r.peak.displacement_m,
        allowed: |c| c.displacement_m,
    },
    Quantity {
        name: "velocity",
        unit: "mm/s",
        scale: 1e3,
        asked: |r| r.peak.velocity_m_s,
        allowed: |c| c.velocity_m_s,
    },
    Quantity {
        name: "acceleration",
        unit: "m/s2",
        scale: 1.0,
        asked: |r| r.peak.acceleration_m_s2,
        allowed: |c| c.acceleration_m_s2,
    },
    Quantity {
        name: "jerk",
        unit: "m/s3",
        scale: 1.0,
        asked: |r| r.peak.jerk_m_s3,
        allowed: |c| c.jerk_m_s3,
    },
    Quantity { name: "force", unit: "N", scale: 1.0, asked: |r| r.force_n, allowed: |c| c.force_n },
];

/// Peaks of one segment.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PreviewRow {
    /// The step, or the one ahead of a ramp or transition.
    pub step: Step,
    /// `start ramp`, `transition into the step`, `step` or `end ramp`.
    pub place: &'static str,
    /// Largest magnitudes.
    pub peak: Motion,
    /// Force to move table and specimen rigidly, friction included, N. What a specimen that hits its
    /// bumpers adds is not known beforehand.
    pub force_n: f64,
}

/// What a whole schedule asks, against what a rig gives.
#[derive(Clone, Debug)]
pub struct Preview {
    rows: Vec<PreviewRow>,
    capacity: Capacity,
    duration_s: f64,
}

impl Preview {
    /// Evaluates a schedule for a rig that moves `moving_mass_kg` (table and specimen) against
    /// `friction_n`.
    pub fn new(schedule: &Schedule, capacity: &Capacity, moving_mass_kg: f64, friction_n: f64) -> Self {
        let mut rows = Vec::new();
        let mut push = |step: &Step, place, peak: Motion| {
            let force_n = moving_mass_kg * peak.acceleration_m_s2 + friction_n;
            rows.push(PreviewRow { step: *step, place, peak, force_n });
        };
        let steps = schedule.steps();
        let smooth = schedule.transition() == Transition::Smooth;
        for (i, step) in steps.iter().enumerate() {
            let before = i.checked_sub(1).map(|before| &steps[before]);
            match before {
                None if smooth => push(step, "start ramp", ramp_peak(schedule, step, true)),
                None => {}
                Some(before) => {
                    if let Some(glide) = schedule.glide(before, step) {
                        push(step, "transition into the step", peak(glide.duration_s, |t| glide.at(t).0));
                    }
                }
            }
            push(step, "step", step_peak(step));
        }
        if let Some(last) = steps.last().filter(|_| smooth) {
            push(last, "end ramp", ramp_peak(schedule, last, false));
        }
        Self { rows, capacity: *capacity, duration_s: schedule.duration_s() }
    }

    /// Refuses a schedule that exceeds the rig anywhere.
    ///
    /// # Errors
    /// [`SweepError::BeyondCapacity`] names the first step and quantity that exceed.
    pub fn check(&self) -> Result<(), SweepError> {
        for row in &self.rows {
            for quantity in &QUANTITIES {
                let (asked, allowed) = ((quantity.asked)(row), (quantity.allowed)(&self.capacity));
                if asked > allowed {
                    return Err(SweepError::BeyondCapacity {
                        index: row.step.index,
                        frequency_hz: row.step.frequency_hz,
                        place: row.place,
                        quantity: quantity.name,
                        asked: asked * quantity.scale,
                        allowed: allowed * quantity.scale,
                        unit: quantity.unit,
                    });
                }
            }
        }
        Ok(())
    }

    /// The quantities that are checked.
    pub fn quantities() -> &'static [Quantity] {
        &QUANTITIES
    }

    /// Peaks of every segment, in order.
    pub fn rows(&self) -> &[PreviewRow] {
        &self.rows
    }

    /// The rig's limits.
    pub fn capacity(&self) -> &Capacity {
        &self.capacity
    }

    /// Largest peak of a quantity over the whole sweep, SI, with the row that asks for it.
    pub fn worst(&self, quantity: &Quantity) -> Option<(f64, &PreviewRow)> {
        let value = quantity.asked;
        self.rows.iter().map(|row| (value(row), row)).max_by(|a, b| a.0.total_cmp(&b.0))
    }

    /// The preview as text: duration, worst peaks against capacity, and a table of the steps.
    pub fn text(&self) -> String {
        let mut text = String::new();
        let steps = self.rows.iter().filter(|row| row.place == "step").count();
        // Writing to a String cannot fail.
        let _ = writeln!(text, "{steps} steps, {:.1} s from rest to rest", self.duration_s);
        let _ = writeln!(text, "\n{:<13} {:>11} {:>11} {:>7}  where", "peak", "asked", "allowed", "use");
        for quantity in &QUANTITIES {
            let Some((asked, row)) = self.worst(quantity) else { continue };
            let allowed = (quantity.allowed)(&self.capacity);
            let _ = writeln!(
                text,
                "{:<13} {:>11.2} {:>11.2} {:>6.1}%  {:.2} Hz, {}  ({})",
                quantity.name,
                asked * quantity.scale,
                allowed * quantity.scale,
                100.0 * asked / allowed,
                row.step.frequency_hz,
                row.place,
                quantity.unit,
            );
        }
        self.step_table(&mut text);
        text
    }

    fn step_table(&self, text: &mut String) {
        let _ = writeln!(text, "\n step  direction     Hz   x (mm)  v (mm/s)  a (m/s2)  j (m/s3)  start (s)");
        for row in self.rows.iter().filter(|row| row.place == "step") {
            let _ = writeln!(
                text,
                "{:>5}  {:<9} {:>6.2} {:>8.2} {:>9.1} {:>9.3} {:>9.2} {:>10.2}",
                row.step.index,
                row.step.direction.label(),
                row.step.frequency_hz,
                row.peak.displacement_m * 1e3,
                row.peak.velocity_m_s * 1e3,
                row.peak.acceleration_m_s2,
                row.peak.jerk_m_s3,
                row.step.start_s,
            );
        }
    }
}

fn step_peak(step: &Step) -> Motion {
    let w = TAU * step.frequency_hz;
    let a = step.acceleration_amplitude_m_s2;
    Motion { displacement_m: a / (w * w), velocity_m_s: a / w, acceleration_m_s2: a, jerk_m_s3: a * w }
}

fn ramp_peak(schedule: &Schedule, step: &Step, rising: bool) -> Motion {
    let duration_s = schedule.ramp_s(step);
    let w = TAU * step.frequency_hz;
    peak(duration_s, |t| ramp(step.acceleration_amplitude_m_s2, w, duration_s, t, rising).0)
}

fn peak(duration_s: f64, motion: impl Fn(f64) -> Motion) -> Motion {
    (0..=POINTS).fold(Motion::default(), |worst, i| {
        let m = motion(duration_s * f64::from(i) / f64::from(POINTS));
        Motion {
            displacement_m: worst.displacement_m.max(m.displacement_m.abs()),
            velocity_m_s: worst.velocity_m_s.max(m.velocity_m_s.abs()),
            acceleration_m_s2: worst.acceleration_m_s2.max(m.acceleration_m_s2.abs()),
            jerk_m_s3: worst.jerk_m_s3.max(m.jerk_m_s3.abs()),
        }
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sweep::SweepSpec;

    const CAPACITY: Capacity = Capacity {
        displacement_m: 0.1,
        velocity_m_s: 0.5,
        acceleration_m_s2: 5.884,
        jerk_m_s3: 200.0,
        force_n: 12_000.0,
    };

    fn preview(acceleration_g: f64) -> Preview {
        let spec = SweepSpec { acceleration_g, ..SweepSpec::paper() };
        Preview::new(&Schedule::new(&spec).expect("valid"), &CAPACITY, 2000.0, 60.0)
    }

    #[test]
    fn the_paper_sweep_fits_and_its_transitions_cost_six_per_cent() {
        let preview = preview(0.05);
        preview.check().expect("fits");
        let (worst, row) = preview.worst(&QUANTITIES[2]).expect("rows");
        let excess = worst / row.step.acceleration_amplitude_m_s2;
        assert!((excess - 1.062).abs() < 5e-4, "{excess}");
        // 0.5 to 0.6 Hz on the way up, or its mirror image on the way down
        let (low, high) = (row.step.frequency_hz.min(0.6), row.step.frequency_hz.max(0.5));
        assert!(row.place.starts_with("transition") && low >= 0.5 && high <= 0.6);
        let start = preview.rows()[0];
        let ramp_excess = start.peak.acceleration_m_s2 / start.step.acceleration_amplitude_m_s2;
        assert!(ramp_excess < 1.0185, "{ramp_excess}");
        // velocity and jerk are nowhere above those of the steps
        for quantity in [&QUANTITIES[1], &QUANTITIES[3]] {
            let steps = preview.rows().iter().filter(|row| row.place == "step");
            let largest = steps.map(quantity.asked).fold(0.0, f64::max);
            assert!(preview.worst(quantity).expect("rows").0 <= largest * (1.0 + 1e-9), "{}", quantity.name);
        }
        assert!(preview.text().contains("92 steps"));
    }

    #[test]
    fn a_sweep_past_the_stroke_is_refused_with_its_step() {
        let error = preview(0.15).check().expect_err("149 mm of 100 mm");
        let SweepError::BeyondCapacity { index, quantity, asked, .. } = &error else { panic!("{error}") };
        assert_eq!((*index, *quantity), (0, "displacement"));
        assert!(*asked > 100.0 && *asked < 150.0);
        assert!(error.to_string().contains("0.5 Hz, start ramp"), "{error}");
    }

    #[test]
    fn force_counts_mass_and_friction() {
        let weak = Capacity { force_n: 1000.0, ..CAPACITY };
        let spec = SweepSpec::paper();
        let schedule = Schedule::new(&spec).expect("valid");
        let error = Preview::new(&schedule, &weak, 2000.0, 60.0).check().expect_err("1041 N of 1000 N");
        assert!(error.to_string().contains("force"), "{error}");
    }
}
