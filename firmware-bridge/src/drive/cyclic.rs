//! The thread that talks with the drive once a cycle while a run is on.
//!
//! Commands are meant for instants of host time; at each SYNC the latest is carried forward to the even grid of
//! the cycle by its velocity and acceleration, so that neither the jitter of this thread nor that of the
//! control thread reaches the table.

use super::status::Shared;
use super::{
    BusEvent, DriveCounters, DriveError, DriveFault, DriveSettings, Phase, ReadyDrive, Sequencer, Wish,
};
use crate::canopen::cia402::Statusword;
use crate::canopen::emcy::Emergency;
use crate::canopen::nmt::{self, NodeState};
use crate::canopen::pdo::{Inputs, Outputs};
use crate::clock::HostClock;
use ringbuf::traits::{Consumer, Producer, Split};
use ringbuf::{HeapCons, HeapProd, HeapRb};
use std::boxed::Box;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::thread::JoinHandle;

/// A command and the host time for which it is meant.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct TimedCommand {
    /// Host time, ns.
    pub at_ns: u64,
    /// Displacement, m.
    pub displacement_m: f64,
    /// Velocity, m/s.
    pub velocity_m_s: f64,
    /// Acceleration, m/s2.
    pub acceleration_m_s2: f64,
}

/// A drive in cyclic operation.
pub struct DriveStream {
    commands: HeapProd<TimedCommand>,
    monitor: DriveMonitor,
    thread: Option<JoinHandle<()>>,
}

const RING: usize = 4096;

impl ReadyDrive {
    /// Starts the exchange on a thread of its own; the drive stays off until [`DriveStream::wish`]. `on_thread`
    /// runs first on that thread (for its scheduling).
    ///
    /// # Errors
    /// [`DriveError::Thread`].
    pub fn start(
        self,
        clock: HostClock,
        on_thread: Option<Box<dyn FnOnce() + Send>>,
    ) -> Result<DriveStream, DriveError> {
        let (producer, commands) = HeapRb::new(RING).split();
        let shared = Arc::new(Shared::default());
        let counts_per_m = self.settings.units.counts_per_m;
        let mut cycle = Cycle::new(self, clock, commands, Arc::clone(&shared));
        let thread = std::thread::Builder::new()
            .name("drive-link".into())
            .spawn(move || {
                if let Some(setup) = on_thread {
                    setup();
                }
                cycle.run();
            })
            .map_err(DriveError::Thread)?;
        let monitor = DriveMonitor { shared, counts_per_m };
        Ok(DriveStream { commands: producer, monitor, thread: Some(thread) })
    }
}

impl DriveStream {
    /// Hands over a command; never waits. A full ring means that the link thread is dead, which its fault says.
    pub fn command(&mut self, command: TimedCommand) {
        // The link extrapolates from the last command it has and stops when that gets stale.
        let _ = self.commands.try_push(command);
    }

    /// Sets what is wanted of the drive; never waits.
    pub fn wish(&self, wish: Wish) {
        self.monitor.shared.wish.store(wish as u8, Ordering::Release);
    }

    /// Where the drive stands.
    pub fn phase(&self) -> Phase {
        self.monitor.phase()
    }

    /// The first fault, if any.
    pub fn fault(&self) -> Option<DriveFault> {
        self.monitor.fault()
    }

    /// Position that the drive reports, m.
    pub fn position_m(&self) -> f64 {
        self.monitor.position_m()
    }

    /// Counters.
    pub fn counters(&self) -> DriveCounters {
        self.monitor.counters()
    }

    /// A second pair of eyes, for another thread.
    pub fn monitor(&self) -> DriveMonitor {
        self.monitor.clone()
    }
}

/// Tells how the drive does, from any thread, also after the stream is gone.
#[derive(Clone, Debug)]
pub struct DriveMonitor {
    shared: Arc<Shared>,
    counts_per_m: f64,
}

impl DriveMonitor {
    /// Where the drive stands.
    pub fn phase(&self) -> Phase {
        self.shared.phase()
    }

    /// The first fault, if any.
    pub fn fault(&self) -> Option<DriveFault> {
        self.shared.fault()
    }

    /// Position that the drive reports, m.
    pub fn position_m(&self) -> f64 {
        f64::from(self.shared.position.load(Ordering::Relaxed)) / self.counts_per_m
    }

    /// Following error that the drive reports, m.
    pub fn following_error_m(&self) -> f64 {
        f64::from(self.shared.following_error.load(Ordering::Relaxed)) / self.counts_per_m
    }

    /// Counters.
    pub fn counters(&self) -> DriveCounters {
        self.shared.counters()
    }
}

impl Drop for DriveStream {
    fn drop(&mut self) {
        self.monitor.shared.stop.store(true, Ordering::Release);
        if let Some(thread) = self.thread.take() {
            // A panic on the link thread has been printed by the runtime; the drive stops by its time-outs.
            let _ = thread.join();
        }
    }
}

struct Cycle {
    drive: ReadyDrive,
    clock: HostClock,
    commands: HeapCons<TimedCommand>,
    shared: Arc<Shared>,
    sequencer: Sequencer,
    inputs: Inputs,
    heard: Heard,
    latest: Option<TimedCommand>,
    /// Last target sent, m; the drive's own position until the first command.
    target_m: f64,
    heartbeat_at_ns: u64,
    cycle_ns: u64,
    unsent: u32,
}

/// When something was last heard.
#[derive(Clone, Copy, Default)]
struct Heard {
    inputs: bool,
    cycles_without: u32,
    heartbeat_ns: u64,
}

/// Time allowed for braking at the end, ns.
const LEAVE_NS: u64 = 1_000_000_000;
/// Below this speed the table is at rest, m/s.
const AT_REST_M_S: f64 = 1e-3;
/// Cycles in a row in which nothing could be sent before that is a fault.
const UNSENT_CYCLES: u32 = 10;

impl Cycle {
    fn new(
        drive: ReadyDrive,
        clock: HostClock,
        commands: HeapCons<TimedCommand>,
        shared: Arc<Shared>,
    ) -> Self {
        let cycle_ns = drive.settings.cycle.as_nanos() as u64;
        let heard = Heard { heartbeat_ns: clock.now_ns(), ..Heard::default() };
        Self {
            drive,
            clock,
            commands,
            shared,
            sequencer: Sequencer::default(),
            inputs: Inputs::default(),
            heard,
            latest: None,
            target_m: 0.0,
            heartbeat_at_ns: 0,
            cycle_ns,
            unsent: 0,
        }
    }

    fn settings(&self) -> &DriveSettings {
        &self.drive.settings
    }

    fn run(&mut self) {
        let mut deadline_ns = self.clock.now_ns() + self.cycle_ns;
        let mut leaving_until_ns = None;
        loop {
            let late_ns = self.clock.sleep_until(deadline_ns);
            let now_ns = deadline_ns + late_ns;
            self.shared.worst_late_ns.fetch_max(late_ns, Ordering::Relaxed);
            // Whole periods that have passed are skipped before the exchange, the phase is kept: what goes out now is
            // the target for now. The one for the deadline would throw the table back by all that lies between.
            let skipped = late_ns / self.cycle_ns;
            add(&self.shared.skipped, skipped);
            deadline_ns += skipped * self.cycle_ns;
            if self.shared.stop.load(Ordering::Acquire) {
                // Never cut the power of a moving table: its drive brakes first.
                let until = *leaving_until_ns.get_or_insert(deadline_ns + LEAVE_NS);
                self.shared.wish.store(Wish::QuickStop as u8, Ordering::Release);
                if deadline_ns > until || !self.moving() {
                    break;
                }
            }
            self.listen(now_ns);
            self.exchange(deadline_ns, now_ns, 1 + skipped);
            self.heartbeat(deadline_ns);
            add(&self.shared.cycles, 1);
            deadline_ns += self.cycle_ns;
        }
        self.leave();
    }

    fn moving(&self) -> bool {
        let units = self.settings().units;
        let speed_m_s = f64::from(self.inputs.velocity) / units.velocity_per_m_s;
        let reachable = !self.shared.fault().is_some_and(DriveFault::is_link);
        let stopping = self.sequencer.phase() == Phase::Stopping && speed_m_s.abs() > AT_REST_M_S;
        reachable && (self.sequencer.phase() == Phase::Enabled || stopping)
    }

    /// Takes all that has come since the last cycle.
    fn listen(&mut self, now_ns: u64) {
        let node = self.settings().node;
        self.heard.inputs = false;
        loop {
            let event = match self.drive.bus.poll() {
                Ok(Some(event)) => event,
                Ok(None) => return,
                // The interface went down or away; what cannot be heard shows as silence as well.
                Err(_) => return self.shared.latch(DriveFault::BusOff),
            };
            match event {
                BusEvent::Frame(frame) => {
                    if self.inputs.take(&frame, node) == Some(0) {
                        self.heard.inputs = true;
                    } else if let Some(state) = NodeState::from_frame(&frame, node) {
                        self.heard.heartbeat_ns = now_ns;
                        if state != NodeState::Operational {
                            self.shared.latch(DriveFault::Restarted);
                        }
                    } else if let Some(emergency) = Emergency::from_frame(&frame, node)
                        && emergency.code != 0
                    {
                        self.shared.latch(DriveFault::Tripped { code: emergency.code });
                    }
                }
                BusEvent::BusOff => self.shared.latch(DriveFault::BusOff),
                BusEvent::Disturbed => add(&self.shared.disturbed, 1),
                BusEvent::Restarted => {}
            }
        }
    }

    fn exchange(&mut self, deadline_ns: u64, now_ns: u64, periods: u64) {
        self.watch(now_ns);
        while let Some(command) = self.commands.try_pop() {
            self.latest = Some(command);
            add(&self.shared.commands, 1);
        }
        let mut wish = Wish::from_code(self.shared.wish.load(Ordering::Acquire));
        let target = self.target(deadline_ns, periods);
        if self.shared.fault().is_some() && wish == Wish::Enable {
            wish = Wish::QuickStop;
        }
        let (outputs, left) = self.sequencer.step(Statusword(self.inputs.statusword), wish, target);
        // An EMCY or a restart says more than the state alone, and comes in the same cycle or before.
        if let Some(fault) = left {
            self.shared.latch(fault);
        }
        self.shared.phase.store(self.sequencer.phase() as u8, Ordering::Release);
        self.shared.position.store(self.inputs.position, Ordering::Relaxed);
        self.shared.following_error.store(self.inputs.following_error, Ordering::Relaxed);
        self.send(&outputs);
    }

    /// What is missing from the drive.
    fn watch(&mut self, now_ns: u64) {
        self.heard.cycles_without = if self.heard.inputs { 0 } else { self.heard.cycles_without + 1 };
        if !self.heard.inputs && self.shared.cycles.load(Ordering::Relaxed) > 2 {
            add(&self.shared.missed_inputs, 1);
        }
        let silent_ns = now_ns.saturating_sub(self.heard.heartbeat_ns);
        let heartbeat_lost = silent_ns > 3 * self.settings().drive_heartbeat.as_nanos() as u64;
        if heartbeat_lost || self.heard.cycles_without > self.settings().missed_cycles {
            self.shared.latch(DriveFault::Silent);
        }
    }

    /// The target for the SYNC at `deadline_ns`, in the drive's units.
    fn target(&mut self, deadline_ns: u64, periods: u64) -> Outputs {
        let units = self.settings().units;
        let phase = self.sequencer.phase();
        if phase != Phase::Enabled {
            // Where the drive is, so that enabling does not move it.
            self.target_m = f64::from(self.inputs.position) / units.counts_per_m;
            self.latest = None;
            return Outputs { target_position: self.inputs.position, ..Outputs::default() };
        }
        let Some(command) = self.latest else {
            return Outputs {
                target_position: counts(self.target_m * units.counts_per_m),
                ..Outputs::default()
            };
        };
        let ahead_ns = deadline_ns as f64 - command.at_ns as f64;
        // A table that was told to rest needs no fresh commands: nobody dies between two runs.
        let rests = command.velocity_m_s == 0.0 && command.acceleration_m_s2 == 0.0;
        if !rests && ahead_ns > self.settings().command_stale.as_nanos() as f64 {
            self.shared.latch(DriveFault::CommandsStale);
        }
        let t = ahead_ns * 1e-9;
        let velocity_m_s = command.velocity_m_s + command.acceleration_m_s2 * t;
        let target_m =
            command.displacement_m + (command.velocity_m_s + 0.5 * command.acceleration_m_s2 * t) * t;
        let room_m = self.settings().speed_limit_m_s * periods as f64 * self.cycle_ns as f64 * 1e-9;
        if !target_m.is_finite() || (target_m - self.target_m).abs() > room_m {
            self.shared.latch(DriveFault::CommandJump);
            return Outputs {
                target_position: counts(self.target_m * units.counts_per_m),
                ..Outputs::default()
            };
        }
        self.target_m = target_m;
        Outputs {
            controlword: 0,
            target_position: counts(target_m * units.counts_per_m),
            velocity_offset: counts(velocity_m_s * units.velocity_per_m_s),
            torque_offset: counts(command.acceleration_m_s2 * units.torque_per_m_s2)
                .clamp(i32::from(i16::MIN), i32::from(i16::MAX)) as i16,
        }
    }

    fn send(&mut self, outputs: &Outputs) {
        let [first, second] = outputs.frames(self.settings().node);
        let mut failed = 0;
        for frame in [first, second, nmt::sync()] {
            failed += u32::from(self.drive.bus.send(&frame).is_err());
        }
        if failed == 0 {
            self.unsent = 0;
            return;
        }
        add(&self.shared.send_failures, failed.into());
        self.unsent += 1;
        if self.unsent >= UNSENT_CYCLES {
            self.shared.latch(DriveFault::CannotSend);
        }
    }

    /// The host's heartbeat, three times within the time that the drive allows.
    fn heartbeat(&mut self, now_ns: u64) {
        if now_ns < self.heartbeat_at_ns {
            return;
        }
        self.heartbeat_at_ns = now_ns + self.settings().host_lost.as_nanos() as u64 / 3;
        let frame = NodeState::Operational.frame(self.settings().host_node);
        if self.drive.bus.send(&frame).is_err() {
            add(&self.shared.send_failures, 1);
        }
    }

    /// The end of the run: power off, then the node out of operation so that its time-outs rest.
    fn leave(&mut self) {
        use crate::canopen::nmt::NmtCommand;
        let off = Outputs { target_position: self.inputs.position, ..Outputs::default() };
        self.send(&off);
        // A drive that cannot be reached any more has its own time-outs.
        let _ = self.drive.bus.send(&NmtCommand::EnterPreOperational.frame(self.settings().node));
    }
}

fn counts(value: f64) -> i32 {
    // The cast cuts to the range of the type.
    value.round() as i32
}

fn add(counter: &AtomicU64, count: u64) {
    counter.fetch_add(count, Ordering::Relaxed);
}
