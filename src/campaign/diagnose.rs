//! What the peaks of a whole campaign say about the model, all cells at once: how far it is off, how much of
//! that is its numbers, which effect or correction of the observation takes more away on gaps that were left
//! out, what is ambiguous, what peaks cannot tell.
//!
//! `campaign diagnose` calls it. Every held-out figure comes from a fit that starts cold, from the campaign's
//! own model, and has not seen the gap that it is judged on.

use super::first_look::first_look;
use super::fit::{Cell, Correction, Freedom};
use super::ladder::{Depth, Rung, Study, paired};
use super::odd::{Odd, odd_entries, without};
use super::spec::Configuration;
use crate::diagnose::candidates::contained_in;
use crate::model::effects;
use serde::Serialize;

/// Standard errors by which the held-out squares must fall for an addition to be accepted, and within which
/// two of them cannot be told apart.
pub(super) const DECISIVE: f64 = 2.0;
/// Squares after a full fit, over those of the best, beyond which a candidate is not judged on gaps left out.
const HOPELESS: f64 = 1.3;

/// A candidate that was not taken.
#[derive(Clone, Debug, Serialize)]
pub struct Refused {
    /// Its name.
    pub name: String,
    /// Why.
    pub reason: String,
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
    /// Place of the best in the ladder.
    pub best: usize,
    /// What was not taken, and why.
    pub refused: Vec<Refused>,
    /// Scatter of A_max and E_max among cases that repeat each other (standard deviations).
    pub scatter: Option<[f64; 2]>,
    /// Entries that fit no smooth trend.
    pub odd: Vec<Odd>,
    /// The best over all bumpers, odd entries left out; `null` where no other bumpers are.
    pub all_bumpers: Option<Rung>,
    /// What peaks cannot tell.
    pub cannot_tell: Vec<String>,
    /// What would settle the rest.
    pub next: Vec<&'static str>,
}

/// Peaks to diagnose.
#[derive(Clone, Debug)]
pub struct Given {
    /// Cells of the bumpers that the search is made on.
    pub cells: Vec<Cell>,
    /// Cells of all bumpers.
    pub all: Vec<Cell>,
    /// Standard deviations that errors of A_max, E_max and nu_R are measured in (logarithms).
    pub scatter: [f64; 3],
    /// Standard deviations of A_max and E_max among cases that repeat each other, where there are any.
    pub repeats: Option<[f64; 2]>,
}

/// Diagnoses a table of peaks against the campaign's model. `None` when that cannot be simulated.
pub fn diagnose(
    configuration: &Configuration,
    given: &Given,
    depth: Depth,
    tell: &(dyn Fn(&str) + Sync),
) -> Option<Diagnosis> {
    let study = Study { configuration, cells: &given.cells, scatter: given.scatter, depth };
    let fixed = Freedom { fixed: true, ..Freedom::default() };
    let common = Freedom { common_stiffness: true, ..Freedom::default() };
    let mut ladder = vec![study.rung(fixed)?];
    for freedom in [common, Freedom::default()] {
        let rung = study.rung(freedom)?;
        tell(&rung.line());
        ladder.push(rung);
    }
    let mut best = ladder.len() - 1;
    let (finalists, mut refused) = first_look(&study, &ladder[best].x, tell)?;
    tell(&format!("gaps left out: {}", finalists.join(", ")));
    let with = |name: &&'static str| Freedom { effects: vec![*name], ..Freedom::default() };
    let mut taken = study.judged(finalists.iter().map(with).collect(), &ladder[best], &mut refused, tell);
    simplest(&mut taken, &mut refused);
    let equal = equals(&taken);
    best = plainest(&taken, &equal).map_or(best, |at| ladder.len() + at);
    ladder.extend(taken);
    tell("corrections of the observation");
    let on_top = ladder[best].freedom.effects.clone();
    let with =
        |correction| Freedom { effects: on_top.clone(), corrections: vec![correction], ..Freedom::default() };
    let corrected =
        study.judged(Correction::ALL.into_iter().map(with).collect(), &ladder[best], &mut refused, tell);
    let corrections = equals(&corrected);
    best = if corrected.is_empty() { best } else { ladder.len() };
    ladder.extend(corrected);
    let verdict = match (equal.len(), corrections.len()) {
        (0, 0) => "adequate",
        (0 | 1, 0 | 1) => "missing",
        _ => "ambiguous",
    };
    let cannot_tell = cannot_tell(&ladder[best], given.repeats);
    tell("entries that fit no trend");
    let freedom = ladder[best].freedom.clone();
    let odd = odd_entries(configuration, &given.all, freedom.clone(), depth.held_out).unwrap_or_default();
    let mut all_bumpers = None;
    if given.all.len() > given.cells.len() {
        tell("all bumpers");
        let cells = without(&given.all, &odd);
        all_bumpers = Study { cells: &cells, ..study }.rung(freedom);
        all_bumpers.iter().for_each(|rung| tell(&rung.line()));
    }
    let (scatter, next) = (given.repeats, NEXT.to_vec());
    Some(Diagnosis {
        verdict,
        effects: equal,
        corrections,
        ladder,
        best,
        refused,
        scatter,
        odd,
        all_bumpers,
        cannot_tell,
        next,
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
    /// Those rungs whose squares of the gaps left out fall decisively below those of a base, best first.
    fn judged(
        &self,
        freedoms: Vec<Freedom>,
        base: &Rung,
        refused: &mut Vec<Refused>,
        tell: &(dyn Fn(&str) + Sync),
    ) -> Vec<Rung> {
        let fits = self.wholes(&freedoms);
        let least = fits.iter().flatten().map(|fit| fit.cost).fold(f64::INFINITY, f64::min);
        let mut near = Vec::new();
        for (freedom, fit) in freedoms.into_iter().zip(fits) {
            match fit {
                Some(fit) if fit.cost <= HOPELESS * least => near.push((freedom, fit)),
                fit => {
                    let left = fit.map_or("nothing that can be simulated".to_owned(), |fit| {
                        format!("{:.1} squares of the cells fitted to", fit.cost)
                    });
                    let reason = format!("leaves {left}, where the best leaves {least:.1}");
                    refused.push(Refused { name: freedom.name(), reason });
                }
            }
        }
        let mut taken = Vec::new();
        for rung in self.rungs(&near) {
            tell(&rung.line());
            let t = paired(&base.squares, &rung.squares);
            if t >= DECISIVE {
                taken.push(rung);
                continue;
            }
            let (held, before) = (rung.held_out.unwrap_or(f64::NAN), base.held_out.unwrap_or(f64::NAN));
            let reason = format!(
                "left-out gaps: {:.1} % after {:.1} %, which is {t:.1} standard errors; {DECISIVE} are asked",
                100.0 * held,
                100.0 * before
            );
            refused.push(Refused { name: rung.name, reason });
        }
        let held = |rung: &Rung| rung.held_out.unwrap_or(f64::INFINITY);
        taken.sort_by(|a, b| held(a).total_cmp(&held(b)));
        taken
    }
}

/// Refuses effects that contain a simpler one of the same place that does as well.
fn simplest(taken: &mut Vec<Rung>, refused: &mut Vec<Refused>) {
    let place = |name: &str| effects::find(name).ok().map(|effect| effect.place);
    let simpler = |rung: &Rung, other: &Rung| {
        contained_in(&rung.name).contains(&other.name.as_str())
            && place(&rung.name) == place(&other.name)
            && paired(&other.squares, &rung.squares) < DECISIVE
    };
    let all = taken.clone();
    taken.retain(|rung| match all.iter().find(|other| simpler(rung, other)) {
        None => true,
        Some(other) => {
            let reason = format!("contains {}, which does as well with less", other.name);
            refused.push(Refused { name: rung.name.clone(), reason });
            false
        }
    });
}

fn cannot_tell(best: &Rung, repeats: Option<[f64; 2]>) -> Vec<String> {
    let mut list = Vec::new();
    if let Some([a, e]) = repeats {
        let [own_a, own_e, _] = best.rms_of.map(|rms| 100.0 * rms);
        list.push(format!(
            "anything finer than their own scatter: cases that repeat each other differ by {:.0} % in A and {:.0} % in E; the best fit is {own_a:.1} % and {own_e:.1} % off",
            100.0 * a,
            100.0 * e
        ));
    }
    list.extend(ALWAYS.map(str::to_owned));
    for number in best.parameters.iter().filter(|number| !number.tested) {
        list.push(format!(
            "{}: its interval is as wide as what was allowed; the cells do not test it",
            number.name
        ));
    }
    list
}

/// What no table of peaks can tell.
const ALWAYS: [&str; 3] = [
    "the mass: every column is kinematic, and mass, stiffnesses and dampings times one factor leave all peaks as they are",
    "which side: gap asymmetry and constant force act on D_max and D_min, of which only the difference is there",
    "delays of the instruments: peaks have no phase",
];

/// Of those that cannot be told apart the one with the fewest numbers, of these the best.
fn plainest(taken: &[Rung], equal: &[String]) -> Option<usize> {
    let alike = taken.iter().enumerate().filter(|(_, rung)| equal.contains(&rung.name));
    alike.min_by_key(|(_, rung)| rung.numbers).map(|(at, _)| at)
}

/// Names of those that cannot be told from the best, which comes first.
fn equals(taken: &[Rung]) -> Vec<String> {
    let Some(best) = taken.first() else { return Vec::new() };
    let near = taken.iter().filter(|rung| paired(&rung.squares, &best.squares) < DECISIVE);
    near.map(|rung| rung.name.clone()).collect()
}
