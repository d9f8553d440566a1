//! What a model predicts for bumpers and gaps between and beyond those tried: a design map for each problem,
//! the best design, and how sure that is.
//!
//! `campaign optimise` calls it. The model is identified on the peaks of the campaign first; its covariance is
//! what the interval of a prediction comes from. A design is judged as the tried devices are
//! ([`super::tables::Study::robust`]): by its worst sum of both ratios over all table accelerations.

use super::fit::{Cell, Effort, Fitted, Freedom, Problem as Fit};
use super::ideal::{self, Settings};
use super::peaks::Peaks;
use super::spec::{CaseKey, Configuration};
use super::tables::Problem;
use crate::model::{BumperSpec, ModelSpec};
use crate::parallel;
use crate::sweep::{Direction, Step};
use nalgebra::DVector;
use rand::SeedableRng;
use rand_distr::{Distribution, StandardNormal};
use serde::{Deserialize, Serialize};

/// Which designs are looked at.
#[derive(Clone, Debug, Deserialize, PartialEq, Serialize)]
pub struct Space {
    /// Stiffnesses of the bumper, N/m, rising.
    pub stiffness_n_m: Vec<f64>,
    /// Total gaps, m, rising.
    pub total_gap_m: Vec<f64>,
    /// Models drawn from the fit's covariance.
    pub draws: usize,
    /// Threads.
    #[serde(skip)]
    pub jobs: usize,
}

impl Default for Space {
    fn default() -> Self {
        Self {
            stiffness_n_m: geometric(10e3, 6e6, 11),
            total_gap_m: linear(0.005, 0.045, 9),
            draws: 60,
            jobs: parallel::cores(),
        }
    }
}

/// Bumper and gap with what is predicted.
#[derive(Clone, Debug, Deserialize, PartialEq, Serialize)]
pub struct Design {
    /// Name of a tried device, `B1-G2`; `null` for a design of the map.
    pub device: Option<String>,
    /// Stiffness of the bumper, N/m.
    pub stiffness_n_m: f64,
    /// Its damping, N s/m: for designs of the map from the power law through the bumpers of the campaign.
    pub damping_n_s_m: f64,
    /// Total gap, m.
    pub total_gap_m: f64,
    /// Stiffness or gap lies outside those tried.
    pub beyond: bool,
    /// Excursion and acceleration ratio at every table acceleration.
    pub ratios: Vec<[f64; 2]>,
    /// Largest sum of both.
    pub worst_sum: f64,
    /// 95 % interval of that sum over models that the peaks allow; only where it was drawn.
    pub worst_sum_95: Option<[f64; 2]>,
    /// Share of those models in which this design is better than the best tried device.
    pub better_than_tried: Option<f64>,
}

/// The map of one problem.
#[derive(Clone, Debug, Deserialize, Serialize)]
pub struct Map {
    /// Which problem.
    pub problem: Problem,
    /// Table accelerations, g.
    pub levels_g: Vec<f64>,
    /// Every design, stiffness by stiffness within each gap.
    pub designs: Vec<Design>,
    /// The same for the devices of the campaign.
    pub tried: Vec<Design>,
    /// The best tried device as the model has it.
    pub best_tried: Design,
    /// The best design of the map.
    pub best: Design,
    /// Whether the best design lies on the border of what was looked at.
    pub at_border: bool,
}

/// The whole answer.
#[derive(Clone, Debug, Deserialize, Serialize)]
pub struct Optimum {
    /// RMS of the logarithmic errors of the model that was identified.
    pub rms: f64,
    /// Damping of a bumper, N s/m, is `factor * stiffness^exponent` (stiffness in N/m).
    pub damping_law: [f64; 2],
    /// Models that were drawn and could be solved.
    pub draws: usize,
    /// A map a problem that has a reference.
    pub maps: Vec<Map>,
}

/// Everything that predictions share.
struct Bench<'a> {
    configuration: &'a Configuration,
    fit: Fit<'a>,
    levels_g: Vec<f64>,
    steps: Vec<Vec<Step>>,
}

/// One model and what its predictions are divided by.
struct Judge<'b, 'a> {
    bench: &'b Bench<'a>,
    x: Vec<f64>,
    problem: Problem,
}

/// Identifies the model on the cells, with effects added by name, and maps what it predicts. `None` when the
/// model cannot be simulated or the campaign names no reference.
pub fn optimise(
    configuration: &Configuration,
    cells: &[Cell],
    effects: Vec<&'static str>,
    space: &Space,
    tell: &dyn Fn(&str),
) -> Option<Optimum> {
    tell("identifying the model");
    let fit = Fit::new(configuration, cells, Freedom { effects, ..Freedom::default() });
    let some: Vec<&Cell> = cells.iter().collect();
    let fitted = fit.fit(&some, Effort::HELD_OUT)?;
    let mut levels_g: Vec<f64> = configuration.cases.iter().map(|case| case.acceleration_g).collect();
    levels_g.sort_by(f64::total_cmp);
    levels_g.dedup_by(|a, b| (*a - *b).abs() < 1e-9);
    // Only those that free flight and rigid bumper were run at: ratios need both.
    levels_g.retain(|level| {
        let at = |name: &Option<String>| {
            name.as_ref().is_none_or(|name| {
                configuration.cases.iter().any(|case| {
                    configuration.spec.bumper[case.bumper].name == *name
                        && (case.acceleration_g - level).abs() < 1e-9
                })
            })
        };
        at(&configuration.spec.free) && at(&configuration.spec.rigid)
    });
    let steps = levels_g
        .iter()
        .map(|level| {
            let all = ideal::steps_of(&configuration.sweep, *level, (0.0, f64::INFINITY));
            all.into_iter().filter(|step| step.direction == Direction::Forward).collect()
        })
        .collect();
    let bench = Bench { configuration, fit, levels_g, steps };
    let draws = draws(&fitted, space.draws);
    let mut maps = Vec::new();
    for problem in Problem::ALL {
        tell(&format!("map of the {} problem", problem.name()));
        maps.extend(bench.map(problem, &fitted, &draws, space));
    }
    let law = bench.damping_law(&fitted.x)?;
    (!maps.is_empty()).then_some(Optimum {
        rms: bench.fit.rms(&fitted.x, &some)?,
        damping_law: [law.0, law.1],
        draws: draws.len(),
        maps,
    })
}

/// Values of the fit drawn from its covariance, always the same ones.
fn draws(fitted: &Fitted, count: usize) -> Vec<Vec<f64>> {
    let Some(root) = fitted.covariance.clone().cholesky() else { return Vec::new() };
    let mut random = rand_pcg::Pcg64::seed_from_u64(2_517);
    let best = DVector::from_column_slice(&fitted.x);
    (0..count)
        .map(|_| {
            let z = DVector::from_fn(best.len(), |_, _| StandardNormal.sample(&mut random));
            (&best + root.l() * z).iter().copied().collect()
        })
        .collect()
}

impl Bench<'_> {
    /// A case whose bumper is the named one; of free flight the first.
    fn case_of(&self, bumper: usize) -> Option<&CaseKey> {
        self.configuration.cases.iter().find(|case| case.bumper == bumper)
    }

    /// Mass, isolator and effects with another bumper.
    fn model(&self, x: &[f64], bumper: Option<BumperSpec>) -> Option<ModelSpec> {
        let mut model = self.fit.model(x, self.configuration.cases.iter().find(|case| case.gap.is_some())?);
        match bumper {
            Some(bumper) => model.bumper = Some(bumper),
            None => super::spec::mount(&mut model, None),
        }
        Some(model)
    }

    /// Bumpers as the fit has them, by their place in the campaign.
    fn bumpers(&self, x: &[f64]) -> Vec<(usize, BumperSpec)> {
        let places = 0..self.configuration.spec.bumper.len();
        places.filter_map(|i| Some((i, self.fit.model(x, self.case_of(i)?).bumper?))).collect()
    }

    /// Factor and exponent of damping against stiffness: the line through the logarithms of all bumpers.
    fn damping_law(&self, x: &[f64]) -> Option<(f64, f64)> {
        let points: Vec<(f64, f64)> = self
            .bumpers(x)
            .iter()
            .filter(|(_, b)| b.stiffness_n_m > 0.0 && b.damping_n_s_m > 0.0)
            .map(|(_, b)| (b.stiffness_n_m.ln(), b.damping_n_s_m.ln()))
            .collect();
        line(&points).map(|(offset, slope)| (offset.exp(), slope))
    }

    fn map(&self, problem: Problem, fitted: &Fitted, draws: &[Vec<f64>], space: &Space) -> Option<Map> {
        let judge = Judge { bench: self, x: fitted.x.clone(), problem };
        let law = self.damping_law(&fitted.x)?;
        let tried = parallel::map(&self.devices(&fitted.x), space.jobs, |design| judge.judged(design));
        let tried: Vec<Design> = tried.into_iter().flatten().collect();
        let grid = self.grid(space, law, &tried);
        let designs = parallel::map(&grid, space.jobs, |design| judge.judged(design));
        let designs: Vec<Design> = designs.into_iter().collect::<Option<_>>()?;
        let least = |list: &[Design]| list.iter().min_by(|a, b| a.worst_sum.total_cmp(&b.worst_sum)).cloned();
        // The rigid device is its own reference in the second problem: not a choice.
        let choices: Vec<Design> = tried.iter().filter(|d| !judge.is_reference(d)).cloned().collect();
        let (mut best, mut best_tried) = (least(&designs)?, least(&choices)?);
        let sums = parallel::map(draws, space.jobs, |x| {
            let judge = Judge { bench: self, x: x.clone(), problem };
            let law = self.damping_law(x)?;
            let device = self.devices(x).into_iter().find(|d| d.device == best_tried.device)?;
            let design = Design { damping_n_s_m: damping(law, best.stiffness_n_m), ..best.clone() };
            Some((judge.judged(&design)?.worst_sum, judge.judged(&device)?.worst_sum))
        });
        let sums: Vec<(f64, f64)> = sums.into_iter().flatten().collect();
        best.worst_sum_95 = interval(sums.iter().map(|pair| pair.0).collect());
        best_tried.worst_sum_95 = interval(sums.iter().map(|pair| pair.1).collect());
        let wins = sums.iter().filter(|(own, other)| own < other).count();
        best.better_than_tried = (!sums.is_empty()).then(|| wins as f64 / sums.len() as f64);
        let ends = |list: &[f64], value: f64| list.first() == Some(&value) || list.last() == Some(&value);
        let at_border =
            ends(&space.stiffness_n_m, best.stiffness_n_m) || ends(&space.total_gap_m, best.total_gap_m);
        Some(Map { problem, levels_g: self.levels_g.clone(), designs, tried, best_tried, best, at_border })
    }

    /// The devices of the campaign, not judged yet.
    fn devices(&self, x: &[f64]) -> Vec<Design> {
        let mut devices: Vec<Design> = Vec::new();
        let bumpers = self.bumpers(x);
        for case in &self.configuration.cases {
            let known = devices.iter().any(|d| d.device.as_deref() == Some(case.device.as_str()));
            let bumper = bumpers.iter().find(|(place, _)| *place == case.bumper);
            let (Some((_, bumper)), Some(total_gap_m), false) =
                (bumper, self.configuration.total_gap_m(case), known)
            else {
                continue;
            };
            let bumper = BumperSpec { total_gap_m, ..*bumper };
            devices.push(Design::new(Some(case.device.clone()), &bumper, false));
        }
        devices
    }

    /// The designs of the map, not judged yet.
    fn grid(&self, space: &Space, law: (f64, f64), tried: &[Design]) -> Vec<Design> {
        let range = |of: fn(&Design) -> f64| {
            let values = tried.iter().map(of);
            values.fold((f64::INFINITY, 0.0_f64), |(low, high), v| (low.min(v), high.max(v)))
        };
        let (stiff, gaps) = (range(|d| d.stiffness_n_m), range(|d| d.total_gap_m));
        // A hair beyond, so that rounding does not make a tried value an untried one.
        let outside = |v: f64, (low, high): (f64, f64)| v < low * (1.0 - 1e-6) || v > high * (1.0 + 1e-6);
        let mut designs = Vec::new();
        for &total_gap_m in &space.total_gap_m {
            for &stiffness_n_m in &space.stiffness_n_m {
                let damping_n_s_m = damping(law, stiffness_n_m);
                let beyond = outside(stiffness_n_m, stiff) || outside(total_gap_m, gaps);
                let bumper = BumperSpec { stiffness_n_m, damping_n_s_m, total_gap_m };
                designs.push(Design::new(None, &bumper, beyond));
            }
        }
        designs
    }

    fn peaks(&self, model: &ModelSpec, level: usize) -> Option<Peaks> {
        let states = ideal::steady_states(model, self.steps.get(level)?, &Settings::default()).ok()?;
        ideal::peaks(&states, Direction::Forward, self.configuration.resonance())
    }
}

impl Judge<'_, '_> {
    fn reference_place(&self) -> Option<usize> {
        let spec = &self.bench.configuration.spec;
        let name = match self.problem {
            Problem::First => spec.free.as_ref()?,
            Problem::Second => spec.rigid.as_ref()?,
        };
        spec.bumper.iter().position(|bumper| bumper.name == *name)
    }

    fn is_reference(&self, design: &Design) -> bool {
        let spec = &self.bench.configuration.spec;
        let name = self.reference_place().map(|place| spec.bumper[place].name.as_str());
        let bumper = design.device.as_deref().and_then(|device| device.split('-').next());
        bumper.is_some() && bumper == name
    }

    /// A design with its ratios.
    fn judged(&self, design: &Design) -> Option<Design> {
        let bench = self.bench;
        let place = self.reference_place()?;
        let rigid = bench.bumpers(&self.x).into_iter().find(|(i, _)| *i == place).map(|(_, b)| b);
        let reference = rigid.map(|b| BumperSpec { total_gap_m: design.total_gap_m, ..b });
        let (own, reference) =
            (bench.model(&self.x, Some(design.bumper()))?, bench.model(&self.x, reference)?);
        let mut ratios = Vec::new();
        for level in 0..bench.levels_g.len() {
            let (own, reference) = (bench.peaks(&own, level)?, bench.peaks(&reference, level)?);
            ratios.push([own.excursion_m / reference.excursion_m, own.a_max_m_s2 / reference.a_max_m_s2]);
        }
        let worst_sum = ratios.iter().map(|[eta, alpha]| eta + alpha).fold(0.0, f64::max);
        worst_sum.is_finite().then(|| Design { ratios, worst_sum, ..design.clone() })
    }
}

impl Design {
    fn new(device: Option<String>, bumper: &BumperSpec, beyond: bool) -> Self {
        Self {
            device,
            stiffness_n_m: bumper.stiffness_n_m,
            damping_n_s_m: bumper.damping_n_s_m,
            total_gap_m: bumper.total_gap_m,
            beyond,
            ratios: Vec::new(),
            worst_sum: f64::INFINITY,
            worst_sum_95: None,
            better_than_tried: None,
        }
    }

    fn bumper(&self) -> BumperSpec {
        BumperSpec {
            stiffness_n_m: self.stiffness_n_m,
            damping_n_s_m: self.damping_n_s_m,
            total_gap_m: self.total_gap_m,
        }
    }
}

fn damping((factor, exponent): (f64, f64), stiffness_n_m: f64) -> f64 {
    factor * stiffness_n_m.powf(exponent)
}

/// Offset and slope of the line of least squares; of one point, a level line.
fn line(points: &[(f64, f64)]) -> Option<(f64, f64)> {
    let n = points.len() as f64;
    let (x, y) = points.iter().fold((0.0, 0.0), |(sx, sy), (x, y)| (sx + x / n, sy + y / n));
    let (xy, xx) =
        points.iter().fold((0.0, 0.0), |(a, b), p| (a + (p.0 - x) * (p.1 - y), b + (p.0 - x).powi(2)));
    let slope = if xx > 0.0 { xy / xx } else { 0.0 };
    (!points.is_empty()).then_some((y - slope * x, slope))
}

/// 2.5 % and 97.5 % of a sample of twenty at least.
fn interval(mut values: Vec<f64>) -> Option<[f64; 2]> {
    values.sort_by(f64::total_cmp);
    let at = |share: f64| values.get((share * (values.len().saturating_sub(1)) as f64).round() as usize);
    (values.len() >= 20).then_some(())?;
    Some([*at(0.025)?, *at(0.975)?])
}

/// So many values from one to another, in equal ratios.
pub fn geometric(low: f64, high: f64, count: usize) -> Vec<f64> {
    let last = count.saturating_sub(1).max(1) as f64;
    (0..count).map(|i| low * (high / low).powf(i as f64 / last)).collect()
}

/// So many values from one to another, in equal steps.
pub fn linear(low: f64, high: f64, count: usize) -> Vec<f64> {
    let last = count.saturating_sub(1).max(1) as f64;
    (0..count).map(|i| low + (high - low) * i as f64 / last).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::campaign::fit;
    use crate::campaign::tables::Origin;
    use crate::campaign::testing::published as study;

    #[test]
    fn a_tried_device_on_the_map_has_the_ratios_of_its_own_peaks() {
        let study = study();
        let configuration = &study.configuration;
        let all = fit::cells(configuration, study.of(Origin::Published));
        let fixed = Freedom { fixed: true, ..Freedom::default() };
        let problem = Fit::new(configuration, &all, fixed);
        let steps = |level: f64| ideal::steps_of(&configuration.sweep, level, (0.0, f64::INFINITY));
        let forward =
            |level| steps(level).into_iter().filter(|s| s.direction == Direction::Forward).collect();
        let bench = Bench { configuration, fit: problem, levels_g: vec![0.05], steps: vec![forward(0.05)] };
        let judge = Judge { bench: &bench, x: Vec::new(), problem: Problem::First };
        let device = bench.devices(&[]).into_iter().find(|d| d.device.as_deref() == Some("B1-G2"));
        let judged = judge.judged(&device.expect("there")).expect("solved");
        let predicted = |label: &str| {
            let cell = all.iter().find(|cell| cell.case.label == label).expect("there");
            bench.fit.predict(&[], cell).expect("solved")
        };
        let (own, free) = (predicted("B1-G2-0.05"), predicted("B0-0.05"));
        let expected = [own.excursion_m / free.excursion_m, own.a_max_m_s2 / free.a_max_m_s2];
        assert_eq!(judged.ratios, [expected]);
        assert_eq!(judged.worst_sum, expected[0] + expected[1]);
        // A bumper of hardly any stiffness is free flight.
        let bumper = BumperSpec { stiffness_n_m: 1e-3, damping_n_s_m: 1e-6, total_gap_m: 0.02 };
        let none = judge.judged(&Design::new(None, &bumper, true)).expect("solved");
        assert!(none.ratios[0].iter().all(|ratio| (ratio - 1.0).abs() < 1e-3), "{none:?}");
    }

    #[test]
    fn the_damping_law_goes_through_the_bumpers() {
        let (offset, slope) = line(&[(1.0, 2.0), (3.0, 3.0), (5.0, 4.0)]).expect("points");
        assert!((offset - 1.5).abs() < 1e-12 && (slope - 0.5).abs() < 1e-12);
        assert_eq!(line(&[(2.0, 7.0)]), Some((7.0, 0.0)));
        assert_eq!(line(&[]), None);
        assert_eq!(interval(vec![1.0; 19]), None);
        assert_eq!(interval((0..=40).map(f64::from).collect()), Some([1.0, 39.0]));
    }
}
