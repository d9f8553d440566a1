//! The parts of a diagnosis as they end: a bench times them, an operator is shown that it goes on.

use crate::diagnose::parts::TARGET;
use indicatif::{ProgressBar, ProgressStyle};
use std::time::Duration;
use tracing::field::{Field, Visit};
use tracing::subscriber::with_default;
use tracing::{Event, Subscriber};
use tracing_subscriber::layer::{Context, Layer, SubscriberExt as _};

/// How often the time that has passed is drawn anew.
const REDRAWN: Duration = Duration::from_millis(200);

/// Hands on the name of each part that has ended.
struct Listener<F>(F);

impl<S: Subscriber, F: Fn(String) + 'static> Layer<S> for Listener<F> {
    fn on_event(&self, event: &Event<'_>, _context: Context<'_, S>) {
        if event.metadata().target() == TARGET {
            let mut part = Part(String::new());
            event.record(&mut part);
            self.0(part.0);
        }
    }
}

/// Name of the part that an event tells of.
struct Part(String);

impl Visit for Part {
    fn record_str(&mut self, _field: &Field, value: &str) {
        value.clone_into(&mut self.0);
    }

    fn record_debug(&mut self, _field: &Field, _value: &dyn std::fmt::Debug) {}
}

/// Does what diagnoses; each part of it that has ended is told.
pub fn told<T>(each: impl Fn(String) + Send + Sync + 'static, diagnose: impl FnOnce() -> T) -> T {
    with_default(tracing_subscriber::registry().with(Listener(each)), diagnose)
}

/// The same with a line on the terminal, where there is one, that says for how long it has gone on and what has been done last.
pub fn shown<T>(diagnose: impl FnOnce() -> T) -> T {
    let bar = ProgressBar::new_spinner();
    if let Ok(style) = ProgressStyle::with_template("{spinner} diagnosing for {elapsed_precise}  {msg}") {
        bar.set_style(style);
    }
    bar.enable_steady_tick(REDRAWN);
    let line = bar.clone();
    let out = told(move |part| line.set_message(format!("done: {part}")), diagnose);
    bar.finish_and_clear();
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::diagnose::parts;
    use std::sync::{Arc, Mutex};

    #[test]
    fn every_part_is_told_in_its_order_and_nothing_else() {
        let parts = Arc::new(Mutex::new(Vec::new()));
        let heard = Arc::clone(&parts);
        let out = told(
            move |part| heard.lock().expect("alone").push(part),
            || {
                parts::done("first");
                tracing::info!(part = "of something else");
                parts::done("second");
                3
            },
        );
        assert_eq!(
            (out, parts.lock().expect("alone").as_slice()),
            (3, &["first".to_owned(), "second".to_owned()][..])
        );
    }
}
