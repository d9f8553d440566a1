//! A CiA 402 drive as a node on the bus, without input or output of its own: frames and time come in, frames
//! go out. It honours whatever PDO mapping and time-outs a master gives it.

use super::dictionary::{Objects, SYNC_TIMEOUT_MS};
use super::motion::{Demand, Motion};
use crate::canopen::cia402::{DriveCommand, State, Statusword, transition};
use crate::canopen::emcy::Emergency;
use crate::canopen::nmt::{NmtCommand, NodeState};
use crate::canopen::objects::{self, Address, at};
use crate::canopen::sdo::{Dictionary, Server, abort};
use crate::canopen::{Frame, cob};
use crate::clock::TimeGrid;
use crate::drive::Units;
use crate::wire::fields::FieldReader;
use std::string::String;
use std::vec::Vec;

/// What the emulated drive is.
#[derive(Clone, Debug)]
pub struct DriveSpec {
    /// Node number.
    pub node: u8,
    /// Vendor, product, revision, serial number.
    pub identity: [u32; 4],
    /// Name, longer than 4 bytes so that it takes a segmented transfer.
    pub name: String,
    /// Units.
    pub units: Units,
}

/// The drive.
#[derive(Debug)]
pub struct DriveNode {
    spec: DriveSpec,
    sdo: Option<Server>,
    dictionary: Contents,
    nmt: NodeState,
    state: State,
    last_word: u16,
    motion: Motion,
    grid: Option<TimeGrid>,
    actual_m: f64,
    speed_m_s: f64,
    pending: Vec<(Address, u32)>,
    timers: Timers,
    follow_late_since_ns: Option<u64>,
    quick_stop_at_ns: Option<u64>,
    silent: bool,
    trip: Option<u16>,
    /// After a lost connection a standing enable command does not start the drive again; it must be let go first.
    must_let_go: bool,
}

/// Times at which something was last heard or sent, ns; `None` is not watched (yet).
#[derive(Clone, Copy, Debug, Default)]
struct Timers {
    host_heartbeat: Option<u64>,
    sync: Option<u64>,
    rpdo: [Option<u64>; 4],
    own_heartbeat: u64,
}

#[derive(Debug)]
struct Contents {
    objects: Objects,
    name: String,
    /// Controlword written by SDO, to be acted on.
    controlword: Option<u16>,
}

impl Dictionary for Contents {
    fn read(&mut self, address: Address, room: &mut [u8]) -> Result<usize, u32> {
        if address == objects::DEVICE_NAME {
            let text = self.name.as_bytes();
            room.get_mut(..text.len()).ok_or(abort::LENGTH)?.copy_from_slice(text);
            return Ok(text.len());
        }
        let length = self.objects.length(address)?;
        let bytes = self.objects.get(address).to_le_bytes();
        room.get_mut(..length).ok_or(abort::LENGTH)?.copy_from_slice(&bytes[..length]);
        Ok(length)
    }

    fn write(&mut self, address: Address, data: &[u8]) -> Result<(), u32> {
        if address == objects::MODE && !matches!(data, [0 | 7 | 8]) {
            return Err(abort::VALUE);
        }
        let value = self.objects.write(address, data)?;
        if address == objects::CONTROLWORD {
            self.controlword = Some(value as u16);
        }
        if address == objects::MODE {
            self.objects.put(objects::MODE_DISPLAY, value);
        }
        Ok(())
    }
}

impl DriveNode {
    /// A drive that has just got power. It says so with the first [`DriveNode::tick`].
    pub fn new(spec: DriveSpec) -> Self {
        let objects = Objects::new(spec.node, spec.identity);
        Self {
            sdo: None,
            dictionary: Contents { objects, name: spec.name.clone(), controlword: None },
            nmt: NodeState::BootUp,
            state: State::SwitchOnDisabled,
            last_word: 0,
            motion: Motion::Hold(0.0),
            grid: None,
            actual_m: 0.0,
            speed_m_s: 0.0,
            pending: Vec::new(),
            timers: Timers::default(),
            follow_late_since_ns: None,
            quick_stop_at_ns: None,
            silent: false,
            trip: None,
            must_let_go: false,
            spec,
        }
    }

    /// State of the drive.
    pub fn state(&self) -> State {
        self.state
    }

    /// Time at which quick stop or a fault reaction last began by the drive's own decision, ns.
    pub fn stopped_itself_at_ns(&self) -> Option<u64> {
        self.quick_stop_at_ns
    }

    /// What it asks of the table at a time.
    pub fn demand(&self, now_ns: f64) -> Demand {
        self.motion.at(now_ns)
    }

    /// Tells the drive what its encoder shows.
    pub fn set_actual(&mut self, position_m: f64, speed_m_s: f64) {
        (self.actual_m, self.speed_m_s) = (position_m, speed_m_s);
    }

    /// Makes it deaf and mute, as without its cable.
    pub fn set_silent(&mut self, silent: bool) {
        self.silent = silent;
    }

    /// Takes a frame.
    pub fn on_frame(&mut self, frame: &Frame, now_ns: u64, send: &mut impl FnMut(Frame)) {
        if self.silent {
            return;
        }
        if let Some(command) = NmtCommand::from_frame(frame, self.spec.node) {
            return self.on_nmt(command, now_ns, send);
        }
        let host = self.dictionary.objects.get(objects::HEARTBEAT_CONSUMER) >> 16 & 0x7F;
        if host != 0 && NodeState::from_frame(frame, host as u8).is_some() {
            self.timers.host_heartbeat = Some(now_ns);
        }
        if self.nmt != NodeState::Stopped
            && let Some(server) = &mut self.sdo
            && let Some(answer) = server.on_request(frame, &mut self.dictionary)
        {
            send(answer);
            if let Some(word) = self.dictionary.controlword.take() {
                self.on_controlword(word, now_ns);
            }
        }
        if self.nmt == NodeState::Operational {
            self.receive_pdo(frame, now_ns);
            if frame.id == cob::SYNC {
                self.on_sync(now_ns, send);
            }
        }
    }

    /// Lets time pass: heartbeat, time-outs, following error, the end of a ramp.
    pub fn tick(&mut self, now_ns: u64, send: &mut impl FnMut(Frame)) {
        if self.nmt == NodeState::BootUp {
            self.sdo = Some(Server::new(self.spec.node));
            self.send(NodeState::BootUp.frame(self.spec.node), send);
            self.nmt = NodeState::PreOperational;
        }
        let heartbeat_ms = self.dictionary.objects.get(objects::HEARTBEAT_PRODUCER_MS);
        if heartbeat_ms != 0 && now_ns >= self.timers.own_heartbeat + u64::from(heartbeat_ms) * 1_000_000 {
            self.timers.own_heartbeat = now_ns;
            self.send(self.nmt.frame(self.spec.node), send);
        }
        if let Some(code) = self.trip.take() {
            self.trip(code, now_ns, send);
        }
        self.watch_host(now_ns, send);
        self.watch_following(now_ns, send);
        if self.motion.at_rest(now_ns as f64) {
            match self.state {
                State::FaultReactionActive => self.state = State::Fault,
                // Options 1 to 4 of quick stop end without power, 5 to 8 stay.
                State::QuickStopActive if self.dictionary.objects.get(objects::QUICK_STOP_OPTION) < 5 => {
                    self.state = State::SwitchOnDisabled;
                }
                _ => {}
            }
        }
    }

    /// Trips with an error code.
    pub fn trip(&mut self, code: u16, now_ns: u64, send: &mut impl FnMut(Frame)) {
        self.dictionary.objects.put(objects::ERROR_CODE, code.into());
        self.dictionary.objects.put(objects::ERROR_REGISTER, 1);
        let moving = matches!(self.state, State::OperationEnabled | State::QuickStopActive);
        self.brake(now_ns);
        self.state = if moving { State::FaultReactionActive } else { State::Fault };
        self.send(Emergency { code, register: 1, manufacturer: [0; 5] }.frame(self.spec.node), send);
    }

    /// Trips with the next [`DriveNode::tick`].
    pub fn trip_later(&mut self, code: u16) {
        self.trip = Some(code);
    }

    /// Loses power for a moment: everything set is forgotten, the table stands.
    pub fn restart(&mut self) {
        let (actual_m, speed_m_s) = (self.actual_m, self.speed_m_s);
        *self = Self { actual_m, speed_m_s, motion: Motion::Hold(actual_m), ..Self::new(self.spec.clone()) };
    }

    fn send(&self, frame: Frame, send: &mut impl FnMut(Frame)) {
        if !self.silent {
            send(frame);
        }
    }

    fn on_nmt(&mut self, command: NmtCommand, now_ns: u64, send: &mut impl FnMut(Frame)) {
        match command {
            NmtCommand::Start => {
                self.nmt = NodeState::Operational;
                self.pending.clear();
                self.send(self.nmt.frame(self.spec.node), send);
            }
            NmtCommand::Stop | NmtCommand::EnterPreOperational => {
                // Leaving operational is a lost connection for a drive that moves (CiA 402-2, 0x6007).
                if self.state == State::OperationEnabled {
                    self.lose_connection(0x8130, now_ns, send);
                }
                self.nmt =
                    if command == NmtCommand::Stop { NodeState::Stopped } else { NodeState::PreOperational };
                self.timers = Timers { own_heartbeat: self.timers.own_heartbeat, ..Timers::default() };
            }
            NmtCommand::ResetNode | NmtCommand::ResetCommunication => {
                self.restart();
                self.tick(now_ns, send);
            }
        }
    }

    fn on_controlword(&mut self, word: u16, now_ns: u64) {
        let edge = word & 0x80 != 0 && self.last_word & 0x80 == 0;
        self.last_word = word;
        let Some(command) = DriveCommand::from_word(word) else { return };
        if command == DriveCommand::FaultReset {
            if edge && self.state == State::Fault {
                self.dictionary.objects.put(objects::ERROR_REGISTER, 0);
                self.state = State::SwitchOnDisabled;
            }
            return;
        }
        if command != DriveCommand::EnableOperation {
            self.must_let_go = false;
        } else if self.must_let_go {
            return;
        }
        let before = self.state;
        self.state = transition(before, command);
        match (before, self.state) {
            (a, b) if a == b => {}
            (_, State::QuickStopActive) => self.brake(now_ns),
            (_, State::OperationEnabled) => self.motion = Motion::Hold(self.actual_m),
            (State::OperationEnabled | State::QuickStopActive, _) => {
                self.motion = Motion::Hold(self.actual_m)
            }
            _ => {}
        }
    }

    fn receive_pdo(&mut self, frame: &Frame, now_ns: u64) {
        for n in 0..4_u16 {
            let objects = &self.dictionary.objects;
            // Bit 31 makes it invalid, bit 30 forbids remote requests, which are not answered anyway.
            let id = objects.get(at(objects::RPDO_COMMUNICATION + n, 1));
            if id >> 31 != 0 || id & 0x7FF != u32::from(frame.id) {
                continue;
            }
            let mut fields = FieldReader::new(frame.data());
            let mapping = objects::RPDO_MAPPING + n;
            for sub in 1..=objects.get(at(mapping, 0)) as u8 {
                let entry = objects.get(at(mapping, sub));
                let address = at((entry >> 16) as u16, (entry >> 8) as u8);
                let Some(value) = fields.uint(usize::from(entry as u8 / 8)) else { return };
                self.pending.push((address, value as u32));
            }
            self.timers.rpdo[usize::from(n)] = Some(now_ns);
        }
    }

    /// Outputs take effect, inputs are sampled and sent.
    fn on_sync(&mut self, now_ns: u64, send: &mut impl FnMut(Frame)) {
        self.timers.sync = Some(now_ns);
        let period_us = self.dictionary.objects.get(objects::COMMUNICATION_CYCLE_US).max(100);
        let grid = self.grid.get_or_insert_with(|| TimeGrid::new(f64::from(period_us) * 1e3));
        let at_ns = grid.observe(now_ns);
        let mut word = None;
        for (address, value) in std::mem::take(&mut self.pending) {
            self.dictionary.objects.put(address, value);
            if address == objects::CONTROLWORD {
                word = Some(value as u16);
            }
        }
        if let Some(word) = word {
            self.on_controlword(word, now_ns);
        }
        if self.state == State::OperationEnabled {
            self.motion = Motion::Follow { target: self.target(), at_ns };
        }
        self.refresh(now_ns);
        self.send_pdos(send);
    }

    fn target(&self) -> Demand {
        let (objects, units) = (&self.dictionary.objects, self.spec.units);
        let signed = |address| f64::from(objects.get_signed(address));
        let torque = signed(objects::TORQUE_OFFSET);
        Demand {
            displacement_m: signed(objects::TARGET_POSITION) / units.counts_per_m,
            velocity_m_s: signed(objects::VELOCITY_OFFSET) / units.velocity_per_m_s,
            acceleration_m_s2: if units.torque_per_m_s2 == 0.0 {
                0.0
            } else {
                torque / units.torque_per_m_s2
            },
        }
    }

    fn refresh(&mut self, now_ns: u64) {
        let units = self.spec.units;
        let counts = |metres: f64| (metres * units.counts_per_m).round() as i32 as u32;
        let error_m = self.motion.at(now_ns as f64).displacement_m - self.actual_m;
        let follows = if self.state == State::OperationEnabled { Statusword::FOLLOWS } else { 0 };
        // Voltage is on and the remote bit says that the bus commands.
        let word = Statusword::from_state(self.state).0 | 1 << 9 | follows;
        let objects = &mut self.dictionary.objects;
        objects.put(objects::STATUSWORD, word.into());
        objects.put(objects::POSITION, counts(self.actual_m));
        objects.put(objects::VELOCITY, (self.speed_m_s * units.velocity_per_m_s).round() as i32 as u32);
        objects.put(objects::FOLLOWING_ERROR, counts(error_m));
    }

    fn send_pdos(&mut self, send: &mut impl FnMut(Frame)) {
        for n in 0..4_u16 {
            let objects = &self.dictionary.objects;
            let id = objects.get(at(objects::TPDO_COMMUNICATION + n, 1));
            let synchronous = (1..=240).contains(&objects.get(at(objects::TPDO_COMMUNICATION + n, 2)));
            if id >> 31 != 0 || !synchronous {
                continue;
            }
            let mapping = objects::TPDO_MAPPING + n;
            let mut bytes = Vec::new();
            for sub in 1..=objects.get(at(mapping, 0)) as u8 {
                let entry = objects.get(at(mapping, sub));
                let value = objects.get(at((entry >> 16) as u16, (entry >> 8) as u8)).to_le_bytes();
                bytes.extend(value.iter().take(usize::from(entry as u8 / 8)));
            }
            self.send(Frame::new((id & 0x7FF) as u16, &bytes), send);
        }
    }

    /// The chain that does not need the host: heartbeat, SYNC and process data must keep coming.
    fn watch_host(&mut self, now_ns: u64, send: &mut impl FnMut(Frame)) {
        let objects = &self.dictionary.objects;
        let late = |last: Option<u64>, limit_ms: u32| {
            limit_ms != 0
                && last.is_some_and(|at| now_ns.saturating_sub(at) > u64::from(limit_ms) * 1_000_000)
        };
        if late(self.timers.host_heartbeat, objects.get(objects::HEARTBEAT_CONSUMER) & 0xFFFF) {
            self.timers.host_heartbeat = None;
            return self.lose_connection(0x8130, now_ns, send);
        }
        if late(self.timers.sync, objects.get(SYNC_TIMEOUT_MS)) {
            self.timers.sync = None;
            return self.lose_connection(0x8700, now_ns, send);
        }
        for n in 0..4 {
            let deadline_ms = objects.get(at(objects::RPDO_COMMUNICATION + n as u16, 5));
            if late(self.timers.rpdo[n], deadline_ms) {
                self.timers.rpdo[n] = None;
                return self.lose_connection(0x8250, now_ns, send);
            }
        }
    }

    fn lose_connection(&mut self, code: u16, now_ns: u64, send: &mut impl FnMut(Frame)) {
        if self.state != State::OperationEnabled {
            return;
        }
        self.send(Emergency { code, register: 0x11, manufacturer: [0; 5] }.frame(self.spec.node), send);
        self.quick_stop_at_ns = Some(now_ns);
        self.must_let_go = true;
        // CiA 402-2, object 0x6007: nothing, fault, disable voltage, quick stop.
        match self.dictionary.objects.get(objects::ABORT_CONNECTION_OPTION) {
            0 => self.quick_stop_at_ns = None,
            2 => {
                self.motion = Motion::Hold(self.actual_m);
                self.state = State::SwitchOnDisabled;
            }
            3 => {
                self.brake(now_ns);
                self.state = State::QuickStopActive;
            }
            _ => {
                self.brake(now_ns);
                self.state = State::FaultReactionActive;
            }
        }
    }

    fn brake(&mut self, now_ns: u64) {
        let units = self.spec.units;
        let set = f64::from(self.dictionary.objects.get(objects::QUICK_STOP_DECELERATION));
        let deceleration_m_s2 = if set > 0.0 { set / units.velocity_per_m_s.abs() } else { 1.0 };
        self.motion = self.motion.brake(now_ns as f64, deceleration_m_s2);
    }

    fn watch_following(&mut self, now_ns: u64, send: &mut impl FnMut(Frame)) {
        let window = self.dictionary.objects.get(objects::FOLLOWING_ERROR_WINDOW);
        let error_m = self.motion.at(now_ns as f64).displacement_m - self.actual_m;
        let beyond = error_m.abs() * self.spec.units.counts_per_m.abs() > f64::from(window);
        if self.state != State::OperationEnabled || window == 0 || !beyond {
            self.follow_late_since_ns = None;
            return;
        }
        let since = *self.follow_late_since_ns.get_or_insert(now_ns);
        let limit_ms = self.dictionary.objects.get(objects::FOLLOWING_ERROR_TIME_MS);
        if now_ns - since > u64::from(limit_ms) * 1_000_000 {
            self.follow_late_since_ns = None;
            self.trip(0x8611, now_ns, send);
        }
    }
}
