//! What has arrived on the bus and when, by the kernel's own stamps: a device answers when a frame comes, not when
//! a thread that plays it gets the processor.

use crate::canopen::Frame;
use crate::clock::HostClock;
use crate::drive::CanBus;
use nix::errno::Errno;
use nix::sys::socket::{ControlMessageOwned, MsgFlags, recvmsg, setsockopt, sockopt::ReceiveTimestampns};
use nix::sys::time::TimeSpec;
use std::io::{ErrorKind, IoSliceMut};
use std::os::fd::{AsFd, AsRawFd};
use std::time::{Duration, SystemTime, UNIX_EPOCH};
use std::vec;
use std::vec::Vec;

/// A bus whose frames carry the time at which they came.
pub(super) struct Arrivals {
    bus: CanBus,
    clock: HostClock,
    control: Vec<u8>,
    /// Calendar time less time of `clock`, ns, at the last look at both.
    calendar_ns: i128,
    /// Times of `clock`, ns, between which a frame that is in the queue can have come: the last look but one, when the queue was
    /// emptied, and a little after the last. Whatever lies outside is a calendar that was set meanwhile.
    between_ns: (u64, u64),
}

/// Longest time for which the queue is being emptied, by a thread that may be held up meanwhile, ns.
const EMPTYING_NS: u64 = 200_000_000;

impl Arrivals {
    /// Takes a bus and has its arrivals stamped.
    ///
    /// # Errors
    /// The kernel does not stamp what comes through this socket.
    pub fn new(bus: CanBus, clock: HostClock) -> std::io::Result<Self> {
        setsockopt(&bus, ReceiveTimestampns, &true)?;
        Ok(Self { bus, clock, control: nix::cmsg_space!(TimeSpec), calendar_ns: 0, between_ns: (0, 0) })
    }

    /// The bus, to send on.
    pub fn bus(&self) -> &CanBus {
        &self.bus
    }

    /// Waits until something arrives, at most for `timeout`, and gives the time, ns: what came before is in the queue.
    pub fn wait(&mut self, timeout: Duration) -> u64 {
        if self.bus.arrives(timeout).is_err() {
            // A bus that cannot be asked is a silent one; time passes all the same.
            std::thread::sleep(timeout);
        }
        let now_ns = self.clock.now_ns();
        let calendar = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
        self.calendar_ns = calendar.as_nanos() as i128 - i128::from(now_ns);
        self.between_ns = (self.between_ns.1.saturating_sub(EMPTYING_NS), now_ns + EMPTYING_NS);
        now_ns
    }

    /// The next data frame and when it came, ns; `None` when there is no other.
    ///
    /// # Errors
    /// What the system says: the interface is gone or down.
    pub fn next(&mut self) -> std::io::Result<Option<(Frame, u64)>> {
        loop {
            let mut bytes = [0; CAN_FRAME];
            let mut pieces = [IoSliceMut::new(&mut bytes)];
            let socket = self.bus.as_fd().as_raw_fd();
            let flags = MsgFlags::MSG_DONTWAIT;
            let (count, stamp) = match recvmsg::<()>(socket, &mut pieces, Some(&mut self.control), flags) {
                Ok(message) => (message.bytes, stamp(message.cmsgs()?)),
                Err(Errno::EAGAIN) => return Ok(None),
                Err(Errno::EINTR) => continue,
                Err(error) => return Err(error.into()),
            };
            let stamp = stamp.ok_or_else(|| std::io::Error::from(ErrorKind::Unsupported))?;
            if count == CAN_FRAME
                && let Some(frame) = data_frame(&bytes)
            {
                let at_ns = i128::from(stamp.tv_sec()) * 1_000_000_000 + i128::from(stamp.tv_nsec());
                let at_ns = u64::try_from(at_ns - self.calendar_ns).unwrap_or(0);
                return Ok(Some((frame, at_ns.clamp(self.between_ns.0, self.between_ns.1))));
            }
        }
    }
}

fn stamp(mut with: impl Iterator<Item = ControlMessageOwned>) -> Option<TimeSpec> {
    with.find_map(|message| match message {
        ControlMessageOwned::ScmTimestampns(stamp) => Some(stamp),
        _ => None,
    })
}

/// Length of the kernel's `struct can_frame`: identifier with flags, length, three bytes of padding, eight of data
/// (`linux/can.h`).
const CAN_FRAME: usize = 16;
/// Flags of the identifier that make it another thing than a data frame with 11 bits: extended, remote, error.
const NOT_PLAIN: u32 = 0b111 << 29;

fn data_frame(bytes: &[u8; CAN_FRAME]) -> Option<Frame> {
    let [a, b, c, d, length, _, _, _, data @ ..] = bytes;
    let id = u32::from_ne_bytes([*a, *b, *c, *d]);
    let data = data.get(..usize::from(*length))?;
    (id & NOT_PLAIN == 0).then(|| Frame::new((id & 0x7FF) as u16, data))
}
