//! The supervisor: a pure state machine over states, events and time (counted in control periods). The
//! guard of the control thread drives one per run; the daemon follows it. It promises that a latched fault and a
//! running table exclude each other, that a stop is obeyed in every state, and that the way back from a
//! fault leads through a reset, an arm and a start, each asked for anew.

use super::action::Action;
use serde::{Deserialize, Serialize};

/// How the table stands.
///
/// | state | table | leaves by |
/// |---|---|---|
/// | faulted | at rest, latched | reset, once nothing is wrong any more |
/// | idle | at rest | arm |
/// | centring | returns slowly from its measured place | its end, stop, trip |
/// | armed | at rest in its centre | start, stop, trip, time |
/// | running, holding | follows the sweep | its end, stop, trip |
/// | stopping | comes to rest as asked | rest, trip |
/// | aborting | comes to rest, latched | rest |
/// | aborted | at rest after an abort, latched | reset, once nothing is wrong any more |
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
#[repr(u8)]
pub enum State {
    /// Where every supervisor begins (SR-01), and where a fault at rest leads.
    #[default]
    Faulted,
    /// Nothing wrong, nothing asked.
    Idle,
    /// On the way from the measured place to the centre.
    Centring,
    /// May be started.
    Armed,
    /// The sweep goes on.
    Running,
    /// The sweep stays in its step.
    Holding,
    /// Comes to rest on request.
    Stopping,
    /// Comes to rest because of a fault.
    Aborting,
    /// At rest because of a fault.
    Aborted,
}

impl State {
    /// All states, by their public number.
    pub const ALL: [Self; 9] = [
        Self::Faulted,
        Self::Idle,
        Self::Centring,
        Self::Armed,
        Self::Running,
        Self::Holding,
        Self::Stopping,
        Self::Aborting,
        Self::Aborted,
    ];

    /// The word shown to operators and written to files.
    pub fn name(self) -> &'static str {
        match self {
            Self::Faulted => "faulted",
            Self::Idle => "idle",
            Self::Centring => "centring",
            Self::Armed => "armed",
            Self::Running => "running",
            Self::Holding => "holding",
            Self::Stopping => "stopping",
            Self::Aborting => "aborting",
            Self::Aborted => "aborted",
        }
    }

    /// Whether the command moves the table, or may do so in the next period.
    pub fn moves(self) -> bool {
        matches!(self, Self::Centring | Self::Running | Self::Holding | Self::Stopping | Self::Aborting)
    }
}

/// What happens to the supervisor.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Event {
    /// A detector asks for a latching action ([`Action::Stop`] or more).
    Trip(Action),
    /// No condition of a latching detector is present any more.
    Clear,
    /// An operator acknowledges and resets; when it was asked, in control periods.
    Reset {
        /// Period in which the operator asked.
        asked: u64,
    },
    /// An operator arms the table where it was measured to be.
    Arm {
        /// The measured table is at rest.
        at_rest: bool,
        /// It is in its centre, too.
        centred: bool,
    },
    /// An operator starts the sweep.
    Start,
    /// An operator asks to stay in the step.
    Hold,
    /// An operator lets the sweep go on.
    Resume,
    /// Anyone asks to stop.
    Stop,
    /// The motion that was ordered (centring, stop) has come to rest.
    Rest,
    /// The sweep has come to its end, at rest.
    Done,
    /// Time passes.
    Time,
}

/// What is to be done now; the command source carries it out in the same period.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Order {
    /// Go on as before.
    None,
    /// Return slowly from the measured place to the centre.
    Centre,
    /// Follow the sweep.
    Sweep,
    /// Stay in the step once its counted cycles are done.
    Hold,
    /// Leave the hold.
    Resume,
    /// Come to rest gently and return to the centre.
    Stop,
    /// Come to rest at once and stay there.
    Abort,
    /// As [`Order::Abort`], and the drive stops by itself.
    QuickStop,
}

/// Why something asked for is not done.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, thiserror::Error, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Refusal {
    /// Not in this state.
    #[error("not possible while {}", .0.name())]
    NotNow(State),
    /// What is wrong is still there.
    #[error("a fault is still present: see the detectors that are tripped")]
    FaultPresent,
    /// The reset was asked while the fault was still there, or too long ago.
    #[error("the reset is not fresh: acknowledge and reset again now that no fault is present")]
    NotFresh,
    /// The measured table moves.
    #[error("the table is measured to move: wait until it is at rest")]
    NotAtRest,
}

/// Times of the supervisor, control periods.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Rules {
    /// After this an armed table that was not started is disarmed.
    pub armed_for: u64,
    /// A reset older than this does not count.
    pub reset_fresh: u64,
}

/// State, latch and times. A value: [`Supervisor::after`] changes nothing but gives what follows.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Supervisor {
    rules: Rules,
    state: State,
    since: u64,
    present: bool,
    cleared: u64,
    latched: bool,
    acting: Action,
}

impl Supervisor {
    /// Faulted and latched, as long as nobody has seen that nothing is wrong.
    pub fn new(rules: Rules) -> Self {
        Self {
            rules,
            state: State::Faulted,
            since: 0,
            present: true,
            cleared: 0,
            latched: true,
            acting: Action::None,
        }
    }

    /// How the table stands.
    pub fn state(&self) -> State {
        self.state
    }

    /// Whether a fault is latched.
    pub fn latched(&self) -> bool {
        self.latched
    }

    /// Whether a fault is present as far as is known.
    pub fn present(&self) -> bool {
        self.present
    }

    /// Takes an event at a period, and says what is to be done.
    ///
    /// # Errors
    /// [`Refusal`]; nothing has changed then.
    pub fn handle(&mut self, now: u64, event: Event) -> Result<Order, Refusal> {
        let (after, order) = self.after(now, event)?;
        *self = after;
        Ok(order)
    }

    /// What follows an event at a period.
    ///
    /// # Errors
    /// [`Refusal`].
    pub fn after(self, now: u64, event: Event) -> Result<(Self, Order), Refusal> {
        match event {
            Event::Trip(action) => Ok(self.tripped(now, action)),
            Event::Clear => Ok((Self { present: false, cleared: now, ..self }, Order::None)),
            Event::Reset { asked } => self.reset(now, asked).map(|next| (next, Order::None)),
            Event::Arm { at_rest, centred } => self.arm(now, at_rest, centred),
            Event::Start => self.only(State::Armed)?.go(now, State::Running, Order::Sweep),
            Event::Hold => self.only(State::Running)?.go(now, State::Holding, Order::Hold),
            Event::Resume => self.only(State::Holding)?.go(now, State::Running, Order::Resume),
            Event::Stop => self.stop(now),
            Event::Rest => self.rest(now),
            Event::Done => match self.state {
                State::Running | State::Holding => self.go(now, State::Idle, Order::None),
                _ => Ok((self, Order::None)),
            },
            // SR-07: an operator who armed and went away has not asked for a start any more.
            Event::Time => {
                let over =
                    self.state == State::Armed && now.saturating_sub(self.since) >= self.rules.armed_for;
                if over { self.go(now, State::Idle, Order::None) } else { Ok((self, Order::None)) }
            }
        }
    }

    fn only(self, state: State) -> Result<Self, Refusal> {
        // SR-03: what is latched moves nothing, whatever the state says.
        if self.latched && self.state == state {
            return Err(Refusal::FaultPresent);
        }
        if self.state == state { Ok(self) } else { Err(Refusal::NotNow(self.state)) }
    }

    fn go(self, now: u64, state: State, order: Order) -> Result<(Self, Order), Refusal> {
        Ok((Self { state, since: now, ..self }, order))
    }

    /// SR-02: every latching trip latches, in every state; a higher action overrides the one in force.
    fn tripped(self, now: u64, action: Action) -> (Self, Order) {
        if !action.latches() {
            return (self, Order::None);
        }
        let state = match self.state {
            State::Faulted | State::Idle | State::Armed => State::Faulted,
            State::Aborted => State::Aborted,
            _ => State::Aborting,
        };
        let begins = state == State::Aborting && self.state != State::Aborting;
        // A stop on request is as gentle as the gentlest abort and is not begun again.
        let in_force = if self.state == State::Stopping { Action::Stop } else { self.acting };
        let before = if begins && self.state != State::Stopping { Action::None } else { in_force };
        let order = match action {
            _ if action <= before => Order::None,
            Action::QuickStop => Order::QuickStop,
            _ if state != State::Aborting => Order::None,
            Action::Stop => Order::Stop,
            _ => Order::Abort,
        };
        let since = if state == self.state { self.since } else { now };
        let acting = action.max(before);
        (Self { state, since, present: true, latched: true, acting, ..self }, order)
    }

    /// SR-04: only with no fault present, and asked for after the last one has gone.
    fn reset(self, now: u64, asked: u64) -> Result<Self, Refusal> {
        if !matches!(self.state, State::Faulted | State::Aborted) {
            return Err(Refusal::NotNow(self.state));
        }
        if self.present {
            return Err(Refusal::FaultPresent);
        }
        if asked < self.cleared || asked > now || now - asked > self.rules.reset_fresh {
            return Err(Refusal::NotFresh);
        }
        Ok(Self { state: State::Idle, since: now, latched: false, acting: Action::None, ..self })
    }

    /// SR-05: the table begins where it is measured to be, at rest.
    fn arm(self, now: u64, at_rest: bool, centred: bool) -> Result<(Self, Order), Refusal> {
        let idle = self.only(State::Idle)?;
        if !at_rest {
            return Err(Refusal::NotAtRest);
        }
        match centred {
            true => idle.go(now, State::Armed, Order::None),
            false => idle.go(now, State::Centring, Order::Centre),
        }
    }

    /// SR-06: never refused.
    fn stop(self, now: u64) -> Result<(Self, Order), Refusal> {
        match self.state {
            State::Centring | State::Running | State::Holding => self.go(now, State::Stopping, Order::Stop),
            State::Armed => self.go(now, State::Idle, Order::None),
            _ => Ok((self, Order::None)),
        }
    }

    fn rest(self, now: u64) -> Result<(Self, Order), Refusal> {
        match self.state {
            State::Centring => self.go(now, State::Armed, Order::None),
            State::Stopping => self.go(now, State::Idle, Order::None),
            State::Aborting => self.go(now, State::Aborted, Order::None),
            _ => Ok((self, Order::None)),
        }
    }
}

#[cfg(test)]
#[path = "supervisor_tests.rs"]
mod tests;
