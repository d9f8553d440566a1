//! Which effects of the catalogue are worth a full fit to peaks: each is put on top of the identified numbers at
//! several sizes, and what the identified numbers can make up for is taken away along their slopes, which are
//! computed once. [`super::diagnose`] calls it.

use super::diagnose::{DECISIVE, Refused};
use super::fit::{Cell, Freedom, Look, Problem};
use super::ladder::Study;
use crate::diagnose::candidates::{acts_on_motion, contained_in};
use crate::identify::least_squares;
use crate::model::effects::{self, Effect};
use crate::parallel;
use nalgebra::{DMatrix, DVector};

/// Sizes at which an effect is looked at: logarithms of the factor on its starting value.
const SIZES: [f64; 5] = [-1.0, 0.0, 0.75, 1.5, 2.25];
/// Steps along the slopes from each size.
const STEPS: usize = 3;
/// Longest of them in one number, as a logarithm.
const LONGEST: f64 = 0.7;
/// Share of the scatter that an effect must move the peaks by (RMS) at the strongest it is looked at.
const FELT: f64 = 0.1;
/// Squares after a short fit, over those of the best, within which an effect is fitted in full.
const WITHIN: f64 = 1.5;
/// Mean square beyond which short fits are still on their way and say little of where they would end.
const UNSETTLED: f64 = 4.0;
/// Candidates for a short fit beyond those that may be fitted in full.
const SHORT_FITS: usize = 3;

/// Numbers without effects, the errors they leave (in units of the scatter), and the slopes of these.
struct Identified {
    x: Vec<f64>,
    errors: Vec<f64>,
    slopes: DMatrix<f64>,
}

/// An effect at the best of its sizes.
struct Looked {
    /// RMS by which it moves the peaks where everything else stays, in units of the scatter.
    felt: f64,
    /// What is left, priors included, and where.
    cost: f64,
    x: Vec<f64>,
}

/// Effects worth a full fit, best first, and why the others are not: those that peaks do not feel, and those that
/// leave more after a short fit. One that contains a simpler one of the same place must do better than it.
pub(super) fn first_look(
    study: &Study<'_>,
    identified: &[f64],
    tell: &(dyn Fn(&str) + Sync),
) -> Option<(Vec<&'static str>, Vec<Refused>)> {
    let cells: Vec<&Cell> = study.cells.iter().collect();
    let difference = study.depth.first.difference;
    let base = Identified::at(&study.problem(Freedom::default()), identified, &cells, difference)?;
    let candidates: Vec<&'static Effect> =
        effects::CATALOGUE.iter().copied().filter(|effect| acts_on_motion(effect)).collect();
    let problem =
        |effect: &Effect| study.problem(Freedom { effects: vec![effect.name], ..Freedom::default() });
    let looked = parallel::map(&candidates, study.depth.jobs, |effect| {
        tell(effect.name);
        base.look(&problem(effect), &cells)
    });
    let mut refused = Vec::new();
    let mut refuse =
        |effect: &Effect, reason: String| refused.push(Refused { name: effect.name.to_owned(), reason });
    let mut ranked: Vec<(f64, &'static Effect, Vec<f64>)> = Vec::new();
    for (effect, look) in candidates.into_iter().zip(looked) {
        match look {
            Some(look) if look.felt < FELT => {
                let shift = 100.0 * look.felt * study.scatter[0];
                refuse(effect, format!("moves no peak by more than {shift:.2} %"));
            }
            Some(look) => ranked.push((look.cost, effect, look.x)),
            None => refuse(effect, "cannot be simulated there".to_owned()),
        }
    }
    let more = |left: f64| format!("leaves {left:.1} squares at first sight, more than others");
    ranked.sort_by(|a, b| a.0.total_cmp(&b.0));
    let short = SHORT_FITS + study.depth.finalists;
    ranked.iter().skip(short).for_each(|(cost, effect, _)| refuse(effect, more(*cost)));
    ranked.truncate(short);
    let fits = parallel::map(&ranked, study.depth.jobs, |(_, effect, x)| {
        tell(effect.name);
        Some(problem(effect).fit_from(&cells, vec![x.clone()], study.depth.first)?.cost)
    });
    for (entry, cost) in ranked.iter_mut().zip(fits) {
        entry.0 = cost.unwrap_or(entry.0).min(entry.0);
    }
    ranked.sort_by(|a, b| a.0.total_cmp(&b.0));
    let least = ranked.first().map_or(f64::INFINITY, |(cost, _, _)| *cost);
    let unsettled = least > UNSETTLED * base.errors.len() as f64;
    let mut finalists: Vec<&'static str> = Vec::new();
    for (cost, effect, _) in &ranked {
        let simpler = ranked.iter().find(|(other_cost, other, _)| {
            contained_in(effect.name).contains(&other.name)
                && effect.place == other.place
                && other_cost - cost < DECISIVE * DECISIVE
        });
        // Whatever a finalist contains is fitted in full as well: it needs less to explain as much.
        let contained = finalists.iter().any(|finalist| contained_in(finalist).contains(&effect.name));
        let room = finalists.len() < study.depth.finalists && (unsettled || *cost <= WITHIN * least);
        if let Some((_, other, _)) = simpler {
            refuse(effect, format!("contains {}, which does as well with less", other.name));
        } else if contained || room {
            finalists.push(effect.name);
        } else {
            refuse(effect, more(*cost));
        }
    }
    Some((finalists, refused))
}

impl Identified {
    fn at(problem: &Problem<'_>, x: &[f64], cells: &[&Cell], difference: f64) -> Option<Self> {
        let errors = errors(problem, x, cells)?;
        let mut slopes = DMatrix::zeros(errors.len(), x.len());
        for (j, number) in problem.numbers.iter().enumerate() {
            let mut at = x.to_vec();
            let step = difference * number.free.scale;
            at[j] += step;
            let there = self::errors(problem, &at, cells)?;
            let column = there.iter().zip(&errors).map(|(there, here)| (there - here) / step);
            slopes.set_column(j, &DVector::from_iterator(errors.len(), column));
        }
        Some(Self { x: x.to_vec(), errors, slopes })
    }

    /// The best size of an effect, the other numbers following along their slopes.
    fn look(&self, problem: &Problem<'_>, cells: &[&Cell]) -> Option<Looked> {
        let mut start = problem.start();
        start.iter_mut().zip(&self.x).for_each(|(x, known)| *x = *known);
        let count = self.errors.len().max(1) as f64;
        let mut felt: Option<f64> = None;
        let mut best: Option<(f64, Vec<f64>)> = None;
        for size in SIZES {
            let mut x = problem.at_size(&start, size);
            for step in 0..=STEPS {
                let Some(errors) = errors(problem, &x, cells) else { break };
                if step == 0 {
                    let moved: f64 = errors.iter().zip(&self.errors).map(|(a, b)| (a - b).powi(2)).sum();
                    let moved = (moved / count).sqrt();
                    felt = Some(felt.map_or(moved, |felt| felt.max(moved)));
                }
                let prior = least_squares::prior_sum(&problem.free_from(x.clone()), &x);
                let cost = least_squares::sum_of_squares(&errors) + prior;
                if best.as_ref().is_none_or(|(least, _)| cost < *least) {
                    best = Some((cost, x.clone()));
                }
                self.follow(problem, &mut x, &errors);
            }
        }
        let (cost, x) = best?;
        Some(Looked { felt: felt?, cost, x })
    }

    /// One Gauss-Newton step of the identified numbers.
    fn follow(&self, problem: &Problem<'_>, x: &mut [f64], errors: &[f64]) {
        let mut normal = self.slopes.transpose() * &self.slopes;
        let mut right = -(self.slopes.transpose() * DVector::from_column_slice(errors));
        for (j, number) in problem.numbers.iter().take(self.x.len()).enumerate() {
            let (mean, sigma) = number.free.prior;
            normal[(j, j)] += sigma.powi(-2);
            right[j] -= (x[j] - mean) * sigma.powi(-2);
        }
        let Some(factors) = normal.cholesky() else { return };
        for ((x, step), number) in x.iter_mut().zip(factors.solve(&right).iter()).zip(&problem.numbers) {
            *x = (*x + step.clamp(-LONGEST, LONGEST)).clamp(number.free.bounds.0, number.free.bounds.1);
        }
    }
}

fn errors(problem: &Problem<'_>, x: &[f64], cells: &[&Cell]) -> Option<Vec<f64>> {
    let mut errors = Vec::new();
    problem.residuals(x, cells, Look::Smooth, &mut errors).then_some(errors)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::campaign::fit::{self, Effort};
    use crate::campaign::ladder::Depth;
    use crate::campaign::tables::Origin;
    use crate::campaign::testing::published;

    #[test]
    fn hidden_friction_is_a_finalist_and_every_candidate_gets_an_answer() {
        let study = published();
        let configuration = &study.configuration;
        let mut cells = fit::cells(configuration, study.of(Origin::Published));
        cells.retain(|cell| cell.case.bumper < 2 && cell.case.gap.is_none_or(|gap| gap % 2 == 0));
        // 40 N of dry friction, a softer isolator and less viscous damping than the campaign's model has.
        let hidden = Freedom { effects: vec!["coulomb-friction"], ..Freedom::default() };
        let problem = Problem::new(configuration, &cells, hidden);
        let put = |number: &crate::campaign::numbers::Number| match number.name.as_str() {
            name if name.contains("fc_n") => (40.0 / number.value(0.0)).ln(),
            name if name.contains("damping") => -0.2,
            name if name.contains("stiffness_n_m[0]") => -0.05,
            _ => 0.0,
        };
        let truth: Vec<f64> = problem.numbers.iter().map(put).collect();
        let observed: Vec<_> =
            cells.iter().map(|cell| problem.predict(&truth, cell).expect("solved")).collect();
        cells.iter_mut().zip(observed).for_each(|(cell, observed)| cell.observed = observed);
        let first = Effort { iterations: 2, ..Effort::QUICK };
        let depth =
            Depth { full: first, held_out: first, first, finalists: 3, jobs: crate::parallel::cores() };
        let study = Study { configuration, cells: &cells, scatter: [0.02, 0.02, 0.04], depth };
        let all: Vec<&Cell> = cells.iter().collect();
        let identified = study.problem(Freedom::default()).fit(&all, Effort::QUICK).expect("fits");
        let (finalists, refused) = first_look(&study, &identified.x, &|_| {}).expect("looks");
        // Bouc-Wen hysteresis contains it, and a short fit may take it further.
        assert!(finalists.contains(&"coulomb-friction"), "{finalists:?} {refused:?}");
        assert!(finalists.len() <= 4 && !finalists.contains(&"stribeck-friction"), "{finalists:?}");
        let candidates = effects::CATALOGUE.iter().copied().filter(|effect| acts_on_motion(effect)).count();
        assert_eq!(finalists.len() + refused.len(), candidates);
    }
}
