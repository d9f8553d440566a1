//! The drive link and the drive emulator on a real CAN socket, against a peer that shares no code with them: a node and a
//! master on the Python packages `canopen` and `python-can`.
//!
//! These tests need a CAN interface and are run by `hil-tests/uml/run`, in a guest whose clock does not count what the machine
//! does meanwhile: nothing here is excused by a busy one.

use firmware_bridge::canopen::cia402::State;
use firmware_bridge::clock::HostClock;
use firmware_bridge::drive::{
    CanBus, DriveFault, DriveSettings, DriveStream, ExpectedDrive, Phase, TimedCommand, Units, Wish, prepare,
};
use firmware_bridge::emulator::{DaqNode, Demand, DriveSpec, Fault, Lab, LabSettings, Plant};
use serde_json::{Value, json};
use std::f64::consts::TAU;
use std::io::{BufRead, BufReader, Write};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

const UNITS: Units = Units { counts_per_m: 1e7, velocity_per_m_s: 1e6, torque_per_m_s2: 100.0 };
const NEEDS_CAN: &str = "set by hil-tests/uml/run";

fn interface() -> String {
    std::env::var("SHAKETABLE_CAN").expect(NEEDS_CAN)
}

fn bus() -> CanBus {
    CanBus::open(&interface()).expect("the interface")
}

/// A Python peer by the name of its script.
fn peer(script: &str, node: u8) -> Child {
    let python = std::env::var("PYTHON").expect(NEEDS_CAN);
    let peers = std::env::var("PEERS").expect(NEEDS_CAN);
    Command::new(python)
        .args([format!("{peers}/{script}"), interface(), node.to_string()])
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .spawn()
        .expect("the peer starts")
}

fn settings(node: u8, cycle_ms: u64) -> DriveSettings {
    DriveSettings {
        node,
        host_node: 126,
        expected: ExpectedDrive::default(),
        units: UNITS,
        cycle: Duration::from_millis(cycle_ms),
        mode: 8,
        host_lost: Duration::from_millis(40),
        commands_lost: Duration::from_millis(35),
        sync_timeout: None,
        drive_heartbeat: Duration::from_millis(50),
        missed_cycles: 40,
        command_stale: Duration::from_millis(60),
        quick_stop_m_s2: 2.0,
        following_error_m: 0.02,
        speed_limit_m_s: 0.6,
        settings: Vec::new(),
    }
}

/// A table that is where it is asked to be.
struct Stiff;

impl Plant for Stiff {
    fn step(&mut self, demand: Demand) -> [f64; 5] {
        [demand.displacement_m, demand.acceleration_m_s2, 0.0, 0.0, 0.0]
    }
}

fn lab(node: u8, schedule: Vec<(f64, Fault)>) -> Lab {
    let settings = LabSettings {
        rate_hz: 2048.0,
        port_link: None,
        drive: DriveSpec { node, identity: [1, 2, 3, 4], name: "emulated servo drive".into(), units: UNITS },
        daq: DaqNode::new(1, 2, "KR-0001", 2048.0, 1),
        schedule,
        on_thread: None,
    };
    Lab::start(settings, bus(), Box::new(Stiff)).expect("a lab")
}

/// Waits for a condition, at most 10 s.
fn until(what: &str, mut condition: impl FnMut() -> bool) {
    let deadline = Instant::now() + Duration::from_secs(10);
    while !condition() {
        assert!(Instant::now() < deadline, "waited in vain until {what}");
        std::thread::sleep(Duration::from_micros(500));
    }
}

fn enabled(settings: DriveSettings, clock: HostClock) -> DriveStream {
    let drive = prepare(bus(), settings).expect("a drive").start(clock, None).expect("a thread");
    drive.wish(Wish::Enable);
    until("the drive is enabled", || drive.phase() == Phase::Enabled);
    drive
}

const AMPLITUDE_M: f64 = 0.005;
const FREQUENCY_HZ: f64 = 1.0;

/// Sends a sine that grows over its first second until `done`.
fn shake(drive: &mut DriveStream, clock: HostClock, mut done: impl FnMut(&DriveStream, f64) -> bool) {
    let start = clock.now_ns();
    let w = TAU * FREQUENCY_HZ;
    for n in 1_u64.. {
        let at_ns = start + n * 1_000_000_000 / 2048;
        clock.sleep_until(at_ns);
        let t = n as f64 / 2048.0;
        let grow = t.min(1.0) * AMPLITUDE_M;
        drive.command(TimedCommand {
            at_ns,
            displacement_m: grow * (w * t).sin(),
            velocity_m_s: grow * w * (w * t).cos(),
            acceleration_m_s2: -grow * w * w * (w * t).sin(),
        });
        if done(drive, t) {
            return;
        }
    }
}

fn number(value: &Value, key: &str) -> f64 {
    value[key].as_f64().expect("a number")
}

#[test]
#[ignore = "needs a CAN interface: hil-tests/uml/run"]
fn our_master_drives_the_independent_node() {
    let mut python = peer("node.py", 7);
    let mut lines = BufReader::new(python.stdout.take().expect("a pipe")).lines();
    assert_eq!(lines.next().expect("a line").expect("text"), "ready");
    let clock = HostClock::new();
    // The interpreter needs some milliseconds a cycle in the guest.
    let mut settings = settings(7, 10);
    settings.drive_heartbeat = Duration::from_millis(200);
    settings.expected = ExpectedDrive { vendor: Some(0xABCD), product: Some(0x402), serial: Some(99) };
    let ready = prepare(bus(), settings).expect("the node is configured");
    assert_eq!(ready.name, "independent python drive", "a segmented upload");
    let mut drive = ready.start(clock, None).expect("a thread");
    drive.wish(Wish::Enable);
    until("the node is enabled", || drive.phase() == Phase::Enabled);
    shake(&mut drive, clock, |drive, t| t > 3.25 || drive.fault().is_some());
    assert_eq!(drive.fault(), None);
    drive.wish(Wish::QuickStop);
    until("quick stop is seen", || drive.phase() == Phase::Stopping);
    drive.wish(Wish::Off);
    until("it is off", || drive.phase() == Phase::Off);
    drop(drive);
    python.stdin.take().expect("a pipe").write_all(b"end\n").expect("heard");
    let seen: Value = serde_json::from_str(&lines.next().expect("a line").expect("text")).expect("JSON");
    println!("{seen}");
    assert!(python.wait().expect("ended").success());
    let walk = [
        "SWITCH ON DISABLED",
        "READY TO SWITCH ON",
        "SWITCHED ON",
        "OPERATION ENABLED",
        "QUICK STOP ACTIVE",
        "SWITCH ON DISABLED",
    ];
    assert_eq!(seen["states"], json!(walk));
    let counts = AMPLITUDE_M * UNITS.counts_per_m;
    for (key, sign) in [("max_target", 1.0), ("min_target", -1.0)] {
        let reached = number(&seen, key);
        assert!((reached - sign * counts).abs() < 0.01 * counts, "{key} {reached}");
    }
    // No jump: over any two cycles the targets go no faster than twice the sine's steepest slope.
    let steepest = counts * TAU * FREQUENCY_HZ;
    let speed = number(&seen, "largest_speed");
    assert!(speed > 0.9 * steepest && speed < 2.0 * steepest, "{speed} counts/s beside {steepest}: {seen}");
    assert_eq!(seen["rpdo_deadline_ms"], 35);
    assert_eq!(seen["heartbeat_consumer"], 126 << 16 | 40);
    assert_eq!((&seen["abort_option"], &seen["mode"]), (&Value::from(3), &Value::from(8)));
    assert!(number(&seen, "host_heartbeats") > 150.0, "{seen}");
}

#[test]
#[ignore = "needs a CAN interface: hil-tests/uml/run"]
fn the_independent_master_drives_our_emulator() {
    let lab = lab(9, vec![]);
    let output = peer("master.py", 9).wait_with_output().expect("the peer ends");
    assert!(output.status.success(), "the peer failed");
    let result: Value = serde_json::from_slice(&output.stdout).expect("JSON");
    println!("{result}");
    assert_eq!(result["name"], "emulated servo drive");
    assert_eq!((&result["vendor"], &result["profile"]), (&Value::from(1), &Value::from(402)));
    let aborts = json!({"read-only": 0x0601_0002, "mode": 0x0609_0030, "missing": 0x0602_0000});
    assert_eq!(result["aborts"], aborts);
    assert_eq!(result["mapped"], json!([0x6064_0020, 0x607A_0020]));
    let walk = [
        "READY TO SWITCH ON",
        "SWITCHED ON",
        "OPERATION ENABLED",
        "QUICK STOP ACTIVE",
        "SWITCH ON DISABLED",
        "QUICK STOP ACTIVE",
    ];
    assert_eq!(result["states"], json!(walk));
    assert!((number(&result, "position") - 20_000.0).abs() < 20.0, "{result}");
    assert_eq!(result["emergencies_before"], json!([]), "it holds as long as the heartbeat comes");
    assert_eq!(result["emergencies"], json!([0x8130]), "the lost heartbeat is told");
    drop(lab);
}

#[test]
#[ignore = "needs a CAN interface: hil-tests/uml/run"]
fn our_master_drives_our_emulator_at_a_millisecond() {
    let lab = lab(5, vec![]);
    let clock = HostClock::new();
    let mut drive = enabled(settings(5, 1), clock);
    shake(&mut drive, clock, |drive, t| t > 10.0 || drive.fault().is_some());
    let counters = drive.counters();
    println!("{counters:?} {:?}", lab.report());
    assert_eq!((drive.fault(), counters.send_failures), (None, 0));
    assert!(counters.cycles + counters.skipped > 9_900, "{counters:?}");
}

#[test]
#[ignore = "needs a CAN interface: hil-tests/uml/run"]
fn bus_off_ends_in_quick_stop_and_the_next_run_connects_again() {
    let lab = lab(6, vec![(1.2, Fault::BusOff)]);
    let clock = HostClock::new();
    let mut drive = enabled(settings(6, 1), clock);
    shake(&mut drive, clock, |drive, _| drive.fault().is_some());
    assert_eq!(drive.fault(), Some(DriveFault::BusOff));
    until("the drive stops", || lab.report().drive == State::QuickStopActive);
    drop(drive);
    prepare(bus(), settings(6, 1)).expect("the next run connects again");
}

/// Name of the variable that makes this test binary the process that is killed.
const VICTIM: &str = "SHAKETABLE_VICTIM";

#[test]
#[ignore = "needs a CAN interface: hil-tests/uml/run"]
fn a_killed_host_leaves_the_drive_in_quick_stop_within_50_ms() {
    if std::env::var_os(VICTIM).is_some() {
        let clock = HostClock::new();
        let mut drive = enabled(settings(8, 1), clock);
        println!("moving");
        return shake(&mut drive, clock, |drive, _| drive.fault().is_some());
    }
    let mut measured = Vec::new();
    for _ in 0..5 {
        let lab = lab(8, vec![]);
        let mut victim = Command::new(std::env::current_exe().expect("this binary"))
            .args(["a_killed_host", "--ignored", "--nocapture"])
            .env(VICTIM, "yes")
            .stdout(Stdio::piped())
            .spawn()
            .expect("the victim starts");
        let lines = BufReader::new(victim.stdout.take().expect("a pipe")).lines();
        let moving = lines.map_while(Result::ok).any(|line| line.contains("moving"));
        assert!(moving, "the victim never moved");
        until("the table moves", || lab.report().demand.velocity_m_s.abs() > 0.01);
        // SIGKILL: nothing of the host runs after it.
        victim.kill().expect("killed");
        victim.wait().expect("gone");
        until("the drive stops by itself", || lab.report().drive == State::QuickStopActive);
        until("the table rests", || lab.report().at_rest());
        measured.push(1e3 * lab.report().stopped_itself_after_s.expect("it stopped by itself"));
    }
    println!("from the last SYNC of a killed host to quick stop: {measured:.1?} ms");
    assert!(measured.iter().all(|ms| *ms < 50.0), "{measured:?}");
}
