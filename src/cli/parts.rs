//! The parts of a diagnosis as they end: a bench times them, an operator is shown that it goes on.

use crate::diagnose::parts::TARGET;
use indicatif::{ProgressBar, ProgressStyle};
use std::sync::mpsc::{Receiver, RecvTimeoutError, channel};
use std::time::{Duration, Instant};
use tracing::field::{Field, Visit};
use tracing::subscriber::with_default;
use tracing::{Event, Subscriber};
use tracing_subscriber::layer::{Context, Layer, SubscriberExt as _};

/// How often the time that has passed is drawn anew.
const REDRAWN: Duration = Duration::from_millis(200);

/// What has been found so far is told from then on: a quick answer needs no news.
const LONG: Duration = Duration::from_secs(20);

/// What a diagnosis tells of itself.
#[derive(Clone, Debug, PartialEq)]
pub enum News {
    /// A part of this name has ended.
    Done(String),
    /// What has been found until now.
    SoFar(String),
}

/// Hands on each of them.
struct Listener<F>(F);

impl<S: Subscriber, F: Fn(News) + 'static> Layer<S> for Listener<F> {
    fn on_event(&self, event: &Event<'_>, _context: Context<'_, S>) {
        if event.metadata().target() == TARGET {
            let mut told = Told(None);
            event.record(&mut told);
            told.0.into_iter().for_each(&self.0);
        }
    }
}

/// What an event tells.
struct Told(Option<News>);

impl Visit for Told {
    fn record_str(&mut self, field: &Field, value: &str) {
        self.0 = match field.name() {
            "part" => Some(News::Done(value.to_owned())),
            "so_far" => Some(News::SoFar(value.to_owned())),
            _ => None,
        };
    }

    fn record_debug(&mut self, _field: &Field, _value: &dyn std::fmt::Debug) {}
}

/// Does what diagnoses; each part of it that has ended is told, and what has been found so far.
pub fn told<T>(each: impl Fn(News) + Send + Sync + 'static, diagnose: impl FnOnce() -> T) -> T {
    with_default(tracing_subscriber::registry().with(Listener(each)), diagnose)
}

/// The same with a line on the terminal, where there is one, that says for how long it has gone on and what has been done last; of one that takes
/// long also what has been found so far, on the error output: whoever does not wait for the end has that.
pub fn shown<T>(diagnose: impl FnOnce() -> T) -> T {
    let bar = ProgressBar::new_spinner();
    if let Ok(style) = ProgressStyle::with_template("{spinner} diagnosing for {elapsed_precise}  {msg}") {
        bar.set_style(style);
    }
    bar.enable_steady_tick(REDRAWN);
    let (tell, heard) = channel();
    let end = tell.clone();
    let (line, begun) = (bar.clone(), Instant::now());
    let beside_it = bar.clone();
    let show = move |text: String| beside_it.suspend(|| eprintln!("{text}"));
    let shows = std::thread::spawn(move || show_when_long(&heard, begun, show));
    let news = move |news| match news {
        News::Done(part) => line.set_message(format!("done: {part}")),
        News::SoFar(found) => {
            // Whoever shows it has not ended before this does.
            let _ = tell.send(Some(format!("after {:.0} s: {found}", begun.elapsed().as_secs_f64())));
        }
    };
    let out = told(news, diagnose);
    let _ = end.send(None);
    let _ = shows.join();
    bar.finish_and_clear();
    out
}

/// Shows what is heard until there is no more: what comes before it has taken long then, nothing of what ends sooner.
fn show_when_long(heard: &Receiver<Option<String>>, begun: Instant, show: impl Fn(String)) {
    let (mut early, mut goes_on) = (Vec::new(), true);
    while goes_on {
        match heard.recv_timeout(LONG.saturating_sub(begun.elapsed())) {
            Ok(Some(text)) => early.push(text),
            Err(RecvTimeoutError::Timeout) => break,
            Ok(None) | Err(RecvTimeoutError::Disconnected) => goes_on = false,
        }
    }
    if begun.elapsed() < LONG {
        return;
    }
    early.into_iter().for_each(&show);
    if goes_on {
        heard.iter().map_while(|text| text).for_each(show);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::diagnose::parts;
    use std::sync::{Arc, Mutex};

    #[test]
    fn what_takes_long_is_told_from_its_beginning_and_what_is_quick_not_at_all() {
        let shown = |heard: &Receiver<Option<String>>, begun| {
            let lines = Mutex::new(Vec::new());
            show_when_long(heard, begun, |text| lines.lock().expect("alone").push(text));
            lines.into_inner().expect("alone")
        };
        let (tell, heard) = channel();
        let say = |text: Option<&str>| tell.send(text.map(str::to_owned)).expect("heard");
        say(Some("quick"));
        say(None);
        assert!(shown(&heard, Instant::now()).is_empty());
        // Begun so long ago that it has taken long already.
        let long_ago = Instant::now().checked_sub(2 * LONG).expect("the machine has run for that long");
        for text in [Some("first"), Some("second"), None] {
            say(text);
        }
        assert_eq!(shown(&heard, long_ago), ["first", "second"]);
    }

    #[test]
    fn every_part_is_told_in_its_order_and_nothing_else() {
        let heard = Arc::new(Mutex::new(Vec::new()));
        let hears = Arc::clone(&heard);
        let out = told(
            move |news| hears.lock().expect("alone").push(news),
            || {
                parts::done("first");
                tracing::info!(part = "of something else");
                parts::so_far("something");
                parts::done("second");
                3
            },
        );
        let [first, found, second] = ["first", "something", "second"].map(str::to_owned);
        let all = [News::Done(first), News::SoFar(found), News::Done(second)];
        assert_eq!((out, heard.lock().expect("alone").as_slice()), (3, &all[..]));
    }
}
