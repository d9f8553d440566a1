//! The lines of the runs' `events.jsonl` as numbered messages. The files on the disk are the queue: what a server has not
//! confirmed is read again after the connection was lost, however long that took, and memory holds no more than what is
//! under way. Used by the publisher alone, on a worker thread, as a disk may stall.

use serde::{Deserialize, Serialize};
use serde_json::value::RawValue;
use std::collections::VecDeque;
use std::fs::File;
use std::io;
use std::os::unix::fs::FileExt;
use std::path::{Path, PathBuf};

/// Longest line that is published, bytes: half of what a server takes by default.
const LONGEST: usize = 512 << 10;
/// Bytes that are read at once where lines are not longer.
const BLOCK: usize = 64 << 10;
/// Runs that may wait; the oldest one is given up for the next.
const MOST_RUNS: usize = 64;

/// What a message is about.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Topic {
    /// A line of `events.jsonl`; its number is that of the line, from 0.
    Events,
    /// A finished step; its number is that of its line in `steps.csv`, from 0 without the head.
    Steps,
}

impl Topic {
    /// Last word of the subject.
    pub fn word(self) -> &'static str {
        match self {
            Self::Events => "events",
            Self::Steps => "steps",
        }
    }
}

/// One message.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Message {
    /// What it is about.
    pub topic: Topic,
    /// The same for the same message however often it is sent, and for no other.
    pub id: String,
    /// JSON.
    pub payload: String,
}

/// What a message says; `event` and `step` are the line as it stands in the file.
#[derive(Serialize)]
struct Told<'a> {
    table: &'a str,
    run: &'a str,
    number: u64,
    #[serde(skip_serializing_if = "Option::is_none")]
    event: Option<&'a RawValue>,
    #[serde(skip_serializing_if = "Option::is_none")]
    step: Option<&'a RawValue>,
}

#[derive(Deserialize)]
struct Line<'a> {
    #[serde(borrow)]
    event: std::borrow::Cow<'a, str>,
}

/// A place in the file of one run.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
struct Place {
    offset: u64,
    line: u64,
    step: u64,
    /// Inside a line that is too long.
    skipping: bool,
}

/// One run that is followed.
struct Run {
    events: PathBuf,
    /// Folder name.
    name: String,
    /// Told apart from a run that was given up.
    serial: u64,
    file: Option<File>,
    next: Place,
    confirmed: Place,
    /// Closed, and read to its end.
    ended: bool,
}

/// What has not been confirmed yet.
pub struct Lines {
    table: String,
    runs: VecDeque<Run>,
    serials: u64,
    /// Messages handed out since the connection was made, and after how many of them which place is reached.
    handed: u64,
    confirmed: u64,
    marks: VecDeque<(u64, u64, Place)>,
    /// Lines that cannot be published.
    lost_lines: u64,
    /// Runs that were given up, at least in part.
    lost_runs: u64,
    waiting: u64,
}

impl Lines {
    /// Nothing to tell yet, by a table of this name.
    pub fn new(table: &str) -> Self {
        Self {
            table: table.to_owned(),
            runs: VecDeque::new(),
            serials: 0,
            handed: 0,
            confirmed: 0,
            marks: VecDeque::new(),
            lost_lines: 0,
            lost_runs: 0,
            waiting: 0,
        }
    }

    /// Follows one more run from its first line on.
    pub fn add(&mut self, events: PathBuf) {
        if self.runs.len() == MOST_RUNS {
            self.runs.pop_front();
            self.lost_runs += 1;
        }
        let folder = events.parent().and_then(Path::file_name);
        let name = folder.map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
        self.serials += 1;
        let (next, confirmed) = (Place::default(), Place::default());
        let serial = self.serials;
        self.runs.push_back(Run { events, name, serial, file: None, next, confirmed, ended: false });
    }

    /// Hands out up to `room` messages, lines with both of theirs; `is_open` tells whether lines may still be added to a file.
    /// A run whose file cannot be read is given up and named in the second answer.
    pub fn take(&mut self, room: usize, is_open: impl Fn(&Path) -> bool) -> (Vec<Message>, Option<String>) {
        let (mut messages, mut failed) = (Vec::new(), None);
        let mut at = 0;
        while at < self.runs.len() && messages.len() + 1 < room {
            // Asked first: what was written before the file was closed is then read below.
            let open = is_open(&self.runs[at].events);
            match self.read(at, room, &mut messages) {
                Ok(true) => continue,
                Ok(false) if open => break,
                Ok(false) => {
                    self.runs[at].ended = messages.len() + 1 < room;
                    at += 1;
                }
                Err(error) => {
                    failed = Some(format!("{}: {error}", self.runs[at].events.display()));
                    self.runs.remove(at);
                    self.lost_runs += 1;
                }
            }
        }
        self.runs.retain(|run| !run.ended || run.confirmed.line != run.next.line);
        (messages, failed)
    }

    /// Hands out the lines of one block; true when there may be more.
    fn read(&mut self, at: usize, room: usize, messages: &mut Vec<Message>) -> io::Result<bool> {
        let run = &mut self.runs[at];
        let block = run.block()?;
        let mut rest = block.as_slice();
        while messages.len() + 1 < room {
            let Some(end) = rest.iter().position(|byte| *byte == b'\n') else {
                if rest.len() < block.len() || block.is_empty() {
                    return Ok(block.len() >= BLOCK);
                }
                let endless = block.len() >= LONGEST || run.next.skipping;
                if endless {
                    run.next.offset += block.len() as u64;
                    run.next.skipping = true;
                }
                return Ok(endless);
            };
            let (line, after) = rest.split_at(end);
            rest = &after[1..];
            run.next.offset += end as u64 + 1;
            let told = if std::mem::take(&mut run.next.skipping) {
                None
            } else {
                tell(&self.table, &run.name, run.next, line)
            };
            run.next.line += 1;
            match told {
                None => self.lost_lines += 1,
                Some((event, step)) => {
                    self.handed += 1 + u64::from(step.is_some());
                    run.next.step += u64::from(step.is_some());
                    messages.push(event);
                    messages.extend(step);
                }
            }
            self.marks.push_back((self.handed, run.serial, run.next));
        }
        Ok(false)
    }

    /// All of the first `count` messages since the connection was made have arrived.
    pub fn confirm(&mut self, count: u64) {
        self.confirmed = count;
        while let Some((_, serial, place)) = self.marks.front().copied().filter(|mark| mark.0 <= count) {
            self.marks.pop_front();
            if let Some(run) = self.runs.iter_mut().find(|run| run.serial == serial) {
                run.confirmed = place;
            }
        }
    }

    /// The connection was lost: whatever has not been confirmed is handed out again. Returns how many messages that are.
    pub fn rewind(&mut self) -> u64 {
        for run in &mut self.runs {
            (run.next, run.ended) = (run.confirmed, false);
        }
        self.marks.clear();
        let again = self.handed.saturating_sub(self.confirmed);
        (self.handed, self.confirmed) = (0, 0);
        again
    }

    /// A message that was handed out cannot be sent at all.
    pub fn refused(&mut self) {
        self.lost_lines += 1;
    }

    /// Nothing is told any more, and all of it is confirmed.
    pub fn is_empty(&self) -> bool {
        self.runs.is_empty()
    }

    /// Looks how many bytes wait.
    pub fn measure(&mut self) {
        self.waiting = self.runs.iter().map(|run| run.length().saturating_sub(run.confirmed.offset)).sum();
    }

    /// Bytes that were not confirmed when they were measured; lines and runs that were given up.
    pub fn waiting(&self) -> (u64, u64, u64) {
        (self.waiting, self.lost_lines, self.lost_runs)
    }
}

impl Run {
    /// The next bytes of the file: as many as hold a whole line, unless it is too long.
    fn block(&mut self) -> io::Result<Vec<u8>> {
        let file = match &mut self.file {
            Some(file) => file,
            none => none.insert(File::open(&self.events)?),
        };
        let mut size = BLOCK;
        loop {
            let mut block = vec![0; size];
            let mut read = 0;
            while read < size {
                match file.read_at(&mut block[read..], self.next.offset + read as u64) {
                    Ok(0) => break,
                    Ok(n) => read += n,
                    Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
                    Err(error) => return Err(error),
                }
            }
            block.truncate(read);
            if read < size || size >= LONGEST || block.contains(&b'\n') {
                return Ok(block);
            }
            size = LONGEST;
        }
    }

    fn length(&self) -> u64 {
        match &self.file {
            Some(file) => file.metadata(),
            None => std::fs::metadata(&self.events),
        }
        .map_or(0, |metadata| metadata.len())
    }
}

/// The messages of a line; `None` for one that is no event.
fn tell(table: &str, run: &str, at: Place, line: &[u8]) -> Option<(Message, Option<Message>)> {
    let text = std::str::from_utf8(line).ok()?;
    let raw: &RawValue = serde_json::from_str(text).ok()?;
    let message = |topic: Topic, number, event, step| {
        let payload = serde_json::to_string(&Told { table, run, number, event, step }).ok()?;
        Some(Message { topic, id: format!("{table}.{run}.{}.{number}", topic.word()), payload })
    };
    let event = message(Topic::Events, at.line, Some(raw), None)?;
    let is_step = serde_json::from_str::<Line<'_>>(text).is_ok_and(|line| line.event == "step");
    let step = if is_step { message(Topic::Steps, at.step, None, Some(raw)) } else { None };
    Some((event, step))
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::{Value, json};
    use std::io::Write;

    struct Written {
        folder: tempfile::TempDir,
    }

    impl Written {
        fn new() -> Self {
            Self { folder: tempfile::tempdir().expect("folder") }
        }

        fn events(&self, run: &str) -> PathBuf {
            let folder = self.folder.path().join(run);
            std::fs::create_dir_all(&folder).expect("made");
            folder.join("events.jsonl")
        }

        fn append(&self, run: &str, text: &str) {
            let mut options = std::fs::OpenOptions::new();
            let mut file = options.create(true).append(true).open(self.events(run)).expect("opened");
            file.write_all(text.as_bytes()).expect("written");
        }
    }

    fn slips(from: u64, to: u64) -> String {
        (from..to).map(|n| format!("{{\"event\":\"slip\",\"cycle\":{n}}}\n")).collect()
    }

    fn numbers(messages: &[Message], topic: Topic) -> Vec<u64> {
        let of = |message: &Message| {
            let told: Value = serde_json::from_str(&message.payload).expect("JSON");
            assert_eq!(told["table"], "east");
            told["number"].as_u64().expect("number")
        };
        messages.iter().filter(|message| message.topic == topic).map(of).collect()
    }

    #[test]
    fn lines_become_events_and_steps_with_numbers_of_their_own() {
        let written = Written::new();
        written.append("night", "{\"event\":\"slip\",\"cycle\":3}\n{\"event\":\"step\",\"index\":0}\n");
        written.append("night", "{\"event\":\"step\",\"index\":1}\n{\"event\":\"end\"");
        let mut lines = Lines::new("east");
        lines.add(written.events("night"));
        let (messages, failed) = lines.take(100, |_| true);
        assert_eq!(failed, None);
        assert_eq!(numbers(&messages, Topic::Events), [0, 1, 2]);
        assert_eq!(numbers(&messages, Topic::Steps), [0, 1]);
        let last: Value = serde_json::from_str(&messages[4].payload).expect("JSON");
        let step = json!({ "event": "step", "index": 1 });
        assert_eq!(last, json!({ "table": "east", "run": "night", "number": 1, "step": step }));
        assert_eq!(messages[4].id, "east.night.steps.1");
        // A line that is not whole yet is not told before it is.
        written.append("night", ",\"cycle\":9}\n");
        let (messages, _) = lines.take(100, |_| true);
        assert_eq!(numbers(&messages, Topic::Events), [3]);
    }

    #[test]
    fn what_was_not_confirmed_comes_again_and_nothing_else() {
        let written = Written::new();
        let mut lines = Lines::new("east");
        lines.add(written.events("night"));
        written.append("night", &slips(0, 10));
        assert_eq!(lines.take(7, |_| true).0.len(), 6, "room is left for the second message of a step");
        lines.confirm(4);
        assert_eq!(lines.rewind(), 2);
        let (messages, _) = lines.take(100, |_| true);
        assert_eq!(numbers(&messages, Topic::Events), (4..10).collect::<Vec<_>>());
        lines.measure();
        assert_eq!(lines.waiting().0, slips(4, 10).len() as u64);
        lines.confirm(6);
        lines.measure();
        assert_eq!((lines.waiting(), lines.rewind()), ((0, 0, 0), 0));
        assert!(lines.take(100, |_| true).0.is_empty());
        written.append("night", &slips(10, 11));
        assert_eq!(numbers(&lines.take(100, |_| true).0, Topic::Events), [10]);
    }

    #[test]
    fn runs_follow_each_other_and_are_let_go_once_confirmed() {
        let written = Written::new();
        let mut lines = Lines::new("east");
        for run in ["first", "second"] {
            written.append(run, &slips(0, 2));
            lines.add(written.events(run));
        }
        // The second waits while lines may still be added to the first.
        let first = written.events("first");
        assert_eq!(lines.take(100, |path| path == first).0.len(), 2);
        let (messages, _) = lines.take(100, |_| false);
        assert_eq!(
            messages.iter().map(|m| m.id.as_str()).collect::<Vec<_>>(),
            ["east.second.events.0", "east.second.events.1"]
        );
        lines.confirm(4);
        assert!(lines.take(100, |_| false).0.is_empty());
        assert!(lines.runs.is_empty(), "both are told");
        for n in 0..=MOST_RUNS {
            lines.add(written.events(&format!("run-{n}")));
        }
        assert_eq!((lines.runs.len(), lines.waiting().2), (MOST_RUNS, 1));
    }

    #[test]
    fn what_cannot_be_told_is_counted_and_leaves_a_gap() {
        let written = Written::new();
        let mut lines = Lines::new("east");
        lines.add(written.events("night"));
        written.append("night", &slips(0, 1));
        written.append("night", "no JSON\n");
        written
            .append("night", &format!("{{\"event\":\"long\",\"text\":\"{}\"}}\n", "x".repeat(3 * LONGEST)));
        // Longer than a block, and told all the same.
        written.append("night", &format!("{{\"event\":\"note\",\"text\":\"{}\"}}\n", "x".repeat(2 * BLOCK)));
        let mut messages = Vec::new();
        for _ in 0..4 {
            messages.extend(lines.take(100, |_| true).0);
        }
        assert_eq!(numbers(&messages, Topic::Events), [0, 3]);
        assert_eq!(lines.waiting().1, 2);
        lines.add(written.folder.path().join("gone/events.jsonl"));
        let (_, failed) = lines.take(100, |_| false);
        assert!(failed.expect("named").contains("gone"));
        assert_eq!(lines.waiting().2, 1);
    }
}
