//! The drive link against the emulated drive, in real time over a socket pair.

mod support;

use firmware_bridge::canopen::cia402::State;
use firmware_bridge::clock::HostClock;
use firmware_bridge::drive::{DriveError, DriveFault, Phase, TimedCommand, Wish, prepare};
use firmware_bridge::emulator::Fault;
use support::{drive_settings, enabled, lab, shake, until};

#[test]
fn a_drive_is_configured_enabled_moved_and_stopped() {
    let (lab, bus) = lab(vec![]);
    let clock = HostClock::new();
    let ready = prepare(bus, drive_settings()).expect("a drive");
    assert_eq!(ready.name, "emulated servo drive");
    assert_eq!(ready.identity, [0x1234, 0x5678, 1, 42]);
    let mut drive = ready.start(clock, None).expect("a thread");
    drive.wish(Wish::Enable);
    until("the drive is enabled", || drive.phase() == Phase::Enabled);
    let mut largest_m = 0.0_f64;
    shake(&mut drive, clock, |drive| {
        largest_m = largest_m.max(drive.position_m().abs());
        drive.counters().commands > 4096 || drive.fault().is_some()
    });
    assert_eq!(drive.fault(), None);
    assert!((largest_m - 0.005).abs() < 2e-4, "{largest_m} m");
    drive.wish(Wish::QuickStop);
    until("quick stop is seen", || drive.phase() == Phase::Stopping);
    until("the table rests", || lab.report().at_rest());
    assert_eq!(lab.report().drive, State::QuickStopActive);
    drop(drive);
    until("the power is off", || lab.report().drive == State::SwitchOnDisabled);
    assert_eq!(lab.report().stopped_itself_after_s, None, "an orderly end needs no time-out");
}

#[test]
fn the_wrong_drive_is_refused_by_name_and_number() {
    let (_lab, bus) = lab(vec![]);
    let mut settings = drive_settings();
    settings.expected.product = Some(0x9999);
    let error = prepare(bus, settings).expect_err("refused");
    assert_eq!(error.to_string(), "wrong drive at node 5: product is 0x00005678, expected 0x00009999");
}

#[test]
fn nobody_at_the_node_is_said_so() {
    let (_lab, bus) = lab(vec![]);
    let mut settings = drive_settings();
    settings.node = 6;
    assert!(matches!(prepare(bus, settings), Err(DriveError::NoAnswer { node: 6, .. })));
}

#[test]
fn a_setting_that_the_drive_refuses_ends_the_start() {
    let (_lab, bus) = lab(vec![]);
    let mut settings = drive_settings();
    settings.mode = 9;
    let error = prepare(bus, settings).expect_err("refused");
    assert!(error.to_string().contains("0x6060:00"), "{error}");
    assert!(error.to_string().contains("value out of range"), "{error}");
}

/// Runs until a fault, and a little on so that the drive's reaction shows.
fn fault_of(fault: Fault) -> (Option<DriveFault>, State) {
    let (lab, bus) = lab(vec![(1.2, fault)]);
    let clock = HostClock::new();
    let mut drive = enabled(bus, drive_settings(), clock);
    shake(&mut drive, clock, |drive| drive.fault().is_some());
    let fault = drive.fault();
    until("the table rests", || lab.report().at_rest());
    (fault, lab.report().drive)
}

#[test]
fn a_silent_drive_is_a_fault_and_stops_itself() {
    assert_eq!(fault_of(Fault::DriveSilent), (Some(DriveFault::Silent), State::QuickStopActive));
}

#[test]
fn an_emcy_in_motion_is_told_with_its_code() {
    let (fault, state) = fault_of(Fault::DriveTrip(0x2320));
    assert_eq!(fault, Some(DriveFault::Tripped { code: 0x2320 }));
    assert!(matches!(state, State::Fault | State::FaultReactionActive), "{state:?}");
}

#[test]
fn bus_off_is_a_fault_and_the_table_stops() {
    let (fault, state) = fault_of(Fault::BusOff);
    assert_eq!(fault, Some(DriveFault::BusOff));
    assert_eq!(state, State::QuickStopActive);
}

#[test]
fn a_drive_that_loses_power_is_a_fault() {
    let (fault, state) = fault_of(Fault::DriveRestart);
    assert!(
        matches!(fault, Some(DriveFault::Restarted | DriveFault::LeftOperation | DriveFault::Silent)),
        "{fault:?}"
    );
    assert_eq!(state, State::SwitchOnDisabled);
}

#[test]
fn a_control_thread_that_dies_stops_the_table() {
    let (lab, bus) = lab(vec![]);
    let clock = HostClock::new();
    let mut drive = enabled(bus, drive_settings(), clock);
    shake(&mut drive, clock, |drive| drive.counters().commands > 1000);
    until("stale commands are seen", || drive.fault().is_some());
    assert_eq!(drive.fault(), Some(DriveFault::CommandsStale));
    until("the drive stops", || lab.report().drive == State::QuickStopActive);
}

#[test]
fn a_command_that_jumps_is_not_passed_on() {
    let (lab, bus) = lab(vec![]);
    let clock = HostClock::new();
    let mut drive = enabled(bus, drive_settings(), clock);
    drive.command(TimedCommand { at_ns: clock.now_ns(), displacement_m: 0.05, ..Default::default() });
    until("the jump is seen", || drive.fault().is_some());
    assert_eq!(drive.fault(), Some(DriveFault::CommandJump));
    until("the drive stops", || lab.report().drive == State::QuickStopActive);
    assert!(lab.report().demand.displacement_m.abs() < 1e-6, "the table did not move");
}
