//! SDO client against server over every length, and what happens when an answer does not belong.

use firmware_bridge::canopen::objects::{Address, at};
use firmware_bridge::canopen::sdo::{
    Dictionary, Download, SERVER_ROOM, SdoError, Server, Step, Upload, abort,
};
use firmware_bridge::canopen::{Frame, cob};
use proptest::prelude::*;

const NODE: u8 = 5;

/// One object of any length.
#[derive(Default)]
struct Store(Vec<u8>);

impl Dictionary for Store {
    fn read(&mut self, address: Address, room: &mut [u8]) -> Result<usize, u32> {
        if address.index != 0x2000 {
            return Err(abort::NO_OBJECT);
        }
        room[..self.0.len()].copy_from_slice(&self.0);
        Ok(self.0.len())
    }

    fn write(&mut self, address: Address, data: &[u8]) -> Result<(), u32> {
        if address.index != 0x2000 {
            return Err(abort::READ_ONLY);
        }
        self.0 = data.to_vec();
        Ok(())
    }
}

fn download(
    server: &mut Server,
    store: &mut Store,
    address: Address,
    data: &[u8],
) -> Result<usize, SdoError> {
    let (mut client, mut frame) = Download::new(NODE, address, data);
    loop {
        let answer = server.on_request(&frame, store).expect("an answer");
        match client.on_answer(&answer)? {
            Step::Send(next) => frame = next,
            Step::Done(length) => return Ok(length),
        }
    }
}

fn upload(
    server: &mut Server,
    store: &mut Store,
    address: Address,
    room: &mut [u8],
) -> Result<usize, SdoError> {
    let (mut client, mut frame) = Upload::new(NODE, address, room);
    loop {
        let answer = server.on_request(&frame, store).expect("an answer");
        match client.on_answer(&answer)? {
            Step::Send(next) => frame = next,
            Step::Done(length) => return Ok(length),
        }
    }
}

#[test]
fn every_length_goes_there_and_back() {
    let (mut server, mut store) = (Server::new(NODE), Store::default());
    for length in 0..=SERVER_ROOM {
        let data: Vec<u8> = (0..length).map(|i| (i * 7 + length) as u8).collect();
        download(&mut server, &mut store, at(0x2000, 0), &data).expect("written");
        assert_eq!(store.0, data, "length {length}");
        let mut room = [0; SERVER_ROOM];
        let used = upload(&mut server, &mut store, at(0x2000, 0), &mut room).expect("read");
        assert_eq!(&room[..used], data, "length {length}");
    }
}

#[test]
fn refusals_name_object_and_code() {
    let (mut server, mut store) = (Server::new(NODE), Store::default());
    let address = at(0x2001, 3);
    let mut room = [0; 8];
    assert_eq!(
        upload(&mut server, &mut store, address, &mut room),
        Err(SdoError::Aborted { address, code: abort::NO_OBJECT })
    );
    assert_eq!(
        download(&mut server, &mut store, address, &[1]),
        Err(SdoError::Aborted { address, code: abort::READ_ONLY })
    );
    store.0 = vec![1; 20];
    assert_eq!(
        upload(&mut server, &mut store, at(0x2000, 0), &mut room),
        Err(SdoError::TooLong { address: at(0x2000, 0), room: 8 })
    );
    let long = vec![0; SERVER_ROOM + 1];
    assert!(matches!(download(&mut server, &mut store, at(0x2000, 0), &long), Err(SdoError::Aborted { .. })));
}

#[test]
fn a_segment_that_comes_twice_is_refused() {
    let (mut server, mut store) = (Server::new(NODE), Store(vec![9; 30]));
    let request = |command| Frame::new(cob::sdo_request(NODE), &[command, 0, 0x20, 0, 0, 0, 0, 0]);
    server.on_request(&request(0x40), &mut store).expect("begun");
    server.on_request(&request(0x60), &mut store).expect("first segment");
    let answer = server.on_request(&request(0x60), &mut store).expect("an abort");
    assert_eq!(answer.data()[0], 0x80);
    assert_eq!(answer.data()[4..], abort::TOGGLE.to_le_bytes());
}

proptest! {
    /// Any frames at all, at any moment: no panic, and the server still serves.
    #[test]
    fn a_server_survives_anything(frames in prop::collection::vec((any::<u16>(), prop::collection::vec(any::<u8>(), 0..=8)), 0..60)) {
        let (mut server, mut store) = (Server::new(NODE), Store(vec![3; 40]));
        for (id, data) in frames {
            let id = if id & 1 == 0 { cob::sdo_request(NODE) } else { id & 0x7FF };
            server.on_request(&Frame::new(id, &data), &mut store);
        }
        store.0 = vec![7; 17];
        let mut room = [0; 64];
        prop_assert_eq!(upload(&mut server, &mut store, at(0x2000, 0), &mut room), Ok(17));
    }

    /// Any answers at all: no panic on the client's side, and it ends.
    #[test]
    fn a_client_survives_anything(answers in prop::collection::vec(prop::array::uniform8(any::<u8>()), 1..60), length in 0_usize..40) {
        let data = vec![1; length];
        let (mut writing, _) = Download::new(NODE, at(0x2000, 0), &data);
        let mut room = [0; 32];
        let (mut reading, _) = Upload::new(NODE, at(0x2000, 0), &mut room);
        for answer in answers {
            let frame = Frame::new(cob::sdo_answer(NODE), &answer);
            let _ = writing.on_answer(&frame);
            let _ = reading.on_answer(&frame);
        }
    }
}
