//! The operator's side, where a link to it is configured (SR-18). Called by the watch once a control period.

use crate::safety::judge::Estimate;
use crate::safety::observation::Period;

/// Time since the operator's side was heard of, s; idle where no link is configured.
pub fn estimate(period: &Period) -> Estimate {
    period.link_age_s.map_or(Estimate::Idle, Estimate::Value)
}

#[cfg(test)]
mod tests {
    use crate::safety::DetectorId;
    use crate::safety::detect::bench::Bench;

    #[test]
    fn a_link_that_was_never_configured_is_not_missed() {
        let mut bench = Bench::new();
        bench.healthy(DetectorId::OperatorLink);
        let age = |link_age_s| crate::safety::Period { samples: 1, link_age_s, ..Default::default() };
        assert!(!bench.watch.period(&age(None)).tripped.has(DetectorId::OperatorLink));
        assert!(!bench.watch.period(&age(Some(2.9))).tripped.has(DetectorId::OperatorLink));
        assert!(bench.watch.period(&age(Some(3.1))).tripped.has(DetectorId::OperatorLink));
    }
}
