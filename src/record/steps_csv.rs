//! The lines of `steps.csv`: a step each, with its peaks, the model's, their difference, and the harmonics
//! of table and mass. The recorder appends them; `recover` writes them anew.

use crate::control::event::{StepDirection, StepSummary};
use crate::signal::{HARMONICS, Harmonic};
use std::fmt::Write as _;

/// Columns before the harmonics.
const SCALARS: &str = "index,direction,frequency_hz,a_max_m_s2,excursion_m,model_a_max_m_s2,model_excursion_m,\
                       nrmse_a,nrmse_d,table_amplitude_ratio";
/// Demodulated channels, with the unit of their amplitudes.
const CHANNELS: [(&str, &str); 3] =
    [("table_acceleration", "m_s2"), ("mass_acceleration", "m_s2"), ("relative_displacement", "m")];

/// Head of `steps.csv`, without the end of the line.
pub fn head() -> String {
    let mut head = SCALARS.to_owned();
    for (channel, unit) in CHANNELS {
        for order in 1..=HARMONICS {
            // Writing to a String cannot fail.
            let _ = write!(head, ",{channel}_h{order}_{unit},{channel}_h{order}_phase_rad");
        }
    }
    head
}

/// One line of `steps.csv`, without its end.
pub fn line(step: &StepSummary) -> String {
    let direction = match step.direction {
        StepDirection::Forward => "forward",
        StepDirection::Backward => "backward",
    };
    let mut line = format!("{},{direction}", step.index);
    let scalars = [
        step.frequency_hz,
        step.a_max_m_s2,
        step.excursion_m,
        step.model_a_max_m_s2,
        step.model_excursion_m,
        step.nrmse_a,
        step.nrmse_d,
        step.table_amplitude_ratio,
    ];
    let harmonics =
        step.table_acceleration.iter().chain(&step.mass_acceleration).chain(&step.relative_displacement);
    let pairs = harmonics.flat_map(|&Harmonic { amplitude, phase_rad }| [amplitude, phase_rad]);
    for value in scalars.into_iter().chain(pairs) {
        // Writing to a String cannot fail.
        let _ = write!(line, ",{value}");
    }
    line
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_column_has_its_value() {
        let mut step = StepSummary {
            index: 3,
            frequency_hz: 0.8,
            table_amplitude_ratio: 0.99,
            ..StepSummary::default()
        };
        step.relative_displacement[4] = Harmonic { amplitude: 1e-5, phase_rad: -0.25 };
        let (head, line) = (head(), line(&step));
        let row: Vec<(&str, &str)> = head.split(',').zip(line.split(',')).collect();
        assert_eq!(head.matches(',').count(), line.matches(',').count());
        for pair in [
            ("index", "3"),
            ("direction", "forward"),
            ("table_amplitude_ratio", "0.99"),
            ("mass_acceleration_h2_m_s2", "0"),
            ("relative_displacement_h5_m", "0.00001"),
            ("relative_displacement_h5_phase_rad", "-0.25"),
        ] {
            assert!(row.contains(&pair), "{pair:?} in {row:?}");
        }
    }
}
