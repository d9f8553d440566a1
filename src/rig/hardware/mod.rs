//! The real rig: a DAQ device on a serial line and a servo drive on a CAN bus, behind the same [`Rig`] as
//! the simulated one. [`HardwareRig::open`] connects, checks the loop and hands over a rig at rest at the
//! centre; from then on `read` and `write` only touch lock-free rings to the links' own threads.

mod emulated;
mod preflight;
mod signature;
mod spec;

pub use emulated::{SimulatedPlant, lab_settings};
pub use preflight::{ChannelCheck, Preflight, PreflightError, check_loop};
pub use signature::{Finding, Response};
pub use spec::{DaqSpec, DriveLinkSpec, HardwareSpec, ObjectSpec, PreflightSpec};

use super::{Rig, RigFault};
use crate::stream::{Channels, Command, Sample, StatusBits};
use firmware_bridge::clock::{HostClock, TimeGrid};
use firmware_bridge::daq::{DaqCounters, DaqDevice, DaqError, DaqFault, DaqMonitor, DaqSample, DaqStream};
use firmware_bridge::drive::{
    CanBus, DriveCounters, DriveError, DriveFault, DriveMonitor, DriveStream, Phase, TimedCommand, Wish,
    prepare,
};
use firmware_bridge::wire::SampleFrame;
use std::time::{Duration, Instant};

/// Time from a lost DAQ to quick stop, ns: the supervisor, which stops gently, has had its turn by then.
const BLIND_NS: u64 = 1_500_000_000;
/// Time allowed for a drive to get into operation.
const ENABLE_TIMEOUT: Duration = Duration::from_secs(5);

/// Why the rig cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum HardwareError {
    /// The DAQ side.
    #[error(transparent)]
    Daq(#[from] DaqError),
    /// The drive side.
    #[error(transparent)]
    Drive(#[from] DriveError),
    /// The drive does not go into operation.
    #[error("the drive does not go into operation: {0}")]
    NotEnabled(String),
    /// The loop check found something.
    #[error(transparent)]
    Preflight(#[from] PreflightError),
    /// The thread of the loop check could not be started.
    #[error("cannot start the thread of the loop check: {0}")]
    Thread(std::io::Error),
    /// The thread of the loop check panicked, which is a fault of the program.
    #[error("the thread of the loop check died")]
    CheckDied,
}

/// A function that sets up the scheduling of the calling link thread.
pub type ThreadSetup = fn();

/// A rig of real devices.
pub struct HardwareRig {
    daq: DaqStream,
    drive: DriveStream,
    clock: HostClock,
    grid: TimeGrid,
    chain_delay_s: f64,
    /// The first read drops what has gathered since the pre-flight.
    stale: bool,
    daq_lost_at_ns: Option<u64>,
}

/// How the links do; may be asked from any thread, also after the rig is gone.
#[derive(Clone, Debug)]
pub struct HardwareMonitor {
    daq: DaqMonitor,
    drive: DriveMonitor,
}

impl HardwareMonitor {
    /// Counters of both links.
    pub fn counters(&self) -> (DaqCounters, DriveCounters) {
        (self.daq.counters(), self.drive.counters())
    }

    /// The first fault of each link.
    pub fn faults(&self) -> (Option<DaqFault>, Option<DriveFault>) {
        (self.daq.fault(), self.drive.fault())
    }

    /// What the operator should know, one line each; empty when all is well.
    pub fn complaints(&self) -> Vec<String> {
        let (daq, drive) = self.faults();
        let mut lines: Vec<String> = daq
            .map(|fault| fault.to_string())
            .into_iter()
            .chain(drive.map(|fault| fault.to_string()))
            .collect();
        let (line, bus) = self.counters();
        if line.lost > 0 {
            lines.push(format!(
                "{} samples lost in {} gaps on the DAQ line ({} bad frames): check the DAQ cable",
                line.lost, line.gaps, line.bad_frames
            ));
        }
        if bus.disturbed > 0 {
            lines.push(format!("the CAN bus was disturbed {} times: check the drive cable", bus.disturbed));
        }
        lines
    }
}

impl HardwareRig {
    /// Connects both devices, enables the drive, brings the table to its centre and checks the loop. `on_thread`
    /// is run first on each link's thread and on the one that moves the table for the check.
    ///
    /// # Errors
    /// [`HardwareError`], which says what is wrong and which cable to look at; the table rests then.
    pub fn open(
        spec: &HardwareSpec,
        rate_hz: f64,
        on_thread: Option<ThreadSetup>,
    ) -> Result<(Self, Preflight), HardwareError> {
        let bus = CanBus::open(&spec.drive.interface)?;
        Self::open_on(bus, spec, rate_hz, on_thread)
    }

    /// The same on a bus that is open already.
    ///
    /// # Errors
    /// As [`HardwareRig::open`].
    pub fn open_on(
        bus: CanBus,
        spec: &HardwareSpec,
        rate_hz: f64,
        on_thread: Option<ThreadSetup>,
    ) -> Result<(Self, Preflight), HardwareError> {
        let setup = || on_thread.map(|f| Box::new(f) as Box<dyn FnOnce() + Send>);
        let clock = HostClock::new();
        let daq = DaqDevice::open(spec.daq.settings(rate_hz))?;
        let identity = daq.identity;
        let ready = prepare(bus, spec.drive.settings())?;
        let devices = format!("{} (serial {:08x})", ready.name, ready.identity[3]);
        let daq = daq.start(clock, setup())?;
        let drive = ready.start(clock, setup())?;
        let mut rig = Self {
            daq,
            drive,
            clock,
            grid: TimeGrid::new(1e9 / rate_hz),
            chain_delay_s: 0.0,
            stale: true,
            daq_lost_at_ns: None,
        };
        rig.enable()?;
        let mut preflight = rig.check(spec, rate_hz, on_thread)?;
        preflight.drive = devices;
        preflight.daq = String::from_utf8_lossy(&identity.serial).trim_end_matches('\0').to_owned();
        rig.chain_delay_s = preflight.chain_delay_s;
        rig.grid = TimeGrid::new(1e9 / rate_hz);
        rig.stale = true;
        Ok((rig, preflight))
    }

    /// Checks the loop from a thread of its own: while it moves the table it must be as punctual as the control thread is, and
    /// the caller's scheduling stays as it was.
    fn check(
        &mut self,
        spec: &HardwareSpec,
        rate_hz: f64,
        on_thread: Option<ThreadSetup>,
    ) -> Result<Preflight, HardwareError> {
        let checked = std::thread::scope(|scope| {
            let body = || {
                if let Some(setup) = on_thread {
                    setup();
                }
                preflight::run(self, spec, rate_hz)
            };
            let thread = std::thread::Builder::new().name("loop-check".into()).spawn_scoped(scope, body);
            thread.map(std::thread::ScopedJoinHandle::join)
        });
        match checked {
            Ok(Ok(measured)) => Ok(measured?),
            Ok(Err(_)) => Err(HardwareError::CheckDied),
            Err(error) => Err(HardwareError::Thread(error)),
        }
    }

    /// A second pair of eyes on the links.
    pub fn monitor(&self) -> HardwareMonitor {
        HardwareMonitor { daq: self.daq.monitor(), drive: self.drive.monitor() }
    }

    fn enable(&mut self) -> Result<(), HardwareError> {
        self.drive.wish(Wish::Enable);
        let deadline = Instant::now() + ENABLE_TIMEOUT;
        while self.drive.phase() != Phase::Enabled {
            if let Some(fault) = self.drive.fault() {
                return Err(HardwareError::NotEnabled(fault.to_string()));
            }
            if Instant::now() > deadline {
                let phase = self.drive.phase();
                return Err(HardwareError::NotEnabled(format!(
                    "it stays {phase:?}; check its power and enable input"
                )));
            }
            // The state changes once a millisecond at most.
            std::thread::sleep(Duration::from_millis(1));
        }
        Ok(())
    }

    fn status(&self, frame: u16) -> StatusBits {
        let mut bits = 0;
        if frame & SampleFrame::OVERRANGE_ANY != 0 {
            bits |= StatusBits::OVERRANGE;
        }
        if self.drive.phase() == Phase::Enabled {
            bits |= StatusBits::DRIVE_ENABLED;
        }
        match self.drive.fault() {
            Some(fault) if fault.is_link() => bits |= StatusBits::LINK_DOWN,
            Some(_) => bits |= StatusBits::DRIVE_FAULT,
            None => {}
        }
        StatusBits(bits)
    }

    fn sample(&self, from: &DaqSample) -> Sample {
        let [table_displacement_m, table_acceleration_m_s2, first, second, relative_displacement_m] =
            from.values;
        Sample {
            sequence: from.sequence,
            device_time_us: from.device_time_us,
            channels: Channels {
                table_displacement_m,
                table_acceleration_m_s2,
                mass_acceleration_1_m_s2: first,
                mass_acceleration_2_m_s2: second,
                relative_displacement_m,
            },
            status: self.status(from.status),
        }
    }

    /// Stops a table that nobody sees any more.
    fn watch_daq(&mut self, now_ns: u64) {
        if self.daq.fault().is_none() {
            return;
        }
        let lost_at = *self.daq_lost_at_ns.get_or_insert(now_ns);
        if now_ns - lost_at > BLIND_NS {
            self.drive.wish(Wish::QuickStop);
        }
    }
}

impl Rig for HardwareRig {
    fn read(&mut self) -> Result<Option<Sample>, RigFault> {
        let mut next = self.daq.pop();
        if self.stale && next.is_some() {
            self.stale = false;
            while let Some(newer) = self.daq.pop() {
                next = Some(newer);
            }
        }
        match next {
            Some(sample) => Ok(Some(self.sample(&sample))),
            None if self.daq.fault().is_some() => Err(RigFault::DaqLink),
            None => Ok(None),
        }
    }

    fn write(&mut self, command: &Command) -> Result<(), RigFault> {
        let now_ns = self.clock.now_ns();
        self.watch_daq(now_ns);
        let at_ns = self.grid.observe(now_ns) as u64;
        self.drive.command(TimedCommand {
            at_ns,
            displacement_m: command.displacement_m,
            velocity_m_s: command.velocity_m_s,
            acceleration_m_s2: command.acceleration_m_s2,
        });
        match self.drive.fault() {
            None => Ok(()),
            Some(fault) if fault.is_link() => Err(RigFault::DriveLink),
            Some(_) => Err(RigFault::DriveTrip),
        }
    }

    fn quick_stop(&mut self) {
        self.drive.wish(Wish::QuickStop);
    }

    fn chain_delay_s(&self) -> f64 {
        self.chain_delay_s
    }
}
