//! Causal, per-sample signal processing: band-pass, averages, steady-state peaks, demodulation.
