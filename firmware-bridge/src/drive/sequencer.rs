//! Drives the CiA 402 state machine towards a wish, one statusword at a time; no input or output.

use super::status::{DriveFault, Phase};
use crate::canopen::cia402::{
    Axis, DriveCommand, Fault, Observed, OperationEnabled, QuickStopActive, ReadyToSwitchOn, Request, State,
    Statusword, SwitchOnDisabled, SwitchedOn,
};
use crate::canopen::pdo::Outputs;

/// What is wanted of the drive.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[repr(u8)]
pub enum Wish {
    /// Off.
    #[default]
    Off = 0,
    /// Follow commands.
    Enable = 1,
    /// Quick stop; stays there until off is wished.
    QuickStop = 2,
}

impl Wish {
    /// The wish behind a number; unknown ones are the safe one.
    pub fn from_code(code: u8) -> Self {
        match code {
            0 => Self::Off,
            1 => Self::Enable,
            _ => Self::QuickStop,
        }
    }
}

/// Where the axis is, with the type-state inside.
#[derive(Debug)]
enum Course {
    /// Not known, or in a state out of which only waiting leads.
    Unknown,
    Disabled(Axis<SwitchOnDisabled>),
    ToReady(Request<ReadyToSwitchOn>),
    ToOn(Request<SwitchedOn>),
    ToEnabled(Request<OperationEnabled>),
    Enabled(Axis<OperationEnabled>),
    ToStop(Request<QuickStopActive>),
    Stopped(Axis<QuickStopActive>),
    ToDisabled(Request<SwitchOnDisabled>),
    Faulted(Axis<Fault>),
    /// The edge of fault reset was sent; next comes a word without it.
    Resetting(Request<SwitchOnDisabled>),
}

/// The sequence of one drive.
#[derive(Debug)]
pub struct Sequencer {
    course: Course,
    /// A fault found at the start may be reset once; one in motion may not.
    may_reset: bool,
}

impl Default for Sequencer {
    fn default() -> Self {
        Self { course: Course::Unknown, may_reset: true }
    }
}

impl Sequencer {
    /// One cycle: takes the statusword and the wish, gives what to send. `target` is used only while
    /// the drive is in operation.
    ///
    /// # Errors
    /// The drive left operation without being asked; the outputs then ask for quick stop.
    pub fn step(&mut self, status: Statusword, wish: Wish, target: Outputs) -> (Outputs, Option<DriveFault>) {
        let course = core::mem::replace(&mut self.course, Course::Unknown);
        let was_enabled = matches!(course, Course::Enabled(_));
        let course = self.advance(course, status);
        // Leaving by the ways of the standard is a fault only when nobody asked for it.
        let left = was_enabled && !matches!(course, Course::Enabled(_));
        self.course = self.steer(course, wish);
        let outputs = self.outputs(target);
        (outputs, left.then_some(DriveFault::LeftOperation))
    }

    /// The phase for those who watch.
    pub fn phase(&self) -> Phase {
        match self.course {
            Course::Unknown | Course::Disabled(_) | Course::ToDisabled(_) | Course::Resetting(_) => {
                Phase::Off
            }
            Course::ToReady(_) | Course::ToOn(_) | Course::ToEnabled(_) => Phase::Enabling,
            Course::Enabled(_) => Phase::Enabled,
            Course::ToStop(_) | Course::Stopped(_) => Phase::Stopping,
            Course::Faulted(_) => Phase::Fault,
        }
    }

    fn advance(&mut self, course: Course, status: Statusword) -> Course {
        fn follow<To: crate::canopen::cia402::StateType>(
            request: Request<To>,
            status: Statusword,
            reached: impl FnOnce(Axis<To>) -> Course,
            pending: impl FnOnce(Request<To>) -> Course,
        ) -> Course {
            match request.observe(status) {
                Observed::Reached(axis) => reached(axis),
                Observed::Pending(request) => pending(request),
                Observed::Diverted(_) => found(status),
            }
        }
        match course {
            Course::Unknown => found(status),
            Course::Disabled(axis) => axis.stay(status).map_or_else(|_| found(status), Course::Disabled),
            Course::ToReady(r) => follow(r, status, |axis| Course::ToOn(axis.switch_on()), Course::ToReady),
            Course::ToOn(r) => {
                follow(r, status, |axis| Course::ToEnabled(axis.enable_operation()), Course::ToOn)
            }
            Course::ToEnabled(r) => follow(r, status, Course::Enabled, Course::ToEnabled),
            Course::Enabled(axis) => {
                self.may_reset = false;
                axis.stay(status).map_or_else(|_| found(status), Course::Enabled)
            }
            Course::ToStop(r) => follow(r, status, Course::Stopped, Course::ToStop),
            Course::Stopped(axis) => axis.stay(status).map_or_else(|_| found(status), Course::Stopped),
            Course::ToDisabled(r) => follow(r, status, Course::Disabled, Course::ToDisabled),
            Course::Resetting(r) => follow(r, status, Course::Disabled, Course::Resetting),
            Course::Faulted(axis) => axis.stay(status).map_or_else(|_| found(status), Course::Faulted),
        }
    }

    fn steer(&mut self, course: Course, wish: Wish) -> Course {
        match (course, wish) {
            (Course::Disabled(axis), Wish::Enable) => Course::ToReady(axis.shut_down()),
            (Course::Faulted(axis), Wish::Enable) if self.may_reset => {
                self.may_reset = false;
                Course::Resetting(axis.reset())
            }
            (Course::Enabled(axis), Wish::QuickStop) => Course::ToStop(axis.quick_stop()),
            (Course::Enabled(axis), Wish::Off) => Course::ToDisabled(axis.disable_voltage()),
            (Course::Stopped(axis), Wish::Off) => Course::ToDisabled(axis.disable_voltage()),
            // A start that is called off half-way: unknown asks for disable voltage until the drive is there.
            (Course::ToReady(_) | Course::ToOn(_) | Course::ToEnabled(_), Wish::Off | Wish::QuickStop) => {
                Course::Unknown
            }
            (course, _) => course,
        }
    }

    fn outputs(&self, target: Outputs) -> Outputs {
        let hold = |controlword| Outputs { controlword, velocity_offset: 0, torque_offset: 0, ..target };
        match &self.course {
            Course::Unknown | Course::Disabled(_) | Course::Faulted(_) => {
                hold(DriveCommand::DisableVoltage.word())
            }
            Course::ToReady(r) => hold(r.controlword()),
            Course::ToOn(r) => hold(r.controlword()),
            Course::ToEnabled(r) => hold(r.controlword()),
            Course::Enabled(axis) => axis.follow(target),
            Course::ToStop(r) => hold(r.controlword()),
            Course::Stopped(_) => hold(DriveCommand::QuickStop.word()),
            Course::ToDisabled(r) | Course::Resetting(r) => hold(r.controlword()),
        }
    }
}

/// The course that fits a state which the drive took by itself.
fn found(status: Statusword) -> Course {
    match status.state() {
        Some(State::SwitchOnDisabled) => Axis::observe(status).map_or(Course::Unknown, Course::Disabled),
        Some(State::QuickStopActive) => Axis::observe(status).map_or(Course::Unknown, Course::Stopped),
        Some(State::Fault) => Axis::observe(status).map_or(Course::Unknown, Course::Faulted),
        // Ready, switched on, enabled by someone else, starting, reacting: disable voltage leads out of all.
        _ => Course::Unknown,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::canopen::cia402::transition;

    /// A drive that follows the controlword one cycle later.
    struct Peer(State, u16);

    impl Peer {
        fn hear(&mut self, word: u16) {
            let command = DriveCommand::from_word(word);
            let edge = word & 0x80 != 0 && self.1 & 0x80 == 0;
            self.1 = word;
            match command {
                Some(DriveCommand::FaultReset) if !edge => {}
                Some(command) => self.0 = transition(self.0, command),
                None => {}
            }
        }
    }

    fn run(sequencer: &mut Sequencer, peer: &mut Peer, wish: Wish, cycles: usize) -> Vec<DriveFault> {
        let mut faults = Vec::new();
        for _ in 0..cycles {
            let status = Statusword::from_state(peer.0);
            let (outputs, fault) = sequencer.step(status, wish, Outputs::default());
            faults.extend(fault);
            peer.hear(outputs.controlword);
        }
        faults
    }

    use std::vec::Vec;

    #[test]
    fn any_start_ends_enabled_and_any_wish_is_granted() {
        for start in [
            State::SwitchOnDisabled,
            State::ReadyToSwitchOn,
            State::SwitchedOn,
            State::OperationEnabled,
            State::QuickStopActive,
            State::Fault,
        ] {
            let (mut sequencer, mut peer) = (Sequencer::default(), Peer(start, 0));
            if start == State::QuickStopActive {
                // Only a wish for off leads out of a quick stop.
                run(&mut sequencer, &mut peer, Wish::Off, 4);
            }
            let faults = run(&mut sequencer, &mut peer, Wish::Enable, 10);
            assert_eq!((peer.0, faults.len()), (State::OperationEnabled, 0), "from {start:?}");
            run(&mut sequencer, &mut peer, Wish::QuickStop, 3);
            assert_eq!((peer.0, sequencer.phase()), (State::QuickStopActive, Phase::Stopping));
            run(&mut sequencer, &mut peer, Wish::Enable, 10);
            assert_eq!(peer.0, State::QuickStopActive, "a stop does not end by a wish to go on");
            run(&mut sequencer, &mut peer, Wish::Off, 3);
            assert_eq!(peer.0, State::SwitchOnDisabled);
        }
    }

    #[test]
    fn a_trip_in_motion_is_reported_and_not_reset() {
        let (mut sequencer, mut peer) = (Sequencer::default(), Peer(State::SwitchOnDisabled, 0));
        run(&mut sequencer, &mut peer, Wish::Enable, 10);
        peer.0 = State::Fault;
        assert_eq!(run(&mut sequencer, &mut peer, Wish::Enable, 50), [DriveFault::LeftOperation]);
        assert_eq!((peer.0, sequencer.phase()), (State::Fault, Phase::Fault));
    }
}
