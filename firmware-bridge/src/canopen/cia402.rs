//! The state machine of a drive (CiA 402-2, IEC 61800-7-201) with the state in the type.
//!
//! An [`Axis`] in a state has only the transitions that this state allows; each consumes it and gives
//! a [`Request`], which becomes an axis in the next state when the drive's statusword says so. Only an
//! [`Axis<OperationEnabled>`] has [`Axis::follow`], so that no other can be given a target.

use core::marker::PhantomData;

/// States of the drive.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum State {
    /// Initialising; leaves it by itself.
    #[default]
    NotReadyToSwitchOn,
    /// Power off, parameters may change.
    SwitchOnDisabled,
    /// Waits for power.
    ReadyToSwitchOn,
    /// Powered, no torque.
    SwitchedOn,
    /// Follows its target.
    OperationEnabled,
    /// Stopping or stopped by quick stop.
    QuickStopActive,
    /// Reacting to a fault.
    FaultReactionActive,
    /// Tripped.
    Fault,
}

/// Statusword (object 0x6041).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Statusword(pub u16);

impl Statusword {
    /// Warning bit.
    pub const WARNING: u16 = 1 << 7;
    /// In cyclic synchronous position: the drive follows the target.
    pub const FOLLOWS: u16 = 1 << 12;
    /// In the position modes: following error beyond its window.
    pub const FOLLOWING_ERROR: u16 = 1 << 13;

    /// The state that it tells (CiA 402-2, table of the statusword); `None` for a pattern that
    /// stands for none.
    pub fn state(self) -> Option<State> {
        Some(match (self.0 & 0x4F, self.0 & 0x6F) {
            (0x00, _) => State::NotReadyToSwitchOn,
            (0x40, _) => State::SwitchOnDisabled,
            (_, 0x21) => State::ReadyToSwitchOn,
            (_, 0x23) => State::SwitchedOn,
            (_, 0x27) => State::OperationEnabled,
            (_, 0x07) => State::QuickStopActive,
            (0x0F, _) => State::FaultReactionActive,
            (0x08, _) => State::Fault,
            _ => return None,
        })
    }

    /// The pattern of a state, for a drive to send.
    pub fn from_state(state: State) -> Self {
        Self(match state {
            State::NotReadyToSwitchOn => 0x00,
            State::SwitchOnDisabled => 0x40,
            State::ReadyToSwitchOn => 0x31,
            State::SwitchedOn => 0x33,
            State::OperationEnabled => 0x37,
            State::QuickStopActive => 0x17,
            State::FaultReactionActive => 0x1F,
            State::Fault => 0x18,
        })
    }
}

/// Commands of the controlword (object 0x6040).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum DriveCommand {
    /// To ready to switch on.
    Shutdown,
    /// To switched on.
    SwitchOn,
    /// To operation enabled.
    EnableOperation,
    /// To switched on, out of operation enabled.
    DisableOperation,
    /// To switch on disabled.
    DisableVoltage,
    /// To quick stop active.
    QuickStop,
    /// Out of fault (on the rising edge).
    FaultReset,
}

impl DriveCommand {
    /// The controlword.
    pub const fn word(self) -> u16 {
        match self {
            Self::Shutdown => 0x06,
            Self::SwitchOn | Self::DisableOperation => 0x07,
            Self::EnableOperation => 0x0F,
            Self::DisableVoltage => 0x00,
            Self::QuickStop => 0x02,
            Self::FaultReset => 0x80,
        }
    }

    /// The command of a controlword (CiA 402-2, table of command coding). Switch on and disable
    /// operation share a pattern; the state tells them apart.
    pub const fn from_word(word: u16) -> Option<Self> {
        Some(match word {
            w if w & 0x80 != 0 => Self::FaultReset,
            w if w & 0x02 == 0 => Self::DisableVoltage,
            w if w & 0x04 == 0 => Self::QuickStop,
            w if w & 0x01 == 0 => Self::Shutdown,
            w if w & 0x08 == 0 => Self::SwitchOn,
            _ => Self::EnableOperation,
        })
    }
}

/// The state that a drive goes to on a command: its side of the machine. Fault reset counts on its
/// rising edge only, which the caller finds out.
pub fn transition(state: State, command: DriveCommand) -> State {
    use DriveCommand as C;
    use State as S;
    match (state, command) {
        (S::SwitchOnDisabled, C::Shutdown) => S::ReadyToSwitchOn,
        (S::ReadyToSwitchOn, C::SwitchOn) => S::SwitchedOn,
        (S::ReadyToSwitchOn | S::SwitchedOn, C::EnableOperation) => S::OperationEnabled,
        (S::SwitchedOn | S::OperationEnabled, C::Shutdown) => S::ReadyToSwitchOn,
        (S::OperationEnabled, C::SwitchOn | C::DisableOperation) => S::SwitchedOn,
        (S::OperationEnabled, C::QuickStop) => S::QuickStopActive,
        (S::QuickStopActive, C::EnableOperation) => S::OperationEnabled,
        (
            S::ReadyToSwitchOn | S::SwitchedOn | S::OperationEnabled | S::QuickStopActive,
            C::DisableVoltage,
        )
        | (S::ReadyToSwitchOn | S::SwitchedOn, C::QuickStop)
        | (S::Fault, C::FaultReset) => S::SwitchOnDisabled,
        (state, _) => state,
    }
}

/// A state as a type.
pub trait StateType {
    /// The state it stands for.
    const STATE: State;
}

macro_rules! state_types {
    ($($(#[$doc:meta])* $name:ident),* $(,)?) => {$(
        $(#[$doc])*
        #[derive(Clone, Copy, Debug, PartialEq, Eq)]
        pub struct $name;
        impl StateType for $name {
            const STATE: State = State::$name;
        }
    )*};
}
state_types! {
    /// See [`State::SwitchOnDisabled`].
    SwitchOnDisabled,
    /// See [`State::ReadyToSwitchOn`].
    ReadyToSwitchOn,
    /// See [`State::SwitchedOn`].
    SwitchedOn,
    /// See [`State::OperationEnabled`].
    OperationEnabled,
    /// See [`State::QuickStopActive`].
    QuickStopActive,
    /// See [`State::Fault`].
    Fault,
}

/// A drive that is known to be in a state. Neither `Clone` nor `Copy`: a transition uses it up.
#[derive(Debug, PartialEq, Eq)]
pub struct Axis<S>(PhantomData<S>);

/// A transition that was asked for and not seen yet.
#[derive(Debug, PartialEq, Eq)]
pub struct Request<To> {
    from: State,
    command: DriveCommand,
    to: PhantomData<To>,
}

/// What a statusword says about a [`Request`].
#[derive(Debug, PartialEq, Eq)]
pub enum Observed<To> {
    /// The drive is there.
    Reached(Axis<To>),
    /// Not yet.
    Pending(Request<To>),
    /// The drive went somewhere else.
    Diverted(Option<State>),
}

impl<S: StateType> Axis<S> {
    /// The axis, if the drive's statusword says that it is in this state.
    pub fn observe(status: Statusword) -> Option<Self> {
        (status.state() == Some(S::STATE)).then_some(Self(PhantomData))
    }

    /// Keeps the axis while the statusword agrees, else tells where the drive is.
    ///
    /// # Errors
    /// The state it fell into, `None` for a pattern without meaning.
    pub fn stay(self, status: Statusword) -> Result<Self, Option<State>> {
        if status.state() == Some(S::STATE) { Ok(self) } else { Err(status.state()) }
    }

    fn request<To>(self, command: DriveCommand) -> Request<To> {
        Request { from: S::STATE, command, to: PhantomData }
    }
}

impl Axis<SwitchOnDisabled> {
    /// Transition 2.
    pub fn shut_down(self) -> Request<ReadyToSwitchOn> {
        self.request(DriveCommand::Shutdown)
    }
}

impl Axis<ReadyToSwitchOn> {
    /// Transition 3.
    pub fn switch_on(self) -> Request<SwitchedOn> {
        self.request(DriveCommand::SwitchOn)
    }
}

impl Axis<SwitchedOn> {
    /// Transition 4.
    pub fn enable_operation(self) -> Request<OperationEnabled> {
        self.request(DriveCommand::EnableOperation)
    }
}

impl Axis<OperationEnabled> {
    /// The outputs that make the drive follow a target.
    pub fn follow(&self, target: super::pdo::Outputs) -> super::pdo::Outputs {
        super::pdo::Outputs { controlword: DriveCommand::EnableOperation.word(), ..target }
    }

    /// Transition 11.
    pub fn quick_stop(self) -> Request<QuickStopActive> {
        self.request(DriveCommand::QuickStop)
    }

    /// Transition 9.
    pub fn disable_voltage(self) -> Request<SwitchOnDisabled> {
        self.request(DriveCommand::DisableVoltage)
    }
}

impl Axis<QuickStopActive> {
    /// Transition 12.
    pub fn disable_voltage(self) -> Request<SwitchOnDisabled> {
        self.request(DriveCommand::DisableVoltage)
    }
}

impl Axis<Fault> {
    /// Transition 15.
    pub fn reset(self) -> Request<SwitchOnDisabled> {
        self.request(DriveCommand::FaultReset)
    }
}

impl<To: StateType> Request<To> {
    /// The controlword to send until the transition is seen.
    pub fn controlword(&self) -> u16 {
        self.command.word()
    }

    /// What became of it.
    pub fn observe(self, status: Statusword) -> Observed<To> {
        match status.state() {
            Some(state) if state == To::STATE => Observed::Reached(Axis(PhantomData)),
            Some(state) if state == self.from => Observed::Pending(self),
            other => Observed::Diverted(other),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const STATES: [State; 8] = [
        State::NotReadyToSwitchOn,
        State::SwitchOnDisabled,
        State::ReadyToSwitchOn,
        State::SwitchedOn,
        State::OperationEnabled,
        State::QuickStopActive,
        State::FaultReactionActive,
        State::Fault,
    ];

    #[test]
    fn every_state_has_its_pattern_whatever_the_free_bits() {
        for state in STATES {
            let pattern = Statusword::from_state(state);
            for free in 0..=0xFF_u16 {
                // Bits 4 (voltage), 7 to 15 are free in every state; 5 where the table says so.
                let word = Statusword((pattern.0 & 0x6F) | (free & 1) << 4 | (free >> 1) << 8);
                assert_eq!(word.state(), Some(state), "{word:?}");
            }
        }
    }

    #[test]
    fn commands_survive_their_coding() {
        use DriveCommand as C;
        for command in
            [C::Shutdown, C::SwitchOn, C::EnableOperation, C::DisableVoltage, C::QuickStop, C::FaultReset]
        {
            assert_eq!(DriveCommand::from_word(command.word()), Some(command));
        }
    }

    #[test]
    fn only_a_walk_through_the_states_reaches_a_target() {
        let at = |state| Statusword::from_state(state);
        let axis = Axis::<SwitchOnDisabled>::observe(at(State::SwitchOnDisabled)).expect("disabled");
        let Observed::Pending(request) = axis.shut_down().observe(at(State::SwitchOnDisabled)) else {
            panic!("not moved yet")
        };
        let Observed::Reached(axis) = request.observe(at(State::ReadyToSwitchOn)) else { panic!("ready") };
        let Observed::Reached(axis) = axis.switch_on().observe(at(State::SwitchedOn)) else { panic!("on") };
        let Observed::Reached(axis) = axis.enable_operation().observe(at(State::OperationEnabled)) else {
            panic!("enabled")
        };
        assert_eq!(axis.follow(Default::default()).controlword, 0x0F);
        assert_eq!(axis.stay(at(State::Fault)), Err(Some(State::Fault)));
        assert!(Axis::<OperationEnabled>::observe(at(State::SwitchedOn)).is_none());
        let axis = Axis::<SwitchedOn>::observe(at(State::SwitchedOn)).expect("on");
        assert_eq!(axis.enable_operation().observe(at(State::Fault)), Observed::Diverted(Some(State::Fault)));
    }
}
