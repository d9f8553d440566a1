//! Oscillations of the mass in one table cycle: the pinball effect between the bumpers. Called by the watch
//! with every sample.

use crate::safety::context::{Context, Halves};
use crate::safety::judge::Estimate;
use crate::safety::observation::Setup;
use crate::safety::spec::Detection;

#[derive(Clone, Copy, Default)]
struct Counts {
    reversals: u32,
    contacts: u32,
}

/// Counts reversals of D and contacts with the bumpers.
pub struct MassOscillations {
    half_gap_m: Option<f64>,
    hysteresis_m: f64,
    least_contacts: u32,
    rising: bool,
    extreme_m: f64,
    contact: bool,
    halves: Halves<Counts>,
}

impl MassOscillations {
    /// For the gap of a specimen.
    pub fn new(setup: &Setup, detection: &Detection) -> Self {
        let share_m = setup.total_gap_m.unwrap_or(0.0) * detection.oscillation_hysteresis_share;
        Self {
            half_gap_m: setup.total_gap_m.map(|gap| 0.5 * gap),
            hysteresis_m: detection.oscillation_hysteresis_m.max(share_m),
            least_contacts: detection.oscillation_contacts,
            rising: true,
            extreme_m: 0.0,
            contact: false,
            halves: Halves::default(),
        }
    }

    /// Oscillations a cycle, each half-cycle; 0 with fewer contacts than configured, idle without bumpers.
    pub fn estimate(&mut self, c: &Context) -> Estimate {
        let (Some(half_gap_m), Some(place)) = (self.half_gap_m, &c.place) else {
            self.halves.clear();
            return Estimate::Idle;
        };
        let d = c.channels.relative_displacement_m;
        let (reversal, contact) = (self.reversal(d), self.contact(d.abs() - half_gap_m));
        let joined = self.halves.turn(place);
        let now = self.halves.now();
        now.reversals += u32::from(reversal);
        now.contacts += u32::from(contact);
        joined.map_or(Estimate::Keep, |(a, b)| {
            let enough = a.contacts + b.contacts >= self.least_contacts;
            let reversals = if enough { a.reversals + b.reversals } else { 0 };
            Estimate::Value(0.5 * f64::from(reversals))
        })
    }

    fn reversal(&mut self, d: f64) -> bool {
        let sign = if self.rising { 1.0 } else { -1.0 };
        if sign * (d - self.extreme_m) > 0.0 {
            self.extreme_m = d;
        }
        let turned = sign * (self.extreme_m - d) >= self.hysteresis_m;
        if turned {
            self.rising = !self.rising;
            self.extreme_m = d;
        }
        turned
    }

    fn contact(&mut self, penetration_m: f64) -> bool {
        let begins = !self.contact && penetration_m >= 0.0;
        self.contact = penetration_m >= if self.contact { -0.5 * self.hysteresis_m } else { 0.0 };
        begins
    }
}

#[cfg(test)]
mod tests {
    use crate::safety::DetectorId;
    use crate::safety::detect::bench::Bench;

    #[test]
    fn five_bounces_a_cycle_trip() {
        let mut bench = Bench::new();
        bench.healthy(DetectorId::MassOscillations);
        let after = bench.until_trip(DetectorId::MassOscillations, |k, o| {
            o.sample.channels.relative_displacement_m =
                0.0105 * (std::f64::consts::TAU * 5.0 * k as f64 / 2048.0).sin();
        });
        assert!(after.is_some_and(|n| (1024 * 6 - 10..=1024 * 8).contains(&n)), "{after:?}");
    }
}
