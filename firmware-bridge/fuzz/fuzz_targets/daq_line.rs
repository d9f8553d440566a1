#![no_main]
//! Any bytes on the DAQ line.

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| firmware_bridge::check::daq_line(bytes));
