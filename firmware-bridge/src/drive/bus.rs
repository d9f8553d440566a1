//! A CAN socket that never waits longer than it is told to.

use super::DriveError;
use crate::canopen::Frame;
use rustix::event::{PollFd, PollFlags, Timespec};
use socketcan::{
    CanDataFrame, CanErrorFrame, CanFrame, CanSocket, EmbeddedFrame, Id, Socket, SocketOptions, StandardId,
};
use std::io::ErrorKind;
use std::os::fd::{AsFd, BorrowedFd, OwnedFd};
use std::string::ToString;
use std::time::{Duration, Instant};

/// One thing heard from the bus.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum BusEvent {
    /// A data frame with an 11-bit identifier.
    Frame(Frame),
    /// The controller is off the bus.
    BusOff,
    /// The controller is error-passive or warns: the bus is disturbed but works.
    Disturbed,
    /// The controller is back.
    Restarted,
}

/// A raw CAN socket, or one end of a socket pair that carries the same frames.
#[derive(Debug)]
pub struct CanBus {
    socket: CanSocket,
}

impl CanBus {
    /// Opens a network interface by name (`can0`, `vcan0`) and asks for error frames as well.
    ///
    /// # Errors
    /// [`DriveError::Open`].
    pub fn open(interface: &str) -> Result<Self, DriveError> {
        let failed = |reason| DriveError::Open { interface: interface.into(), reason };
        let socket = CanSocket::open(interface).map_err(|e| failed(e.to_string()))?;
        socket.set_error_filter_accept_all().map_err(|e| failed(e.to_string()))?;
        Self::new(socket).map_err(|e| failed(e.to_string()))
    }

    /// Takes a datagram socket on which whole `can_frame`s travel, for tests without a CAN interface.
    ///
    /// # Errors
    /// What the system says.
    pub fn from_socket(socket: OwnedFd) -> std::io::Result<Self> {
        Self::new(CanSocket::from(socket))
    }

    fn new(socket: CanSocket) -> std::io::Result<Self> {
        socket.set_nonblocking(true)?;
        Ok(Self { socket })
    }

    /// Sends a frame at once.
    ///
    /// # Errors
    /// What the system says; a full queue (nobody acknowledges) is an error, too.
    pub fn send(&self, frame: &Frame) -> std::io::Result<()> {
        let id = StandardId::new(frame.id).ok_or(ErrorKind::InvalidInput)?;
        let frame = CanDataFrame::new(id, frame.data()).ok_or(ErrorKind::InvalidInput)?;
        self.socket.write_frame(&frame)
    }

    /// Sends an error frame that says bus-off. Only a virtual interface passes it on: that is how the
    /// emulator makes the host's controller fail.
    ///
    /// # Errors
    /// What the system says.
    pub fn send_bus_off(&self) -> std::io::Result<()> {
        // CAN_ERR_BUSOFF of linux/can/error.h.
        let frame = CanErrorFrame::new_error(0x40, &[0; 8]).map_err(std::io::Error::other)?;
        self.socket.write_frame(&CanFrame::Error(frame))
    }

    /// What has arrived, without waiting.
    ///
    /// # Errors
    /// What the system says: the interface is gone or down.
    pub fn poll(&mut self) -> std::io::Result<Option<BusEvent>> {
        self.read()
    }

    /// What has arrived or arrives within `timeout`, or nothing.
    ///
    /// # Errors
    /// What the system says: the interface is gone or down.
    pub fn wait(&mut self, timeout: Duration) -> std::io::Result<Option<BusEvent>> {
        if let Some(event) = self.read()? {
            return Ok(Some(event));
        }
        if self.arrives(timeout)? { self.read() } else { Ok(None) }
    }

    /// Waits for something that `pick` wants; other events are dropped. What has come by then is looked at even when this
    /// thread gets the processor only after the time: the drive did answer.
    ///
    /// # Errors
    /// The bus failed, or bus-off.
    pub fn wait_for<T>(
        &mut self,
        timeout: Duration,
        mut pick: impl FnMut(&Frame) -> Option<T>,
    ) -> Result<Option<T>, DriveError> {
        let deadline = Instant::now() + timeout;
        loop {
            let left = deadline.saturating_duration_since(Instant::now());
            match self.wait(left.min(Duration::from_millis(10)))? {
                Some(BusEvent::Frame(frame)) => {
                    if let Some(found) = pick(&frame) {
                        return Ok(Some(found));
                    }
                }
                Some(BusEvent::BusOff) => return Err(DriveError::BusOff),
                Some(_) => {}
                None if left.is_zero() => return Ok(None),
                None => {}
            }
        }
    }

    /// Whether something arrives within `timeout`.
    ///
    /// # Errors
    /// What the system says.
    pub fn arrives(&self, timeout: Duration) -> std::io::Result<bool> {
        let timeout = Timespec { tv_sec: timeout.as_secs() as i64, tv_nsec: timeout.subsec_nanos().into() };
        let mut watched = [PollFd::new(&self.socket, PollFlags::IN)];
        match rustix::event::poll(&mut watched, Some(&timeout)) {
            Ok(ready) => Ok(ready > 0),
            Err(rustix::io::Errno::INTR) => Ok(false),
            Err(error) => Err(error.into()),
        }
    }

    fn read(&self) -> std::io::Result<Option<BusEvent>> {
        loop {
            match self.socket.read_frame() {
                Ok(CanFrame::Data(frame)) => {
                    if let Id::Standard(id) = frame.id() {
                        return Ok(Some(BusEvent::Frame(Frame::new(id.as_raw(), frame.data()))));
                    }
                }
                Ok(CanFrame::Error(frame)) => {
                    let error = frame.into_error();
                    if error.causes().any(|c| matches!(c, socketcan::errors::ErrorCause::BusOff)) {
                        return Ok(Some(BusEvent::BusOff));
                    }
                    if error.causes().any(|c| matches!(c, socketcan::errors::ErrorCause::Restarted)) {
                        return Ok(Some(BusEvent::Restarted));
                    }
                    return Ok(Some(BusEvent::Disturbed));
                }
                Ok(CanFrame::Remote(_)) => {}
                Err(error) if matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut) => {
                    return Ok(None);
                }
                Err(error) if error.kind() == ErrorKind::Interrupted => {}
                Err(error) => return Err(error),
            }
        }
    }
}

impl AsFd for CanBus {
    fn as_fd(&self) -> BorrowedFd<'_> {
        self.socket.as_fd()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::os::unix::net::UnixDatagram;

    #[test]
    fn an_answer_that_waits_is_taken_though_its_time_is_over() {
        let (host, device) = UnixDatagram::pair().expect("a socket pair");
        let device = CanBus::from_socket(device.into()).expect("the device's end");
        let mut host = CanBus::from_socket(host.into()).expect("the host's end");
        for id in [0x705, 0x585] {
            device.send(&Frame::new(id, &[5])).expect("sent");
        }
        let mut answer = || host.wait_for(Duration::ZERO, |frame| (frame.id == 0x585).then_some(*frame));
        assert_eq!(answer().expect("a bus"), Some(Frame::new(0x585, &[5])));
        assert_eq!(answer().expect("a bus"), None);
    }
}
