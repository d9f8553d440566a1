//! What effects remember of the whole record before a step: the states of a springpot, which forget by a power law, and reversals
//! that a hysteresis forgets only when the motion goes beyond them. Both depend on the motion alone and are found along it once
//! for all fits.

use super::{Measured, Window};
use crate::model::{self, EffectSpec, IsolatorSpec, ModelSpec, Specimen};

impl Measured<'_> {
    /// What a springpot remembers where the warming up of a step begins, the motion before it run through once.
    pub(super) fn remembered(&self, window: &Window) -> &[f64] {
        let all = self.remembered.get_or_init(|| {
            let motion = self.motion;
            let mut states = Vec::with_capacity(motion.windows.len());
            let mut walk: Option<(usize, usize, Box<dyn Specimen>)> = None;
            for window in &motion.windows {
                let (from, source) = (motion.sources[window.source].first, window.source);
                let (at, mut specimen) = match walk.take() {
                    Some((of, at, specimen)) if of == source && at <= window.warm_from => (at, specimen),
                    _ => match springpot(motion.dt_s()) {
                        Some(specimen) => (from, specimen),
                        None => return Vec::new(),
                    },
                };
                for n in at..window.warm_from {
                    specimen.impose(motion.displacement_m[n], motion.velocity_m_s[n]);
                }
                states.push(specimen.memory());
                walk = Some((source, window.warm_from.max(at), specimen));
            }
            states
        });
        self.of_window(window, all)
    }

    /// Displacements (m) at which the motion has turned before the warming up of a step begins, but for loops that have closed since.
    pub(super) fn reversals_m(&self, window: &Window) -> &[f64] {
        let all = self.reversals_m.get_or_init(|| {
            let motion = self.motion;
            let before = |window: &Window| {
                let range = motion.sources[window.source].first..window.warm_from;
                open_reversals(&motion.displacement_m[range], TURNED * motion.displacement_noise_m)
            };
            motion.windows.iter().map(before).collect()
        });
        self.of_window(window, all)
    }

    fn of_window<'w>(&self, window: &Window, all: &'w [Vec<f64>]) -> &'w [f64] {
        let index = self.motion.windows.iter().position(|w| std::ptr::eq(w, window));
        index.and_then(|index| all.get(index)).map_or(&[], Vec::as_slice)
    }
}

/// Noise of the displacement by which a motion that has turned goes back at least.
const TURNED: f64 = 6.0;

/// Reversals of a motion that begins at zero, in their order, without those of loops that have closed (I. D. Mayergoyz, Mathematical
/// Models of Hysteresis, 1991, ch. 1); it turns when it goes back by more than `dead`.
fn open_reversals(motion: &[f64], dead: f64) -> Vec<f64> {
    let mut open: Vec<f64> = Vec::new();
    let (mut top, mut direction) = (0.0_f64, 0.0_f64);
    for x in motion {
        let way = x - top;
        if way * direction >= 0.0 && way != 0.0 && (direction != 0.0 || way.abs() > dead) {
            (top, direction) = (*x, way.signum());
        } else if way.abs() > dead {
            close(&mut open, top);
            open.push(top);
            (top, direction) = (*x, way.signum());
        }
    }
    close(&mut open, top);
    open.push(top);
    open
}

/// Takes out what a motion to a further reversal has wiped out.
fn close(open: &mut Vec<f64>, turn: f64) {
    while let [.., before, last] = open[..] {
        if (turn - last).abs() < (last - before).abs() {
            return;
        }
        open.truncate(open.len() - 2);
    }
    if open.first().is_some_and(|first| first.abs() <= turn.abs()) {
        open.clear();
    }
}

/// A specimen that is nothing but a springpot.
fn springpot(dt_s: f64) -> Option<Box<dyn Specimen>> {
    let isolator = IsolatorSpec { stiffness_n_m: vec![1.0], breakpoints_m: vec![], damping_n_s_m: 0.0 };
    let parameters = [("ca".to_owned(), 1.0), ("alpha".to_owned(), 0.5)].into_iter().collect();
    let spring = EffectSpec { name: "fractional-damping".into(), expression: None, parameters };
    let spec = ModelSpec {
        name: "springpot".into(),
        mass_kg: 1.0,
        isolator,
        bumper: None,
        effects: vec![spring],
        uncertainty: None,
    };
    model::build(&spec, dt_s).ok()
}

#[cfg(test)]
mod tests {
    use super::open_reversals;

    #[test]
    fn a_loop_that_closes_is_forgotten_and_noise_does_not_turn() {
        let turns = |motion: &[f64]| open_reversals(motion, 0.1);
        assert_eq!(turns(&[0.5, 3.0, 2.95, 3.0, -2.0, 1.0, -1.0]), [3.0, -2.0, 1.0, -1.0]);
        // The inner loop between 1 and -1 closes on the way to 2.
        assert_eq!(turns(&[3.0, -2.0, 1.0, -1.0, 2.0, 1.5]), [3.0, -2.0, 2.0, 1.5]);
        // Beyond the first reversal the virgin curve goes on.
        assert_eq!(turns(&[3.0, -2.0, 1.0, 4.0]), [4.0]);
        assert_eq!(turns(&[3.0, -5.0, 4.0]), [-5.0, 4.0]);
        assert_eq!(turns(&[0.01, -0.02, 0.03]), [0.0]);
    }
}
