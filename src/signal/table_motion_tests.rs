//! The motion stays as it is, the noise goes where the displacement is quiet; what does not agree is left alone.

use super::*;
use crate::signal::LowPass;
use rand::{Rng, SeedableRng};
use rand_distr::StandardNormal;

const RATE_HZ: f64 = 2048.0;
const NOISE: TableNoise = TableNoise { displacement_m: 1e-5, acceleration_m_s2: 0.01 };
const SAMPLES: usize = 40 * 2048;

/// Displacement and acceleration of a table that starts from rest, sweeps from 0.6 to 4.6 Hz and is kicked at 25 Hz now and then.
fn motion() -> (Vec<f64>, Vec<f64>) {
    let at = |i: usize| {
        let t = i as f64 / RATE_HZ;
        let start = t.min(2.0) / 2.0;
        let envelope = start.powi(3) * (10.0 - 15.0 * start + 6.0 * start * start);
        let since = t % 1.7;
        let blow = 3e-5 * since * (-12.0 * since).exp() * (TAU * 25.0 * since).sin();
        envelope * (0.4 / (TAU * (0.6 + 0.1 * t)).powi(2) * (TAU * (0.6 + 0.05 * t) * t).sin() + blow)
    };
    let x: Vec<f64> = (0..SAMPLES + 4).map(at).collect();
    // Second difference of fourth order.
    let of = |x: &[f64]| (-x[0] + 16.0 * x[1] - 30.0 * x[2] + 16.0 * x[3] - x[4]) / 12.0 * RATE_HZ * RATE_HZ;
    (x[2..SAMPLES + 2].to_vec(), x.windows(5).map(of).collect())
}

/// Both channels with the noise of their sensors and a zero of the accelerometer.
fn measured(seed: u64) -> (Vec<f64>, Vec<f64>) {
    let random = &mut rand_pcg::Pcg64::seed_from_u64(seed);
    let mut noise = |rms: f64| rms * random.sample::<f64, _>(StandardNormal);
    let (x, a) = motion();
    let x = x.iter().map(|x| x + 0.01 + noise(NOISE.displacement_m)).collect();
    (x, a.iter().map(|a| a + 0.015 + noise(NOISE.acceleration_m_s2)).collect())
}

fn live(x: &[f64], a: &[f64]) -> Vec<f64> {
    let mut table = TableMotion::new(RATE_HZ, NOISE);
    x.iter().zip(a).enumerate().map(|(i, (x, a))| table.process(i as u64, *x, *a)).collect()
}

/// RMS of a difference from the fifth second on, below `corner_hz`.
fn apart(one: &[f64], two: &[f64], corner_hz: f64) -> f64 {
    let mut low = LowPass::new(corner_hz, RATE_HZ);
    let square = one.iter().zip(two).map(|(a, b)| low.process(a - b).powi(2));
    (square.skip(5 * 2048).sum::<f64>() / (SAMPLES - 5 * 2048) as f64).sqrt()
}

#[test]
fn a_motion_without_noise_is_left_as_it_is() {
    let (x, a) = motion();
    let found = table_acceleration(&x, &a, RATE_HZ).expect("agrees");
    let rms = apart(&a, &[0.0; SAMPLES], 900.0);
    for (way, found) in [("whole", found), ("live", live(&x, &a))] {
        let off = apart(&found, &a, 900.0);
        assert!(rms > 0.25 && off < 1e-4 * rms, "{way}: {off} of {rms} m/s2");
    }
}

#[test]
fn noise_and_zero_go_where_the_displacement_is_quiet() {
    let ((x, a), (_, truth)) = (measured(1), motion());
    let raw = apart(&a.iter().map(|a| a - 0.015).collect::<Vec<_>>(), &truth, 0.7);
    let found = table_acceleration(&x, &a, RATE_HZ).expect("agrees");
    for (way, found) in [("whole", found), ("live", live(&x, &a))] {
        let off = apart(&found, &truth, 0.7);
        assert!(off < raw / 5.0, "{way}: {off} of {raw} m/s2");
        // Nowhere does it bring more than the displacement may.
        let all = apart(&found, &truth, 900.0);
        assert!(all < 1.4 * NOISE.acceleration_m_s2, "{way}: {all} m/s2");
    }
}

#[test]
fn the_accelerometer_stays_the_gauge() {
    let ((x, a), (_, truth)) = (measured(2), motion());
    // Two per cent too much, 1.5 ms late.
    let late = |i: usize| x[i.saturating_sub(3)];
    let off: Vec<f64> = (0..SAMPLES).map(|i| 1.02 * (late(i) - 0.01)).collect();
    let raw = apart(&a.iter().map(|a| a - 0.015).collect::<Vec<_>>(), &truth, 0.7);
    let found = table_acceleration(&off, &a, RATE_HZ).expect("agrees but for gain and delay");
    let near = apart(&found, &truth, 0.7);
    assert!(near < raw / 3.0, "{near} of {raw} m/s2");
    let noise = TableNoise::of(&off, &a);
    let (_, agreement) = agreed(&off, &a, RATE_HZ, noise).expect("agrees");
    // The second order of the lateness looks like a gain: 0.3 % at 8 Hz.
    assert!((agreement.gain - 0.02).abs() < 1e-3, "{agreement:?}");
    assert!((agreement.delay_s + 3.0 / RATE_HZ).abs() < 5e-5, "{agreement:?}");
    // On board nothing is known at the beginning.
    assert!(apart(&live(&off, &a), &truth, 0.7) < raw);
}

#[test]
fn a_displacement_that_does_not_go_with_it_is_left_alone() {
    let (x, a) = measured(3);
    let n = SAMPLES;
    let still = vec![x[0]; n];
    let millimetres: Vec<f64> = x.iter().map(|x| 1e3 * x).collect();
    let reversed: Vec<f64> = x.iter().map(|x| -x).collect();
    let other: Vec<f64> = (0..n).map(|i| 1e-3 * (TAU * 3.3 * i as f64 / RATE_HZ).sin()).collect();
    for (what, x) in [("still", still), ("mm", millimetres), ("reversed", reversed), ("other", other)] {
        assert!(table_acceleration(&x, &a, RATE_HZ).is_none(), "{what}");
        let found = live(&x, &a);
        assert_eq!(found[5 * 2048..], a[5 * 2048..], "{what}");
    }
    assert!(table_acceleration(&[], &a, RATE_HZ).is_none());
    assert!(table_acceleration(&[f64::NAN; 10], &[0.0; 10], RATE_HZ).is_none());
}

#[test]
fn the_noise_of_the_sensors_is_told_in_spite_of_motion_and_blows() {
    let (x, a) = measured(4);
    let found = TableNoise::of(&x, &a);
    assert!((found.displacement_m / NOISE.displacement_m - 1.0).abs() < 0.05, "{found:?}");
    assert!((found.acceleration_m_s2 / NOISE.acceleration_m_s2 - 1.0).abs() < 0.05, "{found:?}");
}

#[test]
fn a_record_that_begins_in_motion_brings_no_blow() {
    let (x, a) = motion();
    let from = 10 * 2048 + 300;
    let found = table_acceleration(&x[from..], &a[from..], RATE_HZ).expect("agrees");
    let worst = found.iter().zip(&a[from..]).map(|(one, two)| (one - two).abs()).fold(0.0, f64::max);
    assert!(worst < 0.01, "{worst} m/s2");
}

#[test]
fn lost_samples_and_no_numbers_leave_no_trace() {
    let (x, a) = motion();
    let mut table = TableMotion::new(RATE_HZ, NOISE);
    let (mut worst, mut told) = (0.0_f64, 0);
    for i in 0..SAMPLES {
        if i % 10_000 > 9_900 && i % 10_000 < 9_934 {
            continue;
        }
        if i % 7_000 == 6_000 {
            assert!(table.process(i as u64, x[i], f64::NAN).is_nan());
            assert_eq!(table.process(i as u64, f64::NAN, a[i]), a[i]);
            told += 1;
            continue;
        }
        worst = worst.max((table.process(i as u64, x[i], a[i]) - a[i]).abs());
    }
    assert!(told > 5 && worst < 0.02, "{worst} m/s2");
}

#[test]
fn a_low_sampling_rate_keeps_the_motion() {
    let (x, a) = motion();
    let (x, a): (Vec<f64>, Vec<f64>) = x.into_iter().zip(a).step_by(16).unzip();
    let found = table_acceleration(&x, &a, RATE_HZ / 16.0).expect("agrees");
    let square = |x: &mut dyn Iterator<Item = f64>| x.map(|x| x * x).sum::<f64>();
    let off = square(&mut found.iter().zip(&a).map(|(one, two)| one - two));
    assert!(off < 1e-6 * square(&mut a.iter().copied()));
}
