//! Fitting a model's parameters to records, with intervals.
