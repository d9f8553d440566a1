//! A model compiled for the solvers: the base model's numbers, the contact law, and the terms that
//! effects add. Effects write into it once, at construction; the solvers read it.

use super::contact::ContactLaw;
use super::cubic::Cubic;
use super::observe::Instruments;
use super::{ModelError, ModelSpec, effects};

/// Where a term is evaluated: time, motion of its element, table acceleration, penetrations.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Point {
    /// Time since reset, s.
    pub time_s: f64,
    /// Relative displacement of the mass, or of the isolator behind a joint, m.
    pub displacement_m: f64,
    /// Its rate, m/s.
    pub velocity_m_s: f64,
    /// Table acceleration, m/s2.
    pub table_acceleration_m_s2: f64,
    /// Penetration of the right bumper, 0 when it is not reached, m.
    pub penetration_right_m: f64,
    /// Penetration of the left bumper, m.
    pub penetration_left_m: f64,
}

impl Point {
    /// d, v, a, p_r, p_l, t.
    pub(super) fn variables(&self) -> [f64; 6] {
        [
            self.displacement_m,
            self.velocity_m_s,
            self.table_acceleration_m_s2,
            self.penetration_right_m,
            self.penetration_left_m,
            self.time_s,
        ]
    }
}

/// Carries u' = v - u/tau over one sample period in closed form along the cubic through displacement and velocity at both its ends.
#[derive(Clone, Copy, Debug)]
pub struct Relaxation {
    decay: f64,
    /// Weights of v at the beginning and at the end, and of what its mean is more than theirs.
    weights: [f64; 3],
}

impl Relaxation {
    /// For a rate 1/tau (1/s) and a sample period (s).
    pub fn new(rate: f64, period_s: f64) -> Self {
        let x = rate * period_s;
        let decay = (-x).exp();
        // Integrals of exp(-rate (period - t)) times 1, s = t / period and s (1 - s); series where x is small.
        let (one, ramp) = if x < 1e-3 {
            (1.0 - x / 2.0 + x * x / 6.0, 0.5 - x / 6.0 + x * x / 24.0)
        } else {
            let one = (1.0 - decay) / x;
            (one, (1.0 - one) / x)
        };
        let bulge = if x < 0.05 {
            1.0 / 6.0 - x * (1.0 / 12.0 - x * (1.0 / 40.0 - x / 180.0))
        } else {
            (x - 2.0 + (x + 2.0) * decay) / x.powi(3)
        };
        Self { decay, weights: [one - ramp, ramp, 6.0 * bulge].map(|weight| period_s * weight) }
    }

    /// The state one sample period later.
    pub fn after(&self, state: f64, course: &Cubic) -> f64 {
        let [start, end, bulge] = self.weights;
        self.decay * state + start * course.from.1 + end * course.to.1 + bulge * course.bulge_m_s()
    }
}

/// A force that an effect adds.
pub trait Term: Send {
    /// How many states it integrates.
    fn states(&self) -> usize {
        0
    }

    /// Its force, N (opposing positive displacement is positive), and the rates of its states.
    fn force(&self, at: &Point, state: &[f64], rate: &mut [f64]) -> f64;

    /// Carries its states over one sample period along the course of an imposed motion: in closed form or by small
    /// steps of its own, since an imposed motion needs no step control. Called for terms with states.
    fn follow(&self, _course: &Cubic, _state: &mut [f64]) {}

    /// Its states forget by a power law; they depend on the motion alone, not on what the term's parameters are.
    fn remembers(&self) -> bool {
        false
    }

    /// Needs reversals of the motion as events.
    fn turns(&self) -> bool {
        false
    }

    /// Forgets a reversal of the motion only when this goes beyond it: all of them count, however long ago.
    fn retraces(&self) -> bool {
        false
    }

    /// The motion has come to this displacement, monotonically since the last call.
    fn commit(&mut self, _displacement_m: f64) {}

    /// Forgets everything.
    fn reset(&mut self) {}

    /// Stiffness it adds at small amplitudes, N/m.
    fn tangent_n_m(&self) -> f64 {
        0.0
    }
}

/// Exponential loss of stiffness.
#[derive(Clone, Copy, Debug)]
pub struct Degradation {
    /// Share lost in the end.
    pub delta: f64,
    /// 1/tau, 1/s.
    pub rate: f64,
}

/// Mass, spring and dashpot under one bumper.
#[derive(Clone, Copy, Debug)]
pub struct Stand {
    /// N/m.
    pub stiffness_n_m: f64,
    /// kg.
    pub mass_kg: f64,
    /// N s/m.
    pub damping_n_s_m: f64,
    /// One sample period of its motion alone, and with a linear bumper pressed against it.
    sampled: [Oscillation; 2],
    /// That period, s.
    period_s: f64,
}

impl Stand {
    /// A stand under a bumper of the given law, for a sample period (s).
    pub fn new(
        stiffness_n_m: f64,
        mass_kg: f64,
        damping_n_s_m: f64,
        law: &ContactLaw,
        period_s: f64,
    ) -> Self {
        let sampled = [Oscillation::default(); 2];
        let mut stand = Self { stiffness_n_m, mass_kg, damping_n_s_m, sampled, period_s };
        stand.sampled = [false, true].map(|pressed| stand.oscillation(pressed, law, period_s));
        stand
    }

    /// Its motion alone over some time, s, or with a linear bumper pressed against it.
    pub fn alone(&self, pressed: bool, law: &ContactLaw, during_s: f64) -> Oscillation {
        if during_s == self.period_s {
            return self.sampled[usize::from(pressed)];
        }
        self.oscillation(pressed, law, during_s)
    }

    fn oscillation(&self, pressed: bool, law: &ContactLaw, during_s: f64) -> Oscillation {
        let (k, c) = if pressed { (law.linear_n_m, law.damping_n_s_m) } else { (0.0, 0.0) };
        let over_mass = |own: f64, more: f64| (own + more) / self.mass_kg;
        Oscillation::new(over_mass(self.stiffness_n_m, k), over_mass(self.damping_n_s_m, c), during_s)
    }
}

/// Some time of u'' + c u' + k u = f in closed form, f running linearly.
#[derive(Clone, Copy, Debug, Default)]
pub struct Oscillation {
    /// (u, u') at the end by u, u', f at the beginning, f at the end.
    rows: [[f64; 4]; 2],
}

impl Oscillation {
    /// For k (1/s2), c (1/s) and some time (s), which may be next to nothing.
    pub fn new(k: f64, c: f64, during_s: f64) -> Self {
        let h = during_s;
        // States u, h u', h2 f and its rise, of one magnitude however short the time: the exponential of the augmented matrix.
        #[rustfmt::skip]
        let e = nalgebra::Matrix4::new(
            0.0, 1.0, 0.0, 0.0,
            -k * h * h, -c * h, 1.0, 0.0,
            0.0, 0.0, 0.0, 1.0,
            0.0, 0.0, 0.0, 0.0,
        )
        .exp();
        let rows = [(0, 1.0), (1, 1.0 / h)].map(|(i, over)| {
            let end = e[(i, 3)] * h * h;
            [e[(i, 0)], e[(i, 1)] * h, e[(i, 2)] * h * h - end, end].map(|of| of * over)
        });
        Self { rows }
    }

    /// u and u' at the end of it, from the forces at both ends (m/s2).
    pub fn after(&self, u: f64, rate: f64, f0: f64, f1: f64) -> (f64, f64) {
        let at = |row: &[f64; 4]| row[0] * u + row[1] * rate + row[2] * f0 + row[3] * f1;
        (at(&self.rows[0]), at(&self.rows[1]))
    }
}

/// A friction that falls off with velocity: N exp(-(v/vs)^delta).
#[derive(Clone, Copy, Debug, Default)]
pub struct Fall {
    /// What falls off, N.
    pub force_n: f64,
    /// 1/vs2, s2/m2.
    pub per_square_s2_m2: f64,
    /// Half of its exponent, delta/2.
    pub half_exponent: f64,
}

impl Fall {
    /// What is left of it at a speed, N.
    fn at(&self, speed_m_s: f64) -> f64 {
        let square = speed_m_s * speed_m_s * self.per_square_s2_m2;
        let power = if self.half_exponent == 1.0 { square } else { square.powf(self.half_exponent) };
        self.force_n * (-power).exp()
    }
}

/// Dry friction: sliding, breakaway, and the velocity over which one falls to the other.
#[derive(Clone, Copy, Debug, Default)]
pub struct Friction {
    /// Sliding force at speed, N.
    pub sliding_n: f64,
    /// Breakaway force, N.
    pub breakaway_n: f64,
    /// What falls off with velocity.
    pub fall: [Fall; 2],
    /// How many entries of `fall` are in use.
    pub falls: usize,
}

impl Friction {
    /// Force while sliding at a speed, N.
    pub fn at(&self, speed_m_s: f64) -> f64 {
        self.sliding_n + self.fall[..self.falls].iter().map(|fall| fall.at(speed_m_s)).sum::<f64>()
    }
}

/// A model compiled for the solvers.
pub struct System {
    /// Sample period, s.
    pub sample_period_s: f64,
    /// Mass, kg.
    pub mass_kg: f64,
    /// Slopes, N/m.
    pub slopes_n_m: Vec<f64>,
    /// Breakpoints, m.
    pub knees_m: Vec<f64>,
    /// Force at d = 0 of the line of each slope on the positive side, N.
    pub intercepts_n: Vec<f64>,
    /// Viscous damping, N s/m.
    pub damping_n_s_m: f64,
    /// Loss of stiffness with time.
    pub degradation: Option<Degradation>,
    /// Dry friction; `None` without.
    pub friction: Option<Friction>,
    /// Constant force, N.
    pub constant_n: f64,
    /// There are bumpers.
    pub has_bumper: bool,
    /// Law of either bumper.
    pub bumper: ContactLaw,
    /// Right gap, m.
    pub gap_right_m: f64,
    /// Left gap, m.
    pub gap_left_m: f64,
    /// Stands that give way.
    pub stand: Option<Stand>,
    /// Inverse effective mass of the table, 1/kg.
    pub table_inverse_mass_1_kg: f64,
    /// Half the play of the joint, m.
    pub joint_half_width_m: Option<f64>,
    /// Terms of the isolator, behind the joint if there is one.
    pub isolator_terms: Vec<Box<dyn Term>>,
    /// Terms that act on the mass itself.
    pub mass_terms: Vec<Box<dyn Term>>,
    /// What the instruments do to the channels.
    pub instruments: Instruments,
}

impl System {
    /// Compiles a checked model.
    ///
    /// # Errors
    /// [`ModelError`] where the model file would be refused, or effects exclude each other.
    pub fn compile(spec: &ModelSpec, sample_period_s: f64) -> Result<Self, ModelError> {
        use crate::config::Check;
        if !(sample_period_s.is_finite() && sample_period_s > 0.0) {
            return Err(ModelError::SamplePeriod { dt_s: sample_period_s });
        }
        spec.check().map_err(|(key, reason)| ModelError::Invalid { key, reason })?;
        let (slopes, knees) = (spec.isolator.stiffness_n_m.clone(), spec.isolator.breakpoints_m.clone());
        let mut intercepts_n = vec![0.0; slopes.len()];
        for i in 1..slopes.len() {
            intercepts_n[i] = intercepts_n[i - 1] + (slopes[i - 1] - slopes[i]) * knees[i - 1];
        }
        let gap = spec.bumper.as_ref().map_or(f64::INFINITY, |b| 0.5 * b.total_gap_m);
        let mut system = Self {
            sample_period_s,
            mass_kg: spec.mass_kg,
            slopes_n_m: slopes,
            knees_m: knees,
            intercepts_n,
            damping_n_s_m: spec.isolator.damping_n_s_m,
            degradation: None,
            friction: None,
            constant_n: 0.0,
            has_bumper: spec.bumper.is_some(),
            bumper: ContactLaw::linear(spec.bumper.as_ref()),
            gap_right_m: gap,
            gap_left_m: gap,
            stand: None,
            table_inverse_mass_1_kg: 0.0,
            joint_half_width_m: None,
            isolator_terms: Vec::new(),
            mass_terms: Vec::new(),
            instruments: Instruments::default(),
        };
        effects::install_all(spec, &mut system)?;
        Ok(system)
    }

    /// Adds dry friction to what is there already; what breakaway takes more than sliding falls off with the velocity over that of Stribeck
    /// to the power of `exponent`.
    pub fn add_friction(
        &mut self,
        sliding_n: f64,
        breakaway_n: f64,
        stribeck_velocity_m_s: f64,
        exponent: f64,
    ) {
        let friction = self.friction.get_or_insert_default();
        friction.sliding_n += sliding_n;
        friction.breakaway_n += breakaway_n;
        if breakaway_n > sliding_n && stribeck_velocity_m_s.is_finite() {
            let slot = friction.falls.min(1);
            friction.fall[slot] = Fall {
                force_n: breakaway_n - sliding_n,
                per_square_s2_m2: stribeck_velocity_m_s.powi(-2),
                half_exponent: 0.5 * exponent,
            };
            friction.falls = slot + 1;
        }
    }

    /// Whether closed-form pieces describe it: no terms, no states beside the mass and the tips.
    pub fn is_piecewise_linear(&self) -> bool {
        self.isolator_terms.is_empty()
            && self.mass_terms.is_empty()
            && self.degradation.is_none()
            && self.stand.is_none()
            && self.joint_half_width_m.is_none()
            && self.table_inverse_mass_1_kg == 0.0
            && self.bumper.is_linear()
            && self.friction.is_none_or(|friction| friction.falls == 0)
    }

    /// Segment of the isolator's curve that holds a displacement: 0 is the innermost; a negative
    /// one lies on the negative side.
    pub fn segment(&self, displacement_m: f64) -> i32 {
        let index = self.knees_m.iter().take_while(|knee| displacement_m.abs() > **knee).count() as i32;
        if displacement_m < 0.0 { -index } else { index }
    }

    /// Slope and intercept of a segment, N/m and N.
    pub fn line(&self, segment: i32) -> (f64, f64) {
        let index = segment.unsigned_abs() as usize;
        let sign = f64::from(segment.signum());
        (self.slopes_n_m[index], sign * self.intercepts_n[index])
    }

    /// Where a segment begins and ends, m.
    pub fn bounds(&self, segment: i32) -> (f64, f64) {
        let index = segment.unsigned_abs() as usize;
        let outer = self.knees_m.get(index).copied().unwrap_or(f64::INFINITY);
        match segment {
            0 => (-outer, outer),
            s if s > 0 => (self.knees_m[index - 1], outer),
            _ => (-outer, -self.knees_m[index - 1]),
        }
    }

    /// Static force of isolator, bumpers and constant force at a displacement, N.
    pub fn static_force_n(&self, displacement_m: f64) -> f64 {
        let (slope, intercept) = self.line(self.segment(displacement_m));
        let side =
            |penetration: f64| if penetration > 0.0 { self.bumper.elastic_n(penetration) } else { 0.0 };
        slope * displacement_m + intercept + self.constant_n + side(displacement_m - self.gap_right_m)
            - side(-displacement_m - self.gap_left_m)
    }

    /// Displacement at rest, m: 0 when nothing pushes or friction holds, else where the static
    /// forces balance (0 again when nothing brings the mass back).
    pub fn equilibrium_m(&self) -> f64 {
        let at_zero = self.static_force_n(0.0);
        let held = self.friction.map_or(0.0, |friction| friction.breakaway_n);
        if at_zero.abs() <= held || at_zero == 0.0 {
            return 0.0;
        }
        let towards = -at_zero.signum();
        let mut reach = 1e-9;
        while self.static_force_n(towards * reach) * at_zero > 0.0 {
            reach *= 2.0;
            if reach > 1e6 {
                return 0.0;
            }
        }
        let (mut near, mut far) = (0.0, reach);
        for _ in 0..200 {
            let middle = 0.5 * (near + far);
            if self.static_force_n(towards * middle) * at_zero > 0.0 { near = middle } else { far = middle }
        }
        towards * 0.5 * (near + far)
    }

    /// A length of this specimen (half the gap, first knee, ...), m, and its highest stiff frequency
    /// without hidden states, rad/s: floors of the error control.
    pub fn magnitudes(&self) -> (f64, f64) {
        let half_gap = 0.5 * (self.gap_right_m + self.gap_left_m);
        let lengths = [half_gap, self.knees_m.first().copied().unwrap_or(f64::INFINITY)];
        let length = lengths.into_iter().filter(|l| *l > 0.0).fold(f64::INFINITY, f64::min);
        let length = if length.is_finite() { length } else { 1e-3 };
        let terms = self.isolator_terms.iter().chain(&self.mass_terms).map(|t| t.tangent_n_m()).sum::<f64>();
        let stiffness = self.slopes_n_m.iter().copied().fold(0.0, f64::max) + terms;
        let frequency = (stiffness / self.mass_kg).sqrt();
        (length, if frequency > 0.0 { frequency } else { 1e-3 / self.sample_period_s })
    }

    /// States beside displacement and velocity.
    pub fn hidden_states(&self) -> usize {
        let terms = self.isolator_terms.iter().chain(&self.mass_terms).map(|t| t.states()).sum::<usize>();
        terms + if self.stand.is_some() { 4 } else { 0 } + usize::from(self.joint_half_width_m.is_some())
    }
}
