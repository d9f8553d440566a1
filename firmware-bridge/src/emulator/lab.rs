//! The threads that give the emulated devices their line, their bus and their mechanics, in real time.

use super::arrivals::Arrivals;
use super::drive::DriveSpec;
use super::{DaqNode, Demand, DriveNode, Fault, Plant};
use crate::canopen::cia402::State;
use crate::canopen::{Frame, cob};
use crate::clock::HostClock;
use crate::drive::{CanBus, DriveError};
use serialport::{SerialPort, TTYPort};
use std::boxed::Box;
use std::io::{ErrorKind, Read, Write};
use std::path::PathBuf;
use std::string::{String, ToString};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;
use std::time::Duration;
use std::vec::Vec;

/// What the emulated lab consists of.
pub struct LabSettings {
    /// Rate of DAQ and mechanics, Hz.
    pub rate_hz: f64,
    /// Path of a symbolic link to the pseudo terminal, made new; `None` for none.
    pub port_link: Option<PathBuf>,
    /// The drive.
    pub drive: DriveSpec,
    /// The DAQ.
    pub daq: DaqNode,
    /// Faults by time after the drive was first enabled, s.
    pub schedule: Vec<(f64, Fault)>,
    /// Runs first on each thread of the lab, for its scheduling: real devices do not wait for a busy machine.
    pub on_thread: Option<fn()>,
}

/// What happened in the lab.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct LabReport {
    /// Looks at the bus so far; what was sent before a report is taken into account two looks later.
    pub looks: u64,
    /// Sample instants so far.
    pub samples: u64,
    /// Wake-ups at which the devices had to make up for more than 3 ms.
    pub late_steps: u64,
    /// State of the drive.
    pub drive: State,
    /// Time since the last process data of the host, s, at which the drive stopped by itself; `None` if it did not.
    pub stopped_itself_after_s: Option<f64>,
    /// Number that the DAQ's next sample bore when the last fault of the schedule took effect.
    pub fault_at_sequence: Option<u32>,
    /// Time from that fault until the drive was out of operation, s.
    pub out_of_operation_after_fault_s: Option<f64>,
    /// Last demand.
    pub demand: Demand,
}

impl LabReport {
    /// Whether the drive stands and is not asked to move: a sine that turns round has an acceleration.
    pub fn at_rest(&self) -> bool {
        self.demand.velocity_m_s == 0.0 && self.demand.acceleration_m_s2 == 0.0
    }
}

struct Shared {
    stop: AtomicBool,
    daq: Mutex<DaqSide>,
    report: Mutex<LabReport>,
    faults: Mutex<Vec<Fault>>,
}

struct DaqSide {
    node: DaqNode,
    /// The device's end of the line; `None` when the cable is out.
    port: Option<TTYPort>,
    unsent: Vec<u8>,
}

/// A running lab; dropping it ends it.
pub struct Lab {
    shared: Arc<Shared>,
    threads: Vec<JoinHandle<()>>,
    port_path: String,
    link: Option<PathBuf>,
    /// Kept open so that the line does not hang up when the host closes it between runs.
    _host_end: TTYPort,
}

/// More unsent bytes than a device's buffer holds are dropped.
const DAQ_BUFFER: usize = 8192;

impl Lab {
    /// Starts both devices: a new pseudo terminal, the given bus.
    ///
    /// # Errors
    /// No pseudo terminal, no symbolic link, no thread.
    pub fn start(settings: LabSettings, bus: CanBus, plant: Box<dyn Plant>) -> Result<Self, DriveError> {
        let (mut device_end, host_end) =
            TTYPort::pair().map_err(|error| std::io::Error::other(error.to_string()))?;
        let short = Duration::from_millis(1);
        device_end.set_timeout(short).map_err(|error| std::io::Error::other(error.to_string()))?;
        let requests =
            device_end.try_clone_native().map_err(|error| std::io::Error::other(error.to_string()))?;
        let port_path = host_end.name().unwrap_or_default();
        if let Some(link) = &settings.port_link {
            // A link that a killed emulator left behind is replaced.
            let _ = std::fs::remove_file(link);
            std::os::unix::fs::symlink(&port_path, link)?;
        }
        let clock = HostClock::new();
        let bus = Arrivals::new(bus, clock)?;
        let shared = Arc::new(Shared {
            stop: AtomicBool::new(false),
            daq: Mutex::new(DaqSide { node: settings.daq, port: Some(device_end), unsent: Vec::new() }),
            report: Mutex::new(LabReport::default()),
            faults: Mutex::new(Vec::new()),
        });
        let node = DriveNode::new(settings.drive);
        let mut devices = Devices::new(bus, node, plant, clock, settings.rate_hz, settings.schedule);
        let mut threads = Vec::new();
        let on_thread = settings.on_thread;
        let mut spawn = |name: &str, body: Box<dyn FnOnce(&Shared) + Send>| -> std::io::Result<()> {
            let shared = Arc::clone(&shared);
            let builder = std::thread::Builder::new().name(name.into());
            threads.push(builder.spawn(move || {
                if let Some(setup) = on_thread {
                    setup();
                }
                body(&shared);
            })?);
            Ok(())
        };
        spawn("lab-devices", Box::new(move |shared| devices.run(shared)))?;
        spawn("lab-requests", Box::new(move |shared| request_thread(shared, requests)))?;
        Ok(Self { shared, threads, port_path, link: settings.port_link, _host_end: host_end })
    }

    /// Path of the host's end of the serial line.
    pub fn port_path(&self) -> &str {
        &self.port_path
    }

    /// Switches a fault on.
    pub fn inject(&self, fault: Fault) {
        lock(&self.shared.faults).push(fault);
    }

    /// What happened so far.
    pub fn report(&self) -> LabReport {
        *lock(&self.shared.report)
    }
}

impl Drop for Lab {
    fn drop(&mut self) {
        self.shared.stop.store(true, Ordering::Release);
        for thread in self.threads.drain(..) {
            // A panic there has been printed by the runtime.
            let _ = thread.join();
        }
        if let Some(link) = &self.link {
            // Gone already is as good.
            let _ = std::fs::remove_file(link);
        }
    }
}

/// A poisoned lock means that another thread of the lab panicked; the data is still whole enough to end.
fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

fn request_thread(shared: &Shared, mut port: TTYPort) {
    let mut buffer = [0; 256];
    // Errors of `set_timeout` cannot happen on a pseudo terminal: it only stores the number.
    let _ = port.set_timeout(Duration::from_millis(5));
    while !shared.stop.load(Ordering::Acquire) {
        let read = port.read(&mut buffer);
        let mut side = lock(&shared.daq);
        if side.port.is_none() {
            return;
        }
        match read {
            Ok(count) => {
                let DaqSide { node, unsent, .. } = &mut *side;
                node.on_bytes(&buffer[..count], unsent);
                side.flush();
            }
            Err(error) if error.kind() == ErrorKind::TimedOut => {}
            Err(_) => return,
        }
    }
}

impl DaqSide {
    /// Sends what the line takes now; the rest waits, or is dropped like in a device whose buffer is full.
    fn flush(&mut self) {
        let Some(port) = &mut self.port else { return self.unsent.clear() };
        match port.write(&self.unsent) {
            Ok(sent) => drop(self.unsent.drain(..sent)),
            Err(_) if self.unsent.len() > DAQ_BUFFER => self.unsent.clear(),
            Err(_) => {}
        }
    }
}

/// Longest time between two looks at the bus, ns: one of 1 ms brings SYNC and a delivery of samples with one wake-up.
const PATIENCE: Duration = Duration::from_micros(1500);
/// The thread was late when it has to make up for more than this, ns.
const LATE_NS: f64 = 3e6;

/// Drive, mechanics and sampling as functions of the times at which frames came in: it makes no difference to their motion
/// when this thread gets the processor, only how late the answers are.
struct Devices {
    bus: Arrivals,
    node: DriveNode,
    plant: Box<dyn Plant>,
    rate_hz: f64,
    start_ns: f64,
    instants: u64,
    last_m: f64,
    last_output_ns: u64,
    enabled_at_ns: Option<f64>,
    schedule: Vec<(f64, Fault)>,
    /// When the last fault of the schedule took effect: device time, ns, and the DAQ's number.
    fault_at: Option<(f64, Option<u32>)>,
    out_after_s: Option<f64>,
    /// Frames to be sent.
    answers: Vec<Frame>,
    late_steps: u64,
}

impl Devices {
    fn new(
        bus: Arrivals,
        node: DriveNode,
        plant: Box<dyn Plant>,
        clock: HostClock,
        rate_hz: f64,
        mut schedule: Vec<(f64, Fault)>,
    ) -> Self {
        schedule.sort_by(|a, b| b.0.total_cmp(&a.0));
        Self {
            bus,
            node,
            plant,
            rate_hz,
            start_ns: clock.now_ns() as f64,
            instants: 0,
            last_m: 0.0,
            last_output_ns: 0,
            enabled_at_ns: None,
            schedule,
            fault_at: None,
            out_after_s: None,
            answers: Vec::new(),
            late_steps: 0,
        }
    }

    fn run(&mut self, shared: &Shared) {
        while !shared.stop.load(Ordering::Acquire) {
            let now_ns = self.bus.wait(PATIENCE);
            let mut daq = lock(&shared.daq);
            self.late_steps += u64::from(now_ns as f64 - self.next_instant_ns() > LATE_NS);
            // An error is silence, which the drive's time-outs answer.
            while let Ok(Some((frame, at_ns))) = self.bus.next() {
                self.advance(at_ns, shared, &mut daq);
                if frame.id == cob::SYNC {
                    self.last_output_ns = at_ns;
                }
                self.node.on_frame(&frame, at_ns, &mut |frame| self.answers.push(frame));
            }
            self.advance(now_ns, shared, &mut daq);
            self.apply_faults(shared, &mut daq);
            for frame in self.answers.drain(..) {
                // A full queue loses the frame, as on a real bus that nobody acknowledges.
                let _ = self.bus.bus().send(&frame);
            }
            if !daq.unsent.is_empty() {
                daq.flush();
            }
            drop(daq);
            self.tell(shared);
        }
    }

    fn next_instant_ns(&self) -> f64 {
        self.start_ns + (self.instants + 1) as f64 * 1e9 / self.rate_hz
    }

    /// All instants up to a time.
    fn advance(&mut self, until_ns: u64, shared: &Shared, daq: &mut DaqSide) {
        while self.next_instant_ns() <= until_ns as f64 {
            self.step(shared, daq);
        }
    }

    fn step(&mut self, shared: &Shared, daq: &mut DaqSide) {
        let instant_ns = self.next_instant_ns();
        self.instants += 1;
        self.node.tick(instant_ns as u64, &mut |frame| self.answers.push(frame));
        let values = self.plant.step(self.node.demand(instant_ns));
        self.node.set_actual(values[0], (values[0] - self.last_m) * self.rate_hz);
        self.last_m = values[0];
        if self.node.state() == State::OperationEnabled {
            self.enabled_at_ns.get_or_insert(instant_ns);
        } else if let Some((fault_ns, _)) = self.fault_at {
            self.out_after_s.get_or_insert((instant_ns - fault_ns) * 1e-9);
        }
        while let (Some(since), Some((at_s, fault))) = (self.enabled_at_ns, self.schedule.last().copied())
            && instant_ns - since >= at_s * 1e9
        {
            lock(&shared.faults).push(fault);
            self.fault_at = Some((instant_ns, daq.node.sequence()));
            self.schedule.pop();
        }
        let device_us = (self.instants as f64 * 1e6 / self.rate_hz) as u64;
        daq.node.sample(&values, device_us, &mut daq.unsent);
    }

    fn apply_faults(&mut self, shared: &Shared, daq: &mut DaqSide) {
        for fault in lock(&shared.faults).drain(..) {
            match fault {
                Fault::DaqUnplug => daq.port = None,
                Fault::DriveSilent => self.node.set_silent(true),
                // The EMCY goes out with the next tick.
                Fault::DriveTrip(code) => self.node.trip_later(code),
                Fault::DriveRestart => self.node.restart(),
                Fault::BusOff => {
                    // What cannot be told to the host shows as a silent drive.
                    let _ = self.bus.bus().send_bus_off();
                }
                other => daq.node.fault(other, &mut daq.unsent),
            }
        }
    }

    fn tell(&self, shared: &Shared) {
        let stopped = self.node.stopped_itself_at_ns();
        let mut report = lock(&shared.report);
        report.looks += 1;
        report.samples = self.instants;
        report.fault_at_sequence = self.fault_at.and_then(|(_, sequence)| sequence);
        report.out_of_operation_after_fault_s = self.out_after_s;
        report.late_steps = self.late_steps;
        report.drive = self.node.state();
        report.demand = self.node.demand(self.start_ns + self.instants as f64 * 1e9 / self.rate_hz);
        report.stopped_itself_after_s = stopped
            .map(|at| at.saturating_sub(self.last_output_ns) as f64 * 1e-9)
            .or(report.stopped_itself_after_s);
    }
}
