//! The lines of `steps.csv`: a step each, with its peaks, the model's, their difference, and the harmonics
//! of table and mass. The recorder appends them; `recover` writes them anew; campaigns and the daemon read
//! them back, value for value.

use crate::control::event::{StepDirection, StepSummary};
use crate::signal::{HARMONICS, Harmonic};
use std::fmt::Write as _;
use std::path::Path;

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

/// All lines of a `steps.csv`. Harmonics of files that were written without them are zero.
///
/// # Errors
/// When the file cannot be read or a value is missing or none.
pub fn read(path: &Path) -> Result<Vec<StepSummary>, csv::Error> {
    let mut reader = csv::Reader::from_path(path)?;
    let header = reader.headers()?.clone();
    let at = |name: &str| header.iter().position(|column| column == name);
    let mut places = Vec::new();
    for (channel, unit) in CHANNELS {
        for order in 1..=HARMONICS {
            let amplitude = at(&format!("{channel}_h{order}_{unit}"));
            places.push(amplitude.zip(at(&format!("{channel}_h{order}_phase_rad"))));
        }
    }
    let step = |record: csv::StringRecord| {
        let mut step: StepSummary = record.deserialize(Some(&header))?;
        let harmonics = (step.table_acceleration.iter_mut())
            .chain(&mut step.mass_acceleration)
            .chain(&mut step.relative_displacement);
        for (harmonic, place) in harmonics.zip(&places) {
            let Some((amplitude, phase)) = *place else { continue };
            *harmonic =
                Harmonic { amplitude: number(&record, amplitude)?, phase_rad: number(&record, phase)? };
        }
        Ok(step)
    };
    reader.records().map(|record| step(record?)).collect()
}

fn number(record: &csv::StringRecord, at: usize) -> Result<f64, csv::Error> {
    let text = record.get(at).unwrap_or_default();
    text.parse().map_err(|_| {
        let line = record.position().map_or(0, csv::Position::line);
        let text = format!("line {line}, column {}: `{text}` is no number", at + 1);
        csv::Error::from(std::io::Error::new(std::io::ErrorKind::InvalidData, text))
    })
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

    #[test]
    fn lines_are_read_back_value_for_value() {
        let folder = tempfile::tempdir().expect("folder");
        let path = folder.path().join("steps.csv");
        let mut step = StepSummary {
            index: 1,
            direction: StepDirection::Backward,
            nrmse_a: 1.0 / 3.0,
            ..StepSummary::default()
        };
        let harmonics = (step.table_acceleration.iter_mut())
            .chain(&mut step.mass_acceleration)
            .chain(&mut step.relative_displacement);
        for (harmonic, n) in harmonics.zip(1..) {
            *harmonic = Harmonic { amplitude: f64::from(n) / 7.0, phase_rad: -f64::from(n) / 11.0 };
        }
        let steps = [StepSummary { frequency_hz: 0.1 + 0.2, ..StepSummary::default() }, step];
        let lines: Vec<String> = steps.iter().map(line).collect();
        std::fs::write(&path, format!("{}\n{}\n", head(), lines.join("\n"))).expect("written");
        assert_eq!(read(&path).expect("read"), steps);
        // A file without harmonics; a number that is none.
        let scalars = lines[0].split(',').take(SCALARS.split(',').count()).collect::<Vec<_>>().join(",");
        std::fs::write(&path, format!("{SCALARS}\n{scalars}\n")).expect("written");
        assert_eq!(read(&path).expect("read"), steps[..1]);
        std::fs::write(&path, format!("{}\n{scalars},x{}\n", head(), ",0".repeat(6 * HARMONICS - 1)))
            .expect("written");
        assert!(read(&path).expect_err("no number").to_string().contains("`x` is no number"));
    }
}
