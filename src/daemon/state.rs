//! The states of the bench and the ways between them, as pure functions: what the operator may ask in
//! which state, what the supervisor of a run makes of it, and what that run's end does. The desk calls it before it does
//! anything; nothing else changes a state. Whether the table moves is the supervisor's to say, here as everywhere.

use crate::control::Ending;
use crate::safety;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// How the bench stands.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "kebab-case")]
pub enum State {
    /// Nothing goes on; sweep and model may be changed.
    #[default]
    Idle,
    /// The checks before a run are made, or wait to be confirmed.
    PreFlight,
    /// Checked and confirmed: an operator may start.
    Armed,
    /// The sweep runs.
    Running,
    /// The sweep stays in its step, or will from the end of its counted cycles on.
    Holding,
    /// The table is brought to rest.
    Stopping,
    /// The run is over, in order: to its end, or stopped on request.
    Stopped,
    /// Ended by the supervisor or a failure; stays so until it is acknowledged and reset.
    Aborted,
}

/// What can be asked of the bench.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Action {
    /// Change sweep, case or model.
    Configure,
    /// Make the checks before a run.
    PreFlight,
    /// Confirm the checks.
    Arm,
    /// Give the confirmation back.
    Disarm,
    /// Start the sweep.
    Start,
    /// Stay in the present step once its counted cycles are done.
    Hold,
    /// End a hold.
    Resume,
    /// Bring the table to rest.
    Stop,
    /// Acknowledge the cause of an abort and clear it.
    Reset,
}

/// All actions, for tables and tests.
pub const ACTIONS: [Action; 9] = [
    Action::Configure,
    Action::PreFlight,
    Action::Arm,
    Action::Disarm,
    Action::Start,
    Action::Hold,
    Action::Resume,
    Action::Stop,
    Action::Reset,
];

/// An action that the present state does not allow.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("`{}` is not possible while the bench is {}; possible now: {}", .action.name(), .state.name(), possible(*.state))]
pub struct NotNow {
    /// What was asked.
    pub action: Action,
    /// How the bench stands.
    pub state: State,
}

impl State {
    /// All of them.
    pub const ALL: [Self; 8] = [
        Self::Idle,
        Self::PreFlight,
        Self::Armed,
        Self::Running,
        Self::Holding,
        Self::Stopping,
        Self::Stopped,
        Self::Aborted,
    ];

    /// The word of the interface.
    pub fn name(self) -> &'static str {
        match self {
            Self::Idle => "idle",
            Self::PreFlight => "pre-flight",
            Self::Armed => "armed",
            Self::Running => "running",
            Self::Holding => "holding",
            Self::Stopping => "stopping",
            Self::Stopped => "stopped",
            Self::Aborted => "aborted",
        }
    }

    /// A run goes on: the control thread is there to be asked.
    pub fn is_live(self) -> bool {
        matches!(self, Self::Running | Self::Holding | Self::Stopping)
    }

    /// The state after an action.
    ///
    /// # Errors
    /// [`NotNow`] when the present state does not allow it.
    pub fn after(self, action: Action) -> Result<Self, NotNow> {
        use State::{Aborted, Armed, Holding, Idle, PreFlight, Running, Stopped, Stopping};
        match (self, action) {
            // What was checked is no longer what would run.
            (Idle | PreFlight | Stopped, Action::Configure) => Ok(Idle),
            (Idle | PreFlight | Stopped, Action::PreFlight) => Ok(PreFlight),
            (PreFlight, Action::Arm) => Ok(Armed),
            (PreFlight | Armed, Action::Disarm) => Ok(Idle),
            (Armed, Action::Start) => Ok(Running),
            (Running, Action::Hold) => Ok(Holding),
            (Holding, Action::Resume) => Ok(Running),
            (Running | Holding | Stopping, Action::Stop) => Ok(Stopping),
            // To stop what does not move takes the readiness to start away, and is never refused.
            (Idle | PreFlight | Armed, Action::Stop) => Ok(Idle),
            (Stopped | Aborted, Action::Stop) => Ok(self),
            (Aborted, Action::Reset) => Ok(Idle),
            _ => Err(NotNow { action, state: self }),
        }
    }

    /// The state of a live bench whose supervisor on the control thread is in one of its own: what that decides stands
    /// above what was asked here. From a stop only the end leads on.
    pub fn under(self, supervisor: safety::State) -> Self {
        use safety::State as Supervisor;
        match (self, supervisor) {
            (Self::Running | Self::Holding, Supervisor::Stopping | Supervisor::Aborting) => Self::Stopping,
            (Self::Running | Self::Holding, Supervisor::Holding) => Self::Holding,
            // Before the sweep there is nothing to hold.
            (Self::Holding, _) => Self::Running,
            _ => self,
        }
    }

    /// The state once a run has ended.
    pub fn ended(ending: Ending) -> Self {
        match ending {
            Ending::Done | Ending::Stopped => Self::Stopped,
            Ending::Aborted | Ending::Failed | Ending::Interrupted => Self::Aborted,
        }
    }

    /// What can be asked now.
    pub fn possible(self) -> Vec<Action> {
        ACTIONS.into_iter().filter(|action| self.after(*action).is_ok()).collect()
    }
}

impl Action {
    /// The word of the interface.
    pub fn name(self) -> &'static str {
        match self {
            Self::Configure => "configure",
            Self::PreFlight => "pre-flight",
            Self::Arm => "arm",
            Self::Disarm => "disarm",
            Self::Start => "start",
            Self::Hold => "hold",
            Self::Resume => "resume",
            Self::Stop => "stop",
            Self::Reset => "reset",
        }
    }
}

fn possible(state: State) -> String {
    state.possible().into_iter().map(Action::name).collect::<Vec<_>>().join(", ")
}

#[cfg(test)]
mod tests {
    use super::*;
    use State::{Aborted, Armed, Holding, PreFlight, Running, Stopped, Stopping};

    #[test]
    fn only_an_armed_bench_starts_and_only_a_reset_leaves_an_abort() {
        for state in State::ALL {
            assert_eq!(state.after(Action::Start).is_ok(), state == Armed, "{state:?}");
            assert_eq!(state.after(Action::Arm).is_ok(), state == PreFlight, "{state:?}");
            assert_eq!(state.after(Action::Reset).is_ok(), state == Aborted, "{state:?}");
            assert!(state.after(Action::Stop).is_ok(), "stop is never refused: {state:?}");
            for action in ACTIONS {
                if let (Aborted, Ok(next)) = (state, state.after(action)) {
                    assert!(next == Aborted || action == Action::Reset, "{action:?}");
                }
                if let Ok(Running) = state.after(action) {
                    assert!(matches!(action, Action::Start | Action::Resume), "{state:?} {action:?}");
                }
            }
        }
    }

    #[test]
    fn a_moving_table_is_neither_reconfigured_nor_checked() {
        for state in [Armed, Running, Holding, Stopping, Aborted] {
            for action in [Action::Configure, Action::PreFlight] {
                let error = state.after(action).expect_err("refused").to_string();
                assert!(error.contains(state.name()) && error.contains("stop"), "{error}");
            }
        }
        assert_eq!(Stopping.after(Action::Hold), Err(NotNow { action: Action::Hold, state: Stopping }));
        assert_eq!(Stopping.after(Action::Resume), Err(NotNow { action: Action::Resume, state: Stopping }));
    }

    // SR-03
    #[test]
    fn the_supervisor_has_the_last_word_on_what_moves() {
        use safety::State as Supervisor;
        for state in State::ALL {
            for supervisor in Supervisor::ALL {
                let under = state.under(supervisor);
                assert_eq!(under.is_live(), state.is_live(), "{state:?} {supervisor:?}");
                if matches!(supervisor, Supervisor::Stopping | Supervisor::Aborting) && state.is_live() {
                    assert_eq!(under, Stopping, "{state:?}");
                }
                assert!(under != Holding || supervisor == Supervisor::Holding, "{state:?} {supervisor:?}");
                assert!(state != Stopping || under == Stopping, "a stop is not taken back: {supervisor:?}");
            }
        }
    }

    #[test]
    fn endings() {
        assert_eq!(State::ended(Ending::Done), Stopped);
        assert_eq!(State::ended(Ending::Stopped), Stopped);
        assert_eq!(State::ended(Ending::Aborted), Aborted);
        assert_eq!(State::ended(Ending::Failed), Aborted);
    }
}
