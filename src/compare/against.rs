//! Signs and units that only a model can tell: a mass that answers by a thousand times what the model's mass and stiffness let it, or to
//! the other side and so that it would give off energy, is measured in another unit, or wired the other way round.
//!
//! Of a component, that its force is what the model's line takes by no factor that a guess is off by.
//!
//! [`examine`] looks where neither damping nor a stiffness that is off matters, well below and well above what the model alone swings at.
//! Comparison and diagnosis call it beside the record's own quality, which needs no model.

use crate::model::ModelSpec;
use crate::model::system::System;
use crate::record::data::Role;
use crate::record::kinematic::typical_cycle;
use crate::record::quality::{Finding, Problem, Severity};
use crate::record::{Kind, Record};
use crate::signal::Spectrum;
use crate::units::STANDARD_GRAVITY_M_S2;
use realfft::num_complex::Complex64;

/// Samples that are looked at, in the middle of the record.
const PIECE: usize = 1 << 18;
/// Distance from the frequencies that the model's slopes have, as a factor.
const AWAY: f64 = 2.0;
/// Coherence of answer and model from which on they are of one motion, whatever its size.
const ALIKE: f64 = 0.9;
/// Factor to either side within which an answer is a unit's; models are not as far off.
const NEAR: f64 = 1.5;
/// Size of the imaginary part over the real one that a sign or unit has at most.
const SIDEWAYS: f64 = 0.3;
/// Samples of a component that say anything.
const FEWEST: usize = 100;
/// Share of the power that force and speed could have, that a turned sign gives off at least.
const GIVEN_OFF: f64 = 0.05;
/// The same where the model has no say, as about the frequencies that it swings at: a drive that comes late is not so far off.
const PLAINLY: f64 = 0.5;

/// Times that a component's force is what its model says, or less than it by, from which on that is no guess but a unit.
const FAR: f64 = 150.0;
/// Correlation of a component's force with the model's, with the other sign, from which on one of them is turned; and share of the energy that
/// it could take up which it gives off then. The inertia of what hangs on a load cell pushes the other way as well, and gives off none.
const TURNED: f64 = 0.2;
const GIVES: f64 = 0.01;
/// Velocities of a component are told over this share of a cycle.
const SHORT: f64 = 0.05;

/// What is wrong with how a channel answers.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Fault {
    Sign,
    Unit(f64),
}

/// Findings of a driven mass whose channels do not say themselves what sign and unit they have.
pub fn examine(record: &Record, spec: &ModelSpec) -> Vec<Finding> {
    if record.kind == Kind::Component {
        return of_component(record, spec).into_iter().collect();
    }
    let Some(answers) = answers(record) else { return Vec::new() };
    let rate = record.sample_rate_hz;
    let Ok(mass_kg) = System::compile(spec, 1.0 / rate).map(|system| system.mass_kg) else {
        return Vec::new();
    };
    let n = record.len();
    let from = n.saturating_sub(PIECE) / 2;
    let piece = |channel: &[f64]| {
        channel.get(from..(from + PIECE).min(n)).map(|piece| Spectrum::tapered(piece, rate))
    };
    let Some(drive) = piece(record.input()) else { return Vec::new() };
    // Force over mass, as it pushes the mass against what it is held by.
    let per_mass = if record.kind == Kind::Force { 1.0 / mass_kg } else { -1.0 };
    let faults: Vec<(Role, Option<Fault>)> = answers
        .into_iter()
        .filter_map(|role| {
            let answer = piece(record.channel(role))?;
            Some((role, fault(&drive, per_mass, &answer, role == Role::Acceleration, spec, mass_kg)))
        })
        .collect();
    let input = if record.kind == Kind::Force { Role::Force } else { Role::TableAcceleration };
    let of = |role: Role, fault: Fault| match fault {
        // No displacement is in g.
        Fault::Unit(factor) if role != Role::Acceleration && is_gravity(factor) => {
            finding(input, input, fault)
        }
        _ => finding(role, input, fault),
    };
    match faults[..] {
        // Two that agree, and whatever drives them is at fault.
        [(_, Some(one)), (_, Some(other))] if one == other => vec![of(input, one)],
        _ => faults.iter().filter_map(|(role, fault)| fault.map(|fault| of(*role, fault))).collect(),
    }
}

/// Channels whose sign and unit are asked of the model.
fn answers(record: &Record) -> Option<Vec<Role>> {
    let there = |role: &Role| record.channel(*role).len() == record.len();
    let roles = match record.kind {
        Kind::Base => vec![Role::RelativeDisplacement],
        Kind::Force => vec![Role::Displacement, Role::Acceleration],
        Kind::Component => return None,
    };
    Some(roles.into_iter().filter(there).collect())
}

/// What is wrong with a component's force, laid against the model's line: of another size by hundreds, or against it and without taking up any
/// energy, as nothing does that has a spring or a dashpot.
fn of_component(record: &Record, spec: &ModelSpec) -> Option<Finding> {
    let (d, f) = (&record.displacement_m, &record.force_n);
    let n = d.len();
    if n != f.len() || n < FEWEST {
        return None;
    }
    let mean = |x: &[f64]| x.iter().sum::<f64>() / n as f64;
    let (middle_m, mean_n) = (mean(d), mean(f));
    let cycle = typical_cycle(d).unwrap_or(n as f64);
    let reach = ((SHORT * cycle) as usize).clamp(1, n / 4);
    let (stiffness, damping) = (*spec.isolator.stiffness_n_m.first()?, spec.isolator.damping_n_s_m);
    let (mut there, mut modelled, mut both, mut taken, mut could) = (0.0, 0.0, 0.0, 0.0, 0.0);
    for i in reach..n - reach {
        let velocity = (d[i + reach] - d[i - reach]) * record.sample_rate_hz / (2 * reach) as f64;
        let (force, model) = (f[i] - mean_n, stiffness * (d[i] - middle_m) + damping * velocity);
        there += force * force;
        modelled += model * model;
        both += force * model;
        taken += force * velocity;
        could += (force * velocity).abs();
    }
    if there == 0.0 || modelled == 0.0 {
        return None;
    }
    let (factor, alike) = ((there / modelled).sqrt(), both / (there * modelled).sqrt());
    // Effects of the model may do what its line does not.
    let fault = if spec.effects.is_empty() && !(1.0 / FAR..FAR).contains(&factor) {
        Fault::Unit(factor)
    } else if alike < -TURNED && taken < -GIVES * could {
        Fault::Sign
    } else {
        return None;
    };
    Some(finding(Role::Force, Role::Displacement, fault))
}

fn is_gravity(factor: f64) -> bool {
    factor.log10().abs() < 2.0
}

/// What is wrong with an answer to a drive, if a sign or unit is.
fn fault(
    drive: &Spectrum,
    per_mass: f64,
    answer: &Spectrum,
    is_acceleration: bool,
    spec: &ModelSpec,
    mass_kg: f64,
) -> Option<Fault> {
    let slopes = spec.isolator.stiffness_n_m.iter().map(|k| (k.max(0.0) / mass_kg).sqrt());
    let (low, high) = slopes.fold((f64::INFINITY, 0.0_f64), |(l, h), w| (l.min(w), h.max(w)));
    let (held, damped) =
        (spec.isolator.stiffness_n_m.first()? / mass_kg, spec.isolator.damping_n_s_m / mass_kg);
    // Whole, and of what is above what the model swings at, where its stiffness does not matter: what is there and in the model, and both.
    let (mut whole, mut above) = ((0.0, 0.0, Complex64::ZERO), (0.0, 0.0, Complex64::ZERO));
    let (mut power, mut could) = (0.0, 0.0);
    for (bin, (u, y)) in drive.bins.iter().zip(&answer.bins).enumerate().skip(4) {
        let w = drive.omega_rad_s(bin);
        let u = u * per_mass;
        let speed = if is_acceleration { y / Complex64::new(0.0, w) } else { y * Complex64::new(0.0, w) };
        power += (u * speed.conj()).re;
        could += u.norm() * speed.norm();
        if w > low / AWAY && w < high * AWAY {
            continue;
        }
        let moved = u / Complex64::new(held - w * w, damped * w);
        let moved = if is_acceleration { moved * -(w * w) } else { moved };
        let add = |sums: &mut (f64, f64, Complex64)| {
            sums.0 += y.norm_sqr();
            sums.1 += moved.norm_sqr();
            sums.2 += y * moved.conj();
        };
        add(&mut whole);
        if w >= high * AWAY {
            add(&mut above);
        }
    }
    let factor = |(there, modelled, both): (f64, f64, Complex64)| {
        let is_alike = both.norm_sqr() > ALIKE * ALIKE * there * modelled;
        let factor = both / modelled;
        (is_alike && factor.im.abs() < SIDEWAYS * factor.re.abs()).then_some(factor.re)
    };
    let near = |size: f64, unit: f64| (1.0 / NEAR..NEAR).contains(&(size / unit));
    let g = STANDARD_GRAVITY_M_S2;
    let of_thousands = factor(whole).and_then(|factor| {
        [1e3, 1e-3, 1e6, 1e-6].into_iter().find(|unit| near(factor.abs(), *unit)).map(Fault::Unit)
    });
    let of_gravity = || {
        let factor = factor(above)?;
        [g, 1.0 / g].into_iter().find(|unit| near(factor.abs(), *unit)).map(Fault::Unit)
    };
    let turned = || {
        let is_turned = match factor(whole) {
            Some(factor) => factor < 0.0 && power < -GIVEN_OFF * could,
            None => power < -PLAINLY * could,
        };
        is_turned.then_some(Fault::Sign)
    };
    of_thousands.or_else(of_gravity).or_else(turned)
}

fn finding(role: Role, input: Role, fault: Fault) -> Finding {
    let channel = role.name();
    let of_model = if role == Role::Force && input == Role::Displacement {
        "the stiffness and damping of the model, which may be what is so far off"
    } else {
        "the mass of the model"
    };
    let other = if role == input { "what answers it".to_owned() } else { input.name().to_owned() };
    let (problem, text, figure) = match fault {
        Fault::Sign => (
            Problem::WrongSign,
            format!("{channel} has the wrong sign against {other}: the specimen would give off energy"),
            -1.0,
        ),
        Fault::Unit(factor) => {
            let times = factor.max(1.0 / factor);
            let times = if times < 100.0 { format!("{times:.5}") } else { format!("{times:.0}") };
            let is_large = (factor > 1.0) == (role != input);
            let what = if is_large { "large" } else { "small" };
            let text =
                format!("{channel} is {times} times too {what} for {other} and {of_model}: wrong unit");
            (Problem::WrongUnit, text, factor)
        }
    };
    Finding::new(Severity::Error, problem, Some(role), text, figure)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::build;
    use crate::model::testing::{effect, oscillator};
    use rand::{SeedableRng, prelude::Distribution};

    const RATE_HZ: f64 = 500.0;

    /// A mass that noise drives.
    fn driven(spec: &ModelSpec, kind: Kind) -> Record {
        let mut random = rand_pcg::Pcg64::seed_from_u64(11);
        let mut specimen = build(spec, 1.0 / RATE_HZ).expect("valid");
        let mut record = Record::empty("driven", kind, RATE_HZ);
        let mut smooth = [0.0; 2];
        for i in 0..20_000 {
            let noise: f64 = rand_distr::StandardNormal.sample(&mut random);
            smooth[0] += 0.3 * (noise - smooth[0]);
            smooth[1] += 0.3 * (smooth[0] - smooth[1]);
            let response = specimen.step(smooth[1]);
            record.time_s.push(f64::from(i) / RATE_HZ);
            if kind == Kind::Base {
                record.table_acceleration_m_s2.push(smooth[1]);
                record.relative_displacement_m.push(response.relative_displacement_m);
            } else {
                record.force_n.push(-spec.mass_kg * smooth[1]);
                record.displacement_m.push(response.relative_displacement_m);
                record.acceleration_m_s2.push(response.mass_acceleration_m_s2 - smooth[1]);
            }
        }
        record
    }

    fn scaled(channel: &[f64], factor: f64) -> Vec<f64> {
        channel.iter().map(|x| factor * x).collect()
    }

    #[test]
    fn a_sign_or_a_unit_is_told_and_a_model_that_is_off_is_not() {
        let truth = oscillator(12.0, 40e3, 60.0);
        let sound = driven(&truth, Kind::Force);
        let alone = |displacement: f64, acceleration: f64| Record {
            displacement_m: scaled(&sound.displacement_m, displacement),
            acceleration_m_s2: scaled(&sound.acceleration_m_s2, acceleration),
            ..sound.clone()
        };
        let only = |record: Record, is_d: bool| match is_d {
            true => Record { acceleration_m_s2: Vec::new(), ..record },
            false => Record { displacement_m: Vec::new(), ..record },
        };
        for model in [truth.clone(), oscillator(12.0, 28e3, 80.0), oscillator(11.0, 52e3, 40.0)] {
            let told = |record: &Record| {
                let found = examine(record, &model);
                assert!(found.len() < 2, "{found:?}");
                found.first().map(|finding| (finding.problem, finding.channel))
            };
            assert_eq!(told(&sound), None);
            assert_eq!(told(&alone(1.05, 0.95)), None);
            let (d, a) = (Some("displacement_m"), Some("acceleration_m_s2"));
            assert_eq!(told(&only(alone(-1.0, 1.0), true)), Some((Problem::WrongSign, d)));
            assert_eq!(told(&only(alone(1.0, -1.0), false)), Some((Problem::WrongSign, a)));
            assert_eq!(told(&only(alone(1e3, 1.0), true)), Some((Problem::WrongUnit, d)));
            assert_eq!(
                told(&only(alone(1.0, 1.0 / STANDARD_GRAVITY_M_S2), false)),
                Some((Problem::WrongUnit, a))
            );
            for (factor, problem) in [(-1.0, Problem::WrongSign), (1e-3, Problem::WrongUnit)] {
                let force_n = scaled(&sound.force_n, factor);
                let record = Record { force_n, ..sound.clone() };
                assert_eq!(told(&record), Some((problem, Some("force_n"))));
            }
            let base = driven(&truth, Kind::Base);
            assert_eq!(told(&base), None);
            let relative_displacement_m = scaled(&base.relative_displacement_m, 1e3);
            let in_mm = Record { relative_displacement_m, ..base.clone() };
            assert_eq!(told(&in_mm), Some((Problem::WrongUnit, Some("relative_displacement_m"))));
            let table_acceleration_m_s2 = scaled(&base.table_acceleration_m_s2, 1.0 / STANDARD_GRAVITY_M_S2);
            let in_g = Record { table_acceleration_m_s2, ..base.clone() };
            assert_eq!(told(&in_g), Some((Problem::WrongUnit, Some("table_acceleration_m_s2"))));
        }
    }

    #[test]
    fn about_its_resonance_a_mass_that_gives_off_energy_has_a_sign_turned() {
        let model = oscillator(12.0, 40e3, 60.0);
        for kind in [Kind::Base, Kind::Force] {
            let mut specimen = build(&model, 1.0 / RATE_HZ).expect("valid");
            let mut record = Record::empty("resonant", kind, RATE_HZ);
            // Steps of a sine from three quarters of its frequency to four thirds.
            let mut turn = 0.0_f64;
            for i in 0..20_000 {
                turn += (0.75 + 0.06 * f64::from(i / 2000)) * (40e3_f64 / 12.0).sqrt() / RATE_HZ;
                let response = specimen.step(turn.sin());
                record.time_s.push(f64::from(i) / RATE_HZ);
                match kind {
                    Kind::Base => {
                        record.table_acceleration_m_s2.push(turn.sin());
                        record.relative_displacement_m.push(response.relative_displacement_m);
                    }
                    _ => {
                        record.force_n.push(-12.0 * turn.sin());
                        record.displacement_m.push(response.relative_displacement_m);
                    }
                }
            }
            assert_eq!(examine(&record, &model), Vec::new());
            record.relative_displacement_m = scaled(&record.relative_displacement_m, -1.0);
            record.force_n = scaled(&record.force_n, -1.0);
            let told: Vec<_> = examine(&record, &model).iter().map(|finding| finding.problem).collect();
            assert_eq!(told, [Problem::WrongSign], "{kind:?}");
        }
    }

    #[test]
    fn a_component_that_gives_off_energy_or_is_of_another_size_by_hundreds_is_told() {
        // Pressed to and fro, with friction that is most of its force, and hardly anything but its spring.
        let of = |friction_n: f64, viscous: f64| {
            let mut record = Record::empty("component", Kind::Component, RATE_HZ);
            for i in 0..4000 {
                let turn = 6.0 * f64::from(i) / RATE_HZ;
                let (d, v) = (0.01 * turn.sin(), 0.06 * turn.cos());
                record.time_s.push(f64::from(i) / RATE_HZ);
                record.displacement_m.push(d);
                record.force_n.push(4e4 * d + viscous * v + friction_n * v.signum());
            }
            record
        };
        let model = oscillator(1.0, 5e4, 900.0);
        for (friction_n, viscous) in [(0.0, 30.0), (0.0, 800.0), (1000.0, 800.0)] {
            let sound = of(friction_n, viscous);
            let told = |force: f64, displacement: f64| {
                let record = Record {
                    force_n: scaled(&sound.force_n, force),
                    displacement_m: scaled(&sound.displacement_m, displacement),
                    ..sound.clone()
                };
                examine(&record, &model).first().map(|finding| finding.problem)
            };
            assert_eq!([told(1.0, 1.0), told(0.1, 1.0), told(10.0, 1.0)], [None; 3]);
            assert_eq!([told(-1.0, 1.0), told(1.0, -1.0)], [Some(Problem::WrongSign); 2]);
            assert_eq!([told(1e-3, 1.0), told(1.0, 1e3)], [Some(Problem::WrongUnit); 2]);
        }
        // What the model does not say: neither a spring that pushes on, nor a mass of its own.
        let mut falling = of(0.0, 800.0);
        falling.force_n.iter_mut().zip(&falling.displacement_m).for_each(|(f, d)| *f -= 8e4 * d);
        assert_eq!(examine(&falling, &model), vec![]);
        let mut heavy = of(0.0, 0.0);
        heavy.force_n.iter_mut().zip(&heavy.displacement_m).for_each(|(f, d)| *f -= 2e5 * d);
        assert_eq!(examine(&heavy, &model), vec![]);
    }

    #[test]
    fn missing_physics_is_neither() {
        let model = oscillator(12.0, 40e3, 60.0);
        for (name, parameters) in [
            ("coulomb-friction", [("fc_n", 30.0)].as_slice()),
            ("cubic-stiffness", &[("k3_n_m3", 1e11)]),
            ("bouc-wen-hysteresis", &[("kh_n_m", 4e5), ("dy_m", 1e-4)]),
        ] {
            let mut truth = model.clone();
            truth.effects.push(effect(name, parameters));
            for kind in [Kind::Force, Kind::Base] {
                let found = examine(&driven(&truth, kind), &model);
                assert!(found.is_empty(), "{name}: {found:?}");
            }
        }
    }
}
