//! The operator's link, where one is configured: signs of life keep the sweep going, their absence stops it, and neither
//! their return nor anything else but reset, arm and start lets the table move again. On the control step, at the desk, and
//! with the processes of a lab.

use crate::bench::{Bench, setup};
use serde_json::Value;
use shaketable::config::Case;
use shaketable::control::session::Pace;
use shaketable::control::setup::{Setup, model_of_case};
use shaketable::control::{Ending, Event, Request};
use shaketable::daemon::desk::{Desk, DeskError, Options};
use shaketable::daemon::state::State as DeskState;
use shaketable::daemon::work::Work;
use shaketable::rig::RigSpec;
use shaketable::rig::simulated::Fault;
use shaketable::safety::{Begin, DetectorId, SafetySpec, State};
use shaketable::sweep::SweepSpec;
use std::io::{BufRead, BufReader};
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::sync::Arc;
use std::time::{Duration, Instant};

const RATE: u64 = 2048;

/// The built-in file with a link that may be silent for so long, s.
fn linked(silence_s: f64) -> SafetySpec {
    let mut spec = SafetySpec::built_in().expect("valid");
    spec.supervision.operator_link = true;
    (spec.operator_link.warn, spec.operator_link.trip) = (Some(0.5 * silence_s), silence_s);
    spec
}

fn bench(begin: Begin) -> Bench {
    let sweep = SweepSpec::paper().restricted(1.0, 1.2).expect("in range");
    let setup = setup("B2-G2-0.05", RigSpec::default(), sweep, 3);
    let setup = Setup { safety: Some(linked(3.0)), ..setup };
    Bench::new(&setup, |_| {}, |guard| guard.beginning(begin))
}

/// Steps for so long, with a sign of life each half second if wanted.
fn pass(bench: &mut Bench, periods: u64, alive: bool) -> Option<Ending> {
    for k in 0..periods {
        if alive && k % (RATE / 2) == 0 {
            bench.operator.ask(Request::Alive).expect("room");
        }
        let ending = bench.step();
        if ending.is_some() {
            return ending;
        }
    }
    None
}

fn ask(bench: &mut Bench, request: Request) {
    bench.operator.ask(request).expect("room");
    bench.step();
}

// SR-18
#[test]
fn a_silent_link_stops_the_sweep_after_its_time_and_its_return_starts_nothing() {
    let mut bench = bench(Begin::OnRequest);
    pass(&mut bench, 400, true);
    for request in [Request::Reset, Request::Arm, Request::Start] {
        ask(&mut bench, request);
    }
    assert_eq!(pass(&mut bench, 10 * RATE, true), None);
    assert_eq!((bench.controller.state(), bench.controller.cause()), (Some(State::Running), None));
    // Other requests are no sign of life: the link is told from a page that somebody left open.
    ask(&mut bench, Request::Alive);
    let last = bench.cycle;
    ask(&mut bench, Request::Hold);
    ask(&mut bench, Request::Resume);
    while bench.controller.cause().is_none() {
        assert!(bench.cycle < last + 4 * RATE, "never stopped");
        bench.step();
    }
    assert_eq!(bench.controller.cause(), Some(DetectorId::OperatorLink));
    assert_eq!(bench.cycle - last, 3 * RATE, "periods from the last sign to the decision");
    assert_eq!(bench.controller.state(), Some(State::Aborting));
    pass(&mut bench, 6 * RATE, true);
    assert_eq!(bench.controller.state(), Some(State::Aborted), "signs of life do not start anything");
    bench.drain();
    let alive = |event: &&Event| matches!(event, Event::Obeyed { request: Request::Alive, .. });
    assert_eq!(bench.events.iter().filter(alive).count(), 0, "they are no events");
}

// SR-18
#[test]
fn a_latched_link_is_reset_only_while_it_is_heard() {
    let mut bench = bench(Begin::OnRequest);
    pass(&mut bench, 3 * RATE + 400, false);
    assert_eq!(bench.controller.state(), Some(State::Faulted));
    assert_eq!(bench.controller.cause(), Some(DetectorId::OperatorLink));
    ask(&mut bench, Request::Reset);
    assert_eq!(bench.controller.state(), Some(State::Faulted), "still silent");
    ask(&mut bench, Request::Alive);
    bench.step();
    ask(&mut bench, Request::Reset);
    assert_eq!((bench.controller.state(), bench.controller.cause()), (Some(State::Idle), None));
    for request in [Request::Arm, Request::Start] {
        ask(&mut bench, request);
    }
    assert_eq!(bench.controller.state(), Some(State::Running));
}

// SR-02
#[test]
fn a_fault_after_the_end_of_the_sweep_still_latches() {
    let mut bench = bench(Begin::AtOnce);
    let mut ending = None;
    while bench.controller.state() != Some(State::Idle) || bench.cycle < RATE {
        ending = pass(&mut bench, RATE / 8, true);
        assert_eq!(ending, None, "in the middle of the sweep");
    }
    bench.faults.set(Fault::DriveTrip, true);
    while ending.is_none() {
        ending = pass(&mut bench, RATE / 8, true);
    }
    assert_eq!(ending, Some(Ending::Aborted));
    assert_eq!(bench.controller.cause(), Some(DetectorId::DeviceStatus));
}

fn desk(out: &Path, safety: SafetySpec) -> Arc<Desk> {
    let case: Case = "B1-G2-0.05".parse().expect("a case");
    let sweep = SweepSpec::paper().restricted(1.0, 2.0).expect("in range");
    let work = Work::new(Some(case), sweep, model_of_case(&case), None);
    let (out, rig) = (out.to_owned(), RigSpec::default());
    Desk::new(Options { out, rig, work, seed: 1, pace: Pace::Virtual, safety })
}

async fn ended(desk: &Desk) {
    let mut changes = desk.changes();
    while desk.state().is_live() {
        changes.changed().await.expect("the desk is there");
    }
}

fn armed(desk: &Desk) -> Result<(), DeskError> {
    let checked = desk.preflight("test").expect("checks");
    assert!(checked.passed, "{:?}", checked.lines);
    desk.arm("test", checked.id)
}

fn interlock(desk: &Desk, name: &str) -> Option<bool> {
    desk.status().interlocks.iter().find(|link| link.name == name).map(|link| link.ok)
}

// SR-18
#[tokio::test]
async fn the_desk_arms_and_resets_nothing_while_the_link_is_silent() {
    let out = tempfile::tempdir().expect("a folder");
    let desk = desk(out.path(), linked(0.4));
    assert!(matches!(armed(&desk), Err(DeskError::Silent(_))), "never heard of");
    assert_eq!(interlock(&desk, "operator's link"), Some(false));
    let heard = desk.alive("test");
    assert!(heard.watched && heard.silence_s == 0.4, "{heard:?}");
    armed(&desk).expect("heard");
    desk.alive("test");
    // Virtual time outruns every sign of life: the run is stopped for the lack of them.
    desk.start("test").await.expect("started");
    ended(&desk).await;
    assert_eq!(desk.state(), DeskState::Aborted);
    let cause = desk.status().cause.expect("a cause").detector;
    assert_eq!(cause, DetectorId::OperatorLink.name());
    while interlock(&desk, "operator's link") != Some(false) {
        tokio::time::sleep(Duration::from_millis(20)).await;
    }
    assert!(matches!(desk.reset("test", &cause), Err(DeskError::Silent(_))), "still silent");
    assert!(matches!(desk.start("test").await, Err(DeskError::NotNow(_))), "aborted");
    desk.alive("test");
    assert_eq!(desk.state(), DeskState::Aborted, "a sign of life is no reset");
    desk.reset("test", &cause).expect("heard again");
    assert_eq!(desk.state(), DeskState::Idle);
}

// SR-03
#[tokio::test]
async fn without_a_configured_link_nobody_is_waited_for() {
    let out = tempfile::tempdir().expect("a folder");
    let desk = desk(out.path(), SafetySpec::built_in().expect("valid"));
    assert_eq!(interlock(&desk, "operator's link"), None);
    armed(&desk).expect("nothing is asked of a link");
    desk.start("test").await.expect("started");
    ended(&desk).await;
    assert_eq!(desk.state(), DeskState::Stopped);
    assert!(!desk.alive("test").watched);
}

/// A process that is killed when the test ends.
struct Process(Child);

impl Drop for Process {
    fn drop(&mut self) {
        // It may have ended by itself.
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

fn shaketable(args: &[&str]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_shaketable"));
    command.args(args).stderr(Stdio::null());
    command
}

/// A daemon whose safety file asks for a link; its address.
fn serve(out: &Path) -> (Process, String) {
    let file = out.join("safety.toml");
    std::fs::write(&file, toml::to_string(&linked(1.0)).expect("TOML")).expect("written");
    let (file, runs) = (file.to_str().expect("a path"), out.join("runs"));
    let runs = runs.to_str().expect("a path");
    let mut daemon = shaketable(&["serve", "--listen", "127.0.0.1:0", "--safety", file, "--out", runs])
        .stdout(Stdio::piped())
        .spawn()
        .expect("the daemon");
    let mut address = String::new();
    let stdout = daemon.stdout.take().expect("a pipe");
    BufReader::new(stdout).read_line(&mut address).expect("an address");
    (Process(daemon), address.trim().to_owned())
}

fn answer(args: &[&str], url: &str) -> (bool, String) {
    let output = shaketable(args).args(["--url", url, "--json"]).output().expect("the binary runs");
    (output.status.success(), String::from_utf8_lossy(&output.stdout).into_owned())
}

fn status(url: &str) -> Value {
    serde_json::from_str(&answer(&["status"], url).1).expect("JSON")
}

/// The status once it is as wanted, at most 30 s from now.
fn status_when(url: &str, wanted: impl Fn(&Value) -> bool) -> Value {
    let deadline = Instant::now() + Duration::from_secs(30);
    loop {
        let now = status(url);
        if wanted(&now) || Instant::now() > deadline {
            return now;
        }
        std::thread::sleep(Duration::from_millis(50));
    }
}

// SR-18
#[test]
fn the_death_of_the_heartbeat_process_stops_a_run_of_the_daemon() {
    // A machine that stands still for longer than control or samples may is no witness here; it gets two more chances.
    for _ in 0..3 {
        let out = tempfile::tempdir().expect("a folder");
        let (_daemon, url) = serve(out.path());
        assert!(!answer(&["start", "--confirm"], &url).0, "nobody watches over the table yet");
        let beat = ["watch", "--heartbeat", "--url", &url];
        let mut heartbeat = Process(shaketable(&beat).spawn().expect("the link"));
        let there = |status: &Value| {
            let links = status["interlocks"].as_array().expect("a chain");
            links.iter().any(|link| link["name"] == "operator's link" && link["ok"] == true)
        };
        assert!(there(&status_when(&url, there)), "the link is not heard");
        assert!(answer(&["start", "--confirm"], &url).0, "started");
        let moves = |status: &Value| status["run"]["elapsed_s"].as_f64().is_some_and(|s| s > 3.0);
        let before = status_when(&url, |status| moves(status) || status["state"] == "aborted");
        if before["state"] == "aborted" {
            assert_ne!(before["cause"]["detector"], "operator-link", "it was fed all the time");
            continue;
        }
        heartbeat.0.kill().expect("killed");
        let after = status_when(&url, |status| status["state"] == "aborted");
        if after["cause"]["detector"] != "operator-link" {
            let cause = &after["cause"]["detector"];
            assert!(cause == "control-slips" || cause == "stale-sample", "{after}");
            continue;
        }
        assert_eq!(after["ended"]["outcome"], "aborted");
        assert!(!answer(&["start", "--confirm"], &url).0, "latched");
        return;
    }
    println!("this machine stood still in each of three runs: the link's end was not judged");
}
