//! Which numbers of a model a fit may move, how far, and how they are put back.

use super::least_squares::Free;
use crate::model::effects::{self, Parameter, Place, Sign};
use crate::model::{ModelSpec, Scales};
use crate::record::Kind;

/// Share of a 95 % half-width that is one standard deviation.
const SIGMA: f64 = 1.0 / 1.96;

/// Least share that is left of a spring or a dashpot of which nothing is known.
const NEXT_TO_NOTHING: f64 = 1e-6;

/// A number that is fitted over magnitudes is `exp` of what the fit moves.
#[derive(Clone, Debug, PartialEq)]
pub struct Number {
    /// Key in the model file.
    pub key: String,
    /// The fit moves the logarithm.
    pub logarithmic: bool,
    /// How strong an effect is: its first number, where its magnitude is not known beforehand.
    pub strength: bool,
}

/// Keys of the springs and of the dashpot of an isolator.
const SPRING: &str = "isolator.stiffness_n_m";
const DASHPOT: &str = "isolator.damping_n_s_m";

/// Lets those of such keys vanish of which the model file knows nothing.
fn let_vanish(free: &mut Free, keys: &[&str]) {
    let unknown = free.prior.1 >= free.prior.0.abs() * SIGMA;
    if unknown && free.prior.0 > 0.0 && keys.iter().any(|key| free.key.starts_with(key)) {
        free.bounds.0 = NEXT_TO_NOTHING * free.prior.0;
    }
}

/// The numbers of a model that a fit moves, and the fit's view of them.
#[derive(Clone, Debug, Default)]
pub struct Numbers {
    /// Keys and scales.
    pub numbers: Vec<Number>,
    /// The same for the fit.
    pub free: Vec<Free>,
}

impl Number {
    /// A value as fits hold it.
    pub fn as_fitted(&self, value: f64) -> f64 {
        if self.logarithmic { value.ln() } else { value }
    }
}

impl Numbers {
    /// The base model's numbers (the mass where a measured force drives it: of a base record only F/M is fixed), each within
    /// what the model file says of it, or the defaults: mass 5 %, slopes 10 %, knees 6 %, damping 10 %,
    /// bumper stiffness 10 % and damping 12 %, gap 2 % (95 % half-widths).
    pub fn of_base(nominal: &ModelSpec, kind: Kind) -> Self {
        let mut out = Self::default();
        let u = nominal.uncertainty.clone().unwrap_or_default();
        if kind == Kind::Force {
            out.relative("mass_kg", nominal.mass_kg, u.mass_kg.unwrap_or(0.05));
        }
        let isolator = u.isolator.unwrap_or_default();
        let slope = |i: usize| isolator.stiffness_n_m.get(i).or(isolator.stiffness_n_m.last()).copied();
        for (i, k) in nominal.isolator.stiffness_n_m.iter().enumerate() {
            // A slope of zero is a statement (a friction device has no spring), not a guess.
            if *k != 0.0 {
                out.relative(&format!("isolator.stiffness_n_m[{i}]"), *k, slope(i).unwrap_or(0.10));
            }
        }
        for (i, x) in nominal.isolator.breakpoints_m.iter().enumerate() {
            let width = isolator.breakpoints_m.get(i).copied().unwrap_or(0.06);
            out.relative(&format!("isolator.breakpoints_m[{i}]"), *x, width);
        }
        let c = nominal.isolator.damping_n_s_m;
        if c != 0.0 {
            out.relative("isolator.damping_n_s_m", c, isolator.damping_n_s_m.unwrap_or(0.10));
        }
        if let Some(bumper) = &nominal.bumper {
            let u = u.bumper.unwrap_or_default();
            out.relative("bumper.stiffness_n_m", bumper.stiffness_n_m, u.stiffness_n_m.unwrap_or(0.10));
            if bumper.damping_n_s_m != 0.0 {
                out.relative("bumper.damping_n_s_m", bumper.damping_n_s_m, u.damping_n_s_m.unwrap_or(0.12));
            }
            out.relative("bumper.total_gap_m", bumper.total_gap_m, u.total_gap_m.unwrap_or(0.02));
        }
        // A driven mass may have neither (an axis that nothing holds), a component no spring (a friction device), a mass on a moving base no
        // dashpot (a pendulum that slides).
        let vanish: &[&str] = match kind {
            Kind::Force => &[SPRING, DASHPOT],
            Kind::Component => &[SPRING],
            Kind::Base => &[DASHPOT],
        };
        out.free.iter_mut().for_each(|free| let_vanish(free, vanish));
        out
    }

    fn relative(&mut self, key: &str, value: f64, half_width: f64) {
        let scale = value.abs() * half_width.max(1e-6) * SIGMA;
        // Six half-widths are far outside what the file allows; the prior pulls long before. Nothing turns its sign.
        let [less, more] = [(6.0 * half_width).min(0.95), 6.0 * half_width].map(|reach| reach * value.abs());
        self.numbers.push(Number { key: key.to_owned(), logarithmic: false, strength: false });
        self.free.push(Free {
            key: key.to_owned(),
            start: value,
            scale,
            prior: (value, scale),
            bounds: if value < 0.0 { (value - more, value + less) } else { (value - less, value + more) },
        });
    }

    /// Makes the base numbers start from a fitted model, their priors kept.
    pub fn start_from(&mut self, spec: &ModelSpec) {
        for (number, free) in self.numbers.iter().zip(&mut self.free) {
            if let Ok(value) = spec.get(&number.key) {
                free.start = if number.logarithmic { value.abs().max(1e-300).ln() } else { value };
            }
        }
    }

    /// Adds the parameters of an effect that is already in the model at `index`; none of an instrument.
    pub fn add_effect(&mut self, spec: &ModelSpec, index: usize, scales: &Scales) {
        let Some(given) = spec.effects.get(index) else { return };
        let Ok(effect) = effects::find(&given.name) else { return };
        // An instrument is told by the kinematics, which have taken it out of the motion: nothing here sees it.
        if effect.is_instrument() {
            return;
        }
        if effect.place == Place::User {
            given.parameters.iter().for_each(|(name, value)| self.add_own(index, name, *value));
            return;
        }
        let fitted = (effect.parameters)(scales).into_iter().filter(|parameter| !parameter.chosen);
        for (i, parameter) in fitted.enumerate() {
            if let Some(start) = given.parameters.get(parameter.name) {
                self.add_parameter(&format!("effect[{index}].{}", parameter.name), &parameter, *start);
                if let (0, Some(added)) = (i, self.numbers.last_mut()) {
                    added.strength = !added.logarithmic;
                }
            }
        }
    }

    /// A parameter of the user's own expression: of either sign, its magnitude as written, or 1.
    fn add_own(&mut self, index: usize, name: &str, value: f64) {
        let key = format!("effect[{index}].{name}");
        let size = if value == 0.0 { 1.0 } else { value.abs() };
        self.numbers.push(Number { key: key.clone(), logarithmic: false, strength: false });
        self.free.push(Free {
            key,
            start: value,
            scale: 0.1 * size,
            prior: (value, 10.0 * size),
            bounds: (value - 100.0 * size, value + 100.0 * size),
        });
    }

    fn add_parameter(&mut self, key: &str, parameter: &Parameter, start: f64) {
        let (low, high) = parameter.prior;
        let logarithmic = parameter.log_scale && parameter.sign == Sign::Positive && start > 0.0 && low > 0.0;
        let free = if logarithmic {
            let (l, h) = (low.ln(), high.ln());
            Free {
                key: key.to_owned(),
                start: start.ln(),
                scale: 0.1,
                // The range is where 95 % are sought.
                prior: (0.5 * (l + h), (h - l) * 0.5 * SIGMA),
                // A factor of three beyond: farther out a model only gets stiff, not better.
                bounds: (l - 1.1, (h + 1.1).min(parameter.at_most.ln())),
            }
        } else {
            let centre = if parameter.sign == Sign::Either { 0.0 } else { 0.5 * (low + high) };
            let half = 0.5 * (high - low);
            let bottom = if parameter.sign == Sign::Either { -3.0 * high.abs() } else { 0.0 };
            let tiny = if parameter.sign == Sign::Positive { 1e-6 * high.abs() } else { bottom };
            Free {
                key: key.to_owned(),
                start,
                scale: (0.1 * start.abs()).max(1e-3 * high.abs()),
                prior: (centre, half.max(1e-300) * if parameter.sign == Sign::Either { SIGMA } else { 2.0 }),
                bounds: (bottom.max(tiny).max(parameter.at_least), (3.0 * high.abs()).min(parameter.at_most)),
            }
        };
        self.numbers.push(Number { key: key.to_owned(), logarithmic, strength: false });
        self.free.push(free);
    }

    /// A component may have no dashpot beside a law of its own, where the model file knows nothing of one. What plays within it has to close
    /// against something: during a search it may not.
    pub fn let_dashpot_vanish(&mut self) {
        self.free.iter_mut().for_each(|free| let_vanish(free, &[DASHPOT]));
    }

    /// Forgets the numbers whose keys are not to be kept.
    pub fn retain(&mut self, kept: impl Fn(&str) -> bool) {
        self.numbers.retain(|number| kept(&number.key));
        self.free.retain(|free| kept(&free.key));
    }

    /// A model with its numbers moved by so many times what is given, within their bounds; `None` when a key is not there.
    pub fn moved(&self, mut spec: ModelSpec, by: &[f64], times: f64) -> Option<ModelSpec> {
        let mut numbers = self.clone();
        numbers.start_from(&spec);
        let moved = numbers.free.iter().zip(by);
        let moved: Vec<f64> =
            moved.map(|(free, by)| (free.start + by * times).clamp(free.bounds.0, free.bounds.1)).collect();
        numbers.put(&moved, &mut spec).then_some(spec)
    }

    /// Puts the fit's values into a model. False when a key is not there.
    pub fn put(&self, values: &[f64], spec: &mut ModelSpec) -> bool {
        self.numbers.iter().zip(values).all(|(number, value)| {
            spec.set(&number.key, if number.logarithmic { value.exp() } else { *value }).is_ok()
        })
    }

    /// Value and limits of a number from those of the fit.
    pub fn interval(&self, index: usize, value: f64, limits: (f64, f64)) -> (f64, f64, f64) {
        if self.numbers[index].logarithmic {
            (value.exp(), limits.0.exp(), limits.1.exp())
        } else {
            (value, limits.0, limits.1)
        }
    }
}
