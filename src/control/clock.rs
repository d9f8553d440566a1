//! The control thread's clock: wall time with absolute deadlines, or virtual time that runs as fast
//! as the recorder takes the rows. The overrun policy is a pure function of its own ([`overrun`]).

use rustix::thread::{ClockId, clock_nanosleep_absolute};
use rustix::time::{Timespec, clock_gettime};

/// One wake-up.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Tick {
    /// Periods that have begun since the last wake-up: 1 in time, more after an overrun.
    pub periods: u64,
    /// From the deadline to the wake-up, ns; 0 in virtual time.
    pub latency_ns: u64,
    /// Deviation of the distance from the last wake-up from the periods passed, ns; `None` in virtual
    /// time.
    pub period_error_ns: Option<u64>,
    /// The deadline had passed before the thread went to sleep: the step before took too long.
    pub overslept_by_work: bool,
}

/// Gives the control step its rhythm.
pub trait Clock: Send {
    /// Waits for the next period.
    fn tick(&mut self) -> Tick;
}

/// Periods that begin with a wake-up which comes `latency_ns` after its deadline: whole periods that
/// have passed are skipped, the phase is kept, and nothing is caught up in a burst.
pub fn overrun(latency_ns: u64, period_ns: u64) -> u64 {
    1 + latency_ns / period_ns.max(1)
}

/// Virtual time: the next period begins at once.
#[derive(Clone, Copy, Debug, Default)]
pub struct VirtualClock;

impl Clock for VirtualClock {
    fn tick(&mut self) -> Tick {
        Tick { periods: 1, ..Tick::default() }
    }
}

/// Wall time: absolute deadlines on the monotonic clock.
#[derive(Clone, Copy, Debug)]
pub struct WallClock {
    period_num_ns: u64,
    rate_hz: f64,
    start_ns: u64,
    deadline_index: u64,
    last_wake_ns: Option<u64>,
}

impl WallClock {
    /// A clock whose first period begins one period from now.
    pub fn new(rate_hz: f64) -> Self {
        Self {
            period_num_ns: (1e9 / rate_hz).round() as u64,
            rate_hz,
            start_ns: now_ns(),
            deadline_index: 0,
            last_wake_ns: None,
        }
    }

    /// Deadline of a period, ns; computed from the index so that 488.28 us do not drift.
    fn deadline_ns(&self, index: u64) -> u64 {
        self.start_ns + (index as f64 * 1e9 / self.rate_hz).round() as u64
    }
}

impl Clock for WallClock {
    fn tick(&mut self) -> Tick {
        self.deadline_index += 1;
        let deadline = self.deadline_ns(self.deadline_index);
        let before = now_ns();
        let overslept_by_work = before >= deadline;
        if !overslept_by_work {
            let until = Timespec {
                tv_sec: (deadline / 1_000_000_000) as i64,
                tv_nsec: (deadline % 1_000_000_000) as i64,
            };
            // A signal may end the sleep early; the deadline is absolute, so sleeping on is safe.
            while clock_nanosleep_absolute(ClockId::Monotonic, &until).is_err() && now_ns() < deadline {}
        }
        let now = now_ns();
        let latency_ns = now.saturating_sub(deadline);
        let periods = overrun(latency_ns, self.period_num_ns);
        self.deadline_index += periods - 1;
        let period_error_ns = self
            .last_wake_ns
            .map(|last| (now - last).abs_diff(periods * self.period_num_ns))
            .or(Some(latency_ns));
        self.last_wake_ns = Some(now);
        Tick { periods, latency_ns, period_error_ns, overslept_by_work }
    }
}

/// Monotonic time, ns.
pub fn now_ns() -> u64 {
    let now = clock_gettime(rustix::time::ClockId::Monotonic);
    now.tv_sec as u64 * 1_000_000_000 + now.tv_nsec as u64
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_overrun_skips_whole_periods() {
        assert_eq!(overrun(0, 488_281), 1);
        assert_eq!(overrun(488_280, 488_281), 1);
        assert_eq!(overrun(488_281, 488_281), 2);
        assert_eq!(overrun(24_000_000, 488_281), 50);
    }

    #[test]
    fn wall_time_keeps_its_phase_after_a_late_step() {
        let mut clock = WallClock::new(1000.0);
        let mut periods = clock.tick().periods;
        let late = now_ns() + 5_500_000;
        while now_ns() < late {
            std::hint::spin_loop();
        }
        let tick = clock.tick();
        assert!(tick.overslept_by_work);
        assert!(tick.periods >= 5, "{tick:?}");
        periods += tick.periods;
        for _ in 0..20 {
            periods += clock.tick().periods;
        }
        // Whatever was skipped, the number of periods is that of the time gone by.
        let gone = (now_ns() - clock.start_ns) / 1_000_000;
        assert!(gone.abs_diff(periods) <= 1, "{gone} ms, {periods} periods");
    }
}
