//! The answer of a diagnosis, as JSON and as text an engineer reads.

use super::missing_force::MissingForce;
use super::next_test::NextTest;
use super::verdict::{Refused, Verdict};
use crate::identify::refit::FittedNumber;
use crate::model::ModelSpec;
use crate::model::effects::{expression, unit_behind};
use serde::Serialize;
use std::collections::BTreeMap;

/// One effect named by a verdict.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct NamedEffect {
    /// Name in the catalogue.
    pub name: String,
    /// How sure.
    pub probability: f64,
    /// Parameters by name.
    pub parameters: BTreeMap<String, ParameterEstimate>,
    /// Held-out error with this effect (and those before it in the list).
    pub error_after: Option<f64>,
}

/// One parameter of a named effect.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ParameterEstimate {
    /// Best value.
    pub value: f64,
    /// Lower end of the 95 % interval.
    pub low95: f64,
    /// Upper end of the 95 % interval.
    pub high95: f64,
    /// Unit.
    pub unit: String,
}

/// One step of the error ladder.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Rung {
    /// What the model is at this step.
    pub model: String,
    /// NRMSE on the steps that the fit saw.
    pub training: f64,
    /// NRMSE on the held-out steps.
    pub held_out: f64,
}

/// Error of one step, response simulated.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct StepErrors {
    /// Number of the step.
    pub step: i32,
    /// Its frequency, Hz.
    pub frequency_hz: f64,
    /// Whether it was kept back from the fits.
    pub held_out: bool,
    /// Re-identified without what was found.
    pub reidentified: f64,
    /// With it.
    pub after: f64,
    /// What the noise of the instruments makes of it.
    pub noise_floor: f64,
}

/// What the named effects leave of a record of another rig, which no few lines of a model tell to within a good sensor's noise: they stand,
/// and are not all there is.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Left {
    /// Held-out error over what the noise alone makes.
    pub times_noise: f64,
    /// The force that is still missing.
    pub force: Option<MissingForce>,
}

/// The whole answer. Errors are NRMSE of the held-out steps: RMS of the error over RMS of the
/// measured signal, the mean square of A's and D's where both were measured.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Diagnosis {
    /// Verdict.
    pub verdict: Verdict,
    /// Named effects, best first.
    pub effects: Vec<NamedEffect>,
    /// What was tried and refused.
    pub refused: Vec<Refused>,
    /// Error of the model as given.
    pub error_before: f64,
    /// Error after re-identifying its own numbers.
    pub error_reidentified: f64,
    /// Error with the named effects.
    pub error_after: f64,
    /// Error that the noise of the instruments alone makes.
    pub noise_floor: f64,
    /// Names that explain the record as well.
    pub ambiguous_with: Vec<String>,
    /// The test that would part the rivals or sharpen the answer.
    pub next_test: Option<NextTest>,
    /// What is left over displacement and velocity after re-identification.
    pub missing_force: Option<MissingForce>,
    /// What the named effects leave, where that is more than noise.
    pub left: Option<Left>,
    /// Error ladder.
    pub ladder: Vec<Rung>,
    /// Errors step by step.
    pub steps: Vec<StepErrors>,
    /// Numbers of the base model, re-identified together with the named effects.
    pub reidentified: Vec<FittedNumber>,
    /// Numbers that this record cannot tell.
    pub not_identifiable: Vec<String>,
    /// What was noticed about record and instruments.
    pub notes: Vec<String>,
    /// Share of the excess over the noise that is left.
    pub share_left: f64,
    /// Covariance of neighbouring residuals of the simulated response, in units of the noise, which has none; nothing where the
    /// response does not decide.
    pub structure_left: Option<f64>,
    /// The model that was found: re-identified, with what was named, or with the drafted force.
    #[serde(skip)]
    pub model: ModelSpec,
    /// Wall time, s.
    pub wall_s: f64,
}

/// Error over the noise floor from which on something is left that numbers make up for.
const LEFT: f64 = 1.2;
/// The same from which on what is named may stand in for something that there is no name for.
const ANOTHER_LAW: f64 = 3.0;

impl Diagnosis {
    /// What the re-identified numbers are called: those of a model that lacks something make up for it, and no interval holds then.
    pub fn numbers_title(&self) -> &'static str {
        match self.verdict {
            Verdict::OutsideCatalogue if self.error_after > LEFT * self.noise_floor => {
                "Re-identified numbers (they make up for what is missing: no interval holds before the model has that)"
            }
            Verdict::OutsideCatalogue if self.found() == Some(expression::EFFECT.name) => {
                "Re-identified numbers (beside the drafted force: they hold as far as that is what is missing)"
            }
            _ => "Re-identified numbers",
        }
    }

    /// What the last rung of the ladder has added to the re-identified model.
    fn found(&self) -> Option<&str> {
        self.ladder.last()?.model.strip_prefix("+ ")
    }

    /// What explains a part of a record that nothing explains, in the numbers and the error after; none where that is a drafted force.
    fn explained_in_part(&self) -> Option<&str> {
        let outside = self.verdict == Verdict::OutsideCatalogue;
        self.found().filter(|found| outside && *found != expression::EFFECT.name)
    }

    /// The verdict in one line.
    pub fn sentence(&self) -> String {
        let names = self.effects.iter().map(|e| e.name.as_str()).collect::<Vec<_>>().join(", ");
        match self.verdict {
            Verdict::Adequate => {
                "Verdict: adequate - nothing is missing beyond noise and parameters".to_owned()
            }
            Verdict::Missing => format!("Verdict: missing - {names}"),
            Verdict::Ambiguous => {
                format!("Verdict: ambiguous - {names}, or as well {}", self.ambiguous_with.join(", "))
            }
            Verdict::OutsideCatalogue => {
                "Verdict: outside the catalogue - no known effect explains it".to_owned()
            }
        }
    }

    /// The answer in words.
    pub fn text(&self) -> String {
        let mut out = String::new();
        let mut line = |text: String| {
            out.push_str(&text);
            out.push('\n');
        };
        line(self.sentence());
        line(format!(
            "Error on held-out steps: {:.3} % as given, {:.3} % re-identified, {:.3} % after; noise floor {:.3} %",
            100.0 * self.error_before,
            100.0 * self.error_reidentified,
            100.0 * self.error_after,
            100.0 * self.noise_floor
        ));
        if let Some(left) = &self.left {
            line(left.sentence());
            left.force.iter().for_each(|force| tell(&mut line, "What is still missing", force));
        }
        if let Some(tried) = self.explained_in_part() {
            line(format!("After and the numbers below are with {tried}, which explains a part of it"));
        }
        for effect in &self.effects {
            line(format!("  {} (probability {:.2})", effect.name, effect.probability));
            for (name, p) in &effect.parameters {
                line(format!(
                    "    {name} = {}{} (95 %: {} to {})",
                    Short(p.value),
                    unit_behind(&p.unit),
                    Short(p.low95),
                    Short(p.high95)
                ));
            }
        }
        if !self.reidentified.is_empty() {
            line(format!("{}:", self.numbers_title()));
            for r in &self.reidentified {
                line(format!(
                    "  {:<28} {:>12} -> {:>12} (95 %: {} to {}{})",
                    r.key,
                    Short(r.nominal),
                    Short(r.value),
                    Short(r.low95),
                    Short(r.high95),
                    r.remark()
                ));
            }
        }
        for note in &self.notes {
            line(format!("Note: {note}"));
        }
        if !self.not_identifiable.is_empty() {
            line(format!("This record cannot tell: {}", self.not_identifiable.join("; ")));
        }
        if !self.refused.is_empty() {
            line("Refused:".to_owned());
            for refused in &self.refused {
                line(format!("  {}: {}", refused.name, refused.reason));
            }
        }
        // Of a model that lacks nothing there is nothing to be told.
        if let Some(force) = self.missing_force.as_ref().filter(|_| self.verdict != Verdict::Adequate) {
            tell(&mut line, "What the re-identified model lacks without any effect", force);
        }
        if let Some(test) = &self.next_test {
            line(format!("Next test: {} - {}", test.title, test.reason));
        }
        out
    }
}

/// Says where a missing force is, and what it may be.
fn tell(line: &mut impl FnMut(String), what: &str, force: &MissingForce) {
    line(format!(
        "{what}: {:.0} % of it is a surface over D and D', {:.0} % lies in contact ({:.0} % of the time)",
        100.0 * force.explained_by_surface,
        100.0 * force.power_in_contact,
        100.0 * force.time_in_contact
    ));
    if let Some(draft) = &force.expression {
        line(format!("  draft: {} (explains {:.0} %)", draft.expression, 100.0 * draft.explains));
        let values = draft.parameters.iter().map(|(name, value)| format!("{name} = {}", Short(*value)));
        line(format!("    with {}", values.collect::<Vec<_>>().join(", ")));
    }
}

impl Left {
    /// That something is left, in words.
    pub fn sentence(&self) -> String {
        let named = if self.times_noise < ANOTHER_LAW {
            "what is named stands"
        } else {
            "what is named comes nearest among known effects, and may stand in for another law"
        };
        format!(
            "Not all of it: {named}; the error that is left is {:.1} times what noise alone makes",
            self.times_noise
        )
    }
}

/// A number with five significant digits, whatever its magnitude.
pub struct Short(pub f64);

impl std::fmt::Display for Short {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let magnitude = self.0.abs();
        let text = if magnitude == 0.0 || (1e-3..1e6).contains(&magnitude) {
            let digits = (4 - magnitude.max(1e-3).log10().floor() as i32).clamp(0, 8) as usize;
            format!("{:.digits$}", self.0)
        } else {
            format!("{:.4e}", self.0)
        };
        match f.width() {
            Some(width) => write!(f, "{text:>width$}"),
            None => f.write_str(&text),
        }
    }
}
