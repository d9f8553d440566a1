//! Which effects are tried, and from where their parameters start.

use crate::identify::motion::Motion;
use crate::model::effects::{self, Effect, Parameter, Place, Sign, stribeck_friction};
use crate::model::{EffectSpec, ModelSpec, Scales};
use std::f64::consts::TAU;

/// Effects that a single record may show through the motion of the specimen, in the
/// order of the catalogue, those that the model has already left out.
///
/// Instruments are judged by kinematics, the table by its own acceleration; a wrong mass looks
/// like all stiffnesses and dampings scaled; an expression is the user's own.
pub fn physical(spec: &ModelSpec) -> Vec<&'static Effect> {
    effects::CATALOGUE
        .iter()
        .copied()
        .filter(|effect| {
            let judged_elsewhere = !acts_on_motion(effect) || effect.name == "table-interaction";
            let absent = effect.needs_bumper() && spec.bumper.is_none();
            let given = spec.effects.iter().any(|given| given.name == effect.name);
            !(judged_elsewhere || absent || given)
        })
        .collect()
}

/// Whether an effect of the catalogue changes the motion in a way of its own: no instrument, no formula of the user, no wrong
/// mass.
pub fn acts_on_motion(effect: &Effect) -> bool {
    !(effect.is_instrument() || effect.place == Place::User || effect.name == "mass-error")
}

/// Simpler effects that are contained in an effect as a limit: parsimony prefers them.
pub fn contained_in(name: &str) -> &'static [&'static str] {
    match name {
        "stribeck-friction" => &["coulomb-friction"],
        "iwan-hysteresis" => &["coulomb-friction"],
        "bouc-wen-hysteresis" => &["coulomb-friction"],
        "stand-compliance" => &["bumper-preload"],
        _ => &[],
    }
}

/// Effects that do much the same to a record, by twos.
pub const TWINS: [[&str; 2]; 5] = [
    ["coulomb-friction", "stribeck-friction"],
    ["maxwell-branch", "fractional-damping"],
    ["bouc-wen-hysteresis", "iwan-hysteresis"],
    ["hertz-contact", "bumper-stiffening"],
    ["constant-force", "gap-asymmetry"],
];

/// The effect that does much the same as another, if there is one.
pub fn twin(name: &str) -> Option<&'static str> {
    TWINS.iter().find_map(|[one, other]| match name {
        _ if name == *one => Some(*other),
        _ if name == *other => Some(*one),
        _ => None,
    })
}

/// A number of an effect's shape that a model may leave out.
pub struct Shape {
    /// Name of the parameter.
    pub name: &'static str,
    /// Limits within which it can be simulated; none where a search leaves it as it is.
    pub limits: Option<(f64, f64)>,
    /// Those of an explanation along a motion that is known, where that lets go farther.
    pub at_last: Option<(f64, f64)>,
    /// Where a fit begins that the default leads nowhere.
    pub other: Option<f64>,
}

/// Numbers of an effect's shape that a model may leave out, those that no other number of it makes up for: a fit begins without them.
pub fn shapes(name: &str) -> &'static [Shape] {
    match name {
        // With a gamma of 1 and more, unloading takes the element farther out; with an n below 1 its slope has a cusp at rest, and at 1,
        // the default, it bends there.
        "bouc-wen-hysteresis" => &[
            Shape { name: "n", limits: Some((1.0, 5.0)), at_last: Some((1.0, 25.0)), other: Some(2.0) },
            Shape { name: "gamma", limits: Some((-0.5, 0.9)), at_last: None, other: None },
        ],
        "stand-compliance" => {
            &[Shape { name: "zeta", limits: Some((1e-4, 0.3)), at_last: None, other: None }]
        }
        // What falls off otherwise falls off all the same: a search finds it as it usually is.
        "stribeck-friction" => &[Shape {
            name: stribeck_friction::EXPONENT,
            limits: None,
            at_last: Some(stribeck_friction::EXPONENTS),
            other: None,
        }],
        _ => &[],
    }
}

/// Magnitudes of the motion, for the priors of the effects.
pub fn scales(spec: &ModelSpec, motion: &Motion) -> Scales {
    let mut scales = Scales::of_spec(spec, motion.dt_s());
    let peak = |x: &[f64]| 1.5 * motion.rms(x).max(1e-300);
    scales.mass_kg = spec.mass_kg;
    scales.displacement_m = peak(&motion.displacement_m);
    scales.velocity_m_s = peak(&motion.velocity_m_s);
    scales.acceleration_m_s2 = peak(&motion.restoring_m_s2);
    scales.force_n = scales.mass_kg * scales.acceleration_m_s2;
    scales.frequency_hz = motion.median_frequency_hz();
    scales.fastest_hz = motion.fastest_hz;
    scales.duration_s = motion.displacement_m.len() as f64 * motion.dt_s();
    scales.sample_period_s = motion.dt_s();
    if let Some(bumper) = &spec.bumper {
        let largest = motion
            .windows
            .iter()
            .flat_map(|w| &motion.displacement_m[w.range.clone()])
            .fold(0.0_f64, |m, d| m.max(d.abs()));
        scales.penetration_m = Some((largest - 0.5 * bumper.total_gap_m).max(0.02 * largest));
        scales.total_gap_m = Some(bumper.total_gap_m);
    }
    scales
}

/// A start whose effect is scaled, within what its leading parameter may be, and by how much it was; `None` when its sign
/// forbids it.
pub fn scaled(start: &EffectSpec, factor: f64, scales: &Scales) -> Option<(EffectSpec, f64)> {
    let effect = effects::find(&start.name).ok()?;
    let leading = (effect.parameters)(scales).into_iter().find(|p| p.default.is_none())?;
    if leading.sign != Sign::Either && factor <= 0.0 {
        return None;
    }
    if effect.name == "hertz-contact" {
        let factor = factor.min((MOST_BENT - 1.0) / (start.parameters.get("n")? - 1.0).max(1e-9));
        return Some((grown(start, &leading, factor, scales)?, factor));
    }
    let (low, high) = leading.prior;
    let most = (3.0 * high.abs()).min(leading.at_most);
    let least = if leading.sign == Sign::Either { -most } else { (0.1 * low).max(1e-6 * high.abs()) };
    let before = *start.parameters.get(leading.name)?;
    let within =
        (before * if leading.in_series { 1.0 / factor } else { factor }).clamp(least.min(most), most);
    let by = if leading.in_series { before / within } else { within / before };
    let spec = grown(start, &leading, by, scales)?;
    by.is_finite().then_some((spec, by))
}

/// Largest exponent of a contact that a fit starts from.
const MOST_BENT: f64 = 3.0;

/// A start that does less, or more.
pub fn fainter(start: &EffectSpec, factor: f64, scales: &Scales) -> Option<EffectSpec> {
    let effect = effects::find(&start.name).ok()?;
    let leading = (effect.parameters)(scales).into_iter().find(|p| p.default.is_none())?;
    grown(start, &leading, factor, scales)
}

/// A start whose effect is so many times as strong.
fn grown(start: &EffectSpec, leading: &Parameter, factor: f64, scales: &Scales) -> Option<EffectSpec> {
    let mut spec = start.clone();
    if start.name == "hertz-contact" && scales.penetration_m.is_some() {
        // In place of the bumper's line, as stiff as it at the usual penetration: its exponent bends it.
        let n = 1.0 + (start.parameters.get("n")? - 1.0) * factor;
        spec.parameters.insert("n".to_owned(), n);
        spec.parameters.insert("kh".to_owned(), scales.contact_coefficient(n));
        return Some(spec);
    }
    let value = spec.parameters.get_mut(leading.name)?;
    *value = if leading.in_series { *value / factor } else { *value * factor };
    // A stand rings as fast as before, a lighter one where it is softer; breakaway friction stays as far above the sliding one.
    match start.name.as_str() {
        "stand-compliance" => spec.parameters.get_mut("ms_kg").into_iter().for_each(|mass| *mass /= factor),
        "stribeck-friction" => spec.parameters.get_mut("fs_n").into_iter().for_each(|fs| *fs *= factor),
        _ => {}
    }
    Some(spec)
}

/// A model with an effect more, its own numbers such that it does about the same: a bumper on a stand is stiffer by what the
/// stand gives way, a preloaded one stands back by what it would give way under its preload.
pub fn beside(spec: &ModelSpec, start: &EffectSpec) -> ModelSpec {
    let mut with = spec.clone();
    with.effects.push(start.clone());
    if let ("stand-compliance", Some(bumper), Some(&stand)) =
        (start.name.as_str(), &mut with.bumper, start.parameters.get("ks_n_m"))
    {
        // Springs in series, the stand no softer than twice both together; the loss of the bumper's share of the motion.
        let stiffer = 1.0 / (1.0 - bumper.stiffness_n_m / stand.max(2.0 * bumper.stiffness_n_m));
        bumper.stiffness_n_m *= stiffer;
        bumper.damping_n_s_m *= stiffer * stiffer;
    }
    if let ("bumper-preload", Some(bumper), Some(preload)) =
        (start.name.as_str(), &mut with.bumper, start.parameters.get("f0_n"))
    {
        bumper.total_gap_m += 2.0 * preload / bumper.stiffness_n_m;
    }
    with
}

/// Frequencies of a stand that are tried, Hz, each so many times the one before; its stiffness over the bumper's. Those of soft bumpers
/// begin where twice as stiff a stand does with that share of the mass.
const RINGING_HZ: [f64; 2] = [15.0, 700.0];
const HEAVIEST: f64 = 0.08;
const FASTER: f64 = 1.11;
const STIFFER: f64 = 30.0;
/// How many times softer a stand is tried, too, and so many of its frequencies, where no response tells how strong it is.
const SOFTER: [f64; 3] = [1.0, 4.0, 12.0];
const RINGINGS: usize = 20;
/// The golden section.
pub(super) const GOLDEN: f64 = 0.618_033_988_749_895;
/// Shapes that are no nearer to each other than that are started from.
const ALIKE: f64 = 0.1;
/// Starts spread over the prior ranges of an effect with three numbers or more.
const SPREAD: i32 = 6;

/// Starting values: shape parameters spread over their prior ranges, the leading (amplitude)
/// parameter small, of either sign where it may be.
pub fn starts(effect: &Effect, scales: &Scales) -> Vec<EffectSpec> {
    if effect.name == "hertz-contact" && scales.penetration_m.is_some() {
        // Both of its numbers together: exponents with the linear bumper's force at the usual penetration.
        let bent = |n: f64| {
            let mut spec = effect.starting_spec(scales);
            spec.parameters.insert("kh".to_owned(), scales.contact_coefficient(n));
            spec.parameters.insert("n".to_owned(), n);
            spec
        };
        return [1.1, 1.5, 2.0, 2.7].map(bent).to_vec();
    }
    if effect.name == "stand-compliance" {
        // How it shows depends on how fast it rings; at one frequency it does so much more as it is softer.
        let contact_n_m = scales.contact_stiffness_n_m();
        let slow_hz = (2.0 * contact_n_m / (HEAVIEST * scales.mass_kg)).sqrt() / TAU;
        let slowest_hz = RINGING_HZ[0].min(slow_hz);
        let count = ((RINGING_HZ[1] / slowest_hz).ln() / FASTER.ln()) as i32;
        let ringing = |k: i32| {
            let (stiffness, pulsation) = (STIFFER * contact_n_m, TAU * slowest_hz * FASTER.powi(k));
            let mut spec = effect.starting_spec(scales);
            spec.parameters.insert("ks_n_m".to_owned(), stiffness);
            spec.parameters.insert("ms_kg".to_owned(), stiffness / pulsation.powi(2));
            spec
        };
        // Spread from the first on, for those who take a few.
        let mut order: Vec<i32> = (0..=count).collect();
        order.sort_by(|a, b| (GOLDEN * f64::from(*a)).fract().total_cmp(&(GOLDEN * f64::from(*b)).fract()));
        return order.into_iter().map(ringing).collect();
    }
    let parameters: Vec<_> =
        (effect.parameters)(scales).into_iter().filter(|p| p.default.is_none()).collect();
    let quantile = |(low, high): (f64, f64), q: f64, logarithmic: bool| {
        if logarithmic && low > 0.0 { low * (high / low).powf(q) } else { low + (high - low) * q }
    };
    let mut out = vec![effect.starting_spec(scales)];
    // Along the diagonal of the prior ranges; where there are three numbers or more, spread over them by an additive recurrence
    // with the roots of x^(n+1) = x + 1 (M. Roberts, The unreasonable effectiveness of quasirandom sequences, 2018).
    let n = parameters.len();
    let diagonal: &[f64] = if n > 1 { &[0.5, 0.25, 0.75, 0.1] } else { &[0.5] };
    let mut points: Vec<Vec<f64>> = diagonal.iter().map(|q| vec![*q; n]).collect();
    if n > 2 {
        let root = (0..30).fold(2.0_f64, |x, _| (1.0 + x).powf(1.0 / n as f64));
        let at = |k: i32, i: usize| (0.5 + f64::from(k) * root.powi(-(i as i32))).fract();
        points.extend((1..=SPREAD).map(|k| (0..n).map(|i| at(k, i)).collect()));
    }
    for point in points {
        let mut spec = effect.starting_spec(scales);
        for ((i, parameter), q) in parameters.iter().enumerate().zip(point) {
            let value = match (i, parameter.sign) {
                (0, Sign::Either) => 0.05 * parameter.prior.1,
                (0, _) => quantile(parameter.prior, 0.3, parameter.log_scale),
                _ => quantile(parameter.prior, q, parameter.log_scale),
            };
            spec.parameters.insert(parameter.name.to_owned(), value);
        }
        order_friction(&mut spec);
        out.push(spec);
    }
    if let ("bumper-preload", Some(gap)) = (effect.name, scales.total_gap_m) {
        // By how far it makes the bumper stand back.
        out.extend([0.0025, 0.005, 0.01, 0.02, 0.04].map(|share| {
            let mut spec = effect.starting_spec(scales);
            spec.parameters.insert("f0_n".to_owned(), 0.5 * share * gap * scales.contact_stiffness_n_m());
            spec
        }));
    }
    one_of_each_shape(&mut out, &parameters, effect.name != "bumper-preload");
    out.iter_mut().for_each(|start| start.hold_up_to(scales.fastest_hz));
    out
}

/// Starts for a fit by force alone, which follows a stand neither to another frequency nor far to a softer one.
pub fn starts_by_force(effect: &Effect, scales: &Scales) -> Vec<EffectSpec> {
    if effect.name != "stand-compliance" {
        return starts(effect, scales);
    }
    let ringing = starts(effect, scales).into_iter().take(RINGINGS);
    ringing.flat_map(|start| SOFTER.into_iter().filter_map(move |by| fainter(&start, by, scales))).collect()
}

/// Loading and unloading shape of a hysteresis that grows stiffer as it is loaded, and its yield displacements over the motion.
const STIFFENS: [(&str, f64); 2] = [("beta", 0.75), ("gamma", -1.0)];
const YIELDS: [f64; 3] = [0.1, 0.3, 0.9];

/// Starts of an effect that specimens of other rigs may have in a form that an elastomer has not: a Bouc-Wen hysteresis that grows stiffer
/// as it is loaded (hardening; Ismail, Ikhouane and Rodellar, Arch. Comput. Methods Eng. 16 (2009) 161).
pub fn starts_elsewhere(effect: &Effect, scales: &Scales) -> Vec<EffectSpec> {
    let stiffening = |yields: f64| {
        let mut spec = effect.starting_spec(scales);
        spec.parameters.insert("dy_m".to_owned(), yields * scales.displacement_m);
        spec.parameters.extend(STIFFENS.map(|(name, value)| (name.to_owned(), value)));
        spec
    };
    if effect.name == "bouc-wen-hysteresis" { YIELDS.map(stiffening).to_vec() } else { Vec::new() }
}

/// Leaves out what is shaped like one before it: how strong an effect is follows from first order.
fn one_of_each_shape(starts: &mut Vec<EffectSpec>, parameters: &[Parameter], strength_follows: bool) {
    let shape = &parameters[usize::from(strength_follows && !parameters.is_empty())..];
    let alike = |a: &EffectSpec, b: &EffectSpec| {
        shape.iter().all(|parameter| {
            let (of_a, of_b) = (a.parameters.get(parameter.name), b.parameters.get(parameter.name));
            of_a.zip(of_b).is_some_and(|(a, b)| (a - b).abs() <= ALIKE * a.abs().max(b.abs()))
        })
    };
    let mut kept: Vec<EffectSpec> = Vec::with_capacity(starts.len());
    for start in starts.drain(..) {
        if !kept.iter().any(|other| alike(other, &start)) {
            kept.push(start);
        }
    }
    *starts = kept;
}

/// Breakaway friction is not below the sliding one.
fn order_friction(spec: &mut EffectSpec) {
    if let (Some(&fc), Some(fs)) =
        (spec.parameters.get("fc_n").copied().as_ref(), spec.parameters.get_mut("fs_n"))
    {
        *fs = fs.max(1.3 * fc);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::testing::{b1_g2, effect};

    #[test]
    fn starts_are_scaled_by_what_they_do() {
        let spec = b1_g2();
        let mut scales = Scales::of_spec(&spec, 1.0 / 2048.0);
        scales.penetration_m = Some(0.01);
        let (more, by) = scaled(&effect("coulomb-friction", &[("fc_n", 10.0)]), 2.0, &scales).expect("may");
        assert_eq!((more.parameters["fc_n"], by), (20.0, 2.0));
        assert!(scaled(&effect("coulomb-friction", &[("fc_n", 10.0)]), -2.0, &scales).is_none());
        // A stand does more the softer it is.
        let stand = effect("stand-compliance", &[("ks_n_m", 1e6), ("ms_kg", 10.0)]);
        let (more, by) = scaled(&stand, 2.0, &scales).expect("may");
        assert_eq!((more.parameters["ks_n_m"], by), (5e5, 2.0));
        // A contact is bent more, as stiff as the line at the usual penetration.
        let hertz = effect("hertz-contact", &[("kh", scales.contact_stiffness_n_m()), ("n", 1.2)]);
        let (more, _) = scaled(&hertz, 2.0, &scales).expect("may");
        let at = more.parameters["kh"] * 0.01_f64.powf(more.parameters["n"]);
        assert!((more.parameters["n"] - 1.4).abs() < 1e-12, "{more:?}");
        assert!((at / (scales.contact_stiffness_n_m() * 0.01) - 1.0).abs() < 1e-12, "{more:?}");
    }

    #[test]
    fn a_preloaded_bumper_presses_as_much_as_before() {
        let spec = b1_g2();
        let with = beside(&spec, &effect("bumper-preload", &[("f0_n", 30.0)]));
        let (before, after) = (spec.bumper.expect("one"), with.bumper.expect("one"));
        let presses = |d: f64, gap: f64, preload: f64| preload + before.stiffness_n_m * (d - 0.5 * gap);
        let d = before.total_gap_m;
        let (then, now) = (presses(d, before.total_gap_m, 0.0), presses(d, after.total_gap_m, 30.0));
        assert!((now / then - 1.0).abs() < 1e-12, "{then} {now}");
    }

    #[test]
    fn a_bumper_on_a_stand_is_as_stiff_as_before() {
        let spec = b1_g2();
        let with = beside(&spec, &effect("stand-compliance", &[("ks_n_m", 5e5), ("ms_kg", 10.0)]));
        let (before, after) = (spec.bumper.expect("one"), with.bumper.expect("one"));
        let both = 1.0 / (1.0 / after.stiffness_n_m + 1.0 / 5e5);
        assert!((both / before.stiffness_n_m - 1.0).abs() < 1e-12, "{both}");
        assert!(after.damping_n_s_m > before.damping_n_s_m);
    }
}
