//! Reversals of a motion that count for what comes after them: a hysteresis with a memory of its own forgets one only when the motion
//! goes beyond it. Found once when a record is made ready.

use super::motion::{Motion, Window};
use crate::model::Specimen;

/// Noise of the displacement by which a motion that has turned goes back at least.
const TURNED: f64 = 6.0;

impl Motion {
    /// Notes for each window where the motion before its warming up has turned.
    pub(super) fn note_reversals(&mut self) {
        let dead = TURNED * self.displacement_noise_m;
        let (mut walk, mut at) = (Reversals::default(), 0);
        for window in &mut self.windows {
            if window.warm_from < at {
                (walk, at) = (Reversals::default(), 0);
            }
            self.displacement_m[at..window.warm_from].iter().for_each(|d| walk.follow(*d, dead));
            at = window.warm_from;
            window.reversals_m = walk.so_far();
        }
    }

    /// Tells a specimen that begins in the middle of a record, at sample `first` of a window's warming up, the reversals before; what the
    /// displacement lacks is `zero_m`.
    pub(super) fn retrace(&self, specimen: &mut dyn Specimen, window: &Window, first: usize, zero_m: f64) {
        if first > self.sources[window.source].first {
            let now = (self.displacement_m[first - 1] + zero_m, self.velocity_m_s[first - 1]);
            specimen.retrace(&mut window.reversals_m.iter().map(|d| d + zero_m), now);
        }
    }
}

/// A motion that begins at zero, followed: its reversals without those of loops that have closed (I. D. Mayergoyz, Mathematical Models
/// of Hysteresis, 1991, ch. 1).
#[derive(Default)]
struct Reversals {
    open: Vec<f64>,
    /// How far it has come since it turned last, and which way.
    top: f64,
    direction: f64,
}

impl Reversals {
    /// It turns when it goes back by more than `dead`.
    fn follow(&mut self, x: f64, dead: f64) {
        let way = x - self.top;
        let on = way * self.direction > 0.0;
        if !on && way.abs() <= dead {
            return;
        }
        if !on && self.direction != 0.0 {
            close(&mut self.open, self.top);
            self.open.push(self.top);
        }
        (self.top, self.direction) = (x, way.signum());
    }

    /// Those that count, and where it has come to last.
    fn so_far(&self) -> Vec<f64> {
        let mut open = self.open.clone();
        close(&mut open, self.top);
        open.push(self.top);
        open
    }
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

#[cfg(test)]
mod tests {
    use super::Reversals;

    #[test]
    fn a_loop_that_closes_is_forgotten_and_noise_does_not_turn() {
        let turns = |motion: &[f64]| {
            let mut walk = Reversals::default();
            motion.iter().for_each(|x| walk.follow(*x, 0.1));
            walk.so_far()
        };
        assert_eq!(turns(&[0.5, 3.0, 2.95, 3.0, -2.0, 1.0, -1.0]), [3.0, -2.0, 1.0, -1.0]);
        // The inner loop between 1 and -1 closes on the way to 2.
        assert_eq!(turns(&[3.0, -2.0, 1.0, -1.0, 2.0, 1.5]), [3.0, -2.0, 2.0, 1.5]);
        // Beyond the first reversal the virgin curve goes on.
        assert_eq!(turns(&[3.0, -2.0, 1.0, 4.0]), [4.0]);
        assert_eq!(turns(&[3.0, -5.0, 4.0]), [-5.0, 4.0]);
        assert_eq!(turns(&[0.01, -0.02, 0.03]), [0.0]);
    }
}
