//! `cyclictest` (package rt-tests) as the yardstick for wake-up latency.

use crate::cli::CliError;
use crate::control::thread::PRIORITY;
use std::process::Command;

/// Longest latency that the histogram resolves, us.
const LONGEST_US: usize = 200_000;

/// What a run of `cyclictest` said.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Cyclictest {
    counts: Vec<u64>,
    total: u64,
}

impl Cyclictest {
    /// Runs it; `None` when it is not installed.
    pub(super) fn run(interval_us: u64, seconds: f64, cpu: usize) -> Result<Option<Self>, CliError> {
        let output = Command::new("cyclictest")
            .args(["-m", "-q", "-t1"])
            .args(["-p", &PRIORITY.to_string(), "-i", &interval_us.to_string(), "-a", &cpu.to_string()])
            .args(["-D", &format!("{}s", seconds.ceil() as u64), "-h", &LONGEST_US.to_string()])
            .output();
        let output = match output {
            Ok(output) => output,
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => return Ok(None),
            Err(error) => return Err(CliError::failed(format!("cyclictest: {error}"))),
        };
        if !output.status.success() {
            return Err(CliError::failed(format!("cyclictest: {}", String::from_utf8_lossy(&output.stderr))));
        }
        Ok(Some(Self::parse(&String::from_utf8_lossy(&output.stdout))))
    }

    /// Reads its histogram: lines of latency (us) and count, and the overflows that it names in a
    /// comment.
    fn parse(text: &str) -> Self {
        let mut counts = vec![0; LONGEST_US + 1];
        for line in text.lines() {
            if let Some(overflows) = line.strip_prefix("# Histogram Overflows:") {
                counts[LONGEST_US] += overflows.trim().parse::<u64>().unwrap_or(0);
                continue;
            }
            let mut words = line.split_whitespace();
            if let (Some(Ok(latency)), Some(Ok(count)), None) =
                (words.next().map(str::parse::<usize>), words.next().map(str::parse::<u64>), words.next())
                && latency < LONGEST_US
            {
                counts[latency] += count;
            }
        }
        let total = counts.iter().sum();
        Self { counts, total }
    }

    /// Adds another run.
    pub(super) fn add(&mut self, other: &Self) {
        self.counts.resize(other.counts.len().max(self.counts.len()), 0);
        for (sum, count) in self.counts.iter_mut().zip(&other.counts) {
            *sum += count;
        }
        self.total += other.total;
    }

    /// Cycles.
    pub(super) fn cycles(&self) -> u64 {
        self.total
    }

    /// Latency that a share of the cycles does not exceed, us.
    pub(super) fn quantile_us(&self, share: f64) -> f64 {
        let wanted = (share * self.total as f64).ceil() as u64;
        let mut sum = 0;
        for (latency, count) in self.counts.iter().enumerate() {
            sum += count;
            if sum >= wanted {
                return latency as f64;
            }
        }
        LONGEST_US as f64
    }

    /// Cycles that came a whole interval or more too late.
    pub(super) fn slips(&self, interval_us: u64) -> u64 {
        self.counts.iter().skip(interval_us as usize).sum()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn its_histogram_is_read() {
        let text = "# /dev/cpu_dma_latency set to 0us\n# Histogram\n000001 000000\n000018\t000090\n000040 000009\n000600 000001\n# Total: 000000100\n# Histogram Overflows: 00002\n# Min Latencies: 00003\n";
        let read = Cyclictest::parse(text);
        assert_eq!((read.cycles(), read.slips(488)), (102, 3));
        assert_eq!((read.quantile_us(0.5), read.quantile_us(0.95)), (18.0, 40.0));
        let mut sum = Cyclictest::default();
        sum.add(&read);
        sum.add(&read);
        assert_eq!(sum.slips(488), 6);
    }
}
