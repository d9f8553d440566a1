//! The last fit of a model that is to follow a run: numbers that no steady step tells (a slope beyond the last knee) from the cycles
//! in which the mass goes farther than in any of them. Called where a model is written to a file.

use super::contest::FURTHER_ON;
use super::search::{Effort, Searcher, UNSEEN};
use super::trial::Trial;
use crate::identify::least_squares::Settings;
use crate::identify::motion::Motion;
use crate::model::ModelSpec;
use crate::record::Record;

const SETTINGS: Settings = Settings { iterations: 30, ..FURTHER_ON };

/// A fitted explanation of a record and its motion with those of its numbers that the steady steps leave as they were given fitted to
/// the cycles in which the mass goes farther, from where they are and from where the force along the motion puts them; everything else moves within what the steady
/// steps told, and stays as they told it. As it is where there are no such numbers or no such cycles.
pub fn out_there(record: &Record, motion: &Motion, nominal: &ModelSpec, trial: Trial) -> Trial {
    farther(record, motion, nominal, &trial).unwrap_or(trial)
}

fn farther(record: &Record, motion: &Motion, nominal: &ModelSpec, trial: &Trial) -> Option<Trial> {
    trial.response.as_ref()?;
    let mut refit = trial.refit.clone();
    let told = refit.numbers.numbers.iter().zip(&refit.numbers.free).zip(&refit.sigmas);
    let unseen: Vec<String> = told
        .filter(|((number, free), sigma)| {
            !number.key.starts_with("effect[") && **sigma > UNSEEN * free.prior.1
        })
        .map(|((number, _), _)| number.key.clone())
        .collect();
    if unseen.is_empty() {
        return None;
    }
    let motion = motion.farthest(record).ok()?;
    if !motion.windows.iter().any(|window| window.settling) {
        return None;
    }
    let searcher = Searcher::new(&motion, nominal, Effort::default());
    let measured = searcher.measured.as_ref()?.settling();
    // What the steady steps told stands as it was told.
    let mut numbers = refit.numbers.clone();
    numbers.start_from(&refit.spec);
    let mut by_force = refit.spec.clone();
    for (j, free) in numbers.free.iter_mut().enumerate() {
        if unseen.contains(&free.key) {
            by_force.set(&free.key, searcher.fitted.as_ref()?.spec.get(&free.key).ok()?).ok()?;
        } else {
            free.prior = (refit.fit.values[j], refit.sigmas[j].max(1e-9 * free.scale));
        }
    }
    let fit = |start: &ModelSpec| {
        let mut numbers = numbers.clone();
        numbers.start_from(start);
        measured.fit(start, &numbers, refit.zero_m, None, SETTINGS)
    };
    let starts = [&refit.spec, &by_force];
    let laid = starts.into_iter().filter_map(fit).min_by(|a, b| a.total().total_cmp(&b.total()))?;
    // Too little is told there to be sure: limits stay as wide as they were.
    let mut there = refit.spec.clone();
    numbers.put(&laid.values, &mut there).then_some(())?;
    for (j, number) in numbers.numbers.iter().enumerate().filter(|(_, number)| unseen.contains(&number.key)) {
        refit.spec.set(&number.key, there.get(&number.key).ok()?).ok()?;
        let by = laid.values[j] - refit.fit.values[j];
        refit.fit.values[j] += by;
        if let Some((low, high)) = refit.limits.get_mut(j) {
            (*low, *high) = (*low + by, *high + by);
        }
    }
    Some(Trial { refit, ..trial.clone() })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::diagnose::testing::seen;
    use crate::identify::kinematics::Tolerances;
    use crate::model::testing::b1_g2;

    #[test]
    fn a_slope_that_the_mass_reaches_only_while_it_settles_is_found() {
        let mut truth = b1_g2();
        truth.bumper = None;
        truth.isolator.stiffness_n_m[2] = 6000.0;
        let largest = |motion: &Motion, settling: bool| {
            let windows = motion.windows.iter().filter(|w| w.settling == settling);
            let all = windows.flat_map(|w| &motion.displacement_m[w.range.clone()]);
            all.fold(0.0_f64, |top, d| top.max(d.abs()))
        };
        let with = |truth: &ModelSpec| {
            let record = seen(truth, 5);
            let motion = Motion::of(&record, 500.0, Tolerances::default()).expect("sound");
            let motion = motion.farthest(&record).expect("sound");
            (record, largest(&motion, false), largest(&motion, true))
        };
        // The knee between where the mass is steady and where it settles.
        let (_, steady_m, settling_m) = with(&truth);
        truth.isolator.breakpoints_m[1] = 0.5 * (steady_m + settling_m);
        let (record, steady_m, settling_m) = with(&truth);
        let knee_m = truth.isolator.breakpoints_m[1];
        assert!(steady_m < knee_m && knee_m < settling_m, "{steady_m} {knee_m} {settling_m}");
        let mut nominal = truth.clone();
        nominal.isolator.stiffness_n_m[2] = 5000.0;
        let motion = Motion::of(&record, 500.0, Tolerances::default()).expect("sound");
        let base = Searcher::new(&motion, &nominal, Effort::default()).base(&nominal).expect("follows");
        let slope = |trial: &Trial| trial.refit.interval("isolator.stiffness_n_m[2]").expect("moves");
        let (before, low, high) = slope(&base);
        assert!((before - 5000.0).abs() < 50.0, "no steady step tells it: {before} {low} {high}");
        let (after, low, high) = slope(&out_there(&record, &motion, &nominal, base));
        assert!((after - 6000.0).abs() < 500.0 && low < 6000.0 && 6000.0 < high, "{after} {low} {high}");
    }
}
