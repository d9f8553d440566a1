//! Instruments before physics: which instrument effects a record shows beyond their tolerance.

use crate::identify::kinematics::{Estimate, Instruments, Tolerances, Yaw};
use crate::record::{Kind, Record};
use serde::Serialize;

/// An instrument off by more than its tolerance.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Finding {
    /// Effect of the catalogue.
    pub name: String,
    /// Its parameters: name, value, 95 % interval, unit.
    pub parameters: Vec<(String, Estimate95, String)>,
    /// What was seen.
    pub text: String,
}

/// A value with its 95 % interval.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Estimate95 {
    /// Best value.
    pub value: f64,
    /// Lower end.
    pub low95: f64,
    /// Upper end.
    pub high95: f64,
}

impl From<Estimate> for Estimate95 {
    fn from(e: Estimate) -> Self {
        Self { value: e.value, low95: e.value - 1.96 * e.sigma, high95: e.value + 1.96 * e.sigma }
    }
}

impl Finding {
    /// It is a gain, which the response of a model that follows the record tells better than the kinematics do.
    pub fn is_gain(&self) -> bool {
        matches!(self.name.as_str(), "laser-gain" | "accelerometer-gain")
    }

    /// Takes up what the response of a model that follows the record says of its gains, factors: of the displacement sensor and of the
    /// accelerometers.
    pub fn sharpen(&mut self, [laser, accelerometers]: [Estimate; 2]) {
        let factor = match self.name.as_str() {
            "laser-gain" => laser,
            "accelerometer-gain" => accelerometers,
            _ => return,
        };
        for (_, estimate, _) in &mut self.parameters {
            let value = estimate.value;
            *estimate = Estimate { value: value * factor.value, sigma: value.abs() * factor.sigma }.into();
        }
    }
}

/// Judges what the kinematics told.
pub fn judge(found: &Instruments, record: &Record, tolerances: Tolerances) -> Vec<Finding> {
    let mut out = Vec::new();
    let beyond =
        |e: Estimate, neutral: f64, tolerance: f64| (e.value - neutral).abs() > tolerance + 3.0 * e.sigma;
    let (mass, rest) = match record.kind {
        Kind::Force => ("A", "D''"),
        Kind::Base | Kind::Component => ("A - a_table", "D'' and a_table"),
    };
    if beyond(found.laser_delay_s, 0.0, tolerances.delay_s) {
        out.push(finding(
            "laser-delay",
            "dt_s",
            "s",
            found.laser_delay_s,
            &format!("D'' comes late against {mass}"),
        ));
    }
    let late = found.accelerometers_late_s();
    if beyond(late, 0.0, tolerances.delay_s) {
        // Nothing comes before it happens.
        let text = if late.value < 0.0 {
            format!("A comes early against {rest}, as behind a coupling that blocks what is slow (AC)")
        } else {
            format!("A comes late against {rest}")
        };
        out.push(finding("accelerometer-delay", "dt_s", "s", late, &text));
    }
    // A gain is a finding from twice its tolerance: the priors that share the ratios between laser,
    // accelerometers and leak are as wide as the tolerances themselves.
    if beyond(found.laser_gain, 1.0, 5.0 * tolerances.laser_gain) {
        out.push(finding(
            "laser-gain",
            "gain",
            "1",
            found.laser_gain,
            &format!("D'' is out of proportion to {mass}"),
        ));
    }
    if let Some(Yaw { eccentricity_m, frequency_hz, damping_ratio, .. }) = found.yaw {
        let parameters =
            [("e_m", eccentricity_m, "m"), ("f_hz", frequency_hz, "Hz"), ("zeta", damping_ratio, "1")];
        out.push(Finding {
            name: "yaw-rotation".to_owned(),
            parameters: parameters
                .map(|(name, of, unit)| (name.to_owned(), of.into(), unit.to_owned()))
                .into(),
            text: "the accelerometers on the mass differ as a rotational mode does".to_owned(),
        });
    }
    // A mode that leaves gains open passes for some.
    if found.yaw.is_some_and(|yaw| !yaw.tells_gains(tolerances)) {
        return out;
    }
    out.extend(gain_of_accelerometers(found, record, tolerances, rest));
    out
}

/// Which of the accelerometers are out of proportion to the rest, by the numbers of the effect.
fn gain_of_accelerometers(
    found: &Instruments,
    record: &Record,
    tolerances: Tolerances,
    rest: &str,
) -> Option<Finding> {
    const GAINS: [&str; 2] = ["gain", "gain_2"];
    let tolerance = 2.0 * tolerances.accelerometer_gain;
    let gains = found.accelerometers.map(|accelerometer| accelerometer.gain);
    let [off, other_off] = gains.map(|gain| (gain.value - 1.0).abs());
    let [sigma, other_sigma] = gains.map(|gain| gain.sigma);
    let apart = (gains[0].value - gains[1].value).abs();
    let there = match record.kind {
        Kind::Base => {
            [&record.mass_acceleration_1_m_s2, &record.mass_acceleration_2_m_s2].map(|a| !a.is_empty())
        }
        Kind::Force | Kind::Component => [true, false],
    };
    if there == [true; 2] && apart > tolerance + 3.0 * sigma.hypot(other_sigma) {
        let which = usize::from(off <= other_off);
        let text = format!("accelerometer {} is out of proportion to the other and to {rest}", which + 1);
        return Some(finding("accelerometer-gain", GAINS[which], "1", gains[which], &text));
    }
    if off <= tolerance + 3.0 * sigma || other_off <= tolerance + 3.0 * other_sigma {
        return None;
    }
    let both = Estimate { value: 0.5 * (gains[0].value + gains[1].value), sigma: sigma.max(other_sigma) };
    let parameters = GAINS.into_iter().zip(there).filter(|(_, there)| *there);
    let text = if there == [true; 2] {
        "both accelerometers on the mass alike".to_owned()
    } else {
        format!("the accelerometer on the mass is out of proportion to {rest}")
    };
    Some(Finding {
        name: "accelerometer-gain".to_owned(),
        parameters: parameters.map(|(name, _)| (name.to_owned(), both.into(), "1".to_owned())).collect(),
        text,
    })
}

fn finding(name: &str, parameter: &str, unit: &str, estimate: Estimate, text: &str) -> Finding {
    Finding {
        name: name.to_owned(),
        parameters: vec![(parameter.to_owned(), estimate.into(), unit.to_owned())],
        text: text.to_owned(),
    }
}
