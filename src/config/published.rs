//! What the paper measured (Table 2 of Andreaus and De Angelis 2020), read by the run's final table and
//! by campaigns.

use super::case::Case;

/// One row of the published table.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PublishedPeaks {
    /// Bumper, gap and table acceleration.
    pub case: Case,
    /// Pseudo-resonance frequency over f_R = 1.0 Hz, numerically Hz, within 0.05.
    pub nu_r: f64,
    /// Peak absolute acceleration of the mass, m/s2.
    pub a_max_m_s2: f64,
    /// Excursion D_max - D_min, m.
    pub excursion_m: f64,
}

/// A row that cannot be read.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("line {line}: {reason}")]
pub struct PublishedError {
    /// Line, from 1.
    pub line: usize,
    /// What is wrong there.
    pub reason: String,
}

const TABLE_2: &str = include_str!("../../config/published/andreaus-2020-table2.csv");
const HEADER: &str = "bumper,gap,total_gap_m,table_acceleration_g,nu_r,a_max_m_s2,excursion_m";

/// Table 2 of the paper, 53 rows.
pub fn table_2() -> Vec<PublishedPeaks> {
    // Checked by a test of this module: the text is part of the binary.
    parse(TABLE_2).unwrap_or_default()
}

/// The published peaks of a case, if it was run.
pub fn peaks_of(case: &Case) -> Option<PublishedPeaks> {
    table_2().into_iter().find(|row| row.case == *case)
}

/// Reads a table of the columns of `config/published/andreaus-2020-table2.csv`.
///
/// # Errors
/// [`PublishedError`] with the line that cannot be read.
pub fn parse(text: &str) -> Result<Vec<PublishedPeaks>, PublishedError> {
    let mut lines = text.lines().enumerate();
    match lines.next() {
        Some((_, header)) if header.trim() == HEADER => {}
        _ => return Err(PublishedError { line: 1, reason: format!("expected the columns {HEADER}") }),
    }
    lines
        .filter(|(_, line)| !line.trim().is_empty())
        .map(|(i, line)| row(line).map_err(|reason| PublishedError { line: i + 1, reason }))
        .collect()
}

fn row(line: &str) -> Result<PublishedPeaks, String> {
    let cells: Vec<&str> = line.split(',').map(str::trim).collect();
    let [bumper, gap, total_gap_m, ag, nu_r, a_max, excursion] = cells.as_slice() else {
        return Err(format!("{} columns; expected 7", cells.len()));
    };
    let number = |name: &str, cell: &str| -> Result<f64, String> {
        match cell.parse::<f64>() {
            Ok(value) if value > 0.0 && value.is_finite() => Ok(value),
            _ => Err(format!("{name}: `{cell}` is no positive number")),
        }
    };
    let label = if *bumper == "B0" { format!("B0-{ag}") } else { format!("{bumper}-{gap}-{ag}") };
    let case: Case = label.parse().map_err(|error| format!("{error}"))?;
    if let Some(expected_m) = case.total_gap_m()
        && (number("total_gap_m", total_gap_m)? - expected_m).abs() > 1e-9
    {
        return Err(format!("total_gap_m: {total_gap_m}; {gap} is {expected_m} m"));
    }
    Ok(PublishedPeaks {
        case,
        nu_r: number("nu_r", nu_r)?,
        a_max_m_s2: number("a_max_m_s2", a_max)?,
        excursion_m: number("excursion_m", excursion)?,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_built_in_table_is_complete() {
        let rows = parse(TABLE_2).expect("valid");
        assert_eq!(rows.len(), 53);
        let row = peaks_of(&"B1-G2-0.05".parse().expect("case")).expect("published");
        assert_eq!((row.nu_r, row.a_max_m_s2, row.excursion_m), (1.6, 2.94, 0.0418));
        assert!(peaks_of(&"B4-G1-0.07".parse().expect("case")).is_none(), "the authors did not keep it");
    }

    #[test]
    fn a_broken_row_is_named() {
        let text = format!("{HEADER}\nB1,G2,0.025,0.05,1.6,2.6,0.04\n");
        assert_eq!(parse(&text).expect_err("gap").line, 2);
        assert_eq!(parse("a,b\n").expect_err("header").line, 1);
    }
}
