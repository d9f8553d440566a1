//! Service data objects (CiA 301, 7.2.4): reading and writing the dictionary of a node, expedited and
//! segmented. [`Download`] and [`Upload`] are the client's side, [`Server`] is the node's.
//!
//! Both sides are state machines without input or output: they take a frame and say what to send.

use super::objects::Address;
use super::{Frame, cob};

/// Abort codes that are made here (CiA 301, table 22); others come from the peer as numbers.
pub mod abort {
    /// Toggle bit not alternated.
    pub const TOGGLE: u32 = 0x0503_0000;
    /// Command specifier unknown.
    pub const COMMAND: u32 = 0x0504_0001;
    /// Write to a read-only object.
    pub const READ_ONLY: u32 = 0x0601_0002;
    /// Object does not exist.
    pub const NO_OBJECT: u32 = 0x0602_0000;
    /// The object cannot be mapped to a PDO.
    pub const NOT_MAPPABLE: u32 = 0x0604_0041;
    /// The mapping exceeds the length of a PDO.
    pub const PDO_LENGTH: u32 = 0x0604_0042;
    /// Length does not match.
    pub const LENGTH: u32 = 0x0607_0010;
    /// Sub-index does not exist.
    pub const NO_SUB_INDEX: u32 = 0x0609_0011;
    /// Value out of range.
    pub const VALUE: u32 = 0x0609_0030;
    /// Not in the present device state.
    pub const STATE: u32 = 0x0800_0022;
}

/// What an abort code means.
pub fn abort_meaning(code: u32) -> &'static str {
    match code {
        abort::TOGGLE => "toggle bit not alternated",
        0x0504_0000 => "timed out",
        abort::COMMAND => "command not known",
        0x0601_0000 => "access not supported",
        0x0601_0001 => "object is write-only",
        abort::READ_ONLY => "object is read-only",
        abort::NO_OBJECT => "object does not exist",
        abort::NOT_MAPPABLE => "object cannot be mapped to a PDO",
        abort::PDO_LENGTH => "mapping exceeds the PDO",
        abort::LENGTH | 0x0607_0012 | 0x0607_0013 => "length does not match",
        abort::NO_SUB_INDEX => "sub-index does not exist",
        abort::VALUE => "value out of range",
        0x0609_0031 => "value too high",
        0x0609_0032 => "value too low",
        0x0800_0000..=0x0800_0021 => "cannot be stored or transferred",
        abort::STATE => "not in the present device state",
        _ => "see CiA 301, table 22",
    }
}

/// Why a transfer ended without a result.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum SdoError {
    /// The other side broke off.
    #[error("the node refused {address} with abort code {code:#010x}")]
    Aborted {
        /// Object asked for.
        address: Address,
        /// Code of CiA 301, table 22.
        code: u32,
    },
    /// An answer that does not belong to the request.
    #[error("the node gave an answer to {address} that does not belong there")]
    Unexpected {
        /// Object asked for.
        address: Address,
    },
    /// The object is longer than the room for it.
    #[error("{address} is longer than {room} bytes")]
    TooLong {
        /// Object asked for.
        address: Address,
        /// Bytes that would fit.
        room: usize,
    },
}

/// What to do after an answer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Step {
    /// Send this and wait for the next answer.
    Send(Frame),
    /// The transfer is complete; an upload holds so many bytes.
    Done(usize),
}

const EXPEDITED_WITH_SIZE: u8 = 0x03;

fn request(node: u8, command: u8, address: Address, data: [u8; 4]) -> Frame {
    let [low, high] = address.index.to_le_bytes();
    let [a, b, c, d] = data;
    Frame::new(cob::sdo_request(node), &[command, low, high, address.sub, a, b, c, d])
}

/// Splits an answer into command, address and the last four bytes; an abort becomes an error.
fn answer(frame: &Frame, address: Address) -> Result<(u8, Address, [u8; 4]), SdoError> {
    let &[command, low, high, sub, a, b, c, d] = frame.full().ok_or(SdoError::Unexpected { address })?;
    if command == 0x80 {
        return Err(SdoError::Aborted { address, code: u32::from_le_bytes([a, b, c, d]) });
    }
    Ok((command, Address { index: u16::from_le_bytes([low, high]), sub }, [a, b, c, d]))
}

/// A write to the dictionary of a node.
#[derive(Debug)]
pub struct Download<'a> {
    node: u8,
    address: Address,
    rest: &'a [u8],
    toggle: u8,
    started: bool,
    last_sent: bool,
}

impl<'a> Download<'a> {
    /// Starts: the transfer and its first frame. Up to 4 bytes go expedited, more in segments.
    pub fn new(node: u8, address: Address, data: &'a [u8]) -> (Self, Frame) {
        let mut this = Self { node, address, rest: data, toggle: 0, started: false, last_sent: false };
        let first = match data.len() {
            length @ 1..=4 => {
                let mut bytes = [0; 4];
                bytes[..length].copy_from_slice(data);
                this.rest = &[];
                this.last_sent = true;
                request(node, 0x20 | ((4 - length as u8) << 2) | EXPEDITED_WITH_SIZE, address, bytes)
            }
            length => request(node, 0x21, address, (length as u32).to_le_bytes()),
        };
        (this, first)
    }

    /// Takes the answer of the node.
    ///
    /// # Errors
    /// [`SdoError`]; the transfer is over then.
    pub fn on_answer(&mut self, frame: &Frame) -> Result<Step, SdoError> {
        let unexpected = SdoError::Unexpected { address: self.address };
        let (command, address, _) = answer(frame, self.address)?;
        if !self.started {
            if command != 0x60 || address != self.address {
                return Err(unexpected);
            }
            self.started = true;
        } else if command & 0xF0 == 0x20 | (self.toggle ^ 0x10) {
            // Answer to the segment sent before; `toggle` is already that of the next one.
        } else {
            return Err(unexpected);
        }
        if self.last_sent {
            return Ok(Step::Done(0));
        }
        let (now, rest) = self.rest.split_at(self.rest.len().min(7));
        let mut bytes = [0; 8];
        bytes[1..=now.len()].copy_from_slice(now);
        bytes[0] = self.toggle | ((7 - now.len() as u8) << 1) | u8::from(rest.is_empty());
        self.last_sent = rest.is_empty();
        self.rest = rest;
        self.toggle ^= 0x10;
        Ok(Step::Send(Frame::new(cob::sdo_request(self.node), &bytes)))
    }
}

/// A read from the dictionary of a node.
#[derive(Debug)]
pub struct Upload<'a> {
    node: u8,
    address: Address,
    room: &'a mut [u8],
    used: usize,
    toggle: u8,
    started: bool,
}

impl<'a> Upload<'a> {
    /// Starts: the transfer and its first frame; the value goes to the start of `room`.
    pub fn new(node: u8, address: Address, room: &'a mut [u8]) -> (Self, Frame) {
        let first = request(node, 0x40, address, [0; 4]);
        (Self { node, address, room, used: 0, toggle: 0, started: false }, first)
    }

    fn keep(&mut self, bytes: &[u8]) -> Result<(), SdoError> {
        let too_long = SdoError::TooLong { address: self.address, room: self.room.len() };
        let room = self.room.get_mut(self.used..self.used + bytes.len()).ok_or(too_long)?;
        room.copy_from_slice(bytes);
        self.used += bytes.len();
        Ok(())
    }

    /// Takes the answer of the node.
    ///
    /// # Errors
    /// [`SdoError`]; the transfer is over then.
    pub fn on_answer(&mut self, frame: &Frame) -> Result<Step, SdoError> {
        let unexpected = SdoError::Unexpected { address: self.address };
        let (command, address, data) = answer(frame, self.address)?;
        if !self.started {
            if command & 0xE0 != 0x40 || address != self.address {
                return Err(unexpected);
            }
            self.started = true;
            if command & 0x02 != 0 {
                // Expedited; without the size bit all four bytes count.
                let unused = if command & 0x01 != 0 { usize::from(command >> 2 & 0x03) } else { 0 };
                self.keep(&data[..4 - unused])?;
                return Ok(Step::Done(self.used));
            }
        } else {
            if command & 0xF0 != self.toggle {
                return Err(unexpected);
            }
            let unused = usize::from(command >> 1 & 0x07);
            let bytes = frame.full().ok_or(unexpected)?;
            self.keep(&bytes[1..8 - unused])?;
            if command & 0x01 != 0 {
                return Ok(Step::Done(self.used));
            }
            self.toggle ^= 0x10;
        }
        let next = Frame::new(cob::sdo_request(self.node), &[0x60 | self.toggle, 0, 0, 0, 0, 0, 0, 0]);
        Ok(Step::Send(next))
    }
}

/// The dictionary behind a [`Server`].
pub trait Dictionary {
    /// Writes the value of an object to the start of `room` and returns its length, bytes.
    ///
    /// # Errors
    /// An abort code of [`abort`].
    fn read(&mut self, address: Address, room: &mut [u8]) -> Result<usize, u32>;

    /// Sets an object.
    ///
    /// # Errors
    /// An abort code of [`abort`].
    fn write(&mut self, address: Address, data: &[u8]) -> Result<(), u32>;
}

/// Longest object that a server handles, bytes.
pub const SERVER_ROOM: usize = 128;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum ServerState {
    Idle,
    Sending,
    Receiving,
}

/// The node's side of the default SDO channel.
#[derive(Debug)]
pub struct Server {
    node: u8,
    state: ServerState,
    address: Address,
    bytes: [u8; SERVER_ROOM],
    length: usize,
    done: usize,
    toggle: u8,
}

impl Server {
    /// The server of a node.
    pub fn new(node: u8) -> Self {
        let address = Address { index: 0, sub: 0 };
        Self {
            node,
            state: ServerState::Idle,
            address,
            bytes: [0; SERVER_ROOM],
            length: 0,
            done: 0,
            toggle: 0,
        }
    }

    /// Takes a frame; the answer, if it was a request to this node.
    pub fn on_request(&mut self, frame: &Frame, dictionary: &mut impl Dictionary) -> Option<Frame> {
        if frame.id != cob::sdo_request(self.node) {
            return None;
        }
        let &bytes = frame.full()?;
        if bytes[0] == 0x80 {
            self.state = ServerState::Idle;
            return None;
        }
        Some(self.serve(&bytes, dictionary).unwrap_or_else(|code| {
            self.state = ServerState::Idle;
            self.answer(0x80, code.to_le_bytes())
        }))
    }

    fn answer(&self, command: u8, data: [u8; 4]) -> Frame {
        let mut frame = request(self.node, command, self.address, data);
        frame.id = cob::sdo_answer(self.node);
        frame
    }

    fn serve(&mut self, bytes: &[u8; 8], dictionary: &mut impl Dictionary) -> Result<Frame, u32> {
        let [command, low, high, sub, data @ ..] = *bytes;
        let initiate = Address { index: u16::from_le_bytes([low, high]), sub };
        match (command >> 5, self.state) {
            (1, _) => {
                self.address = initiate;
                self.begin_download(command, data, dictionary)
            }
            (2, _) => {
                self.address = initiate;
                self.begin_upload(dictionary)
            }
            (0, ServerState::Receiving) => self.receive_segment(bytes, dictionary),
            (3, ServerState::Sending) => self.send_segment(command),
            _ => Err(abort::COMMAND),
        }
    }

    fn begin_download(&mut self, command: u8, data: [u8; 4], to: &mut impl Dictionary) -> Result<Frame, u32> {
        if command & 0x02 != 0 {
            let unused = if command & 0x01 != 0 { usize::from(command >> 2 & 0x03) } else { 0 };
            self.state = ServerState::Idle;
            to.write(self.address, &data[..4 - unused])?;
        } else {
            let announced = if command & 0x01 != 0 { u32::from_le_bytes(data) as usize } else { 0 };
            if announced > SERVER_ROOM {
                return Err(abort::LENGTH);
            }
            (self.state, self.length, self.done, self.toggle) = (ServerState::Receiving, announced, 0, 0);
        }
        Ok(self.answer(0x60, [0; 4]))
    }

    fn receive_segment(&mut self, bytes: &[u8; 8], to: &mut impl Dictionary) -> Result<Frame, u32> {
        let command = bytes[0];
        if command & 0x10 != self.toggle {
            return Err(abort::TOGGLE);
        }
        let segment = &bytes[1..8 - usize::from(command >> 1 & 0x07)];
        let room = self.bytes.get_mut(self.done..self.done + segment.len()).ok_or(abort::LENGTH)?;
        room.copy_from_slice(segment);
        self.done += segment.len();
        if command & 0x01 != 0 {
            self.state = ServerState::Idle;
            if self.length != 0 && self.length != self.done {
                return Err(abort::LENGTH);
            }
            to.write(self.address, &self.bytes[..self.done])?;
        }
        let answer = Frame::new(cob::sdo_answer(self.node), &[0x20 | self.toggle, 0, 0, 0, 0, 0, 0, 0]);
        self.toggle ^= 0x10;
        Ok(answer)
    }

    fn begin_upload(&mut self, from: &mut impl Dictionary) -> Result<Frame, u32> {
        self.length = from.read(self.address, &mut self.bytes)?.min(SERVER_ROOM);
        if (1..=4).contains(&self.length) {
            self.state = ServerState::Idle;
            let mut data = [0; 4];
            data[..self.length].copy_from_slice(&self.bytes[..self.length]);
            return Ok(self.answer(0x40 | ((4 - self.length as u8) << 2) | EXPEDITED_WITH_SIZE, data));
        }
        (self.state, self.done, self.toggle) = (ServerState::Sending, 0, 0);
        Ok(self.answer(0x41, (self.length as u32).to_le_bytes()))
    }

    fn send_segment(&mut self, command: u8) -> Result<Frame, u32> {
        if command & 0x10 != self.toggle {
            return Err(abort::TOGGLE);
        }
        let segment = &self.bytes[self.done..self.length.min(self.done + 7)];
        let last = self.done + segment.len() == self.length;
        let mut bytes = [0; 8];
        bytes[0] = self.toggle | ((7 - segment.len() as u8) << 1) | u8::from(last);
        bytes[1..=segment.len()].copy_from_slice(segment);
        self.done += segment.len();
        self.toggle ^= 0x10;
        if last {
            self.state = ServerState::Idle;
        }
        Ok(Frame::new(cob::sdo_answer(self.node), &bytes))
    }
}
