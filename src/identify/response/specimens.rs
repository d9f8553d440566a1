//! A model's simulated step, from the measured state and driven as the record was. Called for every step that is laid against a model,
//! and for every slope.

use super::jumps::Sampled;
use super::memory::{Walk, Walked};
use super::{Measured, STARTING, Simulated};
use crate::identify::motion::Window;
use crate::identify::together::Source;
use crate::model::{self, EffectSpec, ModelSpec, Specimen, effects};

/// Cycles before a step in which the tips of the bumpers have come to where they are; the same where those of either side are not back
/// before they touch again.
const RETURNING: f64 = 0.5;
const CREEPING: f64 = 1.5;

/// The model as it stood at each record.
pub(super) struct Specimens {
    pub(super) each: Vec<Box<dyn Specimen>>,
    /// An effect has states of its own.
    pub(super) hidden: bool,
    /// Tips of the bumpers come back by a power law, as long as there is no contact.
    creeps: bool,
    /// One of them keeps what larger motions left it with as long as those after are small.
    lasting: bool,
    /// What has states, where one lasts.
    of_states: Vec<EffectSpec>,
    /// What lasts of each record, where that has been asked for.
    walked: Vec<Option<Walked>>,
    /// An effect forgets by a power law: slower than in the cycles before a step.
    pub(super) remembers: bool,
    /// The table moves otherwise than it is driven.
    pub(super) kicks: bool,
    /// What drives it over what drives the mass that the motion was made with.
    pub(super) share: f64,
}

impl Measured<'_> {
    /// Simulates a step from the measured state, moved by so much, jumps spread.
    pub(super) fn simulate(
        &self,
        specimens: &mut Specimens,
        window: &Window,
        common: &[f64],
        start: &[f64],
    ) -> Simulated {
        let mut sampled = self.sampled(specimens, window, common, start);
        if !self.coarse {
            sampled.spread(specimens, self.motion.sample_rate_hz);
        }
        // A is what is seen less what would have driven the mass that the motion was made with.
        if specimens.share != 1.0 {
            let more = 1.0 - specimens.share;
            for (of, n) in sampled.simulated.iter_mut().zip(window.range.clone()) {
                of.0 += more * self.motion.seen_to_drive_m_s2(n);
            }
        }
        sampled.simulated
    }

    /// The same with its jumps as they are; hidden states are warmed up along the measured motion.
    pub(super) fn sampled(
        &self,
        specimens: &mut Specimens,
        window: &Window,
        common: &[f64],
        start: &[f64],
    ) -> Sampled {
        let motion = self.motion;
        let (zero_m, table_zero_m_s2) = (common[0], if window.random { common[5] } else { 0.0 });
        let source = &motion.sources[window.source];
        let last = window.range.start.max(1) - 1;
        let first = self.warmed_from(specimens, window);
        let states = self.walked(specimens, window, zero_m);
        let (specimen, share) = (&mut *specimens.each[window.source], specimens.share);
        specimen.reset();
        specimen.set_time_s(source.time_s(first, motion.dt_s()));
        // A record begins at rest; what was recalled goes on from the sample before, not from there.
        let before = (first > source.first)
            .then(|| (motion.displacement_m[first - 1] + zero_m, motion.velocity_m_s[first - 1]));
        if let Some(before) = before.filter(|_| specimens.remembers) {
            specimen.recall(self.remembered(window), before);
        }
        motion.retrace(specimen, window, first, zero_m);
        if let Some((states, before)) = states.zip(before) {
            specimen.resume(&states, before);
        }
        for n in first..last {
            specimen.impose(motion.displacement_m[n] + zero_m, motion.velocity_m_s[n]);
        }
        specimen
            .impose(motion.displacement_m[last] + zero_m + start[0], motion.velocity_m_s[last] + start[1]);
        // What drives the step, its amplitude and time as they are estimated.
        let end = motion.drive_m_s2.len() - 1;
        let offsets = &start[STARTING..self.followed(window)];
        let length = window.range.len() as f64;
        let drive = |n: usize| {
            let at = n.saturating_sub(window.range.start) * offsets.len() / window.range.len();
            let slope = 0.5
                * (motion.drive_m_s2[(n + 1).min(end)] - motion.drive_m_s2[n.max(1) - 1])
                * motion.sample_rate_hz;
            let late_s = start[3] + start[4] * (2.0 * (n as f64 - window.range.start as f64) / length - 1.0);
            let offset = table_zero_m_s2 + offsets.get(at).unwrap_or(&0.0);
            share * (motion.drive_m_s2[n] * (1.0 + start[2]) + slope * late_s + offset)
        };
        specimen.prime(drive(last));
        let table: Vec<f64> = window.range.clone().map(drive).collect();
        let mut simulated = Simulated::with_capacity(table.len());
        let mut velocity_m_s = Vec::with_capacity(table.len());
        let mut visit = |response: &model::Response| {
            simulated.push((response.mass_acceleration_m_s2, response.relative_displacement_m));
            velocity_m_s.push(response.relative_velocity_m_s);
        };
        if window.random {
            // A blow, or noise, is no smooth course: every solver joins its samples by lines, for which the drive makes up.
            table.iter().for_each(|table| visit(&specimen.step(*table)));
        } else {
            specimen.run(&table, &mut visit);
        }
        Sampled { simulated, velocity_m_s, table_m_s2: table }
    }

    /// First sample from which on a model is warmed up for a window.
    fn warmed_from(&self, specimens: &Specimens, window: &Window) -> usize {
        let last = window.range.start.max(1) - 1;
        let first = window.warm_from.min(last);
        if specimens.hidden && !(specimens.lasting && window.random) {
            return first;
        }
        // Nothing but the tips of the bumpers to bring to where they are.
        let cycles = if specimens.creeps { CREEPING } else { RETURNING };
        let samples = cycles * self.motion.sample_rate_hz / window.frequency_hz.max(1e-9);
        first.max(last.saturating_sub(samples as usize))
    }

    /// States of what lasts where a window of a record without steps begins to be warmed up: a model goes through the record once for all windows.
    fn walked(&self, specimens: &mut Specimens, window: &Window, zero_m: f64) -> Option<Vec<f64>> {
        if !specimens.lasting || !window.random {
            return None;
        }
        let (motion, of) = (self.motion, window.source);
        let own: Vec<&Window> = motion.windows.iter().filter(|other| other.source == of).collect();
        let walked = match &specimens.walked[of] {
            Some(walked) => walked.clone(),
            None => {
                let (effects, creeps) = (specimens.of_states.clone(), specimens.creeps);
                self.walks.of(Walk { effects, source: of, zero_m, creeps })
            }
        };
        specimens.walked[of] = Some(walked.clone());
        let states = walked.get_or_init(|| {
            let begins: Vec<usize> = own.iter().map(|own| self.warmed_from(specimens, own)).collect();
            let specimen = &mut specimens.each[of];
            specimen.reset();
            let mut at = motion.sources[of].first;
            specimen.set_time_s(motion.sources[of].time_s(at, motion.dt_s()));
            let hidden = |begin: usize| {
                for n in at..begin.max(at) {
                    specimen.impose(motion.displacement_m[n] + zero_m, motion.velocity_m_s[n]);
                }
                at = begin.max(at);
                specimen.hidden()
            };
            begins.into_iter().map(hidden).collect()
        });
        let place = own.iter().position(|own| std::ptr::eq(*own, window))?;
        let begins = self.warmed_from(specimens, window);
        let states = states.get(place)?;
        (begins > motion.sources[of].first && !states.is_empty()).then(|| states.clone())
    }

    pub(super) fn specimens(&self, spec: &ModelSpec) -> Option<Specimens> {
        let sources = &self.motion.sources;
        let build = |source: &Source| model::build(&source.setting.of(spec), self.motion.dt_s()).ok();
        let has = |name: &str| spec.effects.iter().any(|effect| effect.name == name);
        let (remembers, kicks, creeps) =
            (has("fractional-damping"), has("table-interaction"), has("hertz-contact"));
        let stateless = |effect: &EffectSpec| effects::find(&effect.name).is_ok_and(|e| e.states.is_empty());
        let hidden = !spec.effects.iter().all(stateless);
        let share = self.motion.driven_by(spec);
        let lasting = has("bouc-wen-hysteresis") && !has("backlash") && !has("iwan-hysteresis");
        let stateful = spec.effects.iter().filter(|effect| lasting && !stateless(effect));
        Some(Specimens {
            lasting,
            of_states: stateful.cloned().collect(),
            walked: vec![None; sources.len()],
            each: sources.iter().map(build).collect::<Option<_>>()?,
            hidden,
            creeps,
            remembers,
            kicks,
            share,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::diagnose::testing::seen;
    use crate::identify::kinematics::Tolerances;
    use crate::identify::motion::Motion;
    use crate::model::testing::b1_g2;

    #[test]
    fn a_hysteresis_begins_each_part_as_the_whole_record_before_left_it() {
        let mut spec = b1_g2();
        let numbers = [("kh_n_m", 6000.0), ("dy_m", 0.004), ("n", 1.5), ("beta", 0.5), ("gamma", 0.5)];
        spec.effects.push(EffectSpec {
            name: "bouc-wen-hysteresis".into(),
            expression: None,
            parameters: numbers.map(|(name, value)| (name.to_owned(), value)).into(),
        });
        let mut record = seen(&spec, 3);
        record.step.clear();
        let mut motion = Motion::of(&record, spec.mass_kg, Tolerances::default()).expect("sound");
        let simulated = |motion: &Motion, lasting: bool| -> Vec<Simulated> {
            let measured = Measured::new(motion).expect("driven");
            let mut specimens = measured.specimens(&spec).expect("a model");
            assert!(specimens.lasting);
            specimens.lasting = lasting;
            let still = measured.still(crate::identify::problem::Part::HeldOut);
            let held_out = measured.held_out.iter().zip(&still);
            held_out
                .map(|(k, still)| measured.simulate(&mut specimens, &motion.windows[*k], &[0.0; 6], still))
                .collect()
        };
        let walked = simulated(&motion, true);
        motion.windows.iter_mut().for_each(|window| window.warm_from = 0);
        let from_the_beginning = simulated(&motion, false);
        let farthest = |of: &Simulated| of.iter().fold(0.0_f64, |most, (_, d)| most.max(d.abs()));
        for (walked, whole) in walked.iter().zip(&from_the_beginning) {
            let apart = walked.iter().zip(whole).fold(0.0_f64, |most, (a, b)| most.max((a.1 - b.1).abs()));
            assert!(apart < 1e-5 * farthest(whole), "{apart} m of {}", farthest(whole));
        }
    }
}
