//! From the motion to the measured channels: gains, delays and the yaw of the mass. The simulated
//! rig and identification put it behind a specimen, so that simulated channels carry the
//! instruments' effects.

use super::{ModelError, ModelSpec, Response, system::System};

/// What the instruments do to the channels.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Instruments {
    /// Gain of the laser.
    pub laser_gain: f64,
    /// Delay of the laser, s.
    pub laser_delay_s: f64,
    /// Gains of the accelerometers.
    pub accelerometer_gains: [f64; 2],
    /// Delay of both accelerometers, s.
    pub accelerometer_delay_s: f64,
    /// Rotation of the mass.
    pub yaw: Option<Yaw>,
}

impl Default for Instruments {
    fn default() -> Self {
        Self {
            laser_gain: 1.0,
            laser_delay_s: 0.0,
            accelerometer_gains: [1.0; 2],
            accelerometer_delay_s: 0.0,
            yaw: None,
        }
    }
}

/// A rotational mode: y'' + 2 zeta w y' + w^2 y = -coupling A.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Yaw {
    /// Edge acceleration per acceleration of the mass.
    pub coupling: f64,
    /// w, rad/s.
    pub angular_frequency_rad_s: f64,
    /// zeta.
    pub damping_ratio: f64,
}

/// What the instruments say of one response.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Observation {
    /// Laser, m.
    pub relative_displacement_m: f64,
    /// First accelerometer, m/s2.
    pub mass_acceleration_1_m_s2: f64,
    /// Second accelerometer, m/s2.
    pub mass_acceleration_2_m_s2: f64,
}

/// Applies the instrument effects of a model, sample by sample; allocates only when built.
#[derive(Clone, Debug)]
pub struct Observer {
    instruments: Instruments,
    sample_period_s: f64,
    laser: DelayLine,
    accelerometers: [DelayLine; 2],
    yaw: Option<YawFilter>,
}

impl Observer {
    /// The observer of a model at a sample period (s).
    ///
    /// # Errors
    /// [`ModelError`] when the model is refused.
    pub fn new(spec: &ModelSpec, dt_s: f64) -> Result<Self, ModelError> {
        Ok(Self::from_instruments(System::compile(spec, dt_s)?.instruments, dt_s))
    }

    /// An observer with given instruments.
    pub fn from_instruments(instruments: Instruments, dt_s: f64) -> Self {
        Self {
            instruments,
            sample_period_s: dt_s,
            laser: DelayLine::new(instruments.laser_delay_s / dt_s),
            accelerometers: [(); 2].map(|()| DelayLine::new(instruments.accelerometer_delay_s / dt_s)),
            yaw: instruments.yaw.map(|yaw| YawFilter::new(yaw, dt_s)),
        }
    }

    /// Forgets the past.
    pub fn reset(&mut self) {
        self.laser.filled = 0;
        self.accelerometers.iter_mut().for_each(|line| line.filled = 0);
        if let Some(yaw) = &mut self.yaw {
            (yaw.state, yaw.last) = ([0.0; 2], 0.0);
        }
    }

    /// What the instruments say of the next response.
    pub fn observe(&mut self, response: &Response) -> Observation {
        let a = response.mass_acceleration_m_s2;
        let rotation = self.yaw.as_mut().map_or(0.0, |yaw| yaw.step(a));
        let d = [response.relative_displacement_m, response.relative_velocity_m_s];
        let dt = self.sample_period_s;
        let delayed_d = self
            .laser
            .push(d, |before, after, part| hermite(before[0], before[1] * dt, after[0], after[1] * dt, part));
        let straight =
            |before: [f64; 2], after: [f64; 2], part: f64| before[0] + part * (after[0] - before[0]);
        let first = self.accelerometers[0].push([a + rotation, 0.0], straight);
        let second = self.accelerometers[1].push([a - rotation, 0.0], straight);
        Observation {
            relative_displacement_m: self.instruments.laser_gain * delayed_d,
            mass_acceleration_1_m_s2: self.instruments.accelerometer_gains[0] * first,
            mass_acceleration_2_m_s2: self.instruments.accelerometer_gains[1] * second,
        }
    }
}

/// Cubic through two values and their slopes (per interval), at a part of the interval.
pub(crate) fn hermite(y0: f64, s0: f64, y1: f64, s1: f64, part: f64) -> f64 {
    let (u, w) = (part, 1.0 - part);
    y0 * (1.0 + 2.0 * u) * w * w + s0 * u * w * w + y1 * u * u * (3.0 - 2.0 * u) - s1 * u * u * w
}

/// A delay of any number of samples, whole or not; before its first value it repeats that value.
#[derive(Clone, Debug)]
struct DelayLine {
    values: Vec<[f64; 2]>,
    newest: usize,
    filled: usize,
    delay: f64,
}

impl DelayLine {
    fn new(delay: f64) -> Self {
        let delay = if delay.is_finite() { delay.clamp(0.0, 1e6) } else { 0.0 };
        Self { values: vec![[0.0; 2]; delay as usize + 2], newest: 0, filled: 0, delay }
    }

    /// Takes a value and returns the delayed one, `between` two kept values at a part of the interval.
    fn push(&mut self, value: [f64; 2], between: impl Fn([f64; 2], [f64; 2], f64) -> f64) -> f64 {
        if self.delay == 0.0 {
            return value[0];
        }
        let length = self.values.len();
        self.newest = (self.newest + 1) % length;
        self.values[self.newest] = value;
        if self.filled == 0 {
            self.values.fill([value[0], 0.0]);
            self.values[self.newest] = value;
        }
        self.filled = (self.filled + 1).min(length);
        let whole = self.delay as usize;
        let part = self.delay - whole as f64;
        let after = self.values[(self.newest + length - whole) % length];
        if part == 0.0 {
            return after[0];
        }
        let before = self.values[(self.newest + length - whole - 1) % length];
        between(before, after, 1.0 - part)
    }
}

/// The rotational mode, driven by A running linearly between samples, in closed form.
#[derive(Clone, Debug)]
struct YawFilter {
    yaw: Yaw,
    /// Transition over one sample, and what the value at its beginning and end add.
    transition: [[f64; 2]; 2],
    gain_old: [f64; 2],
    gain_new: [f64; 2],
    state: [f64; 2],
    last: f64,
}

impl YawFilter {
    fn new(yaw: Yaw, dt: f64) -> Self {
        let (w, z) = (yaw.angular_frequency_rad_s, yaw.damping_ratio.min(0.999));
        let (decay, wd) = (z * w, w * (1.0 - z * z).sqrt());
        let (e, s, c) = ((-decay * dt).exp(), (wd * dt).sin(), (wd * dt).cos());
        let transition =
            [[e * (c + decay / wd * s), e * s / wd], [-e * w * w * s / wd, e * (c - decay / wd * s)]];
        // Particular solution for the input p0 + p1 t: y = (p0 - 2 z p1 / w) / w^2 + p1 t / w^2.
        let reach = |p0: f64, p1: f64| {
            let (y0, v) = ((p0 - 2.0 * z * p1 / w) / (w * w), p1 / (w * w));
            let y1 = y0 + v * dt;
            [
                y1 - transition[0][0] * y0 - transition[0][1] * v,
                v - transition[1][0] * y0 - transition[1][1] * v,
            ]
        };
        let g = -yaw.coupling;
        let gain_old = reach(g, -g / dt);
        let gain_new = reach(0.0, g / dt);
        Self { yaw, transition, gain_old, gain_new, state: [0.0; 2], last: 0.0 }
    }

    /// Edge acceleration y'' at the next sample.
    fn step(&mut self, a: f64) -> f64 {
        let [y, v] = self.state;
        let next = |row: usize| {
            self.transition[row][0] * y
                + self.transition[row][1] * v
                + self.gain_old[row] * self.last
                + self.gain_new[row] * a
        };
        self.state = [next(0), next(1)];
        self.last = a;
        let (w, z) = (self.yaw.angular_frequency_rad_s, self.yaw.damping_ratio);
        -self.yaw.coupling * a - 2.0 * z * w * self.state[1] - w * w * self.state[0]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_delay_shifts_a_sine_by_its_time() {
        let (dt, w) = (1.0 / 2048.0, 12.0_f64);
        for delay_s in [0.0, 0.3 * dt, dt, 7.4 * dt] {
            let instruments = Instruments {
                laser_delay_s: delay_s,
                accelerometer_delay_s: delay_s,
                ..Instruments::default()
            };
            let mut observer = Observer::from_instruments(instruments, dt);
            for i in 0..200 {
                let t = f64::from(i) * dt;
                let seen = observer.observe(&Response {
                    relative_displacement_m: (w * t).sin(),
                    relative_velocity_m_s: w * (w * t).cos(),
                    mass_acceleration_m_s2: (w * t).cos(),
                    ..Response::default()
                });
                if i > 10 {
                    assert!((seen.relative_displacement_m - (w * (t - delay_s)).sin()).abs() < 1e-9);
                    assert!((seen.mass_acceleration_2_m_s2 - (w * (t - delay_s)).cos()).abs() < 1e-5);
                }
            }
        }
    }

    #[test]
    fn yaw_parts_the_accelerometers_by_its_transfer_function() {
        let (dt, w) = (1.0 / 2048.0, 2.0 * std::f64::consts::PI * 20.0);
        let yaw = Yaw { coupling: 0.06, angular_frequency_rad_s: w, damping_ratio: 0.05 };
        let mut observer =
            Observer::from_instruments(Instruments { yaw: Some(yaw), ..Instruments::default() }, dt);
        // At its own frequency y'' = coupling / (2 i zeta) A: amplitude 0.6 of A.
        let largest = (0..8192).fold(0.0_f64, |largest, i| {
            let a = (w * f64::from(i) * dt).sin();
            let seen = observer.observe(&Response { mass_acceleration_m_s2: a, ..Response::default() });
            let mean = 0.5 * (seen.mass_acceleration_1_m_s2 + seen.mass_acceleration_2_m_s2);
            assert!((mean - a).abs() < 1e-12);
            if i > 6000 { largest.max((seen.mass_acceleration_1_m_s2 - a).abs()) } else { largest }
        });
        assert!((largest - 0.6).abs() < 0.003, "{largest}");
    }
}
