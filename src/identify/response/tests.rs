use super::*;
use crate::diagnose::candidates;
use crate::diagnose::testing::seen;
use crate::identify::kinematics::Tolerances;
use crate::identify::least_squares::Settings;
use crate::model::testing::{b1_g2, effect};
use crate::model::{self, BumperSpec, effects};
use crate::record::Record;
use rand::{SeedableRng, prelude::Distribution};
use std::f64::consts::TAU;

/// The paper's specimen with numbers that are off by what a model file allows.
pub(super) fn off() -> ModelSpec {
    let mut truth = b1_g2();
    truth.isolator.stiffness_n_m[0] *= 1.06;
    truth.isolator.breakpoints_m[0] *= 0.97;
    truth.isolator.damping_n_s_m *= 0.93;
    if let Some(bumper) = &mut truth.bumper {
        bumper.stiffness_n_m *= 1.08;
        bumper.total_gap_m *= 1.015;
    }
    truth
}

pub(super) fn fitted(measured: &Measured<'_>) -> (ModelSpec, Numbers, Laid) {
    let numbers = Numbers::of_base(&b1_g2(), Kind::Base);
    let settings = Settings { iterations: 30, ..Settings::default() };
    let laid = measured.fit(&b1_g2(), &numbers, 0.0, None, settings).expect("fits");
    let mut spec = b1_g2();
    assert!(numbers.put(&laid.values, &mut spec));
    (spec, numbers, laid)
}

/// What the best start of every effect brings to first order, best first.
fn scores(measured: &Measured<'_>, motion: &Motion) -> Vec<(&'static str, f64)> {
    let (spec, numbers, laid) = fitted(measured);
    let tangent = measured.tangent(&spec, &numbers, &laid).expect("linearises");
    let scales = candidates::scales(&spec, motion);
    let best = |e: &&'static effects::Effect| {
        let nats = |start| {
            let mut with = spec.clone();
            with.effects.push(start);
            tangent.score(&with).map(|score| score.nats)
        };
        (e.name, candidates::starts(e, &scales).into_iter().filter_map(nats).fold(0.0, f64::max))
    };
    let mut all: Vec<_> = candidates::physical(&spec).iter().map(best).collect();
    all.sort_by(|a, b| b.1.total_cmp(&a.1));
    all
}

#[test]
fn numbers_that_are_off_are_found_within_their_intervals_and_noise_is_left() {
    let truth = off();
    let motion = Motion::of(&seen(&truth, 11), 500.0, Tolerances::default()).expect("a motion");
    let measured = Measured::new(&motion).expect("a base record");
    let (spec, numbers, laid) = fitted(&measured);
    let left = measured.left(&spec, Part::Training, &laid).expect("finite");
    assert!(left.median < 1.1 && left.excess < 0.01 && left.colour < 1.5, "{left:?}");
    let refit = measured.refit(&spec, &numbers, &laid, left.colour);
    for (j, number) in numbers.numbers.iter().enumerate() {
        let (found, meant) = (laid.values[j], truth.get(&number.key).expect("there"));
        assert!(
            (found - meant).abs() < 4.0 * refit.sigmas[j],
            "{}: {found} {meant} {}",
            number.key,
            refit.sigmas[j]
        );
    }
    // The record tells them, not the priors.
    assert!(refit.sigmas[0] < 0.01 * numbers.free[0].prior.1, "{:?}", refit.sigmas);
    let held_out = measured.judge(&spec, &numbers, &laid).expect("finite");
    assert!(held_out.cost < 1.1 * held_out.count as f64, "{} of {}", held_out.cost, held_out.count);
}

#[test]
fn a_fit_that_leads_to_a_known_place_is_given_up_and_one_that_leads_elsewhere_is_not() {
    let motion = Motion::of(&seen(&off(), 12), 500.0, Tolerances::default()).expect("a motion");
    let measured = Measured::new(&motion).expect("a base record");
    let (_, numbers, laid) = fitted(&measured);
    let settings = Settings { iterations: 30, ..Settings::default() };
    let fit = |known: &Laid| {
        measured.fit_up_to(&b1_g2(), &numbers, (0.0, None), settings, Until::better_than(known))
    };
    assert!(fit(&laid).is_none());
    // A place that is no floor: the first stiffness ten deviations beside it.
    let mut elsewhere = laid.clone();
    let sigma = measured.refit(&b1_g2(), &numbers, &laid, 1.0).sigmas[0];
    elsewhere.values[0] += 10.0 * sigma;
    elsewhere.cost += 100.0;
    let found = fit(&elsewhere).expect("another place");
    assert!((found.total() - laid.total()).abs() < 0.1, "{} {}", found.total(), laid.total());
}

#[test]
fn slow_noise_of_the_displacement_sensor_is_told_from_what_a_model_leaves() {
    let heard = |slow_m: f64| {
        let mut record = seen(&off(), 14);
        let mut random = rand_pcg::Pcg64::seed_from_u64(15);
        // Of first order, with a time constant of 5 s.
        let (decay, mut slow) = ((-1.0 / (5.0 * record.sample_rate_hz)).exp(), 0.0);
        for d in &mut record.relative_displacement_m {
            let step: f64 = rand_distr::StandardNormal.sample(&mut random);
            slow = decay * slow + slow_m * (1.0 - decay * decay).sqrt() * step;
            *d += slow;
        }
        let motion = Motion::of(&record, 500.0, Tolerances::default()).expect("a motion");
        let measured = Measured::new(&motion).expect("a base record");
        let (spec, numbers, laid) = fitted(&measured);
        let held_out = measured.judge(&spec, &numbers, &laid).expect("finite");
        measured.learn_slow_noise(&spec, &numbers, [(Part::Training, &laid), (Part::HeldOut, &held_out)]);
        measured.slow_noise_hz().first().copied().unwrap_or(0.0)
    };
    // Its density is 4 s^2 T / (1 + (w T)^2), that of the white noise 2 s^2 / rate.
    let corner_hz = heard(6e-6);
    assert!((0.5..1.8).contains(&corner_hz), "{corner_hz} where 0.91 is");
    let none_hz = heard(0.0);
    assert!(none_hz < 0.4, "{none_hz}");
}

#[test]
fn to_first_order_nothing_is_missing_from_a_right_model_and_what_is_missing_comes_first() {
    let sound = Motion::of(&seen(&off(), 12), 500.0, Tolerances::default()).expect("a motion");
    let nothing = scores(&Measured::new(&sound).expect("a base record"), &sound);
    assert!(nothing[0].1 < 15.0, "{nothing:?}");
    let mut truth = off();
    truth.effects.push(effect("maxwell-branch", &[("km_n_m", 800.0), ("tau_s", 0.1)]));
    let motion = Motion::of(&seen(&truth, 13), 500.0, Tolerances::default()).expect("a motion");
    let found = scores(&Measured::new(&motion).expect("a base record"), &motion);
    assert!(found[0].0 == "maxwell-branch" && found[0].1 > 40.0, "{found:?}");
}

#[test]
fn a_step_far_off_counts_by_its_logarithm_without_a_corner() {
    let (below, above) = (robust(1.5e3 - 1e-3, 1000), robust(1.5e3 + 1e-3, 1000));
    assert!((below.0 - above.0).abs() < 0.01 && (below.1 - above.1).abs() < 1e-4);
    let (far, slope) = robust(1e6, 1000);
    assert!(far < 12e3 && (slope - 1.5e-3).abs() < 1e-12, "{far} {slope}");
}

#[test]
fn samples_beside_a_jump_do_not_count() {
    let mut acceleration = vec![0.0; 100];
    acceleration[50..].fill(0.2);
    let counts = beside_jumps(&acceleration, 0.007);
    let out: Vec<usize> = (0..100).filter(|n| !counts[*n]).collect();
    assert_eq!(out, (47..=52).collect::<Vec<_>>());
}

#[test]
fn jumps_are_spread_and_what_does_not_jump_stays() {
    use super::jumps::spread_jumps;
    let rate = 2048.0;
    let table = vec![0.0; 40];
    // A smooth motion to fourth order; the ends as they are.
    let w = TAU * 20.0;
    let at = |i: usize| i as f64 / rate;
    let smooth: Vec<(f64, f64)> = (0..40).map(|i| (-w * (w * at(i)).sin(), 0.0)).collect();
    let velocity: Vec<f64> = (0..40).map(|i| (w * at(i)).cos()).collect();
    let mut spread = smooth.clone();
    spread_jumps(&mut spread, &velocity, &table, rate);
    let apart = smooth.iter().zip(&spread).map(|(a, b)| (a.0 - b.0).abs()).fold(0.0, f64::max);
    assert!(apart < 1e-5 * w, "{apart}");
    assert_eq!(spread[1], smooth[1]);
    // A jump of 1 at an instant, in samples: its sample goes over from 0 to 1 by less the less the instant moves.
    let jump = |instant: f64| {
        let mut sampled: Vec<(f64, f64)> = (0..40).map(|i| (f64::from(i as f64 > instant), 0.0)).collect();
        let velocity: Vec<f64> = (0..40).map(|i| (i as f64 - instant).max(0.0) / rate).collect();
        spread_jumps(&mut sampled, &velocity, &table, rate);
        sampled
    };
    for instant in [19.0, 19.3, 19.999] {
        let change = |by: f64| {
            let pairs = jump(instant).into_iter().zip(jump(instant + by));
            pairs.map(|(a, b)| (a.0 - b.0).abs()).fold(0.0, f64::max)
        };
        assert!(change(2e-3) < 3e-3 && change(2e-2) > 5e-3, "{instant}: {} {}", change(2e-3), change(2e-2));
    }
}

#[test]
fn a_springpot_remembers_the_record_before_a_step() {
    let mut truth = b1_g2();
    truth.effects.push(effect("fractional-damping", &[("ca", 2000.0), ("alpha", 0.4)]));
    let record = seen(&truth, 5);
    let motion = Motion::of(&record, 500.0, Tolerances::default()).expect("a base record");
    let measured = Measured::new(&motion).expect("with a laser");
    // The last step's memory is what imposing the whole record leaves, whatever the parameters.
    let window = motion.windows.last().expect("steps");
    let mut other = truth.clone();
    other.set("effect[0].alpha", 0.7).expect("there");
    let mut specimen = model::build(&other, motion.dt_s()).expect("builds");
    for n in 0..window.warm_from {
        specimen.impose(motion.displacement_m[n], motion.velocity_m_s[n]);
    }
    let (whole, kept) = (specimen.memory(), measured.remembered(window));
    assert_eq!(whole.len(), kept.len());
    let size = whole.iter().fold(0.0_f64, |m, x| m.max(x.abs()));
    assert!(whole.iter().zip(kept).all(|(a, b)| (a - b).abs() < 1e-9 * size), "{whole:?} {kept:?}");
    let at = |n: usize| (motion.displacement_m[n], motion.velocity_m_s[n]);
    let forces = |specimen: &mut dyn model::Specimen| -> Vec<f64> {
        (window.warm_from..window.warm_from + 50)
            .map(|n| specimen.impose(at(n).0, at(n).1).mass_acceleration_m_s2)
            .collect()
    };
    let whole = forces(&mut *specimen);
    specimen.reset();
    specimen.recall(kept, at(window.warm_from - 1));
    assert_eq!(specimen.memory(), kept);
    // The mass goes on from where it was: from rest it jumped there, and the springpot remembered the jump.
    let size = whole.iter().fold(0.0_f64, |m, x| m.max(x.abs()));
    for (whole, resumed) in whole.iter().zip(forces(&mut *specimen)) {
        assert!((whole - resumed).abs() < 1e-9 * size, "{whole} {resumed}");
    }
}

#[test]
fn a_hysteresis_is_told_of_the_reversals_before_a_step() {
    let mut truth = b1_g2();
    let iwan = [("kp_n_m", 4e3), ("exponent", -0.3), ("yield_min_m", 2e-4), ("yield_max_m", 1e-2)];
    truth.effects.push(effect("iwan-hysteresis", &iwan));
    let motion = Motion::of(&seen(&truth, 21), 500.0, Tolerances::default()).expect("a motion");
    let mut specimen = model::build(&truth, motion.dt_s()).expect("builds");
    let window = motion.windows.last().expect("steps");
    let first = window.warm_from;
    let at = |n: usize| (motion.displacement_m[n], motion.velocity_m_s[n]);
    let whole: Vec<f64> =
        (0..window.range.start).map(|n| specimen.impose(at(n).0, at(n).1).mass_acceleration_m_s2).collect();
    let mut apart = |retraced: bool| {
        specimen.reset();
        if retraced {
            motion.retrace(specimen.as_mut(), window, first, 0.0);
        }
        let after = |n: usize| (specimen.impose(at(n).0, at(n).1).mass_acceleration_m_s2 - whole[n]).abs();
        (first..window.range.start).map(after).fold(0.0, f64::max)
    };
    // What is left of it is that noise turned the motion, too.
    let (retraced, from_the_middle) = (apart(true), apart(false));
    assert!(retraced < 1e-3 && from_the_middle > 1e-2, "{retraced} {from_the_middle} m/s2");
}

#[test]
fn tips_that_creep_back_have_come_to_where_they_are_before_a_step() {
    let mut truth = b1_g2();
    truth.effects.push(effect("hertz-contact", &[("kh", 3e9), ("n", 3.0)]));
    let motion = Motion::of(&seen(&truth, 24), 500.0, Tolerances::default()).expect("a motion");
    let measured = Measured::new(&motion).expect("a base record");
    let cost = |spec: &ModelSpec| {
        let (numbers, settings) = (Numbers::default(), Settings::default());
        measured.fit(spec, &numbers, 0.0, None, settings).expect("laid").cost
    };
    // Beside a state that does nothing, all of the cycles before a step are gone through.
    let mut from_farther_back = truth.clone();
    from_farther_back.effects.push(effect("maxwell-branch", &[("km_n_m", 1e-9), ("tau_s", 0.1)]));
    let (cost, farther_back) = (cost(&truth), cost(&from_farther_back));
    assert!((cost - farther_back).abs() < 2.0, "{cost} {farther_back}");
}

#[test]
fn jumps_that_a_wrong_model_told_are_told_anew_by_a_better_one() {
    let mut truth = b1_g2();
    truth.effects.push(effect("hertz-contact", &[("kh", 1.2e5), ("n", 1.3)]));
    let motion = Motion::of(&seen(&truth, 25), 500.0, Tolerances::default()).expect("a motion");
    let told = |models: &[&ModelSpec]| {
        let measured = Measured::new(&motion).expect("a base record");
        let others = models.iter().map(|spec| {
            let of = |part: Part| {
                let laid = measured.fit(spec, &Numbers::default(), 0.0, None, Settings::default());
                let laid = laid.expect("laid");
                if part == Part::HeldOut {
                    measured.judge(spec, &Numbers::default(), &laid)
                } else {
                    Some(laid)
                }
            };
            let [training, held_out] = [Part::Training, Part::HeldOut].map(|part| of(part).expect("laid"));
            measured.learn_jumps(spec, [(Part::Training, &training), (Part::HeldOut, &held_out)])
        });
        (others.collect::<Vec<bool>>(), measured.counts())
    };
    let (others, anew) = told(&[&b1_g2(), &truth, &truth]);
    assert_eq!(others, [true, true, false], "told once more where they are elsewhere alone");
    assert_eq!(anew, told(&[&truth]).1);
    assert_ne!(anew, told(&[&b1_g2()]).1);
}

#[test]
fn what_noise_leaves_of_structure_is_what_chance_gives_it() {
    let of = |seed: u64| {
        let motion = Motion::of(&seen(&b1_g2(), seed), 500.0, Tolerances::default()).expect("a motion");
        let measured = Measured::new(&motion).expect("a base record");
        let laid = measured.fit(&b1_g2(), &Numbers::default(), 0.0, None, Settings::default()).expect("laid");
        let Left { excess, chance, .. } = measured.left(&b1_g2(), Part::Training, &laid).expect("finite");
        // Steps count alike, of fewer samples each than all have together.
        assert!(chance > 1.05 / (laid.count as f64).sqrt(), "{chance} of {}", laid.count);
        excess / chance
    };
    let deviations: Vec<f64> = (50..62).map(of).collect();
    let squares = deviations.iter().map(|x| x * x).sum::<f64>() / deviations.len() as f64;
    // Half of them are below zero, which is none.
    assert!((0.1..1.2).contains(&squares), "{deviations:?}");
}

#[test]
fn along_a_number_that_the_record_tells_the_profile_says_what_the_curvature_does_and_finds_a_better_place() {
    let mut truth = b1_g2();
    truth.effects.push(effect("quadratic-damping", &[("c2_n_s2_m2", 400.0)]));
    let motion = Motion::of(&seen(&truth, 17), 500.0, Tolerances::default()).expect("a motion");
    let measured = Measured::new(&motion).expect("a base record");
    let mut start = b1_g2();
    start.effects.push(effect("quadratic-damping", &[("c2_n_s2_m2", 300.0)]));
    let mut numbers = Numbers::of_base(&start, Kind::Base);
    numbers.add_effect(&start, 0, &candidates::scales(&start, &motion));
    let j = numbers.numbers.len() - 1;
    let fit = |iterations| {
        let settings = Settings { iterations, ..Settings::default() };
        measured.fit(&start, &numbers, 0.0, None, settings).expect("fits")
    };
    let arrived = fit(30);
    let profile = measured.profile(&start, &numbers, &arrived, 1.0);
    assert!(profile.better.is_none());
    let (low, high) = profile.limits[j];
    let sigma = measured.refit(&start, &numbers, &arrived, 1.0).sigmas[j];
    assert!(low < 400.0 && 400.0 < high, "{low} {high}");
    for half in [arrived.values[j] - low, high - arrived.values[j]] {
        assert!((0.99..1.2).contains(&(half / (1.96 * sigma))), "{half} {sigma}");
    }
    // From where a fit has not begun it comes upon a better place.
    let better = measured.profile(&start, &numbers, &fit(0), 1.0).better.expect("a better place");
    assert!(better.total() < fit(0).total() - 2.0);
}

#[test]
fn a_fit_with_the_general_solver_mostly_ends_in_the_same_place_from_wherever_it_starts() {
    let mut truth = off();
    truth.effects.push(effect("cubic-stiffness", &[("k3_n_m3", 3e6)]));
    let apart = |seed: u64| {
        let motion = Motion::of(&seen(&truth, seed), 500.0, Tolerances::default()).expect("a motion");
        let measured = Measured::new(&motion).expect("a base record");
        let mut faint = b1_g2();
        faint.effects.push(effect("cubic-stiffness", &[("k3_n_m3", 1e5)]));
        let mut numbers = Numbers::of_base(&b1_g2(), Kind::Base);
        numbers.add_effect(&faint, 0, &candidates::scales(&faint, &motion));
        let [there, here] = [&faint, &truth].map(|start| {
            let mut numbers = numbers.clone();
            numbers.start_from(start);
            let settings = Settings { iterations: 30, ..Settings::default() };
            let laid = measured.fit(start, &numbers, 0.0, None, settings).expect("fits");
            measured.refit(start, &numbers, &laid, 1.0)
        });
        let deviations = there.fit.values.iter().zip(&here.fit.values).zip(&here.sigmas);
        deviations.map(|((a, b), sigma)| ((a - b) / sigma).abs()).fold(0.0, f64::max)
    };
    // Where jumps are clipped the cost is rough: most fits end some tenth of a deviation apart, now and then one ends beside.
    let mut worst: Vec<f64> = (16..24).map(apart).collect();
    worst.sort_by(f64::total_cmp);
    assert!(worst[5] < 0.2, "deviations apart: {worst:?}");
}

#[test]
fn what_changes_a_short_contact_as_a_whole_is_a_slope() {
    let mut truth = off();
    truth.bumper = Some(BumperSpec { stiffness_n_m: 650e3, damping_n_s_m: 1400.0, total_gap_m: 0.03 });
    truth.effects.push(effect("quadratic-damping", &[("c2_n_s2_m2", 300.0)]));
    let motion = Motion::of(&seen(&truth, 26), 500.0, Tolerances::default()).expect("a motion");
    let measured = Measured::new(&motion).expect("a base record");
    let mut numbers = Numbers::of_base(&truth, Kind::Base);
    numbers.add_effect(&truth, 0, &candidates::scales(&truth, &motion));
    numbers.start_from(&truth);
    let settings = Settings { iterations: 30, ..Settings::default() };
    let fit = || measured.fit(&truth, &numbers, 0.0, None, settings).expect("fits");
    let laid = fit();
    let held_out = measured.judge(&truth, &numbers, &laid).expect("finite");
    measured.learn_jumps(&truth, [(Part::Training, &laid), (Part::HeldOut, &held_out)]);
    let arrived = fit();
    // Where contacts pass for jumps that go over a sample, it promises 1.3 and comes no farther.
    assert!(arrived.promised() < 0.1, "{}", arrived.promised());
}

/// A mass between damped bumpers, driven by waves of force and seen by its acceleration alone.
fn felt_between_bumpers(spec: &ModelSpec, seed: u64) -> Record {
    const RATE_HZ: f64 = 280.0;
    const SAMPLES: usize = 8000;
    let mut random = rand_pcg::Pcg64::seed_from_u64(seed);
    let mut uniform = |to: f64| to * rand_distr::Uniform::new(0.0, 1.0).expect("valid").sample(&mut random);
    let waves: Vec<(f64, f64)> = (0..60).map(|_| (TAU * (0.4 + uniform(9.0)), uniform(TAU))).collect();
    let force = |n: usize| {
        let t = n as f64 / RATE_HZ;
        0.008 * waves.iter().map(|(w, phase)| (w * t + phase).sin()).sum::<f64>()
    };
    let mut normal = |sigma: f64| {
        let deviate: f64 = rand_distr::StandardNormal.sample(&mut random);
        sigma * deviate
    };
    let mut record = Record::empty("felt", Kind::Force, RATE_HZ);
    let mut specimen = model::build(spec, 1.0 / RATE_HZ).expect("builds");
    for n in 0..SAMPLES {
        let table = -force(n) / spec.mass_kg;
        let seen = specimen.step(table).mass_acceleration_m_s2 - table;
        record.time_s.push(n as f64 / RATE_HZ);
        record.force_n.push(force(n) + normal(6e-5));
        record.acceleration_m_s2.push(seen + normal(1e-3));
    }
    record
}

#[test]
fn a_step_whose_start_is_hardly_known_does_not_stay_on_the_wrong_side_of_a_contact() {
    let spec: ModelSpec = toml::from_str(
        "name = 'felt'\nmass_kg = 0.86\n[isolator]\nstiffness_n_m = [510.0]\nbreakpoints_m = []\ndamping_n_s_m = 2.1\n\
         [bumper]\nstiffness_n_m = 3000.0\ndamping_n_s_m = 10.0\ntotal_gap_m = 2.4e-4\n",
    )
    .expect("a model");
    let mut motion =
        Motion::of(&felt_between_bumpers(&spec, 15), 500.0, Tolerances::default()).expect("a motion");
    // One step starts so that every slope leads away; it is one of training first, one of those held out then.
    for _ in 0..2 {
        let measured = Measured::new(&motion).expect("driven");
        let numbers = Numbers::of_base(&spec, Kind::Force);
        let laid = measured.fit(&spec, &numbers, 0.0, None, Settings::default()).expect("fits");
        let held_out = measured.judge(&spec, &numbers, &laid).expect("finite");
        for (part, laid) in [("training", &laid), ("held out", &held_out)] {
            let over = laid.cost / laid.count as f64;
            assert!((0.05..0.15).contains(&over), "{part}: {over} of what is least taken for noise");
        }
        motion.windows.iter_mut().for_each(|window| window.held_out = !window.held_out);
    }
}

#[test]
fn a_blow_moves_a_mass_alike_in_both_solvers() {
    let spec: ModelSpec = toml::from_str(
        "name = 'struck'\nmass_kg = 10.0\n[isolator]\nstiffness_n_m = [6317.0]\nbreakpoints_m = []\ndamping_n_s_m = 5.0\n",
    )
    .expect("a model");
    let mut record = Record::empty("struck", Kind::Force, 2000.0);
    let mut specimen = model::build(&spec, 1.0 / 2000.0).expect("builds");
    let mut random = rand_pcg::Pcg64::seed_from_u64(2);
    for n in 0..20_000 {
        // Twelve milliseconds of every second.
        let force =
            if n % 2000 < 24 { 200.0 * (1.0 - (TAU * f64::from(n % 2000) / 24.0).cos()) } else { 0.0 };
        let response = specimen.step(-force / 10.0);
        let normal: f64 = rand_distr::StandardNormal.sample(&mut random);
        record.time_s.push(f64::from(n) / 2000.0);
        record.force_n.push(force + 1e-2 * normal);
        record.displacement_m.push(response.relative_displacement_m + 1e-6 * normal);
    }
    let motion = Motion::of(&record, 10.0, Tolerances::default()).expect("a motion");
    let measured = Measured::new(&motion).expect("driven");
    let mut general = spec.clone();
    general.effects.push(effect("quadratic-damping", &[("c2_n_s2_m2", 0.0)]));
    let numbers = Numbers::default();
    let free = measured.free(&numbers, 0.0);
    let values: Vec<f64> = free.iter().map(|f| f.start).collect();
    let simulate = |spec: &ModelSpec| -> Vec<f64> {
        let (_, steps) =
            measured.lay(spec, Part::Training, &values, &measured.still(Part::Training)).expect("finite");
        steps.iter().flat_map(|step| step.simulated.iter().map(|(_, d)| *d)).collect()
    };
    let (exact, general) = (simulate(&spec), simulate(&general));
    let apart = exact.iter().zip(&general).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
    let largest = exact.iter().fold(0.0_f64, |top, d| top.max(d.abs()));
    assert!(apart < 1e-6 * largest, "{apart} m of {largest}");
}

#[test]
fn a_line_rises_alike_at_its_ends() {
    let line: Simulated = (0..5).map(|i| (3.0 * f64::from(i), -2.0 * f64::from(i))).collect();
    (0..5).for_each(|i| assert_eq!(slopes(|i| line[i], line.len(), i), (3.0, -2.0), "{i}"));
    assert_eq!(slopes(|i| line[i], 1, 0), (0.0, 0.0));
}
