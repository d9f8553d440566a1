//! Laws of force that the field knows and the catalogue lacks, in place of what was named along an imposed motion: two effects, or three,
//! stand in for one that there is no name for, and come near it. Where one law with fewer numbers does better than all of them, the verdict
//! is "outside the catalogue", and the law is its draft. Where a response is simulated, shapes of force do so.

use super::at_last::bound;
use super::candidates;
use super::missing_force::Draft;
use super::search::{Search, Searcher, Stage};
use super::thresholds::Thresholds;
use super::trial::Trial;
use super::verdict::{self, Decision, Refused, Verdict};
use crate::model::effects::expression;
use crate::model::{EffectSpec, Scales};
use crate::record::Kind;

/// A law with its own numbers.
struct Law {
    /// Force as an expression; `f_n` (N) is how strong it is, `dm_m`, `vm_m_s` and `vt_m_s` are chosen.
    expression: &'static str,
    /// Numbers that are fitted beside the strength.
    numbers: &'static [Own],
}

/// A number of a law.
struct Own {
    name: &'static str,
    /// What it is given over.
    over: fn(&Scales) -> f64,
    limits: [f64; 2],
    /// Where fits begin.
    starts: &'static [f64],
}

const ONE: fn(&Scales) -> f64 = |_| 1.0;
const VELOCITY: fn(&Scales) -> f64 = |scales| scales.velocity_m_s;
const LENGTH: fn(&Scales) -> f64 = |scales| scales.displacement_m;

/// Fluid dampers, whose force is a power of the velocity (M. C. Constantinou and M. D. Symans, Struct. Des. Tall Build. 2 (1993) 93);
/// sliding bearings, whose friction rises with it (M. Constantinou, A. Mokha, A. Reinhorn, J. Struct. Eng. 116 (1990) 455); friction that
/// grows with the displacement (T. J. Reid, J. R. Aeronaut. Soc. 60 (1956) 283), damping that does, and springs that stiffen faster than
/// their cube.
const LAWS: [Law; 5] = [
    Law {
        expression: "f_n*abs(v/vm_m_s)^p*signum(v)",
        numbers: &[Own { name: "p", over: ONE, limits: [0.05, 6.0], starts: &[0.35, 0.7, 3.0] }],
    },
    Law {
        expression: "f_n*(1-r*exp(0-abs(v)/vs_m_s))*tanh(v/vt_m_s)",
        numbers: &[
            Own { name: "r", over: ONE, limits: [0.02, 1.0], starts: &[0.5] },
            Own { name: "vs_m_s", over: VELOCITY, limits: [1e-3, 3.0], starts: &[0.05, 0.3] },
        ],
    },
    Law { expression: "f_n*abs(d/dm_m)*tanh(v/vt_m_s)", numbers: &[] },
    Law {
        expression: "f_n*abs(d/dm_m)^q*v/vm_m_s",
        numbers: &[Own { name: "q", over: ONE, limits: [0.3, 6.0], starts: &[1.5] }],
    },
    Law {
        expression: "f_n*sinh(d/dl_m)",
        numbers: &[Own { name: "dl_m", over: LENGTH, limits: [0.05, 3.0], starts: &[0.3] }],
    },
];

/// Velocity over which friction turns round, over the typical one: less than shows.
const TURNING: f64 = 1e-3;
/// Share of the base model's excess that a law leaves at most: one that leaves more is no draft of what is missing.
const MOST_LEFT: f64 = 0.5;
/// How strong a law is at first, over the typical force.
const STRENGTH: f64 = 0.3;

impl Searcher<'_> {
    /// What was decided, or that a law explains it rather; where a response is simulated, the shape that ended the search.
    pub(super) fn by_law(&self, search: &Search, decision: Decision, thresholds: Thresholds) -> Decision {
        let component = self.motion.kind == Kind::Component;
        let asks = match decision.verdict {
            Verdict::Adequate => false,
            Verdict::OutsideCatalogue => true,
            Verdict::Missing | Verdict::Ambiguous => component,
        };
        if !asks || component && self.is_enough(&decision.chosen, thresholds) {
            return decision;
        }
        let lawful = || if component { self.lawful(&search.base) } else { None };
        let Some(with) = search.law.clone().or_else(lawful) else { return decision };
        let (taken, ahead) = (&decision.chosen, verdict::apart(&with, &decision.chosen));
        let explains = with.share_left(&search.base) < MOST_LEFT;
        if !explains || verdict::gain(&with, taken) <= 0.0 || ahead < thresholds.of_shape_instead(taken) {
            return decision;
        }
        let mut refused = decision.refused;
        if !taken.names.is_empty() {
            let reason = format!("explains less than the drafted force does: {ahead:.1} nats apart");
            refused.push(Refused { name: taken.said(), reason });
        }
        Decision {
            verdict: Verdict::OutsideCatalogue,
            left: with.share_left(&search.base),
            chosen: with,
            ambiguous_with: Vec::new(),
            probabilities: Vec::new(),
            refused,
        }
    }

    /// Whether one effect leaves nothing but noise: a law with more numbers takes up what its motion does between samples.
    fn is_enough(&self, taken: &Trial, thresholds: Thresholds) -> bool {
        taken.names.len() == 1 && verdict::leaves_noise(self, taken, thresholds)
    }

    /// Whether a law leaves nothing of a component but noise, which neither the base model nor a first effect does, and does better than
    /// each of those.
    pub(super) fn is_lawful(&self, search: &mut Search, first: &Stage, thresholds: Thresholds) -> bool {
        if verdict::leaves_noise(self, &search.base, thresholds) {
            return false;
        }
        let best = first.finalists.iter().fold(&search.base, verdict::better);
        if self.is_enough(best, thresholds) {
            return false;
        }
        search.law = self.lawful(&search.base);
        search.law.as_ref().is_some_and(|with| {
            verdict::apart(with, best) > thresholds.of_shape_instead(best)
                && verdict::leaves_noise(self, with, thresholds)
        })
    }

    /// The base model with the law beside it that explains most.
    fn lawful(&self, base: &Trial) -> Option<Trial> {
        let scales = candidates::scales(&base.refit.spec, self.motion);
        let starts: Vec<Trial> = LAWS.iter().flat_map(|law| law.starts(base, &scales)).collect();
        self.likeliest_by_force(&starts)
    }
}

impl Law {
    /// Where fits of the base model with the law beside it begin.
    fn starts(&self, base: &Trial, scales: &Scales) -> Vec<Trial> {
        let (velocity_m_s, displacement_m) = (scales.velocity_m_s, scales.displacement_m);
        let chosen = [("dm_m", displacement_m), ("vm_m_s", velocity_m_s), ("vt_m_s", TURNING * velocity_m_s)];
        let mut starts = vec![EffectSpec {
            name: expression::EFFECT.name.into(),
            expression: Some(self.expression.into()),
            parameters: chosen
                .into_iter()
                .filter(|(name, _)| self.expression.contains(name))
                .chain([("f_n", STRENGTH * scales.force_n)])
                .map(|(name, value)| (name.to_owned(), value))
                .collect(),
        }];
        for own in self.numbers {
            let with = |start: &EffectSpec, value: &f64| {
                let mut start = start.clone();
                start.parameters.insert(own.name.to_owned(), value * (own.over)(scales));
                start
            };
            starts =
                starts.iter().flat_map(|start| own.starts.iter().map(|value| with(start, value))).collect();
        }
        starts.into_iter().map(|start| self.beside(base, &start, scales)).collect()
    }

    /// The base model with the law beside it, the law's numbers within their limits.
    fn beside(&self, base: &Trial, start: &EffectSpec, scales: &Scales) -> Trial {
        let fitted: Vec<&str> = self.numbers.iter().map(|own| own.name).chain(["f_n"]).collect();
        let mut with = base.with_expression(candidates::beside(&base.refit.spec, start), &fitted, scales);
        with.refit.numbers.let_dashpot_vanish();
        let index = with.refit.spec.effects.len() - 1;
        for Own { name, over, limits: [low, high], .. } in self.numbers {
            let limits = (low * over(scales), high * over(scales));
            bound(&mut with.refit, &format!("effect[{index}].{name}"), limits);
        }
        with
    }
}

/// The law that a trial has in it, as a draft; none where it has none.
pub fn draft(trial: &Trial, base: &Trial, searcher: &Searcher<'_>) -> Option<Draft> {
    let is_law = verdict::last_name(trial) == expression::EFFECT.name;
    let last = trial.refit.spec.effects.last().filter(|_| is_law)?;
    let left = match [trial, base].map(|trial| searcher.over_noise(trial)) {
        [Some(with), Some(of)] => (with / of).powi(2),
        _ => trial.force.mean() / base.force.mean().max(1e-300),
    };
    Some(Draft {
        expression: last.expression.clone()?,
        parameters: last.parameters.clone(),
        explains: 1.0 - left,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::diagnose::testing::{among, imposed};
    use crate::diagnose::{Diagnosis, diagnose};
    use crate::model::ModelSpec;
    use crate::model::testing::{b1_g2, effect};

    /// What is said of a component without bumpers that has such effects.
    fn said_of(effects: Vec<EffectSpec>) -> Diagnosis {
        let nominal = ModelSpec { bumper: None, ..b1_g2() };
        let mut truth = nominal.clone();
        truth.isolator.damping_n_s_m *= 0.9;
        truth.effects = effects;
        let options = among(&[
            "coulomb-friction",
            "stribeck-friction",
            "quadratic-damping",
            "cubic-stiffness",
            "maxwell-branch",
        ]);
        diagnose(&imposed(&truth, 61), &nominal, &options).expect("a sound record")
    }

    #[test]
    fn laws_that_the_catalogue_lacks_are_drafted_with_their_numbers() {
        let fluid = effect("expression", &[("c", 300.0), ("p", 0.4)]);
        let fluid = EffectSpec { expression: Some("c*abs(v/0.1)^p*signum(v)".into()), ..fluid };
        let pendulum = EffectSpec {
            expression: Some("300*(1-0.6*exp(0-abs(v)/0.03))*tanh(v/0.0001)".into()),
            ..effect("expression", &[])
        };
        for (of, numbers) in [(fluid, &[("p", 0.4)][..]), (pendulum, &[("r", 0.6), ("vs_m_s", 0.03)])] {
            let found = said_of(vec![of]);
            assert_eq!(found.verdict, Verdict::OutsideCatalogue);
            let draft = found.missing_force.and_then(|force| force.expression).expect("a draft");
            for (name, truth) in numbers {
                let told = draft.parameters[*name];
                assert!((told / truth - 1.0).abs() < 0.03, "{name}: {told} for {truth}");
            }
            assert!(
                found.error_after < 1.1 * found.noise_floor,
                "{} {}",
                found.error_after,
                found.noise_floor
            );
        }
    }

    #[test]
    fn two_effects_that_a_law_comes_near_stay_two() {
        let both = [
            effect("coulomb-friction", &[("fc_n", 100.0)]),
            effect("quadratic-damping", &[("c2_n_s2_m2", 8000.0)]),
        ];
        let found = said_of(both.to_vec());
        let mut names: Vec<&str> = found.effects.iter().map(|of| of.name.as_str()).collect();
        names.sort_unstable();
        assert_eq!((found.verdict, names), (Verdict::Missing, vec!["coulomb-friction", "quadratic-damping"]));
    }
}
