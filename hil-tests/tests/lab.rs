//! A whole run on emulated devices: samples over a pseudo terminal, process data over a socket that carries CAN frames, the
//! simulated table behind both, the real control thread before them, in real time.

use firmware_bridge::drive::CanBus;
use firmware_bridge::emulator::{Fault, Lab};
use shaketable::config::builtin::find;
use shaketable::control::Ending;
use shaketable::control::session::{Finished, Pace, start};
use shaketable::control::setup::{Setup, model_of_case};
use shaketable::control::thread::prioritise_link;
use shaketable::rig::RigSpec;
use shaketable::rig::hardware::{
    HardwareError, HardwareMonitor, HardwareRig, Preflight, PreflightError, SimulatedPlant, lab_settings,
};
use shaketable::sweep::SweepSpec;
use std::os::unix::net::UnixDatagram;
use std::path::Path;
use std::sync::{Mutex, MutexGuard, PoisonError};

/// Two labs at once would wait for each other's processors.
static ONE_AT_A_TIME: Mutex<()> = Mutex::new(());
/// Emulated devices stand still with the machine; a drive that is left without set-points for so long jerks. Periods.
const STOOD_STILL: u64 = 10;
const ATTEMPTS: u32 = 6;

fn alone() -> MutexGuard<'static, ()> {
    ONE_AT_A_TIME.lock().unwrap_or_else(PoisonError::into_inner)
}

const WALL: Pace = Pace::Wall { cpu: None, require_realtime: false };

fn setup(low_hz: f64, high_hz: f64) -> Setup {
    let case = "B1-G2-0.05".parse().expect("a case");
    let rig: RigSpec = find("rigs", "lab").and_then(|source| source.parse()).expect("valid");
    let specimen = model_of_case(&case);
    Setup {
        rig,
        sweep: SweepSpec::paper().restricted(low_hz, high_hz).expect("in range"),
        model: specimen.clone(),
        specimen,
        case: Some(case),
        safety: None,
        seed: 1,
        name: "lab".into(),
    }
}

/// The emulated devices of a setup, and the host's rig before them.
fn connect(
    setup: &Setup,
    schedule: Vec<(f64, Fault)>,
    early: &[Fault],
) -> (Lab, Result<(HardwareRig, Preflight), HardwareError>) {
    let mut hardware = setup.rig.hardware.clone().expect("a lab has hardware");
    // A build machine stands still now and then; the drive must not take that for the host's death here.
    hardware.drive.host_lost_ms = 50;
    hardware.drive.commands_lost_ms = 50;
    hardware.drive.command_stale_ms = 200;
    hardware.drive.missed_cycles = 200;
    let (host, device) = UnixDatagram::pair().expect("a socket pair");
    let mut settings = lab_settings(&hardware, setup.rig.sample_rate_hz, 1);
    settings.schedule = schedule;
    let plant = SimulatedPlant::new(setup.simulated_rig().expect("a rig"));
    let bus = CanBus::from_socket(device.into()).expect("the device's end");
    let lab = Lab::start(settings, bus, Box::new(plant)).expect("a lab");
    for fault in early {
        lab.inject(*fault);
    }
    hardware.daq.port = lab.port_path().to_owned();
    let bus = CanBus::from_socket(host.into()).expect("the host's end");
    let opened = HardwareRig::open_on(bus, &hardware, setup.rig.sample_rate_hz, Some(prioritise_link));
    (lab, opened)
}

/// A lab that passes its pre-flight; a machine that stands still for longer than the drive's time-outs is given three more
/// chances to get there.
fn sound(setup: &Setup, schedule: Vec<(f64, Fault)>) -> (Lab, HardwareRig, Preflight) {
    for _ in 0..3 {
        let (lab, opened) = connect(setup, schedule.clone(), &[]);
        match opened {
            Ok((rig, preflight)) => return (lab, rig, preflight),
            Err(HardwareError::Preflight(PreflightError::Rig { reason, .. })) => println!("again: {reason}"),
            Err(other) => panic!("{other}"),
        }
    }
    let (lab, opened) = connect(setup, schedule, &[]);
    let (rig, preflight) = opened.expect("a sound rig");
    (lab, rig, preflight)
}

fn run(setup: &Setup, out: &Path) -> (Finished, Preflight, HardwareMonitor) {
    let (_lab, rig, preflight) = sound(setup, vec![]);
    let monitor = rig.monitor();
    let plan = setup.plan_on(rig, &preflight, out, WALL).expect("a plan");
    let finished = start(plan).expect("started").wait(|_| {}).expect("ended");
    (finished, preflight, monitor)
}

/// Runs the sweep on the lab and on the simulated rig and compares their peaks.
fn assert_same_peaks(low_hz: f64, high_hz: f64) {
    let out = tempfile::tempdir().expect("a folder");
    let setup = setup(low_hz, high_hz);
    let (plan, _) = setup.plan(out.path(), Pace::Virtual).expect("a plan");
    let simulated = start(plan).expect("started").wait(|_| {}).expect("ended");
    // Only a machine that stood still excuses another attempt, and none of them may lose a sample.
    for _ in 0..ATTEMPTS {
        let (finished, preflight, monitor) = run(&setup, out.path());
        let (line, bus) = monitor.counters();
        let slips = slips(&finished);
        println!("{preflight}{line:?}\n{bus:?}\nslips of {slips:?} periods");
        assert_eq!((line.lost, line.bad_frames, line.ring_overflow), (0, 0, 0));
        assert_eq!(finished.manifest.lost.samples, 0);
        let held_up = bus.worst_late_ns > 5_000_000
            || line.worst_late_us > 5_000
            || slips.iter().any(|periods| *periods >= STOOD_STILL);
        match compare(&finished, &preflight, &monitor, &simulated) {
            Ok(()) => return,
            Err(why) if held_up => println!("not judged, the machine stood still: {why}"),
            Err(why) => panic!("{why}"),
        }
    }
    println!(
        "this machine stood still in each of {ATTEMPTS} runs: nothing lost in any, their peaks are not judged"
    );
}

/// Control periods left out, slip by slip.
fn slips(finished: &Finished) -> Vec<u64> {
    let events = std::fs::read_to_string(finished.folder.path().join("events.jsonl")).expect("events");
    let events =
        events.lines().map(|line| serde_json::from_str::<serde_json::Value>(line).expect("an event"));
    events.filter(|event| event["event"] == "slip").filter_map(|event| event["periods"].as_u64()).collect()
}

/// Whether a run on emulated devices went through and showed the peaks of the simulated rig.
fn compare(
    finished: &Finished,
    preflight: &Preflight,
    monitor: &HardwareMonitor,
    simulated: &Finished,
) -> Result<(), String> {
    if let (_, Some(fault)) = monitor.faults() {
        return Err(fault.to_string());
    }
    if finished.ending != Ending::Done || finished.steps.len() != simulated.steps.len() {
        return Err(format!("ended {:?} after {} steps", finished.ending, finished.steps.len()));
    }
    if !(0.5e-3..10e-3).contains(&preflight.chain_delay_s) {
        return Err(preflight.to_string());
    }
    let mut worst = [0.0_f64; 2];
    for (lab, simulated) in finished.steps.iter().zip(&simulated.steps) {
        let deviation = |a: f64, b: f64| (a / b - 1.0).abs();
        worst[0] = worst[0].max(deviation(lab.a_max_m_s2, simulated.a_max_m_s2));
        worst[1] = worst[1].max(deviation(lab.excursion_m, simulated.excursion_m));
    }
    let [a_max, excursion] = worst;
    println!("worst deviation of {} steps: A_max {a_max:.4}, E_max {excursion:.4}", simulated.steps.len());
    // Noise of 0.01 m/s2 on peaks from 0.2 m/s2 up, of 30 um on excursions from 6 mm up.
    if a_max < 0.06 && excursion < 0.02 { Ok(()) } else { Err(format!("peaks deviate by {worst:?}")) }
}

#[test]
fn a_short_sweep_on_emulated_devices_shows_what_the_simulated_rig_shows() {
    let _alone = alone();
    assert_same_peaks(2.0, 2.0);
}

#[test]
#[ignore = "takes three minutes of real time"]
fn the_sweep_from_1_to_2_hz_on_emulated_devices_shows_what_the_simulated_rig_shows() {
    assert_same_peaks(1.0, 2.0);
}

#[test]
fn the_loop_check_names_what_is_wired_wrongly() {
    let _alone = alone();
    let setup = setup(2.0, 2.0);
    for (fault, expected) in [
        (Fault::DaqSwap(1, 2), "table acceleration and mass acceleration 1 have changed places"),
        (Fault::DaqGain(0, -1.0), "table displacement has the wrong sign"),
        (Fault::DaqGain(2, 0.0), "mass acceleration 1 does not move"),
        (Fault::DaqGain(4, 2.0), "relative displacement shows"),
    ] {
        let opened = (0..4).map(|_| connect(&setup, vec![], &[fault]).1).find(|opened| {
            // Held-up machines end in another error, which says nothing about the wiring.
            !matches!(opened, Err(HardwareError::Preflight(PreflightError::Rig { .. })))
        });
        match opened.expect("a machine that keeps time once in four") {
            Err(HardwareError::Preflight(error @ PreflightError::Findings(_))) => {
                let text = error.to_string();
                assert!(text.contains(expected), "{fault:?}: {text}");
            }
            Err(other) => panic!("{fault:?}: {other}"),
            Ok(_) => panic!("{fault:?} went unnoticed"),
        }
    }
}

#[test]
#[ignore = "takes two minutes of real time"]
fn every_fault_in_motion_is_recorded_and_told_with_its_cable() {
    let out = tempfile::tempdir().expect("a folder");
    let setup = setup(2.0, 2.0);
    // The pre-flight takes some five seconds from enabling; the faults come in the run.
    for (fault, cable) in [
        (Fault::DaqUnplug, "DAQ cable"),
        (Fault::DaqSilent, "DAQ cable"),
        (Fault::DriveSilent, "drive cable"),
        (Fault::BusOff, "drive cable"),
        (Fault::DriveTrip(0x2320), "short circuit"),
        (Fault::DaqBitErrors(1e-4), "DAQ cable"),
    ] {
        let (lab, rig, preflight) = sound(&setup, vec![(8.0, fault)]);
        let monitor = rig.monitor();
        let plan = setup.plan_on(rig, &preflight, out.path(), WALL).expect("a plan");
        let finished = start(plan).expect("started").wait(|_| {}).expect("ended");
        let complaints = monitor.complaints().join("; ");
        assert!(complaints.contains(cable), "{fault:?}: {complaints}");
        // Whatever reached the host is in the folder: the samples of the pre-flight are the only ones that are not.
        let received = monitor.counters().0.samples;
        let before_run = received - finished.manifest.samples;
        let preflight_s = before_run as f64 / setup.rig.sample_rate_hz;
        println!(
            "{fault:?}: {complaints}; {received} received, {preflight_s:.2} s of them before the run; drive {:?}",
            lab.report().drive
        );
        assert!(preflight_s < 12.0, "{fault:?}: {preflight_s} s of samples are missing");
    }
}
