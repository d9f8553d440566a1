//! A case of the paper's matrix: bumper, gap and table acceleration, as in `B1-G2-0.05`.

use std::fmt;
use std::str::FromStr;

/// Bumper, gap and peak table acceleration.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Case {
    /// Bumper, 0 (none) to 4 (stiffest).
    pub bumper: u8,
    /// Gap, 1 (15 mm) to 4 (30 mm); 0 for B0, which has none.
    pub gap: u8,
    /// Peak acceleration of the table A_G, g.
    pub acceleration_g: f64,
}

/// A case that cannot be read.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "case `{text}`: {reason}; a case reads B1-G2-0.05 (B1 to B4, G1 to G4, table acceleration in g) or B0-0.05"
)]
pub struct CaseError {
    text: String,
    reason: String,
}

/// Total gaps G1 to G4 of the paper, m.
const TOTAL_GAPS_M: [f64; 4] = [0.015, 0.020, 0.025, 0.030];

impl Case {
    /// Clearance of both sides together, m; `None` for B0.
    pub fn total_gap_m(&self) -> Option<f64> {
        usize::from(self.gap).checked_sub(1).and_then(|i| TOTAL_GAPS_M.get(i)).copied()
    }

    /// Bumper and gap without the acceleration: `B1-G2`, or `B0`.
    pub fn device(&self) -> String {
        match self.gap {
            0 => format!("B{}", self.bumper),
            gap => format!("B{}-G{gap}", self.bumper),
        }
    }
}

impl fmt::Display for Case {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}-{:.2}", self.device(), self.acceleration_g)
    }
}

impl FromStr for Case {
    type Err = CaseError;

    fn from_str(text: &str) -> Result<Self, CaseError> {
        let error = |reason: &str| CaseError { text: text.to_owned(), reason: reason.to_owned() };
        let mut parts = text.split('-');
        let digit = |part: Option<&str>, letter: char, low: u8, high: u8| {
            let number =
                part.and_then(|part| part.strip_prefix(letter)).and_then(|rest| rest.parse::<u8>().ok());
            number.filter(|number| (low..=high).contains(number))
        };
        let bumper = digit(parts.next(), 'B', 0, 4).ok_or_else(|| error("no bumper B0 to B4"))?;
        let gap = match bumper {
            0 => 0,
            _ => digit(parts.next(), 'G', 1, 4).ok_or_else(|| error("no gap G1 to G4"))?,
        };
        let ag = parts.next().ok_or_else(|| error("no table acceleration"))?;
        let ag = ag.strip_suffix('g').unwrap_or(ag).parse::<f64>().ok();
        let acceleration_g = ag
            .filter(|ag| (0.0005..=2.0).contains(ag))
            .ok_or_else(|| error("the table acceleration is no number from 0.0005 to 2 g"))?;
        if parts.next().is_some() {
            return Err(error("something follows the table acceleration"));
        }
        Ok(Self { bumper, gap, acceleration_g })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cases_are_read_and_written() {
        for text in ["B1-G2-0.05", "B4-G1-0.07", "B0-0.03"] {
            assert_eq!(text.parse::<Case>().expect("valid").to_string(), text);
        }
        let case: Case = "B1-G2-0.05g".parse().expect("valid");
        assert_eq!(case.total_gap_m(), Some(0.020));
        assert_eq!("B0-0.03".parse::<Case>().expect("valid").total_gap_m(), None);
    }

    #[test]
    fn mistakes_say_what_is_allowed() {
        for text in
            ["B5-G1-0.05", "B1-G5-0.05", "B1-0.05", "B1-G2", "B1-G2-x", "B1-G2-0.05-x", "", "B1-G2--1"]
        {
            let error = text.parse::<Case>().expect_err(text).to_string();
            assert!(error.contains("a case reads B1-G2-0.05"), "{error}");
        }
    }
}
