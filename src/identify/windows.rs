//! Where a record is steady: the stretches that models are laid against.

use super::motion::{Motion, Window};
use crate::model::elementary::sin_cos;
use crate::record::{Kind, Record};
use crate::signal::{cycles_hz, step_cycles_hz};
use realfft::num_complex::Complex64;
use std::f64::consts::TAU;
use std::ops::Range;

/// Steady steps below which a record is cut into equal parts.
const FEWEST_STEPS: usize = 4;
/// Samples of a record above which it is a whole sweep.
pub(super) const VERY_LONG: usize = 720_000;
/// Cycles of a step that count, fewer of a whole sweep, and that warm it up.
const COUNTED: f64 = 4.0;
const FEWEST_COUNTED: f64 = 2.0;
const WARM: f64 = 3.0;
/// Cycles that count at most in each part of a record of an applied force without steps.
const CYCLES_OF_A_PART: f64 = 10.0;
/// So many at most, where they are as steady, in records of no more samples than it takes to keep a diagnosis short; they become
/// fewer with the length of the record.
const MOST: f64 = 8.0;
const SHORT: f64 = 180_000.0;
/// A cycle is as steady as the last ones when input and displacement differ from them by no more than that, relative.
const STEADY: f64 = 0.02;
/// How much farther than in any steady stretch the mass goes elsewhere when that is looked at, too; cycles before and after.
const FARTHER: f64 = 1.02;
const AROUND: (f64, f64) = (1.0, 2.0);
/// Times its share of the force's power that a stretch holds in which the mass is struck, and how many of those are divided among fit and judgement.
const STRUCK: f64 = 3.0;
const FEWEST_STRUCK: usize = 3;
/// How much farther than in every other step the mass goes in one that the fit is to see.
const BY_FAR: f64 = 1.1;

/// Steady stretches: the later part of each step in whole cycles, or the record in equal parts; and where the mass goes farthest, if asked.
/// A component answers what is imposed on it whether that is steady or not: its record is cut into equal parts, and none of it is left out.
pub(super) fn cut(record: &Record, motion: &Motion, with_farthest: bool) -> Vec<Window> {
    let n = motion.displacement_m.len();
    let mut windows = Vec::new();
    if record.step.len() == n && motion.kind != Kind::Component {
        let of_step = |(step, range)| steady(step, range, motion);
        windows = record.step_ranges().into_iter().filter_map(of_step).collect();
    }
    // A few long stretches leave none to judge by: they are cut into parts instead.
    if windows.len() < FEWEST_STEPS {
        windows = equal_parts(n, motion);
    }
    let settles = with_farthest && record.step.len() == n && motion.kind == Kind::Base;
    let farthest = if settles { farthest(record, motion, &windows) } else { None };
    let judging = with_struck(motion, &windows, judging(motion, &windows));
    for (i, window) in windows.iter_mut().enumerate() {
        // The fit sees how it settles.
        window.held_out = judging.contains(&i) && farthest.as_ref().is_none_or(|f| f.step != window.step);
    }
    windows.extend(farthest);
    windows.sort_by_key(|window| window.range.start);
    windows
}

/// Stretches of a record of an applied force without steps that hold so many times their share of what the force does, as those with a
/// blow of a hammer: they alone tell the mass.
pub(super) fn struck(motion: &Motion, windows: &[Window]) -> Vec<bool> {
    if motion.kind != Kind::Force || !windows.iter().all(|window| window.random) {
        return vec![false; windows.len()];
    }
    let power = |window: &Window| motion.drive_m_s2[window.range.clone()].iter().map(|f| f * f).sum::<f64>();
    let powers: Vec<f64> = windows.iter().map(power).collect();
    let least = STRUCK * powers.iter().sum::<f64>() / windows.len().max(1) as f64;
    powers.iter().map(|power| *power > least).collect()
}

/// Those that judge, with some of the struck ones among them and some not, where there are a few: whatever else changes, neighbours take each
/// other's place.
fn with_struck(motion: &Motion, windows: &[Window], mut judging: Vec<usize>) -> Vec<usize> {
    let struck = struck(motion, windows);
    let all: Vec<usize> = (1..windows.len().saturating_sub(1)).filter(|k| struck[*k]).collect();
    let judged = all.iter().filter(|k| judging.contains(k)).count();
    let Some(middle) = all.get(all.len() / 2).copied().filter(|_| all.len() >= FEWEST_STRUCK) else {
        return judging;
    };
    if judged == 0 {
        judging.retain(|k| k.abs_diff(middle) > 1);
        judging.push(middle);
    } else if judged == all.len() {
        // Every other one serves the fit, and the one after it judges.
        for k in all.into_iter().step_by(2) {
            judging.iter_mut().filter(|judge| **judge == k).for_each(|judge| *judge += 1);
        }
        judging.retain(|k| *k + 1 < windows.len());
    }
    judging.sort_unstable();
    judging
}

/// Which stretches judge: every third, but the first and last serve the fit, so that it need not extrapolate, and the one in which the
/// mass goes farthest, of steps by far: there may be a contact that no other one has. The one beside it judges in its place.
fn judging(motion: &Motion, windows: &[Window]) -> Vec<usize> {
    let last = windows.len().saturating_sub(1);
    let mut by_top: Vec<(f64, usize)> =
        windows.iter().map(|window| largest_m(motion, &window.range)).zip(0..).collect();
    by_top.sort_by(|a, b| b.0.total_cmp(&a.0));
    let alone = |two: &[(f64, usize)]| windows[two[0].1].random || two[0].0 > BY_FAR * two[1].0;
    let outermost = by_top.windows(2).next().filter(|two| alone(two)).map(|two| two[0].1);
    let in_place_of = |i: usize| match Some(i) == outermost {
        true if i + 1 < last => i + 1,
        true => i - 1,
        false => i,
    };
    (0..last).filter(|i| i % 3 == 1).map(in_place_of).filter(|i| *i > 0).collect()
}

/// Largest displacement of the mass in so many samples, m.
pub(super) fn largest_m(motion: &Motion, samples: &Range<usize>) -> f64 {
    motion.displacement_m[samples.clone()].iter().fold(0.0_f64, |top, d| top.max(d.abs()))
}

/// The cycles in which the mass goes farther than in any steady stretch while it settles: nothing else tells of the isolator out there,
/// and a model is driven there in every run.
fn farthest(record: &Record, motion: &Motion, steady: &[Window]) -> Option<Window> {
    let far = |n: &usize| motion.displacement_m[*n].abs();
    let top = |range: Range<usize>| range.max_by(|a, b| far(a).total_cmp(&far(b)));
    let reached = steady.iter().map(|window| largest_m(motion, &window.range)).fold(0.0, f64::max);
    let settling = steady.windows(2).filter_map(|two| {
        let n = top(two[0].range.end..two[1].range.start)?;
        Some((n, two))
    });
    let (n, two) = settling.max_by(|a, b| far(&a.0).total_cmp(&far(&b.0)))?;
    if far(&n) <= FARTHER * reached {
        return None;
    }
    let cycles = |count: f64| (count * motion.sample_rate_hz / two[1].frequency_hz) as usize;
    // A table that changes its frequency at once jumps between two samples; what that does is not known well enough.
    let changed = (1..n).rev().find(|i| record.step[*i] != record.step[n]).map_or(0, |i| i + 2);
    let start = n.saturating_sub(cycles(AROUND.0)).max(two[0].range.end).max(changed);
    let end = (n + cycles(AROUND.1)).min(two[1].range.start);
    let warm = start.saturating_sub(cycles(WARM))..start;
    let warm_from = from_the_middle(&motion.displacement_m, warm, cycles(1.0) as f64);
    Some(Window { warm_from, range: start..end, settling: true, held_out: false, ..two[1].clone() })
}

/// The last whole cycles of a step, at least four and more where they are as steady (half of a shorter step; two of a whole sweep), warmed
/// up by three before.
fn steady(step: i32, range: Range<usize>, motion: &Motion) -> Option<Window> {
    let rate = motion.sample_rate_hz;
    let input = &motion.drive_m_s2;
    let frequency_hz = step_cycles_hz(motion.kind, &input[range.clone()], rate)?;
    let cycle = rate / frequency_hz;
    let cycles = (range.len() as f64 / cycle).floor();
    // So many samples tell as much by few cycles of each step as by many of few steps.
    let very_long = motion.displacement_m.len() > VERY_LONG;
    let asked = if very_long { FEWEST_COUNTED } else { COUNTED };
    let mut counted = if cycles >= COUNTED + WARM { asked } else { (cycles / 2.0).floor().min(asked) };
    if counted < 1.0 {
        return None;
    }
    let most = (MOST * SHORT / motion.displacement_m.len() as f64).min(MOST).min(cycles - WARM);
    let back = |count: f64| range.end - (count * cycle).round() as usize;
    let channels = [input, &motion.displacement_m];
    let from_here = back(counted);
    let last = channels.map(|channel| phasor(&channel[from_here..range.end], cycle));
    let like_the_last = |from: usize, to: usize| {
        let turned = Complex64::from_polar(1.0, TAU * (from_here - from) as f64 / cycle);
        channels.iter().zip(&last).all(|(channel, last)| {
            (phasor(&channel[from..to], cycle) * turned - last).norm() < STEADY * last.norm()
        })
    };
    while counted >= asked && counted + 1.0 <= most && like_the_last(back(counted + 1.0), back(counted)) {
        counted += 1.0;
    }
    let start = back(counted);
    let warm_from = start.saturating_sub((WARM * cycle).round() as usize).max(range.start);
    let warm_from = from_the_middle(&motion.displacement_m, warm_from..start, cycle);
    Some(Window::steady(step, frequency_hz, warm_from, start..range.end))
}

/// Complex amplitude of a channel at a period of so many samples, its phase that at the first sample.
fn phasor(channel: &[f64], cycle: f64) -> Complex64 {
    let mean = channel.iter().sum::<f64>() / channel.len().max(1) as f64;
    let at = |(n, x): (usize, &f64)| {
        let (sin, cos) = sin_cos(TAU * n as f64 / cycle);
        (x - mean) * Complex64::new(cos, -sin)
    };
    channel.iter().enumerate().map(at).sum::<Complex64>() * (2.0 / channel.len().max(1) as f64)
}

/// The first passage through zero within a cycle: a model is warmed up from rest in the middle, and what it remembers of a jump
/// from there to elsewhere it forgets slowly.
fn from_the_middle(displacement: &[f64], range: Range<usize>, cycle: f64) -> usize {
    let within = range.start..range.end.min(range.start + cycle.ceil() as usize + 1).min(displacement.len());
    let crosses = |n: &usize| displacement[n - 1] * displacement[*n] <= 0.0;
    within.clone().skip(1).find(crosses).unwrap_or(range.start)
}

/// Thirty equal parts inside a record without steps, each warmed up by what is before it; of a record of very many cycles the first
/// cycles of each.
fn equal_parts(n: usize, motion: &Motion) -> Vec<Window> {
    let parts = (n / 64).clamp(1, 30);
    let length = n / parts;
    // A force may have any frequency; the mass answers at its own.
    let told = if motion.kind == Kind::Base { &motion.drive_m_s2 } else { &motion.displacement_m };
    let frequency_hz = cycles_hz(told, motion.sample_rate_hz).unwrap_or(1.0);
    let most = (CYCLES_OF_A_PART * motion.sample_rate_hz / frequency_hz).max(64.0) as usize;
    let counted = if motion.kind == Kind::Force { length.min(most) } else { length };
    (usize::from(parts > 4)..parts)
        .map(|i| {
            let (start, end) = (i * length, i * length + counted);
            let warm_from = start.saturating_sub(2 * counted);
            let part = Window::steady(i as i32, frequency_hz, warm_from, start..end);
            Window { random: motion.kind != Kind::Component, ..part }
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::largest_m;
    use crate::diagnose::testing::seen;
    use crate::identify::kinematics::Tolerances;
    use crate::identify::motion::Motion;
    use crate::model::testing::b1_g2;

    #[test]
    fn the_farthest_excursion_is_looked_at_although_the_motion_only_settles_there() {
        let record = seen(&b1_g2(), 1);
        let motion = Motion::of(&record, 500.0, Tolerances::default()).expect("sound").farthest(&record);
        let motion = motion.expect("sound");
        let (steady, settling): (Vec<_>, Vec<_>) = motion.windows.iter().partition(|w| !w.settling);
        let reached = steady.iter().map(|w| largest_m(&motion, &w.range)).fold(0.0, f64::max);
        let between = largest_m(&motion, &(steady[0].range.end..steady[steady.len() - 1].range.start));
        assert!(between > 1.02 * reached, "the record overshoots: {between} m over {reached} m");
        let [window] = settling.as_slice() else { panic!("{settling:?}") };
        assert_eq!(largest_m(&motion, &window.range), between);
        assert!(motion.windows.iter().all(|w| w.step != window.step || !w.held_out));
        assert!(motion.windows.windows(2).all(|two| two[0].range.end <= two[1].range.start));
    }

    #[test]
    fn the_fit_sees_the_step_in_which_the_mass_goes_farthest_by_far() {
        let whole = seen(&b1_g2(), 1);
        // One of four steps judges: the second, unless the fit would have to extrapolate to it.
        let held_out = |four: [i32; 4]| {
            let mut record = whole.clone();
            record.step.iter_mut().filter(|step| !four.contains(*step)).for_each(|step| *step = -1);
            let motion = Motion::of(&record, 500.0, Tolerances::default()).expect("sound");
            let top = |i: usize| largest_m(&motion, &motion.windows[i].range);
            let by_far = top(1) > 1.1 * top(0).max(top(2)).max(top(3));
            (by_far, motion.windows.iter().map(|w| w.held_out).collect::<Vec<bool>>())
        };
        assert_eq!(held_out([0, 1, 2, 3]), (false, vec![false, true, false, false]));
        assert_eq!(held_out([0, 3, 12, 13]), (true, vec![false, false, true, false]));
    }

    #[test]
    fn the_zero_of_an_accelerometer_is_taken_out_once_where_stretches_warm_each_other_up() {
        let mut record = seen(&b1_g2(), 2);
        record.step.clear();
        let channels = [&mut record.mass_acceleration_1_m_s2, &mut record.mass_acceleration_2_m_s2];
        channels.into_iter().flatten().for_each(|a| *a += 0.05);
        let motion = Motion::of(&record, 500.0, Tolerances::default()).expect("sound");
        let (first, last) = (&motion.windows[0], &motion.windows[motion.windows.len() - 1]);
        let counted = first.range.start..last.range.end;
        let mean = motion.restoring_m_s2[counted.clone()].iter().sum::<f64>() / counted.len() as f64;
        assert!(mean.abs() < 0.01, "{mean} m/s2 of 0.05 are left");
    }
}
