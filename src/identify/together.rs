//! Several records of one specimen as one motion: a first test and the one that was to decide, or the same specimen with
//! another gap and without bumpers. Diagnosis calls it; instruments are corrected record by record before.

use super::motion::{Motion, MotionError};
use crate::model::{ModelSpec, effects};
use std::ops::Range;

/// What was changed on the specimen between records; everything else is fitted as one.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Setting {
    /// The bumpers were taken off.
    pub without_bumpers: bool,
    /// The total gap was made wider by so much, m.
    pub wider_m: f64,
}

/// Where a record lies within a motion.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Source {
    /// Its first sample.
    pub first: usize,
    /// Time of that sample on the record's own clock, s.
    pub start_s: f64,
    /// How the specimen stood.
    pub setting: Setting,
}

impl Source {
    /// Time of a sample on the record's own clock, s.
    pub fn time_s(&self, sample: usize, dt_s: f64) -> f64 {
        self.start_s + (sample as f64 - self.first as f64) * dt_s
    }
}

/// Why records cannot be looked at together.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum TogetherError {
    /// A record that cannot be used at all.
    #[error(transparent)]
    Motion(#[from] MotionError),
    /// The models differ in more than what is changed between two tests.
    #[error(
        "model `{second}` differs from `{first}` in more than the gap and the bumpers; records of other specimens are \
         diagnosed one by one"
    )]
    OtherSpecimen {
        /// Model of the first record.
        first: String,
        /// The other model.
        second: String,
    },
    /// The first record has to be the one with bumpers.
    #[error("model `{second}` has bumpers, `{first}` has none: name the record with bumpers first")]
    BumpersFirst {
        /// Model of the first record.
        first: String,
        /// The other model.
        second: String,
    },
    /// Records of different kinds or rates.
    #[error("records of different {what} cannot be diagnosed together")]
    Different {
        /// What differs.
        what: &'static str,
    },
}

impl Setting {
    /// What was changed from one model to another.
    ///
    /// # Errors
    /// They differ in more than gap and bumpers.
    pub fn between(first: &ModelSpec, second: &ModelSpec) -> Result<Self, TogetherError> {
        let names = || (first.name.clone(), second.name.clone());
        let mut setting = Self::default();
        match (&first.bumper, &second.bumper) {
            (Some(a), Some(b)) => setting.wider_m = b.total_gap_m - a.total_gap_m,
            (Some(_), None) => setting.without_bumpers = true,
            (None, Some(_)) => {
                let (first, second) = names();
                return Err(TogetherError::BumpersFirst { first, second });
            }
            (None, None) => {}
        }
        let mut same = setting.of(first);
        (same.name, same.uncertainty) = (second.name.clone(), second.uncertainty.clone());
        if let (Some(a), Some(b)) = (&mut same.bumper, &second.bumper) {
            a.total_gap_m = b.total_gap_m;
        }
        if same != *second {
            let (first, second) = names();
            return Err(TogetherError::OtherSpecimen { first, second });
        }
        Ok(setting)
    }

    /// A model in this setting.
    pub fn of(&self, spec: &ModelSpec) -> ModelSpec {
        let mut spec = spec.clone();
        if self.without_bumpers {
            spec.bumper = None;
            if let Some(uncertainty) = &mut spec.uncertainty {
                uncertainty.bumper = None;
            }
            spec.effects.retain(|e| !effects::find(&e.name).is_ok_and(|effect| effect.needs_bumper()));
        }
        if let Some(bumper) = &mut spec.bumper {
            bumper.total_gap_m = (bumper.total_gap_m + self.wider_m).max(0.0);
        }
        spec
    }
}

impl Motion {
    /// The motion of all records, one after the other; each keeps its windows, its clock and its setting.
    ///
    /// # Errors
    /// Records of different kinds, rates or channels; none.
    pub fn together(parts: Vec<(Motion, Setting)>) -> Result<Self, TogetherError> {
        let mut parts = parts.into_iter();
        let Some((mut all, setting)) = parts.next() else {
            return Err(MotionError::TooShort { samples: 0, needed: 1 }.into());
        };
        all.sources.iter_mut().for_each(|source| source.setting = setting);
        for (part, setting) in parts {
            if part.kind != all.kind {
                return Err(TogetherError::Different { what: "kinds" });
            }
            if (part.sample_rate_hz / all.sample_rate_hz - 1.0).abs() > 1e-6 {
                return Err(TogetherError::Different { what: "sampling rates" });
            }
            let sees = |motion: &Motion| (motion.sees_acceleration, motion.laser_m.is_empty());
            if sees(&part) != sees(&all) {
                return Err(TogetherError::Different { what: "channels" });
            }
            all.append(part, setting);
        }
        Ok(all)
    }

    /// Samples of each record.
    pub fn records(&self) -> impl Iterator<Item = Range<usize>> {
        let ends = self.sources.iter().map(|source| source.first).skip(1).chain([self.displacement_m.len()]);
        self.sources.iter().zip(ends).map(|(source, end)| source.first..end)
    }

    fn append(&mut self, part: Motion, setting: Setting) {
        let (here, there) = (self.displacement_m.len(), part.displacement_m.len());
        let (number, first_step) = (self.sources.len(), self.windows.iter().map(|w| w.step + 1).max());
        let share = there as f64 / (here + there).max(1) as f64;
        let mix = |a: f64, b: f64| ((1.0 - share) * a * a + share * b * b).sqrt();
        self.drive_noise_m_s2 = mix(self.drive_noise_m_s2, part.drive_noise_m_s2);
        self.restoring_noise_m_s2 = mix(self.restoring_noise_m_s2, part.restoring_noise_m_s2);
        self.laser_noise_m = mix(self.laser_noise_m, part.laser_noise_m);
        self.displacement_noise_m = mix(self.displacement_noise_m, part.displacement_noise_m);
        self.velocity_noise_m_s = mix(self.velocity_noise_m_s, part.velocity_noise_m_s);
        self.fastest_hz = self.fastest_hz.max(part.fastest_hz);
        self.sources.extend(part.sources.iter().map(|s| Source { first: s.first + here, setting, ..*s }));
        self.windows.extend(part.windows.into_iter().map(|mut window| {
            window.range = window.range.start + here..window.range.end + here;
            window.warm_from += here;
            window.source += number;
            window.step += first_step.unwrap_or(0);
            window
        }));
        self.displacement_m.extend(part.displacement_m);
        self.velocity_m_s.extend(part.velocity_m_s);
        self.velocity_is_told.extend(part.velocity_is_told);
        self.is_held.extend(part.is_held);
        self.restoring_m_s2.extend(part.restoring_m_s2);
        self.drive_m_s2.extend(part.drive_m_s2);
        self.seen_drive_m_s2.extend(part.seen_drive_m_s2);
        self.laser_m.extend(part.laser_m);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::{BumperSpec, IsolatorSpec};

    fn model(gap_m: Option<f64>) -> ModelSpec {
        ModelSpec {
            name: format!("{gap_m:?}"),
            mass_kg: 500.0,
            isolator: IsolatorSpec {
                stiffness_n_m: vec![20e3],
                breakpoints_m: vec![],
                damping_n_s_m: 1100.0,
            },
            bumper: gap_m.map(|total_gap_m| BumperSpec {
                stiffness_n_m: 33e3,
                damping_n_s_m: 300.0,
                total_gap_m,
            }),
            effects: vec![],
            uncertainty: None,
        }
    }

    #[test]
    fn only_gap_and_bumpers_may_differ() {
        let (near, far, none) = (model(Some(0.02)), model(Some(0.03)), model(None));
        let wider = Setting::between(&near, &far).expect("another gap");
        assert!((wider.wider_m - 0.01).abs() < 1e-15 && !wider.without_bumpers);
        assert!(Setting::between(&near, &none).expect("no bumpers").without_bumpers);
        // A model that says how sure it is of its bumpers is valid without them as well.
        let text = include_str!("../../config/models/andreaus-2020-b2-g2.toml");
        let published: ModelSpec = crate::config::parse_toml("b2-g2", text).expect("valid");
        assert!(published.uncertainty.as_ref().is_some_and(|u| u.bumper.is_some()));
        let off = Setting { without_bumpers: true, wider_m: 0.0 }.of(&published);
        crate::config::Check::check(&off).expect("valid without bumpers");
        assert!(matches!(Setting::between(&none, &near), Err(TogetherError::BumpersFirst { .. })));
        let heavier = ModelSpec { mass_kg: 510.0, ..near.clone() };
        assert!(matches!(Setting::between(&near, &heavier), Err(TogetherError::OtherSpecimen { .. })));
        // A fitted gap is changed by as much as the screws were turned.
        let mut fitted = near.clone();
        fitted.set("bumper.total_gap_m", 0.0202).expect("a key");
        assert!((wider.of(&fitted).bumper.expect("bumpers").total_gap_m - 0.0302).abs() < 1e-15);
    }
}
