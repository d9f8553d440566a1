//! A model's simulated step, from the measured state and driven as the record was. Called for every step that is laid against a model,
//! and for every slope.

use super::jumps::Sampled;
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
        let (specimen, share) = (&mut *specimens.each[window.source], specimens.share);
        specimen.reset();
        let source = &motion.sources[window.source];
        let last = window.range.start.max(1) - 1;
        let mut first = window.warm_from.min(last);
        if !specimens.hidden {
            // Nothing but the tips of the bumpers to bring to where they are.
            let cycles = if specimens.creeps { CREEPING } else { RETURNING };
            let samples = cycles * motion.sample_rate_hz / window.frequency_hz.max(1e-9);
            first = first.max(last.saturating_sub(samples as usize));
        }
        specimen.set_time_s(source.time_s(first, motion.dt_s()));
        if specimens.remembers {
            specimen.recall(self.remembered(window));
        }
        motion.retrace(specimen, window, first, zero_m);
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

    pub(super) fn specimens(&self, spec: &ModelSpec) -> Option<Specimens> {
        let sources = &self.motion.sources;
        let build = |source: &Source| model::build(&source.setting.of(spec), self.motion.dt_s()).ok();
        let has = |name: &str| spec.effects.iter().any(|effect| effect.name == name);
        let (remembers, kicks, creeps) =
            (has("fractional-damping"), has("table-interaction"), has("hertz-contact"));
        let stateless = |effect: &EffectSpec| effects::find(&effect.name).is_ok_and(|e| e.states.is_empty());
        let hidden = !spec.effects.iter().all(stateless);
        let share = self.motion.driven_by(spec);
        Some(Specimens {
            each: sources.iter().map(build).collect::<Option<_>>()?,
            hidden,
            creeps,
            remembers,
            kicks,
            share,
        })
    }
}
