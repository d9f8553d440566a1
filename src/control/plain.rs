//! The published base model by a fixed-step midpoint rule: trilinear isolator, viscous damping, two
//! Kelvin-Voigt bumpers whose massless tips relax when free (equations 1 and 2 of Andreaus and De Angelis
//! 2020). Knows no effects and refuses a model that has some.

use crate::config::Case;
use crate::model::{BumperSpec, IsolatorSpec, ModelSpec, Regime, Response, Specimen};

/// Steps of the midpoint rule in one sample interval.
const STEPS: u32 = 2;

/// A model that this solver cannot build.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("effect `{0}` is not known to the base model's solver")]
pub struct ModelError(String);

/// Stiffness (N/m) and damping (N s/m) of B1 to B4. B1 and B2 as published; B3 and B4 were not
/// identified, these values come nearest to Table 2.
const BUMPERS: [(f64, f64); 4] = [(33e3, 300.0), (175e3, 500.0), (650e3, 1500.0), (3000e3, 3000.0)];

/// The published model of a case.
pub(super) fn of_case(case: &Case) -> ModelSpec {
    let bumper = usize::from(case.bumper).checked_sub(1).and_then(|i| BUMPERS.get(i));
    ModelSpec {
        name: format!("andreaus-2020-{}", case.device().to_lowercase()),
        mass_kg: 500.0,
        isolator: IsolatorSpec {
            stiffness_n_m: vec![20e3, 18e3, 2e3],
            breakpoints_m: vec![0.008, 0.040],
            damping_n_s_m: 1100.0,
        },
        bumper: bumper.zip(case.total_gap_m()).map(|(&(stiffness_n_m, damping_n_s_m), total_gap_m)| {
            BumperSpec { stiffness_n_m, damping_n_s_m, total_gap_m }
        }),
        effects: Vec::new(),
        uncertainty: None,
    }
}

/// Builds the model for a sample interval.
pub(super) fn build(spec: &ModelSpec, step_s: f64) -> Result<Box<dyn Specimen>, ModelError> {
    if let Some(effect) = spec.effects.first() {
        return Err(ModelError(effect.name.clone()));
    }
    Ok(Box::new(Plain {
        spec: spec.clone(),
        step_s: step_s / f64::from(STEPS),
        d: 0.0,
        v: 0.0,
        table: 0.0,
        right: Side::default(),
        left: Side::default(),
    }))
}

/// One bumper: compression of its tip (m, towards the stand) and whether the mass touches it.
#[derive(Clone, Copy, Default)]
struct Side {
    tip_m: f64,
    contact: bool,
}

impl Side {
    /// Contact force for a penetration of the gap (m) and its rate (m/s).
    fn force(self, bumper: &BumperSpec, penetration_m: f64, rate_m_s: f64) -> f64 {
        if !self.contact {
            return 0.0;
        }
        (bumper.stiffness_n_m * penetration_m + bumper.damping_n_s_m * rate_m_s).max(0.0)
    }

    fn follow(&mut self, bumper: &BumperSpec, penetration_m: f64, rate_m_s: f64, step_s: f64) {
        if self.contact {
            self.tip_m = penetration_m;
            self.contact = bumper.stiffness_n_m * penetration_m + bumper.damping_n_s_m * rate_m_s > 0.0;
        } else {
            self.tip_m *= (-bumper.stiffness_n_m / bumper.damping_n_s_m.max(1e-9) * step_s).exp();
            self.contact = penetration_m >= self.tip_m && rate_m_s > 0.0;
        }
    }
}

struct Plain {
    spec: ModelSpec,
    step_s: f64,
    d: f64,
    v: f64,
    table: f64,
    right: Side,
    left: Side,
}

impl Plain {
    fn isolator(&self, d: f64, v: f64) -> (f64, u8) {
        let isolator = &self.spec.isolator;
        let (mut force, mut from, mut branch) = (0.0, 0.0, 0);
        for (i, slope) in isolator.stiffness_n_m.iter().enumerate() {
            let to = isolator.breakpoints_m.get(i).copied().unwrap_or(f64::INFINITY);
            if d.abs() > from {
                force += slope * (d.abs().min(to) - from);
                branch = i as u8;
            }
            from = to;
        }
        (force.copysign(d) + isolator.damping_n_s_m * v, branch)
    }

    fn contacts(&self, d: f64, v: f64) -> (f64, f64) {
        let Some(bumper) = &self.spec.bumper else { return (0.0, 0.0) };
        let gap = 0.5 * bumper.total_gap_m;
        (self.right.force(bumper, d - gap, v), self.left.force(bumper, -d - gap, -v))
    }

    fn acceleration(&self, d: f64, v: f64) -> f64 {
        let (right, left) = self.contacts(d, v);
        -(self.isolator(d, v).0 + right - left) / self.spec.mass_kg
    }

    fn response(&self) -> Response {
        let (right, left) = self.contacts(self.d, self.v);
        Response {
            relative_displacement_m: self.d,
            relative_velocity_m_s: self.v,
            mass_acceleration_m_s2: self.acceleration(self.d, self.v),
            right_contact_force_n: right,
            left_contact_force_n: left,
            regime: Regime {
                isolator_branch: self.isolator(self.d, self.v).1,
                right_contact: self.right.contact,
                left_contact: self.left.contact,
                sticking: false,
            },
        }
    }

    fn follow(&mut self, step_s: f64) {
        if let Some(bumper) = &self.spec.bumper {
            let gap = 0.5 * bumper.total_gap_m;
            self.right.follow(bumper, self.d - gap, self.v, step_s);
            self.left.follow(bumper, -self.d - gap, -self.v, step_s);
        }
    }
}

impl Specimen for Plain {
    fn reset(&mut self) {
        (self.d, self.v, self.table) = (0.0, 0.0, 0.0);
        (self.right, self.left) = (Side::default(), Side::default());
    }

    fn step(&mut self, table_acceleration_m_s2: f64) -> Response {
        let h = self.step_s;
        for i in 0..STEPS {
            let at = |u: f64| {
                let share = (f64::from(i) + u) / f64::from(STEPS);
                self.table + share * (table_acceleration_m_s2 - self.table)
            };
            let first = self.acceleration(self.d, self.v) - at(0.0);
            let (d, v) = (self.d + 0.5 * h * self.v, self.v + 0.5 * h * first);
            let middle = self.acceleration(d, v) - at(0.5);
            self.d += h * v;
            self.v += h * middle;
            self.follow(h);
        }
        self.table = table_acceleration_m_s2;
        self.response()
    }

    fn impose(&mut self, relative_displacement_m: f64, relative_velocity_m_s: f64) -> Response {
        (self.d, self.v) = (relative_displacement_m, relative_velocity_m_s);
        self.follow(self.step_s * f64::from(STEPS));
        self.response()
    }
}
