#![no_main]
//! Any frames on the CAN bus, to every decoder and to both sides of the SDO channel.

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| firmware_bridge::check::can_frames(bytes));
