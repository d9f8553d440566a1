//! The object dictionary of the emulated drive: plain numbers by address, with length and access.

use crate::canopen::objects::{self, Address, at};
use crate::canopen::sdo::abort;
use std::collections::BTreeMap;

/// One object.
#[derive(Clone, Copy, Debug)]
struct Object {
    value: u32,
    bytes: u8,
    writable: bool,
}

/// All objects that hold a number.
#[derive(Clone, Debug)]
pub struct Objects(BTreeMap<Address, Object>);

/// The vendor's object with the SYNC time-out, ms.
pub const SYNC_TIMEOUT_MS: Address = at(0x2010, 0);

const RPDOS: u16 = 4;
const MAPPED_MAX: u8 = 8;

impl Objects {
    /// The dictionary after power-up: PDOs invalid, time-outs off, as CiA 301 and 402 have them.
    pub fn new(node: u8, identity: [u32; 4]) -> Self {
        let mut this = Self(BTreeMap::new());
        let mut add = |address, value, bytes, writable| {
            this.0.insert(address, Object { value, bytes, writable });
        };
        let [vendor, product, revision, serial] = identity;
        // Servo drive (bit 17) of profile 402.
        add(objects::DEVICE_TYPE, 0x0002_0192, 4, false);
        add(objects::ERROR_REGISTER, 0, 1, false);
        add(objects::COMMUNICATION_CYCLE_US, 0, 4, true);
        add(at(0x1016, 0), 1, 1, false);
        add(objects::HEARTBEAT_CONSUMER, 0, 4, true);
        add(objects::HEARTBEAT_PRODUCER_MS, 0, 2, true);
        add(at(0x1018, 0), 4, 1, false);
        for (address, value) in [
            (objects::VENDOR, vendor),
            (objects::PRODUCT, product),
            (objects::REVISION, revision),
            (objects::SERIAL, serial),
        ] {
            add(address, value, 4, false);
        }
        for n in 0..RPDOS {
            let invalid = (1 << 31) + u32::from(node) + 0x100 * u32::from(n);
            for (communication, mapping, base) in [
                (objects::RPDO_COMMUNICATION + n, objects::RPDO_MAPPING + n, 0x200),
                (objects::TPDO_COMMUNICATION + n, objects::TPDO_MAPPING + n, 0x180),
            ] {
                add(at(communication, 0), 5, 1, false);
                add(at(communication, 1), invalid + base, 4, true);
                add(at(communication, 2), 255, 1, true);
                add(at(communication, 3), 0, 2, true);
                add(at(communication, 5), 0, 2, true);
                add(at(mapping, 0), 0, 1, true);
                for sub in 1..=MAPPED_MAX {
                    add(at(mapping, sub), 0, 4, true);
                }
            }
        }
        for (address, value, bytes, writable) in DRIVE_OBJECTS {
            add(address, value, bytes, writable);
        }
        this
    }

    /// The value of an object; 0 when there is none.
    pub fn get(&self, address: Address) -> u32 {
        self.0.get(&address).map_or(0, |object| object.value)
    }

    /// The same as a signed number of the object's length.
    pub fn get_signed(&self, address: Address) -> i32 {
        let Some(object) = self.0.get(&address) else { return 0 };
        let shift = 32 - 8 * u32::from(object.bytes);
        ((object.value << shift) as i32) >> shift
    }

    /// Length of an object, bytes.
    pub fn length(&self, address: Address) -> Result<usize, u32> {
        match self.0.get(&address) {
            Some(object) => Ok(usize::from(object.bytes)),
            None if self.0.keys().any(|known| known.index == address.index) => Err(abort::NO_SUB_INDEX),
            None => Err(abort::NO_OBJECT),
        }
    }

    /// Sets an object from inside the drive.
    pub fn put(&mut self, address: Address, value: u32) {
        if let Some(object) = self.0.get_mut(&address) {
            object.value = value;
        }
    }

    /// Sets an object from the bus.
    ///
    /// # Errors
    /// An abort code.
    pub fn write(&mut self, address: Address, data: &[u8]) -> Result<u32, u32> {
        let length = self.length(address)?;
        let object = self.0.get_mut(&address).ok_or(abort::NO_OBJECT)?;
        if !object.writable {
            return Err(abort::READ_ONLY);
        }
        if data.len() != length {
            return Err(abort::LENGTH);
        }
        let mut bytes = [0; 4];
        bytes[..length].copy_from_slice(data);
        object.value = u32::from_le_bytes(bytes);
        Ok(object.value)
    }
}

const DRIVE_OBJECTS: [(Address, u32, u8, bool); 21] = [
    (SYNC_TIMEOUT_MS, 0, 2, true),
    (objects::ABORT_CONNECTION_OPTION, 1, 2, true),
    (objects::ERROR_CODE, 0, 2, false),
    (objects::CONTROLWORD, 0, 2, true),
    (objects::STATUSWORD, 0, 2, false),
    (objects::QUICK_STOP_OPTION, 2, 2, true),
    (objects::MODE, 0, 1, true),
    (objects::MODE_DISPLAY, 0, 1, false),
    (objects::POSITION, 0, 4, false),
    (objects::FOLLOWING_ERROR_WINDOW, 0, 4, true),
    (objects::FOLLOWING_ERROR_TIME_MS, 10, 2, true),
    (objects::VELOCITY, 0, 4, false),
    (objects::TARGET_POSITION, 0, 4, true),
    (objects::QUICK_STOP_DECELERATION, 0, 4, true),
    (objects::VELOCITY_OFFSET, 0, 4, true),
    (objects::TORQUE_OFFSET, 0, 2, true),
    (at(0x60C2, 0), 2, 1, false),
    (objects::INTERPOLATION_PERIOD, 1, 1, true),
    (objects::INTERPOLATION_EXPONENT, 0xFD, 1, true),
    (objects::FOLLOWING_ERROR, 0, 4, false),
    // Supported modes: interpolated position (bit 6) and cyclic synchronous position (bit 7).
    (at(0x6502, 0), 0xC0, 4, false),
];
