//! Bringing a drive from power-up to operational: identity, settings, PDO mapping, its own time-outs, all read
//! back.

use super::{CanBus, DriveError, DriveSettings, Setting};
use crate::canopen::nmt::{NmtCommand, NodeState};
use crate::canopen::objects::{self, Address, at};
use crate::canopen::pdo::{self, Mapped};
use crate::canopen::sdo::{Download, Step, Upload};
use crate::canopen::{Frame, cob};
use std::format;
use std::string::String;
use std::time::Duration;

/// A drive that is configured and operational on the bus, its power still off.
#[derive(Debug)]
pub struct ReadyDrive {
    pub(super) bus: CanBus,
    pub(super) settings: DriveSettings,
    /// Name that the device gives itself (object 0x1008), empty if it has none.
    pub name: String,
    /// Vendor, product, revision, serial number.
    pub identity: [u32; 4],
}

const SDO_TIMEOUT: Duration = Duration::from_millis(300);
const BOOT_TIMEOUT: Duration = Duration::from_secs(2);
const SYNCHRONOUS_EVERY_SYNC: u32 = 1;
const PDO_INVALID: u32 = 1 << 31;
const QUICK_STOP_ON_LOSS: u32 = 3;
const STAY_IN_QUICK_STOP: u32 = 6;

/// Configures the drive.
///
/// # Errors
/// [`DriveError`]: silent, wrong identity, a refused setting, or one that reads back differently.
pub fn prepare(bus: CanBus, settings: DriveSettings) -> Result<ReadyDrive, DriveError> {
    let mut master = Master { bus, node: settings.node };
    master.reset()?;
    let identity = master.identity()?;
    check_identity(&settings, identity)?;
    let name = master.name();
    for setting in &settings.settings {
        master.set(*setting, "configured setting")?;
    }
    master.set_profile(&settings)?;
    master.set_timeouts(&settings)?;
    master.map_all(&settings)?;
    master.bus.send(&NmtCommand::Start.frame(settings.node))?;
    master.expect_state(NodeState::Operational, Duration::from_millis(500))?;
    Ok(ReadyDrive { bus: master.bus, settings, name, identity })
}

fn check_identity(settings: &DriveSettings, identity: [u32; 4]) -> Result<(), DriveError> {
    let [vendor, product, _, serial] = identity;
    let expected = &settings.expected;
    for (what, expected, received) in [
        ("vendor", expected.vendor, vendor),
        ("product", expected.product, product),
        ("serial number", expected.serial, serial),
    ] {
        if let Some(expected) = expected
            && expected != received
        {
            return Err(DriveError::WrongDevice { node: settings.node, what, expected, received });
        }
    }
    Ok(())
}

struct Master {
    bus: CanBus,
    node: u8,
}

impl Master {
    /// Resets the communication of the node, so that settings of an earlier session are gone.
    fn reset(&mut self) -> Result<(), DriveError> {
        self.bus.send(&NmtCommand::ResetCommunication.frame(self.node))?;
        let node = self.node;
        let booted = self
            .bus
            .wait_for(BOOT_TIMEOUT, |f| NodeState::from_frame(f, node).filter(|s| *s == NodeState::BootUp))?;
        booted.map(drop).ok_or_else(|| self.no_answer("a reset of its communication", BOOT_TIMEOUT))
    }

    fn expect_state(&mut self, state: NodeState, timeout: Duration) -> Result<(), DriveError> {
        let node = self.node;
        let seen = self.bus.wait_for(timeout, |f| NodeState::from_frame(f, node).filter(|s| *s == state))?;
        seen.map(drop).ok_or_else(|| self.no_answer("the command to go operational", timeout))
    }

    fn no_answer(&self, request: impl Into<String>, timeout: Duration) -> DriveError {
        DriveError::NoAnswer {
            node: self.node,
            request: request.into(),
            timeout_ms: timeout.as_millis() as u64,
        }
    }

    fn identity(&mut self) -> Result<[u32; 4], DriveError> {
        let mut identity = [0; 4];
        let addresses = [objects::VENDOR, objects::PRODUCT, objects::REVISION, objects::SERIAL];
        for (value, address) in identity.iter_mut().zip(addresses) {
            // Only the vendor is mandatory (CiA 301, 7.5.2.19); a part that is missing reads as 0.
            *value = match self.read(address) {
                Err(DriveError::Sdo(_)) if address != objects::VENDOR => 0,
                other => other?,
            };
        }
        Ok(identity)
    }

    fn name(&mut self) -> String {
        let mut room = [0; 128];
        match self.upload(objects::DEVICE_NAME, &mut room) {
            Ok(used) => String::from_utf8_lossy(&room[..used]).into_owned(),
            // The name is optional and only shown.
            Err(_) => String::new(),
        }
    }

    fn set_profile(&mut self, settings: &DriveSettings) -> Result<(), DriveError> {
        let counts = |metres: f64| (metres * settings.units.counts_per_m.abs()).round() as u32;
        let stop = (settings.quick_stop_m_s2 * settings.units.velocity_per_m_s.abs()).round() as u32;
        let cycle_us = settings.cycle.as_micros() as u32;
        let values = [
            (objects::MODE, u32::from(settings.mode as u8), 1, "mode of operation"),
            (objects::INTERPOLATION_PERIOD, cycle_us / 1000, 1, "interpolation period, ms"),
            (objects::INTERPOLATION_EXPONENT, u32::from(-3_i8 as u8), 1, "its exponent"),
            (
                objects::FOLLOWING_ERROR_WINDOW,
                counts(settings.following_error_m),
                4,
                "following error window",
            ),
            (objects::QUICK_STOP_DECELERATION, stop, 4, "quick stop deceleration"),
            (objects::QUICK_STOP_OPTION, STAY_IN_QUICK_STOP, 2, "quick stop option"),
        ];
        self.set_all(&values)
    }

    /// What stops the drive when the host dies.
    fn set_timeouts(&mut self, settings: &DriveSettings) -> Result<(), DriveError> {
        let ms = |time: Duration| time.as_millis() as u32;
        let consumer = u32::from(settings.host_node) << 16 | ms(settings.host_lost);
        let cycle_us = settings.cycle.as_micros() as u32;
        self.set_all(&[
            (objects::ABORT_CONNECTION_OPTION, QUICK_STOP_ON_LOSS, 2, "reaction to a lost connection"),
            (objects::HEARTBEAT_CONSUMER, consumer, 4, "heartbeat consumer"),
            (objects::HEARTBEAT_PRODUCER_MS, ms(settings.drive_heartbeat), 2, "heartbeat producer"),
            (objects::COMMUNICATION_CYCLE_US, cycle_us, 4, "communication cycle period"),
        ])?;
        if let Some(address) = settings.sync_timeout {
            self.set_all(&[(address, ms(settings.commands_lost), 2, "SYNC time-out")])?;
        }
        Ok(())
    }

    fn map_all(&mut self, settings: &DriveSettings) -> Result<(), DriveError> {
        let node = self.node;
        for (n, mapping) in [(0, &pdo::RPDO1), (1, &pdo::RPDO2)] {
            let communication = objects::RPDO_COMMUNICATION + u16::from(n);
            self.map(
                communication,
                objects::RPDO_MAPPING + u16::from(n),
                cob::rpdo(n, node),
                mapping,
                |master| {
                    // Event timer of a receive PDO: its deadline (CiA 301, 7.5.2.35).
                    let deadline = settings.commands_lost.as_millis() as u32;
                    master.set_all(&[(at(communication, 5), deadline, 2, "deadline of the receive PDO")])
                },
            )?;
        }
        for (n, mapping) in [(0, &pdo::TPDO1), (1, &pdo::TPDO2)] {
            let communication = objects::TPDO_COMMUNICATION + u16::from(n);
            self.map(
                communication,
                objects::TPDO_MAPPING + u16::from(n),
                cob::tpdo(n, node),
                mapping,
                |_| Ok(()),
            )?;
        }
        Ok(())
    }

    /// The order of CiA 301, 7.5.2.36: invalid, type, mapping off, entries, mapping on, valid.
    fn map(
        &mut self,
        communication: u16,
        mapping: u16,
        cob_id: u16,
        entries: &[Mapped],
        before_valid: impl FnOnce(&mut Self) -> Result<(), DriveError>,
    ) -> Result<(), DriveError> {
        let id = u32::from(cob_id);
        self.set_all(&[
            (at(communication, 1), id | PDO_INVALID, 4, "PDO switched off"),
            (at(communication, 2), SYNCHRONOUS_EVERY_SYNC, 1, "transmission type"),
            (at(mapping, 0), 0, 1, "number of mapped objects"),
        ])?;
        for (sub, entry) in (1..).zip(entries) {
            self.set_all(&[(at(mapping, sub), entry.entry(), 4, "mapped object")])?;
        }
        self.set_all(&[(at(mapping, 0), entries.len() as u32, 1, "number of mapped objects")])?;
        before_valid(self)?;
        self.set_all(&[(at(communication, 1), id, 4, "PDO switched on")])
    }

    fn set_all(&mut self, values: &[(Address, u32, u8, &'static str)]) -> Result<(), DriveError> {
        values
            .iter()
            .try_for_each(|&(address, value, bytes, what)| self.set(Setting { address, value, bytes }, what))
    }

    /// Writes an object and reads it back.
    fn set(&mut self, setting: Setting, what: &'static str) -> Result<(), DriveError> {
        let Setting { address, value, bytes } = setting;
        let length = usize::from(bytes.clamp(1, 4));
        self.download(address, &value.to_le_bytes()[..length])?;
        let received = self.read(address)?;
        let mask = u32::MAX >> (32 - 8 * length as u32);
        if received & mask == value & mask {
            return Ok(());
        }
        Err(DriveError::NotTaken { address, what, written: value, received })
    }

    fn read(&mut self, address: Address) -> Result<u32, DriveError> {
        let mut room = [0; 4];
        self.upload(address, &mut room)?;
        Ok(u32::from_le_bytes(room))
    }

    fn download(&mut self, address: Address, data: &[u8]) -> Result<(), DriveError> {
        let (mut transfer, first) = Download::new(self.node, address, data);
        self.exchange(address, first, |answer| transfer.on_answer(answer)).map(drop)
    }

    fn upload(&mut self, address: Address, room: &mut [u8]) -> Result<usize, DriveError> {
        let (mut transfer, first) = Upload::new(self.node, address, room);
        self.exchange(address, first, |answer| transfer.on_answer(answer))
    }

    fn exchange(
        &mut self,
        address: Address,
        first: Frame,
        mut on_answer: impl FnMut(&Frame) -> Result<Step, crate::canopen::sdo::SdoError>,
    ) -> Result<usize, DriveError> {
        let channel = cob::sdo_answer(self.node);
        let mut next = first;
        loop {
            self.bus.send(&next)?;
            let answer = self.bus.wait_for(SDO_TIMEOUT, |frame| (frame.id == channel).then_some(*frame))?;
            let Some(answer) = answer else {
                return Err(self.no_answer(format!("a request for {address}"), SDO_TIMEOUT));
            };
            match on_answer(&answer)? {
                Step::Send(frame) => next = frame,
                Step::Done(length) => return Ok(length),
            }
        }
    }
}
