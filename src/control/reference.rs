//! Which command belongs to which sample. The control step writes one command a period; samples may
//! come late, in bursts, or number from anywhere, and each must still be told its own step and phase.

use crate::sweep::CommandPoint;

/// Periods that are remembered; a sample later than this is taken for the oldest one.
const REMEMBERED: u64 = 1024;
/// Periods in a row that must agree before the alignment follows a drift of the DAQ's clock.
const AGREEING: u32 = 256;

/// The command of each of the last periods, and how sample numbers lie to periods.
pub struct References {
    points: Vec<CommandPoint>,
    periods: u64,
    offset: Option<i64>,
    drifted: i64,
    agreeing: u32,
}

impl References {
    /// No period yet; `rest` stands for whatever was before.
    pub fn new(rest: CommandPoint) -> Self {
        Self { points: vec![rest; REMEMBERED as usize], periods: 0, offset: None, drifted: 0, agreeing: 0 }
    }

    /// Nothing has been commanded yet: what the table was found to hold stands for whatever was before.
    pub fn begin_at(&mut self, rest: CommandPoint) {
        self.points.fill(rest);
    }

    /// The command of the period that begins.
    pub fn push(&mut self, point: CommandPoint) {
        self.points[(self.periods % REMEMBERED) as usize] = point;
        self.periods += 1;
    }

    /// The newest command.
    pub fn last(&self) -> CommandPoint {
        self.points[(self.periods.saturating_sub(1) % REMEMBERED) as usize]
    }

    /// Periods that went by without a command, of which only so many are remembered; the caller lets the
    /// command go on by as many and then pushes those that are remembered.
    pub fn forget(&mut self, periods: u64) -> u64 {
        let forgotten = periods.saturating_sub(REMEMBERED);
        self.periods += forgotten;
        forgotten
    }

    /// The command in force when the sample with this number was taken.
    pub fn of(&mut self, sequence: u64) -> CommandPoint {
        let offset = *self.offset.get_or_insert(self.natural_offset(sequence));
        let period = sequence as i64 + offset;
        let oldest = self.periods.saturating_sub(REMEMBERED) as i64;
        let kept = period.clamp(oldest, (self.periods as i64 - 1).max(0));
        self.points[(kept as u64 % REMEMBERED) as usize]
    }

    /// The sample taken as a period begins stands under the command of the period before.
    fn natural_offset(&self, sequence: u64) -> i64 {
        self.periods as i64 - 1 - sequence as i64
    }

    /// Tells the newest sample of a period. Two quartz clocks part by some 50 us a second: when samples
    /// have come one period early or late for long enough, the alignment moves by one.
    pub fn newest(&mut self, sequence: u64) {
        let natural = self.natural_offset(sequence);
        let offset = *self.offset.get_or_insert(natural);
        let off_by = (natural - offset).clamp(-1, 1);
        if off_by == 0 || off_by != self.drifted {
            (self.drifted, self.agreeing) = (off_by, 0);
            return;
        }
        self.agreeing += 1;
        if self.agreeing >= AGREEING {
            self.offset = Some(offset + off_by);
            self.agreeing = 0;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::stream::Command;
    use crate::sweep::Segment;

    fn point(k: u64) -> CommandPoint {
        CommandPoint {
            command: Command { displacement_m: k as f64, ..Command::default() },
            jerk_m_s3: 0.0,
            phase: None,
            segment: Segment::Step,
        }
    }

    fn number(point: CommandPoint) -> u64 {
        point.command.displacement_m as u64
    }

    #[test]
    fn late_samples_keep_their_own_command() {
        let mut references = References::new(point(0));
        for k in 0..100 {
            references.push(point(k));
            assert_eq!(number(references.of(5000 + k)), k);
            references.newest(5000 + k);
        }
        // 33 samples are held back and then come at once.
        for k in 100..133 {
            references.push(point(k));
        }
        for k in 100..133 {
            assert_eq!(number(references.of(5000 + k)), k);
        }
    }

    #[test]
    fn the_alignment_follows_a_slow_clock() {
        let mut references = References::new(point(0));
        references.push(point(0));
        references.of(0);
        // From period 1000 on the DAQ is one sample behind.
        for k in 1..3000 {
            references.push(point(k));
            let sequence = if k < 1000 { k } else { k - 1 };
            let expected = (!(1000..=1300).contains(&k)).then_some(k);
            let got = number(references.of(sequence));
            references.newest(sequence);
            assert!(expected.is_none_or(|expected| got == expected), "{k}: {got}");
        }
    }
}
