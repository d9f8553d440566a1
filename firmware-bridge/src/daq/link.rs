//! The thread that owns the serial port during a run.

use super::DaqError;
use crate::clock::{ClockFit, ClockModel, HostClock};
use crate::wire::{CHANNELS, Calibration, Deframer, Message, SampleFrame, WIRE_MAX, encode};
use ringbuf::traits::{Consumer, Producer, Split};
use ringbuf::{HeapCons, HeapProd, HeapRb};
use serialport::TTYPort;
use std::boxed::Box;
use std::io::{ErrorKind, Read, Write};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU8, AtomicU64, Ordering};
use std::thread::JoinHandle;
use std::time::Duration;
use std::vec::Vec;

/// One sample with its place in host time.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct DaqSample {
    /// Sequence number, unwrapped.
    pub sequence: u64,
    /// Device time, us.
    pub device_time_us: u64,
    /// Host time at which it arrived, ns.
    pub arrival_ns: u64,
    /// Values by channel, SI.
    pub values: [f64; CHANNELS],
    /// Status bits of the frame.
    pub status: u16,
}

/// Why the stream ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[repr(u8)]
pub enum DaqFault {
    /// The port is gone.
    #[error("the DAQ's serial port is gone: check the DAQ cable")]
    Unplugged = 1,
    /// No valid sample for longer than allowed.
    #[error("the DAQ has fallen silent: check the DAQ cable and its power")]
    Silent = 2,
}

impl DaqFault {
    fn from_code(code: u8) -> Option<Self> {
        [Self::Unplugged, Self::Silent].into_iter().find(|fault| *fault as u8 == code)
    }
}

#[derive(Debug, Default)]
struct Shared {
    stop: AtomicBool,
    fault: AtomicU8,
    samples: AtomicU64,
    lost: AtomicU64,
    gaps: AtomicU64,
    bad_frames: AtomicU64,
    repeated: AtomicU64,
    ring_overflow: AtomicU64,
    late: AtomicU64,
    worst_late_us: AtomicU64,
    largest_burst: AtomicU64,
    offset_ns: AtomicU64,
    drift_ppm: AtomicU64,
    reference_us: AtomicU64,
}

/// What happened on the line so far.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct DaqCounters {
    /// Samples received.
    pub samples: u64,
    /// Samples missing by their sequence numbers.
    pub lost: u64,
    /// Places where some are missing.
    pub gaps: u64,
    /// Frames that were not accepted.
    pub bad_frames: u64,
    /// Samples whose sequence number had already passed; dropped.
    pub repeated: u64,
    /// Samples that the control thread did not fetch in time; dropped, the sequence number tells which.
    pub ring_overflow: u64,
    /// Samples that came more than 5 ms after their instant.
    pub late: u64,
    /// Worst of them, us after its instant.
    pub worst_late_us: u64,
    /// Most samples delivered at once.
    pub largest_burst: u64,
    /// The device's clock against the host's.
    pub clock: ClockModel,
}

/// A sampling device: samples come out of a ring.
pub struct DaqStream {
    samples: HeapCons<DaqSample>,
    monitor: DaqMonitor,
    thread: Option<JoinHandle<()>>,
}

const LATE_US: f64 = 5_000.0;
const RING_S: f64 = 2.0;

impl DaqStream {
    pub(super) fn spawn(
        started: Started,
        clock: HostClock,
        on_thread: Option<Box<dyn FnOnce() + Send>>,
    ) -> Result<Self, DaqError> {
        let Started { port, deframer, early, calibration, rate_hz, silence } = started;
        let (ring, samples) = HeapRb::new((RING_S * rate_hz) as usize).split();
        let shared = Arc::new(Shared::default());
        let mut receiver = Receiver {
            ring,
            shared: Arc::clone(&shared),
            calibration,
            clock,
            fit: ClockFit::default(),
            expected: 0,
        };
        let thread = std::thread::Builder::new()
            .name("daq-link".into())
            .spawn(move || {
                if let Some(setup) = on_thread {
                    setup();
                }
                let now = clock.now_ns();
                early.iter().for_each(|frame| receiver.take(frame, now));
                receiver.run(port, deframer, silence);
            })
            .map_err(DaqError::Thread)?;
        Ok(Self { samples, monitor: DaqMonitor(shared), thread: Some(thread) })
    }

    /// The next sample, oldest first. Never waits.
    pub fn pop(&mut self) -> Option<DaqSample> {
        self.samples.try_pop()
    }

    /// Why the stream ended, if it has. Samples that came before are still in the ring.
    pub fn fault(&self) -> Option<DaqFault> {
        self.monitor.fault()
    }

    /// Counters and clock model.
    pub fn counters(&self) -> DaqCounters {
        self.monitor.counters()
    }

    /// A second pair of eyes, for another thread.
    pub fn monitor(&self) -> DaqMonitor {
        self.monitor.clone()
    }
}

/// Tells how the line does, from any thread, also after the stream is gone.
#[derive(Clone, Debug)]
pub struct DaqMonitor(Arc<Shared>);

impl DaqMonitor {
    /// Why the stream ended, if it has.
    pub fn fault(&self) -> Option<DaqFault> {
        DaqFault::from_code(self.0.fault.load(Ordering::Acquire))
    }

    /// Counters and clock model.
    pub fn counters(&self) -> DaqCounters {
        let get = |counter: &AtomicU64| counter.load(Ordering::Relaxed);
        let float = |bits: &AtomicU64| f64::from_bits(bits.load(Ordering::Relaxed));
        let s = &*self.0;
        DaqCounters {
            samples: get(&s.samples),
            lost: get(&s.lost),
            gaps: get(&s.gaps),
            bad_frames: get(&s.bad_frames),
            repeated: get(&s.repeated),
            ring_overflow: get(&s.ring_overflow),
            late: get(&s.late),
            worst_late_us: get(&s.worst_late_us),
            largest_burst: get(&s.largest_burst),
            clock: ClockModel {
                offset_ns: float(&s.offset_ns),
                drift_ppm: float(&s.drift_ppm),
                reference_us: float(&s.reference_us),
            },
        }
    }
}

impl Drop for DaqStream {
    fn drop(&mut self) {
        self.monitor.0.stop.store(true, Ordering::Release);
        if let Some(thread) = self.thread.take() {
            // A panic on the link thread has been printed by the runtime; nothing is left to do here.
            let _ = thread.join();
        }
    }
}

/// What the session hands over to the thread.
pub(super) struct Started {
    pub port: TTYPort,
    pub deframer: Deframer,
    /// Samples that came in one piece with the answer to start.
    pub early: Vec<SampleFrame>,
    pub calibration: [Calibration; CHANNELS],
    pub rate_hz: f64,
    pub silence: Duration,
}

struct Receiver {
    ring: HeapProd<DaqSample>,
    shared: Arc<Shared>,
    calibration: [Calibration; CHANNELS],
    clock: HostClock,
    fit: ClockFit,
    expected: u64,
}

impl Receiver {
    fn run(&mut self, mut port: TTYPort, mut deframer: Deframer, silence: Duration) {
        let mut buffer = [0; 8192];
        let mut last_valid_ns = self.clock.now_ns();
        let silence_ns = silence.as_nanos() as u64;
        while !self.shared.stop.load(Ordering::Acquire) {
            let count = match port.read(&mut buffer) {
                Ok(0) => return self.end(DaqFault::Unplugged),
                Ok(count) => count,
                Err(error) if matches!(error.kind(), ErrorKind::TimedOut | ErrorKind::Interrupted) => 0,
                Err(_) => return self.end(DaqFault::Unplugged),
            };
            let now = self.clock.now_ns();
            let mut burst = 0;
            deframer.feed(&buffer[..count], |found| match found {
                Ok(Message::Sample(frame)) => {
                    burst += 1;
                    self.take(&frame, now);
                }
                Ok(_) => {}
                Err(_) => add(&self.shared.bad_frames, 1),
            });
            self.shared.largest_burst.fetch_max(burst, Ordering::Relaxed);
            if burst > 0 {
                last_valid_ns = now;
            } else if now - last_valid_ns > silence_ns {
                return self.end(DaqFault::Silent);
            }
        }
        let mut wire = [0; WIRE_MAX];
        let used = encode(&Message::Stop, &mut wire);
        // The run is over; a device that is gone by now needs no stop.
        let _ = port.write_all(&wire[..used]);
    }

    fn end(&self, fault: DaqFault) {
        self.shared.fault.store(fault as u8, Ordering::Release);
    }

    fn take(&mut self, frame: &SampleFrame, now_ns: u64) {
        // The sequence number starts at 0, so that samples lost right after the start are counted, too.
        let step = frame.sequence.wrapping_sub(self.expected as u32);
        if step > u32::MAX / 2 {
            add(&self.shared.repeated, 1);
            return;
        }
        if step > 0 {
            add(&self.shared.gaps, 1);
            add(&self.shared.lost, step.into());
        }
        let sequence = self.expected + u64::from(step);
        self.expected = sequence + 1;
        self.time(frame.device_time_us, now_ns);
        let sample = DaqSample {
            sequence,
            device_time_us: frame.device_time_us,
            arrival_ns: now_ns,
            values: std::array::from_fn(|i| self.calibration[i].value(frame.counts[i])),
            status: frame.status,
        };
        add(&self.shared.samples, 1);
        if self.ring.try_push(sample).is_err() {
            add(&self.shared.ring_overflow, 1);
        }
    }

    fn time(&mut self, device_us: u64, now_ns: u64) {
        if self.fit.observe(device_us, now_ns) {
            let model = self.fit.model();
            self.shared.offset_ns.store(model.offset_ns.to_bits(), Ordering::Relaxed);
            self.shared.drift_ppm.store(model.drift_ppm.to_bits(), Ordering::Relaxed);
            self.shared.reference_us.store(model.reference_us.to_bits(), Ordering::Relaxed);
        }
        let late_us = (now_ns as f64 - self.fit.model().host_ns(device_us)) * 1e-3;
        if late_us > LATE_US {
            add(&self.shared.late, 1);
            self.shared.worst_late_us.fetch_max(late_us as u64, Ordering::Relaxed);
        }
    }
}

fn add(counter: &AtomicU64, count: u64) {
    counter.fetch_add(count, Ordering::Relaxed);
}
