//! The general solver: Dormand and Prince's embedded Runge-Kutta 5(4) with dense output and the
//! event discipline that every model needs (contact, release, knees, stick and slip, play,
//! reversals). [`super::build`] and the sweep simulation drive it.
//!
//! Between events the model is smooth, so a step never straddles a corner; an event is bracketed on
//! the dense output, also when a pair of crossings lies inside one step, and the step is then taken
//! again up to it.

mod dynamics;
mod events;
mod impose;
mod interface;
mod runge_kutta;
mod specimen;
mod stretch;
#[cfg(test)]
mod tests;

pub use dynamics::{Drive, Line, Mode, Motion, Sine, Sliding};
pub(in crate::model) use events::{GUARDS, guard};
pub use specimen::General;

use super::system::System;
use super::{ModelError, Options, Response, Specimen};

/// The largest state that a solver is compiled for.
const LARGEST: usize = 48;

/// Begin and end of an accepted step (s since the start of the stretch), contacts, and the response
/// at any part of it under the table acceleration there (m/s2).
pub type StretchVisit<'a> = dyn FnMut(f64, f64, [bool; 2], &dyn Fn(f64, f64) -> Response) + 'a;

/// A solver that an ideal sweep can drive, whatever the number of its states.
pub trait Sweepable: Specimen {
    /// Advances by `duration` s under a sine from phase 0, visiting every accepted step.
    fn stretch(&mut self, duration: f64, drive: Sine, visit: &mut StretchVisit<'_>);
}

/// Chooses the smallest solver that carries all states.
///
/// # Errors
/// [`ModelError::TooManyStates`].
pub(super) fn boxed(system: System, options: &Options) -> Result<Box<dyn Specimen>, ModelError> {
    Ok(swept(system, options)?)
}

/// [`boxed`], for sweeps.
///
/// # Errors
/// [`ModelError::TooManyStates`].
pub(super) fn swept(system: System, options: &Options) -> Result<Box<dyn Sweepable>, ModelError> {
    let states = 2 + system.hidden_states();
    Ok(match states {
        0..=2 => Box::new(General::<2>::new(system, options)),
        3 => Box::new(General::<3>::new(system, options)),
        4..=6 => Box::new(General::<6>::new(system, options)),
        7..=10 => Box::new(General::<10>::new(system, options)),
        11..=12 => Box::new(General::<12>::new(system, options)),
        13..=18 => Box::new(General::<18>::new(system, options)),
        19..=LARGEST => Box::new(General::<LARGEST>::new(system, options)),
        needed => return Err(ModelError::TooManyStates { needed, allowed: LARGEST }),
    })
}
