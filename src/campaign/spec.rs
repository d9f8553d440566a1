//! The campaign file: bumpers, gaps and accelerations as a matrix with exceptions, the order of the cases,
//! and what the cases are run with. Read by every `campaign` subcommand.

use super::CampaignError;
use crate::config::published::PublishedPeaks;
use crate::config::{Check, ConfigError, builtin::find, published};
use crate::model::{BumperSpec, EffectSpec, ModelSpec};
use crate::rig::RigSpec;
use crate::sweep::SweepSpec;
use serde::{Deserialize, Serialize};
use std::collections::BTreeSet;

/// A campaign file.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CampaignSpec {
    /// Name of the campaign and of its folder.
    pub name: String,
    /// Rig, by name or file.
    pub rig: String,
    /// Sweep, by name or file; its acceleration is replaced case by case.
    pub sweep: String,
    /// Model of mass and isolator, by name or file; its bumper is replaced by that of the case.
    pub model: String,
    /// What really stands on the simulated table, by name or file (its bumper is replaced as well); it may
    /// carry effects that the model lacks. Without it the model.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub specimen: Option<String>,
    /// Published table to measure against: by name, or a CSV file.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub published: Option<String>,
    /// f_R of nu = f / f_R, Hz.
    #[serde(default = "default_reference_hz")]
    pub reference_hz: f64,
    /// What the pseudo-resonance is the largest of; the paper leaves it open.
    #[serde(default)]
    pub pseudo_resonance: ResonanceOf,
    /// Bumper that the first problem is normalised by (free flight).
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub free: Option<String>,
    /// Bumper that the second problem is normalised by (the most rigid).
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub rigid: Option<String>,
    /// Cases that the report draws with histories, loops and portraits.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub showcase: Vec<String>,
    /// What is changed least often.
    #[serde(default)]
    pub order: Order,
    /// Runs of every case.
    #[serde(default = "one")]
    pub repeats: u32,
    /// Seed of the simulated rig's noise; every run derives its own from it and its label.
    #[serde(default = "default_seed")]
    pub seed: u64,
    /// Every bumper at every gap.
    pub matrix: Block,
    /// When cases are left out.
    #[serde(default)]
    pub stop: StopRules,
    /// Bumpers.
    pub bumper: Vec<BumperEntry>,
    /// Gaps.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub gap: Vec<GapEntry>,
    /// Cases beside the matrix.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub also: Vec<Block>,
    /// Cases of the matrix that are not run.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub except: Vec<Block>,
}

/// A pair of bumpers.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct BumperEntry {
    /// Short name, as in labels.
    pub name: String,
    /// What it is.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub about: Option<String>,
    /// Stiffness of one bumper, N/m; left out for free flight.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub stiffness_n_m: Option<f64>,
    /// Damping of one bumper, N s/m.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub damping_n_s_m: Option<f64>,
    /// The two numbers were not identified, only assumed.
    #[serde(default)]
    pub assumed: bool,
}

/// A gap.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct GapEntry {
    /// Short name, as in labels.
    pub name: String,
    /// Clearance of both sides together, m.
    pub total_gap_m: f64,
}

/// A block of cases: every one of its bumpers at every gap under every acceleration; no list means all.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Block {
    /// Bumpers by name.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub bumpers: Option<Vec<String>>,
    /// Gaps by name.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub gaps: Option<Vec<String>>,
    /// Peak accelerations of the table, g.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub accelerations_g: Option<Vec<f64>>,
}

/// What the pseudo-resonance is the largest of.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum ResonanceOf {
    /// The excursion.
    #[default]
    Excursion,
    /// The acceleration of the mass.
    Acceleration,
}

/// What is changed least often.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Order {
    /// The gap: screws are turned least.
    #[default]
    Gap,
    /// The bumpers: they are exchanged least.
    Bumper,
    /// The acceleration: low levels first, over the whole matrix.
    Acceleration,
}

/// When cases are left out.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct StopRules {
    /// What an abort by safety means for what follows.
    pub after_abort: AfterAbort,
}

/// What an abort by safety means for what follows.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum AfterAbort {
    /// The same bumper and gap is not run at higher accelerations.
    #[default]
    SkipHigher,
    /// Nothing.
    GoOn,
    /// No further case is started.
    End,
}

/// One case of a campaign: places in its lists, and the acceleration.
#[derive(Clone, Debug, PartialEq)]
pub struct CaseKey {
    /// Place in [`CampaignSpec::bumper`].
    pub bumper: usize,
    /// Place in [`CampaignSpec::gap`]; `None` in free flight.
    pub gap: Option<usize>,
    /// Peak acceleration of the table A_G, g.
    pub acceleration_g: f64,
    /// `B1-G2-0.05`.
    pub label: String,
    /// `B1-G2`: what has to be mounted and set.
    pub device: String,
}

/// A campaign with everything that it names.
#[derive(Clone, Debug)]
pub struct Configuration {
    /// The file.
    pub spec: CampaignSpec,
    /// Rig.
    pub rig: RigSpec,
    /// Sweep.
    pub sweep: SweepSpec,
    /// Mass and isolator.
    pub model: ModelSpec,
    /// What stands on the simulated table.
    pub specimen: ModelSpec,
    /// Published values.
    pub published: Vec<PublishedPeaks>,
    /// The cases in their order.
    pub cases: Vec<CaseKey>,
}

fn default_reference_hz() -> f64 {
    1.0
}
fn one() -> u32 {
    1
}
fn default_seed() -> u64 {
    1
}

impl BumperEntry {
    /// No bumper at all.
    pub fn is_free(&self) -> bool {
        self.stiffness_n_m.is_none()
    }
}

impl Block {
    fn holds(&self, bumper: &str, gap: Option<&str>, acceleration_g: f64) -> bool {
        let named = |list: &Option<Vec<String>>, name: &str| {
            list.as_ref().is_none_or(|list| list.iter().any(|n| n == name))
        };
        let level = |list: &Vec<f64>| list.iter().any(|a| (a - acceleration_g).abs() < 1e-9);
        named(&self.bumpers, bumper)
            && gap.is_none_or(|gap| named(&self.gaps, gap))
            && self.accelerations_g.as_ref().is_none_or(level)
    }
}

impl CampaignSpec {
    /// The cases in the order in which they are to be run: within a device by rising acceleration.
    pub fn cases(&self) -> Vec<CaseKey> {
        let blocks = || std::iter::once(&self.matrix).chain(&self.also);
        let mut levels: Vec<f64> =
            blocks().flat_map(|b| b.accelerations_g.iter().flatten().copied()).collect();
        levels.sort_by(f64::total_cmp);
        levels.dedup();
        let mut cases = Vec::new();
        for (b, bumper) in self.bumper.iter().enumerate() {
            let gaps: Vec<Option<usize>> =
                if bumper.is_free() { vec![None] } else { (0..self.gap.len()).map(Some).collect() };
            for gap in gaps {
                let gap_name = gap.map(|g| self.gap[g].name.as_str());
                for &acceleration_g in &levels {
                    let holds = |block: &Block| block.holds(&bumper.name, gap_name, acceleration_g);
                    let of_matrix = holds(&self.matrix) && !self.except.iter().any(holds);
                    if of_matrix || self.also.iter().any(holds) {
                        cases.push(self.key(b, gap, acceleration_g));
                    }
                }
            }
        }
        let level = |case: &CaseKey| (case.acceleration_g * 1e9) as u64;
        // The sort is stable: what is not named keeps its order.
        match self.order {
            Order::Gap => cases.sort_by_key(|case| case.gap),
            Order::Bumper => cases.sort_by_key(|case| case.bumper),
            Order::Acceleration => cases.sort_by_key(|case| (level(case), case.gap)),
        }
        cases
    }

    /// The key of a case.
    fn key(&self, bumper: usize, gap: Option<usize>, acceleration_g: f64) -> CaseKey {
        let device = match gap {
            Some(gap) => format!("{}-{}", self.bumper[bumper].name, self.gap[gap].name),
            None => self.bumper[bumper].name.clone(),
        };
        let level = format!("{acceleration_g:.2}");
        let exact = level.parse::<f64>().is_ok_and(|v| (v - acceleration_g).abs() < 1e-9);
        let level = if exact { level } else { acceleration_g.to_string() };
        CaseKey { bumper, gap, acceleration_g, label: format!("{device}-{level}"), device }
    }

    fn check_names(&self) -> Result<(), (String, String)> {
        let sound = |key: String, name: &str| {
            let fits = !name.is_empty() && name.chars().all(|c| c.is_ascii_alphanumeric() || c == '_');
            let reason = || format!("`{name}`; allowed: letters, digits and _ (labels are joined by -)");
            if fits { Ok(()) } else { Err((key, reason())) }
        };
        let mut seen = BTreeSet::new();
        for (i, bumper) in self.bumper.iter().enumerate() {
            let key = format!("bumper[{i}]");
            sound(format!("{key}.name"), &bumper.name)?;
            if !seen.insert(&bumper.name) {
                return Err((format!("{key}.name"), format!("`{}` is there twice", bumper.name)));
            }
            let numbers = (bumper.stiffness_n_m, bumper.damping_n_s_m);
            if matches!(numbers, (None, Some(_)) | (Some(_), None)) {
                let reason = "stiffness_n_m and damping_n_s_m go together; without both it is free flight";
                return Err((key, reason.into()));
            }
            if numbers.0.is_some_and(|k| !(k > 0.0 && k <= 1e12))
                || numbers.1.is_some_and(|c| !(0.0..=1e9).contains(&c))
            {
                let reason = "allowed: stiffness above 0 to 1e12 N/m, damping 0 to 1e9 N s/m";
                return Err((key, reason.into()));
            }
        }
        let mut seen = BTreeSet::new();
        for (i, gap) in self.gap.iter().enumerate() {
            sound(format!("gap[{i}].name"), &gap.name)?;
            if !seen.insert(&gap.name) {
                return Err((format!("gap[{i}].name"), format!("`{}` is there twice", gap.name)));
            }
            if !(1e-6..=10.0).contains(&gap.total_gap_m) {
                let reason = format!("{} m; allowed: 0.000001 to 10 m", gap.total_gap_m);
                return Err((format!("gap[{i}].total_gap_m"), reason));
            }
        }
        Ok(())
    }

    fn check_block(&self, key: &str, block: &Block) -> Result<(), (String, String)> {
        let known = |list: &Option<Vec<String>>, what: &str, has: &dyn Fn(&str) -> bool| {
            for (i, name) in list.iter().flatten().enumerate() {
                if !has(name) {
                    return Err((format!("{key}.{what}[{i}]"), format!("no entry is called `{name}`")));
                }
            }
            Ok(())
        };
        known(&block.bumpers, "bumpers", &|name| self.bumper.iter().any(|b| b.name == name))?;
        known(&block.gaps, "gaps", &|name| self.gap.iter().any(|g| g.name == name))?;
        for (i, level) in block.accelerations_g.iter().flatten().enumerate() {
            if !(0.0005..=2.0).contains(level) {
                let reason = format!("{level} g; allowed: 0.0005 to 2 g");
                return Err((format!("{key}.accelerations_g[{i}]"), reason));
            }
        }
        Ok(())
    }
}

impl Check for CampaignSpec {
    fn check(&self) -> Result<(), (String, String)> {
        let name_fits = self.name.chars().all(|c| c.is_ascii_alphanumeric() || "-_.".contains(c));
        if self.name.is_empty() || !name_fits {
            return Err(("name".into(), format!("`{}`; allowed: letters, digits, - _ .", self.name)));
        }
        if !(1e-3..=1e3).contains(&self.reference_hz) {
            return Err((
                "reference_hz".into(),
                format!("{} Hz; allowed: 0.001 to 1000 Hz", self.reference_hz),
            ));
        }
        if !(1..=1000).contains(&self.repeats) {
            return Err(("repeats".into(), format!("{}; allowed: 1 to 1000", self.repeats)));
        }
        self.check_names()?;
        self.check_block("matrix", &self.matrix)?;
        for (what, blocks) in [("also", &self.also), ("except", &self.except)] {
            for (i, block) in blocks.iter().enumerate() {
                self.check_block(&format!("{what}[{i}]"), block)?;
            }
        }
        for (key, name) in [("free", &self.free), ("rigid", &self.rigid)] {
            if name.as_ref().is_some_and(|name| !self.bumper.iter().any(|b| b.name == *name)) {
                return Err((key.into(), "no bumper of that name".into()));
            }
        }
        let cases = self.cases();
        if cases.is_empty() {
            return Err(("matrix".into(), "no case: give bumpers, gaps and accelerations_g".into()));
        }
        for (i, label) in self.showcase.iter().enumerate() {
            if !cases.iter().any(|case| case.label == *label) {
                return Err((format!("showcase[{i}]"), format!("`{label}` is no case of the campaign")));
            }
        }
        Ok(())
    }
}

impl Configuration {
    /// Reads everything that a campaign names.
    ///
    /// # Errors
    /// [`CampaignError::Config`].
    pub fn load(spec: CampaignSpec) -> Result<Self, CampaignError> {
        let rig: RigSpec = find("rigs", &spec.rig)?.parse()?;
        let sweep: SweepSpec = find("sweeps", &spec.sweep)?.parse()?;
        let model: ModelSpec = find("models", &spec.model)?.parse()?;
        let specimen = match spec.specimen.as_ref().or(rig.specimen.as_ref()) {
            Some(name) => find("models", name)?.parse()?,
            None => model.clone(),
        };
        let published = match spec.published.as_deref() {
            None => Vec::new(),
            Some(name) => read_published(name)?,
        };
        let cases = spec.cases();
        Ok(Self { spec, rig, sweep, model, specimen, published, cases })
    }

    /// What nu_R means in this campaign.
    pub fn resonance(&self) -> super::peaks::Resonance {
        super::peaks::Resonance {
            reference_hz: self.spec.reference_hz,
            by_acceleration: self.spec.pseudo_resonance == ResonanceOf::Acceleration,
        }
    }

    /// The model of a case: mass and isolator as they are, the bumper of the case.
    pub fn model_of(&self, case: &CaseKey) -> ModelSpec {
        self.mounted(&self.model, case)
    }

    /// What stands on the simulated table in a case.
    pub fn specimen_of(&self, case: &CaseKey) -> ModelSpec {
        self.mounted(&self.specimen, case)
    }

    fn mounted(&self, base: &ModelSpec, case: &CaseKey) -> ModelSpec {
        let mut model = base.clone();
        model.name = format!("{}-{}", self.spec.name, case.device.to_lowercase());
        mount(&mut model, self.bumper_of(case));
        model
    }

    /// Bumper and gap of a case; `None` in free flight.
    pub fn bumper_of(&self, case: &CaseKey) -> Option<BumperSpec> {
        let bumper = &self.spec.bumper[case.bumper];
        Some(BumperSpec {
            stiffness_n_m: bumper.stiffness_n_m?,
            damping_n_s_m: bumper.damping_n_s_m?,
            total_gap_m: self.total_gap_m(case)?,
        })
    }

    /// Total gap of a case, m.
    pub fn total_gap_m(&self, case: &CaseKey) -> Option<f64> {
        case.gap.map(|gap| self.spec.gap[gap].total_gap_m)
    }

    /// The case of a label.
    pub fn case(&self, label: &str) -> Option<&CaseKey> {
        self.cases.iter().find(|case| case.label == label)
    }

    /// What a publication states of a case.
    pub fn published_of(&self, case: &CaseKey) -> Option<&PublishedPeaks> {
        self.published.iter().find(|row| row.case.to_string() == case.label)
    }
}

/// Puts a bumper into a model, or takes it out with the effects that need one.
pub fn mount(model: &mut ModelSpec, bumper: Option<BumperSpec>) {
    if bumper.is_none() {
        let needs = |effect: &EffectSpec| {
            crate::model::effects::find(&effect.name).is_ok_and(|effect| effect.needs_bumper())
                || effect.name == "gap-asymmetry"
        };
        model.effects.retain(|effect| !needs(effect));
        if let Some(uncertainty) = &mut model.uncertainty {
            uncertainty.bumper = None;
        }
    }
    model.bumper = bumper;
}

/// Reads a published table by name or path.
///
/// # Errors
/// [`CampaignError`] with the file and what is wrong.
pub fn read_published(name: &str) -> Result<Vec<PublishedPeaks>, CampaignError> {
    if name == "andreaus-2020-table2" {
        return Ok(published::table_2());
    }
    let path = std::path::Path::new(name);
    let text = std::fs::read_to_string(path)
        .map_err(|error| ConfigError::Unreadable { path: name.to_owned(), reason: error.to_string() })?;
    published::parse(&text).map_err(|error| CampaignError::file(path, error))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::parse_toml;

    pub(super) const PAPER: &str = include_str!("../../config/campaigns/andreaus-2020.toml");

    #[test]
    fn the_paper_campaign_is_the_published_matrix_in_the_order_of_gaps() {
        let spec: CampaignSpec = parse_toml("c.toml", PAPER).expect("valid");
        let labels: Vec<String> = spec.cases().into_iter().map(|case| case.label).collect();
        let mut sorted = labels.clone();
        sorted.sort();
        let mut table: Vec<String> = published::table_2().iter().map(|row| row.case.to_string()).collect();
        table.sort();
        assert_eq!(sorted, table);
        assert_eq!(&labels[..4], ["B0-0.03", "B0-0.04", "B0-0.05", "B1-G1-0.03"]);
        let gaps: Vec<_> = spec.cases().iter().map(|case| case.gap).collect();
        assert!(gaps.windows(2).all(|pair| pair[0] <= pair[1]), "screws are turned three times");
    }

    #[test]
    fn the_models_of_the_cases_are_those_of_the_paper() {
        let spec: CampaignSpec = parse_toml("c.toml", PAPER).expect("valid");
        let configuration = Configuration::load(spec).expect("loads");
        for case in &configuration.cases {
            let model = configuration.model_of(case);
            assert_eq!(model.check(), Ok(()), "{}", case.label);
            let paper = crate::model::paper::of_case(&case.label.parse().expect("a case of the paper"));
            assert_eq!(
                (model.mass_kg, model.isolator, model.bumper),
                (paper.mass_kg, paper.isolator, paper.bumper)
            );
        }
    }

    #[test]
    fn mistakes_are_refused_with_their_line() {
        let refusal = |from: &str, to: &str| {
            parse_toml::<CampaignSpec>("c.toml", &PAPER.replacen(from, to, 1))
                .expect_err("refused")
                .to_string()
        };
        assert!(
            refusal("bumpers = [\"B4\"]", "bumpers = [\"B7\"]")
                .contains("also[0].bumpers[0]: no entry is called `B7`")
        );
        assert!(
            refusal("total_gap_m = 0.015", "total_gap_m = -0.015")
                .contains("gap[0].total_gap_m: -0.015 m; allowed")
        );
        assert!(refusal("name = \"B1\"", "name = \"B-1\"").contains("joined by -"));
        assert!(refusal("damping_n_s_m = 300.0", "").contains("go together"));
        assert!(refusal("repeats = 1", "repeats = 0").contains("allowed: 1 to 1000"));
        assert!(refusal("order = \"gap\"", "order = \"size\"").contains("unknown variant"));
        assert!(refusal("B1-G2-0.05", "B1-G2-0.09").contains("no case of the campaign"));
    }
}
