//! What a model file may say: ranges of the numbers, known effects with known parameters.

use super::effects;
use super::{BumperSpec, IsolatorSpec, ModelError, ModelSpec};
use crate::config::Check;

type Refusal = (String, String);

fn refuse<T>(key: &str, reason: String) -> Result<T, Refusal> {
    Err((key.to_owned(), reason))
}

/// Finite and above zero.
fn positive(key: &str, value: f64, unit: &str) -> Result<(), Refusal> {
    if value.is_finite() && value > 0.0 {
        return Ok(());
    }
    refuse(key, format!("{value} {unit}; allowed: above 0 {unit}"))
}

/// Finite and not below zero.
fn not_negative(key: &str, value: f64, unit: &str) -> Result<(), Refusal> {
    if value.is_finite() && value >= 0.0 {
        return Ok(());
    }
    refuse(key, format!("{value} {unit}; allowed: 0 {unit} or more"))
}

fn check_isolator(isolator: &IsolatorSpec) -> Result<(), Refusal> {
    let (slopes, knees) = (&isolator.stiffness_n_m, &isolator.breakpoints_m);
    if slopes.is_empty() || slopes.len() != knees.len() + 1 {
        return refuse(
            "isolator.stiffness_n_m",
            format!(
                "{} slopes with {} breakpoints; allowed: one slope more than breakpoints",
                slopes.len(),
                knees.len()
            ),
        );
    }
    if slopes.len() > 16 {
        return refuse("isolator.stiffness_n_m", format!("{} slopes; allowed: 16 at most", slopes.len()));
    }
    for (i, slope) in slopes.iter().enumerate() {
        not_negative(&format!("isolator.stiffness_n_m[{i}]"), *slope, "N/m")?;
    }
    for (i, knee) in knees.iter().enumerate() {
        let key = format!("isolator.breakpoints_m[{i}]");
        positive(&key, *knee, "m")?;
        if i > 0 && *knee <= knees[i - 1] {
            return refuse(&key, format!("{knee} m; allowed: above the one before, {} m", knees[i - 1]));
        }
    }
    not_negative("isolator.damping_n_s_m", isolator.damping_n_s_m, "N s/m")
}

fn check_bumper(bumper: &BumperSpec) -> Result<(), Refusal> {
    not_negative("bumper.stiffness_n_m", bumper.stiffness_n_m, "N/m")?;
    not_negative("bumper.damping_n_s_m", bumper.damping_n_s_m, "N s/m")?;
    not_negative("bumper.total_gap_m", bumper.total_gap_m, "m")
}

impl Check for ModelSpec {
    fn check(&self) -> Result<(), Refusal> {
        positive("mass_kg", self.mass_kg, "kg")?;
        check_isolator(&self.isolator)?;
        if let Some(bumper) = &self.bumper {
            check_bumper(bumper)?;
        }
        for (i, effect) in self.effects.iter().enumerate() {
            effects::check(i, effect, self).map_err(|error| match error {
                ModelError::Invalid { key, reason } => (key, reason),
                other => (format!("effect[{i}].name"), other.to_string()),
            })?;
        }
        self.uncertainty.as_ref().map_or(Ok(()), |u| u.check_against(self))
    }
}

impl super::spec::Uncertainty {
    /// Half-widths are relative: above 0 and at most 1; lists as long as what they speak of.
    fn check_against(&self, spec: &ModelSpec) -> Result<(), Refusal> {
        let width = |key: &str, value: f64| {
            if value.is_finite() && value > 0.0 && value <= 1.0 {
                return Ok(());
            }
            refuse(
                &format!("uncertainty.{key}"),
                format!("{value}; allowed: above 0, at most 1 (relative half-width)"),
            )
        };
        let list = |key: &str, widths: &[f64], wanted: usize| {
            if !widths.is_empty() && widths.len() != wanted {
                return refuse(
                    &format!("uncertainty.{key}"),
                    format!("{} numbers; allowed: {wanted}, one for each in the model", widths.len()),
                );
            }
            widths.iter().enumerate().try_for_each(|(i, value)| width(&format!("{key}[{i}]"), *value))
        };
        self.mass_kg.map_or(Ok(()), |value| width("mass_kg", value))?;
        if let Some(isolator) = &self.isolator {
            list("isolator.stiffness_n_m", &isolator.stiffness_n_m, spec.isolator.stiffness_n_m.len())?;
            list("isolator.breakpoints_m", &isolator.breakpoints_m, spec.isolator.breakpoints_m.len())?;
            isolator.damping_n_s_m.map_or(Ok(()), |value| width("isolator.damping_n_s_m", value))?;
        }
        let Some(bumper) = &self.bumper else { return Ok(()) };
        if spec.bumper.is_none() {
            return refuse("uncertainty.bumper", "the model has no bumper".to_owned());
        }
        for (key, value) in [
            ("bumper.stiffness_n_m", bumper.stiffness_n_m),
            ("bumper.damping_n_s_m", bumper.damping_n_s_m),
            ("bumper.total_gap_m", bumper.total_gap_m),
        ] {
            value.map_or(Ok(()), |value| width(key, value))?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use crate::config::parse_toml;
    use crate::model::ModelSpec;

    const GOOD: &str = "name = \"x\"\nmass_kg = 500.0\n[isolator]\nstiffness_n_m = [20e3, 18e3]\nbreakpoints_m = [0.008]\n\
        damping_n_s_m = 1100.0\n[bumper]\nstiffness_n_m = 33e3\ndamping_n_s_m = 300.0\ntotal_gap_m = 0.020\n\
        [[effect]]\nname = \"coulomb-friction\"\nfc_n = 12.0\n";

    #[test]
    fn impossible_numbers_are_refused_with_line_and_range() {
        parse_toml::<ModelSpec>("m.toml", GOOD).expect("good");
        for (from, to, expected) in [
            ("mass_kg = 500.0", "mass_kg = 0.0", "m.toml:2: mass_kg: 0 kg; allowed: above 0 kg"),
            (
                "[20e3, 18e3]",
                "[20e3, -1.0]",
                "m.toml:4: isolator.stiffness_n_m[1]: -1 N/m; allowed: 0 N/m or more",
            ),
            ("[0.008]", "[0.008, 0.009]", "m.toml:4: isolator.stiffness_n_m: 2 slopes with 2 breakpoints"),
            (
                "total_gap_m = 0.020",
                "total_gap_m = -0.1",
                "m.toml:10: bumper.total_gap_m: -0.1 m; allowed: 0 m or more",
            ),
            ("fc_n = 12.0", "fc_n = -12.0", "m.toml:13: effect[0].fc_n: -12 N; allowed: 0 N or more"),
            ("fc_n = 12.0", "fd_n = 12.0", "effect[0].fd_n: `coulomb-friction` has no such parameter"),
            ("fc_n = 12.0", "", "effect[0].fc_n: missing"),
            ("coulomb-friction", "colomb-friction", "no effect is called `colomb-friction`"),
            ("total_gap_m", "gap_m", "unknown field `gap_m`"),
        ] {
            let error =
                parse_toml::<ModelSpec>("m.toml", &GOOD.replace(from, to)).expect_err(expected).to_string();
            assert!(error.contains(expected), "{error}\nwanted: {expected}");
        }
    }
}
