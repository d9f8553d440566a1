//! What the devices say of themselves, and links that the rig lost. Called by the watch with every sample
//! and every period.

use crate::rig::RigFault;
use crate::safety::judge::Estimate;
use crate::stream::StatusBits;

/// Worst of the device status and of the rig's own faults.
#[derive(Default)]
pub struct DeviceStatus {
    was_enabled: bool,
    of_sample: u8,
    of_rig: u8,
}

impl DeviceStatus {
    /// 0 healthy, 1 input out of range, 2 drive no longer enabled, 3 link down, 4 drive tripped.
    pub fn sample(&mut self, status: StatusBits) -> Estimate {
        let enabled = status.has(StatusBits::DRIVE_ENABLED);
        self.of_sample = if status.has(StatusBits::DRIVE_FAULT) {
            4
        } else if status.has(StatusBits::LINK_DOWN) {
            3
        } else if self.was_enabled && !enabled {
            2
        } else {
            u8::from(status.has(StatusBits::OVERRANGE))
        };
        // A rig whose drive does not report (a replayed record) never was enabled and is not judged.
        self.was_enabled |= enabled;
        self.worst()
    }

    /// What the rig reported in this period.
    pub fn period(&mut self, fault: Option<RigFault>) -> Estimate {
        self.of_rig = match fault {
            Some(RigFault::DaqLink | RigFault::DriveLink) => 3,
            Some(RigFault::DriveTrip) => 4,
            Some(RigFault::EndOfRecord) | None => 0,
        };
        self.worst()
    }

    fn worst(&self) -> Estimate {
        Estimate::Value(f64::from(self.of_sample.max(self.of_rig)))
    }
}

#[cfg(test)]
mod tests {
    use crate::safety::DetectorId;
    use crate::safety::detect::bench::Bench;

    #[test]
    fn a_tripped_drive_trips_at_once() {
        let mut bench = Bench::new();
        bench.healthy(DetectorId::DeviceStatus);
        let after = bench.until_trip(DetectorId::DeviceStatus, |_, o| {
            o.sample.status.0 |= crate::stream::StatusBits::DRIVE_FAULT;
        });
        assert!(after == Some(1), "{after:?}");
    }

    #[test]
    fn a_lost_link_trips_without_any_sample() {
        let mut bench = Bench::new();
        bench.run(100, |_, _| {});
        let lost = crate::safety::Period {
            rig_fault: Some(crate::rig::RigFault::DaqLink),
            ..crate::safety::Period::default()
        };
        assert_eq!(bench.watch.period(&lost).first, Some(DetectorId::DeviceStatus));
    }
}
