//! The models of the paper's cases: what was identified by Andreaus and De Angelis (2020), and for the
//! bumpers that were not, the values that come nearest to their Table 2. The command line, campaigns and
//! the daemon start from these.

use super::{BumperSpec, IsolatorSpec, ModelSpec};
use crate::config::Case;

/// Stiffness (N/m) and damping (N s/m) of B1 to B4. B1 and B2 as published; B3 and B4 were not
/// identified.
const BUMPERS: [(f64, f64); 4] = [(33e3, 300.0), (175e3, 500.0), (650e3, 1500.0), (3000e3, 3000.0)];

/// The published model of a case.
pub fn of_case(case: &Case) -> ModelSpec {
    let bumper = usize::from(case.bumper).checked_sub(1).and_then(|i| BUMPERS.get(i));
    ModelSpec {
        name: format!("andreaus-2020-{}", case.device().to_lowercase()),
        mass_kg: 500.0,
        isolator: IsolatorSpec {
            stiffness_n_m: vec![20e3, 18e3, 2e3],
            breakpoints_m: vec![0.008, 0.040],
            damping_n_s_m: 1100.0,
        },
        bumper: bumper.zip(case.total_gap_m()).map(|(&(stiffness_n_m, damping_n_s_m), total_gap_m)| {
            BumperSpec { stiffness_n_m, damping_n_s_m, total_gap_m }
        }),
        effects: Vec::new(),
        uncertainty: None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::Check;

    #[test]
    fn every_case_of_the_paper_has_a_valid_model() {
        for row in crate::config::published::table_2() {
            let model = of_case(&row.case);
            assert_eq!(model.check(), Ok(()), "{}", row.case);
            assert_eq!(model.bumper.map(|bumper| bumper.total_gap_m), row.case.total_gap_m());
        }
    }
}
