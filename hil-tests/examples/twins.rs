//! Study of the next test: records on which two effects are told apart badly, the test that the diagnosis proposes done on the same
//! specimen, all records diagnosed together; the same with tests chosen at random among those the rig can do. One line a case
//! (tab separated) and a summary. Never quote seeds that were developed on.
//!
//! `cargo run --release -p hil-tests --example twins -- --seeds 1000..1040 --size 0.02`

use hil_tests::arguments;
use hil_tests::hidden::{self, Hidden, Recipe};
use rand::{Rng, SeedableRng};
use rand_pcg::Pcg64;
use shaketable::diagnose::next_test::{self, Reach, SweepProposal};
use shaketable::diagnose::{Diagnosis, Options, Verdict, candidates, diagnose_together};

/// Tests that are added at most.
const ADDED: usize = 2;

/// Effects that another one looks like on a single record.
fn twins() -> Vec<&'static str> {
    candidates::TWINS.concat()
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let (mut seeds, mut size, mut only, mut at_random, mut tell) = (0..20u64, 0.02, None, true, false);
    arguments::each(std::env::args().skip(1), |word, value| {
        match word {
            "--seeds" => seeds = arguments::seeds(&value)?,
            "--size" => size = value.parse()?,
            "--told" => tell = value.parse()?,
            "--random" => at_random = value.parse()?,
            "--only" => {
                let twin = twins().into_iter().find(|name| *name == value);
                only = Some(twin.ok_or_else(|| format!("{value} is none of {}", twins().join(", ")))?);
            }
            _ => return Ok(false),
        }
        Ok(true)
    })?;
    let (mut cases, mut ambiguous, mut proposed, mut random) = (0, 0, 0, 0);
    for seed in seeds {
        let effect = only.unwrap_or_else(|| twins()[seed as usize % twins().len()]);
        let Some(case) = hidden::make(&Recipe::of(seed, &[effect], size)) else {
            println!("{seed}\t{effect}\tnot reached");
            continue;
        };
        cases += 1;
        let found = together(&[&case])?;
        if found.verdict != Verdict::Ambiguous {
            println!("{seed}\t{effect}\t{}", told(&found));
            continue;
        }
        ambiguous += 1;
        let first = told(&found);
        let (by_proposal, of_proposal) = decided(&case, effect, found.clone(), seed, tell, |found, _| {
            found.next_test.as_ref().and_then(|test| test.sweep.clone())
        })?;
        let mut dice = Pcg64::seed_from_u64(seed ^ 0xd1ce);
        let (by_chance, of_chance) = if at_random {
            decided(&case, effect, found, seed, tell, |_, case| {
                let all = next_test::possible(&case.nominal, &reach(case));
                Some(all[dice.random_range(0..all.len())].clone())
            })?
        } else {
            (false, " not asked".to_owned())
        };
        proposed += usize::from(by_proposal);
        random += usize::from(by_chance);
        println!("{seed}\t{effect}\t{first}\tproposed: {of_proposal}\tat random: {of_chance}");
    }
    println!(
        "{cases} cases, {ambiguous} ambiguous; decided rightly in at most {ADDED} added tests: {proposed} as proposed, {random} at random"
    );
    Ok(())
}

fn together(cases: &[&Hidden]) -> Result<Diagnosis, Box<dyn std::error::Error>> {
    let tests: Vec<_> = cases.iter().map(|case| (&case.record, &case.nominal)).collect();
    Ok(diagnose_together(&tests, &Options::default())?)
}

/// Adds tests until the verdict names one effect; whether it is the right one, and how it went.
fn decided(
    case: &Hidden,
    effect: &str,
    mut found: Diagnosis,
    seed: u64,
    tell: bool,
    mut choose: impl FnMut(&Diagnosis, &Hidden) -> Option<SweepProposal>,
) -> Result<(bool, String), Box<dyn std::error::Error>> {
    let mut way = String::new();
    let mut added: Vec<Hidden> = Vec::new();
    while added.len() < ADDED && found.verdict == Verdict::Ambiguous {
        let Some(test) = choose(&found, case) else {
            way += " (no sweep proposed)";
            break;
        };
        way += &format!(
            " [{:.2}-{:.2} Hz {:.3} g{}{}]",
            test.start_hz,
            test.stop_hz,
            test.acceleration_g,
            if test.without_bumpers { ", no bumpers" } else { "" },
            test.total_gap_m.map_or_else(String::new, |gap| format!(", gap {:.1} mm", 1e3 * gap)),
        );
        let Some(again) = hidden::tested(case, &test, seed ^ (0xadd + added.len() as u64)) else {
            way += " (no response)";
            break;
        };
        added.push(again);
        let all: Vec<&Hidden> = std::iter::once(case).chain(&added).collect();
        found = together(&all)?;
        if tell {
            found.refused.iter().for_each(|refused| println!("\t\t{}: {}", refused.name, refused.reason));
        }
        way += &format!(" {}", told(&found));
    }
    let right = found.verdict == Verdict::Missing && found.effects.first().is_some_and(|e| e.name == effect);
    Ok((right, way))
}

fn told(found: &Diagnosis) -> String {
    let named: Vec<&str> = found.effects.iter().map(|effect| effect.name.as_str()).collect();
    let next = found.next_test.as_ref().map_or_else(String::new, |test| {
        format!(
            " (next: {:.1} nats expected, {:.2} times the noise)",
            test.expected_nats, test.expected_discrimination
        )
    });
    format!("{} [{}] ~[{}]{next}", found.verdict.name(), named.join(", "), found.ambiguous_with.join(", "))
}

/// What the rig of the study can do.
fn reach(case: &Hidden) -> Reach {
    let table = &case.record.table_acceleration_m_s2;
    let rms = (table.iter().map(|a| a * a).sum::<f64>() / table.len() as f64).sqrt();
    let (stroke_m, velocity_m_s, acceleration_m_s2) = next_test::PAPERS_TABLE;
    Reach {
        stroke_m,
        velocity_m_s,
        acceleration_m_s2,
        tried_m_s2: rms * 2f64.sqrt(),
        tried_hz: (0.6, 3.75),
        noise_m_s2: 0.01,
        laser_noise_m: 30e-6,
        rate_hz: case.record.sample_rate_hz,
    }
}
