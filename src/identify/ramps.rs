//! Displacements that are imposed at constant velocities - triangles, ramps, holds. Seen with noise and smoothed, such a motion is round
//! where it turns and its velocity far off there; straight lines between corners know both. Called when a motion is made of a component's
//! record.

/// A motion of straight parts.
pub(super) struct Ramps {
    /// Sample by sample.
    pub(super) displacement_m: Vec<f64>,
    pub(super) velocity_m_s: Vec<f64>,
    /// Whether that is known: not beside corners that are round.
    pub(super) velocity_is_told: Vec<bool>,
    /// What the noise of the sensor leaves of both, rms.
    pub(super) displacement_noise_m: f64,
    pub(super) velocity_noise_m_s: f64,
}

/// Noise of the sensor that a sample is off a chord by where there is a corner: the chord's ends have noise of their own.
const FAR: f64 = 6.0;
/// Samples that a part has at least, and parts in the mean.
const SHORTEST: usize = 6;
const USUAL: usize = 12;
/// Deviations from which on two neighbouring parts have velocities of their own.
const OTHER: f64 = 4.0;
/// What straight parts may leave over the noise of the sensor, rms; and the mean of a quarter of a part over what chance makes of it, rms.
const LEFT: f64 = 1.15;
const BENT: f64 = 1.3;
/// Deviations from which on the samples beside all corners are off the lines in their mean: nothing turns at once.
const ROUND: f64 = 4.0;
/// Share of the samples beside round corners, at most.
const MOST_ROUND: f64 = 0.15;
/// Rounds in which corners are told by the lines on both of their sides.
const ROUNDS: usize = 4;

/// The straight parts of a displacement (m) that is seen with white noise (m rms); nothing of one that bends.
pub(super) fn examine(seen_m: &[f64], noise_m: f64, rate_hz: f64) -> Option<Ramps> {
    let last = seen_m.len().checked_sub(1)?;
    if noise_m <= 0.0 || last < 4 * USUAL {
        return None;
    }
    let mut corners: Vec<f64> =
        rough(seen_m, FAR * noise_m)?.into_iter().map(|corner| corner as f64).collect();
    for _ in 0..ROUNDS {
        corners = sharper(seen_m, noise_m, corners)?;
    }
    laid(seen_m, noise_m, rate_hz, &corners)
}

/// Samples at which a motion turns, its ends among them: where it is farthest from the chord between two others, and farther than told
/// (Douglas and Peucker 1973). Nothing where there are more than ramps would have.
fn rough(seen_m: &[f64], far_m: f64) -> Option<Vec<usize>> {
    let last = seen_m.len() - 1;
    let mut corners = vec![0, last];
    let mut open = vec![(0, last)];
    while let Some((from, to)) = open.pop() {
        let slope = (seen_m[to] - seen_m[from]) / (to - from) as f64;
        let off = |i: usize| (seen_m[i] - seen_m[from] - slope * (i - from) as f64).abs();
        let Some(farthest) = (from + 1..to).max_by(|a, b| off(*a).total_cmp(&off(*b))) else { continue };
        if off(farthest) > far_m {
            corners.push(farthest);
            open.extend([(from, farthest), (farthest, to)]);
        }
        if corners.len() > seen_m.len() / USUAL {
            return None;
        }
    }
    corners.sort_unstable();
    Some(corners)
}

/// A line through a part: place at its middle and change from sample to sample, with the deviation of that.
struct Line {
    middle: f64,
    place_m: f64,
    slope_m: f64,
    slope_sigma_m: f64,
}

impl Line {
    /// Through the samples between two corners, those beside them left out where there are enough.
    fn through(seen_m: &[f64], noise_m: f64, (from, to): (f64, f64)) -> Self {
        let beside = if to - from > 2.0 * SHORTEST as f64 { 1.0 } else { 0.0 };
        let first = (from + beside).ceil().max(0.0) as usize;
        let end = ((to - beside).floor() as usize + 1).min(seen_m.len()).max(first + 1);
        let count = (end - first) as f64;
        let middle = 0.5 * (first + end - 1) as f64;
        let part = &seen_m[first..end];
        let place_m = part.iter().sum::<f64>() / count;
        let (mut along, mut both) = (0.0, 0.0);
        for (i, x) in part.iter().enumerate() {
            let u = (first + i) as f64 - middle;
            along += u * u;
            both += u * (x - place_m);
        }
        let along = along.max(f64::MIN_POSITIVE);
        Self { middle, place_m, slope_m: both / along, slope_sigma_m: noise_m / along.sqrt() }
    }

    fn at(&self, sample: f64) -> f64 {
        self.place_m + self.slope_m * (sample - self.middle)
    }

    /// Whether the next part goes on as this one does.
    fn goes_on_as(&self, next: &Self) -> bool {
        (self.slope_m - next.slope_m).abs() < OTHER * self.slope_sigma_m.hypot(next.slope_sigma_m)
    }

    /// Where it meets the next one.
    fn meets(&self, next: &Self) -> f64 {
        let apart = next.at(self.middle) - self.place_m;
        self.middle + apart / (self.slope_m - next.slope_m)
    }
}

/// Corners told by the lines on both of their sides, those of which there are none left out.
fn sharper(seen_m: &[f64], noise_m: f64, corners: Vec<f64>) -> Option<Vec<f64>> {
    let (first, last) = (*corners.first()?, *corners.last()?);
    // Two that are next to each other are one.
    let mut apart: Vec<f64> = vec![first];
    for corner in &corners[1..corners.len() - 1] {
        match apart.last_mut() {
            Some(before) if corner - *before < SHORTEST as f64 => {
                if *before > first {
                    *before = 0.5 * (*before + corner);
                }
            }
            _ => apart.push(*corner),
        }
    }
    if apart.len() > 1 && last - apart[apart.len() - 1] < SHORTEST as f64 {
        apart.pop();
    }
    apart.push(last);
    let line = |from: f64, to: f64| Line::through(seen_m, noise_m, (from, to));
    let mut sharp = vec![first];
    let mut before = line(apart[0], apart[1]);
    for k in 1..apart.len() - 1 {
        let next = line(apart[k], apart[k + 1]);
        if before.goes_on_as(&next) {
            before = line(sharp[sharp.len() - 1], apart[k + 1]);
            continue;
        }
        let meets = before.meets(&next);
        // Not beyond the parts themselves.
        sharp.push(meets.clamp(before.middle.min(apart[k]), next.middle.max(apart[k])));
        before = next;
    }
    sharp.push(last);
    sharp.is_sorted().then_some(sharp)
}

/// The motion along lines between corners, where they leave nothing but noise away from those.
fn laid(seen_m: &[f64], noise_m: f64, rate_hz: f64, corners: &[f64]) -> Option<Ramps> {
    let n = seen_m.len();
    let (mut displacement_m, mut velocity_m_s) = (Vec::with_capacity(n), Vec::with_capacity(n));
    let (mut off_m, mut slopes_m) = (Vec::with_capacity(n), Vec::with_capacity(corners.len()));
    let mut ends = Vec::with_capacity(corners.len());
    let (mut of_place, mut of_slope) = (0.0, 0.0);
    for (k, part) in corners.windows(2).enumerate() {
        let line = Line::through(seen_m, noise_m, (part[0], part[1]));
        let first = displacement_m.len();
        let end = if k + 2 < corners.len() { (part[1].ceil() as usize).clamp(first, n) } else { n };
        off_m.extend((first..end).map(|i| seen_m[i] - line.at(i as f64)));
        displacement_m.extend((first..end).map(|i| line.at(i as f64)));
        velocity_m_s.extend((first..end).map(|_| line.slope_m * rate_hz));
        of_place += 2.0 * noise_m.powi(2);
        of_slope += (end - first) as f64 * (line.slope_sigma_m * rate_hz).powi(2);
        slopes_m.push(line.slope_m);
        ends.push(first..end);
    }
    let velocity_is_told = away_from_round(&off_m, noise_m, corners, &slopes_m);
    let (mut left, mut told, mut bent, mut quarters) = (0.0, 0_usize, 0.0, 0_usize);
    for part in ends {
        let off: Vec<f64> = part.filter(|i| velocity_is_told[*i]).map(|i| off_m[i]).collect();
        left += off.iter().map(|x| x * x).sum::<f64>();
        told += off.len();
        let quarter = off.len() / 4;
        if quarter > 1 {
            let square = |of: &[f64]| of.iter().sum::<f64>().powi(2) / of.len() as f64;
            bent += off.chunks_exact(quarter).take(4).map(square).sum::<f64>();
            quarters += 4;
        }
    }
    let rms = |sum: f64, count: usize| (sum / count.max(1) as f64).sqrt();
    let is_straight = (n - told) as f64 <= MOST_ROUND * n as f64
        && rms(left, told) < LEFT * noise_m
        && quarters > 0
        && rms(bent, quarters) < BENT * noise_m;
    is_straight.then(|| Ramps {
        displacement_m,
        velocity_m_s,
        velocity_is_told,
        displacement_noise_m: rms(of_place, n),
        velocity_noise_m_s: rms(of_slope, n),
    })
}

/// Whether each sample lies away from corners, where these are round: a table that turns takes some samples for it, over which the force
/// of a dashpot turns, too. How far they are round all of them tell together.
fn away_from_round(off_m: &[f64], noise_m: f64, corners: &[f64], slopes_m: &[f64]) -> Vec<bool> {
    let turns: Vec<(usize, f64)> = (1..corners.len() - 1)
        .map(|k| (corners[k].round() as usize, (slopes_m[k] - slopes_m[k - 1]).signum()))
        .collect();
    let within = |beside: usize| -> f64 {
        let each = turns.iter().flat_map(|(corner, turn)| {
            let samples = [corner.checked_sub(beside), (beside > 0).then_some(corner + beside)];
            samples.into_iter().flatten().filter_map(move |n| Some(turn * off_m.get(n)?))
        });
        let (sum, count) = each.fold((0.0, 0_usize), |(sum, count), off| (sum + off, count + 1));
        sum / (count.max(1) as f64).sqrt()
    };
    let round = (0..SHORTEST).take_while(|beside| within(*beside) > ROUND * noise_m).count();
    let mut told = vec![true; off_m.len()];
    if round > 0 {
        for (corner, _) in turns {
            let beside = corner.saturating_sub(round)..(corner + round + 1).min(told.len());
            told[beside].fill(false);
        }
    }
    told
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{SeedableRng, prelude::Distribution};

    const RATE_HZ: f64 = 200.0;

    fn seen(at: impl Fn(f64) -> f64, noise_m: f64, seed: u64) -> Vec<f64> {
        let mut random = rand_pcg::Pcg64::seed_from_u64(seed);
        let mut noise = || -> f64 {
            let z: f64 = rand_distr::StandardNormal.sample(&mut random);
            noise_m * z
        };
        (0..8000).map(|i| at(f64::from(i) / RATE_HZ) + noise()).collect()
    }

    /// A triangle of 1 m and 1 s.
    fn triangle(t: f64) -> f64 {
        let u = (t + 0.25).rem_euclid(1.0);
        if u < 0.5 { 4.0 * u - 1.0 } else { 3.0 - 4.0 * u }
    }

    #[test]
    fn triangles_and_holds_are_known_far_better_than_they_are_seen() {
        let hold = |t: f64| triangle(0.37 * t).clamp(-0.6, 0.8);
        let grows = |t: f64| (1.0 + (0.37 * t + 0.5).floor()) * triangle(0.37 * t);
        for (motion, name) in
            [(&triangle as &dyn Fn(f64) -> f64, "triangle"), (&hold, "hold"), (&grows, "grows")]
        {
            for (noise_m, seed) in [(3e-3, 1), (1e-3, 2), (1e-5, 3)] {
                let told = examine(&seen(motion, noise_m, seed), noise_m, RATE_HZ).expect(name);
                let rms = |off: &dyn Fn(usize) -> f64| {
                    ((0..8000).map(|i| off(i).powi(2)).sum::<f64>() / 8000.0).sqrt()
                };
                let at = |i: usize| i as f64 / RATE_HZ;
                let of_place = rms(&|i| told.displacement_m[i] - motion(at(i)));
                assert!(of_place < 0.4 * noise_m, "{name} {noise_m}: {of_place}");
                assert!((0.7..1.5).contains(&(told.displacement_noise_m / of_place)), "{name}: {of_place}");
                // Beside corners it is one of both.
                let wrong = |i: &usize| {
                    let dt = 0.5 / RATE_HZ;
                    let truth = (motion(at(*i) + dt) - motion(at(*i) - dt)) / (2.0 * dt);
                    (told.velocity_m_s[*i] - truth).abs() > 6.0 * told.velocity_noise_m_s + 1e-9
                };
                let corners = (0..8000).filter(wrong).count();
                assert!(corners < 2 * 82, "{name} {noise_m}: {corners}");
            }
        }
    }

    #[test]
    fn beside_corners_that_are_round_no_velocity_is_told() {
        const NOISE_M: f64 = 3e-3;
        // Round over so many samples to each side.
        let mean = |t: f64, samples: i32| {
            let each = (-50..=50).map(|i| triangle(0.37 * (t + f64::from(i * samples) / 50.0 / RATE_HZ)));
            each.sum::<f64>() / 101.0
        };
        for (samples, most) in [(3, 4 * 7), (0, 0)] {
            let told = examine(&seen(|t| mean(t, samples), NOISE_M, 7), NOISE_M, RATE_HZ).expect("ramps");
            let untold = told.velocity_is_told.iter().filter(|told| !**told).count();
            assert!(untold <= most * 30 / 4 && (untold > 0) == (samples > 0), "{samples}: {untold}");
            let wrong = |i: &usize| {
                let (t, dt) = (*i as f64 / RATE_HZ, 0.5 / RATE_HZ);
                let truth = (mean(t + dt, samples) - mean(t - dt, samples)) / (2.0 * dt);
                told.velocity_is_told[*i] && (told.velocity_m_s[*i] - truth).abs() > 0.3
            };
            // Of a sharp corner one sample may lie on both sides.
            let wrong = (0..8000).filter(wrong).count();
            assert!(wrong <= if samples > 0 { 10 } else { 31 }, "{samples}: {wrong}");
        }
    }

    #[test]
    fn what_bends_has_no_straight_parts() {
        for noise_m in [3e-2, 3e-3, 1e-4] {
            let sine = seen(|t| (6.0 * t).sin(), noise_m, 4);
            assert!(examine(&sine, noise_m, RATE_HZ).is_none(), "{noise_m}");
            let waves = seen(|t| (6.0 * t).sin() + 0.5 * (17.0 * t).sin(), noise_m, 5);
            assert!(examine(&waves, noise_m, RATE_HZ).is_none(), "{noise_m}");
            // Corners that are rounded over a tenth of a second.
            let rounded = seen(|t| triangle(t).tanh(), noise_m, 6);
            assert!(examine(&rounded, noise_m, RATE_HZ).is_none(), "{noise_m}");
        }
    }
}
