//! What must hold whatever arrives: shared by the fuzzers and by the tests that run the kept corpus.
//!
//! Each function takes arbitrary bytes, feeds them to every decoder of its side and panics only when a
//! promise is broken, so that a fuzzer notices.

use crate::canopen::cia402::{DriveCommand, State, Statusword, transition};
use crate::canopen::emcy::Emergency;
use crate::canopen::nmt::{NmtCommand, NodeState};
use crate::canopen::objects::{Address, at};
use crate::canopen::pdo::{Inputs, Outputs};
use crate::canopen::sdo::{Dictionary, Download, Server, Upload};
use crate::canopen::{Frame, cob};
use crate::wire::{Deframer, Message, WIRE_MAX, encode};

/// Any bytes on the DAQ line: whatever is taken for a message encodes to a frame that decodes to the same
/// message, and after two delimiters a sound frame is always read.
///
/// # Panics
/// When that does not hold.
pub fn daq_line(bytes: &[u8]) {
    let mut deframer = Deframer::new();
    let mut wire = [0; WIRE_MAX];
    deframer.feed(bytes, |found| {
        if let Ok(message) = found {
            let used = encode(&message, &mut wire);
            let mut again = None;
            Deframer::new().feed(&wire[..used], |result| again = result.ok());
            assert_eq!(again, Some(message));
        }
    });
    let sound = Message::Start { token: 0x0102_0304 };
    let used = encode(&sound, &mut wire);
    let mut last = None;
    for _ in 0..2 {
        deframer.feed(&wire[..used], |result| last = result.ok());
    }
    assert_eq!(last, Some(sound));
}

struct Store {
    bytes: [u8; 40],
    used: usize,
}

impl Dictionary for Store {
    fn read(&mut self, address: Address, room: &mut [u8]) -> Result<usize, u32> {
        let length = usize::from(address.sub).min(self.used);
        room.get_mut(..length).ok_or(1_u32)?.copy_from_slice(&self.bytes[..length]);
        Ok(length)
    }

    fn write(&mut self, _: Address, data: &[u8]) -> Result<(), u32> {
        self.bytes.get_mut(..data.len()).ok_or(2_u32)?.copy_from_slice(data);
        self.used = data.len();
        Ok(())
    }
}

/// Any frames on the bus, nine bytes each (identifier, eight data bytes): no decoder panics, and afterwards the server still
/// serves.
///
/// # Panics
/// When that does not hold.
pub fn can_frames(bytes: &[u8]) {
    const NODE: u8 = 5;
    let mut server = Server::new(NODE);
    let mut store = Store { bytes: [7; 40], used: 40 };
    let mut room = [0; 32];
    let data = [3; 23];
    let (mut reading, _) = Upload::new(NODE, at(0x2000, 1), &mut room);
    let (mut writing, _) = Download::new(NODE, at(0x2000, 1), &data);
    let (mut inputs, mut outputs, mut state) = (Inputs::default(), Outputs::default(), State::default());
    for chunk in bytes.chunks(9) {
        let (&id, payload) = chunk.split_first().unwrap_or((&0, &[]));
        let ids = [
            cob::NMT,
            cob::emcy(NODE),
            cob::tpdo(0, NODE),
            cob::tpdo(1, NODE),
            cob::rpdo(0, NODE),
            cob::rpdo(1, NODE),
            cob::sdo_request(NODE),
            cob::sdo_answer(NODE),
            cob::heartbeat(NODE),
        ];
        let frame = Frame::new(ids[usize::from(id) % ids.len()], payload);
        server.on_request(&frame, &mut store);
        // Refusals are what most answers must end in.
        let _ = reading.on_answer(&frame);
        let _ = writing.on_answer(&frame);
        inputs.take(&frame, NODE);
        if outputs.take(&frame, NODE)
            && let Some(command) = DriveCommand::from_word(outputs.controlword)
        {
            let next = transition(state, command);
            assert!(state != State::Fault || command == DriveCommand::FaultReset || next == State::Fault);
            state = next;
        }
        if let Some(told) = Statusword(inputs.statusword).state() {
            assert_eq!(Statusword::from_state(told).state(), Some(told));
        }
        if let Some(emergency) = Emergency::from_frame(&frame, NODE) {
            assert!(!emergency.meaning().is_empty());
            assert_eq!(emergency.frame(NODE), frame);
        }
        NmtCommand::from_frame(&frame, NODE);
        NodeState::from_frame(&frame, NODE);
    }
    let (mut last, first) = Upload::new(NODE, at(0x2000, 4), &mut room);
    let answer = server.on_request(&first, &mut store);
    assert!(answer.is_some_and(|answer| last.on_answer(&answer).is_ok()));
}
