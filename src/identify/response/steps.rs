//! Which steps of a record are fitted, which judge, and which there is no room for; and fits of a part of them, or of all.

use super::Measured;
use crate::identify::motion::Motion;
use crate::identify::windows::{VERY_LONG, largest_m, struck};
use crate::record::Kind;
use std::sync::{Arc, RwLock};

/// Samples of a record that are simulated at most in one evaluation; steps are left out evenly beyond it.
const SAMPLES: usize = 75_000;
/// The same of a very long record, of whose steps fewer cycles count.
const SAMPLES_OF_VERY_LONG: usize = 50_000;
/// The same where near rivals are told apart by all steps, for each record.
const SAMPLES_IN_ALL: usize = 400_000;
/// A record of more samples (records together: of so many times more) tells enough by a part of its steps where candidates are
/// sorted out.
const LONG: usize = 360_000;

/// Numbers of the windows that are fitted, of those that judge, and of those that there is no room for in either.
pub(super) fn of(motion: &Motion) -> [Vec<usize>; 3] {
    let struck = struck(motion, &motion.windows);
    let room =
        if is_very_long(motion) { SAMPLES_OF_VERY_LONG } else { SAMPLES } * motion.sources.len().max(1);
    let part = |held_out: bool| -> Vec<usize> {
        let all: Vec<usize> =
            (0..motion.windows.len()).filter(|k| motion.windows[*k].held_out == held_out).collect();
        // A record alone keeps one of so many; records together all that there is room for, since a little too much of them would
        // leave out half of what the last one was recorded for.
        let times = simulated(motion, &all) as f64 / room as f64;
        let as_many_as_fit = motion.sources.len() > 1 || motion.kind == Kind::Force;
        let share = 1.0 / if as_many_as_fit { times.max(1.0) } else { times.ceil().max(1.0) };
        // Of a whole sweep the one in which the mass goes farthest tells what none of the few does that are left.
        let reaches = |k: &usize| largest_m(motion, &motion.windows[*k].range);
        let farthest = if !held_out && is_long(motion) {
            all.iter().copied().max_by(|a, b| reaches(a).total_cmp(&reaches(b)))
        } else {
            None
        };
        let needed = |k: usize| motion.windows[k].settling || Some(k) == farthest || struck[k];
        let kept = |(i, k): (usize, usize)| (stays(i, share) || needed(k)).then_some(k);
        all.into_iter().enumerate().filter_map(kept).collect()
    };
    let [training, held_out] = [part(false), part(true)];
    let is_left_out = |k: &usize| !training.contains(k) && !held_out.contains(k);
    let left_out = (0..motion.windows.len()).filter(is_left_out).collect();
    [training, held_out, left_out]
}

/// Samples of such steps that are simulated.
fn simulated(motion: &Motion, steps: &[usize]) -> usize {
    steps.iter().map(|k| motion.windows[*k].range.end - motion.windows[*k].warm_from).sum()
}

/// Whether the step of that place stays where a share of them does, evenly.
fn stays(place: usize, share: f64) -> bool {
    // Beside what rounding makes of whole numbers.
    let before = |place: usize| (place as f64 * share - 1e-9).ceil();
    before(place + 1) > before(place)
}

/// Whether so many samples were recorded that a part of the steps tells enough.
fn is_long(motion: &Motion) -> bool {
    motion.displacement_m.len() > LONG * motion.sources.len().max(1)
}

/// Whether it is a whole sweep, of whose steps two cycles count.
fn is_very_long(motion: &Motion) -> bool {
    motion.displacement_m.len() > VERY_LONG * motion.sources.len().max(1)
}

impl Measured<'_> {
    /// The same with every so many steps of training alone, for fits that sort out.
    pub fn every(&self, steps: usize) -> Self {
        let training = self.training.iter().copied().step_by(steps.max(1)).collect();
        Self { training, ..self.clone() }
    }

    /// The same with the steps that judge taken into the fit, too, and as many as there is room for of those that were left out: for the
    /// evidence of a whole record. Where jumps are it is told by itself.
    pub fn of_all_steps(&self) -> Self {
        let mut all = [self.training.as_slice(), &self.held_out].concat();
        let room = (SAMPLES_IN_ALL * self.records()).saturating_sub(simulated(self.motion, &all));
        let share = room as f64 / simulated(self.motion, &self.left_out).max(1) as f64;
        let more = self.left_out.iter().enumerate().filter(|(i, _)| stays(*i, share.min(1.0)));
        all.extend(more.map(|(_, k)| *k));
        all.sort_unstable();
        let told = Arc::new(RwLock::new(self.told.read().ok().and_then(|told| told.clone())));
        Self { training: all, told, ..self.clone() }
    }

    /// Whether there are steps that neither part has had room for.
    pub fn leaves_steps_out(&self) -> bool {
        !self.left_out.is_empty()
    }

    /// The same with the cycles alone in which the mass goes farther than in any steady stretch.
    pub fn settling(&self) -> Self {
        let settles = |k: &usize| self.motion.windows[*k].settling;
        Self { training: self.training.iter().copied().filter(settles).collect(), ..self.clone() }
    }

    /// Whether a part of the steps is enough to sort out.
    pub fn is_long(&self) -> bool {
        is_long(self.motion)
    }

    /// Whether few samples of each step count, since there are so many steps.
    pub fn is_very_long(&self) -> bool {
        is_very_long(self.motion)
    }

    /// Whether the record has no steps.
    pub fn is_without_steps(&self) -> bool {
        self.motion.windows.iter().all(|window| window.random)
    }

    /// Share of the steps of training in which impacts kick the table: what drives those is known as it was measured, not as a sine.
    pub fn kicked(&self) -> f64 {
        let kicked = |k: &&usize| self.motion.windows[**k].drive_noise_m_s2 > 0.0;
        self.training.iter().filter(kicked).count() as f64 / self.training.len().max(1) as f64
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::diagnose::testing::seen;
    use crate::identify::kinematics::Tolerances;
    use crate::model::testing::b1_g2;

    #[test]
    fn a_fit_to_a_whole_sweep_sees_the_step_in_which_the_mass_goes_farthest() {
        let mut motion = Motion::of(&seen(&b1_g2(), 3), 500.0, Tolerances::default()).expect("a motion");
        // As long as a whole sweep and its steps, in either order.
        motion.displacement_m.resize(LONG + 1, 0.0);
        motion.windows.iter_mut().for_each(|window| window.warm_from = 0);
        for _ in 0..2 {
            let measured = Measured::new(&motion).expect("driven");
            let serve: Vec<usize> =
                (0..motion.windows.len()).filter(|k| !motion.windows[*k].held_out).collect();
            assert!(measured.training.len() < serve.len(), "steps are left out");
            let farthest = |steps: &[usize]| {
                steps.iter().map(|k| largest_m(&motion, &motion.windows[*k].range)).fold(0.0, f64::max)
            };
            assert_eq!(farthest(&measured.training), farthest(&serve));
            motion.windows.reverse();
        }
    }

    #[test]
    fn steps_are_left_out_evenly_and_no_more_than_have_to_be() {
        let left = |share: f64| (0..60).filter(|place| stays(*place, share)).collect::<Vec<_>>();
        assert_eq!(left(1.0).len(), 60);
        // One in ten too many had every other one left out.
        assert_eq!(left(0.9).len(), 54);
        assert_eq!(left(0.5), (0..60).step_by(2).collect::<Vec<_>>());
        assert_eq!(left(1.0 / 7.0), (0..60).step_by(7).collect::<Vec<_>>());
    }

    #[test]
    fn all_steps_are_each_of_them_once_or_as_many_as_there_is_room_for() {
        let mut motion = Motion::of(&seen(&b1_g2(), 3), 500.0, Tolerances::default()).expect("a motion");
        let all = |motion: &Motion| Measured::new(motion).expect("driven").of_all_steps().training;
        assert!(Measured::new(&motion).expect("driven").leaves_steps_out());
        assert_eq!(all(&motion), (0..motion.windows.len()).collect::<Vec<_>>());
        motion.windows.iter_mut().for_each(|window| window.warm_from = 0);
        let some = all(&motion);
        assert!(some.len() < motion.windows.len() && some.is_sorted(), "{some:?}");
        assert!(simulated(&motion, &some) <= SAMPLES_IN_ALL, "{}", simulated(&motion, &some));
    }
}
