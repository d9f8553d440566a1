//! Peaks of a case: pseudo-resonance nu_R, A_max and E_max as in the paper's Table 2, by direction, with
//! their repeatability, and whether the mass reached the bumpers at all.
//!
//! The tables, figures and comparisons of a campaign are made of these.

use super::spec::{CaseKey, Configuration};
use super::store::{CaseOutcome, CaseResult};
use crate::control::{StepDirection, StepSummary};
use serde::Serialize;
use statrs::distribution::{ContinuousCDF, StudentsT};

/// Excursion over gap that counts as grazing: neither clear of the bumpers nor surely in contact.
const GRAZING: std::ops::Range<f64> = 0.97..1.06;

/// Peaks of one sweep direction.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Peaks {
    /// Frequency of the pseudo-resonance over f_R: that of the largest excursion (or A_max, as the campaign says).
    pub nu_r: f64,
    /// Largest A_max, m/s2.
    pub a_max_m_s2: f64,
    /// Largest excursion, m.
    pub excursion_m: f64,
}

/// How the excursion lies to the gap.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Contact {
    /// No bumpers.
    Free,
    /// The bumpers were not reached: the case repeats free flight.
    Clear,
    /// The bumpers were just touched; small changes decide.
    Grazing,
    /// The bumpers were hit.
    Full,
}

/// Half-widths of the 95 % interval of one run, relative.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Confidence {
    /// Of nu_R (half a step of the sweep at least).
    pub nu_r: f64,
    /// Of A_max.
    pub a_max: f64,
    /// Of the excursion.
    pub excursion: f64,
    /// Runs behind it.
    pub runs: usize,
    /// From runs of this very case; otherwise from cases that repeat each other.
    pub own: bool,
}

/// What is known of one case from one source.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct CasePeaks {
    /// `B1-G2-0.05`.
    pub case: String,
    /// Upward sweep: these are the values of the paper's Table 2.
    pub forward: Option<Peaks>,
    /// Downward sweep.
    pub backward: Option<Peaks>,
    /// 95 % interval.
    pub confidence: Option<Confidence>,
    /// Contact in the upward sweep.
    pub contact: Option<Contact>,
    /// `done`, or why there is less.
    pub state: String,
}

/// Which columns of a step are meant.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Source {
    /// What the sensors saw.
    Measured,
    /// The onboard model under the measured table acceleration.
    Model,
}

impl Source {
    /// A_max (m/s2) and excursion (m) of a step.
    pub fn of(self, step: &StepSummary) -> (f64, f64) {
        match self {
            Self::Measured => (step.a_max_m_s2, step.excursion_m),
            Self::Model => (step.model_a_max_m_s2, step.model_excursion_m),
        }
    }
}

/// What the pseudo-resonance is the largest of, and f_R.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Resonance {
    /// f_R, Hz.
    pub reference_hz: f64,
    /// Largest A_max instead of the largest excursion.
    pub by_acceleration: bool,
}

/// Peaks over frequencies (Hz) with (A_max, excursion); `None` of nothing.
pub fn peaks_of(
    curve: impl Iterator<Item = (f64, (f64, f64))> + Clone,
    resonance: Resonance,
) -> Option<Peaks> {
    let top = curve.clone().max_by(|a, b| a.1.0.total_cmp(&b.1.0))?;
    let wide = curve.max_by(|a, b| a.1.1.total_cmp(&b.1.1))?;
    Some(Peaks {
        nu_r: if resonance.by_acceleration { top.0 } else { wide.0 } / resonance.reference_hz,
        a_max_m_s2: top.1.0,
        excursion_m: wide.1.1,
    })
}

/// Peaks of the steps of one direction.
pub fn of_steps(
    steps: &[StepSummary],
    direction: StepDirection,
    source: Source,
    resonance: Resonance,
) -> Option<Peaks> {
    let there = steps.iter().filter(|step| step.direction == direction);
    peaks_of(there.map(|step| (step.frequency_hz, source.of(step))), resonance)
}

/// How an excursion lies to a gap, both m.
pub fn contact_of(excursion_m: f64, total_gap_m: Option<f64>) -> Contact {
    match total_gap_m {
        None => Contact::Free,
        Some(gap) if excursion_m < GRAZING.start * gap => Contact::Clear,
        Some(gap) if excursion_m < GRAZING.end * gap => Contact::Grazing,
        Some(_) => Contact::Full,
    }
}

/// Mean peaks of the runs of a case.
fn mean(all: &[Peaks]) -> Option<Peaks> {
    let n = all.len() as f64;
    let of = |pick: fn(&Peaks) -> f64| all.iter().map(pick).sum::<f64>() / n;
    (!all.is_empty()).then(|| Peaks {
        nu_r: of(|p| p.nu_r),
        a_max_m_s2: of(|p| p.a_max_m_s2),
        excursion_m: of(|p| p.excursion_m),
    })
}

/// Relative standard deviation within groups of values, and its degrees of freedom.
fn pooled(groups: &[Vec<f64>]) -> (f64, usize) {
    let mut sum = 0.0;
    let mut freedom = 0;
    for group in groups.iter().filter(|group| group.len() > 1) {
        let mean = group.iter().sum::<f64>() / group.len() as f64;
        sum += group.iter().map(|v| (v / mean - 1.0).powi(2)).sum::<f64>();
        freedom += group.len() - 1;
    }
    (if freedom > 0 { (sum / freedom as f64).sqrt() } else { 0.0 }, freedom)
}

/// 95 % half-width of the mean of so many runs from a pooled deviation.
fn half_width((deviation, freedom): (f64, usize), runs: usize) -> f64 {
    let t = StudentsT::new(0.0, 1.0, freedom as f64).map_or(f64::INFINITY, |t| t.inverse_cdf(0.975));
    t * deviation / (runs.max(1) as f64).sqrt()
}

/// Peaks of every case of a campaign from its results.
pub fn of_results(configuration: &Configuration, results: &[CaseResult], source: Source) -> Vec<CasePeaks> {
    let resonance = configuration.resonance();
    let step_hz = configuration.sweep.step_hz.unwrap_or(0.1);
    let mut all: Vec<CasePeaks> =
        configuration.cases.iter().map(|case| of_case(configuration, case, results, source)).collect();
    let twins = repeats_of_free_flight(configuration, &all);
    for (case, peaks) in configuration.cases.iter().zip(&mut all) {
        let runs: Vec<Peaks> = runs_of(case, results)
            .filter_map(|result| of_steps(&result.steps, StepDirection::Forward, source, resonance))
            .collect();
        let own = runs.len() > 1;
        let groups = |pick: fn(&Peaks) -> f64| -> Vec<Vec<f64>> {
            if own {
                vec![runs.iter().map(pick).collect()]
            } else {
                twins.iter().map(|g| g.iter().map(pick).collect()).collect()
            }
        };
        let (a, e) = (pooled(&groups(|p| p.a_max_m_s2)), pooled(&groups(|p| p.excursion_m)));
        let nu = pooled(&groups(|p| p.nu_r));
        if let Some(forward) = peaks.forward.filter(|_| a.1 > 0) {
            peaks.confidence = Some(Confidence {
                nu_r: half_width(nu, runs.len()).max(0.5 * step_hz / resonance.reference_hz / forward.nu_r),
                a_max: half_width(a, runs.len()),
                excursion: half_width(e, runs.len()),
                runs: if own { runs.len() } else { a.1 + 1 },
                own,
            });
        }
    }
    all
}

fn runs_of<'a>(case: &'a CaseKey, results: &'a [CaseResult]) -> impl Iterator<Item = &'a CaseResult> {
    results.iter().filter(move |result| result.case == case.label && result.outcome == CaseOutcome::Done)
}

fn of_case(
    configuration: &Configuration,
    case: &CaseKey,
    results: &[CaseResult],
    source: Source,
) -> CasePeaks {
    let resonance = configuration.resonance();
    let of = |direction: StepDirection| -> Vec<Peaks> {
        runs_of(case, results)
            .filter_map(|result| of_steps(&result.steps, direction, source, resonance))
            .collect()
    };
    let forward = mean(&of(StepDirection::Forward));
    let state = results.iter().filter(|result| result.case == case.label).map(CaseResult::state);
    let state = state.reduce(|all, one| if all == one { all } else { format!("{all}; {one}") });
    CasePeaks {
        case: case.label.clone(),
        forward,
        backward: mean(&of(StepDirection::Backward)),
        confidence: None,
        contact: forward.map(|peaks| contact_of(peaks.excursion_m, configuration.total_gap_m(case))),
        state: state.unwrap_or_else(|| "no result yet".to_owned()),
    }
}

/// Peaks of the cases that repeat free flight, by acceleration: none of them reached a bumper.
fn repeats_of_free_flight(configuration: &Configuration, all: &[CasePeaks]) -> Vec<Vec<Peaks>> {
    let mut groups: Vec<(f64, Vec<Peaks>)> = Vec::new();
    for (case, peaks) in configuration.cases.iter().zip(all) {
        let clear = matches!(peaks.contact, Some(Contact::Free | Contact::Clear));
        let Some(forward) = peaks.forward.filter(|_| clear) else { continue };
        match groups.iter_mut().find(|(level, _)| (level - case.acceleration_g).abs() < 1e-9) {
            Some((_, group)) => group.push(forward),
            None => groups.push((case.acceleration_g, vec![forward])),
        }
    }
    groups.into_iter().map(|(_, group)| group).filter(|group| group.len() > 1).collect()
}

/// Standard deviations of A_max and E_max among cases that repeat free flight, where there are any.
pub fn repeatability(configuration: &Configuration, all: &[CasePeaks]) -> Option<[f64; 2]> {
    let twins = repeats_of_free_flight(configuration, all);
    let of = |pick: fn(&Peaks) -> f64| {
        pooled(&twins.iter().map(|g| g.iter().map(pick).collect()).collect::<Vec<_>>())
    };
    let (a, e) = (of(|p| p.a_max_m_s2), of(|p| p.excursion_m));
    (a.1 > 0).then_some([a.0, e.0])
}

/// The published values as peaks; the table has one direction.
pub fn published(configuration: &Configuration) -> Vec<CasePeaks> {
    let of = |case: &CaseKey| {
        let row = configuration.published_of(case);
        let forward =
            row.map(|row| Peaks { nu_r: row.nu_r, a_max_m_s2: row.a_max_m_s2, excursion_m: row.excursion_m });
        CasePeaks {
            case: case.label.clone(),
            forward,
            backward: None,
            confidence: None,
            contact: forward.map(|peaks| contact_of(peaks.excursion_m, configuration.total_gap_m(case))),
            state: if row.is_some() { "published" } else { "not published" }.to_owned(),
        }
    };
    let mut all: Vec<CasePeaks> = configuration.cases.iter().map(of).collect();
    // Three cases stay clear of the bumpers at 0.03 g and repeat B0: the only repeatability in the table.
    let twins = repeats_of_free_flight(configuration, &all);
    let values = |pick: fn(&Peaks) -> f64| -> Vec<Vec<f64>> {
        twins.iter().map(|g| g.iter().map(pick).collect()).collect()
    };
    let (a, e) = (pooled(&values(|p| p.a_max_m_s2)), pooled(&values(|p| p.excursion_m)));
    if a.1 > 0 {
        for peaks in &mut all {
            let Some(forward) = peaks.forward else { continue };
            peaks.confidence = Some(Confidence {
                // Printed on a grid of 0.05 (README of the table).
                nu_r: 0.05 / forward.nu_r,
                a_max: half_width(a, 1),
                excursion: half_width(e, 1),
                runs: a.1 + 1,
                own: false,
            });
        }
    }
    all
}

/// Logarithmic errors of one set of peaks against another.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct LogError {
    /// ln(A_max / reference).
    pub a_max: f64,
    /// ln(E_max / reference).
    pub excursion: f64,
    /// ln(nu_R / reference).
    pub nu_r: f64,
}

impl LogError {
    /// Of peaks against a reference.
    pub fn of(peaks: &Peaks, reference: &Peaks) -> Self {
        Self {
            a_max: (peaks.a_max_m_s2 / reference.a_max_m_s2).ln(),
            excursion: (peaks.excursion_m / reference.excursion_m).ln(),
            nu_r: (peaks.nu_r / reference.nu_r).ln(),
        }
    }

    /// The three numbers.
    pub fn values(&self) -> [f64; 3] {
        [self.a_max, self.excursion, self.nu_r]
    }
}

/// Root-mean-square of all logarithmic errors.
pub fn rms(errors: &[LogError]) -> f64 {
    let squares: f64 = errors.iter().flat_map(LogError::values).map(|e| e * e).sum();
    (squares / (3.0 * errors.len().max(1) as f64)).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn step(direction: StepDirection, frequency_hz: f64, a: f64, e: f64) -> StepSummary {
        StepSummary { direction, frequency_hz, a_max_m_s2: a, excursion_m: e, ..StepSummary::default() }
    }

    #[test]
    fn peaks_are_taken_by_direction() {
        use StepDirection::{Backward, Forward};
        let steps = [
            step(Forward, 1.0, 1.0, 0.03),
            step(Forward, 1.5, 3.0, 0.02),
            step(Backward, 1.5, 0.5, 0.01),
            step(Backward, 1.0, 2.0, 0.04),
        ];
        let half = Resonance { reference_hz: 0.5, by_acceleration: false };
        let up = of_steps(&steps, Forward, Source::Measured, half).expect("peaks");
        assert_eq!((up.nu_r, up.a_max_m_s2, up.excursion_m), (2.0, 3.0, 0.03));
        let down = of_steps(&steps, Backward, Source::Measured, half).expect("peaks");
        assert_eq!((down.nu_r, down.a_max_m_s2, down.excursion_m), (2.0, 2.0, 0.04));
        let by_acceleration = Resonance { by_acceleration: true, ..half };
        let up = of_steps(&steps, Forward, Source::Measured, by_acceleration).expect("peaks");
        assert_eq!(up.nu_r, 3.0);
        assert_eq!(of_steps(&steps[..2], Backward, Source::Measured, half), None);
    }

    #[test]
    fn the_published_table_knows_its_own_scatter_and_its_grazing_cases() {
        let spec: crate::campaign::CampaignSpec =
            crate::config::parse_toml("c", include_str!("../../config/campaigns/andreaus-2020.toml"))
                .expect("valid");
        let configuration = Configuration::load(spec).expect("loads");
        let all = published(&configuration);
        let of = |label: &str| all.iter().find(|peaks| peaks.case == label).expect("a case");
        assert_eq!(of("B0-0.05").contact, Some(Contact::Free));
        assert_eq!(of("B3-G4-0.03").contact, Some(Contact::Clear));
        assert_eq!(of("B2-G4-0.03").contact, Some(Contact::Grazing));
        assert_eq!(of("B2-G1-0.05").contact, Some(Contact::Full));
        // Standard deviations of 8 % and 4 % (README of the table, which also counts B4-G2).
        let [a, e] = repeatability(&configuration, &all).expect("three cases repeat B0");
        assert!((a - 0.08).abs() < 0.01 && (e - 0.04).abs() < 0.005, "{a} {e}");
        let confidence = of("B1-G1-0.03").confidence.expect("three cases repeat B0");
        assert!((0.15..0.35).contains(&confidence.a_max), "{confidence:?}");
        assert!((0.05..0.6).contains(&confidence.excursion), "{confidence:?}");
    }

    #[test]
    fn the_interval_of_repeated_runs_is_students() {
        // 10 runs of 1 +- 0.1: t(9) = 2.262.
        let values: Vec<f64> = (0..10).map(|i| if i % 2 == 0 { 0.9 } else { 1.1 }).collect();
        let (deviation, freedom) = pooled(&[values]);
        assert!((deviation - 0.1 * (10.0_f64 / 9.0).sqrt()).abs() < 1e-12 && freedom == 9);
        assert!((half_width((deviation, freedom), 10) - 2.2622 * deviation / 10f64.sqrt()).abs() < 1e-4);
    }
}
