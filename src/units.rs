//! Constants and conversions between SI and what operators read (g, mm, kN/m).

/// Standard gravity in m/s2 (CGPM 1901); one "g" of an acceleration given in g.
pub const STANDARD_GRAVITY_M_S2: f64 = 9.806_65;

/// Sampling and control rate of the rig in Hz.
pub const SAMPLE_RATE_HZ: f64 = 2048.0;
