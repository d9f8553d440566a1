//! Instruments and DAQ of the simulated rig: anti-aliasing, delay, gain, zero, noise, quantisation.

use super::spec::SensorSpec;
use crate::stream::Channels;
use rand_distr::{Distribution, StandardNormal};
use rand_pcg::Pcg64Mcg;

/// True motion at one instant, before any instrument.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Motion {
    pub(super) table_displacement_m: f64,
    pub(super) table_acceleration_m_s2: f64,
    pub(super) mass_acceleration_1_m_s2: f64,
    pub(super) mass_acceleration_2_m_s2: f64,
    pub(super) relative_displacement_m: f64,
}

/// Number of channels, in the order of [`Motion`].
const CHANNELS: usize = 5;

/// Second-order Butterworth low-pass (bilinear transform), transposed direct form II.
#[derive(Clone, Copy, Debug)]
struct LowPass {
    b: [f64; 3],
    a: [f64; 2],
    s: [f64; 2],
}

impl LowPass {
    fn new(corner_hz: f64, rate_hz: f64) -> Self {
        let k = (std::f64::consts::PI * corner_hz / rate_hz).tan();
        let norm = 1.0 / (1.0 + std::f64::consts::SQRT_2 * k + k * k);
        let b0 = k * k * norm;
        Self {
            b: [b0, 2.0 * b0, b0],
            a: [2.0 * (k * k - 1.0) * norm, (1.0 - std::f64::consts::SQRT_2 * k + k * k) * norm],
            s: [0.0; 2],
        }
    }

    fn step(&mut self, x: f64) -> f64 {
        let y = self.b[0] * x + self.s[0];
        self.s[0] = self.b[1] * x - self.a[0] * y + self.s[1];
        self.s[1] = self.b[2] * x - self.a[1] * y;
        y
    }
}

/// Fractional delay at the integration rate, linear between points.
struct Delay {
    line: Vec<f64>,
    at: usize,
    whole: usize,
    part: f64,
}

impl Delay {
    fn new(delay_s: f64, rate_hz: f64) -> Self {
        let steps = delay_s.max(0.0) * rate_hz;
        let whole = steps.floor() as usize;
        Self { line: vec![0.0; whole + 2], at: 0, whole, part: steps - steps.floor() }
    }

    fn step(&mut self, x: f64) -> f64 {
        let n = self.line.len();
        self.at = (self.at + 1) % n;
        self.line[self.at] = x;
        let near = self.line[(self.at + n - self.whole) % n];
        let far = self.line[(self.at + n - self.whole - 1) % n];
        near + self.part * (far - near)
    }
}

/// One channel's way from volts to number.
#[derive(Clone, Copy, Debug)]
struct Digitiser {
    gain: f64,
    offset: f64,
    noise: f64,
    range: f64,
    resolution: f64,
}

/// The instruments of the rig, seeded.
pub(super) struct Sensors {
    filters: [LowPass; CHANNELS],
    delays: [Option<Delay>; CHANNELS],
    digitisers: [Digitiser; CHANNELS],
    filtered: [f64; CHANNELS],
    random: Pcg64Mcg,
}

impl Sensors {
    pub(super) fn new(spec: &SensorSpec, sample_rate_hz: f64, substeps: u32, random: Pcg64Mcg) -> Self {
        let rate = sample_rate_hz * f64::from(substeps.max(1));
        // With one substep a period there is nothing above the Nyquist frequency to hold back.
        let corner = spec.anti_aliasing * sample_rate_hz;
        let delay = |delay_s: f64| (delay_s > 0.0).then(|| Delay::new(delay_s, rate));
        let accelerometer = |index: usize| Digitiser {
            gain: spec.accelerometer_gain[index],
            offset: spec.accelerometer_offset_m_s2[index],
            noise: spec.accelerometer_noise_m_s2,
            range: spec.accelerometer_range_m_s2,
            resolution: 2.0 * spec.accelerometer_range_m_s2 / 2f64.powi(spec.accelerometer_bits as i32),
        };
        let transducer = |gain: f64, offset: f64, noise: f64| Digitiser {
            gain,
            offset,
            noise,
            range: spec.displacement_range_m,
            resolution: 2.0 * spec.displacement_range_m / 2f64.powi(spec.displacement_bits as i32),
        };
        Self {
            filters: [LowPass::new(corner, rate); CHANNELS],
            delays: [
                None,
                delay(spec.accelerometer_delay_s),
                delay(spec.accelerometer_delay_s),
                delay(spec.accelerometer_delay_s),
                delay(spec.laser_delay_s),
            ],
            digitisers: [
                transducer(1.0, 0.0, spec.table_displacement_noise_m),
                accelerometer(0),
                accelerometer(1),
                accelerometer(2),
                transducer(spec.laser_gain, spec.laser_offset_m, spec.laser_noise_m),
            ],
            filtered: [0.0; CHANNELS],
            random,
        }
    }

    /// Follows the motion at the integration rate.
    pub(super) fn follow(&mut self, motion: &Motion) {
        let values = [
            motion.table_displacement_m,
            motion.table_acceleration_m_s2,
            motion.mass_acceleration_1_m_s2,
            motion.mass_acceleration_2_m_s2,
            motion.relative_displacement_m,
        ];
        for (channel, value) in values.into_iter().enumerate() {
            let late = self.delays[channel].as_mut().map_or(value, |delay| delay.step(value));
            self.filtered[channel] = self.filters[channel].step(late);
        }
    }

    /// Takes a sample; the flag tells whether an input was out of range.
    pub(super) fn sample(&mut self) -> (Channels, bool) {
        let mut out = [0.0; CHANNELS];
        let mut overrange = false;
        for ((digitiser, &value), out) in self.digitisers.iter().zip(&self.filtered).zip(&mut out) {
            let noise: f64 = StandardNormal.sample(&mut self.random);
            let analog = digitiser.gain * value + digitiser.offset + digitiser.noise * noise;
            overrange |= analog.abs() > digitiser.range;
            let held = analog.clamp(-digitiser.range, digitiser.range);
            *out = (held / digitiser.resolution).round() * digitiser.resolution;
        }
        let channels = Channels {
            table_displacement_m: out[0],
            table_acceleration_m_s2: out[1],
            mass_acceleration_1_m_s2: out[2],
            mass_acceleration_2_m_s2: out[3],
            relative_displacement_m: out[4],
        };
        (channels, overrange)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;

    #[test]
    fn noise_has_the_stated_rms_and_values_lie_on_the_grid() {
        let spec = SensorSpec::default();
        let mut sensors = Sensors::new(&spec, 2048.0, 4, Pcg64Mcg::seed_from_u64(1));
        let n = 20_000;
        let resolution = 2.0 * spec.displacement_range_m / 2f64.powi(spec.displacement_bits as i32);
        let mut square = 0.0;
        for _ in 0..n {
            let (channels, overrange) = sensors.sample();
            assert!(!overrange);
            let steps = channels.relative_displacement_m / resolution;
            assert!((steps - steps.round()).abs() < 1e-6);
            square += channels.relative_displacement_m.powi(2);
        }
        let rms = (square / f64::from(n)).sqrt();
        assert!((rms / spec.laser_noise_m - 1.0).abs() < 0.02, "rms {rms} m");
    }

    #[test]
    fn delay_and_gain_act_on_their_channel() {
        let spec = SensorSpec {
            laser_noise_m: 0.0,
            laser_gain: 1.02,
            laser_delay_s: 2.5e-3,
            accelerometer_noise_m_s2: 0.0,
            displacement_bits: 32,
            ..SensorSpec::default()
        };
        let rate = 2048.0 * 4.0;
        let mut sensors = Sensors::new(&spec, 2048.0, 4, Pcg64Mcg::seed_from_u64(1));
        let slope = 0.01;
        for k in 0..4000 {
            let value = slope * f64::from(k) / rate;
            let motion =
                Motion { relative_displacement_m: value, table_displacement_m: value, ..Motion::default() };
            sensors.follow(&motion);
        }
        // The anti-aliasing filter delays both channels alike; the laser comes 2.5 ms later.
        let late = sensors.filtered[0] - sensors.filtered[4];
        assert!((late - slope * 2.5e-3).abs() < 1e-9, "{late}");
        let (channels, _) = sensors.sample();
        assert!((channels.relative_displacement_m - 1.02 * sensors.filtered[4]).abs() < 1e-9);
    }
}
