//! Detectors, action ladder, supervisor and stop trajectories.
