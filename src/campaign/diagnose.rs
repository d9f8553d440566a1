//! What the peaks of a whole campaign say about the model, all cells at once: how far it is off, how much of
//! that is its numbers, which effect or correction of the observation takes more away on gaps that were left
//! out, what is ambiguous, what peaks cannot tell.
//!
//! `campaign diagnose` calls it. Every held-out figure comes from a fit that starts cold, from the campaign's
//! own model, and has not seen the gap that it is judged on.

use super::fit::{Cell, Correction, Effort, Fitted, Freedom, Problem, counted_rms};
use super::peaks::LogError;
use super::spec::Configuration;
use crate::model::effects::{self, Place};
use crate::parallel;
use serde::Serialize;

/// Standard errors by which the held-out squares must fall for an addition to be accepted, and within which
/// two of them cannot be told apart.
const DECISIVE: f64 = 2.0;
/// Share of its prior width that a number's interval must stay below to count as tested.
const TESTED: f64 = 0.7;
/// Robust standard deviations beyond which an entry fits no trend.
const ODD: f64 = 4.0;

/// How thoroughly to look.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Depth {
    /// Of fits that are quoted.
    pub full: Effort,
    /// Of the first look at every candidate.
    pub first: Effort,
    /// Candidates that are judged on gaps left out.
    pub finalists: usize,
    /// Threads.
    pub jobs: usize,
}

/// One rung of the ladder from the model as it stands.
#[derive(Clone, Debug, Serialize)]
pub struct Rung {
    /// What was free: `re-identified`, `coulomb-friction + peak-floor`.
    pub name: String,
    /// Numbers moved.
    pub numbers: usize,
    /// RMS of the logarithmic errors over the cells fitted to.
    pub rms: f64,
    /// The same over every gap while it was left out; `null` where nothing is fitted.
    pub held_out: Option<f64>,
    /// Mean errors of A_max, E_max and nu_R, ln.
    pub bias: [f64; 3],
    /// Values with 95 % intervals.
    pub parameters: Vec<Estimate>,
    #[serde(skip)]
    squares: Vec<f64>,
}

/// A number with its interval.
#[derive(Clone, Debug, Serialize)]
pub struct Estimate {
    /// Name.
    pub name: String,
    /// Unit.
    pub unit: String,
    /// Best value.
    pub value: f64,
    /// 2.5 %.
    pub low95: f64,
    /// 97.5 %.
    pub high95: f64,
    /// The interval is far narrower than what was allowed; otherwise peaks say nothing about it.
    pub tested: bool,
}

/// A candidate that was not taken.
#[derive(Clone, Debug, Serialize)]
pub struct Refused {
    /// Its name.
    pub name: String,
    /// Why.
    pub reason: String,
}

/// An entry that fits no trend.
#[derive(Clone, Debug, Serialize)]
pub struct Odd {
    /// `B3-G3-0.04`.
    pub case: String,
    /// `a_max`, `excursion` or `nu_r`.
    pub quantity: &'static str,
    /// ln(model / entry) of the robust fit over all bumpers.
    pub log_error: f64,
    /// The same in robust standard deviations.
    pub deviations: f64,
}

/// What was found.
#[derive(Clone, Debug, Serialize)]
pub struct Diagnosis {
    /// `adequate`, `missing` or `ambiguous`.
    pub verdict: &'static str,
    /// Effects that explain the peaks equally well, best first.
    pub effects: Vec<String>,
    /// Corrections of the observation that do, on top of the best effect.
    pub corrections: Vec<String>,
    /// From the model as it stands to the best.
    pub ladder: Vec<Rung>,
    /// What was not taken, and why.
    pub refused: Vec<Refused>,
    /// Scatter of A_max and E_max among cases that repeat each other (standard deviations).
    pub scatter: Option<[f64; 2]>,
    /// What peaks cannot tell.
    pub cannot_tell: Vec<String>,
    /// What would settle the rest.
    pub next: Vec<&'static str>,
}

struct Study<'a> {
    configuration: &'a Configuration,
    cells: &'a [Cell],
    scatter: [f64; 3],
    depth: Depth,
}

/// Diagnoses cells (of some bumpers) against the campaign's model.
pub fn diagnose(
    configuration: &Configuration,
    cells: &[Cell],
    scatter: [f64; 3],
    depth: Depth,
    tell: &(dyn Fn(&str) + Sync),
) -> Option<Diagnosis> {
    let study = Study { configuration, cells, scatter, depth };
    let fixed = Freedom { fixed: true, ..Freedom::default() };
    let common = Freedom { common_stiffness: true, ..Freedom::default() };
    let mut ladder = vec![study.rung(fixed)?];
    for freedom in [common, Freedom::default()] {
        tell(&freedom.name());
        ladder.push(study.rung(freedom)?);
    }
    let base = ladder.last()?.clone();
    let (finalists, mut refused) = study.first_look(tell)?;
    let mut taken: Vec<Rung> = Vec::new();
    for rung in study
        .rungs(finalists.iter().map(|name| Freedom { effects: vec![name], ..Freedom::default() }).collect())
    {
        study.judge(rung, &base, &mut taken, &mut refused);
    }
    let equal = equals(&mut taken);
    let best = taken.first().cloned();
    ladder.extend(taken.iter().cloned());
    let on_top: Vec<&'static str> =
        best.iter().filter_map(|rung| effects::find(&rung.name).ok().map(|effect| effect.name)).collect();
    tell("corrections of the observation");
    let with =
        |correction| Freedom { effects: on_top.clone(), corrections: vec![correction], ..Freedom::default() };
    let mut corrected: Vec<Rung> = Vec::new();
    for rung in study.rungs(Correction::ALL.into_iter().map(with).collect()) {
        study.judge(rung, best.as_ref().unwrap_or(&base), &mut corrected, &mut refused);
    }
    let corrections = equals(&mut corrected);
    ladder.extend(corrected);
    let verdict = match (equal.len(), corrections.len()) {
        (0, 0) => "adequate",
        (0 | 1, 0 | 1) => "missing",
        _ => "ambiguous",
    };
    let cannot_tell = study.cannot_tell(ladder.last()?);
    Some(Diagnosis {
        verdict,
        effects: equal,
        corrections,
        ladder,
        refused,
        scatter: None,
        cannot_tell,
        next: NEXT.to_vec(),
    })
}

/// What would settle what peaks leave open.
const NEXT: [&str; 4] = [
    "loops A(D) at pseudo-resonance: their width tells dry from viscous loss, their slope the stiffness",
    "D_max and D_min apart: their difference tells a shifted mass or unequal gaps",
    "the true acceleration of the table: it tells a gain of the accelerometers from a drive that gives more",
    "a known mass added, or a static pull: only these fix mass and force apart",
];

impl Study<'_> {
    fn problem(&self, freedom: Freedom) -> Problem<'_> {
        let mut problem = Problem::new(self.configuration, self.cells, freedom);
        problem.scatter = self.scatter;
        problem
    }

    /// Fits to all cells, and to all but one gap in turn.
    fn rung(&self, freedom: Freedom) -> Option<Rung> {
        self.rungs(vec![freedom]).pop()
    }

    fn rungs(&self, freedoms: Vec<Freedom>) -> Vec<Rung> {
        let gaps: Vec<Option<usize>> = std::iter::once(None)
            .chain((0..self.configuration.spec.gap.len()).map(Some))
            .filter(|gap| gap.is_none() || self.cells.iter().any(|cell| cell.case.gap == *gap))
            .collect();
        let jobs: Vec<(usize, Option<usize>)> =
            (0..freedoms.len()).flat_map(|f| gaps.iter().map(move |gap| (f, *gap))).collect();
        let fits = parallel::map(&jobs, self.depth.jobs, |(f, left_out)| {
            let problem = self.problem(freedoms[*f].clone());
            let seen = |cell: &&Cell| left_out.is_none() || cell.case.gap != *left_out;
            let cells: Vec<&Cell> = self.cells.iter().filter(seen).collect();
            problem.fit(&cells, self.depth.full)
        });
        let of = |f: usize| {
            let own: Vec<(Option<usize>, Option<&Fitted>)> = jobs
                .iter()
                .zip(&fits)
                .filter(|((g, _), _)| *g == f)
                .map(|((_, gap), fit)| (*gap, fit.as_ref()))
                .collect();
            self.assemble(freedoms[f].clone(), &own)
        };
        (0..freedoms.len()).filter_map(of).collect()
    }

    fn assemble(&self, freedom: Freedom, fits: &[(Option<usize>, Option<&Fitted>)]) -> Option<Rung> {
        let problem = self.problem(freedom.clone());
        let whole = fits.iter().find(|(gap, _)| gap.is_none())?.1?;
        let all: Vec<&Cell> = self.cells.iter().collect();
        let errors = problem.errors(&whole.x, &all)?;
        let (mut held, mut held_cells) = (Vec::new(), Vec::new());
        for (gap, fit) in fits.iter().filter(|(gap, _)| gap.is_some()) {
            let test: Vec<&Cell> = self.cells.iter().filter(|cell| cell.case.gap == *gap).collect();
            held.extend(problem.errors(&(*fit)?.x, &test)?);
            held_cells.extend(test);
        }
        let moved = !problem.numbers.is_empty();
        Some(Rung {
            name: freedom.name(),
            numbers: problem.numbers.len(),
            rms: counted_rms(&errors, &all),
            held_out: (moved && !held.is_empty()).then(|| counted_rms(&held, &held_cells)),
            bias: bias(&errors),
            parameters: estimates(&problem, whole),
            squares: held.iter().flat_map(LogError::values).map(|e| e * e).collect(),
        })
    }

    /// Every effect of the catalogue once, from its starting value: those that peaks do not feel are refused,
    /// the others ranked by a short fit.
    fn first_look(&self, tell: &(dyn Fn(&str) + Sync)) -> Option<(Vec<&'static str>, Vec<Refused>)> {
        let all: Vec<&Cell> = self.cells.iter().collect();
        let nominal = self.problem(Freedom::default());
        let start = nominal.fit(&all, self.depth.first)?;
        let before = nominal.errors(&start.x, &all)?;
        let candidates: Vec<&'static str> = effects::CATALOGUE
            .iter()
            .filter(|effect| {
                effect.place != Place::User && !effect.is_instrument() && effect.name != "mass-error"
            })
            .map(|effect| effect.name)
            .collect();
        let looked = parallel::map(&candidates, self.depth.jobs, |name| {
            tell(name);
            let problem = self.problem(Freedom { effects: vec![name], ..Freedom::default() });
            let mut x = start.x.clone();
            x.extend(problem.start().into_iter().skip(x.len()));
            let after = problem.errors(&x, &all)?;
            let felt: Vec<LogError> = before
                .iter()
                .zip(&after)
                .map(|(b, a)| LogError {
                    a_max: a.a_max - b.a_max,
                    excursion: a.excursion - b.excursion,
                    nu_r: a.nu_r - b.nu_r,
                })
                .collect();
            let shift = counted_rms(&felt, &all);
            if shift < 0.1 * self.scatter[0] {
                return Some((shift, f64::INFINITY));
            }
            Some((shift, problem.fit_from(&all, x, self.depth.first)?.cost))
        });
        let mut ranked: Vec<(f64, &'static str)> = Vec::new();
        let mut refused = Vec::new();
        for (name, look) in candidates.iter().zip(looked) {
            match look {
                Some((shift, cost)) if cost.is_infinite() => refused.push(Refused {
                    name: (*name).to_owned(),
                    reason: format!("moves no peak by more than {:.2} % at its starting size", 100.0 * shift),
                }),
                Some((_, cost)) => ranked.push((cost, name)),
                None => refused
                    .push(Refused { name: (*name).to_owned(), reason: "cannot be simulated there".into() }),
            }
        }
        ranked.sort_by(|a, b| a.0.total_cmp(&b.0));
        for (cost, name) in ranked.iter().skip(self.depth.finalists) {
            let reason =
                format!("a short fit leaves {cost:.1} of {:.1} squares, more than others", start.cost);
            refused.push(Refused { name: (*name).to_owned(), reason });
        }
        Some((ranked.into_iter().take(self.depth.finalists).map(|(_, name)| name).collect(), refused))
    }

    /// Takes a rung when the squares of the gaps left out fall decisively.
    fn judge(&self, rung: Rung, base: &Rung, taken: &mut Vec<Rung>, refused: &mut Vec<Refused>) {
        let t = paired(&base.squares, &rung.squares);
        if t >= DECISIVE {
            taken.push(rung);
            return;
        }
        let (held, before) = (rung.held_out.unwrap_or(f64::NAN), base.held_out.unwrap_or(f64::NAN));
        let reason = format!(
            "left-out gaps: {:.1} % after {:.1} %, which is {t:.1} standard errors; {DECISIVE} are asked",
            100.0 * held,
            100.0 * before
        );
        refused.push(Refused { name: rung.name, reason });
    }

    fn cannot_tell(&self, best: &Rung) -> Vec<String> {
        let mut list = vec![
            "the mass: every column is kinematic, and mass, stiffnesses and dampings times one factor leave all peaks as they are"
                .to_owned(),
            "which side: gap asymmetry and constant force act on D_max and D_min, of which only the difference is there".to_owned(),
            "delays of the instruments: peaks have no phase".to_owned(),
        ];
        for number in best.parameters.iter().filter(|number| !number.tested) {
            list.push(format!(
                "{}: its interval is as wide as what was allowed; the cells do not test it",
                number.name
            ));
        }
        list
    }
}

/// Sorts by held-out error; names of those that cannot be told from the best.
fn equals(taken: &mut [Rung]) -> Vec<String> {
    taken.sort_by(|a, b| a.held_out.unwrap_or(f64::INFINITY).total_cmp(&b.held_out.unwrap_or(f64::INFINITY)));
    let Some(best) = taken.first() else { return Vec::new() };
    let near = taken.iter().filter(|rung| paired(&rung.squares, &best.squares) < DECISIVE);
    near.map(|rung| rung.name.clone()).collect()
}

/// Fall of the mean square from `before` to `after`, in its standard errors over the same cells.
fn paired(before: &[f64], after: &[f64]) -> f64 {
    let n = before.len().min(after.len()) as f64;
    if n < 2.0 {
        return 0.0;
    }
    let falls: Vec<f64> = before.iter().zip(after).map(|(b, a)| b - a).collect();
    let mean = falls.iter().sum::<f64>() / n;
    let variance = falls.iter().map(|f| (f - mean).powi(2)).sum::<f64>() / (n - 1.0);
    if variance > 0.0 { mean / (variance / n).sqrt() } else { 0.0 }
}

fn bias(errors: &[LogError]) -> [f64; 3] {
    let n = errors.len().max(1) as f64;
    std::array::from_fn(|k| errors.iter().map(|e| e.values()[k]).sum::<f64>() / n)
}

fn estimates(problem: &Problem<'_>, fit: &Fitted) -> Vec<Estimate> {
    let one = |((number, x), sigma): ((&super::fit::Number, &f64), &f64)| Estimate {
        name: number.name.replacen("base ", "", 1),
        unit: number.unit.clone(),
        value: number.value(*x),
        low95: number.value(x - 1.96 * sigma),
        high95: number.value(x + 1.96 * sigma),
        tested: *sigma < TESTED * number.free.prior.1,
    };
    problem.numbers.iter().zip(&fit.x).zip(&fit.sigma).map(one).collect()
}

/// Entries that fit no smooth trend: a robust fit of the model to all cells, and what lies far beyond its own
/// scatter.
pub fn odd_entries(configuration: &Configuration, cells: &[Cell], effort: Effort) -> Option<Vec<Odd>> {
    let mut problem = Problem::new(configuration, cells, Freedom::default());
    problem.robust = true;
    let all: Vec<&Cell> = cells.iter().collect();
    let fit = problem.fit(&all, effort)?;
    let errors = problem.errors(&fit.x, &all)?;
    let mut odd = Vec::new();
    for (k, quantity) in ["a_max", "excursion", "nu_r"].into_iter().enumerate() {
        let values: Vec<f64> = errors.iter().map(|e| e.values()[k]).collect();
        let centre = median(values.clone());
        // 1.4826 times the median deviation is the standard deviation of a normal scatter.
        let spread = 1.4826 * median(values.iter().map(|v| (v - centre).abs()).collect());
        for (cell, value) in all.iter().zip(&values) {
            let deviations = (value - centre) / spread.max(0.02);
            if deviations.abs() > ODD {
                odd.push(Odd { case: cell.case.label.clone(), quantity, log_error: *value, deviations });
            }
        }
    }
    odd.sort_by(|a, b| b.deviations.abs().total_cmp(&a.deviations.abs()));
    Some(odd)
}

fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    match values.len() {
        0 => 0.0,
        n if n % 2 == 1 => values[n / 2],
        n => 0.5 * (values[n / 2 - 1] + values[n / 2]),
    }
}
