//! The folder of a campaign: one result a run, written whole or not at all, beside the run folders.
//!
//! `campaign.toml` and `configuration/` say what was asked, `cases/<label>.json` what came out, `runs/` holds
//! the recorded runs. A result depends on the configuration and the seed of its case alone, so that folders
//! of several machines can be put together ([`Store::merge`]) and give what one machine would have given.

use super::CampaignError;
use super::spec::{CampaignSpec, CaseKey, Configuration};
use crate::control::StepSummary;
use crate::record::Manifest;
use serde::{Deserialize, Serialize};
use std::fs::{self, File};
use std::path::{Path, PathBuf};

/// How a case ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum CaseOutcome {
    /// The sweep was run to its end.
    Done,
    /// Ended by safety; what had been measured until then is kept.
    Aborted,
    /// Not started: a stop rule, or the operator, left it out.
    NotRun,
}

/// What one run of a case gave.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct CaseResult {
    /// `B1-G2-0.05`.
    pub case: String,
    /// Bumper by name.
    pub bumper: String,
    /// Gap by name; `null` in free flight.
    pub gap: Option<String>,
    /// Clearance of both sides together, m.
    pub total_gap_m: Option<f64>,
    /// Peak acceleration of the table A_G, g.
    pub acceleration_g: f64,
    /// Run of this case, from 1.
    pub repeat: u32,
    /// Seed of the simulated rig.
    pub seed: u64,
    /// SHA-256 over everything that the run depends on.
    pub fingerprint: String,
    /// How it ended.
    pub outcome: CaseOutcome,
    /// Why it was aborted or not run.
    pub cause: Option<String>,
    /// Frequency at which it was aborted, Hz.
    pub at_hz: Option<f64>,
    /// Nothing was lost and the run ended as asked.
    pub clean: bool,
    /// Rows recorded.
    pub samples: u64,
    /// Samples that were lost.
    pub lost_samples: u64,
    /// SHA-256 of all rows.
    pub samples_sha256: Option<String>,
    /// Steady states of the steps.
    pub steps: Vec<StepSummary>,
}

impl CaseResult {
    /// A result without steps; outcome and cause are filled in by the caller.
    pub fn empty(configuration: &Configuration, case: &CaseKey, repeat: u32) -> Self {
        let spec = &configuration.spec;
        Self {
            case: case.label.clone(),
            bumper: spec.bumper[case.bumper].name.clone(),
            gap: case.gap.map(|gap| spec.gap[gap].name.clone()),
            total_gap_m: configuration.total_gap_m(case),
            acceleration_g: case.acceleration_g,
            repeat,
            seed: 0,
            fingerprint: String::new(),
            outcome: CaseOutcome::NotRun,
            cause: None,
            at_hz: None,
            clean: false,
            samples: 0,
            lost_samples: 0,
            samples_sha256: None,
            steps: Vec::new(),
        }
    }

    /// In words: `done`, `aborted: pinball at 0.5 Hz`, `not run: ...`.
    pub fn state(&self) -> String {
        let cause = self.cause.as_deref().unwrap_or("no cause given");
        match (self.outcome, self.at_hz) {
            (CaseOutcome::Done, _) => "done".to_owned(),
            (CaseOutcome::Aborted, Some(hz)) => format!("not run to its end: {cause} at {hz:.2} Hz"),
            (CaseOutcome::Aborted, None) => format!("not run to its end: {cause}"),
            (CaseOutcome::NotRun, _) => format!("not run: {cause}"),
        }
    }
}

/// SHA-256 over what a run depends on: every configuration's hash, and the seed.
pub fn fingerprint(manifest: &Manifest) -> String {
    use sha2::Digest;
    let mut hash = sha2::Sha256::new();
    // What the devices answered is a result, not a cause.
    for (role, sum) in
        manifest.sha256.iter().filter(|(role, _)| !["preflight", "links"].contains(&role.as_str()))
    {
        hash.update(format!("{role}={sum}\n"));
    }
    hash.update(format!("seed={:?}\n", manifest.seed));
    crate::record::samples::hex(&hash.finalize())
}

/// The folder of a campaign.
#[derive(Clone, Debug)]
pub struct Store {
    path: PathBuf,
}

/// A claim on one run of one case, given up when dropped or when the process ends, in whatever way.
#[derive(Debug)]
pub struct Claim(#[allow(dead_code)] File);

impl Store {
    /// The folder, which need not exist.
    pub fn at(path: &Path) -> Self {
        Self { path: path.to_owned() }
    }

    /// Makes the folder and writes down what is asked.
    ///
    /// # Errors
    /// [`CampaignError::File`] when it cannot be written, [`CampaignError::Foreign`] when it belongs to another
    /// campaign.
    pub fn prepare(&self, configuration: &Configuration) -> Result<(), CampaignError> {
        for folder in [self.path.clone(), self.cases(), self.runs(), self.path.join("configuration")] {
            fs::create_dir_all(&folder).map_err(|error| CampaignError::file(&folder, error))?;
        }
        if let Ok(there) = self.spec()
            && there.name != configuration.spec.name
        {
            let reason =
                format!("belongs to the campaign `{}`; choose another folder with --out", there.name);
            return Err(CampaignError::Foreign { path: self.path.clone(), reason });
        }
        let text = |value: Result<String, toml::ser::Error>, name: &str| {
            let path = self.path.join(name);
            let text = value.map_err(|error| CampaignError::file(&path, error))?;
            write_whole(&path, &text)
        };
        text(toml::to_string(&configuration.rig), "configuration/rig.toml")?;
        text(toml::to_string(&configuration.sweep), "configuration/sweep.toml")?;
        text(toml::to_string(&configuration.model), "configuration/model.toml")?;
        text(toml::to_string(&configuration.specimen), "configuration/specimen.toml")?;
        text(toml::to_string(&configuration.spec), "campaign.toml")
    }

    /// The folder.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Where the run folders are.
    pub fn runs(&self) -> PathBuf {
        self.path.join("runs")
    }

    fn cases(&self) -> PathBuf {
        self.path.join("cases")
    }

    /// `<label>` for the first run of a case, `<label>-r2` for the second.
    pub fn run_name(label: &str, repeat: u32) -> String {
        if repeat <= 1 { label.to_owned() } else { format!("{label}-r{repeat}") }
    }

    fn result_path(&self, label: &str, repeat: u32) -> PathBuf {
        self.cases().join(format!("{}.json", Self::run_name(label, repeat)))
    }

    /// The campaign file as it stands in the folder.
    ///
    /// # Errors
    /// [`CampaignError::File`].
    pub fn spec(&self) -> Result<CampaignSpec, CampaignError> {
        let path = self.path.join("campaign.toml");
        let text = fs::read_to_string(&path).map_err(|error| CampaignError::file(&path, error))?;
        toml::from_str(&text).map_err(|error| CampaignError::file(&path, error))
    }

    /// The campaign with the configurations that the folder keeps, which need not be those of today.
    ///
    /// # Errors
    /// [`CampaignError`] when one is missing or broken.
    pub fn configuration(&self) -> Result<Configuration, CampaignError> {
        fn read<T: serde::de::DeserializeOwned>(path: PathBuf) -> Result<T, CampaignError> {
            let text = fs::read_to_string(&path).map_err(|error| CampaignError::file(&path, error))?;
            toml::from_str(&text).map_err(|error| CampaignError::file(&path, error))
        }
        let spec = self.spec()?;
        let of = |name: &str| self.path.join("configuration").join(name);
        let published = spec.published.as_deref().map_or(Ok(Vec::new()), super::spec::read_published)?;
        Ok(Configuration {
            rig: read(of("rig.toml"))?,
            sweep: read(of("sweep.toml"))?,
            model: read(of("model.toml"))?,
            specimen: read(of("specimen.toml"))?,
            published,
            cases: spec.cases(),
            spec,
        })
    }

    /// The result of a run, if there is one.
    ///
    /// # Errors
    /// [`CampaignError::File`] when it cannot be read.
    pub fn result(&self, label: &str, repeat: u32) -> Result<Option<CaseResult>, CampaignError> {
        let path = self.result_path(label, repeat);
        let text = match fs::read_to_string(&path) {
            Ok(text) => text,
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => return Ok(None),
            Err(error) => return Err(CampaignError::file(&path, error)),
        };
        serde_json::from_str(&text).map(Some).map_err(|error| CampaignError::file(&path, error))
    }

    /// All results, in the order of the campaign's cases.
    ///
    /// # Errors
    /// [`CampaignError::File`].
    pub fn results(&self, configuration: &Configuration) -> Result<Vec<CaseResult>, CampaignError> {
        let mut results = Vec::new();
        for case in &configuration.cases {
            for repeat in 1..=configuration.spec.repeats {
                results.extend(self.result(&case.label, repeat)?);
            }
        }
        Ok(results)
    }

    /// Keeps a result: a reader sees the whole of it or nothing.
    ///
    /// # Errors
    /// [`CampaignError::File`].
    pub fn keep(&self, result: &CaseResult) -> Result<(), CampaignError> {
        let path = self.result_path(&result.case, result.repeat);
        let text = serde_json::to_string_pretty(result).map_err(|error| CampaignError::file(&path, error))?;
        write_whole(&path, &(text + "\n"))
    }

    /// Claims a run for this process; `None` while another one has it.
    ///
    /// # Errors
    /// [`CampaignError::File`].
    pub fn claim(&self, label: &str, repeat: u32) -> Result<Option<Claim>, CampaignError> {
        let path = self.cases().join(format!(".{}.lock", Self::run_name(label, repeat)));
        let file = File::create(&path).map_err(|error| CampaignError::file(&path, error))?;
        match file.try_lock() {
            Ok(()) => Ok(Some(Claim(file))),
            Err(fs::TryLockError::WouldBlock) => Ok(None),
            Err(fs::TryLockError::Error(error)) => Err(CampaignError::file(&path, error)),
        }
    }

    /// Takes over the results of another folder of the same campaign; those that are there already must be
    /// the same. Returns how many were new.
    ///
    /// # Errors
    /// [`CampaignError::Foreign`] when the folders disagree about a case.
    pub fn merge(&self, other: &Store) -> Result<usize, CampaignError> {
        let theirs = other.spec()?;
        if self.spec()? != theirs {
            let reason = format!("is of another campaign file than {}", self.path.display());
            return Err(CampaignError::Foreign { path: other.path.clone(), reason });
        }
        let mut new = 0;
        for case in theirs.cases() {
            for repeat in 1..=theirs.repeats {
                let from = other.result_path(&case.label, repeat);
                let Ok(bytes) = fs::read(&from) else { continue };
                let to = self.result_path(&case.label, repeat);
                match fs::read(&to) {
                    Ok(there) if there == bytes => {}
                    Ok(_) => {
                        let reason = format!("disagrees with {}", to.display());
                        return Err(CampaignError::Foreign { path: from, reason });
                    }
                    Err(_) => {
                        fs::copy(&from, &to).map_err(|error| CampaignError::file(&to, error))?;
                        new += 1;
                    }
                }
            }
        }
        Ok(new)
    }
}

/// Writes a file whole or not at all.
///
/// # Errors
/// [`CampaignError::File`].
pub fn write_whole(path: &Path, text: &str) -> Result<(), CampaignError> {
    let name = path.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
    // Two shards may write the same configuration into one folder.
    let partial = path.with_file_name(format!(".{name}.{}", std::process::id()));
    let write = || -> std::io::Result<()> {
        fs::write(&partial, text)?;
        File::open(&partial)?.sync_all()?;
        fs::rename(&partial, path)
    };
    write().map_err(|error| CampaignError::file(path, error))
}
