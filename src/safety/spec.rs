//! `config/safety.toml`: one row a detector, the numbers that detectors share, and the numbers of the
//! stops. Every row must be there, nothing unknown may be, and a detector can only be switched off with
//! a reason, which is recorded and shown.

use super::action::{Action, Clear};
use crate::config::{Check, ConfigError, parse_toml};
use serde::{Deserialize, Serialize};

/// The file that is built in; used when no other is named.
pub const BUILT_IN: &str = include_str!("../../config/safety.toml");

macro_rules! detectors {
    ($($(#[doc = $doc:literal])* $variant:ident $field:ident $name:literal $unit:literal $count:literal;)*) => {
        /// All detectors, in the order in which a tie for the first-out cause is settled.
        #[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
        #[serde(rename_all = "kebab-case")]
        #[repr(u8)]
        pub enum DetectorId { $($(#[doc = $doc])* $variant,)* }

        impl DetectorId {
            /// Every detector.
            pub const ALL: [Self; [$($name),*].len()] = [$(Self::$variant),*];

            /// Public name: the row in `safety.toml`, the word in events and on screen.
            pub fn name(self) -> &'static str {
                match self { $(Self::$variant => $name),* }
            }

            /// Unit of its indicator, empty for a ratio.
            pub fn unit(self) -> &'static str {
                match self { $(Self::$variant => $unit),* }
            }

            /// What its persistence counts.
            pub fn counts(self) -> &'static str {
                match self { $(Self::$variant => $count),* }
            }
        }

        /// A safety file.
        #[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
        #[serde(deny_unknown_fields, rename_all = "kebab-case")]
        pub struct SafetySpec {
            /// Numbers shared by detectors.
            pub detection: Detection,
            /// Numbers of the stops.
            pub stops: Stops,
            /// Times of the supervisor.
            pub supervision: Supervision,
            $($(#[doc = $doc])* pub $field: Row,)*
        }

        impl SafetySpec {
            /// The row of a detector.
            pub fn row(&self, id: DetectorId) -> &Row {
                match id { $(DetectorId::$variant => &self.$field),* }
            }

            /// The row of a detector, to change it.
            pub fn row_mut(&mut self, id: DetectorId) -> &mut Row {
                match id { $(DetectorId::$variant => &mut self.$field),* }
            }
        }
    };
}

detectors! {
    /// A channel delivers something that is not a finite number.
    NotANumber not_a_number "not-a-number" "channels" "samples";
    /// A channel is beyond what its instrument can measure.
    OutOfRange out_of_range "out-of-range" "" "samples";
    /// The DAQ or the drive reports a fault, or the rig lost a link.
    DeviceStatus device_status "device-status" "" "samples or periods";
    /// Mass acceleration, raw.
    MassAcceleration mass_acceleration "mass-acceleration" "m/s2" "samples";
    /// Table acceleration, 100 Hz.
    TableAcceleration table_acceleration "table-acceleration" "m/s2" "samples";
    /// Relative displacement beyond half the gap, over the margin of the bumper.
    RelativeDisplacement relative_displacement "relative-displacement" "" "samples";
    /// Measured table displacement against the delayed command.
    FollowingError following_error "following-error" "m" "samples";
    /// Fundamental of the table acceleration against the command.
    TableFundamental table_fundamental "table-fundamental" "" "half-cycles";
    /// Distortion of the table acceleration, 100 Hz.
    TableDistortion table_distortion "table-distortion" "" "half-cycles";
    /// Peak error of the table acceleration, 30 Hz.
    TablePeakError table_peak_error "table-peak-error" "" "half-cycles";
    /// Mass oscillations per table cycle.
    MassOscillations mass_oscillations "mass-oscillations" "1/cycle" "half-cycles";
    /// A channel repeats one value while the table moves.
    FrozenSensor frozen_sensor "frozen-sensor" "samples" "samples";
    /// The two accelerometers on the mass tell different things.
    AccelerometersDisagree accelerometers_disagree "accelerometers-disagree" "" "samples";
    /// A - a_table against the second derivative of D.
    SensorPlausibility sensor_plausibility "sensor-plausibility" "" "samples";
    /// Onboard model against measurement.
    ModelDivergence model_divergence "model-divergence" "" "samples";
    /// Periods without a sample.
    StaleSample stale_sample "stale-sample" "periods" "periods";
    /// A sample number that came before.
    RepeatedSample repeated_sample "repeated-sample" "in 1 s" "samples";
    /// Sample numbers that never came.
    SequenceGap sequence_gap "sequence-gap" "in 1 s" "samples";
    /// Control periods skipped.
    ControlSlips control_slips "control-slips" "in 1 s" "periods";
    /// The recorder's ring fills up.
    RecorderBehind recorder_behind "recorder-behind" "" "periods";
    /// The operator's side has not been heard of.
    OperatorLink operator_link "operator-link" "s" "periods";
}

/// One row: thresholds, persistence, action, clear condition.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Row {
    /// What is done when the indicator has been at `trip` or above for `persistence`.
    pub action: Action,
    /// Indicator from which on the operator is warned; absent: no warning.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub warn: Option<f64>,
    /// Indicator from which on the action is due.
    pub trip: f64,
    /// Estimates in a row that must be at or above the threshold.
    pub persistence: u32,
    /// When the finding is forgotten.
    pub clear: Clear,
    /// Why the detector is switched off; absent: it is on.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub disabled: Option<String>,
}

/// Numbers shared by detectors.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Detection {
    /// Amplitude below which limits do not shrink any further with A_G, m/s2.
    pub acceleration_floor_m_s2: f64,
    /// Following error allowed per commanded speed amplitude, s: the limit is the larger of the row's
    /// and this times A_G/(2 pi f).
    pub following_time_s: f64,
    /// Smallest reversal of D that counts as an oscillation, m.
    pub oscillation_hysteresis_m: f64,
    /// The same as a share of the total gap; the larger counts.
    pub oscillation_hysteresis_share: f64,
    /// Contacts in a table cycle below which oscillations are not judged.
    pub oscillation_contacts: u32,
    /// How far beyond half the gap the mass may press a bumper: pairs of stiffness (N/m) and margin (m),
    /// stiffness rising; between them the logarithms are interpolated.
    pub bumper_margins: Vec<[f64; 2]>,
    /// Largest relative displacement without bumpers, m.
    pub free_displacement_m: f64,
    /// Largest acceleration that the accelerometers can measure, m/s2.
    pub acceleration_range_m_s2: f64,
    /// Largest displacement that the displacement sensors can measure, m.
    pub displacement_range_m: f64,
    /// Level of D below which the model is not judged, m rms.
    pub model_floor_m: f64,
}

/// Numbers of the stops.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Stops {
    /// Frequency from which on a stop is a minimum-jerk one at once instead of a decay, Hz.
    pub decay_below_hz: f64,
    /// Cycles over which the amplitude decays.
    pub decay_cycles: u32,
    /// Acceleration of a minimum-jerk stop as a share of A_G, tried first.
    pub least_share: f64,
    /// The same, at most (unless only more keeps the table inside its stroke).
    pub most_share: f64,
    /// Jerk of a minimum-jerk stop, m/s3.
    pub jerk_m_s3: f64,
    /// Share of stroke, velocity, acceleration and jerk of the rig that a stop may use.
    pub capacity_share: f64,
    /// Rest between stop and return to the centre, s.
    pub rest_s: f64,
    /// Speed of the return, m/s.
    pub return_speed_m_s: f64,
    /// Acceleration of the return, m/s2.
    pub return_acceleration_m_s2: f64,
    /// Distance from the centre within which no return is needed, m.
    pub centre_tolerance_m: f64,
}

/// Times of the supervisor, and who else is listened to.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Supervision {
    /// Time after which an armed table that is not started is disarmed, s.
    pub armed_for_s: f64,
    /// How old a reset may be when it is looked at, s.
    pub reset_fresh_s: f64,
    /// An operator link is configured: its heartbeat is watched by `operator-link`.
    pub operator_link: bool,
    /// Time without a beat of the control thread after which the watchdog stops the drive, s.
    pub watchdog_s: f64,
}

impl SafetySpec {
    /// The built-in file.
    ///
    /// # Errors
    /// Never in a tested build: a test reads it.
    pub fn built_in() -> Result<Self, ConfigError> {
        parse_toml("config/safety.toml (built in)", BUILT_IN)
    }

    /// Detectors that are switched off, with their reasons.
    pub fn disabled(&self) -> impl Iterator<Item = (DetectorId, &str)> {
        DetectorId::ALL.into_iter().filter_map(|id| Some((id, self.row(id).disabled.as_deref()?)))
    }
}

type Fault = (String, String);

fn refuse(key: &str, reason: String) -> Result<(), Fault> {
    Err((key.to_owned(), reason))
}

fn check_row(name: &str, row: &Row) -> Result<(), Fault> {
    if !(row.trip.is_finite() && row.trip > 0.0) {
        return refuse(&format!("{name}.trip"), format!("{}; allowed: above 0", row.trip));
    }
    if let Some(warn) = row.warn
        && !(warn > 0.0 && warn <= row.trip)
    {
        let key = format!("{name}.warn");
        return refuse(&key, format!("{warn}; allowed: above 0 up to trip, {}", row.trip));
    }
    if !(1..=100_000).contains(&row.persistence) {
        return refuse(&format!("{name}.persistence"), format!("{}; allowed: 1 to 100000", row.persistence));
    }
    if row.action == Action::None {
        let reason = "\"none\"; to switch a detector off, give `disabled` with a reason".to_owned();
        return refuse(&format!("{name}.action"), reason);
    }
    if row.action.latches() && row.clear == Clear::Gone {
        let reason = "\"gone\"; a latching action clears on \"reset\" or \"never\"".to_owned();
        return refuse(&format!("{name}.clear"), reason);
    }
    if row.disabled.as_deref().is_some_and(|reason| reason.trim().len() < 10) {
        let reason = "a reason of at least 10 characters is required".to_owned();
        return refuse(&format!("{name}.disabled"), reason);
    }
    Ok(())
}

/// SR-11: nothing is missing (serde), unknown (serde), out of range or silently off.
impl Check for SafetySpec {
    fn check(&self) -> Result<(), Fault> {
        for id in DetectorId::ALL {
            check_row(id.name(), self.row(id))?;
        }
        let (d, s, t) = (&self.detection, &self.stops, &self.supervision);
        let ranges = [
            ("detection.acceleration_floor_m_s2", d.acceleration_floor_m_s2, 1e-3, 10.0),
            ("detection.following_time_s", d.following_time_s, 0.0, 0.1),
            ("detection.oscillation_hysteresis_m", d.oscillation_hysteresis_m, 1e-6, 0.1),
            ("detection.oscillation_hysteresis_share", d.oscillation_hysteresis_share, 0.0, 0.5),
            ("detection.free_displacement_m", d.free_displacement_m, 1e-3, 10.0),
            ("detection.acceleration_range_m_s2", d.acceleration_range_m_s2, 0.1, 1e4),
            ("detection.displacement_range_m", d.displacement_range_m, 1e-3, 10.0),
            ("detection.model_floor_m", d.model_floor_m, 1e-6, 0.1),
            ("stops.decay_below_hz", s.decay_below_hz, 0.0, 100.0),
            ("stops.decay_cycles", f64::from(s.decay_cycles), 1.0, 10.0),
            ("stops.least_share", s.least_share, 0.1, 1.0),
            ("stops.most_share", s.most_share, s.least_share, 2.0),
            ("stops.jerk_m_s3", s.jerk_m_s3, 1.0, 1e5),
            ("stops.capacity_share", s.capacity_share, 0.5, 1.0),
            ("stops.rest_s", s.rest_s, 0.1, 60.0),
            ("stops.return_speed_m_s", s.return_speed_m_s, 1e-3, 0.1),
            ("stops.return_acceleration_m_s2", s.return_acceleration_m_s2, 1e-3, 0.5),
            ("stops.centre_tolerance_m", s.centre_tolerance_m, 1e-6, 0.01),
            ("supervision.armed_for_s", t.armed_for_s, 1.0, 3600.0),
            ("supervision.reset_fresh_s", t.reset_fresh_s, 0.1, 60.0),
            ("supervision.watchdog_s", t.watchdog_s, 0.01, 10.0),
        ];
        for (key, value, low, high) in ranges {
            if !(low..=high).contains(&value) {
                return refuse(key, format!("{value}; allowed: {low} to {high}"));
            }
        }
        let margins = &d.bumper_margins;
        let usable = margins.iter().all(|[stiffness, margin]| *stiffness > 0.0 && *margin > 0.0);
        if margins.is_empty() || !usable || !margins.is_sorted_by(|a, b| a[0] < b[0]) {
            let reason = "one pair or more of stiffness (N/m, rising) and margin (m), all above 0".to_owned();
            return refuse("detection.bumper_margins", reason);
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(text: &str) -> Result<SafetySpec, String> {
        parse_toml::<SafetySpec>("safety.toml", text).map_err(|error| error.to_string())
    }

    fn line_of(text: &str, needle: &str) -> usize {
        text.lines().position(|line| line.starts_with(needle)).expect("there") + 1
    }

    #[test]
    fn the_built_in_file_is_valid_and_says_every_word_of_the_ladder_and_every_row() {
        let spec = SafetySpec::built_in().expect("valid");
        assert_eq!(spec.disabled().count(), 0);
        for id in DetectorId::ALL {
            assert!(BUILT_IN.contains(&format!("\n[{}]", id.name())), "{}", id.name());
        }
    }

    // SR-11
    #[test]
    fn a_missing_or_unknown_row_is_refused() {
        for id in DetectorId::ALL {
            let renamed = BUILT_IN.replace(&format!("\n[{}]", id.name()), "\n[unheard-of]");
            let error = read(&renamed).expect_err("refused");
            let line = line_of(&renamed, "[unheard-of]");
            assert!(error.starts_with(&format!("safety.toml:{line}: unknown field")), "{error}");
            let start = BUILT_IN.find(&format!("\n[{}]", id.name())).expect("there");
            let end = BUILT_IN[start + 2..].find("\n[").map_or(BUILT_IN.len(), |n| start + 2 + n);
            let error = read(&format!("{}{}", &BUILT_IN[..start], &BUILT_IN[end..])).expect_err("refused");
            assert!(error.contains(&format!("missing field `{}`", id.name())), "{error}");
        }
    }

    // SR-11
    #[test]
    fn a_detector_is_switched_off_with_a_reason_only() {
        let row = "\n[operator-link]";
        let silent = BUILT_IN.replace(row, "\n[operator-link]\ndisabled = \" \"\n#");
        let error = read(&silent).expect_err("refused");
        let line = line_of(&silent, "disabled = \" \"");
        assert!(error.starts_with(&format!("safety.toml:{line}: operator-link.disabled")), "{error}");
        let told = BUILT_IN.replace(row, "\n[operator-link]\ndisabled = \"bench without operator\"\n#");
        let spec = read(&told).expect("valid");
        assert_eq!(
            spec.disabled().collect::<Vec<_>>(),
            [(DetectorId::OperatorLink, "bench without operator")]
        );
        let none = BUILT_IN.replacen("action = \"abort\"", "action = \"none\"", 1);
        assert!(read(&none).expect_err("refused").contains("disabled"));
    }

    #[test]
    fn a_latching_action_does_not_clear_by_itself() {
        let text = BUILT_IN.replacen("clear = \"reset\"", "clear = \"gone\"", 1);
        assert!(read(&text).expect_err("refused").contains("a latching action"));
    }
}
