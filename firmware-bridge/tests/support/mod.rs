//! An emulated lab for the tests: a socket pair carries the CAN frames, a pseudo terminal the samples, and a table
//! that follows at once stands behind both.

// Each test file uses a part of it.
#![allow(dead_code)]

use firmware_bridge::clock::HostClock;
use firmware_bridge::daq::{DaqDevice, DaqSettings, DaqStream, ExpectedDevice};
use firmware_bridge::drive::{
    CanBus, DriveSettings, DriveStream, ExpectedDrive, Phase, TimedCommand, Units, Wish, prepare,
};
use firmware_bridge::emulator::{DaqNode, Demand, DriveSpec, Fault, Lab, LabSettings, Plant};
use std::os::unix::net::UnixDatagram;
use std::time::{Duration, Instant};

pub const UNITS: Units = Units { counts_per_m: 1e7, velocity_per_m_s: 1e6, torque_per_m_s2: 100.0 };
pub const RATE_HZ: f64 = 2048.0;

/// A table that is where it is asked to be.
pub struct Stiff;

impl Plant for Stiff {
    fn step(&mut self, demand: Demand) -> [f64; 5] {
        [demand.displacement_m, demand.acceleration_m_s2, 0.5, -0.5, 0.001]
    }
}

pub fn spec() -> DriveSpec {
    DriveSpec {
        node: 5,
        identity: [0x1234, 0x5678, 1, 42],
        name: "emulated servo drive".into(),
        units: UNITS,
    }
}

/// Time-outs that a machine which stands still for some tens of milliseconds now and then does not reach.
pub fn drive_settings() -> DriveSettings {
    DriveSettings {
        node: 5,
        host_node: 126,
        expected: ExpectedDrive { vendor: Some(0x1234), product: Some(0x5678), serial: None },
        units: UNITS,
        cycle: Duration::from_millis(1),
        mode: 8,
        host_lost: Duration::from_millis(300),
        commands_lost: Duration::from_millis(200),
        sync_timeout: Some(firmware_bridge::canopen::objects::at(0x2010, 0)),
        drive_heartbeat: Duration::from_millis(100),
        missed_cycles: 300,
        command_stale: Duration::from_millis(250),
        quick_stop_m_s2: 5.0,
        following_error_m: 0.02,
        speed_limit_m_s: 0.6,
        settings: Vec::new(),
    }
}

/// A lab and the host's end of its bus.
pub fn lab(schedule: Vec<(f64, Fault)>) -> (Lab, CanBus) {
    let (host, device) = UnixDatagram::pair().expect("a socket pair");
    let bus = CanBus::from_socket(device.into()).expect("the device's end");
    let settings = LabSettings {
        rate_hz: RATE_HZ,
        port_link: None,
        drive: spec(),
        daq: DaqNode::new(0x10, 0x20, "KR-0001", RATE_HZ, 7),
        schedule,
        on_thread: None,
    };
    let lab = Lab::start(settings, bus, Box::new(Stiff)).expect("a lab");
    (lab, CanBus::from_socket(host.into()).expect("the host's end"))
}

pub fn daq_settings(path: &str) -> DaqSettings {
    DaqSettings {
        path: path.into(),
        baud: 921_600,
        rate_hz: RATE_HZ,
        expected: ExpectedDevice { vendor: Some(0x10), product: Some(0x20), serial: Some("KR-0001".into()) },
        silence: Duration::from_millis(50),
    }
}

pub fn stream(lab: &Lab, clock: HostClock) -> DaqStream {
    let device = DaqDevice::open(daq_settings(lab.port_path())).expect("the DAQ answers");
    device.start(clock, None).expect("it samples")
}

/// A drive in operation.
pub fn enabled(bus: CanBus, settings: DriveSettings, clock: HostClock) -> DriveStream {
    let drive = prepare(bus, settings).expect("a drive").start(clock, None).expect("a thread");
    drive.wish(Wish::Enable);
    until("the drive is enabled", || drive.phase() == Phase::Enabled);
    drive
}

/// Sends commands of a 2 Hz sine of 5 mm at the rate of a control thread until `done`.
pub fn shake(drive: &mut DriveStream, clock: HostClock, mut done: impl FnMut(&DriveStream) -> bool) {
    let start = clock.now_ns();
    let (amplitude_m, w) = (0.005, std::f64::consts::TAU * 2.0);
    for n in 1_u64.. {
        let at_ns = start + n * 1_000_000_000 / 2048;
        clock.sleep_until(at_ns);
        let t = n as f64 / RATE_HZ;
        // Begins with a whole second of growing amplitude, so that the speed limit holds.
        let grow = t.min(1.0);
        drive.command(TimedCommand {
            at_ns,
            displacement_m: grow * amplitude_m * (w * t).sin(),
            velocity_m_s: grow * amplitude_m * w * (w * t).cos(),
            acceleration_m_s2: -grow * amplitude_m * w * w * (w * t).sin(),
        });
        if done(drive) {
            return;
        }
    }
}

/// Waits for a condition, at most 5 s.
pub fn until(what: &str, mut condition: impl FnMut() -> bool) {
    let deadline = Instant::now() + Duration::from_secs(30);
    while !condition() {
        assert!(Instant::now() < deadline, "waited in vain until {what}");
        std::thread::yield_now();
        std::thread::sleep(Duration::from_micros(200));
    }
}
