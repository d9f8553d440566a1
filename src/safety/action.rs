//! The action ladder: what a detector may ask for, in rising order; the highest one wins. Read from
//! `config/safety.toml`, acted upon by the supervisor.

use serde::{Deserialize, Serialize};

/// What is done when a detector trips. Further down wins.
///
/// | action | command | drive | sweep | record |
/// |---|---|---|---|---|
/// | log | goes on | enabled | goes on | event |
/// | warn | goes on | enabled | goes on | event, shown |
/// | hold | stays in the step it is in | enabled | waits for the operator | event, shown |
/// | stop | amplitude decays over some cycles or, at higher frequencies, minimum-jerk stop at once; then slowly back to the centre | enabled | ended, latched | event, first-out snapshot |
/// | abort | minimum-jerk stop at once, stays there | enabled | ended, latched | event, first-out snapshot |
/// | quick-stop | as abort | the drive's own quick stop | ended, latched | event, first-out snapshot |
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Action {
    /// Nothing.
    #[default]
    None,
    /// An event in the record.
    Log,
    /// An event, shown to the operator.
    Warn,
    /// The sweep stays in its step until the operator resumes.
    Hold,
    /// The amplitude decays over some cycles, then the table returns to its centre.
    Stop,
    /// Minimum-jerk stop at once; the table stays where it came to rest.
    Abort,
    /// The drive stops by itself, independent of commands.
    QuickStop,
}

impl Action {
    /// Whether the action ends the run and latches.
    pub fn latches(self) -> bool {
        self >= Self::Stop
    }
}

/// When a finding is forgotten.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Clear {
    /// As soon as its condition is gone. Only for actions that do not latch.
    Gone,
    /// By a reset of the operator, once its condition is gone.
    Reset,
    /// Not before the next session.
    Never,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_ladder_rises() {
        use Action::{Abort, Hold, Log, None, QuickStop, Stop, Warn};
        let ladder = [None, Log, Warn, Hold, Stop, Abort, QuickStop];
        assert!(ladder.is_sorted());
        assert_eq!(ladder.map(Action::latches), [false, false, false, false, true, true, true]);
    }
}
