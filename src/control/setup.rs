//! From configurations to a run: checks that the sweep fits the rig, builds specimen, onboard model and
//! rig, and writes down what was asked. Used by the command line, campaigns and the daemon.

use super::onboard::{Observed, Onboard};
use super::recorded::points_of_rows;
use super::session::{Pace, Plan};
use super::thread::prioritise_link;
use crate::config::{Case, ConfigError};
use crate::model::observe::Instruments;
use crate::model::system::System;
use crate::model::{ModelError, ModelSpec, Observer, build, paper};
use crate::record::Manifest;
use crate::rig::hardware::{HardwareError, HardwareMonitor, HardwareRig, HardwareSpec, Preflight};
use crate::rig::replay::ReplayRig;
use crate::rig::simulated::{FaultSwitches, SimulatedRig, chain_delay_s, specimen_step_s};
use crate::rig::{Rig, RigSpec};
use crate::safety::{self, Guard, SafetySpec};
use crate::stream::{Depths, Row, Sample};
use crate::sweep::{Generator, Preview, Schedule, SweepError, SweepSpec, Transition};
use serde::Serialize;
use serde::de::DeserializeOwned;
use std::path::Path;

/// Everything that defines a run on the simulated rig.
#[derive(Clone, Debug)]
pub struct Setup {
    /// Table, drive, instruments.
    pub rig: RigSpec,
    /// The command.
    pub sweep: SweepSpec,
    /// The onboard model.
    pub model: ModelSpec,
    /// What really stands on the simulated table; it may carry effects that the onboard model lacks.
    pub specimen: ModelSpec,
    /// Case of the paper's Table 1, if one was named.
    pub case: Option<Case>,
    /// Detectors, action ladder, stops; without it the built-in `safety.toml`.
    pub safety: Option<SafetySpec>,
    /// Seed of noise and faults.
    pub seed: u64,
    /// Name of the run.
    pub name: String,
}

/// Why a run was refused.
#[derive(Debug, thiserror::Error)]
pub enum SetupError {
    /// The sweep itself, or the sweep on this rig.
    #[error(transparent)]
    Sweep(#[from] SweepError),
    /// The onboard model or the specimen.
    #[error("{role}: {source}")]
    Model {
        /// `model` or `specimen`.
        role: &'static str,
        /// What is wrong.
        source: ModelError,
    },
    /// The real devices.
    #[error(transparent)]
    Hardware(#[from] Box<HardwareError>),
    /// A command that jumps cannot be given to a table.
    #[error("transition = \"none\" jumps in velocity and is for `simulate` only; a run needs \"smooth\"")]
    Jumps,
    /// A configuration could not be written down or read back.
    #[error("{role} of the run: {reason}")]
    Text {
        /// Which configuration.
        role: &'static str,
        /// Why.
        reason: String,
    },
}

impl Setup {
    /// The steps of the sweep.
    ///
    /// # Errors
    /// [`SetupError`] when there are none or the command would jump.
    pub fn schedule(&self) -> Result<Schedule, SetupError> {
        if self.sweep.transition == Transition::None {
            return Err(SetupError::Jumps);
        }
        Ok(Schedule::new(&self.sweep)?)
    }

    /// What the sweep asks of the table.
    ///
    /// # Errors
    /// [`SetupError`] as of [`Setup::schedule`]; that it fits the rig is [`Preview::check`]'s to say.
    pub fn preview(&self) -> Result<Preview, SetupError> {
        let moving_kg = self.rig.table.platen_mass_kg + self.specimen.mass_kg;
        Ok(Preview::new(&self.schedule()?, &self.rig.capacity(), moving_kg, self.rig.table.friction_n))
    }

    /// The onboard model, made for one step a sample period of the rig.
    ///
    /// # Errors
    /// [`SetupError::Model`].
    pub fn onboard(&self) -> Result<Onboard, SetupError> {
        let role = |source| SetupError::Model { role: "model", source };
        let step_s = 1.0 / self.rig.sample_rate_hz;
        let specimen = build(&self.model, step_s).map_err(role)?;
        let instruments = System::compile(&self.model, step_s).map_err(role)?.instruments;
        if instruments == Instruments::default() {
            return Ok(Onboard::new(specimen, &self.rig));
        }
        let observer = Observer::from_instruments(instruments, step_s);
        Ok(Onboard::new(Box::new(Observed::new(specimen, observer)), &self.rig))
    }

    /// The simulated rig with its specimen.
    ///
    /// # Errors
    /// [`SetupError::Model`].
    pub fn simulated_rig(&self) -> Result<SimulatedRig, SetupError> {
        let (spec, rate) = (self.rig.simulated(), self.rig.sample_rate_hz);
        let role = |source| SetupError::Model { role: "specimen", source };
        let step_s = specimen_step_s(&spec, rate);
        let specimen = build(&self.specimen, step_s).map_err(role)?;
        let system = System::compile(&self.specimen, step_s).map_err(role)?;
        let rig = SimulatedRig::new(&spec, specimen, system.mass_kg, rate, self.seed);
        Ok(rig.with_instruments(Observer::from_instruments(system.instruments, step_s)))
    }

    /// The safety file in force: the set-up's own, else the built-in one.
    ///
    /// # Errors
    /// [`SetupError::Text`] when that is broken.
    pub fn safety_spec(&self) -> Result<SafetySpec, SetupError> {
        let broken = |error: ConfigError| SetupError::Text { role: "safety", reason: error.to_string() };
        self.safety.clone().map_or_else(|| SafetySpec::built_in().map_err(broken), Ok)
    }

    /// Detectors, supervisor and stops for this rig and specimen.
    ///
    /// # Errors
    /// [`SetupError::Text`] as of [`Setup::safety_spec`].
    pub fn guard(&self, chain_delay_s: f64) -> Result<Guard, SetupError> {
        let rate = self.rig.sample_rate_hz;
        let known = safety::Setup::new(rate, chain_delay_s, self.rig.capacity(), &self.model);
        Ok(Guard::new(&self.safety_spec()?, &known))
    }

    /// What `run.toml` says at the start.
    ///
    /// # Errors
    /// [`SetupError::Text`].
    pub fn manifest(&self, pace: Pace) -> Result<Manifest, SetupError> {
        let mut manifest = Manifest::new(&self.name, self.rig.sample_rate_hz);
        manifest.clock = match pace {
            Pace::Virtual => "virtual".to_owned(),
            Pace::Wall { .. } => "wall".to_owned(),
        };
        manifest.seed = Some(self.seed);
        manifest.case = self.case.map(|case| case.to_string());
        manifest.configure("rig", text("rig", &self.rig)?);
        manifest.configure("sweep", text("sweep", &self.sweep)?);
        manifest.configure("model", text("model", &self.model)?);
        manifest.configure("specimen", text("specimen", &self.specimen)?);
        manifest.configure("safety", text("safety", &self.safety_spec()?)?);
        Ok(manifest)
    }

    /// The setup of a recorded run, from what its `run.toml` kept. A safety file of another version of this program gives
    /// way to the built-in one.
    ///
    /// # Errors
    /// [`SetupError::Text`] when a configuration is missing or unreadable.
    pub fn of_run(manifest: &Manifest) -> Result<Self, SetupError> {
        let model: ModelSpec = parse(manifest, "model")?;
        Ok(Self {
            rig: parse(manifest, "rig")?,
            sweep: parse(manifest, "sweep")?,
            specimen: match manifest.configuration.contains_key("specimen") {
                true => parse(manifest, "specimen")?,
                false => model.clone(),
            },
            model,
            case: manifest.case.as_ref().and_then(|case| case.parse().ok()),
            safety: parse(manifest, "safety").ok(),
            seed: manifest.seed.unwrap_or(0),
            name: manifest.name.clone(),
        })
    }

    /// The command of a recorded run, for playing it back.
    ///
    /// # Errors
    /// [`SetupError`] when the sweep is refused.
    pub fn recorded_command(&self, rows: &[Row]) -> Result<Generator, SetupError> {
        let (schedule, rate) = (self.schedule()?, self.rig.sample_rate_hz);
        let mut points = points_of_rows(rows, Generator::new(&schedule, rate));
        // The first sample stands under the command before the first period, which is rest.
        let points = points.split_off(points.len().min(1));
        Ok(Generator::recorded(&schedule, rate, points))
    }

    /// Recorded samples, played back through this setup under a command, ready to start. Nobody operates a record, so that
    /// no operator's link is missed.
    ///
    /// # Errors
    /// [`SetupError`] when anything is refused.
    pub fn replay_plan(
        &self,
        samples: Vec<Sample>,
        command: Generator,
        out: &Path,
    ) -> Result<Plan, SetupError> {
        let delay_s = chain_delay_s(&self.rig.simulated(), self.rig.sample_rate_hz);
        let mut safety = self.safety_spec()?;
        safety.supervision.operator_link = false;
        let setup = Self { safety: Some(safety), ..self.clone() };
        Ok(Plan {
            out: out.to_owned(),
            manifest: setup.manifest(Pace::Virtual)?,
            rig: Box::new(ReplayRig::new(samples, delay_s)),
            generator: command,
            model: setup.onboard()?,
            guard: Some(setup.guard(delay_s)?),
            pace: Pace::Virtual,
            depths: Depths::for_rate(self.rig.sample_rate_hz),
        })
    }

    /// The whole run on the simulated rig, ready to start, and the rig's fault switches.
    ///
    /// # Errors
    /// [`SetupError`] when anything is refused, a sweep beyond the rig's capacity included.
    pub fn plan(&self, out: &Path, pace: Pace) -> Result<(Plan, FaultSwitches), SetupError> {
        self.preview()?.check()?;
        let rig = self.simulated_rig()?;
        let (faults, delay_s) = (rig.faults(), rig.chain_delay_s());
        let plan = Plan {
            out: out.to_owned(),
            manifest: self.manifest(pace)?,
            rig: Box::new(rig),
            generator: Generator::new(&self.schedule()?, self.rig.sample_rate_hz),
            model: self.onboard()?,
            guard: Some(self.guard(delay_s)?),
            pace,
            depths: Depths::for_rate(self.rig.sample_rate_hz),
        };
        Ok((plan, faults))
    }
}

impl Setup {
    /// The whole run on real devices, connected, checked and ready to start; a monitor of their links; what the check
    /// found, which is stored with the run.
    ///
    /// # Errors
    /// [`SetupError`] when anything is refused, a link fails or the check finds something.
    pub fn hardware_plan(
        &self,
        hardware: &HardwareSpec,
        out: &Path,
        pace: Pace,
    ) -> Result<(Plan, HardwareMonitor, Preflight), SetupError> {
        self.preview()?.check()?;
        let (rig, preflight) =
            HardwareRig::open(hardware, self.rig.sample_rate_hz, Some(prioritise_link)).map_err(Box::new)?;
        let monitor = rig.monitor();
        Ok((self.plan_on(rig, &preflight, out, pace)?, monitor, preflight))
    }

    /// The run on a rig of real devices that is connected and checked already.
    ///
    /// # Errors
    /// [`SetupError`] when anything is refused.
    pub fn plan_on(
        &self,
        rig: HardwareRig,
        preflight: &Preflight,
        out: &Path,
        pace: Pace,
    ) -> Result<Plan, SetupError> {
        let mut manifest = self.manifest(pace)?;
        manifest.configure("preflight", text("preflight", preflight)?);
        let delay_s = rig.chain_delay_s();
        Ok(Plan {
            out: out.to_owned(),
            manifest,
            rig: Box::new(rig),
            generator: Generator::new(&self.schedule()?, self.rig.sample_rate_hz),
            model: self.onboard()?,
            guard: Some(self.guard(delay_s)?),
            pace,
            depths: Depths::for_rate(self.rig.sample_rate_hz),
        })
    }
}

/// The published model of a case.
pub fn model_of_case(case: &Case) -> ModelSpec {
    paper::of_case(case)
}

fn parse<T: DeserializeOwned>(manifest: &Manifest, role: &'static str) -> Result<T, SetupError> {
    let text = manifest
        .configuration
        .get(role)
        .ok_or_else(|| SetupError::Text { role, reason: "the run did not keep it".to_owned() })?;
    toml::from_str(text).map_err(|error| SetupError::Text { role, reason: error.to_string() })
}

fn text(role: &'static str, value: &impl Serialize) -> Result<String, SetupError> {
    toml::to_string(value).map_err(|error| SetupError::Text { role, reason: error.to_string() })
}
