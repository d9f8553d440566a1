//! Accelerometers behind a coupling that blocks what is slow (AC: piezoelectric ones, charge amplifiers), of first order: `s' = A' + w A` of the true
//! `s` and what is seen of it, `A`. Told from `D'' = A - a_table` alone, whatever the specimen is, and undone.
//!
//! Differentiated once, the relation is linear in what is not known: `D''' = g (A' + w A + dt A'') - g_t (a' + w_t a + dt_t a'')`. It is
//! asked in windows, times smooth functions that vanish at their ends, and integrated by parts (Shinbrot 1957): no
//! derivative is taken of what was measured, and the ends do not count.

use crate::parallel;
use crate::record::data::{Kind, Record, Role};
use crate::record::kinematic::typical_cycle;
use crate::signal::{Spectrum, fast_length};
use nalgebra::{DMatrix, DVector};
use realfft::num_complex::Complex64;
use std::f64::consts::TAU;

/// Windows: at least and at most so many, of so many cycles, and how many share a sample, as their functions are narrow.
const FEWEST: usize = 6;
const OVERLAP: usize = 3;
const MOST: usize = 48;
const CYCLES: f64 = 12.0;
/// Frequency up to which the relation is asked, over the typical one.
const UP_TO: f64 = 12.0;
/// Share of the largest power of a window from which on a bin is motion, and of that of all windows from which on a window has any.
const STRONG: f64 = 0.01;
const MOVES: f64 = 1e-4;
/// Bins that a window's function joins share noise, and so do windows: so many count as one.
const COLOUR: f64 = 4.0;
/// A corner is one from so many deviations on, and from this share of the lowest frequency that moves. None is above half of that.
const SURE: f64 = 8.0;
const LEAST: f64 = 1e-3;
const HIGHEST: f64 = 0.5;
/// Corners of all accelerometers that are as alike are one: so many deviations.
const ALIKE: f64 = 4.0;
/// A fit with one delay less does as well if what it leaves more is so many deviations of chance, squared, at most.
const AS_WELL: f64 = 16.0;
/// Below this share of the lowest frequency that moves nothing is made larger, as noise and zeros would be.
const SLOW: f64 = 0.1;

/// The corner of a channel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Coupling {
    pub(super) role: Role,
    /// Corner, rad/s.
    corner_rad_s: f64,
    /// Lowest frequency that moves, rad/s.
    lowest_rad_s: f64,
}

impl Coupling {
    /// Corner, Hz.
    pub(super) fn corner_hz(&self) -> f64 {
        self.corner_rad_s / TAU
    }

    /// The channel as it would be without the coupling.
    pub(super) fn undone(&self, channel: &[f64], rate_hz: f64) -> Vec<f64> {
        let slow = SLOW * self.lowest_rad_s;
        let factor = |w: f64| {
            let passes = (w / slow).powi(4) / (1.0 + (w / slow).powi(4));
            if w > 0.0 { Complex64::new(1.0, -self.corner_rad_s / w * passes) } else { Complex64::ONE }
        };
        Spectrum::of_second_derivative(channel, rate_hz).multiply(factor).channel()
    }
}

/// Couplings of the accelerometers of a record that shows the displacement, too.
pub(super) fn find(record: &Record) -> Vec<Coupling> {
    let (displacement, accelerometers, table) = match record.kind {
        Kind::Base => (
            Role::RelativeDisplacement,
            vec![Role::MassAcceleration1, Role::MassAcceleration2],
            Some(Role::TableAcceleration),
        ),
        Kind::Force => (Role::Displacement, vec![Role::Acceleration], None),
        Kind::Component => return Vec::new(),
    };
    let there = |role: &Role| record.channel(*role).len() == record.len() && !record.is_empty();
    let accelerometers: Vec<Role> = accelerometers.into_iter().filter(there).collect();
    if !there(&displacement) || !table.as_ref().is_none_or(there) {
        return Vec::new();
    }
    let roles: Vec<Role> =
        std::iter::once(displacement).chain(table).chain(accelerometers.iter().copied()).collect();
    let channels: Vec<&[f64]> = roles.iter().map(|role| record.channel(*role)).collect();
    let Some(seen) = Seen::of(&channels, record.sample_rate_hz) else { return Vec::new() };
    let place = |role: Role| roles.iter().position(|other| *other == role);
    let told: Option<Vec<_>> = accelerometers
        .iter()
        .map(|role| {
            let places = [Some(displacement), Some(*role), table].into_iter().flatten().filter_map(place);
            let relation = Relation::of(&seen, &places.collect::<Vec<_>>())?;
            let lowest_rad_s = relation.lowest_rad_s;
            let coupling = |role, corner_rad_s| Coupling { role, corner_rad_s, lowest_rad_s };
            let (of_mass, of_table) = relation.corners();
            Some((
                of_mass.map(|corner| coupling(*role, corner)),
                table.zip(of_table).map(|(role, corner)| coupling(role, corner)),
            ))
        })
        .collect();
    let Some(told) = told else { return Vec::new() };
    // Each of them sees the one of the table.
    let of_table: Vec<Coupling> = told.iter().filter_map(|(_, table)| *table).collect();
    if !of_table.is_empty() && of_table.len() < told.len() {
        return Vec::new();
    }
    let mean = of_table.iter().map(|of| of.corner_rad_s).sum::<f64>() / of_table.len() as f64;
    let table = of_table.first().map(|first| Coupling { corner_rad_s: mean, ..*first });
    told.into_iter().filter_map(|(mass, _)| mass).chain(table).collect()
}

/// Places in a row of the relation: D''', then of each acceleration its derivative, itself, and its second derivative.
const LEFT: usize = 0;
const MASS: [usize; 3] = [1, 2, 3];
const TABLE: [usize; 3] = [4, 5, 6];

/// The relation, window by window.
struct Relation {
    /// Products of all places with each other, in units of the noise.
    grams: Vec<DMatrix<f64>>,
    /// Real equations that are independent.
    equations: f64,
    lowest_rad_s: f64,
    with_table: bool,
}

/// Places that a column is the sum of, each times a factor.
type Column = Vec<(usize, f64)>;

/// What a least squares tells of its columns, and the square sum that it leaves.
struct Fit {
    told: Vec<Told>,
    left: f64,
}

/// A number with its standard error.
#[derive(Clone, Copy)]
struct Told {
    value: f64,
    sigma: f64,
}

impl Told {
    /// The corner, if it is one.
    fn sure(self, lowest_rad_s: f64) -> Option<f64> {
        let large = self.value > (SURE * self.sigma).max(LEAST * lowest_rad_s);
        (large && self.value < HIGHEST * lowest_rad_s).then_some(self.value)
    }
}

/// Spectra of windows of some channels, up to the highest bin that is asked, and the white noise of each channel, as bins have it.
struct Seen {
    windows: Vec<Vec<Spectrum>>,
    noise: Vec<f64>,
}

impl Seen {
    /// Of channels of which the first tells how long a cycle is; `None` of what is too short.
    fn of(channels: &[&[f64]], rate_hz: f64) -> Option<Self> {
        let samples = channels.first()?.len();
        let cycle = typical_cycle(channels[0])?;
        let length = fast_length((CYCLES * cycle).clamp(64.0, 1e9) as usize);
        if samples / length < FEWEST {
            return None;
        }
        let count = (OVERLAP * samples / length).min(MOST);
        let starts: Vec<usize> = (0..count).map(|k| k * (samples - length) / (count - 1)).collect();
        let bins = (UP_TO * length as f64 / cycle) as usize + 3;
        let seen = parallel::map(&starts, parallel::cores(), |start| {
            let of = |channel: &&[f64]| {
                let mut spectrum = Spectrum::of_piece(&channel[*start..*start + length], rate_hz);
                let noise = top_of_band(&spectrum);
                spectrum.bins.truncate(bins);
                (spectrum, noise)
            };
            channels.iter().map(of).unzip()
        });
        let (windows, told): (Vec<Vec<Spectrum>>, Vec<Vec<f64>>) = seen.into_iter().unzip();
        let noise = (0..channels.len()).map(|channel| {
            let mut of_windows: Vec<f64> = told.iter().map(|of_window| of_window[channel]).collect();
            of_windows.sort_by(f64::total_cmp);
            of_windows[count / 2]
        });
        Some(Self { noise: noise.collect(), windows })
    }
}

impl Relation {
    /// Of the displacement, the acceleration of the mass and that of the table, by their places among what is seen; `None` where
    /// too few windows move.
    fn of(seen: &Seen, places: &[usize]) -> Option<Self> {
        let noise = seen.noise[places[0]];
        let noise_of_accelerations: f64 = places[1..].iter().map(|place| seen.noise[*place]).sum();
        let windows: Vec<Vec<&Spectrum>> =
            seen.windows.iter().map(|window| places.iter().map(|place| &window[*place]).collect()).collect();
        // Power of the accelerations in each bin from the fourth on.
        let powers: Vec<Vec<f64>> = windows
            .iter()
            .map(|window| {
                let power = |bin| window[1..].iter().map(|of| smooth(of, bin, 0).norm_sqr()).sum();
                (4..window[0].bins.len().saturating_sub(2)).map(power).collect()
            })
            .collect();
        let tops: Vec<f64> = powers.iter().map(|powers| powers.iter().copied().fold(0.0, f64::max)).collect();
        let top = tops.iter().copied().fold(0.0, f64::max);
        let (mut grams, mut equations, mut lowest_rad_s) = (Vec::new(), 0.0, f64::INFINITY);
        for ((window, powers), of_window) in windows.iter().zip(&powers).zip(tops) {
            if of_window <= MOVES * top {
                continue;
            }
            let mut gram = DMatrix::zeros(7, 7);
            for (bin, power) in powers.iter().enumerate().map(|(i, power)| (i + 4, *power)) {
                if power <= STRONG * of_window {
                    continue;
                }
                let w = window[0].omega_rad_s(bin);
                if power >= of_window {
                    lowest_rad_s = lowest_rad_s.min(w);
                }
                let scale = (w * w * w * noise).hypot(w * noise_of_accelerations).max(1e-300);
                let mut row = [Complex64::ZERO; 7];
                row[LEFT] = smooth(window[0], bin, 3) / scale;
                for (spectrum, places) in window[1..].iter().zip([MASS, TABLE]) {
                    for (place, order) in places.into_iter().zip([1, 0, 2]) {
                        row[place] = smooth(spectrum, bin, order) / scale;
                    }
                }
                for (i, a) in row.iter().enumerate() {
                    for (j, b) in row.iter().enumerate() {
                        gram[(i, j)] += (a * b.conj()).re;
                    }
                }
                equations += 2.0 / COLOUR;
            }
            grams.push(gram);
        }
        let with_table = places.len() > 2;
        (grams.len() >= FEWEST).then_some(Self { grams, equations, lowest_rad_s, with_table })
    }

    /// Corners of the mass's accelerometer and of the table's, rad/s, where they are beyond doubt.
    fn corners(&self) -> (Option<f64>, Option<f64>) {
        let none = (None, None);
        let each =
            |places: &[usize]| -> Vec<Column> { places.iter().map(|place| vec![(*place, 1.0)]).collect() };
        if !self.with_table {
            let Some(free) = self.fit(&each(&MASS)) else { return none };
            return (ratio(free.told[1], free.told[0]).sure(self.lowest_rad_s), None);
        }
        let gains = each(&[MASS[0], TABLE[0]]);
        let fit_with = |delays: &[Column]| {
            let columns = [gains.clone(), each(&[MASS[1], TABLE[1]]), delays.to_vec()].concat();
            self.fit(&columns).map(|fit| (fit, [gains.clone(), delays.to_vec()].concat()))
        };
        // A mass on a linear spring lets an accelerometer that is early pass for corners of both that are alike. Nothing is early: where a
        // delay of the displacement alone does, there is no other.
        let of_displacement = vec![vec![(MASS[2], 1.0), (TABLE[2], -1.0)]];
        let (Some(free), Some(tied)) = (fit_with(&each(&[MASS[2], TABLE[2]])), fit_with(&of_displacement))
        else {
            return none;
        };
        let (fit, others) =
            if tied.0.left < (1.0 + AS_WELL / self.equations) * free.0.left { tied } else { free };
        self.shared_or_own(&fit, &others)
    }

    /// Of a fit of the two gains, the two corners and more: one corner for both, beside the other columns, where both are alike.
    fn shared_or_own(&self, fit: &Fit, others: &[Column]) -> (Option<f64>, Option<f64>) {
        let (mass, table) = (ratio(fit.told[2], fit.told[0]), ratio(fit.told[3], fit.told[1]));
        let both = vec![(MASS[1], fit.told[0].value), (TABLE[1], fit.told[1].value)];
        let shared =
            self.fit(&[others.to_vec(), vec![both]].concat()).and_then(|fit| fit.told.last().copied());
        let alike = |own: Told, shared: Told| (own.value - shared.value).abs() < ALIKE * own.sigma;
        if let Some(shared) = shared.filter(|shared| alike(mass, *shared) && alike(table, *shared)) {
            let corner = shared.sure(self.lowest_rad_s);
            return (corner, corner);
        }
        (mass.sure(self.lowest_rad_s), table.sure(self.lowest_rad_s))
    }

    /// Least squares of D''' by columns that are sums of places. The errors are the larger of what the remainder says and of what
    /// its scatter from window to window does (White 1980).
    fn fit(&self, columns: &[Column]) -> Option<Fit> {
        let mix = DMatrix::from_fn(7, columns.len(), |place, column| {
            columns[column].iter().filter(|(of, _)| *of == place).map(|(_, factor)| *factor).sum()
        });
        let products =
            |gram: &DMatrix<f64>| (mix.transpose() * gram * &mix, mix.transpose() * gram.column(LEFT));
        let all = self.grams.iter().fold(DMatrix::zeros(7, 7), |sum, gram| sum + gram);
        let (normal, right) = products(&all);
        let scale = DVector::from_fn(columns.len(), |j, _| 1.0 / normal[(j, j)].sqrt().max(1e-300));
        let scaled =
            DMatrix::from_fn(columns.len(), columns.len(), |i, j| normal[(i, j)] * scale[i] * scale[j]);
        let inverse = DMatrix::from_diagonal(&scale) * scaled.try_inverse()? * DMatrix::from_diagonal(&scale);
        let values = &inverse * &right;
        let left = all[(LEFT, LEFT)] - right.dot(&values);
        let variance = (left / COLOUR).max(0.0) / (self.equations - columns.len() as f64).max(1.0);
        let mut scatter = DMatrix::zeros(columns.len(), columns.len());
        for gram in &self.grams {
            let (normal, right) = products(gram);
            let score = right - normal * &values;
            scatter += &score * score.transpose();
        }
        let windows = self.grams.len() as f64;
        let robust = &inverse * scatter * &inverse * (windows / (windows - columns.len() as f64).max(1.0));
        let told = values.iter().enumerate().map(|(j, value)| Told {
            value: *value,
            sigma: (variance * COLOUR * inverse[(j, j)]).max(robust[(j, j)]).max(0.0).sqrt(),
        });
        Some(Fit { told: told.collect(), left })
    }
}

/// One number over another that is known far better.
fn ratio(of: Told, to: Told) -> Told {
    Told { value: of.value / to.value, sigma: (of.sigma / to.value).abs() }
}

/// A derivative of a channel times `sin^4(pi t / T) exp(-i w t)`, summed over a window of length T: by parts, the channel alone.
fn smooth(spectrum: &Spectrum, bin: usize, order: i32) -> Complex64 {
    const WINDOW: [f64; 5] = [1.0 / 16.0, -0.25, 0.375, -0.25, 1.0 / 16.0];
    let at = |(k, share): (usize, f64)| {
        let bin = bin + k - 2;
        spectrum.bins[bin] * Complex64::new(0.0, spectrum.omega_rad_s(bin)).powi(order) * share
    };
    WINDOW.into_iter().enumerate().map(at).sum()
}

/// RMS of the bins at the top of the band.
fn top_of_band(spectrum: &Spectrum) -> f64 {
    let bins = spectrum.bins.len();
    let range = (bins * 8 / 10).max(2)..(bins * 19 / 20).min(bins - 2);
    let count = range.len().max(1) as f64;
    (range.map(|bin| smooth(spectrum, bin, 0).norm_sqr()).sum::<f64>() / count).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{SeedableRng, prelude::Distribution};

    const RATE_HZ: f64 = 200.0;

    /// A motion whose frequency grows, in closed form but for the coupling, which is exact along lines; corners in Hz.
    fn record(of_mass_hz: f64, of_table_hz: f64, seed: u64) -> Record {
        let mut random = rand_pcg::Pcg64::seed_from_u64(seed);
        let mut noise = |rms: f64| -> f64 {
            let z: f64 = rand_distr::StandardNormal.sample(&mut random);
            rms * z
        };
        let mut out = Record::empty("it", Kind::Base, RATE_HZ);
        let block = |channel: &[f64], corner_hz: f64| -> Vec<f64> {
            let kept = (-TAU * corner_hz / RATE_HZ).exp();
            let passes = if corner_hz > 0.0 { (1.0 - kept) / (TAU * corner_hz / RATE_HZ) } else { 1.0 };
            let mut seen = channel[0];
            let next = channel.windows(2).map(|pair| {
                seen = kept * seen + passes * (pair[1] - pair[0]);
                seen
            });
            std::iter::once(channel[0]).chain(next).collect()
        };
        let (mut mass, mut table) = (Vec::new(), Vec::new());
        for i in 0..24_000 {
            let t = f64::from(i) / RATE_HZ;
            let (p, w, k) = (TAU * (1.2 * t + 0.01 * t * t), TAU * (1.2 + 0.02 * t), TAU * 0.02);
            let x = 0.01 * (p - 0.4).sin();
            let relative = 0.01 * (k * (p - 0.4).cos() - w * w * (p - 0.4).sin());
            let a = 0.5 * p.sin();
            out.time_s.push(t);
            out.relative_displacement_m.push(x + noise(1e-5));
            mass.push(relative + a);
            table.push(a);
        }
        out.mass_acceleration_1_m_s2 =
            block(&mass, of_mass_hz).into_iter().map(|a| a + 0.05 + noise(5e-3)).collect();
        out.mass_acceleration_2_m_s2 =
            block(&mass, of_mass_hz).into_iter().map(|a| a + noise(5e-3)).collect();
        out.table_acceleration_m_s2 =
            block(&table, of_table_hz).into_iter().map(|a| a + noise(5e-3)).collect();
        out
    }

    #[test]
    fn corners_are_found_of_what_has_them_alone() {
        let corner = |of: &[Coupling], role: Role| {
            of.iter().find(|of| of.role == role).map_or(0.0, Coupling::corner_hz)
        };
        let roles = [Role::MassAcceleration1, Role::MassAcceleration2, Role::TableAcceleration];
        for (of_mass_hz, of_table_hz) in [(0.05, 0.05), (0.05, 0.0), (0.0, 0.08), (0.2, 0.1), (0.0, 0.0)] {
            for seed in 0..6 {
                let found = find(&record(of_mass_hz, of_table_hz, seed));
                for (role, truth) in roles.into_iter().zip([of_mass_hz, of_mass_hz, of_table_hz]) {
                    let told = corner(&found, role);
                    assert!((told - truth).abs() <= 0.1 * truth, "{role:?}: {told} Hz, is {truth} Hz");
                }
            }
        }
    }

    #[test]
    fn what_a_coupling_took_comes_back() {
        let (without, with) = (record(0.0, 0.0, 1), record(0.1, 0.1, 1));
        for coupling in find(&with) {
            let undone = coupling.undone(with.channel(coupling.role), RATE_HZ);
            let apart = |channel: &[f64]| {
                let pairs = channel.iter().zip(without.channel(coupling.role)).skip(2000).take(20_000);
                (pairs.map(|(a, b)| (a - b).powi(2)).sum::<f64>() / 20_000.0).sqrt()
            };
            let before = apart(with.channel(coupling.role));
            assert!(apart(&undone) < 0.1 * before, "{:?}: {} of {before}", coupling.role, apart(&undone));
        }
    }
}
