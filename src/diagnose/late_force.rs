//! The force of a component that comes later, or earlier, than the motion that it takes: both sensors have chains of their own, and a
//! part of a sample makes memory, or friction of two kinds, of what is none. No kinematics tell it. What explains the record with a lag,
//! and not without, does; a spring and a dashpot alone know it only as another dashpot. The engine asks, and `effect add`.

use super::candidates::GOLDEN;
use super::search::{Searcher, Stage};
use super::thresholds::Thresholds;
use super::trial::Trial;
use super::verdict;
use crate::identify::answered;
use crate::model::ModelSpec;
use crate::parallel;
use crate::record::Kind;

/// Farthest lag that is looked for and the least that is spoken of, samples.
const FARTHEST: f64 = 3.0;
const LEAST: f64 = 0.05;
/// It is known to so much of a sample.
const KNOWN_TO: f64 = 0.02;
/// So many explanations of one effect are asked beside the model itself.
const ASKED: usize = 3;
/// Share of the structure that a lag leaves at most where noise is not all that is left.
const LEFT: f64 = 0.5;

/// An explanation with the lag that suits it best.
#[derive(Clone, Debug)]
pub(super) struct Lagging {
    /// The force comes so much later than the motion, s; below zero earlier.
    pub(super) late_s: f64,
    /// The explanation without it, and with it.
    without: Trial,
    with: Trial,
    /// Noise is all that is left with it.
    pub(super) explains: bool,
}

impl Lagging {
    /// Whether a lag is the reason rather than what a search without one chose: it takes fewer effects and leaves less, or as many and
    /// much less.
    pub(super) fn is_rather_than(&self, chosen: &Trial) -> bool {
        let fewer = self.with.names.len() < chosen.names.len();
        let much_less =
            self.with.names.len() == chosen.names.len() && self.with.excess() < LEFT * chosen.excess();
        (fewer || much_less) && verdict::apart(&self.with, chosen) > 0.0
    }

    /// Whether the model with its effects is all that is looked for and the lag brings so much beside it.
    pub(super) fn is_told(&self) -> bool {
        self.explains || self.with.excess() < LEFT * self.without.excess()
    }
}

/// Of a component: the lag with which the model or one effect explains its record where neither does without; else that of the best of
/// them. Nothing where no lag is needed, or none brings anything.
pub(super) fn of_component(
    searcher: &Searcher<'_>,
    nominal: &ModelSpec,
    (base, first): (&Trial, &Stage),
    thresholds: Thresholds,
) -> Option<Lagging> {
    let explains = |trial: &Trial| verdict::leaves_noise(searcher, trial, thresholds);
    let brings = |trial: &Trial| verdict::brings(trial, base, thresholds);
    if explains(base) && !first.finalists.iter().any(brings) {
        return None;
    }
    // Where one effect explains it, what else may is the model alone.
    let explained = first.finalists.iter().filter(|trial| explains(trial)).reduce(verdict::better);
    let mut asked: Vec<&Trial> = vec![base];
    if explained.is_none() {
        asked.extend(first.finalists.iter().take(ASKED));
    }
    let found = parallel::map(&asked, parallel::cores(), |trial| lag(searcher, nominal, trial, thresholds));
    let found: Vec<Lagging> = found.into_iter().flatten().collect();
    if let Some(explained) = explained {
        let likelier = |found: &Lagging| found.explains && verdict::apart(&found.with, explained) > 0.0;
        return found.into_iter().find(likelier);
    }
    let simple = found.iter().find(|found| found.explains && found.with.names.is_empty());
    let best = found.iter().reduce(
        |best, found| {
            if verdict::apart(&found.with, &best.with) > 0.0 { found } else { best }
        },
    );
    simple.or(best).cloned()
}

/// The lag of a component's force that suits a fitted explanation best; nothing where it brings nothing.
pub(super) fn lag(
    searcher: &Searcher<'_>,
    nominal: &ModelSpec,
    trial: &Trial,
    thresholds: Thresholds,
) -> Option<Lagging> {
    if searcher.motion.kind != Kind::Component {
        return None;
    }
    let dt_s = searcher.motion.dt_s();
    let at = |samples: f64| -> Option<(Trial, bool)> {
        let motion = answered(searcher.motion, samples * dt_s);
        let moved = Searcher::new(&motion, nominal, searcher.effort);
        let trial = moved.fitted_by_force(trial)?;
        let explains = verdict::leaves_noise(&moved, &trial, thresholds);
        Some((trial, explains))
    };
    let cost = |samples: f64| at(samples).map_or(f64::INFINITY, |(trial, _)| trial.objective);
    let samples = least(cost, (-FARTHEST, FARTHEST), KNOWN_TO);
    if samples.abs() < LEAST || samples.abs() > FARTHEST - 2.0 * KNOWN_TO {
        return None;
    }
    let (without, (with, explains)) = (searcher.fitted_by_force(trial)?, at(samples)?);
    let brings = verdict::brings(&with, &without, thresholds);
    brings.then_some(Lagging { late_s: samples * dt_s, without, with, explains })
}

/// Place of the least of a function of one valley (golden section; Kiefer, Proc. Am. Math. Soc. 4 (1953) 502), to so much.
fn least(of: impl Fn(f64) -> f64, (mut from, mut to): (f64, f64), known_to: f64) -> f64 {
    let (mut low, mut high) = (to - GOLDEN * (to - from), from + GOLDEN * (to - from));
    let (mut at_low, mut at_high) = (of(low), of(high));
    while to - from > known_to {
        if at_low < at_high {
            (to, high, at_high) = (high, low, at_low);
            low = to - GOLDEN * (to - from);
            at_low = of(low);
        } else {
            (from, low, at_low) = (low, high, at_high);
            high = from + GOLDEN * (to - from);
            at_high = of(high);
        }
    }
    0.5 * (from + to)
}
