//! The physics of the specimen: base model, effects, exact propagator and general solver.
//!
//! The simulated specimen, the onboard model, identification and diagnosis all call this module;
//! no other one knows an equation of the specimen.

pub mod spec;

pub use spec::{BumperSpec, EffectSpec, IsolatorSpec, ModelSpec};

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
/// Nothing in [`Specimen::step`] allocates, locks or logs.
pub trait Specimen: Send {
    /// Puts the specimen at rest in its equilibrium.
    fn reset(&mut self);

    /// Advances one sample interval, the table acceleration running linearly from its last value
    /// to the one given (first-order hold, m/s2), and returns the state at the end.
    fn step(&mut self, table_acceleration_m_s2: f64) -> Response;

    /// Moves the mass along an imposed motion by one sample interval (relative displacement m and
    /// velocity m/s at its end): hidden states (bumper tips, hysteresis, friction) follow. The
    /// response holds the imposed motion and, as `mass_acceleration_m_s2`, minus the restoring
    /// force over the mass. A following [`Specimen::step`] starts from there, which is how a
    /// simulation is started in the middle of a record.
    fn impose(&mut self, relative_displacement_m: f64, relative_velocity_m_s: f64) -> Response;
}
