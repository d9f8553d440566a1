//! The real-time control step, its thread, its clock and its timing report.
