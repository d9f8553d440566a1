//! Host time against device time and against a period: used by both links and the emulators.
//!
//! [`HostClock`] is the one monotonic clock of a rig. [`TimeGrid`] finds the even grid behind instants
//! that are stamped late by scheduling; [`ClockFit`] fits a device's clock to the host's from arrivals
//! that are late by an unknown, never negative amount.

use std::time::{Duration, Instant};

/// Monotonic host time, ns since the rig was opened. Copies tell the same time.
#[derive(Clone, Copy, Debug)]
pub struct HostClock(Instant);

impl Default for HostClock {
    fn default() -> Self {
        Self::new()
    }
}

impl HostClock {
    /// Starts at 0 now.
    pub fn new() -> Self {
        Self(Instant::now())
    }

    /// Now, ns.
    pub fn now_ns(&self) -> u64 {
        u64::try_from(self.0.elapsed().as_nanos()).unwrap_or(u64::MAX)
    }

    /// Sleeps until a time of this clock; says by how much it woke late, ns.
    pub fn sleep_until(&self, deadline_ns: u64) -> u64 {
        let now = self.now_ns();
        if deadline_ns > now {
            std::thread::sleep(Duration::from_nanos(deadline_ns - now));
        }
        self.now_ns().saturating_sub(deadline_ns)
    }
}

/// The even grid behind events that should come once a period, are stamped late by an unknown, never negative amount, and
/// are left out for whole periods now and then.
///
/// Left-out periods are followed at once, lateness within a period with a small gain, so that a late wake-up does not shift the
/// grid (a first-order phase-locked loop). Nothing comes early: an event before its time shows that one before was later than it
/// seemed, and puts the grid right.
#[derive(Clone, Copy, Debug)]
pub struct TimeGrid {
    period_ns: f64,
    last_ns: Option<f64>,
}

impl TimeGrid {
    const GAIN: f64 = 0.02;
    /// Share of a period by which a stamp may lie before the grid, which follows the mean lateness.
    const EARLY: f64 = 0.2;

    /// A grid with this period.
    pub fn new(period_ns: f64) -> Self {
        Self { period_ns, last_ns: None }
    }

    /// Takes the stamp of one event and gives the time on the grid that it stands for, ns.
    pub fn observe(&mut self, stamp_ns: u64) -> f64 {
        let stamp = stamp_ns as f64;
        let on_grid = match self.last_ns {
            None => stamp,
            Some(last) => {
                let periods = ((stamp - last) / self.period_ns + Self::EARLY).floor().max(1.0);
                let expected = last + periods * self.period_ns;
                let late = stamp - expected;
                if late < -Self::EARLY * self.period_ns { stamp } else { expected + Self::GAIN * late }
            }
        };
        self.last_ns = Some(on_grid);
        on_grid
    }
}

/// How a device's clock runs against the host's.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ClockModel {
    /// Host time minus device time at device time `reference_us`, ns.
    pub offset_ns: f64,
    /// How much faster the host's clock runs, parts per million.
    pub drift_ppm: f64,
    /// Device time that the offset belongs to, us.
    pub reference_us: f64,
}

impl ClockModel {
    /// Host time of a device time, ns.
    pub fn host_ns(&self, device_us: u64) -> f64 {
        let since = (device_us as f64 - self.reference_us) * 1e3;
        self.reference_us * 1e3 + self.offset_ns + since * (1.0 + self.drift_ppm * 1e-6)
    }
}

const WINDOWS: usize = 64;
const WINDOW_US: u64 = 250_000;

/// Fits a [`ClockModel`] to arrivals: the earliest arrival of each quarter second against the line
/// through up to 64 of them. The constant part of the transport delay stays in the offset.
#[derive(Clone, Debug)]
pub struct ClockFit {
    /// (device time us, host minus device ns) of the earliest arrival of each window.
    minima: [(f64, f64); WINDOWS],
    count: usize,
    window: Option<(u64, (f64, f64))>,
    model: ClockModel,
}

impl Default for ClockFit {
    fn default() -> Self {
        Self { minima: [(0.0, 0.0); WINDOWS], count: 0, window: None, model: ClockModel::default() }
    }
}

impl ClockFit {
    /// Takes one arrival; says whether the model has changed.
    pub fn observe(&mut self, device_us: u64, host_ns: u64) -> bool {
        let point = (device_us as f64, host_ns as f64 - device_us as f64 * 1e3);
        let number = device_us / WINDOW_US;
        match &mut self.window {
            Some((current, earliest)) if *current == number => {
                if point.1 < earliest.1 {
                    *earliest = point;
                    if self.count < 2 {
                        self.model = ClockModel { offset_ns: point.1, drift_ppm: 0.0, reference_us: point.0 };
                        return true;
                    }
                }
                return false;
            }
            Some((_, earliest)) => {
                self.minima[self.count % WINDOWS] = *earliest;
                self.count += 1;
            }
            None => self.model = ClockModel { offset_ns: point.1, drift_ppm: 0.0, reference_us: point.0 },
        }
        self.window = Some((number, point));
        self.refit();
        true
    }

    /// The model so far.
    pub fn model(&self) -> ClockModel {
        self.model
    }

    fn refit(&mut self) {
        let points = &self.minima[..self.count.min(WINDOWS)];
        if points.len() < 2 {
            return;
        }
        let n = points.len() as f64;
        let mean = |f: fn(&(f64, f64)) -> f64| points.iter().map(f).sum::<f64>() / n;
        let (mean_us, mean_ns) = (mean(|p| p.0), mean(|p| p.1));
        let covariance: f64 = points.iter().map(|p| (p.0 - mean_us) * (p.1 - mean_ns)).sum();
        let variance: f64 = points.iter().map(|p| (p.0 - mean_us).powi(2)).sum();
        // ns per us is 1e-3, and a part per million 1e-6.
        let drift_ppm = covariance / variance * 1e3;
        self.model = ClockModel { offset_ns: mean_ns, drift_ppm, reference_us: mean_us };
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn offset_and_drift_come_out_of_late_arrivals() {
        // 37 ppm drift, 5 s offset, delays from a fixed generator: mostly 0.2 ms, one in 50 up to 20 ms.
        let mut fit = ClockFit::default();
        let mut random = 12345_u64;
        let truth = |us: u64| 5.0e9 + us as f64 * 1e3 * (1.0 + 37e-6);
        for n in 0..40_960_u64 {
            random = random.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            let uniform = (random >> 40) as f64 / (1_u64 << 24) as f64;
            let delay_ns = if n % 50 == 0 { 20e6 * uniform } else { 2e5 * uniform };
            let device_us = n * 1_000_000 / 2048;
            fit.observe(device_us, (truth(device_us) + delay_ns) as u64);
        }
        let model = fit.model();
        assert!((model.drift_ppm - 37.0).abs() < 0.5, "{model:?}");
        let error_ns = model.host_ns(19_000_000) - truth(19_000_000);
        assert!((0.0..10_000.0).contains(&error_ns), "{error_ns} ns");
    }

    #[test]
    fn a_late_stamp_does_not_shift_the_grid_and_skipped_periods_are_followed() {
        let mut grid = TimeGrid::new(1e6);
        for n in 0..1_000_u64 {
            grid.observe(n * 1_000_000);
        }
        let late = grid.observe(1_000_000_000 + 400_000);
        assert!((late - 1.0e9).abs() < 10_000.0, "{late}");
        let skipped = grid.observe(1_020_000_000);
        assert!((skipped - 1.02e9).abs() < 10_000.0, "{skipped}");
    }

    #[test]
    fn lateness_of_any_share_of_a_period_leaves_the_grid_where_it_was() {
        for late_us in [100, 300, 550, 750, 850, 950] {
            let mut grid = TimeGrid::new(1e6);
            for n in 0..1_000_u64 {
                grid.observe(n * 1_000_000);
            }
            let hit = grid.observe(1_000_000_000 + late_us * 1_000);
            // What cannot be told from a left-out period is off by less than the rest of the period, once.
            let allowed_ns = if late_us <= 750 { 20_000.0 } else { 1.0e6 };
            assert!((hit - 1.0e9).abs() <= allowed_ns, "{late_us} us late: {hit}");
            let next = grid.observe(1_001_000_000);
            assert!((next - 1.001e9).abs() < 20_000.0, "after {late_us} us: {next}");
        }
    }
}
