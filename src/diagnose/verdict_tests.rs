use super::*;
use crate::diagnose::search::{Effort, Searcher};
use crate::diagnose::testing::{seen, with};
use crate::identify::kinematics::Tolerances;
use crate::identify::least_squares::Settings;
use crate::identify::motion::Motion;
use crate::model::testing::{b1_g2, effect};

#[test]
fn an_effect_that_may_have_no_strength_is_not_named_for_how_fast_it_would_be() {
    let motion = Motion::of(&seen(&b1_g2(), 1), 500.0, Tolerances::default()).expect("sound");
    let searcher = Searcher::new(&motion, &b1_g2(), Effort::default());
    let base = searcher.base(&b1_g2()).expect("fits");
    let degradation = effect("stiffness-degradation", &[("delta", -5e-4), ("tau_s", 250.0)]);
    let settings = Settings { iterations: 1, ..Settings::default() };
    let mut trial = with(&searcher, &base, &[degradation], settings);
    let place = |name: &str| {
        let numbers = &trial.refit.numbers.numbers;
        numbers.iter().position(|number| number.key == format!("effect[0].{name}")).expect("fitted")
    };
    let (delta, tau) = (place("delta"), place("tau_s"));
    assert!(!trial.refit.numbers.numbers[delta].logarithmic && trial.refit.numbers.numbers[tau].logarithmic);
    trial.refit.sigmas[tau] = 0.1;
    for (deviations, excludes) in [(1.0, false), (3.0, true)] {
        trial.refit.sigmas[delta] = trial.refit.fit.values[delta].abs() / deviations;
        // Beside itself it gains nothing.
        assert_eq!(excludes_zero(&trial, &trial.clone()), excludes, "{deviations} deviations from zero");
    }
}
