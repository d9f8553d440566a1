//! The figure of a sweep before it runs: displacement, velocity, acceleration and jerk of the whole
//! command against the rig's capacity. `run --preview --svg` writes it.

use super::ReportError;
use super::chart::Chart;
use super::series::envelope;
use super::style::{Ink, Stroke};
use crate::sweep::{CommandPoint, Generator, Preview, Schedule, Segment};

/// Samples of the command in one period of its highest frequency: peaks are met within 0.1 %.
const SAMPLES_PER_CYCLE: f64 = 64.0;
/// Columns of the histories.
const COLUMNS: usize = 1200;
/// Size of each of the four plots, px.
const SIZE_PX: (f64, f64) = (1140.0, 240.0);

/// Values of the command that are drawn, in the order of the quantities of a [`Preview`].
const CHANNELS: [fn(&CommandPoint) -> f64; 4] = [
    |point| point.command.displacement_m,
    |point| point.command.velocity_m_s,
    |point| point.command.acceleration_m_s2,
    |point| point.jerk_m_s3,
];

/// The four histories of a schedule with the rig's limits, one below the other, as an SVG file. With
/// `settling` every step is drawn at its longest.
///
/// # Errors
/// [`ReportError::Figure`] when the plotting library refuses.
pub fn preview_svg(schedule: &Schedule, preview: &Preview) -> Result<String, ReportError> {
    let top_hz = schedule.steps().iter().map(|step| step.frequency_hz).fold(1e-3, f64::max);
    let sample_rate_hz = SAMPLES_PER_CYCLE * top_hz;
    let (mut time_s, mut values) = (Vec::new(), [const { Vec::new() }; 4]);
    let mut generator = Generator::new(schedule, sample_rate_hz);
    loop {
        let point = generator.next_point();
        if point.segment == Segment::Done {
            break;
        }
        time_s.push(time_s.len() as f64 / sample_rate_hz);
        for (values, channel) in values.iter_mut().zip(CHANNELS) {
            values.push(channel(&point) as f32);
        }
    }
    let (width_px, height_px) = (SIZE_PX.0, SIZE_PX.1 * values.len() as f64);
    let mut svg =
        format!("<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{width_px}\" height=\"{height_px}\">\n");
    for (i, (quantity, values)) in Preview::quantities().iter().zip(&values).enumerate() {
        let limit = (quantity.allowed)(preview.capacity()) * quantity.scale;
        let asked = preview.worst(quantity).map_or(0.0, |(asked, _)| asked * quantity.scale);
        let range = 1.1 * limit.max(asked);
        let command = format!(
            "command: {asked:.4} {} at most, {:.1} % of the capacity",
            quantity.unit,
            100.0 * asked / limit
        );
        let chart = Chart::new("Time t (s)", &format!("{} ({})", quantity.name, quantity.unit))
            .size(SIZE_PX.0, SIZE_PX.1)
            .y_range(-range, range)
            .line(
                Some(&command),
                Stroke::solid(Ink::Backward).width(0.8),
                envelope(&time_s, values, quantity.scale, COLUMNS),
            )
            .level(Some("capacity of the rig"), Stroke::dashed(Ink::Limit), limit)
            .level(None, Stroke::dashed(Ink::Limit), -limit);
        let down_px = SIZE_PX.1 * i as f64;
        svg.push_str(&format!("<g transform=\"translate(0 {down_px})\">{}</g>\n", chart.svg()?));
    }
    svg.push_str("</svg>\n");
    Ok(svg)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rig::RigSpec;
    use crate::sweep::SweepSpec;

    #[test]
    fn four_quantities_are_drawn_to_the_end_of_the_sweep_with_their_limits() {
        let spec = SweepSpec::paper().restricted(2.0, 2.2).expect("steps");
        let schedule = Schedule::new(&spec).expect("valid");
        let preview = Preview::new(&schedule, &RigSpec::default().capacity(), 2000.0, 60.0);
        let svg = preview_svg(&schedule, &preview).expect("drawn");
        for text in ["displacement (mm)", "velocity (mm/s)", "acceleration (m/s2)", "jerk (m/s3)"] {
            assert!(svg.contains(text), "{text}");
        }
        assert_eq!(svg.matches("capacity of the rig").count(), 4);
        assert_eq!(svg.matches("command: 3.1").count(), 1, "3.11 mm at 2 Hz and 0.05 g");
        // a dashed limit above and below in each, and one in each legend
        assert_eq!(svg.matches("stroke-dasharray").count(), 12);
        assert_eq!(svg.matches("<svg").count(), svg.matches("</svg>").count());
    }
}
