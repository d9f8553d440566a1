//! Wire formats, serial DAQ link and CANopen drive of the shaketable controller, with emulators of
//! both devices.
//!
//! [`wire`] (DAQ frames) and [`canopen`] (object names, SDO, PDO, NMT, EMCY, the CiA 402 state
//! machine) are `no_std` and do no input or output, so that firmware can be built from the same
//! code. With the feature `std` come the host's ends of both links and the emulated devices.

#![no_std]
#![forbid(unsafe_code)]
#![warn(missing_docs)]

#[cfg(feature = "std")]
extern crate std;

pub mod canopen;
pub mod check;
#[cfg(feature = "std")]
pub mod clock;
#[cfg(feature = "std")]
pub mod daq;
#[cfg(feature = "std")]
pub mod drive;
#[cfg(feature = "std")]
pub mod emulator;
pub mod wire;
