//! A rotational mode in the difference of the two accelerometers on the mass: its ratio to their mean changes with frequency as
//! `w^2/(w0^2 - w^2 + 2 i zeta w0 w)` does, while a gain or a leak keeps it (or its share of the table's) constant. The kinematics
//! ask for it: where there is one, it passes for a gain of each accelerometer. Two channels that are read one after the other differ by the rate
//! of their mean as well, which a mode of much damping would make up for.

use super::{Accelerometer, Estimate, Instruments, Tolerances};
use crate::parallel;
use crate::record::Record;
use crate::record::mended::may_be_hum;
use crate::signal::{EASED, EASED_FOURTH, Spectrum};
use nalgebra::{Matrix4, SMatrix, SVector, Vector4};
use realfft::num_complex::Complex64;
use std::borrow::Cow;
use std::f64::consts::TAU;

/// Frequencies and damping ratios that the search begins from.
const FREQUENCIES: u32 = 48;
const DAMPINGS: [f64; 4] = [0.01, 0.03, 0.1, 0.3];
/// Rounds of the search about the best of them, its first width in frequency, and by how much it shrinks.
const ROUNDS: i32 = 24;
const WIDE: f64 = 0.12;
const SHRINKS: f64 = 0.8;
/// Largest damping ratio.
const MOST_DAMPED: f64 = 0.9;
/// Rounds in which the weights of the bins follow the mode.
const REWEIGHED: usize = 3;
/// Steps of Gauss-Newton at most, and how often one is halved.
const GAUSS_NEWTON: usize = 30;
const HALVED: i32 = 6;
/// Power in the mean over the noise of a bin that counts, and in the difference: a mode that blows on the bumpers set ringing may show where
/// the mean does not. How many bins are enough.
const STANDS_OUT: f64 = 100.0;
const DIFFERS: f64 = 25.0;
const FEWEST: usize = 64;
const MOST: usize = 20_000;
/// What a gain and a leak leave, over the noise, from which on a mode is looked for; share of that which it may leave.
const LEFT: f64 = 1.3;
const UNEXPLAINED: f64 = 0.3;
/// Variance of a coefficient told by eased spectra over that by plain ones.
const SHARED: f64 = EASED_FOURTH / (EASED * EASED);
/// Half the spacing of the accelerometers that an eccentricity is told for, m.
const HALF_SPACING_M: f64 = 0.5;

/// Frequency, rad/s, and damping ratio of a mode.
type Mode = (f64, f64);

/// Numbers of a difference: half of what the gains and the leaks are apart, strength of the mode, half of what the first accelerometer is later, s.
type Numbers = [f64; 4];

/// What is left of the power, with those.
type Fitted = (f64, Numbers);

/// A rotation of the mass about its vertical axis, with half of what the gains and the leaks of its accelerometers are apart beside it.
#[derive(Clone, Copy, Debug, Default)]
pub struct Yaw {
    /// Eccentricity of the mass, m, for accelerometers 1 m apart.
    pub eccentricity_m: Estimate,
    /// Frequency of the mode, Hz.
    pub frequency_hz: Estimate,
    /// Its damping ratio.
    pub damping_ratio: Estimate,
    /// Half of what the gains are apart, relative.
    pub(super) gains_apart: Estimate,
    /// Half of what the shares of the table's acceleration are apart.
    pub(super) leaks_apart: Estimate,
}

impl Yaw {
    /// Whether gains are told beside it to within their tolerance: far above its resonance, or below, a mode is much like a gain itself.
    pub fn tells_gains(&self, tolerances: Tolerances) -> bool {
        self.gains_apart.sigma < tolerances.accelerometer_gain
    }
}

impl Instruments {
    /// Takes up a rotation of the mass. What it adds to one accelerometer and takes from the other had passed for gains and leaks of theirs
    /// and, divided by those, stayed in their mean.
    pub(super) fn turned(self, yaw: Yaw, tolerances: Tolerances) -> Self {
        if !yaw.tells_gains(tolerances) {
            return Self { yaw: Some(yaw), ..self };
        }
        let [one, two] = self.accelerometers;
        let common = |one: Estimate, two: Estimate| Estimate {
            value: 0.5 * (one.value + two.value),
            sigma: 0.5 * (one.sigma + two.sigma),
        };
        let (gain, leak) = (common(one.gain, two.gain), common(one.leak, two.leak));
        let apart = |common: Estimate, apart: Estimate, by: f64| Estimate {
            value: common.value + by * apart.value,
            sigma: common.sigma.hypot(apart.sigma),
        };
        let of = |accelerometer: Accelerometer, sign: f64| Accelerometer {
            gain: apart(gain, yaw.gains_apart, sign * gain.value),
            leak: apart(leak, yaw.leaks_apart, sign),
            ..accelerometer
        };
        Self { accelerometers: [of(one, 1.0), of(two, -1.0)], yaw: Some(yaw), ..self }
    }
}

/// Finds the mode, if there is one; `noise` of each accelerometer, m/s2 rms.
pub(super) fn yaw(record: &Record, noise: &[f64; 2]) -> Option<Yaw> {
    let mut spectra = Spectra::of(record, noise)?;
    let (plain, _) = spectra.fit(None);
    let floor = spectra.noise_of_a_bin * spectra.bins.len() as f64;
    if plain < LEFT * floor {
        return None;
    }
    let mut best = spectra.refined(spectra.coarse(record.sample_rate_hz)?);
    let (mode, (_, mut x)) = best;
    let sigma = spectra.covariance(best)?[(5, 5)].max(0.0).sqrt();
    if !(Estimate { value: x[3], sigma }).is_late(0.0, record.sample_rate_hz) {
        // A delay in doubt would go with what the window makes of the mode's flanks.
        x[3] = 0.0;
        spectra.may_be_late = false;
        best = spectra.refined((mode, (spectra.left(Some(mode), x), x)));
    }
    let (mode, (left, x)) = best;
    // The mode has to explain most of what a gain and a leak do not.
    if (left - floor).max(0.0) > UNEXPLAINED * (plain - floor) {
        return None;
    }
    let covariance = spectra.covariance(best)?;
    if x[2] == 0.0 || ![mode.0, mode.1].iter().chain(&x).all(|number| number.is_finite()) {
        return None;
    }
    let told =
        |value: f64, per: f64, i: usize| Estimate { value, sigma: per * covariance[(i, i)].max(0.0).sqrt() };
    // y'' = H(w) (3 e / L) A with L half the spacing.
    let arm = HALF_SPACING_M / 3.0;
    let frequency_hz = mode.0 / TAU;
    Some(Yaw {
        eccentricity_m: told(x[2] * arm, arm, 2),
        frequency_hz: told(frequency_hz, frequency_hz, 3),
        damping_ratio: told(mode.1, mode.1, 4),
        gains_apart: told(x[0], 1.0, 0),
        leaks_apart: told(x[1], 1.0, 1),
    })
}

/// Half the difference and the mean of both accelerometers and the table's, eased at the ends.
struct Spectra {
    difference: Spectrum,
    mean: Spectrum,
    table: Spectrum,
    /// Bins with signal in the mean, where the response is known, or in the difference.
    bins: Vec<usize>,
    /// Power of the noise of the difference in one bin.
    noise_of_a_bin: f64,
    /// Whether one accelerometer may be read later than the other.
    may_be_late: bool,
}

impl Spectra {
    fn of(record: &Record, noise: &[f64; 2]) -> Option<Self> {
        let n = record.mass_acceleration_1_m_s2.len();
        if record.mass_acceleration_2_m_s2.len() != n || n < 1024 {
            return None;
        }
        let rate = record.sample_rate_hz;
        let half_of = |of: &dyn Fn(f64, f64) -> f64| -> Vec<f64> {
            let pair = record.mass_acceleration_1_m_s2.iter().zip(&record.mass_acceleration_2_m_s2);
            pair.map(|(a, b)| 0.5 * of(*a, *b)).collect()
        };
        // Eased at the ends: what one noisy sample there stands for beyond it would be several times the noise at low frequencies. A window
        // that grows or falls all along has the mode ring down slower or faster by as much.
        let channels = [
            Cow::from(half_of(&|a, b| a - b)),
            Cow::from(half_of(&|a, b| a + b)),
            Cow::from(&record.table_acceleration_m_s2),
        ];
        let eased = |channel: &Cow<'_, [f64]>| Spectrum::eased(channel, rate);
        let [difference, mean, table] = parallel::map(&channels, parallel::cores(), eased).try_into().ok()?;
        let of_difference = 0.25 * (noise[0].powi(2) + noise[1].powi(2)) * EASED;
        let noise_of_a_bin = of_difference * n as f64;
        let bins: Vec<usize> = difference
            .band(0.05, 0.3 * rate)
            .filter(|&b| !may_be_hum(difference.omega_rad_s(b) / TAU))
            .filter(|&b| {
                mean.bins[b].norm_sqr() > STANDS_OUT * noise_of_a_bin
                    || difference.bins[b].norm_sqr() > DIFFERS * noise_of_a_bin
            })
            .collect();
        if bins.len() < FEWEST {
            return None;
        }
        let stride = bins.len().div_ceil(MOST);
        let bins = bins.into_iter().step_by(stride).collect();
        Some(Self { difference, mean, table, bins, noise_of_a_bin, may_be_late: true })
    }

    /// With gains 1 +- g, A1 = (1 + g) (A + y'') and A2 = (1 - g) (A - y''), the first dt later and the second dt earlier: half their difference over
    /// their mean is (g + s H - i w dt) / (1 + g s H); what one leaks of the table more than the other comes on top. The mean is as noisy as the difference: a bin
    /// weighs as much less as the mode amplifies that (errors in both: Deming 1943).
    fn fit(&self, mode: Option<Mode>) -> Fitted {
        let mut x = [0.0; 4];
        for _ in 0..REWEIGHED {
            let mut normal = Matrix4::<f64>::zeros();
            let mut right = Vector4::<f64>::zeros();
            for &b in &self.bins {
                let h = self.mode(mode, b);
                let later = self.later(b);
                let of_mean = share((h, later), x);
                let weight = 1.0 / (1.0 + of_mean.norm_sqr());
                let (mean, table) = (self.mean.bins[b], self.table.bins[b]);
                let columns = [mean, table, h * mean, later * mean];
                // What the difference has of the mean's share of the mode.
                let target = self.difference.bins[b] * (Complex64::ONE + h * (x[0] * x[2]));
                for i in 0..4 {
                    for j in 0..4 {
                        normal[(i, j)] += weight * (columns[i].conj() * columns[j]).re;
                    }
                    right[i] += weight * (columns[i].conj() * target).re;
                }
            }
            for i in 0..4 {
                normal[(i, i)] += (1e-12 * normal[(i, i)]).max(1e-300);
            }
            x = normal.cholesky().map(|c| c.solve(&right)).unwrap_or_default().into();
        }
        (self.left(mode, x), x)
    }

    /// A mode's response at a bin, that of none nothing.
    fn mode(&self, mode: Option<Mode>, bin: usize) -> Complex64 {
        let w = self.difference.omega_rad_s(bin);
        mode.map_or(Complex64::ZERO, |mode| Complex64::from(w * w) / below(mode, w))
    }

    /// What being later, by a second, does to a channel at a bin, to first order; nothing where none may be.
    fn later(&self, bin: usize) -> Complex64 {
        let w = if self.may_be_late { self.difference.omega_rad_s(bin) } else { 0.0 };
        Complex64::new(0.0, -w)
    }

    /// Covariance of the numbers of a fit, in the order of their slopes.
    fn covariance(&self, (mode, (left, x)): (Mode, Fitted)) -> Option<SMatrix<f64, 6, 6>> {
        // A bin's noise lies half in its real part; easing has neighbouring bins share theirs.
        let noise = 0.5 * SHARED * left / self.bins.len() as f64;
        Some(self.slopes(mode, x).0.try_inverse()? * noise)
    }

    /// Power that those numbers leave, each bin by its weight.
    fn left(&self, mode: Option<Mode>, x: Numbers) -> f64 {
        let of = |&b: &usize| {
            let of_mean = share((self.mode(mode, b), self.later(b)), x);
            let left = self.difference.bins[b] - of_mean * self.mean.bins[b] - self.table.bins[b] * x[1];
            left.norm_sqr() / (1.0 + of_mean.norm_sqr())
        };
        self.bins.iter().map(of).sum()
    }

    /// The best mode of a coarse search over all frequencies.
    fn coarse(&self, rate: f64) -> Option<(Mode, Fitted)> {
        let (low, high) = (self.difference.omega_rad_s(*self.bins.first()?), 0.4 * TAU * rate);
        let mut best: Option<(Mode, Fitted)> = None;
        let try_out = |best: &mut Option<(Mode, Fitted)>, mode: Mode| {
            let fitted = self.fit(Some(mode));
            if best.as_ref().is_none_or(|(_, (left, _))| fitted.0 < *left) {
                *best = Some((mode, fitted));
            }
        };
        for i in 0..=FREQUENCIES {
            let w0 = low * (high / low).powf(f64::from(i) / f64::from(FREQUENCIES));
            DAMPINGS.into_iter().for_each(|zeta| try_out(&mut best, (w0, zeta)));
        }
        for round in 0..ROUNDS {
            let (w0, zeta) = best.as_ref()?.0;
            let by = WIDE * SHRINKS.powi(round);
            for (w0, zeta) in [
                (w0 * (1.0 + by), zeta),
                (w0 * (1.0 - by), zeta),
                (w0, (zeta * (1.0 + 4.0 * by)).min(MOST_DAMPED)),
                (w0, zeta / (1.0 + 4.0 * by)),
            ] {
                try_out(&mut best, (w0, zeta));
            }
        }
        best
    }

    /// Frequency and damping pull on each other and on the strength: Gauss-Newton steps of all, halved where they lead astray.
    fn refined(&self, mut best: (Mode, Fitted)) -> (Mode, Fitted) {
        for _ in 0..GAUSS_NEWTON {
            let ((w0, zeta), (before, x)) = best;
            let (information, pull) = self.slopes((w0, zeta), x);
            let Some(inverse) = information.try_inverse() else { break };
            let step = inverse * pull;
            let better = (0..HALVED).map(|k| 0.5_f64.powi(k)).find_map(|share| {
                let times = |i: usize| (share * step[i]).clamp(-1.0, 1.0).exp();
                let mode = (w0 * times(3), (zeta * times(4)).min(MOST_DAMPED));
                let x = [(0, 0), (1, 1), (2, 2), (3, 5)].map(|(i, j)| x[i] + share * step[j]);
                let left = self.left(Some(mode), x);
                (left < before).then_some((mode, (left, x)))
            });
            let Some(better) = better else { break };
            best = better;
            if before - best.1.0 < 1e-3 * self.noise_of_a_bin {
                break;
            }
        }
        best
    }

    /// Information along gain, leak, strength, the logarithms of the mode's frequency and damping, and the delay, and what pulls along them.
    /// Below a resonance frequency and damping go with the strength.
    fn slopes(&self, (w0, zeta): Mode, x: Numbers) -> (SMatrix<f64, 6, 6>, SVector<f64, 6>) {
        let mut information = SMatrix::<f64, 6, 6>::zeros();
        let mut pull = SVector::<f64, 6>::zeros();
        let [gain, leak, strength, late] = x;
        for &b in &self.bins {
            let w = self.difference.omega_rad_s(b);
            let below = below((w0, zeta), w);
            let h = Complex64::from(w * w) / below;
            let along_w0 = -h * Complex64::new(2.0 * w0 * w0, 2.0 * zeta * w0 * w) / below;
            let along_zeta = -h * Complex64::new(0.0, 2.0 * zeta * w0 * w) / below;
            let later = self.later(b);
            let of_mean = share((h, later), x);
            let beneath = Complex64::ONE + h * (gain * strength);
            let square = beneath.powi(2);
            let by_mode = (Complex64::from(1.0 - gain * gain) - later * (late * gain)) / square;
            let along_mean = [
                (Complex64::ONE - (h * strength).powi(2) - h * later * (strength * late)) / square,
                Complex64::ZERO,
                by_mode * h,
                by_mode * along_w0 * strength,
                by_mode * along_zeta * strength,
                later / beneath,
            ];
            let mut slopes = along_mean.map(|along| along * self.mean.bins[b]);
            slopes[1] = self.table.bins[b];
            let left = self.difference.bins[b] - of_mean * self.mean.bins[b] - self.table.bins[b] * leak;
            // The weight follows, too.
            let weight = 1.0 / (1.0 + of_mean.norm_sqr());
            for i in 0..6 {
                let of_weight = (of_mean.conj() * along_mean[i]).re;
                pull[i] += weight * ((slopes[i].conj() * left).re + of_weight * weight * left.norm_sqr());
                for j in 0..6 {
                    information[(i, j)] += weight * (slopes[i].conj() * slopes[j]).re;
                }
            }
        }
        if !self.may_be_late {
            // It stays where it is.
            information[(5, 5)] = 1.0;
        }
        (information, pull)
    }
}

/// Share of the mean in half the difference: a mode's response, what being later does, and the numbers of a fit given.
fn share((h, later): (Complex64, Complex64), [gain, _, strength, late]: Numbers) -> Complex64 {
    (h * strength + gain + later * late) / (Complex64::ONE + h * (gain * strength))
}

/// The denominator of a mode's response.
fn below((w0, zeta): Mode, w: f64) -> Complex64 {
    Complex64::new(w0 * w0 - w * w, 2.0 * zeta * w0 * w)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::record::Kind;
    use rand::{SeedableRng, prelude::Distribution};

    #[test]
    fn a_mode_that_a_sweep_passes_early_is_told_as_it_is_by_sensors_whose_gains_differ() {
        let (rate, seconds, w0, zeta, strength) = (2048.0, 60.0, TAU * 23.0, 0.066, 0.4);
        // Through the mode a quarter of the way; as sweeps do, it swells and ebbs.
        let swells = |t: f64| (0.3 * t.min(seconds - t)).clamp(0.0, 1.0).powi(2);
        let shaken = |t: f64| swells(t) * (TAU * (18.0 + 10.0 * t / seconds) * t).sin();
        let slope = |t: f64, [y, v]: [f64; 2]| [v, -strength * shaken(t) - 2.0 * zeta * w0 * v - w0 * w0 * y];
        let (mut state, dt) = ([0.0; 2], 1.0 / rate);
        let mut random = rand_pcg::Pcg64::seed_from_u64(1);
        let hiss = rand_distr::Normal::new(0.0, 0.003).expect("valid");
        let mut record = Record::empty("sweep", Kind::Base, rate);
        for i in 0..(seconds * rate) as usize {
            let t = i as f64 * dt;
            let (a, turned) = (shaken(t), slope(t, state)[1]);
            record.mass_acceleration_1_m_s2.push(1.005 * (a + turned) + hiss.sample(&mut random));
            record.mass_acceleration_2_m_s2.push(0.995 * (a - turned) + hiss.sample(&mut random));
            record.table_acceleration_m_s2.push(hiss.sample(&mut random));
            // Runge and Kutta's classical step.
            let on = |by: f64, k: [f64; 2]| [state[0] + by * k[0], state[1] + by * k[1]];
            let k1 = slope(t, state);
            let k2 = slope(t + 0.5 * dt, on(0.5 * dt, k1));
            let k3 = slope(t + 0.5 * dt, on(0.5 * dt, k2));
            let k4 = slope(t + dt, on(dt, k3));
            state = [0, 1].map(|i| state[i] + dt / 6.0 * (k1[i] + 2.0 * (k2[i] + k3[i]) + k4[i]));
        }
        let found = yaw(&record, &[0.003; 2]).expect("a mode");
        let off = |told: Estimate, truth: f64| (told.value / truth - 1.0).abs();
        assert!(off(found.damping_ratio, zeta) < 5e-4, "{found:?}");
        assert!(off(found.frequency_hz, 23.0) < 5e-5, "{found:?}");
        assert!(off(found.eccentricity_m, strength * HALF_SPACING_M / 3.0) < 5e-4, "{found:?}");
        assert!(off(found.gains_apart, 0.005) < 0.02, "{found:?}");
        // They are taken up, but for those that it leaves open.
        let gains = |yaw: Yaw| {
            let mut sound = Instruments::assumed_sound(&record);
            sound.accelerometers[0].gain.value = 1.02;
            sound.turned(yaw, Tolerances::default()).accelerometers.map(|of| of.gain.value)
        };
        let [one, two] = gains(found);
        assert!((one - 1.01 * 1.005).abs() < 1e-4 && (two - 1.01 * 0.995).abs() < 1e-4, "{one} {two}");
        let open = Estimate { value: 0.5, sigma: 0.3 };
        assert_eq!(gains(Yaw { gains_apart: open, ..found }), [1.02, 1.0]);
    }

    #[test]
    fn channels_that_are_read_one_after_the_other_are_no_mode() {
        // Made up for by one of the largest damping, from a hundredth of a sample on.
        let mut random = rand_pcg::Pcg64::seed_from_u64(2);
        let hiss = rand_distr::Normal::new(0.0, 1e-3).expect("valid");
        let a = |t: f64| {
            (1..60).map(|k| 0.3 * (TAU * 0.41 * f64::from(k) * t + f64::from(k * k)).sin()).sum::<f64>()
        };
        for late_s in [0.0, 22e-6, 2e-4] {
            let mut record = Record::empty("noise", Kind::Base, 800.0);
            for i in 0..8000 {
                let t = f64::from(i) / 800.0;
                record.mass_acceleration_1_m_s2.push(1.001 * a(t - late_s) + hiss.sample(&mut random));
                record.mass_acceleration_2_m_s2.push(a(t) + hiss.sample(&mut random));
                record.table_acceleration_m_s2.push(hiss.sample(&mut random));
            }
            let found = yaw(&record, &[1e-3; 2]);
            assert!(found.is_none(), "{late_s}: {found:?}");
        }
    }
}
