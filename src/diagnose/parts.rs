//! The parts of a diagnosis, told as each of them ends to whoever listens: a bench adds up how long they take. What is done before the
//! first of them, and between two, belongs to the one that ends next.

/// Target of the events; their field `part` is the name, or `so_far` what has been found until now.
pub const TARGET: &str = "shaketable::diagnose::parts";

/// Tells that a part has ended.
pub(crate) fn done(part: &'static str) {
    tracing::debug!(target: TARGET, part);
}

/// Tells what has been found so far: a diagnosis may take minutes.
pub(crate) fn so_far(found: &str) {
    tracing::debug!(target: TARGET, so_far = found);
}
