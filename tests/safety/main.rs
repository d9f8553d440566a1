//! The safety case, shown on the whole control step over the simulated rig: Table 1 of the paper, faults in every
//! state, rigs that differ, the watchdog, and the numbers that join requirement, code and test.
//!
//! Long parts are ignored by default; `docs/safety.md` says how to run them, and holds what they wrote.

mod bench;
mod campaign;
mod faults;
mod link;
mod pages;
mod requirements;
mod roc;
mod slips;
mod stops;
mod watchdog;
