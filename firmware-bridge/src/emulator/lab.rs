//! The threads that give the emulated devices their line, their bus and their mechanics, in real time.

use super::drive::DriveSpec;
use super::{DaqNode, Demand, DriveNode, Fault, Plant};
use crate::canopen::Frame;
use crate::canopen::cia402::State;
use crate::clock::HostClock;
use crate::drive::{BusEvent, CanBus, DriveError};
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
    /// Sample instants so far.
    pub samples: u64,
    /// Deliveries at which the thread of the mechanics was more than a period late.
    pub late_steps: u64,
    /// State of the drive.
    pub drive: State,
    /// Time since the last process data of the host, s, at which the drive stopped by itself; `None` if it did not.
    pub stopped_itself_after_s: Option<f64>,
    /// Last demand.
    pub demand: Demand,
}

struct Shared {
    stop: AtomicBool,
    clock: HostClock,
    daq: Mutex<DaqSide>,
    drive: Mutex<DriveSide>,
    report: Mutex<LabReport>,
    faults: Mutex<Vec<Fault>>,
}

struct DaqSide {
    node: DaqNode,
    /// The device's end of the line; `None` when the cable is out.
    port: Option<TTYPort>,
    unsent: Vec<u8>,
}

struct DriveSide {
    node: DriveNode,
    last_output_ns: u64,
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
        let shared = Arc::new(Shared {
            stop: AtomicBool::new(false),
            clock: HostClock::new(),
            daq: Mutex::new(DaqSide { node: settings.daq, port: Some(device_end), unsent: Vec::new() }),
            drive: Mutex::new(DriveSide { node: DriveNode::new(settings.drive), last_output_ns: 0 }),
            report: Mutex::new(LabReport::default()),
            faults: Mutex::new(Vec::new()),
        });
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
        let (rate_hz, schedule) = (settings.rate_hz, settings.schedule);
        spawn("lab-drive", Box::new(move |shared| drive_thread(shared, bus)))?;
        spawn("lab-requests", Box::new(move |shared| request_thread(shared, requests)))?;
        spawn("lab-table", Box::new(move |shared| table_thread(shared, plant, rate_hz, schedule)))?;
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

fn drive_thread(shared: &Shared, mut bus: CanBus) {
    let mut frames: Vec<Frame> = Vec::new();
    while !shared.stop.load(Ordering::Acquire) {
        // All that waits is heard before any time-out is judged: a thread that was held up must not take its
        // own lateness for the host's.
        let mut event = bus.wait(Duration::from_millis(1));
        let now_ns = shared.clock.now_ns();
        let mut side = lock(&shared.drive);
        while let Ok(Some(heard)) = event {
            if let BusEvent::Frame(frame) = heard {
                if frame.id == crate::canopen::cob::SYNC {
                    side.last_output_ns = now_ns;
                }
                side.node.on_frame(&frame, now_ns, &mut |frame| frames.push(frame));
            }
            event = bus.poll();
        }
        side.node.tick(now_ns, &mut |frame| frames.push(frame));
        drop(side);
        if event.is_err() {
            // The bus is gone: for a drive that is silence, which its time-outs answer.
            std::thread::sleep(Duration::from_millis(1));
        }
        for _ in take_faults(shared, |f| matches!(f, Fault::BusOff)) {
            // What cannot be told to the host shows as a silent drive.
            let _ = bus.send_bus_off();
        }
        for frame in frames.drain(..) {
            // A full queue loses the frame, as on a real bus that nobody acknowledges.
            let _ = bus.send(&frame);
        }
    }
}

fn take_faults(shared: &Shared, wanted: impl Fn(&Fault) -> bool) -> Vec<Fault> {
    let mut faults = lock(&shared.faults);
    let (taken, rest) = faults.drain(..).partition(|fault| wanted(fault));
    *faults = rest;
    taken
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

/// The mechanics and the sampling. The thread wakes once in [`DELIVERY_NS`] and makes up for all instants since, as a
/// USB serial adapter delivers what has gathered within its frame of a millisecond.
fn table_thread(shared: &Shared, plant: Box<dyn Plant>, rate_hz: f64, mut schedule: Vec<(f64, Fault)>) {
    schedule.sort_by(|a, b| b.0.total_cmp(&a.0));
    let start_ns = shared.clock.now_ns() as f64;
    let mut table =
        Table { plant, rate_hz, start_ns, instants: 0, last_m: 0.0, enabled_at_ns: None, schedule };
    let mut wake_ns = start_ns as u64;
    while !shared.stop.load(Ordering::Acquire) {
        wake_ns += DELIVERY_NS;
        let late_ns = shared.clock.sleep_until(wake_ns);
        let now_ns = wake_ns + late_ns;
        let mut side = lock(&shared.daq);
        while table.next_instant_ns() <= now_ns as f64 {
            table.step(shared, &mut side);
        }
        apply_faults(shared, &mut side);
        if !side.unsent.is_empty() {
            side.flush();
        }
        drop(side);
        let mut report = lock(&shared.report);
        report.samples = table.instants;
        report.late_steps += u64::from(late_ns > DELIVERY_NS);
    }
}

/// Period of delivery, ns: a frame of full-speed USB.
const DELIVERY_NS: u64 = 1_000_000;

struct Table {
    plant: Box<dyn Plant>,
    rate_hz: f64,
    start_ns: f64,
    instants: u64,
    last_m: f64,
    enabled_at_ns: Option<f64>,
    schedule: Vec<(f64, Fault)>,
}

impl Table {
    fn next_instant_ns(&self) -> f64 {
        self.start_ns + (self.instants + 1) as f64 * 1e9 / self.rate_hz
    }

    fn step(&mut self, shared: &Shared, daq: &mut DaqSide) {
        let instant_ns = self.next_instant_ns();
        self.instants += 1;
        let mut side = lock(&shared.drive);
        let demand = side.node.demand(instant_ns);
        let values = self.plant.step(demand);
        side.node.set_actual(values[0], (values[0] - self.last_m) * self.rate_hz);
        self.last_m = values[0];
        let (state, stopped) = (side.node.state(), side.node.stopped_itself_at_ns());
        let last_output_ns = side.last_output_ns;
        drop(side);
        if state == State::OperationEnabled {
            self.enabled_at_ns.get_or_insert(instant_ns);
        }
        while let (Some(since), Some((at_s, fault))) = (self.enabled_at_ns, self.schedule.last().copied())
            && instant_ns - since >= at_s * 1e9
        {
            lock(&shared.faults).push(fault);
            self.schedule.pop();
        }
        let device_us = (self.instants as f64 * 1e6 / self.rate_hz) as u64;
        daq.node.sample(&values, device_us, &mut daq.unsent);
        let mut report = lock(&shared.report);
        report.drive = state;
        report.demand = demand;
        report.stopped_itself_after_s = stopped
            .map(|at| at.saturating_sub(last_output_ns) as f64 * 1e-9)
            .or(report.stopped_itself_after_s);
    }
}

fn apply_faults(shared: &Shared, daq: &mut DaqSide) {
    for fault in take_faults(shared, |f| !matches!(f, Fault::BusOff)) {
        match fault {
            Fault::DaqUnplug => daq.port = None,
            Fault::DriveSilent => lock(&shared.drive).node.set_silent(true),
            Fault::DriveTrip(code) => {
                // The EMCY goes out through the drive's own thread.
                lock(&shared.drive).node.trip_later(code);
            }
            Fault::DriveRestart => lock(&shared.drive).node.restart(),
            other => daq.node.fault(other, &mut daq.unsent),
        }
    }
}
