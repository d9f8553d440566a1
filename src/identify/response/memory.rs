//! What effects remember of the whole record before a part of it. The states of a springpot forget by a power law; they depend on
//! the motion alone and are carried along it once for all fits. A hysteresis stays as larger motions left it; its states depend on its
//! numbers, too, and are carried along once for all fits and slopes that have those.

use super::{Measured, Window};
use crate::model::{self, EffectSpec, IsolatorSpec, ModelSpec, Specimen};
use std::sync::{Arc, Mutex, OnceLock, PoisonError};

/// So many walks are kept: a model and those with one of the numbers of an effect moved to either side, of some fits at once.
const KEPT: usize = 48;

/// States where each window of a record begins to be warmed up, in their order, as soon as somebody has gone there.
pub(super) type Walked = Arc<OnceLock<Vec<Vec<f64>>>>;

/// Walks along records, the newest last.
#[derive(Default)]
pub(super) struct Walks(Mutex<Vec<(Walk, Walked)>>);

/// What a walk depends on.
#[derive(Clone, PartialEq)]
pub(super) struct Walk {
    /// What has states.
    pub effects: Vec<EffectSpec>,
    /// Number of the record.
    pub source: usize,
    /// Zero of its displacement, m.
    pub zero_m: f64,
    /// Its windows are warmed up from farther back, for tips that creep.
    pub creeps: bool,
}

impl Walks {
    /// Where such a walk leads, gone already or not.
    pub(super) fn of(&self, walk: Walk) -> Walked {
        let mut kept = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some((_, walked)) = kept.iter().find(|(of, _)| *of == walk) {
            return walked.clone();
        }
        if kept.len() == KEPT {
            kept.remove(0);
        }
        let walked = Walked::default();
        kept.push((walk, walked.clone()));
        walked
    }
}

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
                    _ => match springpot(motion.dt_s(), motion.fastest_hz) {
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
        let index = self.motion.windows.iter().position(|w| std::ptr::eq(w, window));
        index.and_then(|index| all.get(index)).map_or(&[], Vec::as_slice)
    }
}

/// A specimen that is nothing but a springpot.
fn springpot(dt_s: f64, fastest_hz: f64) -> Option<Box<dyn Specimen>> {
    let isolator = IsolatorSpec { stiffness_n_m: vec![1.0], breakpoints_m: vec![], damping_n_s_m: 0.0 };
    let parameters = [("ca".to_owned(), 1.0), ("alpha".to_owned(), 0.5)].into_iter().collect();
    let mut spring = EffectSpec { name: "fractional-damping".into(), expression: None, parameters };
    spring.hold_up_to(fastest_hz);
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
