//! The user's own term, written in the model file: any expression in d, v, a (table acceleration),
//! p_r, p_l (penetrations of the bumpers), t and named parameters, SI, parsed once by `exmex`.
//!
//! `^` `*` `/` `+` `-`, `sin cos tan asin acos atan atan2 sinh cosh tanh exp sqrt cbrt ln log log2
//! log10 abs signum floor ceil round trunc fract min max` and `PI`, `E`, `TAU` are known.

use super::{Effect, Place, Values};
use crate::model::system::{Point, System, Term};
use crate::model::{EffectSpec, ModelError};
use exmex::prelude::*;

/// `expression`.
pub static EFFECT: Effect = Effect {
    name: "expression",
    place: Place::User,
    equation: "F = expression of d, v, a, p_r, p_l, t and named parameters",
    source: "the user",
    states: "",
    regime: "as written",
    shows: "as written",
    experiment: "as written",
    piecewise_linear: false,
    parameters: |_| Vec::new(),
    install,
};

/// What every expression may speak of, in the order of [`Point`].
const VARIABLES: [&str; 6] = ["d", "v", "a", "p_r", "p_l", "t"];
const WORDS: [&str; 31] = [
    "sin", "cos", "tan", "asin", "acos", "atan", "atan2", "sinh", "cosh", "tanh", "asinh", "acosh", "atanh",
    "floor", "round", "ceil", "trunc", "fract", "exp", "sqrt", "cbrt", "ln", "log2", "log10", "log", "abs",
    "signum", "min", "max", "PI", "TAU",
];
/// Values and names that fit on the stack while evaluating, so that nothing allocates.
const LARGEST: usize = 32;

/// A parsed expression with its parameters bound: force of the term, N.
pub struct Expression {
    parsed: exmex::FlatEx<f64>,
    /// For each variable of the parsed form: an index into the point, or a constant.
    bindings: Vec<Binding>,
}

#[derive(Clone, Copy)]
enum Binding {
    Variable(usize),
    Constant(f64),
}

impl Expression {
    /// Parses an expression and binds its parameters.
    ///
    /// # Errors
    /// Position (from 1) and reason: unknown symbol, syntax, division by zero, too long.
    pub fn parse(text: &str, parameters: &std::collections::BTreeMap<String, f64>) -> Result<Self, String> {
        for (position, word) in words(text) {
            let known = VARIABLES.contains(&word) || WORDS.contains(&word) || matches!(word, "E" | "e");
            if !known && !parameters.contains_key(word) {
                let names: Vec<&str> =
                    VARIABLES.into_iter().chain(parameters.keys().map(String::as_str)).collect();
                return Err(format!(
                    "unknown symbol `{word}` at position {position}; allowed: {} and functions",
                    names.join(", ")
                ));
            }
        }
        if operands(text) > LARGEST {
            return Err(format!("{} numbers and names; allowed: {LARGEST}", operands(text)));
        }
        let expression = Self::bind(text, parameters)?;
        for (position, _) in text.char_indices().filter(|(_, c)| *c == '/') {
            let divisor = divisor(&text[position + 1..]);
            if Self::bind(divisor, parameters).is_ok_and(|divisor| divisor.at(&Point::default()) == 0.0) {
                return Err(format!(
                    "division by zero at position {} (`{}` is 0 at rest)",
                    position + 1,
                    divisor.trim()
                ));
            }
        }
        let at_rest = expression.at(&Point::default());
        if !at_rest.is_finite() {
            return Err(format!(
                "is {at_rest} at rest (d = v = a = p_r = p_l = t = 0); allowed: a finite force"
            ));
        }
        Ok(expression)
    }

    fn bind(text: &str, parameters: &std::collections::BTreeMap<String, f64>) -> Result<Self, String> {
        let parsed = exmex::parse::<f64>(&without_exponents(text)).map_err(|error| error.msg().to_owned())?;
        let bindings = bindings(parsed.var_names(), parameters)?;
        Ok(Self { parsed, bindings })
    }

    /// Force at a point, N; not a number where the expression is not defined.
    pub fn at(&self, point: &Point) -> f64 {
        let values = point.variables();
        let mut slots = [0.0; LARGEST];
        for (slot, binding) in slots.iter_mut().zip(&self.bindings) {
            *slot = match binding {
                Binding::Variable(i) => values[*i],
                Binding::Constant(value) => *value,
            };
        }
        self.parsed.eval(&slots[..self.bindings.len()]).unwrap_or(f64::NAN)
    }

    /// Partial derivative of the force by a variable (`d`, `v`, ...) or parameter, where the
    /// expression has one in closed form.
    pub fn derivative(
        text: &str,
        by: &str,
        parameters: &std::collections::BTreeMap<String, f64>,
    ) -> Option<Self> {
        let parsed = exmex::parse::<f64>(&without_exponents(text)).ok()?;
        let index = parsed.var_names().iter().position(|name| name == by)?;
        let parsed = parsed.partial(index).ok()?;
        let bindings = bindings(parsed.var_names(), parameters).ok()?;
        Some(Self { parsed, bindings })
    }
}

fn bindings(
    names: &[String],
    parameters: &std::collections::BTreeMap<String, f64>,
) -> Result<Vec<Binding>, String> {
    names
        .iter()
        .map(|name| match VARIABLES.iter().position(|v| v == name) {
            Some(i) => Ok(Binding::Variable(i)),
            None => {
                parameters.get(name).copied().map(Binding::Constant).ok_or(format!("unknown symbol `{name}`"))
            }
        })
        .collect()
}

/// The text with numbers such as `1e-3` written out, which the parser would take for a name.
fn without_exponents(text: &str) -> String {
    let (mut plain, mut rest) = (String::with_capacity(text.len()), text);
    let mut previous = ' ';
    while let Some(c) = rest.chars().next() {
        let begins = c.is_ascii_digit() || c == '.';
        let length =
            if begins && !(previous.is_alphanumeric() || previous == '_') { number_length(rest) } else { 0 };
        let (head, tail) = rest.split_at(if length > 0 { length } else { c.len_utf8() });
        match head.parse::<f64>() {
            Ok(value) if length > 0 && head.contains(['e', 'E']) => plain.push_str(&value.to_string()),
            _ => plain.push_str(head),
        }
        previous = head.chars().next_back().unwrap_or(' ');
        rest = tail;
    }
    plain
}

/// Length of the decimal number, exponent included, that a text begins with.
fn number_length(text: &str) -> usize {
    let digits = |from: usize| {
        text[from..].find(|c: char| !(c.is_ascii_digit() || c == '.')).map_or(text.len(), |n| from + n)
    };
    let mantissa = digits(0);
    let Some(exponent) = text[mantissa..].strip_prefix(['e', 'E']) else { return mantissa };
    let sign = usize::from(exponent.starts_with(['+', '-']));
    let end = digits(mantissa + 1 + sign);
    if end > mantissa + 1 + sign { end } else { mantissa }
}

/// Names in a text with their positions, from 1.
fn words(text: &str) -> impl Iterator<Item = (usize, &str)> {
    let mut previous = ' ';
    let mut starts = Vec::new();
    for (i, c) in text.char_indices() {
        let begins = (c.is_alphabetic() || c == '_')
            && !(previous.is_alphanumeric() || previous == '_' || previous == '.');
        if begins {
            starts.push(i);
        }
        previous = c;
    }
    starts.into_iter().map(|start| {
        let rest = &text[start..];
        let length = rest.find(|c: char| !(c.is_alphanumeric() || c == '_')).unwrap_or(rest.len());
        (start + 1, &rest[..length])
    })
}

fn operands(text: &str) -> usize {
    text.split(|c: char| !(c.is_alphanumeric() || c == '_' || c == '.'))
        .filter(|part| !part.is_empty())
        .count()
}

/// The operand that follows a division sign: a signed number, name, call or group, with its powers.
fn divisor(rest: &str) -> &str {
    let (mut depth, mut seen) = (0_i32, false);
    let mut previous = ' ';
    for (i, c) in rest.char_indices() {
        let exponent_sign = matches!(previous, 'e' | 'E')
            && rest[..i].trim_start().starts_with(|c: char| c.is_ascii_digit() || c == '.');
        match c {
            '(' => depth += 1,
            ')' if depth == 0 => return &rest[..i],
            ')' => depth -= 1,
            '*' | '/' | ',' if depth == 0 => return &rest[..i],
            '+' | '-' if depth == 0 && seen && previous != '^' && !exponent_sign => return &rest[..i],
            _ => {}
        }
        if !c.is_whitespace() {
            seen = seen || !matches!(c, '+' | '-');
            previous = c;
        }
    }
    rest
}

pub(super) fn check(spec: &EffectSpec, key: &dyn Fn(&str) -> String) -> Result<(), ModelError> {
    let Some(text) = &spec.expression else {
        return Err(ModelError::invalid(key("name"), "an `expression` effect needs `expression = \"...\"`"));
    };
    for (name, value) in &spec.parameters {
        if VARIABLES.contains(&name.as_str())
            || WORDS.contains(&name.as_str())
            || matches!(name.as_str(), "e" | "E")
        {
            return Err(ModelError::invalid(
                key(name),
                format!("`{name}` has a meaning of its own; choose another name"),
            ));
        }
        if !value.is_finite() {
            return Err(ModelError::invalid(key(name), format!("{value}; allowed: a finite number")));
        }
    }
    Expression::parse(text, &spec.parameters)
        .map(|_| ())
        .map_err(|reason| ModelError::invalid(key("expression"), reason))
}

fn install(values: &Values<'_>, system: &mut System) -> Result<(), ModelError> {
    let spec = values.spec();
    let refuse = |reason: String| ModelError::invalid(values.key("expression"), reason);
    let text = spec.expression.as_deref().ok_or_else(|| refuse("missing".to_owned()))?;
    let expression = Expression::parse(text, &spec.parameters).map_err(refuse)?;
    let slope =
        Expression::derivative(text, "d", &spec.parameters).map_or(0.0, |slope| slope.at(&Point::default()));
    let tangent_n_m = if slope.is_finite() { slope.abs() } else { 0.0 };
    system.mass_terms.push(Box::new(Bound { expression, tangent_n_m }));
    Ok(())
}

/// The expression as a term of a compiled model.
struct Bound {
    expression: Expression,
    tangent_n_m: f64,
}

impl Term for Bound {
    fn force(&self, at: &Point, _: &[f64], _: &mut [f64]) -> f64 {
        self.expression.at(at)
    }

    fn tangent_n_m(&self) -> f64 {
        self.tangent_n_m
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn parse(text: &str) -> Result<Expression, String> {
        Expression::parse(text, &[("k_n_m".to_owned(), 3.0), ("zero".to_owned(), 0.0)].into())
    }

    #[test]
    fn mistakes_are_refused_with_their_position() {
        for (text, expected) in [
            ("k_n_m*d + q", "unknown symbol `q` at position 11"),
            ("1 + d/0", "division by zero at position 6"),
            ("1e-3/(v*2)", "division by zero at position 5"),
            ("d/zero^2 + 1", "division by zero at position 2"),
            ("d +* 2", ""),
            ("ln(d)", "is -inf at rest"),
        ] {
            let error = parse(text).err().unwrap_or_else(|| panic!("{text} was accepted"));
            assert!(error.contains(expected), "{text}: {error}");
        }
    }

    #[test]
    fn what_is_written_is_what_is_computed() {
        let point = Point {
            time_s: 2.0,
            displacement_m: 0.5,
            velocity_m_s: -1.5,
            penetration_right_m: 0.25,
            ..Point::default()
        };
        let value = parse("k_n_m*d^3 + abs(v)*v + 4*p_r/(1+t) - 1e-1").expect("valid").at(&point);
        assert!((value - (3.0 * 0.125 - 2.25 + 4.0 * 0.25 / 3.0 - 0.1)).abs() < 1e-14);
        let slope =
            Expression::derivative("k_n_m*d^3", "d", &[("k_n_m".to_owned(), 3.0)].into()).expect("smooth");
        assert!((slope.at(&point) - 2.25).abs() < 1e-12);
    }
}
