//! The physics of the specimen: base model, effects, exact propagator and general solver.
//!
//! The simulated specimen, the onboard model, identification and diagnosis all call this module;
//! no other one knows an equation of the specimen.

mod check;
pub mod contact;
pub mod cubic;
pub mod effects;
pub(crate) mod elementary;
#[cfg(test)]
mod energy_tests;
mod error;
pub mod exact;
pub mod general;
mod keys;
pub mod observe;
pub mod paper;
#[cfg(test)]
mod physics_tests;
pub mod scales;
pub mod sensitivity;
pub mod simulate;
pub mod spec;
pub mod sweep;
#[cfg(test)]
mod symmetry_tests;
pub mod system;
#[cfg(test)]
pub(crate) mod testing;

pub use error::ModelError;
pub(crate) use observe::hermite;
pub use observe::{Observation, Observer};
pub use scales::Scales;
pub use sensitivity::{Sensitivity, simulate_with_sensitivities};
pub use simulate::{History, simulate_from, simulate_sampled};
pub use spec::{BumperSpec, EffectSpec, IsolatorSpec, IsolatorUncertainty, ModelSpec, Uncertainty};
pub use sweep::{
    StepPeaks, SweepHistory, SweepResponse, simulate_sweep, steady_peaks, sweep_history, sweep_peaks,
};

/// What the specimen does at one sample.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Response {
    /// Displacement of the mass relative to the table D, m.
    pub relative_displacement_m: f64,
    /// Its rate, m/s.
    pub relative_velocity_m_s: f64,
    /// Absolute acceleration of the mass A, m/s2.
    pub mass_acceleration_m_s2: f64,
    /// Contact force of the right bumper on the mass (pushing left is positive), N.
    pub right_contact_force_n: f64,
    /// Contact force of the left bumper on the mass (pushing right is positive), N.
    pub left_contact_force_n: f64,
    /// Branch, contact and friction state.
    pub regime: Regime,
}

/// Which piece of the piecewise model is active.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub struct Regime {
    /// Branch of the isolator, 0 for the innermost slope.
    pub isolator_branch: u8,
    /// The right bumper is in contact.
    pub right_contact: bool,
    /// The left bumper is in contact.
    pub left_contact: bool,
    /// The bearings stick.
    pub sticking: bool,
}

/// A specimen that advances sample by sample, driven by the table acceleration.
///
/// An applied force F with the table at rest (`force` records) is the table acceleration -F/M: D is
/// the same, and the acceleration of the mass is [`Response::mass_acceleration_m_s2`] + F/M
/// (both sides of M D'' = F - R). Nothing in [`Specimen::step`] allocates, locks or logs.
pub trait Specimen: Send {
    /// Puts the specimen at rest in its equilibrium.
    fn reset(&mut self);

    /// Advances one sample interval, the table acceleration running linearly from its last value
    /// to the one given (first-order hold, m/s2), and returns the state at the end.
    fn step(&mut self, table_acceleration_m_s2: f64) -> Response;

    /// Advances over samples of a table acceleration (m/s2) that is smooth, as a table in steady motion has it: handed to
    /// `visit` is the response at each. Solvers that gain by it take steps over many samples, through which the acceleration
    /// runs along cubics; others step from sample to sample.
    fn run(&mut self, table_acceleration_m_s2: &[f64], visit: &mut dyn FnMut(&Response)) {
        table_acceleration_m_s2.iter().for_each(|table| visit(&self.step(*table)));
    }

    /// States that forget the motion by a power law, slower than any start in the middle of a record has time for; none in most
    /// models. The same in all models that have any: they do not depend on their parameters.
    fn memory(&self) -> Vec<f64> {
        Vec::new()
    }

    /// Puts such states in, of a mass whose imposed motion has come to a displacement and velocity.
    fn recall(&mut self, _memory: &[f64], _now: (f64, f64)) {}

    /// States of all effects that are hidden along an imposed motion, where [`Specimen::resume`] can go on from there; none where some are no
    /// numbers, as those of a joint are and reversals.
    fn hidden(&self) -> Vec<f64> {
        Vec::new()
    }

    /// Goes on with such states from where the mass is now (m, m/s).
    fn resume(&mut self, _hidden: &[f64], _now: (f64, f64)) {}

    /// Tells what forgets a reversal of the motion only when this goes beyond it those so far (displacements in m, in their order) and
    /// puts the mass where it is now (m, m/s), everything else undeformed. Other models stay as they are.
    fn retrace(&mut self, _reversals_m: &mut dyn Iterator<Item = f64>, _now: (f64, f64)) {}

    /// Moves the mass along an imposed motion by one sample interval (relative displacement m and
    /// velocity m/s at its end): hidden states (bumper tips, hysteresis, friction) follow. The
    /// response holds the imposed motion and, as `mass_acceleration_m_s2`, minus the restoring
    /// force over the mass. The first after a reset starts at zero displacement with nothing deformed. A following
    /// [`Specimen::step`] starts from there, which is how a
    /// simulation is started in the middle of a record.
    fn impose(&mut self, relative_displacement_m: f64, relative_velocity_m_s: f64) -> Response;

    /// States the table acceleration at the present instant (m/s2), from which the next
    /// [`Specimen::step`] runs: 0 after a reset, held at its next value after
    /// [`Specimen::impose`] unless stated here.
    fn prime(&mut self, _table_acceleration_m_s2: f64) {}

    /// States the present time (s since the beginning of the test; 0 after a reset), on which
    /// `stiffness-degradation` and expressions in `t` depend: for a simulation that starts in the
    /// middle of a record. Nothing else changes.
    fn set_time_s(&mut self, _time_s: f64) {}
}

/// How the general solver works.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Options {
    /// Local error allowed, relative to the largest motion so far.
    pub tolerance: f64,
}

impl Default for Options {
    fn default() -> Self {
        Self { tolerance: 1e-8 }
    }
}

/// Builds the specimen of a model for a sample period, s, at rest in its equilibrium.
///
/// # Errors
/// [`ModelError`] for a model that its file would be refused for, or that cannot be solved.
pub fn build(spec: &ModelSpec, dt_s: f64) -> Result<Box<dyn Specimen>, ModelError> {
    build_with(spec, dt_s, &Options::default())
}

/// [`build`] with a tolerance of one's own.
///
/// # Errors
/// As [`build`].
pub fn build_with(spec: &ModelSpec, dt_s: f64, options: &Options) -> Result<Box<dyn Specimen>, ModelError> {
    match exact::Exact::new(system::System::compile(spec, dt_s)?) {
        Ok(exact) => Ok(Box::new(exact::Sampled::new(exact))),
        Err(system) => general::boxed(*system, options),
    }
}
