//! Every effect on its own, against what its equation says in closed form.

use super::*;
use crate::model::build;
use crate::model::testing::{b1_g2, effect, oscillator};

const DT: f64 = 1.0 / 2048.0;

#[test]
fn every_effect_builds_with_its_starting_values_and_moves_finitely() {
    for entry in CATALOGUE.iter().filter(|entry| entry.name != "expression") {
        let mut spec = b1_g2();
        spec.effects.push(entry.starting_spec(&Scales::of_spec(&spec, DT)));
        let mut specimen = build(&spec, DT).unwrap_or_else(|error| panic!("{}: {error}", entry.name));
        let mut largest = 0.0_f64;
        for i in 0..8192 {
            let a = 0.5 * (std::f64::consts::TAU * f64::from(i) * DT).sin();
            largest = largest.max(specimen.step(a).relative_displacement_m.abs());
        }
        assert!(largest > 1e-3 && largest < 0.1, "{}: {largest}", entry.name);
    }
}

#[test]
fn names_and_parameters_are_unique_and_complete() {
    let scales = Scales::of_spec(&b1_g2(), DT);
    for (i, entry) in CATALOGUE.iter().enumerate() {
        assert!(CATALOGUE[..i].iter().all(|other| other.name != entry.name));
        for p in (entry.parameters)(&scales) {
            assert!(
                p.prior.0 < p.prior.1 && p.prior.0 <= p.start && p.start <= p.prior.1,
                "{} {}",
                entry.name,
                p.name
            );
        }
    }
}

#[test]
fn dry_friction_decays_linearly_and_sticks() {
    // Den Hartog: the amplitude falls by 4 Fc/k a cycle.
    let (m, k, fc) = (2.0, 800.0, 4.0);
    let mut spec = oscillator(m, k, 0.0);
    spec.effects.push(effect("coulomb-friction", &[("fc_n", fc)]));
    let mut specimen = build(&spec, DT).expect("builds");
    specimen.impose(0.0, 2.0);
    specimen.prime(0.0);
    let (mut peaks, mut last) = (Vec::new(), 2.0);
    let mut end = crate::model::Response::default();
    for _ in 0..8192 {
        end = specimen.step(0.0);
        if end.relative_velocity_m_s * last < 0.0 && !end.regime.sticking {
            peaks.push(end.relative_displacement_m.abs());
        }
        if end.relative_velocity_m_s != 0.0 {
            last = end.relative_velocity_m_s;
        }
    }
    assert!(peaks.len() > 5);
    for pair in peaks.windows(2) {
        assert!((pair[0] - pair[1] - 2.0 * fc / k).abs() < 2e-5, "{pair:?}");
    }
    assert!(
        end.regime.sticking
            && end.relative_velocity_m_s == 0.0
            && end.relative_displacement_m.abs() <= fc / k
    );
}
