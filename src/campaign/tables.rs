//! The numbers behind a campaign's report: peaks of three sources, both normalisations, errors against the
//! published table, the trade-off. Figures, CSV tables and `--json` are all made of [`Study`].

use super::peaks::{self, CasePeaks, LogError, Peaks, Source};
use super::spec::{CaseKey, Configuration};
use super::store::CaseResult;
use serde::{Deserialize, Serialize};

/// Where peaks come from.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Origin {
    /// Measured in this campaign.
    Measured,
    /// The onboard model under the measured table acceleration.
    Model,
    /// The published table.
    Published,
}

impl Origin {
    /// All, in the order of reports.
    pub const ALL: [Self; 3] = [Self::Measured, Self::Published, Self::Model];

    /// Word of files and legends.
    pub fn name(self) -> &'static str {
        match self {
            Self::Measured => "measured",
            Self::Model => "model",
            Self::Published => "published",
        }
    }
}

/// The two problems of the paper: what is normalised by what.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Problem {
    /// Displacements: eta_0 = E/E_0, alpha_0 = A/A_0 by free flight at the same A_G.
    First,
    /// Accelerations: alpha_R = A/A_R, eta_R = E/E_R by the most rigid bumper at the same gap and A_G.
    Second,
}

impl Problem {
    /// Both.
    pub const ALL: [Self; 2] = [Self::First, Self::Second];

    /// `first` or `second`.
    pub fn name(self) -> &'static str {
        match self {
            Self::First => "first",
            Self::Second => "second",
        }
    }

    /// Symbols of excursion and acceleration ratio.
    pub fn symbols(self) -> (&'static str, &'static str) {
        match self {
            Self::First => ("eta_0", "alpha_0"),
            Self::Second => ("eta_R", "alpha_R"),
        }
    }
}

/// One case, normalised.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Ratio {
    /// Place of the case in the campaign.
    pub case: usize,
    /// E_max over that of the reference.
    pub eta: f64,
    /// A_max over that of the reference.
    pub alpha: f64,
}

/// A choice of bumper and gap on the trade-off at one acceleration.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Choice {
    /// `B1-G2`.
    pub device: String,
    /// Excursion ratio.
    pub eta: f64,
    /// Acceleration ratio.
    pub alpha: f64,
    /// No other device is better in one without being worse in the other.
    pub on_front: bool,
}

/// The robust choice of a problem: least worst sum of both ratios over all accelerations.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Robust {
    /// `B1-G2`.
    pub device: String,
    /// Its worst eta + alpha over the accelerations.
    pub worst_sum: f64,
}

/// All peaks of a campaign.
#[derive(Clone, Debug)]
pub struct Study {
    /// The campaign.
    pub configuration: Configuration,
    /// Measured peaks, a case each.
    pub measured: Vec<CasePeaks>,
    /// The onboard model's.
    pub model: Vec<CasePeaks>,
    /// The published ones.
    pub published: Vec<CasePeaks>,
}

impl Study {
    /// From the results of a campaign.
    pub fn new(configuration: Configuration, results: &[CaseResult]) -> Self {
        Self {
            measured: peaks::of_results(&configuration, results, Source::Measured),
            model: peaks::of_results(&configuration, results, Source::Model),
            published: peaks::published(&configuration),
            configuration,
        }
    }

    /// Peaks of one origin.
    pub fn of(&self, origin: Origin) -> &[CasePeaks] {
        match origin {
            Origin::Measured => &self.measured,
            Origin::Model => &self.model,
            Origin::Published => &self.published,
        }
    }

    /// The upward peaks of a case.
    pub fn forward(&self, origin: Origin, case: usize) -> Option<Peaks> {
        self.of(origin).get(case)?.forward
    }

    fn reference(&self, problem: Problem, case: &CaseKey) -> Option<usize> {
        let spec = &self.configuration.spec;
        let name = match problem {
            Problem::First => spec.free.as_ref()?,
            Problem::Second => spec.rigid.as_ref()?,
        };
        self.configuration.cases.iter().position(|other| {
            spec.bumper[other.bumper].name == *name
                && (other.acceleration_g - case.acceleration_g).abs() < 1e-9
                && (other.gap.is_none() || other.gap == case.gap)
        })
    }

    /// Normalised values of all cases that have a reference. In the second problem free flight has none.
    pub fn ratios(&self, origin: Origin, problem: Problem) -> Vec<Ratio> {
        let ratio = |(index, case): (usize, &CaseKey)| {
            let own = self.forward(origin, index)?;
            let reference = self.forward(origin, self.reference(problem, case)?)?;
            Some(Ratio {
                case: index,
                eta: own.excursion_m / reference.excursion_m,
                alpha: own.a_max_m_s2 / reference.a_max_m_s2,
            })
        };
        self.configuration.cases.iter().enumerate().filter_map(ratio).collect()
    }

    /// All accelerations, rising, g.
    pub fn levels_g(&self) -> Vec<f64> {
        let mut levels: Vec<f64> = self.configuration.cases.iter().map(|case| case.acceleration_g).collect();
        levels.sort_by(f64::total_cmp);
        levels.dedup_by(|a, b| (*a - *b).abs() < 1e-9);
        levels
    }

    /// The trade-off of a problem at one acceleration: every device but the reference, front marked.
    pub fn trade_off(&self, origin: Origin, problem: Problem, level_g: f64) -> Vec<Choice> {
        let cases = &self.configuration.cases;
        let free = |case: &CaseKey| case.gap.is_none();
        let here: Vec<Ratio> = self
            .ratios(origin, problem)
            .into_iter()
            .filter(|r| (cases[r.case].acceleration_g - level_g).abs() < 1e-9 && !free(&cases[r.case]))
            .collect();
        let beaten = |r: &Ratio| {
            here.iter().any(|o| o.eta <= r.eta && o.alpha <= r.alpha && (o.eta < r.eta || o.alpha < r.alpha))
        };
        here.iter()
            .map(|r| Choice {
                device: cases[r.case].device.clone(),
                eta: r.eta,
                alpha: r.alpha,
                on_front: !beaten(r),
            })
            .collect()
    }

    /// The device whose worst sum eta + alpha over all common accelerations is least, `without` left out.
    pub fn robust(&self, origin: Origin, problem: Problem, without: &[String]) -> Option<Robust> {
        let cases = &self.configuration.cases;
        let ratios = self.ratios(origin, problem);
        let mut devices: Vec<&str> = Vec::new();
        for case in cases.iter().filter(|case| case.gap.is_some()) {
            if !devices.contains(&case.device.as_str()) {
                devices.push(&case.device);
            }
        }
        let of = |device: &str| -> Vec<(f64, &str)> {
            let own = ratios.iter().filter(|r| cases[r.case].device == device);
            own.map(|r| (r.eta + r.alpha, cases[r.case].label.as_str())).collect()
        };
        let most = devices.iter().map(|device| of(device).len().min(3)).max()?;
        let sound = |values: &Vec<(f64, &str)>| {
            values.len() >= most && !values.iter().any(|(_, label)| without.iter().any(|w| w == label))
        };
        devices
            .iter()
            .filter_map(|device| {
                let values = of(device);
                let worst_sum = values.iter().map(|(sum, _)| *sum).fold(0.0, f64::max);
                sound(&values).then(|| Robust { device: (*device).to_owned(), worst_sum })
            })
            .min_by(|a, b| a.worst_sum.total_cmp(&b.worst_sum))
    }

    /// Logarithmic errors against a reference origin, by case.
    pub fn errors(&self, origin: Origin, against: Origin) -> Vec<(usize, LogError)> {
        (0..self.configuration.cases.len())
            .filter_map(|case| {
                let error = LogError::of(&self.forward(origin, case)?, &self.forward(against, case)?);
                Some((case, error))
            })
            .collect()
    }

    /// `peaks.csv`: every origin, case and direction.
    pub fn peaks_csv(&self) -> String {
        let mut out = String::from(
            "origin,case,bumper,gap,total_gap_m,table_acceleration_g,direction,nu_r,a_max_m_s2,excursion_m,\
             a_max_ci95_relative,excursion_ci95_relative,nu_r_ci95_relative,runs,contact,state\n",
        );
        for origin in Origin::ALL {
            for (case, peaks) in self.configuration.cases.iter().zip(self.of(origin)) {
                let ways = [("forward", peaks.forward), ("backward", peaks.backward)];
                for (way, values) in ways.into_iter().filter_map(|(way, values)| Some((way, values?))) {
                    let ci = peaks.confidence;
                    let ci = |pick: fn(&peaks::Confidence) -> f64| {
                        ci.map_or(String::new(), |c| pick(&c).to_string())
                    };
                    out += &format!(
                        "{},{},{way},{},{},{},{},{},{},{},{},{}\n",
                        origin.name(),
                        self.head(case),
                        values.nu_r,
                        values.a_max_m_s2,
                        values.excursion_m,
                        ci(|c| c.a_max),
                        ci(|c| c.excursion),
                        ci(|c| c.nu_r),
                        ci(|c| c.runs as f64),
                        peaks.contact.map_or(String::new(), |c| format!("{c:?}").to_lowercase()),
                        peaks.state.replace(',', ";")
                    );
                }
            }
        }
        out
    }

    fn head(&self, case: &CaseKey) -> String {
        let spec = &self.configuration.spec;
        format!(
            "{},{},{},{},{}",
            case.label,
            spec.bumper[case.bumper].name,
            case.gap.map_or("none", |gap| spec.gap[gap].name.as_str()),
            self.configuration.total_gap_m(case).map_or(String::new(), |gap| gap.to_string()),
            case.acceleration_g
        )
    }

    /// `normalised.csv`: both problems of every origin.
    pub fn normalised_csv(&self) -> String {
        let mut out = String::from(
            "origin,problem,case,bumper,gap,total_gap_m,table_acceleration_g,eta,alpha,on_front\n",
        );
        for origin in Origin::ALL {
            for problem in Problem::ALL {
                for ratio in self.ratios(origin, problem) {
                    let case = &self.configuration.cases[ratio.case];
                    let front = self.trade_off(origin, problem, case.acceleration_g);
                    let on_front = front.iter().any(|choice| choice.device == case.device && choice.on_front);
                    out += &format!(
                        "{},{},{},{},{},{on_front}\n",
                        origin.name(),
                        problem.name(),
                        self.head(case),
                        ratio.eta,
                        ratio.alpha
                    );
                }
            }
        }
        out
    }

    /// `errors.csv`: logarithmic errors against the published table.
    pub fn errors_csv(&self) -> String {
        let mut out = String::from("origin,case,ln_a_max,ln_excursion,ln_nu_r\n");
        for origin in [Origin::Measured, Origin::Model] {
            for (case, error) in self.errors(origin, Origin::Published) {
                let label = &self.configuration.cases[case].label;
                out += &format!(
                    "{},{label},{},{},{}\n",
                    origin.name(),
                    error.a_max,
                    error.excursion,
                    error.nu_r
                );
            }
        }
        out
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::campaign::testing::published as study;

    #[test]
    fn the_published_ratios_are_those_of_the_table() {
        let study = study();
        let ratio = |problem, label: &str| {
            let all = study.ratios(Origin::Published, problem);
            all.into_iter().find(|r| study.configuration.cases[r.case].label == label)
        };
        let first = ratio(Problem::First, "B1-G1-0.05").expect("there");
        assert!((first.eta - 0.0374 / 0.0673).abs() < 1e-12 && (first.alpha - 2.81 / 2.02).abs() < 1e-12);
        let second = ratio(Problem::Second, "B3-G3-0.05").expect("there");
        assert!((second.eta - 0.0279 / 0.0281).abs() < 1e-12 && (second.alpha - 2.19 / 9.29).abs() < 1e-12);
        assert_eq!(ratio(Problem::Second, "B0-0.05"), None, "free flight has no gap to compare at");
        assert_eq!(ratio(Problem::First, "B4-G3-0.07"), None, "no free flight at 0.07 g");
    }

    #[test]
    fn the_choices_of_the_paper_come_out_and_stand_on_the_odd_entries() {
        let study = study();
        let choice =
            |problem, without: &[String]| study.robust(Origin::Published, problem, without).map(|r| r.device);
        let odd = ["B3-G3-0.04".to_owned(), "B3-G3-0.05".to_owned()];
        assert_eq!(choice(Problem::Second, &[]).as_deref(), Some("B3-G3"));
        assert_ne!(choice(Problem::Second, &odd).as_deref(), Some("B3-G3"));
        // In the first problem at 0.05 g the same odd entry, (0.415, 1.08), beats B1-G1, (0.556, 1.39), in both
        // ratios; nothing else does.
        let front = study.trade_off(Origin::Published, Problem::First, 0.05);
        let of = |device: &str| front.iter().find(|c| c.device == device).expect("there");
        let own = of("B1-G1");
        let beats = |c: &&Choice| c.device != own.device && c.eta <= own.eta && c.alpha <= own.alpha;
        let better: Vec<&str> = front.iter().filter(beats).map(|c| c.device.as_str()).collect();
        assert_eq!(better, ["B3-G3"]);
        assert!(of("B3-G3").on_front && !own.on_front && !of("B1-G4").on_front);
        // At 0.03 g, where B3-G3 fits the trend, the choice of the paper is on the front as published.
        let front = study.trade_off(Origin::Published, Problem::First, 0.03);
        assert!(front.iter().any(|c| c.device == "B1-G1" && c.on_front));
    }
}
